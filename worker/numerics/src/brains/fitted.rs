//! A linear brain fitted to the samples of one body.
//!
//! ```text
//! x = signals / rms(signals)     f̂ = rms(f) · (b + W ∗ x)
//! ```

use super::linear::{FOLDS, Plain, solve};
use super::{Reader, Recipe};
use crate::Pool;
use crate::brain::linear::{Lags, Linear, Normal, Sizes, downhill_ridge};
use crate::stimuli::folds;
use crate::trial::{Decoder, Samples, Scales, Trial, Trouble};
use std::ops::RangeInclusive;

/// What a sample of another body counts, beside one of the body itself.
const TIMES: RangeInclusive<f64> = 1e-8..=1.0;
/// Of so many samples one part judges, of fewer each in turn.
const MANY: usize = 60;

/// A linear brain and the scales that it was fitted at.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// Its weights, for signals and forces divided by their scales.
    pub linear: Linear,
    /// λ.
    pub ridge: f64,
    /// What each signal channel is divided by (C).
    pub signal_scale: Vec<f64>,
    /// RMS of all forces (N).
    pub force_scale: f64,
    /// Mean error on the samples that it was fitted to (%); `None` where none has a force.
    pub error: Option<f64>,
}

impl Fitted {
    /// A linear brain of the trial's memory, at the trial's scales.
    ///
    /// # Errors
    /// If no λ has a solution.
    pub(crate) fn of(trial: &Trial, known: &Samples) -> Result<Self, Trouble> {
        let problem = &trial.problem;
        problem.decoder.fit(problem.seed, known, Some(trial.scales.channels.clone()), trial.pool)
    }

    /// Mean error (%) on samples; `None` where none has a force.
    pub(crate) fn error_on(&self, samples: &Samples) -> Option<f64> {
        samples.error(&self.predict(&samples.signals))
    }
}

impl Decoder {
    /// Fits the linear brain to samples, its λ by folds assigned by `seed` where it is not given. Signals are divided by
    /// `signal_scale` (C), by default their own RMS.
    ///
    /// # Errors
    /// If no λ has a solution.
    pub fn fit(
        &self,
        seed: u64,
        known: &Samples,
        signal_scale: Option<Vec<f64>>,
        pool: &Pool,
    ) -> Result<Fitted, Trouble> {
        let mut scales = Scales::of(known);
        scales.channels = signal_scale.unwrap_or(scales.channels);
        self.fitted(seed, known, scales, pool)
    }

    /// Fits it to a few samples of one body beside many of others like it, each of which counts κ times one of the few. κ is
    /// that with which parts of the few are read best from the others: 1 of a body that tells nothing new, less the more there
    /// are. λ is as given, else that of the few.
    ///
    /// # Errors
    /// If no κ has a solution.
    pub(crate) fn fit_beside(
        &self,
        seed: u64,
        few: &Samples,
        others: &Beside,
        pool: &Pool,
    ) -> Result<Fitted, Trouble> {
        let Beside { normal: others, scales } = others;
        let few = Plain::of(few, scales, pool);
        let ridge = self.ridge_of(seed, &few, None)?;
        let beside = |own: &Normal, times: f64| {
            let linear = solve(own.clone().plus(times, others), ridge)?.linear();
            Ok::<Linear, Trouble>(linear)
        };
        let (all, count) = (few.moments().normal(self.lags), few.w.len());
        // the fewer there are, the more of them have to judge
        let (parts, judging) = (FOLDS.min(count), if count < MANY { FOLDS } else { 1 });
        let dealt = folds(seed, count, parts);
        let judges: Vec<(Plain, Normal)> = (0..parts.min(judging))
            .map(|fold| {
                let out = few.select(&(0..count).filter(|&i| dealt[i] == fold).collect::<Vec<_>>());
                let kept = all.clone().plus(-1.0, &out.moments().normal(self.lags));
                (out, kept)
            })
            .collect();
        let error = |times: f64| {
            // a fold without a force judges nothing
            let of = |(out, kept): &(Plain, Normal)| {
                let said = beside(kept, times).ok()?.predict(&out.x);
                said.iter().all(|f| f.is_finite()).then(|| out.error(&said).unwrap_or_default())
            };
            judges.iter().map(of).sum::<Option<f64>>()
        };
        let times = downhill_ridge(1.0, TIMES, error).ok_or(Trouble::Singular)?;
        let linear = beside(&all, times)?;
        let error = few.error(&linear.predict(&few.x));
        Ok(Fitted {
            linear,
            ridge,
            force_scale: scales.force(),
            signal_scale: scales.channels.clone(),
            error,
        })
    }

