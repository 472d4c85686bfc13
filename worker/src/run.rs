//! Runs one trial from its spec to its result, in a worker process or in the foreground.

use metasense_numerics::Heartbeat;
pub use metasense_numerics::Pool;
use metasense_numerics::nested::{self, Optimised, State};
pub use metasense_numerics::nested::{LoopControl, keeps_error};
use metasense_numerics::place::{self, Placed};
use metasense_numerics::trial::{self, BodyModel, PreparedTrial};
use metasense_schemas::reason::{BodyFault, Cause};
use metasense_schemas::record::{Checkpoint, StepRecord, TrialResult};
use metasense_schemas::spec::TrialSpec;

use crate::clock::cpu_seconds;
use crate::convert;
use crate::external;
use crate::limits::{Needs, explained};
use crate::problem::{NO_FORCE, problem};
use crate::simd;

/// Observer of a trial.
pub trait ObserveTrial {
    /// Reports progress: before and after every simulation, training, gradient and projection, and at every iteration of the
    /// final comparison.
    fn progress(&mut self) -> LoopControl;
    /// Reports a finished outer step, and the checkpoint after it.
    fn step(&mut self, record: StepRecord, checkpoint: Checkpoint) -> LoopControl;
    /// Receives a checkpoint within the final comparison.
    fn save(&mut self, checkpoint: Checkpoint);
}

/// Why a trial has no result.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum NoResult {
    /// The observer requested a stop.
    #[error("stopped")]
    Stopped,
    /// The spec is invalid, or the checkpoint belongs to another trial.
    #[error("rejected: {0}")]
    Rejected(String),
    /// The computation failed, and smaller steps did not help.
    #[error("numerical: {detail}")]
    Numerical { cause: Cause, detail: String },
    /// The process of an external body failed.
    #[error("{}: {detail}", fault.name())]
    Body { fault: BodyFault, detail: String },
    /// A system resource is exhausted.
    #[error("a system limit is too low: {0}")]
    Shortage(String),
}

impl NoResult {
    /// The failure of an external body's process.
    pub fn of_body(fault: trial::BodyFailure) -> Self {
        Self::Body { fault: external::named(&fault), detail: fault.detail }
    }
}

/// Runs a trial from the start, or from one of its checkpoints.
///
/// # Errors
/// Why there is no result. Everything that `observer` received before stays valid.
pub fn run_trial(
    trial: &TrialSpec,
    checkpoint: Option<Checkpoint>,
    pool: &Pool,
    observer: &mut dyn ObserveTrial,
) -> Result<TrialResult, NoResult> {
    let problem = problem(trial).map_err(|invalid| NoResult::Rejected(invalid.to_string()))?;
    let resume = match checkpoint {
        None => None,
        Some(checkpoint) => Some(convert::state(checkpoint, &problem).map_err(NoResult::Rejected)?),
    };
    let (problem, placed) = place::placed(&problem, pool)?;
    let mut watch = Watch { observer, store: 0.0, body: &*problem.body };
    let optimised =
        PreparedTrial::new(&problem, pool).and_then(|trial| nested::optimise(&trial, resume, &mut watch));
    if let Some(fault) = problem.body.failure() {
        return Err(NoResult::of_body(fault));
    }
    let optimised = optimised?.ok_or(NoResult::Stopped)?;
    let designs = [&optimised.initial, &optimised.optimised].map(|body| &body.design);
    let drawings = designs.iter().map_while(|design| problem.body.svg(design)).collect();
    Ok(TrialResult { drawings, ..result(trial, optimised, placed, pool) })
}

const FEW_FORCES: &str = "stimuli.samples: there must be two training samples or more whose forces differ; raise stimuli.samples, or \
                          lower stimuli.test";

impl From<trial::Failure> for NoResult {
    fn from(failure: trial::Failure) -> Self {
        match failure.trouble() {
            trial::Trouble::NoForce => return Self::Rejected(format!("stimuli: {NO_FORCE}")),
            trial::Trouble::FewForces => return Self::Rejected(FEW_FORCES.to_owned()),
            _ => {}
        }
        let name = failure.trouble().name();
        let cause = Cause::ALL.iter().find(|cause| cause.name() == name).copied();
        Self::Numerical { cause: cause.unwrap_or(Cause::NonFinite), detail: failure.to_string() }
    }
}

fn result(trial: &TrialSpec, optimised: Optimised, placed: Option<Placed>, pool: &Pool) -> TrialResult {
    TrialResult {
        initial: convert::body_evaluation(optimised.initial),
        optimised: convert::body_evaluation(optimised.optimised),
        best_step: optimised.best_step,
        seconds_evaluation: optimised.seconds.simulate + optimised.seconds.train,
        counters: convert::counters(&optimised.counters),
        simd: pool.width().name().into(),
        solver: optimised.solver,
        signal_errors: optimised.signal_errors.map(convert::finite),
        placed: placed.map(convert::placed),
        nonlinear: optimised.nonlinear,
        moves: Vec::new(),
        casts: optimised.casts.map(|casts| convert::cast_readings(&casts)),
        bands: optimised.bands.map(|bands| convert::bands(&bands)),
        under: convert::under_readings(trial, &optimised.under),
        tasks: (0..2).flat_map(|body| convert::task_readings(body, &optimised.tasks[body])).collect(),
        drawings: Vec::new(),
    }
}

/// Pool of computing threads; 0 counts as 1.
///
/// # Errors
/// If the system cannot start them.
pub fn pool(threads: usize) -> Result<Pool, NoResult> {
    pool_counting(threads, Heartbeat::default())
}

/// As [`pool`]; `heartbeat` counts the progress of the threads.
///
/// # Errors
/// If the system cannot start them.
pub fn pool_counting(threads: usize, heartbeat: Heartbeat) -> Result<Pool, NoResult> {
    Pool::with(threads.max(1), simd::width(), heartbeat).map_err(|error| {
        let needs = Needs { threads: threads as u32, ..Needs::default() };
        NoResult::Shortage(explained(&format!("{threads} threads cannot be started: {error}"), &needs))
    })
}

/// Adapts an observer to the numerics: supplies the CPU time of the process and of external bodies (one trial per process), and
/// converts reports to records.
struct Watch<'a> {
    observer: &'a mut dyn ObserveTrial,
    /// CPU time of the observer at the last step (s); stored in the next step's record.
    store: f64,
    /// After its failure nothing is stored any more.
    body: &'a dyn BodyModel,
}

impl nested::Observe for Watch<'_> {
    /// Called before and after each part of a step, so it also reports progress.
    fn seconds(&mut self) -> f64 {
        self.observer.progress();
        cpu_seconds() + external::waited()
    }

    fn progress(&mut self, _fraction: f64) -> LoopControl {
        let wanted = self.observer.progress();
        if self.body.failure().is_some() { LoopControl::Stop } else { wanted }
    }

    fn step(&mut self, report: &nested::Report, state: &State) -> LoopControl {
        if self.body.failure().is_some() {
            return LoopControl::Stop;
        }
        let mut record = convert::step_record(report);
        record.seconds.store = self.store;
        let checkpoint = convert::checkpoint(state);
        let before = cpu_seconds();
        let control = self.observer.step(record, checkpoint);
        self.store = cpu_seconds() - before;
        control
    }

    fn save(&mut self, state: &State) {
        if self.body.failure().is_none() {
            self.observer.save(convert::checkpoint(state));
        }
    }
}

#[cfg(test)]
mod tests;
