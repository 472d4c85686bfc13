//! Why a body is easy to read, or hard.

use metasense_numerics::questions;
pub use metasense_numerics::questions::Told;
use metasense_schemas::spec::TrialSpec;

use crate::modes::check_rest;
use crate::run::{Failure, with_design};

/// What the sensors of a body can tell of a trial's forces, by small motions.
///
/// # Errors
/// If the spec stands for no trial, its sensors are still to be searched for, or the design is of another length.
pub fn told(trial: &TrialSpec, design: &[f64]) -> Result<Told, Failure> {
    let problem = with_design(trial, design)?;
    if problem.search.is_some() {
        let why = "sensors.search: the sensors of this trial have not been placed yet".to_owned();
        return Err(Failure::Rejected(why));
    }
    check_rest(&problem.scene, design)?;
    Ok(questions::told(&problem, design))
}
