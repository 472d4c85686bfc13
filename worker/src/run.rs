//! One trial from its spec to its result, for a worker process or in the foreground.

use metasense_numerics::Heartbeat;
pub use metasense_numerics::Pool;
use metasense_numerics::nested::{self, Optimised, State};
pub use metasense_numerics::nested::{Control, keeps_error};
use metasense_numerics::place::{self, Placed};
use metasense_numerics::trial::{self, Problem, Trial};
use metasense_schemas::record::{BodyEvaluation, Checkpoint, StepRecord, TrialResult};
use metasense_schemas::spec::TrialSpec;
use metasense_schemas::wire::Cause;

use crate::clock::cpu_seconds;
use crate::convert;
use crate::demands::memory;
use crate::design;
use crate::limits::{Needs, explained};
use crate::problem::problem;
use crate::simd;

/// Who watches a trial.
pub trait Observe {
    /// A sign of life: before and after every simulation, training, gradient and projection, and at every iteration of the
    /// comparison at the end.
    fn progress(&mut self) -> Control;
    /// A finished outer step, and what is needed to go on after it.
    fn step(&mut self, record: StepRecord, checkpoint: Checkpoint) -> Control;
    /// What is needed to go on within the comparison at the end.
    fn save(&mut self, checkpoint: Checkpoint);
}

/// Why a trial has no result.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Failure {
    /// The observer said stop.
    #[error("stopped")]
    Stopped,
    /// The spec stands for no trial, or the checkpoint belongs to another one.
    #[error("rejected: {0}")]
    Rejected(String),
    /// The maths got into trouble that no smaller step leads out of.
    #[error("numerical: {detail}")]
    Numerical {
        /// What it was.
        cause: Cause,
        /// And where.
        detail: String,
    },
    /// The machine is short of something; says of what.
    #[error("short of something: {0}")]
    Shortage(String),
}

/// Runs a trial, from the beginning or from a checkpoint of its own.
///
/// # Errors
/// Says why there is no result. Whatever `observer` was given before then holds.
pub fn run_trial(
    trial: &TrialSpec,
    checkpoint: Option<Checkpoint>,
    pool: &Pool,
    observer: &mut dyn Observe,
) -> Result<TrialResult, Failure> {
    let problem = prepared(trial)?;
    let resume = match checkpoint {
        None => None,
        Some(checkpoint) => Some(convert::state(checkpoint, &problem).map_err(Failure::Rejected)?),
    };
    let (problem, placed) = place::placed(&problem, pool)?;
    let mut watch = Watch { observer, store: 0.0 };
    let optimised = nested::optimise(&Trial::new(&problem, pool)?, resume, &mut watch)?;
    optimised.map(|optimised| result(trial, optimised, placed, pool)).ok_or(Failure::Stopped)
}

const NO_FORCE: &str = "stimuli: no training sample has a force; check stimuli.onset and stimuli.amplitude against time.duration, or the \
                        clock and the scale of the records";
const FEW_FORCES: &str = "stimuli.samples: there must be two training samples or more whose forces differ; raise stimuli.samples, or \
                          lower stimuli.test";

