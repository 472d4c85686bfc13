//! Fits the cast that best explains measured records of a trial's body.

pub use metasense_numerics::dynamics::Parameters;
pub use metasense_numerics::identify::{
    BOX, Ending, Estimate, Fit, FitIteration, Iteration, Offset, Parameter, UNEXPLAINED, Unknown,
};
use metasense_schemas::spec::TrialSpec;
use metasense_worker::run::{NoResult, pool};

use crate::measured::Measured;
use crate::prepare::{check_design, placed};

/// Fits a cast of `design` to records. Unknowns are the parameters in `free` and whatever `[variation]` varies. Other parameters
/// keep the spec's values; if `free` is empty, they vary, too.
///
/// `watch` receives every turn that is not in `known`, the turns of an earlier run.
///
/// # Errors
/// If the spec is invalid, the design belongs to another body, or a free parameter starts at or below 0.
pub fn identify(
    trial: &TrialSpec,
    design: &[f64],
    measured: &Measured,
    free: &[Parameter],
    threads: usize,
    known: &[FitIteration],
    watch: &mut dyn FnMut(&FitIteration),
) -> Result<Fit, NoResult> {
    let pool = pool(threads)?;
    let problem = placed(trial, &pool)?;
    check_design(&problem, design)?;
    let mut free = free.to_vec();
    free.sort_unstable();
    free.dedup();
    for parameter in &free {
        let value = Parameters::of(&problem.scene).array()[*parameter as usize];
        if value <= 0.0 {
            let key = match parameter {
                Parameter::Stretch => "body.stiffness.stretch",
                Parameter::Shear => "body.stiffness.shear",
                Parameter::Bend => "body.stiffness.bend",
                Parameter::Damping => "body.damping_ratio",
                Parameter::Density => "body.density",
                Parameter::Contact => "body.contact.stiffness",
            };
            return Err(NoResult::Rejected(format!(
                "{key} = {value}: a fit must start above 0; set a value, or leave {:?} out of --fit",
                parameter.name()
            )));
        }
    }
    let records = (&measured.forces, &measured.signals[..], measured.start_deviation);
    Ok(Fit::of_records(&problem, design, records, &free, &pool, known, watch))
}
