//! Records the designs that a trial has reached after given CPU seconds, to compare protocols.

use metasense_schemas::record::{Checkpoint, StepRecord};
use metasense_schemas::spec::TrialSpec;
use metasense_worker::clock::cpu_seconds;
use metasense_worker::run::{LoopControl, NoResult, ObserveTrial, pool, run_trial};

/// A design during a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Milestone {
    /// CPU seconds of this process since the start of the trial.
    pub seconds: f64,
    /// Outer steps done.
    pub step: u32,
    /// Additional samples drawn so far, besides the N.
    pub fresh_samples: u64,
    /// α (mm) of the best body so far on the test set; of the current body before the first test.
    pub design: Vec<f64>,
}

/// Runs a trial's outer steps on `threads` threads until it is done or the last of `seconds` (ascending) is over. Records the
/// design at the first step after each of them and at the end.
///
/// # Errors
/// As `run_trial`.
pub fn course(trial: &TrialSpec, seconds: &[f64], threads: usize) -> Result<Vec<Milestone>, NoResult> {
    let steps = trial.optimise.steps() as u32;
    let mut keeper =
        Keeper { start: cpu_seconds(), due: seconds, steps, fresh_samples: 0, milestones: Vec::new() };
    match pool(threads).and_then(|pool| run_trial(trial, None, &pool, &mut keeper)) {
        Ok(_) | Err(NoResult::Stopped) => Ok(keeper.milestones),
        Err(failure) => Err(failure),
    }
}

struct Keeper<'a> {
    start: f64,
    due: &'a [f64],
    steps: u32,
    fresh_samples: u64,
    milestones: Vec<Milestone>,
}

impl ObserveTrial for Keeper<'_> {
    fn progress(&mut self) -> LoopControl {
        LoopControl::Continue
    }

    fn save(&mut self, _: Checkpoint) {}

    fn step(&mut self, record: StepRecord, checkpoint: Checkpoint) -> LoopControl {
        let seconds = cpu_seconds() - self.start;
        self.fresh_samples += record.fresh_samples;
        let passed = self.due.iter().filter(|&&due| due <= seconds).count();
        let ended = passed == self.due.len() || checkpoint.step == self.steps;
        if passed > 0 || ended {
            let design = checkpoint.best.map_or(checkpoint.design, |best| best.design);
            let fresh_samples = self.fresh_samples;
            self.milestones.push(Milestone { seconds, step: checkpoint.step, fresh_samples, design });
            self.due = &self.due[passed..];
        }
        if ended { LoopControl::Stop } else { LoopControl::Continue }
    }
}