    /// The same at given scales.
    pub(crate) fn fitted(
        &self,
        seed: u64,
        known: &Samples,
        scales: Scales,
        pool: &Pool,
    ) -> Result<Fitted, Trouble> {
        let known = Plain::of(known, &scales, pool);
        let ridge = self.ridge_of(seed, &known, None)?;
        let linear = solve(known.moments().normal(self.lags), ridge)?.linear();
        let error = known.error(&linear.predict(&known.x));
        Ok(Fitted { linear, ridge, force_scale: scales.force(), signal_scale: scales.channels, error })
    }
}

/// Samples of many bodies alike, for [`Decoder::fit_beside`].
#[derive(Debug, Clone)]
pub(crate) struct Beside {
    normal: Normal,
    scales: Scales,
}

impl Beside {
    /// Of these samples, at these scales, for a memory.
    pub(crate) fn of(samples: &Samples, scales: &Scales, lags: Lags, pool: &Pool) -> Self {
        let normal = Plain::of(samples, scales, pool).moments().normal(lags);
        Self { normal, scales: scales.clone() }
    }
}

impl Fitted {
    /// T, C, K.
    pub fn sizes(&self) -> Sizes {
        self.linear.sizes
    }

    /// f̂ (N, T, K) (N) of signals (N, T, C).
    ///
    /// # Panics
    /// If the length is not that of whole samples.
    pub fn predict(&self, signals: &[f64]) -> Vec<f64> {
        let x: Vec<f64> = self.scaled(signals).collect();
        self.physical(self.linear.predict(&x))
    }

    /// Transpose of [`Fitted::predict`] but for b: a cotangent on f̂ (N, T, K) as one on the signals.
    ///
    /// # Panics
    /// Likewise.
    pub fn predict_vjp(&self, cotangent: &[f64]) -> Vec<f64> {
        self.physical(self.scaled(&self.linear.predict_vjp(cotangent)).collect())
    }

    /// W (K, lags, C) (N) and b (K) (N): f̂ = b + Σ W · signals / `signal_scale`.
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

/// A linear brain that reads one body.
pub(super) struct LinearReader<'a> {
    recipe: Recipe,
    known: &'a Samples,
    scales: Scales,
    pool: &'a Pool,
    fitted: Option<Fitted>,
}

impl<'a> LinearReader<'a> {
    pub(super) fn new(recipe: Recipe, known: &'a Samples, [scales, _]: [Scales; 2], pool: &'a Pool) -> Self {
        Self { recipe, known, scales, pool, fitted: None }
    }

    fn fitted(&self) -> &Fitted {
        self.fitted.as_ref().expect("it has been fitted")
    }
}

impl Reader for LinearReader<'_> {
    fn fit(
        &mut self,
        _: u64,
        _: usize,
        _: &Samples,
        _: &mut dyn FnMut(usize) -> bool,
    ) -> Option<Result<(), Trouble>> {
        let fitted = self.recipe.decoder.fitted(self.recipe.seed, self.known, self.scales.clone(), self.pool);
        Some(fitted.map(|fitted| self.fitted = Some(fitted)))
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

    fn error(&mut self, samples: &Samples) -> Option<f64> {
        let samples = Plain::of(samples, &self.scales, self.pool);
        samples.error(&self.fitted().linear.predict(&samples.x))
    }
}
