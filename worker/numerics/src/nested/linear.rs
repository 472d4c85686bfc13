//! The linear brain at the scales of a trial: its samples, its ridge, and what it makes of a body.
//!
//! ```text
//! x = A / rms(A₀)     y = f / rms(f)     w_i = 1/Σy²     λ: 10^−j, by a fifth of the training set
//! ```

use super::report::Trouble;
use super::setting::{Scales, Setting, mean_error};
use super::unseen::folds;
use crate::Heartbeat;
use crate::brain::linear::{Fit, Lags, Linear, Moments, Order, Sizes, downhill_ridge};
use crate::brain::{Data, Shape, prediction_error};
use crate::dynamics::Forces;
use std::ops::RangeInclusive;

/// What a linear brain is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decoder {
    /// Its memory.
    pub lags: Lags,
    /// λ.
    pub ridge: Ridge,
}

/// How λ is found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Ridge {
    /// By folds of the training samples.
    Auto,
    /// Given.
    Given(f64),
}

impl Decoder {
    /// Of the whole sample, both ways, or as much of it as can be solved for: what every body is read by.
    pub fn whole(instants: usize, channels: usize) -> Self {
        let both = |reach| Lags { before: reach, after: reach };
        let solvable = |lags: &Lags| lags.groups().len() * channels <= UNKNOWNS_MAX;
        let lags = (0..instants).rev().map(both).find(solvable).unwrap_or(both(0));
        Self { lags, ridge: Ridge::Auto }
    }
}

/// Parts of the training set; one of them judges a ridge that the others are fitted with.
const FOLDS: usize = 5;
/// Where the search for λ begins, and how far it goes.
const FIRST_RIDGE: f64 = 1e-6;
pub(super) const RIDGES: RangeInclusive<f64> = 1e-14..=1e2;

/// Samples as a linear brain takes them.
#[derive(Debug, Clone)]
pub(super) struct Plain {
    pub(super) sizes: Sizes,
    /// x (N, T, 3M).
    pub(super) x: Vec<f64>,
    /// y (N, T, K).
    pub(super) y: Vec<f64>,
    /// w (N); 0 without force.
    pub(super) w: Vec<f64>,
    /// Counts what is done with them.
    pub(super) heartbeat: Heartbeat,
}

impl Plain {
    /// From x (N, T, 3M) and forces (N, T, K) in N, `scale` of which count as 1.
    pub(super) fn new(sizes: Sizes, x: Vec<f64>, forces: &[f64], scale: f64, heartbeat: &Heartbeat) -> Self {
        let y: Vec<f64> = forces.iter().map(|f| f / scale).collect();
        let power = |sample: &[f64]| sample.iter().map(|f| f * f).sum::<f64>();
        let weight = |power: f64| if power > 0.0 { power.recip() } else { 0.0 };
        let w = y.chunks_exact(sizes.instants * sizes.outputs).map(|sample| weight(power(sample))).collect();
        Self { sizes, x, y, w, heartbeat: heartbeat.clone() }
    }

    /// Their moments.
    pub(super) fn moments(&self) -> Moments {
        let mut moments = Moments::new(self.sizes, &self.heartbeat);
        moments.add(&self.x, &self.y, &self.w);
        moments
    }

    /// These samples, in this order.
    pub(super) fn select(&self, samples: &[usize]) -> Self {
        let pick = |values: &[f64]| -> Vec<f64> {
            let one = values.len() / self.w.len();
            samples.iter().flat_map(|&i| &values[i * one..(i + 1) * one]).copied().collect()
        };
        let [x, y, w] = [&self.x, &self.y, &self.w].map(|values| pick(values));
        Self { sizes: self.sizes, x, y, w, heartbeat: self.heartbeat.clone() }
    }

    /// How many have no force.
    pub(super) fn zero_samples(&self) -> u32 {
        self.w.iter().filter(|w| **w == 0.0).count() as u32
    }

    /// Error of each sample (%) by these answers (N, T, K).
    pub(super) fn errors(&self, predicted: &[f64]) -> Vec<Option<f64>> {
        prediction_error(&self.y, predicted, self.sizes.outputs, self.sizes.instants)
    }

    /// Their mean.
    pub(super) fn error(&self, predicted: &[f64]) -> Option<f64> {
        mean_error(&self.errors(predicted))
    }

    /// 2w (ŷ − y)/n of the n samples with force: the derivative of the mean error, as a part of 1, in the answers.
    pub(super) fn residual(&self, predicted: &[f64]) -> Vec<f64> {
        let total = (self.w.len() - self.zero_samples() as usize) as f64;
        let one = self.sizes.instants * self.sizes.outputs;
        let mut residual = Vec::with_capacity(predicted.len());
        for ((p, y), w) in predicted.chunks_exact(one).zip(self.y.chunks_exact(one)).zip(&self.w) {
            residual.extend(p.iter().zip(y).map(|(p, y)| 2.0 * w / total * (p - y)));
        }
        residual
    }
}

