//! Error of a linear decoder on samples to which it was not fitted, with its gradients.
//!
//! ```text
//! L(x, λ) = Σ_f Σ_{i∈f} v_i e_i(W_f)     W_f: fitted to the samples outside fold f; v_i: weight of sample i
//! dL/dx   = ∂L/∂x − ⟨z_f, ∂²E_f/∂W∂x⟩    dL/d ln λ = −2λ ⟨z_f, W_f⟩
//! H_f z_f = ∂L/∂W_f                      E_f: objective of the fit, H_f its second derivative
//! ```
//! The fits also contain samples of earlier bodies. dL/dx treats them as if they moved like the newest body's: otherwise they
//! would pull the design back to these bodies.

use super::linear::{ScaledSamples, solve, through_weights};
use super::ridge;
use crate::brain::linear::{Linear, Moments, Normal};
use crate::stimuli::folds;
use crate::trial::{Trouble, mean_error};

/// Step of ln λ per unit of −d ln L/d ln λ: about the inverse of its second derivative near the minimum, measured as 0.1 … 0.2.
const RIDGE_RATE: f64 = 5.0;

/// Number of folds; with more unknowns than `MANY`, whose factors take most of a step's time.
const FOLDS: [usize; 2] = [5, 3];
const MANY: usize = 1500;

/// Fold of each sample for a decoder with this number of unknowns.
pub(super) fn assign_folds(seed: u64, samples: usize, unknowns: usize) -> Vec<usize> {
    folds(seed, samples, FOLDS[usize::from(unknowns > MANY)].min(samples))
}

/// The decoders of all folds of a body's samples, which come from one or more casts.
pub(super) struct CrossValidation {
    pub(super) samples: ScaledSamples,
    casts: usize,
    folds: Vec<Fold>,
    ridge: f64,
    /// Error (%) of each sample.
    errors: Vec<Option<f64>>,
}

/// A decoder that was fitted without the samples of a fold.
struct Fold {
    own: Vec<usize>,
    others: Vec<usize>,
    linear: Linear,
    /// Estimates of the fold's own samples.
    estimates: Vec<f64>,
    /// z_f of the mean error of each cast.
    sensitivities: Vec<Linear>,
}

impl CrossValidation {
    /// Fits a decoder per fold; `folds` has the fold of each sample, `all` the normal equations of these and of earlier samples.
    /// Equally many samples of each cast follow each other. `moments` is memory.
    ///
    /// # Errors
    /// If a fold's decoder has no solution.
    pub(super) fn new(
        samples: ScaledSamples,
        casts: usize,
        all: &Normal,
        folds: &[usize],
        ridge: f64,
        moments: &mut Moments,
    ) -> Result<Self, Trouble> {
        let count = folds.iter().max().map_or(0, |last| last + 1);
        let mut errors = vec![None; folds.len()];
        let mut fold = |number: usize| {
            let (own, others): (Vec<usize>, Vec<usize>) = (0..folds.len()).partition(|i| folds[*i] == number);
            let test = samples.select(&own);
            moments.clear();
            moments.add(&test.x, &test.y, &test.w);
            let fit = solve(all.clone().plus(-1.0, &moments.normal(all.lags())), ridge)?;
            let linear = fit.linear();
            let estimates = linear.predict(&test.x);
            own.iter().zip(test.errors(&estimates)).for_each(|(i, error)| errors[*i] = error);
            let sensitivity = |cast: usize| {
                let mut by_cast = vec![0.0; casts];
                by_cast[cast] = 1.0;
                let residual = test.divided_residual(&divisors(&samples, &own, &by_cast), &estimates);
                fit.sensitivity(&linear.weights_vjp(&test.x, &residual))
            };
            let sensitivities = (0..casts).map(sensitivity).collect();
            Ok(Fold { own, others, linear, estimates, sensitivities })
        };
        let folds = (0..count).map(&mut fold).collect::<Result<_, Trouble>>()?;
        Ok(Self { samples, casts, folds, ridge, errors })
    }

    /// Mean error (%) of each cast.
    pub(super) fn error_of_casts(&self) -> Vec<Option<f64>> {
        self.errors.chunks_exact(self.errors.len() / self.casts).map(mean_error).collect()
    }

    /// λ after a step of −`RIDGE_RATE` d ln L/d ln λ, at most a factor of e; L is the mean error over casts.
    pub(super) fn next_ridge(&self) -> f64 {
        let losses = self.error_of_casts();
        let mean = 0.01 * mean_error(&losses).unwrap_or_default();
        let known = losses.iter().flatten().count() as f64;
        let by_cast: Vec<f64> =
            losses.iter().map(|loss| if loss.is_some() { known.recip() } else { 0.0 }).collect();
        let slope = |fold: &Fold| {
            let z = fold.sensitivity(&by_cast);
            -2.0 * self.ridge * z.w.iter().zip(&fold.linear.w).map(|(z, w)| z * w).sum::<f64>()
        };
        let slope = self.folds.iter().map(slope).sum::<f64>() / mean;
        let step = if slope.is_finite() { (-RIDGE_RATE * slope).clamp(-1.0, 1.0) } else { 0.0 };
        ridge::within_grid(self.ridge * step.exp())
    }

    /// Derivative in x (N, T, C) of the casts' mean errors (as fractions) with these weights.
    pub(super) fn vjp(&self, by_cast: &[f64]) -> Vec<f64> {
        let samples = &self.samples;
        let one = samples.x.len() / samples.w.len();
        let mut cotangent = vec![0.0; samples.x.len()];
        let mut add = |numbers: &[usize], values: &[f64]| {
            for (i, values) in numbers.iter().zip(values.chunks_exact(one)) {
                cotangent[i * one..][..one].iter_mut().zip(values).for_each(|(sum, x)| *sum += x);
            }
        };
        for fold in &self.folds {
            let test = samples.select(&fold.own);
            let residual = test.divided_residual(&divisors(samples, &fold.own, by_cast), &fold.estimates);
            add(&fold.own, &fold.linear.predict_vjp(&residual));
            let others = samples.select(&fold.others);
            let estimates = fold.linear.predict(&others.x);
            let z = fold.sensitivity(by_cast);
            add(&fold.others, &through_weights(&others, &fold.linear, &estimates, &z));
        }
        cotangent
    }
}

impl Fold {
    /// z_f of the casts' mean errors with these weights.
    fn sensitivity(&self, by_cast: &[f64]) -> Linear {
        let mut sum =
            Linear { w: vec![0.0; self.linear.w.len()], b: vec![0.0; self.linear.b.len()], ..self.linear };
        for (z, by) in self.sensitivities.iter().zip(by_cast) {
            sum.w.iter_mut().zip(&z.w).chain(sum.b.iter_mut().zip(&z.b)).for_each(|(sum, z)| *sum += by * z);
        }
        sum
    }
}

/// 1/v_i of these samples: the number of the cast's samples that have an error, divided by the cast's weight.
fn divisors(samples: &ScaledSamples, numbers: &[usize], by_cast: &[f64]) -> Vec<f64> {
    let each = samples.w.len() / by_cast.len();
    let known = |cast: usize| {
        let own = (cast * each..(cast + 1) * each).filter(|&i| samples.w[i] > 0.0 || samples.failed[i]);
        own.count().max(1) as f64
    };
    numbers.iter().map(|i| known(i / each) / by_cast[i / each]).collect()
}

#[cfg(test)]
mod tests;