impl From<trial::Failure> for Failure {
    fn from(failure: trial::Failure) -> Self {
        match failure.trouble() {
            trial::Trouble::NoForce => return Self::Rejected(NO_FORCE.to_owned()),
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
    }
}

/// The problem that a spec stands for.
///
/// # Errors
/// If it stands for no trial.
pub fn prepared(trial: &TrialSpec) -> Result<Problem, Failure> {
    problem(trial).map_err(|invalid| Failure::Rejected(invalid.to_string()))
}

/// The problem that a spec stands for, and that `design` is one of its body.
///
/// # Errors
/// If the spec stands for no trial, or as `check_design`.
pub fn with_design(trial: &TrialSpec, design: &[f64]) -> Result<Problem, Failure> {
    let problem = prepared(trial)?;
    check_design(&problem, design)?;
    Ok(problem)
}

/// Whether `design` is one of the problem's body, and its units are bodies.
///
/// # Errors
/// If its length is another, a number is not finite, or a unit has no mass: without given masses those turned inside out have none.
pub fn check_design(problem: &Problem, design: &[f64]) -> Result<(), Failure> {
    design::check("the design", &[design.len()], design, problem.initial.len()).map_err(Failure::Rejected)?;
    let geometry = problem.scene.geometry(design);
    let sound = |unit: &usize| {
        let [area, mass, moment] = [&geometry.area, &geometry.mass, &geometry.moment].map(|of| of[*unit]);
        area != 0.0 && mass > 0.0 && moment >= 0.0
    };
    match (0..problem.scene.layout.units()).find(|unit| !sound(unit)) {
        None => Ok(()),
        Some(unit) => Err(Failure::Rejected(format!(
            "the design: unit {unit} has an area of {:.3} mm² and can be neither cast nor simulated; `metasense body project` repairs a design",
            geometry.area[unit]
        ))),
    }
}

/// The problem with this design, of which all samples are to be simulated here.
///
/// # Errors
/// As of [`with_design`], or if this machine has not the memory for them.
pub(crate) fn simulable(trial: &TrialSpec, design: &[f64]) -> Result<Problem, Failure> {
    check_memory(trial)?;
    with_design(trial, design)
}

/// Whether this machine has the memory that the samples of a trial need.
///
/// # Errors
/// Names the key that asks for most.
fn check_memory(trial: &TrialSpec) -> Result<(), Failure> {
    memory::check_here(trial).map_err(|invalid| Failure::Rejected(invalid.to_string()))
}

/// Whether there are as many numbers as a trial has.
pub(crate) fn check_length(what: &str, given: usize, expected: usize) -> Result<(), Failure> {
    match given == expected {
        true => Ok(()),
        false => Err(Failure::Rejected(format!("the {what} has {given} numbers, the trial {expected}"))),
    }
}

/// Refuses NaN and infinity.
///
/// # Errors
/// Names the first that is not finite, and where it stands.
pub fn finite(what: &str, values: &[f64]) -> Result<(), Failure> {
    design::finite(what, values).map_err(Failure::Rejected)
}

/// The problem that a spec stands for, on these threads, its sensors in place: searched for where that is to be done.
///
/// # Errors
/// If the spec stands for no trial, this machine has not the memory for one, or the search comes to nothing.
pub fn placed(trial: &TrialSpec, pool: &Pool) -> Result<Problem, Failure> {
    check_memory(trial)?;
    Ok(place::placed(&prepared(trial)?, pool)?.0)
}

/// Fresh networks on each design, all of the same initial weights: the comparison at the end of a trial.
///
/// # Errors
/// As `run_trial`.
pub fn evaluate_designs(
    trial: &TrialSpec,
    designs: &[Vec<f64>],
    threads: usize,
) -> Result<Vec<BodyEvaluation>, Failure> {
    let pool = pool(threads)?;
    let trial = Trial::new(&placed(trial, &pool)?, &pool)?;
    let bodies = nested::evaluate_designs(&trial, designs, &mut nested::Nobody);
    Ok(bodies.into_iter().map(convert::body_evaluation).collect())
}

/// Threads for the maths; 0 counts as 1.
///
/// # Errors
/// If the system does not start them.
pub fn pool(threads: usize) -> Result<Pool, Failure> {
    pool_counting(threads, Heartbeat::default())
}

/// The same, what they do counted there.
///
/// # Errors
/// If the system does not start them.
pub fn pool_counting(threads: usize, heartbeat: Heartbeat) -> Result<Pool, Failure> {
    Pool::with(threads.max(1), simd::width(), heartbeat).map_err(|error| {
        let needs = Needs { threads: threads as u32, ..Needs::default() };
        Failure::Shortage(explained(&format!("{threads} threads cannot be started: {error}"), &needs))
    })
}

/// Gives the maths a clock, that of the process's CPU time (a process runs one trial at a time), and its reports the form in which they are stored.
struct Watch<'a> {
    observer: &'a mut dyn Observe,
    /// CPU seconds that the observer took with the last step; they stand in the next one's record.
    store: f64,
}

impl nested::Observe for Watch<'_> {
    /// Asked where a part of a step begins and ends, which makes it a sign of life.
    fn seconds(&mut self) -> f64 {
        self.observer.progress();
        cpu_seconds()
    }

    fn progress(&mut self, _fraction: f64) -> Control {
        self.observer.progress()
    }

    fn step(&mut self, report: &nested::Report, state: &State) -> Control {
        let mut record = convert::step_record(report);
        record.seconds.store = self.store;
        let checkpoint = convert::checkpoint(state);
        let before = cpu_seconds();
        let control = self.observer.step(record, checkpoint);
        self.store = cpu_seconds() - before;
        control
    }

    fn save(&mut self, state: &State) {
        self.observer.save(convert::checkpoint(state));
    }
}

#[cfg(test)]
mod tests;
