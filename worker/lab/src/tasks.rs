//! Estimates of other quantities than force histories from a body's signals.

use metasense_numerics::nested::{estimate_tasks, fit_readouts};
use metasense_numerics::place::placed;
use metasense_numerics::trial::{Failure as OfMaths, PreparedTrial};
use metasense_schemas::record::TaskReading;
use metasense_schemas::spec::TrialSpec;
use metasense_worker::convert;
use metasense_worker::problem::estimable;
use metasense_worker::run::{NoResult, pool};

use crate::prepare::simulable;

pub use metasense_numerics::brains::{ReadoutWeights as Readout, SensingTask, TaskReadouts};

/// Estimates of all tasks on the initial (0) or trained (1) body, as a trial stores them with `evaluation.tasks = true`.
///
/// # Errors
/// If the spec is invalid, the design has the wrong length or cannot be simulated, or there are too few samples.
pub fn tasks(
    trial: &TrialSpec,
    body: usize,
    design: &[f64],
    threads: usize,
) -> Result<Vec<TaskReading>, NoResult> {
    let problem = simulable(trial, design)?;
    estimable(trial, &problem).map_err(|invalid| NoResult::Rejected(invalid.to_string()))?;
    let pool = pool(threads)?;
    let (problem, _) = placed(&problem, &pool)?;
    let found = estimate_tasks(&PreparedTrial::new(&problem, &pool)?, design).map_err(OfMaths::Initial)?;
    Ok(convert::task_readings(body, &found))
}

/// Readouts of the trial's tasks (`brain.task`) on a body, for a device.
///
/// # Errors
/// If the spec is invalid, the design has the wrong length or cannot be simulated, or there are too few samples.
pub fn readouts(trial: &TrialSpec, design: &[f64], threads: usize) -> Result<TaskReadouts, NoResult> {
    let (problem, pool) = (simulable(trial, design)?, pool(threads)?);
    let (problem, _) = placed(&problem, &pool)?;
    Ok(fit_readouts(&PreparedTrial::new(&problem, &pool)?, design).map_err(OfMaths::Initial)?)
}
