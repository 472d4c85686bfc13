//! What can be known of forces from a body's signals: by the best linear decoder around each motion, and at most.

use metasense_numerics::place::placed;
use metasense_numerics::questions;
pub use metasense_numerics::questions::Bound;
use metasense_numerics::trial::{Disturbance, Size};
use metasense_schemas::spec::TrialSpec;

use crate::run::{Failure, pool, simulable};

/// The bound of a body under the first `samples` of a trial's holdout, with its chips' noise or, in its place, with white noise of
/// this part of each channel's RMS on the initial body.
///
/// # Errors
/// If the spec stands for no trial, the design is of another length or cannot be simulated, or readings are exact.
pub fn bound(
    trial: &TrialSpec,
    design: &[f64],
    samples: usize,
    noise: Option<f64>,
    threads: usize,
) -> Result<Bound, Failure> {
    let mut problem = simulable(trial, design)?;
    if let Some(part) = noise {
        let chips = problem.disturbance.unwrap_or(Disturbance::NONE);
        problem.disturbance = Some(Disturbance { noise: Size::Relative(part), ..chips });
    }
    let pool = pool(threads)?;
    let (problem, _) = placed(&problem, &pool)?;
    questions::bound(&problem, design, samples, &pool)?.ok_or_else(|| {
        let why = "sensors.noise: must be large enough in every channel for the bound; pass --noise";
        Failure::Rejected(why.to_owned())
    })
}

#[cfg(test)]
mod tests;
