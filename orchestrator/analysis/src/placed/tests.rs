use super::*;
use crate::setting::flatten;
use serde_json::json;

/// Errors with random sensors 40/m, trained 20/m; with searched sensors 16/m, trained 4/m. Factors of four seeds cancel in
/// ratios.
#[test]
fn placing_and_training_are_told_apart() {
    let mut trials = Vec::new();
    for seed in 1..=4u64 {
        for m in 1..=4u64 {
            for (searched, placement) in [(false, 0), (false, 1), (true, 0), (true, 1)] {
                let sensors = if searched { json!({"search": "greedy"}) } else { json!({}) };
                let spec = json!({"sensors": sensors, "point": {"panels": 4, "sensors": m, "seed": seed}});
                let level = f64::from(seed as u32) / m as f64;
                // the second searched placement is ignored
                let [initial, trained] = match (searched, placement) {
                    (false, p) => [40.0, 20.0].map(|e| e * level * [0.5, 2.0][p as usize]),
                    (true, 0) => [16.0, 4.0].map(|e| e * level),
                    (true, _) => [99.0, 99.0],
                };
                trials.push(Trial {
                    setting: flatten(&spec).into_iter().collect(),
                    panels: 4,
                    sensors: m,
                    cluster: Cluster { placement, seed },
                    errors: [initial, trained].map(|e| [Some(e), Some(e), None]),
                    ..Trial::default()
                });
            }
        }
    }
    let refs: Vec<&Trial> = trials.iter().collect();
    let found = placed(&refs);
    assert_eq!((found.len(), found[0].levels.len()), (1, 4));
    let level = &found[0].levels[1];
    let seeds = 24f64.powf(0.25);
    for (searched, body, expected) in [
        (false, BodyState::Initial, 20.0),
        (false, BodyState::Optimised, 10.0),
        (true, BodyState::Initial, 8.0),
        (true, BodyState::Optimised, 2.0),
    ] {
        let error = level.error(searched, body, Set::Holdout).unwrap();
        assert!((error / (expected * seeds) - 1.0).abs() < 1e-12, "{error}");
    }
    let placing = level.gain_from_placing(Set::Holdout).unwrap();
    let training = level.gain_from_training(Set::Holdout).unwrap();
    assert!((placing.ratio - 2.5).abs() < 1e-12 && (training.ratio - 4.0).abs() < 1e-12);
    assert!(training.interval.is_some() && training.over == "4 seeds", "{training:?}");
    // geometric mean over seeds: 16 · 2.21/m ≤ 10.5 from m = 4 on (8.85); trained 4 · 2.21/m from m = 1 on (8.85)
    let needed = |searched, body| found[0].needed(searched, body, Set::Holdout, 10.5);
    let [initial, optimised] = BodyState::ALL.map(|body| needed(true, body));
    assert_eq!((initial.sensors, optimised.sensors), (Some(4), Some(1)));
    // errors are 16/m times the seed, 1 to 4: some replicates need fewer sensors, some more than 4
    let (low, high) = initial.range.unwrap();
    assert!(low.unwrap() < 4 && high.is_none(), "{initial}");
    assert_eq!(needed(false, BodyState::Initial).to_string(), "–");
    // without a search there is no table
    let random: Vec<&Trial> = refs.iter().filter(|t| search(t).is_none()).copied().collect();
    assert!(placed(&random).is_empty());
}
