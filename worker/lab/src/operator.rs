//! How well a body's sensors distinguish forces.

use metasense_schemas::spec::TrialSpec;
use metasense_worker::run::NoResult;

use crate::modes::check_rest;
use crate::prepare::with_design;
use crate::questions;
pub use crate::questions::OperatorFigures;

/// Information on a trial's forces in the signals of a body, for small motions.
///
/// # Errors
/// If the spec is invalid, its sensors are not yet placed, or the design has the wrong length.
pub fn operator_figures(trial: &TrialSpec, design: &[f64]) -> Result<OperatorFigures, NoResult> {
    let problem = with_design(trial, design)?;
    if problem.search.is_some() {
        let why = "sensors.search: the sensors of this trial have not been placed yet".to_owned();
        return Err(NoResult::Rejected(why));
    }
    check_rest(&problem.scene, design)?;
    Ok(questions::compute_figures(&problem, design))
}
