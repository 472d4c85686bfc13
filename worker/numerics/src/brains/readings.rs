//! Errors of linear decoders with several memories, for every kind of decoder of the trial. One factorisation serves many
//! memories.

use super::linear::{ScaledSamples, solve};
use crate::brain::linear::{FactoredEquations, Lags, Linear, Order, Sizes};
use crate::trial::{Decoder, PreparedTrial, RidgeChoice, Samples, Spread, Trouble, mean_error};

/// Errors of a linear decoder with one memory on a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Memory (lags).
    pub lags: Lags,
    /// λ.
    pub ridge: f64,
    /// Mean error on the training set (%).
    pub error_train: Option<f64>,
    /// Mean error on the test set (%).
    pub error_test: Option<f64>,
    /// Mean error on the held-out set (%).
    pub error_holdout: Option<f64>,
    /// Quantiles of the errors on the held-out set.
    pub spread: Option<Spread>,
}

/// Memories besides the whole sample (s): reach in both directions; look-ahead after the whole past.
const REACHES: [f64; 5] = [0.01, 0.05, 0.1, 0.2, 0.4];
const WAITS: [f64; 7] = [0.0, 0.01, 0.025, 0.05, 0.1, 0.2, 0.4];
/// Largest T · 3M: the decoder of longer samples would take minutes.
pub const READINGS_MAX: usize = 9600;

/// Whether a linear decoder of such samples takes a reasonable time.
pub fn fits(instants: usize, channels: usize) -> bool {
    instants.saturating_mul(channels) <= READINGS_MAX
}

fn reading(sets: &[ScaledSamples; 3], linear: &Linear, ridge: f64) -> Reading {
    let [train, test, holdout] = sets.each_ref().map(|set| set.errors(&linear.predict(&set.x)));
    Reading {
        lags: linear.lags,
        ridge,
        error_train: mean_error(&train),
        error_test: mean_error(&test),
        error_holdout: mean_error(&holdout),
        spread: Spread::of(&holdout),
    }
}

/// Errors for training, test and held-out samples: first with the memory of the whole sample, then with each look-ahead, then
/// with each shorter reach, all with the λ of the first. Empty if samples are too long.
///
/// # Errors
/// If no λ gives a solution.
pub(crate) fn readings(trial: &PreparedTrial, sets: &[Samples; 3]) -> Result<Vec<Reading>, Trouble> {
    let known = &sets[0];
    let sets = &sets.each_ref().map(|set| ScaledSamples::of(set, &trial.scales, trial.pool));
    let train = &sets[0];
    let Sizes { instants, channels, .. } = train.sizes;
    if !fits(instants, channels) {
        return Ok(Vec::new());
    }
    let decoder = Decoder::whole(instants, channels);
    let (whole, reach) = (decoder.lags, decoder.lags.before);
    let normal = train.normal(whole);
    let ridge = trial.ridge_for(&decoder, known, train, &normal)?;
    let read = |linear: &Linear| reading(sets, linear, ridge);
    let factor = |order| FactoredEquations::new(normal.clone(), ridge, order).map_err(|_| Trouble::Singular);
    let delta = trial.problem.scene.duration / instants as f64;
    let instants = |seconds: f64| Lags::nearest_group_end((seconds / delta).round() as usize);
    let shorter = |seconds: f64| Some(instants(seconds)).filter(|n| *n < reach);

    let mut found = Vec::new();
    {
        let delays = factor(Order::Ascending)?;
        found.push(read(&delays.linear()));
        for after in WAITS.into_iter().filter_map(shorter) {
            found.push(read(&delays.with_memory(Lags { before: reach, after })));
        }
    }
    let memories = factor(Order::Outward)?;
    for reach in REACHES.into_iter().filter_map(shorter) {
        found.push(read(&memories.with_memory(Lags { before: reach, after: reach })));
    }
    found.dedup_by_key(|reading| reading.lags);
    Ok(found)
}

/// Errors of the trial's own linear decoder; added to [`readings`], or in place of the one of equal memory.
///
/// # Errors
/// If no λ gives a solution.
pub(crate) fn own_reading(
    trial: &PreparedTrial,
    sets: &[Samples; 3],
    readings: &mut Vec<Reading>,
) -> Result<Reading, Trouble> {
    let decoder = trial.problem.decoder;
    let own = match readings.first() {
        Some(whole) if whole.lags == decoder.lags && decoder.ridge == RidgeChoice::Auto => *whole,
        _ => {
            let known = &sets[0];
            let sets = &sets.each_ref().map(|set| ScaledSamples::of(set, &trial.scales, trial.pool));
            let normal = sets[0].normal(decoder.lags);
            let ridge = trial.ridge_for(&decoder, known, &sets[0], &normal)?;
            reading(sets, &solve(normal, ridge)?.linear(), ridge)
        }
    };
    match readings.iter().position(|reading| reading.lags == own.lags) {
        None => readings.push(own),
        // the first remains that of the whole sample with the λ of cross-validation
        Some(0) => (),
        Some(i) => readings[i] = own,
    }
    Ok(own)
}
