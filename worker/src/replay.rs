//! A finished trial computed again from its stored design and weights: geometry, signals, predictions, motion.

use metasense_numerics::body::Geometry;
use metasense_numerics::brains::fits;
use metasense_numerics::feasible::{Active, Feasible};
use metasense_numerics::place::placed;
use metasense_numerics::questions;
pub use metasense_numerics::questions::{LinearReplay, Motion, Replay};
use metasense_numerics::trial::Decoder;
use metasense_schemas::spec::TrialSpec;

use crate::run::{Failure, check_length, pool, prepared, with_design};

/// A body to draw.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawing {
    /// Corners of every unit (mm), counter-clockwise from the right.
    pub units: Vec<[[f64; 2]; 4]>,
    /// Area centroids (mm).
    pub centroids: Vec<[f64; 2]>,
    /// Ends of every ligament (mm).
    pub ligaments: Vec<[[f64; 2]; 2]>,
    /// The two corners (unit, node) that each ligament joins.
    pub joints: Vec<[(usize, usize); 2]>,
    /// Struck units, and the direction of the blow.
    pub panels: Vec<(usize, [f64; 2])>,
    /// Units that carry sensors.
    pub sensors: Vec<usize>,
    /// Units that are held.
    pub clamped: Vec<usize>,
    /// Constraints at their limit.
    pub active: Vec<Active>,
    /// Pitch of the grid (mm).
    pub spacing: f64,
    /// Instants (s) of signals and motion.
    pub clock: Vec<f64>,
}

/// Where everything of a body lies.
///
/// # Errors
/// If the spec stands for no trial, or the design is not one of its body.
pub fn drawing(trial: &TrialSpec, design: &[f64]) -> Result<Drawing, Failure> {
    let problem = with_design(trial, design)?;
    let scene = &problem.scene;
    let geometry = Geometry::new(&scene.layout, design, scene.density);
    let ligaments = scene.layout.ligaments.iter();
    let instants = 1..=scene.instants;
    Ok(Drawing {
        ligaments: ligaments
            .map(|l| [geometry.vertices[l.a.unit][l.a.node], geometry.vertices[l.b.unit][l.b.node]])
            .collect(),
        joints: scene.layout.ligaments.iter().map(|l| [(l.a.unit, l.a.node), (l.b.unit, l.b.node)]).collect(),
        units: geometry.vertices,
        centroids: geometry.centroids,
        panels: scene.panels.iter().map(|p| (p.unit, p.direction)).collect(),
        sensors: scene.sensors.clone(),
        clamped: scene.clamped.clone(),
        // the initial body may be given beyond a limit: then it is not at it
        active: Feasible::new(&scene.layout, problem.limits, &[])
            .active(design)
            .into_iter()
            .filter(|a| a.slack >= 0.0)
            .collect(),
        spacing: scene.layout.spacing,
        clock: instants.map(|n| n as f64 * scene.duration / scene.instants as f64).collect(),
    })
}

/// Signals of a body under all samples of its trial, and the predictions of its brain: of a network where `weights` are
/// given, of a linear one always.
///
/// # Errors
/// If the spec stands for no trial, lengths do not fit it, or a simulation does not end well.
pub fn replay(trial: &TrialSpec, design: &[f64], weights: &[f32], threads: usize) -> Result<Replay, Failure> {
    let problem = with_design(trial, design)?;
    if !weights.is_empty() {
        check_length("network", weights.len(), problem.reader_shape().weights())?;
    }
    let pool = pool(threads)?;
    Ok(questions::replay(&placed(&problem, &pool)?.0, design, weights, &pool)?)
}

/// The linear brain of the whole sample on a replay's signals: what every body is read by. None where it is too large.
///
/// # Errors
/// If the spec stands for no trial, or the brain cannot be solved for.
pub fn linear(trial: &TrialSpec, replay: &Replay) -> Result<Option<LinearReplay>, Failure> {
    let problem = prepared(trial)?;
    let (instants, channels) = (problem.scene.instants, replay.signal_scale.len());
    if !fits(instants, channels, problem.scene.panels.len()) {
        return Ok(None);
    }
    let found = replay.linear(&problem, &Decoder::whole(instants, channels));
    found.map(Some).map_err(Failure::numerical)
}

/// Motion of a body under one sample of its trial, numbered as in [`replay`].
///
/// # Errors
/// As [`replay`].
pub fn motion(trial: &TrialSpec, design: &[f64], sample: usize, threads: usize) -> Result<Motion, Failure> {
    let problem = with_design(trial, design)?;
    Ok(questions::motion(&problem, design, sample, &pool(threads)?)?)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::run::{Control, Observe, run_trial};
    use metasense_schemas::record::{BodyEvaluation, Checkpoint, StepRecord};

    struct Blind;

    impl Observe for Blind {
        fn progress(&mut self) -> Control {
            Control::Continue
        }
        fn save(&mut self, _: Checkpoint) {}
        fn step(&mut self, _: StepRecord, _: Checkpoint) -> Control {
            Control::Continue
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

    /// Mean errors by set, from the stored design and weights alone, against those that the trial recorded.
    #[test]
    fn a_replay_has_the_errors_that_the_trial_recorded() {
        let trial = small_trial();
        let result = run_trial(&trial, None, &pool(1).unwrap(), &mut Blind).unwrap();
        for BodyEvaluation { design, networks, .. } in [&result.initial, &result.optimised] {
            let found = replay(&trial, design, &networks[0].weights, 1).unwrap();
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
        assert!(replay(&trial, &[0.0], &[], 1).is_err());
    }
}