/// RMS of all panels' forces (N), of each one's mean and standard deviation.
pub(super) fn force_scale(mean: &[f64], deviation: &[f64]) -> f64 {
    let squares = mean.iter().zip(deviation).map(|(m, d)| m * m + d * d);
    (squares.sum::<f64>() / mean.len() as f64).sqrt()
}

/// The weights of a fit, or its trouble.
pub(super) fn fit(moments: &Moments, lags: Lags, ridge: f64) -> Result<Fit, Trouble> {
    Fit::new(moments, lags, ridge, Order::Ascending).map_err(|_| Trouble::Singular)
}

/// Linear brains for a network that sees their answers: of what each was fitted on it never sees one's.
pub(super) struct Stack {
    /// For samples that trained none.
    all: Linear,
    /// The fold of each training sample, and of each fold the brain that was fitted on the others.
    dealt: Vec<usize>,
    parts: Vec<Linear>,
}

impl Stack {
    /// Fitted on these training samples.
    ///
    /// # Errors
    /// If one has no solution.
    pub(super) fn new(decoder: &Decoder, seed: u64, train: &Plain) -> Result<Self, Trouble> {
        let ridge = decoder.ridge_of(seed, train, None)?;
        let folds_of = FOLDS.min(train.w.len());
        let (moments, dealt) = (train.moments(), folds(seed, train.w.len(), folds_of));
        let part = |fold: usize| {
            let own: Vec<usize> = (0..dealt.len()).filter(|&i| dealt[i] == fold).collect();
            Ok(fit(&moments.clone().without(&train.select(&own).moments()), decoder.lags, ridge)?.linear())
        };
        let parts = (0..folds_of).map(part).collect::<Result<_, Trouble>>()?;
        Ok(Self { all: fit(&moments, decoder.lags, ridge)?.linear(), dealt, parts })
    }

    /// Answers (N, T, K) for samples that are not the training set's.
    pub(super) fn answers(&self, x: &[f64]) -> Vec<f64> {
        self.all.predict(x)
    }

    /// Answers for the training set's, each by a brain that has not seen it.
    pub(super) fn cross_fitted(&self, x: &[f64]) -> Vec<f64> {
        let one = x.len() / self.dealt.len();
        let Sizes { instants, outputs, .. } = self.all.sizes;
        let mut answers = vec![0.0; self.dealt.len() * instants * outputs];
        for (fold, part) in self.parts.iter().enumerate() {
            let own = || (0..self.dealt.len()).filter(|&i| self.dealt[i] == fold);
            let seen: Vec<f64> = own().flat_map(|i| &x[i * one..(i + 1) * one]).copied().collect();
            let size = instants * outputs;
            for (said, i) in part.predict(&seen).chunks_exact(size).zip(own()) {
                answers[i * size..(i + 1) * size].copy_from_slice(said);
            }
        }
        answers
    }
}

impl Scales {
    /// Samples as a stacked network takes them: signals (N, T, 3M) beside a linear brain's answers (N, T, K), as of forces.
    pub(super) fn stacked(&self, shape: Shape, signals: &[f64], plain: &Plain, answers: &[f64]) -> Data<f32> {
        let force = force_scale(&self.mean, &self.deviation);
        let physical =
            |y: &[f64]| -> Vec<f32> { self.targets(&y.iter().map(|y| force * y).collect::<Vec<f64>>()) };
        let Sizes { channels, outputs, .. } = plain.sizes;
        let (signals, said) = (self.inputs::<f32>(signals), physical(answers));
        let mut x = Vec::with_capacity(signals.len() + said.len());
        for (signals, said) in signals.chunks_exact(channels).zip(said.chunks_exact(outputs)) {
            x.extend_from_slice(signals);
            x.extend_from_slice(said);
        }
        Data::new(shape, &x, &physical(&plain.y))
    }
}

impl Setting<'_> {
    /// Signals (N, T, 3M) under `forces` as a linear brain takes them.
    pub(super) fn plain(&self, signals: &[f64], forces: &Forces) -> Plain {
        let shape = self.problem.shape();
        let sizes = Sizes { instants: shape.instants, channels: shape.inputs, outputs: shape.outputs };
        let scale = force_scale(&self.scales.mean, &self.scales.deviation);
        let (x, forces) = (self.scales.inputs(signals), self.problem.targets(forces));
        Plain::new(sizes, x, &forces, scale, self.pool.heartbeat())
    }

    /// λ of the trial's own linear brain for these training samples.
    ///
    /// # Errors
    /// If none has a solution.
    pub(super) fn ridge(&self, train: &Plain, last: Option<f64>) -> Result<f64, Trouble> {
        self.problem.decoder.ridge_of(self.problem.seed, train, last)
    }
}

