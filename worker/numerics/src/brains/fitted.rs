//! A linear decoder fitted to the samples of one body.
//!
//! ```text
//! x = signals / rms(signals)     f̂ = rms(f) · (b + W ∗ x)
//! ```

use super::linear::{ScaledSamples, solve};
use super::ridge::{self, FoldSplit};
use super::{FittedDecoder, Recipe};
use crate::Pool;
use crate::brain::linear::{Linear, Normal, Sizes};
use crate::trial::{Decoder, PreparedTrial, Result, RidgeChoice, Samples, Scales};

/// Exponents of κ = 10⁰, …, 10⁻⁸.
const SHARES: std::ops::RangeInclusive<i32> = 0..=8;

/// A linear decoder with its scales.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// Weights, for signals and forces divided by their scales.
    pub linear: Linear,
    /// λ.
    pub ridge: f64,
    /// Divisor per signal channel (C).
    pub signal_scale: Vec<f64>,
    /// RMS of all forces (N).
    pub force_scale: f64,
    /// Mean error on the training samples (%); `None` if none has a force.
    pub error: Option<f64>,
}

impl Fitted {
    /// Fits a linear decoder with the trial's memory and scales.
    ///
    /// # Errors
    /// If no λ gives a solution.
    pub(crate) fn of(trial: &PreparedTrial, known: &Samples) -> Result<Self> {
        let problem = &trial.problem;
        problem.decoder.fit(problem.seed, known, Some(trial.scales.channels.clone()), trial.pool)
    }

    fn new(linear: Linear, ridge: f64, known: &ScaledSamples, scales: &Scales) -> Self {
        let (error, signal_scale) = (known.error(&linear.predict(&known.x)), scales.channels.clone());
        Self { linear, ridge, signal_scale, force_scale: scales.force(), error }
    }

    /// Error (%) of each sample.
    pub(crate) fn errors_on(&self, samples: &Samples) -> Vec<Option<f64>> {
        samples.errors(&self.predict(&samples.signals))
    }

    /// T, C, K.
    pub fn sizes(&self) -> Sizes {
        self.linear.sizes
    }

    /// f̂ (N, T, K) (N) from signals (N, T, C).
    ///
    /// # Panics
    /// If the length is not a whole number of samples.
    pub fn predict(&self, signals: &[f64]) -> Vec<f64> {
        let x: Vec<f64> = self.scaled(signals).collect();
        self.physical(self.linear.predict(&x))
    }

    /// Transpose of [`Fitted::predict`] without b: maps a cotangent on f̂ (N, T, K) to the signals.
    ///
    /// # Panics
    /// As [`Fitted::predict`].
    pub fn predict_vjp(&self, cotangent: &[f64]) -> Vec<f64> {
        self.physical(self.scaled(&self.linear.predict_vjp(cotangent)).collect())
    }

    /// W (K, lags, C) and b (K), both in N: f̂ = b + Σ W · signals / `signal_scale`.
    pub fn weights(&self) -> [Vec<f64>; 2] {
        [&self.linear.w, &self.linear.b].map(|w| self.physical(w.clone()))
    }

    fn scaled(&self, signals: &[f64]) -> impl Iterator<Item = f64> {
        signals.iter().zip(self.signal_scale.iter().cycle()).map(|(a, s)| a / s)
    }

    fn physical(&self, mut values: Vec<f64>) -> Vec<f64> {
        values.iter_mut().for_each(|y| *y *= self.force_scale);
        values
    }
}

impl Decoder {
    /// Fits a linear decoder. Unless λ is given, cross-validation over folds from `seed` selects it. Signals are divided by
    /// `signal_scale` (C), by default their RMS.
    ///
    /// # Errors
    /// If no λ gives a solution.
    pub fn fit(
        &self,
        seed: u64,
        known: &Samples,
        signal_scale: Option<Vec<f64>>,
        pool: &Pool,
    ) -> Result<Fitted> {
        let mut scales = Scales::of(known);
        scales.channels = signal_scale.unwrap_or(scales.channels);
        self.fitted(seed, known, scales, pool)
    }

    /// As [`Decoder::fit`], with given scales.
    pub(crate) fn fitted(&self, seed: u64, known: &Samples, scales: Scales, pool: &Pool) -> Result<Fitted> {
        let known = ScaledSamples::of(known, &scales, pool);
        let all = known.normal(self.lags);
        let ridge = self.ridge_of(seed, &known, &all)?;
        Ok(Fitted::new(solve(all, ridge)?.linear(), ridge, &known, &scales))
    }
}

