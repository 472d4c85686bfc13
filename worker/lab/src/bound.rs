//! Bounds on the error of a body's decoders: of the best linear decoder around each motion, and of any decoder.

use metasense_numerics::place::placed;
use metasense_numerics::trial::{ChipErrors, Size};
use metasense_schemas::spec::TrialSpec;
use metasense_worker::run::{NoResult, pool};

use crate::prepare::simulable;
use crate::questions;
pub use crate::questions::Bound;

/// The bounds of a body for the first `samples` held-out samples of a trial. The chips have their own noise, or white noise of
/// `noise` times each channel's RMS on the initial body.
///
/// # Errors
/// If the spec is invalid, the design has the wrong length or cannot be simulated, or readings have no noise.
pub fn bound(
    trial: &TrialSpec,
    design: &[f64],
    samples: usize,
    noise: Option<f64>,
    threads: usize,
) -> Result<Bound, NoResult> {
    let mut problem = simulable(trial, design)?;
    if let Some(part) = noise {
        let chips = problem.disturbance.unwrap_or(ChipErrors::NONE);
        problem.disturbance = Some(ChipErrors { noise: Size::Relative(part), ..chips });
    }
    let pool = pool(threads)?;
    let (problem, _) = placed(&problem, &pool)?;
    questions::bound(&problem, design, samples, &pool)?.ok_or_else(|| {
        let why = "sensors.noise: must be large enough in every channel for the bound; pass --noise";
        NoResult::Rejected(why.to_owned())
    })
}

#[cfg(test)]
mod tests;
