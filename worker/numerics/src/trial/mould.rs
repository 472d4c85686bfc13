//! A design and its solver, from which the body and its casts are simulated after training.

use super::{Counters, PreparedTrial, Result, Samples};
use crate::dynamics::{Forces, IntegratorSettings};
use crate::variation::Cast;

/// A design of a trial, with what its simulation needs.
#[derive(Clone, Copy)]
pub(crate) struct DesignWithSolver<'a> {
    pub trial: &'a PreparedTrial<'a>,
    /// α (mm).
    pub design: &'a [f64],
    /// Tuned by the pilot of the body as designed.
    pub solver: &'a IntegratorSettings,
}

impl DesignWithSolver<'_> {
    /// Simulates the body as designed, or a cast of it.
    ///
    /// # Errors
    /// If too many samples fail.
    pub fn samples(&self, cast: Option<&Cast>, forces: Forces, counters: &mut Counters) -> Result<Samples> {
        let Self { trial, design, solver } = self;
        Ok(trial.simulate_cast(cast, design, forces, solver, false, counters)?.samples)
    }
}
