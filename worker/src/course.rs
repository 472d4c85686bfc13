//! The course of a trial: what its body is worth after so many CPU seconds. Decides between protocols.

use metasense_numerics::nested;
use metasense_schemas::record::{BodyEvaluation, Checkpoint, StepRecord};
use metasense_schemas::spec::TrialSpec;

use crate::clock::cpu_seconds;
use crate::convert;
use crate::problem::problem;
use crate::run::{Control, Failure, Observe, pool, run_trial};

/// A body that a trial had reached.
#[derive(Debug, Clone, PartialEq)]
pub struct Milestone {
    /// CPU seconds of this process since the trial began.
    pub seconds: f64,
    /// Outer steps done.
    pub step: u32,
    /// Samples drawn beside the N.
    pub fresh_samples: u64,
    /// α of the best body so far by the test set, or of the present one where none has been tested (mm).
    pub design: Vec<f64>,
}

/// Runs a trial's outer steps on `threads` threads until it is done or has used the last of `seconds`, which ascend;
/// keeps the body at the first step after each of them and at the end.
///
/// # Errors
/// As `run_trial`.
pub fn course(trial: &TrialSpec, seconds: &[f64], threads: usize) -> Result<Vec<Milestone>, Failure> {
    let steps = trial.optimise.steps() as u32;
    let mut keeper =
        Keeper { start: cpu_seconds(), due: seconds, steps, fresh_samples: 0, milestones: Vec::new() };
    match run_trial(trial, None, threads, &mut keeper) {
        Ok(_) | Err(Failure::Stopped) => Ok(keeper.milestones),
        Err(failure) => Err(failure),
    }
}

/// Fresh networks on each design, all of the same initial weights: the comparison at the end of a trial.
///
/// # Errors
/// As `run_trial`.
pub fn evaluate(
    trial: &TrialSpec,
    designs: &[Vec<f64>],
    threads: usize,
) -> Result<Vec<BodyEvaluation>, Failure> {
    let (problem, pool) = (scene(trial)?, pool(threads)?);
    let bodies = nested::evaluate_designs(&problem, designs, &pool, &mut Alone)
        .map_err(|failure| Failure::NonFinite(failure.to_string()))?;
    Ok(bodies.into_iter().map(convert::body_evaluation).collect())
}

fn scene(trial: &TrialSpec) -> Result<nested::Problem, Failure> {
    problem(trial).map_err(|invalid| Failure::Rejected(invalid.to_string()))
}

struct Keeper<'a> {
    start: f64,
    due: &'a [f64],
    steps: u32,
    fresh_samples: u64,
    milestones: Vec<Milestone>,
}

impl Observe for Keeper<'_> {
    fn progress(&mut self, _: f64) -> Control {
        Control::Continue
    }

    fn save(&mut self, _: Checkpoint) {}

    fn step(&mut self, record: StepRecord, checkpoint: Checkpoint) -> Control {
        let seconds = cpu_seconds() - self.start;
        self.fresh_samples += record.fresh_samples;
        let passed = self.due.iter().filter(|&&due| due <= seconds).count();
        let ended = passed == self.due.len() || checkpoint.step == self.steps;
        if passed > 0 || ended {
            let design = checkpoint.best.map_or(checkpoint.design, |best| best.0);
            let fresh_samples = self.fresh_samples;
            self.milestones.push(Milestone { seconds, step: checkpoint.step, fresh_samples, design });
            self.due = &self.due[passed..];
        }
        if ended { Control::Stop } else { Control::Continue }
    }
}

/// Nobody watches, and time does not count.
struct Alone;

impl nested::Observe for Alone {
    fn seconds(&mut self) -> f64 {
        0.0
    }
    fn progress(&mut self, _: f64) -> nested::Control {
        nested::Control::Continue
    }
    fn save(&mut self, _: &nested::State) {}
    fn step(&mut self, _: &nested::Report, _: &nested::State) -> nested::Control {
        nested::Control::Continue
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metasense_schemas::spec::{Evaluation, Feasible, Sensors, Solver, Time};
    use serde_json::json;

    /// The first step is past the first mark, the end comes before the second: two bodies, the first the initial one.
    #[test]
    fn a_course_keeps_the_first_body_past_each_mark_and_the_last() {
        let trial: TrialSpec = serde_json::from_value(json!({
            "body": {
                "columns": 4, "rows": 3, "spacing": 15.0, "ligament_length": 2.25, "density": 1e-8,
                "stiffness": { "stretch": 3.0, "shear": 0.5, "bend": 1.0 },
            },
            "time": Time { duration: 0.1, samples: 20 },
            "solver": Solver::default(),
            "sensors": Sensors::default(),
            "stimuli": { "kind": "bell", "samples": 6, "test": 2, "holdout": 2, "onset": [0.0, 0.02] },
            "brain": { "iterations": 3 },
            "optimise": { "protocol": "joint", "iterations": 3, "batch": 4 },
            "evaluation": Evaluation::default(),
            "feasible": Feasible::default(),
            "point": { "panels": 2, "sensors": 1, "placement": 0, "seed": 1 },
            "panel_units": [9, 10], "sensor_units": [5],
        }))
        .unwrap();
        let milestones = course(&trial, &[0.0, 1e9], 1).unwrap();
        let found: Vec<_> = milestones.iter().map(|m| (m.step, m.fresh_samples)).collect();
        assert_eq!(found, [(1, 4), (3, 12)]);
        let initial = problem(&trial).unwrap().initial;
        assert_eq!(milestones[0].design, initial);
        let bodies = evaluate(&trial, &[initial, milestones[1].design.clone()], 1).unwrap();
        assert!(bodies.iter().all(|body| body.networks[0].error_holdout.is_some()), "{bodies:?}");
    }
}
