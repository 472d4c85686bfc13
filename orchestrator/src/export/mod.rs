//! A trial in the forms of other programs: arrays (npz), tables (csv, parquet), designs (svg, dxf), the mould (stl), the brain (c).

pub mod device;
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

/// Ends of a body's bands about its brain's predictions (N, T, K) (N), by their names: at each instant by itself, `forces_low` and
/// `forces_high`, and over a whole sample, `sample_low` and `sample_high`. Of an inverse brain the former alone.
pub(crate) fn bands(stored: &Stored, replay: &Replay, body: usize) -> Vec<(String, Vec<f64>)> {
    let [instant, sample] = &stored.bands[body];
    let instant = if replay.half_widths.is_empty() { instant } else { &replay.half_widths };
    let mut found = Vec::new();
    for (of, half_width) in [("forces", instant), ("sample", sample)] {
        for (end, sign) in [("low", -1.0), ("high", 1.0)] {
            let half_width = half_width.iter().cycle().map(|h| sign * h);
            let values: Vec<f64> = replay.predictions.iter().zip(half_width).map(|(f, h)| f + h).collect();
            if !values.is_empty() {
                found.push((format!("{of}_{end}"), values));
            }
        }
    }
    found
}

/// Exported signals are at least as good as this.
const SIGNAL_TOLERANCE: f64 = 1e-4;

/// The initial and the optimised body of a trial once more under all its samples, signals to 1e-4 or better.
///
/// # Errors
/// If they cannot be simulated again.
pub fn replays(stored: &Stored, threads: usize) -> Result<[Replay; 2], StoreError> {
    Ok([replay_of(stored, 0, threads)?, replay_of(stored, 1, threads)?])
}

/// One of them.
///
/// # Errors
/// Likewise.
pub fn replay_of(stored: &Stored, body: usize, threads: usize) -> Result<Replay, StoreError> {
    let mut spec = stored.specs[body].clone();
    spec.solver.tolerance = spec.solver.tolerance.min(SIGNAL_TOLERANCE);
    let (design, weights) = (&stored.designs[body], &stored.weights[body]);
    replay(&spec, design, weights, usize::MAX, threads).map_err(unreadable(stored))
}

/// A trial that the database holds and that cannot be computed again.
pub(crate) fn unreadable(stored: &Stored) -> impl Fn(Failure) -> StoreError {
    let hash = stored.hash.clone();
    move |e| StoreError::Unreadable { hash: hash.clone(), what: "trial", message: e.to_string() }
}
