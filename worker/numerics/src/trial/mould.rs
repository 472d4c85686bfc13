//! A body after the loop: what questions about it, and about casts of it, are simulated with.

use super::{Counters, Samples, Trial, Trouble};
use crate::dynamics::{Forces, Solver};
use crate::variation::Cast;

/// A body of a trial, and what makes casts of it.
#[derive(Clone, Copy)]
pub(crate) struct Mould<'a> {
    pub trial: &'a Trial<'a>,
    /// α (mm).
    pub design: &'a [f64],
    /// Tuned on the body as designed.
    pub solver: &'a Solver,
}

impl Mould<'_> {
    /// Samples of the body as designed, or of a cast of it.
    ///
    /// # Errors
    /// If more of them fail than may.
    pub fn samples(
        &self,
        cast: Option<&Cast>,
        forces: Forces,
        counters: &mut Counters,
    ) -> Result<Samples, Trouble> {
        let Self { trial, design, solver } = self;
        Ok(trial.simulate_cast(cast, design, forces, solver, false, counters)?.samples)
    }
}
