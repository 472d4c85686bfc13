use metasense_schemas::record::{BodyRecord, Checkpoint, StepRecord};
use metasense_worker::run::{LoopControl, ObserveTrial, run_trial};

use super::*;

pub(crate) struct Blind;

impl ObserveTrial for Blind {
    fn progress(&mut self) -> LoopControl {
        LoopControl::Continue
    }
    fn save(&mut self, _: Checkpoint) {}
    fn step(&mut self, _: StepRecord, _: Checkpoint) -> LoopControl {
        LoopControl::Continue
    }
}

pub(crate) fn small_trial() -> TrialSpec {
    let json = r#"{"body": {"columns": 3, "rows": 3, "spacing": 15.0, "ligament_length": 2.25, "density": 1e-8,
            "stiffness": {"stretch": 3.0, "shear": 0.5, "bend": 1.0}}, "time": {"duration": 0.3, "samples": 30},
            "solver": {}, "sensors": {}, "stimuli": {"kind": "bell", "samples": 10, "test": 3, "holdout": 4,
            "onset": [0.0, 0.1]}, "brain": {"iterations": 10}, "optimise": {"iterations": 1}, "evaluation": {},
            "feasible": {}, "point": {"panels": 1, "sensors": 1, "placement": 0, "seed": 3}, "panel_units": [7],
            "sensor_units": [4]}"#;
    serde_json::from_str(json).unwrap()
}

/// The trial with another value of a key.
pub(crate) fn small_trial_with(table: &str, key: &str, value: serde_json::Value) -> TrialSpec {
    let mut trial = serde_json::to_value(small_trial()).unwrap();
    trial[table][key] = value;
    serde_json::from_value(trial).unwrap()
}

/// Mean errors per set, from the stored design and weights, equal those that the trial recorded.
#[test]
fn a_replay_has_the_errors_that_the_trial_recorded() {
    let trial = small_trial();
    let result = run_trial(&trial, None, &pool(1).unwrap(), &mut Blind).unwrap();
    for BodyRecord { design, networks, .. } in [&result.initial, &result.optimised] {
        let found = replay(&trial, design, &networks[0].weights, 0, 1).unwrap();
        let recorded = [networks[0].error_train, networks[0].error_test, networks[0].error_holdout];
        for (set, recorded) in recorded.into_iter().enumerate() {
            let of_set = found.split.iter().zip(&found.errors).filter(|(s, _)| usize::from(**s) == set);
            let errors: Vec<f64> = of_set.filter_map(|(_, e)| *e).collect();
            let mean = errors.iter().sum::<f64>() / errors.len() as f64;
            assert!((mean / recorded.unwrap() - 1.0).abs() < 1e-6, "set {set}: {mean} {recorded:?}");
        }
    }
    assert_eq!(drawing(&trial, &result.initial.design).unwrap().ligaments.len(), 12);
    let motion = motion(&trial, &result.initial.design, 0, 1).unwrap();
    assert_eq!((motion.velocities.len(), motion.velocities[0].len()), (30, 9));
    assert!(replay(&trial, &[0.0], &[], 0, 1).is_err());
}
