//! Ratings of synthetic trials.

use super::*;
use crate::setting::flatten;
use serde_json::{Value, json};

/// A trial with equal errors on both sets.
fn trial(setting: Value, [panels, sensors]: [u64; 2], seed: u64, [initial, optimised]: [f64; 2]) -> Trial {
    Trial {
        setting: flatten(&setting).into_iter().collect(),
        panels,
        sensors,
        cluster: Cluster { placement: seed, seed: 1 },
        errors: [initial, optimised].map(|e| [Some(e), Some(e), None]),
        ..Trial::default()
    }
}

fn scene(stimuli: &str, kind: &str) -> Value {
    json!({"body": {"layout": "planar"}, "stimuli": {"kind": stimuli}, "brain": {"kind": kind}})
}

fn rated(number: usize, trials: &[Trial]) -> (String, Option<Rating>) {
    summary(&CLAIMS[number].evidence(trials))
}

/// A claimed factor of 2: "holds" above 2, "compatible" at about 2, "in part" at 1.5, "no difference" at 1, "fails" below,
/// "open" with three seeds.
#[test]
fn a_factor_is_held_against_its_interval() {
    let of = |kind: &str, factor: f64, seeds: u64| -> Vec<Trial> {
        let at = |seed| {
            trial(
                scene("bell", kind),
                [2, 1],
                seed,
                [factor * (10.0 + seed as f64), 10.0 + 1.1 * seed as f64],
            )
        };
        (1..=seeds).map(at).collect()
    };
    for (factor, seeds, rating) in [
        (2.5, 5, Rating::Holds),
        (2.045, 5, Rating::Compatible),
        (1.5, 5, Rating::InPart),
        (1.02, 5, Rating::Alike),
        (0.7, 5, Rating::Fails),
        (2.5, 3, Rating::Open),
    ] {
        assert_eq!(
            rated(0, &of("linear", factor, seeds)),
            (rating.name().to_owned(), Some(rating)),
            "{factor}"
        );
    }
    let mut told = of("linear", 2.5, 5);
    assert_eq!(by_medians(&CLAIMS[0].evidence(&told)), None);
    for (factor, said) in [(2.5, None), (0.7, Some("fails"))] {
        let medians = |t: &mut Trial| {
            t.errors[0][2] = Some(factor * 10.0);
            t.errors[1][2] = Some(10.0 + 1e-3 * t.cluster.placement as f64);
        };
        told.iter_mut().for_each(medians);
        let evidence = CLAIMS[0].evidence(&told);
        assert_eq!(by_medians(&evidence).as_deref(), said, "{factor}");
        assert_eq!(summary(&evidence).1, Some(Rating::Holds), "{factor}");
    }
    let both = [of("linear", 2.5, 5), of("cnn", 0.7, 5)].concat();
    assert_eq!(rated(0, &both), ("depends on the decoder: holds with linear · fails with cnn".into(), None));
    assert_eq!(rated(3, &both), ("not tested".into(), None));
    // other lattices are no evidence for the claims
    let mut others = of("linear", 2.5, 5);
    let own = json!({"body": {"layout": "planar", "lattice": "kagome"}, "stimuli": {"kind": "bell"}});
    others.iter_mut().for_each(|t| t.setting = flatten(&own).into_iter().collect());
    assert_eq!(rated(0, &others), ("not tested".into(), None));
}

/// Two findings with p-values of 4 % are adjusted to 8 %; one of 0.1 % stays significant.
#[test]
fn many_findings_are_judged_together() {
    let of = |set: &'static str, chance: f64| Evidence {
        who: "linear".into(),
        set,
        trials: 5,
        found: Some(2.0),
        interval: Some(Interval { low: 1.01, high: 4.0 }),
        chance: Some(chance),
        tells: None,
        note: String::new(),
        over: String::new(),
        rating: Rating::Holds,
    };
    let found = corrected(vec![
        vec![of("holdout", 0.04), of("test", 0.04)],
        vec![of("holdout", 0.001), of("holdout", 0.04)],
    ]);
    let told: Vec<(Rating, f64)> =
        found.iter().flatten().map(|e| (e.rating, e.chance.unwrap_or(f64::NAN))).collect();
    let expected =
        [(Rating::Open, 0.08), (Rating::Holds, 0.04), (Rating::Holds, 0.003), (Rating::Open, 0.08)];
    assert_eq!(told, expected);
}

