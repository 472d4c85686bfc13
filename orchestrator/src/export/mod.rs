//! A trial in the forms of other programs: arrays (npz), tables (csv, parquet), designs (svg, dxf), the mould (stl).

pub mod dxf;
pub mod mould;
pub mod npz;
pub mod outline;
pub mod series;

#[cfg(test)]
pub(crate) mod tests;

pub use outline::{Mould, Outline};

use metasense_worker::replay::{Replay, replay};
use metasense_worker::run::Failure;

use crate::store::{StoreError, Stored};

/// Exported signals are at least as good as this.
const SIGNAL_TOLERANCE: f64 = 1e-4;

/// The initial and the optimised body of a trial once more under all its samples, signals to 1e-4 or better.
///
/// # Errors
/// If they cannot be simulated again.
pub fn replays(stored: &Stored, threads: usize) -> Result<[Replay; 2], StoreError> {
    let again = |b: usize| {
        let mut spec = stored.specs[b].clone();
        spec.solver.tolerance = spec.solver.tolerance.min(SIGNAL_TOLERANCE);
        replay(&spec, &stored.designs[b], &stored.weights[b], threads).map_err(unreadable(stored))
    };
    Ok([again(0)?, again(1)?])
}

/// A trial that the database holds and that cannot be computed again.
pub(crate) fn unreadable(stored: &Stored) -> impl Fn(Failure) -> StoreError {
    let hash = stored.hash.clone();
    move |e| StoreError::Unreadable { hash: hash.clone(), what: "trial", message: e.to_string() }
}