/// Samples of several casts: fits a decoder for all casts, and helps to fit one for a further cast.
#[derive(Debug, Clone)]
pub(crate) struct Pooled {
    normal: Normal,
    scales: Scales,
    /// The decoder for all casts.
    pub(crate) fitted: Fitted,
}

impl Pooled {
    /// Pools samples ordered by cast, equally many per cast. λ is given, or chosen by leaving out whole casts.
    ///
    /// # Errors
    /// If no λ gives a solution.
    pub(crate) fn new(trial: &PreparedTrial, samples: &Samples, casts: usize) -> Result<Self> {
        let (decoder, scales) = (trial.problem.decoder, trial.scales.clone());
        let known = ScaledSamples::of(samples, &scales, trial.pool);
        let normal = known.normal(decoder.lags);
        let (dealt, each) = (ridge::assign_folds(trial.problem.seed, casts), samples.count() / casts);
        let dealt: Vec<usize> = (0..samples.count()).map(|i| dealt[i / each]).collect();
        let ridge = match decoder.ridge {
            RidgeChoice::Given(ridge) => ridge,
            RidgeChoice::Auto => ridge::ridge_of(&known, &normal, &dealt)?,
        };
        let fitted = Fitted::new(solve(normal.clone(), ridge)?.linear(), ridge, &known, &scales);
        Ok(Self { normal, scales, fitted })
    }

    /// Fits a decoder to the samples of a further cast; each pooled sample has the weight κ relative to them. λ is that of the
    /// decoder for all casts. Cross-validation over the new samples selects κ; κ = 1 weighs all casts alike.
    ///
    /// # Errors
    /// If no κ gives a solution.
    pub(crate) fn calibrated(&self, seed: u64, samples: &Samples, pool: &Pool) -> Result<(Fitted, f64)> {
        let own = ScaledSamples::of(samples, &self.scales, pool);
        let (normal, ridge) = (own.normal(self.normal.lags()), self.fitted.ridge);
        let add_pooled = |own: &Normal, share: f64| own.clone().plus(share, &self.normal);
        let share = match own.w.len() {
            0 | 1 => 1.0,
            count => {
                let shares = SHARES.map(|decade| 10_f64.powi(-decade));
                let (dealt, prefilter) = (ridge::assign_folds(seed, count), count >= ridge::FEW);
                let folds = ridge::split_folds(&own, &normal, &dealt);
                let errors = |part: &FoldSplit, share| part.errors(add_pooled(&part.others, share), ridge);
                ridge::least(&ridge::errors_by_value(shares, prefilter, folds, errors))?
            }
        };
        let linear = solve(add_pooled(&normal, share), ridge)?.linear();
        Ok((Fitted::new(linear, ridge, &own, &self.scales), share))
    }
}

/// Fits a linear decoder to one body.
pub(super) struct LinearDecoder<'a> {
    recipe: Recipe,
    known: &'a Samples,
    scales: Scales,
    pool: &'a Pool,
    fitted: Option<Fitted>,
}

impl<'a> LinearDecoder<'a> {
    pub(super) fn new(recipe: Recipe, known: &'a Samples, [scales, _]: [Scales; 2], pool: &'a Pool) -> Self {
        Self { recipe, known, scales, pool, fitted: None }
    }

    fn fitted(&self) -> &Fitted {
        self.fitted.as_ref().expect("it has been fitted")
    }
}

impl FittedDecoder for LinearDecoder<'_> {
    fn fit(&mut self, _: u64, _: usize, _: &Samples, _: &mut dyn FnMut(usize) -> bool) -> Option<Result<()>> {
        let fitted = self.recipe.decoder.fitted(self.recipe.seed, self.known, self.scales.clone(), self.pool);
        Some(fitted.map(|fitted| self.fitted = Some(fitted)))
    }

    fn ridge(&self) -> Option<f64> {
        self.fitted.as_ref().map(|fitted| fitted.ridge)
    }

    fn predict(&mut self, signals: &[f64]) -> Vec<f64> {
        self.fitted().predict(signals)
    }

    fn predict_known(&mut self) -> Vec<f64> {
        self.fitted().predict(&self.known.signals)
    }

    fn error_known(&mut self) -> Option<f64> {
        self.fitted().error
    }

    fn errors(&mut self, samples: &Samples) -> Vec<Option<f64>> {
        let samples = ScaledSamples::of(samples, &self.scales, self.pool);
        samples.errors(&self.fitted().linear.predict(&samples.x))
    }
}