/// Gains of 4 under blows and 2 under pulses, then the opposite.
#[test]
fn gains_are_compared_seed_by_seed() {
    let of = |stimuli: &str, factor: f64| -> Vec<Trial> {
        let at =
            |seed| trial(scene(stimuli, "linear"), [2, 1], seed, [factor * (1.0 + 0.02 * seed as f64), 1.0]);
        (1..=4).map(at).collect()
    };
    assert_eq!(rated(4, &[of("irregular", 4.0), of("bell", 2.0)].concat()).1, Some(Rating::Holds));
    assert_eq!(rated(4, &[of("irregular", 2.0), of("bell", 4.0)].concat()).1, Some(Rating::Fails));
}

/// Curves over M of four placements: an elbow at the bend, two sensors against six, a spread that training reduces.
#[test]
fn curves_are_judged_by_votes() {
    let of = |initial: [f64; 6], trained: [f64; 6], kept: f64| -> Vec<Trial> {
        let at = |placement: u64, m: usize| {
            let level = 0.02 * placement as f64 * if m.is_multiple_of(2) { 1.0 } else { -1.0 };
            let errors = [initial[m] * level.exp(), trained[m] * (kept * level).exp()];
            trial(scene("bell", "linear"), [4, m as u64 + 1], placement, errors)
        };
        (1..=4).flat_map(|placement| (0..6).map(move |m| at(placement, m))).collect()
    };
    let initial = [40.0, 32.0, 26.0, 22.0, 20.0, 18.0];
    let early = of(initial, [30.0, 8.0, 7.8, 7.6, 7.5, 7.4], 0.1);
    let found: Vec<_> = (7..=10).map(|number| rated(number, &early).1).collect();
    assert_eq!(found, [Some(Rating::Holds); 4], "{found:?}");
    let late = of(initial, [39.0, 30.0, 20.0, 5.0, 4.9, 4.8], 1.5);
    let found: Vec<_> = (8..=10).map(|number| rated(number, &late).1).collect();
    assert_eq!(found, [Some(Rating::Fails); 3], "{found:?}");
}

/// Different noise separates trials. A placement with a single M, and an M with a single placement, are not part of the curves.
#[test]
fn curves_are_of_whole_settings() {
    let of = |noise: Option<f64>, placement: u64, sensors: u64, errors: [f64; 2]| {
        let mut scene = scene("bell", "linear");
        if let Some(noise) = noise {
            scene["sensors"] = json!({"noise": noise});
        }
        trial(scene, [4, sensors], placement, errors)
    };
    let curve = |noise, placement| {
        (1..=4).map(move |m| of(noise, placement, m, [40.0 / m as f64, (20.0 + placement as f64) / m as f64]))
    };
    let whole: Vec<Trial> = [None, Some(0.03)]
        .into_iter()
        .flat_map(|noise| (1..=4).flat_map(move |placement| curve(noise, placement)))
        .collect();
    let found = CLAIMS[7].evidence(&whole);
    let noisy = |e: &Evidence| e.who.contains("noise");
    assert_eq!((found.len(), found.iter().filter(|e| noisy(e)).count()), (4, 2), "{found:?}");
    for lone in [of(None, 9, 2, [10.0, 40.0]), of(None, 1, 9, [10.0, 40.0])] {
        assert_eq!(CLAIMS[7].evidence(&[whole.clone(), vec![lone]].concat()), found);
    }
}
