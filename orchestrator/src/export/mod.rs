//! Exports of a trial: arrays (npz), tables (csv, parquet), designs (svg, dxf), mould (stl), decoder (c, onnx), files of a device.

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
use metasense_lab::replay::{Replay, ReplayDecoder, fit_decoder, replay, replay_for_casts};
use metasense_worker::run::NoResult;

use crate::reader::StoredTrial;
use crate::store::StoreError;

/// Limits of the bands about a body's predictions (N, T, K) (N), by name: `forces_low` and `forces_high` for single instants,
/// `sample_low` and `sample_high` for whole samples. An inverse decoder has only the former.
pub(crate) fn bands(stored: &StoredTrial, replay: &Replay, body: usize) -> Vec<(String, Vec<f64>)> {
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

/// Greatest tolerance of exported signals.
const SIGNAL_TOLERANCE: f64 = 1e-4;

/// Simulates both bodies of a trial again under all its samples; signals are accurate to 1e-4 or better.
pub fn replays(stored: &StoredTrial, threads: usize) -> Result<[Replay; 2], StoreError> {
    Ok([replay_of(stored, 0, threads)?, replay_of(stored, 1, threads)?])
}

/// Simulates one body again, with the tolerance of exports.
pub fn replay_of(stored: &StoredTrial, body: usize, threads: usize) -> Result<Replay, StoreError> {
    let (design, weights) = (&stored.designs[body], &stored.weights[body]);
    let mut spec = stored.specs[body].clone();
    spec.solver.tolerance = spec.solver.tolerance.min(SIGNAL_TOLERANCE);
    replay(&spec, design, weights, usize::MAX, threads).map_err(unreadable(stored))
}

/// Data to which a decoder is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FitData {
    /// The body as designed: the decoder of the trial
    Design,
    /// Casts of the body: one decoder for all, fitted again as in the trial's comparison
    Casts,
}

/// A replay of a body, and its linear decoder or network.
///
/// # Errors
/// If the body cannot be simulated again, or if the trial has no casts.
pub fn brain_of(
    stored: &StoredTrial,
    body: usize,
    fit: FitData,
    threads: usize,
) -> Result<(Replay, ReplayDecoder), StoreError> {
    match fit {
        FitData::Design => {
            let replay = replay_of(stored, body, threads)?;
            let own = fit_decoder(&stored.specs[body], &stored.weights[body], &replay)
                .map_err(unreadable(stored))?;
            Ok((replay, own))
        }
        // with the trial's own integrator: bit-identical to the decoder of its casts
        FitData::Casts => {
            replay_for_casts(&stored.specs[body], &stored.designs[body], threads).map_err(unreadable(stored))
        }
    }
}

/// The error for a stored trial that cannot be computed again.
pub(crate) fn unreadable(stored: &StoredTrial) -> impl Fn(NoResult) -> StoreError {
    let hash = stored.hash.clone();
    move |e| StoreError::unreadable(&hash, "trial", e)
}
