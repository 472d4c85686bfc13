//! A trial in the forms of other programs: arrays (npz), tables (csv, parquet), designs (svg, dxf), the mould (stl), the brain (c, onnx), what is built (device).

pub mod device;
pub mod dxf;
pub mod ligament;
pub mod mould;
pub mod notes;
pub mod npz;
pub mod onnx;
pub mod outline;
pub mod series;

#[cfg(test)]
pub(crate) mod tests;

pub use outline::{Mould, Outline};

use clap::ValueEnum;
use metasense_schemas::spec::TrialSpec;
use metasense_worker::replay::{Own, Replay, own, replay, replay_for_casts};
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
    let (design, weights) = (&stored.designs[body], &stored.weights[body]);
    replay(&exact(stored, body), design, weights, usize::MAX, threads).map_err(unreadable(stored))
}

/// Whom a brain is fitted to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Fit {
    /// The body as designed: the decoder of the trial
    Design,
    /// Casts of the body: one decoder for all, fitted again as in the trial's comparison
    Casts,
}

/// A body with a linear brain or a network.
///
/// # Errors
/// Likewise, or if the trial has no casts.
pub fn brain_of(stored: &Stored, body: usize, fit: Fit, threads: usize) -> Result<(Replay, Own), StoreError> {
    match fit {
        Fit::Design => {
            let replay = replay_of(stored, body, threads)?;
            let own = own(&stored.specs[body], &stored.weights[body], &replay).map_err(unreadable(stored))?;
            Ok((replay, own))
        }
        // by the trial's own integrator: to the bit what read its casts
        Fit::Casts => {
            replay_for_casts(&stored.specs[body], &stored.designs[body], threads).map_err(unreadable(stored))
        }
    }
}

/// A trial, its signals as good as exports are.
fn exact(stored: &Stored, body: usize) -> TrialSpec {
    let mut spec = stored.specs[body].clone();
    spec.solver.tolerance = spec.solver.tolerance.min(SIGNAL_TOLERANCE);
    spec
}

/// A trial that the database holds and that cannot be computed again.
pub(crate) fn unreadable(stored: &Stored) -> impl Fn(Failure) -> StoreError {
    let hash = stored.hash.clone();
    move |e| StoreError::Unreadable { hash: hash.clone(), what: "trial", message: e.to_string() }
}
