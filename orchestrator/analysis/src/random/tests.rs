use super::*;
use crate::Cluster;
use serde_json::json;

fn trial(design: Option<u64>, placement: u64, initial: f64, optimised: f64) -> Trial {
    Trial {
        setting: design.map(|seed| ("body.design.random".to_owned(), json!(seed))).into_iter().collect(),
        cluster: Cluster { placement, seed: 1 },
        errors: [[None, Some(initial), None], [None, Some(optimised), None]],
        ..Trial::default()
    }
}

/// Placement 1 has twice the error for every body; ratios within clusters do not depend on it.
#[test]
fn random_bodies_are_compared_with_those_of_their_sensors_and_stimuli() {
    let mut trials = vec![trial(None, 0, 20.0, 10.0), trial(None, 1, 40.0, 20.0)];
    for (seed, factor) in [(1, 1.2), (2, 1.8)] {
        trials.push(trial(Some(seed), 0, 20.0 * factor, 11.0));
        trials.push(trial(Some(seed), 1, 40.0 * factor, 22.0));
    }
    let trials: Vec<&Trial> = trials.iter().collect();
    let found = random(&trials, Set::Holdout).unwrap();
    let truth = (1.2f64 * 1.8).sqrt();
    let [initial, optimised] = found.ratios.clone();
    assert!((initial.unwrap().ratio / truth - 1.0).abs() < 1e-12, "{found:?}");
    let optimised = optimised.unwrap();
    assert!((optimised.ratio / (2.0 * truth) - 1.0).abs() < 1e-12, "{found:?}");
    assert_eq!((found.errors.len(), found.trained.len(), optimised.above_one), (4, 4, 4));
    assert_eq!(optimised.over, "no interval, too few units: 2 bodies × 2 placements");
    assert_eq!(random(&trials[..2], Set::Holdout), None);
    assert_eq!(random(&trials[2..], Set::Holdout), None);
}