impl Decoder {
    /// λ for these training samples: as given, or that with which four fifths of them read the last best, looked for
    /// from `last` on.
    ///
    /// # Errors
    /// If no λ has a solution.
    pub(super) fn ridge_of(&self, seed: u64, train: &Plain, last: Option<f64>) -> Result<f64, Trouble> {
        if let Ridge::Given(ridge) = self.ridge {
            return Ok(ridge);
        }
        let lags = self.lags;
        let dealt = folds(seed, train.w.len(), FOLDS.min(train.w.len()));
        let kept: Vec<usize> = (0..dealt.len()).filter(|&i| dealt[i] != 0).collect();
        let judges: Vec<usize> = (0..dealt.len()).filter(|&i| dealt[i] == 0).collect();
        let (moments, judges) = (train.select(&kept).moments(), train.select(&judges));
        // too few samples to judge by
        if kept.is_empty() || judges.w.iter().all(|w| *w == 0.0) {
            return Ok(last.unwrap_or(FIRST_RIDGE));
        }
        let error = |ridge| {
            let linear = fit(&moments, lags, ridge).ok()?.linear();
            judges.error(&linear.predict(&judges.x))
        };
        downhill_ridge(last.unwrap_or(FIRST_RIDGE), RIDGES, error).ok_or(Trouble::Singular)
    }
}

/// What a linear brain of one memory makes of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Its memory.
    pub lags: Lags,
    /// λ.
    pub ridge: f64,
    /// Mean prediction error on the training set (%).
    pub error_train: Option<f64>,
    /// On the test set (%).
    pub error_test: Option<f64>,
    /// On the holdout (%).
    pub error_holdout: Option<f64>,
}

/// Reaches both ways, and waits after the whole past, at which a body is read beside the whole sample (s).
const REACHES: [f64; 5] = [0.01, 0.05, 0.1, 0.2, 0.4];
const WAITS: [f64; 7] = [0.0, 0.01, 0.025, 0.05, 0.1, 0.2, 0.4];
/// Unknowns of the longest memory that a body is read with: 0.7 GB and some 5 s a factor.
const UNKNOWNS_MAX: usize = 9600;
/// Most readings of a sample, T · 3M: the moments are this squared, 0.7 GB. Most of them times T · K: as much again.
pub const READINGS_MAX: usize = 9600;
const CROSS_MAX: usize = 100_000_000;

/// Whether a linear brain of such samples fits into memory.
pub fn fits(instants: usize, channels: usize, outputs: usize) -> bool {
    let readings = instants.saturating_mul(channels);
    readings <= READINGS_MAX && readings.saturating_mul(instants).saturating_mul(outputs) <= CROSS_MAX
}

/// The reading of a body by one memory, from its training, test and holdout samples.
///
/// # Errors
/// If λ has no solution.
pub(super) fn read(sets: &[Plain; 3], lags: Lags, ridge: f64) -> Result<Reading, Trouble> {
    Ok(reading(sets, &fit(&sets[0].moments(), lags, ridge)?.linear(), ridge))
}

fn reading(sets: &[Plain; 3], linear: &Linear, ridge: f64) -> Reading {
    let error = |set: &Plain| set.error(&linear.predict(&set.x));
    let [error_train, error_test, error_holdout] = [0, 1, 2].map(|set| error(&sets[set]));
    Reading { lags: linear.lags, ridge, error_train, error_test, error_holdout }
}

/// Readings of a body by the whole sample, first, then by shorter memories and by waits after the whole past, all with
/// the λ of the first; none of samples that are too long.
///
/// # Errors
/// If no λ has a solution.
pub(super) fn readings(setting: &Setting, sets: &[Plain; 3]) -> Result<Vec<Reading>, Trouble> {
    let train = &sets[0];
    let Sizes { instants, channels, outputs } = train.sizes;
    if !fits(instants, channels, outputs) {
        return Ok(Vec::new());
    }
    let decoder = Decoder::whole(instants, channels);
    let (whole, reach) = (decoder.lags, decoder.lags.before);
    let ridge = decoder.ridge_of(setting.problem.seed, train, None)?;
    let moments = train.moments();
    let read = |linear: &Linear| reading(sets, linear, ridge);
    let factor = |order| Fit::new(&moments, whole, ridge, order).map_err(|_| Trouble::Singular);
    let delta = setting.problem.scene.duration / instants as f64;
    let instants = |seconds: f64| Lags::whole_groups((seconds / delta).round() as usize);
    let shorter = |seconds: f64| Some(instants(seconds)).filter(|n| *n < reach);

    let mut found = Vec::new();
    {
        let delays = factor(Order::Ascending)?;
        found.push(read(&delays.linear()));
        for after in WAITS.into_iter().filter_map(shorter) {
            found.push(read(&delays.shorter(Lags { before: reach, after })));
        }
    }
    let memories = factor(Order::Outward)?;
    for reach in REACHES.into_iter().filter_map(shorter) {
        found.push(read(&memories.shorter(Lags { before: reach, after: reach })));
    }
    found.dedup_by_key(|reading| reading.lags);
    Ok(found)
}
