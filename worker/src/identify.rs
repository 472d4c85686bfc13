//! Material parameters from measured records, for a trial's body.

pub use metasense_numerics::dynamics::Parameters;
pub use metasense_numerics::identify::{
    BOX, Estimate, Identified, Iteration, Offset, Parameter, Turn, UNEXPLAINED, Verdict,
};
use metasense_numerics::identify::{Settings, fit};
use metasense_schemas::spec::TrialSpec;

use crate::measured::Measured;
use crate::run::{Failure, placed, pool};

/// Most iterations, those on the beginnings of the records included.
const ITERATIONS: usize = 1000;

/// Fits `free` parameters of the trial's body, of this design, to records; the others stay at the spec's values.
///
/// Signals are compared as sensors of the trial's frame read them, without what its chips add and filter. `watch` sees
/// every turn but those that are `known` from before.
///
/// # Errors
/// If the spec stands for no trial, or a parameter does not start above 0.
pub fn identify(
    trial: &TrialSpec,
    design: &[f64],
    measured: &Measured,
    free: &[Parameter],
    threads: usize,
    known: &[Turn],
    watch: &mut dyn FnMut(&Turn),
) -> Result<Identified, Failure> {
    let pool = pool(threads)?;
    let problem = placed(trial, &pool)?;
    let scene = &problem.scene;
    let mut free = free.to_vec();
    free.sort_unstable();
    free.dedup();
    for parameter in &free {
        let value = Parameters::of(scene).array()[*parameter as usize];
        if value <= 0.0 {
            let key = match parameter {
                Parameter::Stretch => "body.stiffness.stretch",
                Parameter::Shear => "body.stiffness.shear",
                Parameter::Bend => "body.stiffness.bend",
                Parameter::Damping => "body.damping_ratio",
                Parameter::Density => "body.density",
                Parameter::Contact => "body.contact.stiffness",
            };
            return Err(Failure::Rejected(format!(
                "{key} = {value}: a fit must start above 0; set a value, or leave {:?} out of --fit",
                parameter.name()
            )));
        }
    }
    let offset = measured.start_deviation;
    let settings = Settings { free, solver: problem.solver, iterations: ITERATIONS, offset };
    Ok(fit(scene, design, &measured.forces, &measured.signals, &settings, &pool, known, watch))
}
