use super::*;

const KIND: Irregular = Irregular {
    bell: Bell {
        amplitude: [0.3, 1.0],
        width: [0.02, 0.08],
        onset: [0.0, 0.5],
        peak: [0.2, 0.45],
        power: [1.0, 2.0],
    },
    roughness: [0.1, 0.35],
    double: 0.25,
    gap: [0.01, 0.05],
    rebound: [0.2, 0.7],
};

/// Each sample strikes one panel, all panels occur, no force is negative, and a sample does not depend on others.
#[test]
fn a_sample_strikes_one_panel_and_depends_on_its_number_alone() {
    let all = irregular(&KIND, Purpose::Stimulus, 5, 0..200, 2, 1.0, 200);
    let struck: Vec<Vec<usize>> = (0..200)
        .map(|i| (0..2).filter(|k| all.sample(i)[k * 201..][..201].iter().any(|f| *f > 0.0)).collect())
        .collect();
    assert!(struck.iter().all(|panels| panels.len() == 1), "{struck:?}");
    let right = struck.iter().filter(|panels| panels[0] == 1).count();
    assert!((70..130).contains(&right), "{right} of 200");
    assert!(all.values.iter().all(|f| *f >= 0.0 && *f < 3.0));
    let alone = irregular(&KIND, Purpose::Stimulus, 5, 17..18, 2, 1.0, 200);
    assert_eq!(alone.values, all.sample(17));
    assert_ne!(irregular(&KIND, Purpose::Fresh, 5, 17..18, 2, 1.0, 200).values, alone.values);
}

/// Shares of blows with a gap between two hits, and of rough blows, which have more maxima than hits.
#[test]
fn blows_are_at_times_double_and_rough() {
    let all = irregular(&KIND, Purpose::Stimulus, 1, 0..400, 1, 1.0, 2000);
    let (mut double, mut rough) = (0, 0);
    for i in 0..400 {
        let f = all.sample(i);
        let hits = f.windows(2).filter(|w| w[0] == 0.0 && w[1] > 0.0).count();
        let maxima = f.windows(3).filter(|w| w[0] < w[1] && w[1] > w[2]).count();
        double += usize::from(hits == 2);
        rough += usize::from(maxima > hits);
    }
    assert!((70..130).contains(&double) && rough > 200, "{double} double, {rough} rough of 400");
}
