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
use crate::brain::linear::{Fit, Linear, Normal};
use crate::trial::{Trouble, mean_error};

/// Step of ln λ per unit of −d ln L/d ln λ: about the inverse of its second derivative near the minimum, measured as 0.1 … 0.2.
const RIDGE_RATE: f64 = 5.0;

/// The decoders of all folds of a body's samples.
pub(super) struct CrossValidation {
    samples: ScaledSamples,
    folds: Vec<Fold>,
    ridge: f64,
}

/// A decoder that was fitted without the samples of a fold.
struct Fold {
    own: Vec<usize>,
    others: Vec<usize>,
    fit: Fit,
    linear: Linear,
    /// Estimates of the fold's own samples.
    estimates: Vec<f64>,
}

impl CrossValidation {
    /// Fits a decoder per fold; `folds` has the fold of each sample, `all` the normal equations of these and of earlier samples.
    ///
    /// # Errors
    /// If a fold's decoder has no solution.
    pub(super) fn new(
        samples: ScaledSamples,
        all: &Normal,
        folds: &[usize],
        ridge: f64,
    ) -> Result<Self, Trouble> {
        let count = folds.iter().max().map_or(0, |last| last + 1);
        let fold = |number: usize| {
            let (own, others): (Vec<usize>, Vec<usize>) = (0..folds.len()).partition(|i| folds[*i] == number);
            let test = samples.select(&own);
            let fit = solve(all.clone().plus(-1.0, &test.moments().normal(all.lags())), ridge)?;
            let linear = fit.linear();
            let estimates = linear.predict(&test.x);
            Ok(Fold { own, others, fit, linear, estimates })
        };
        let folds = (0..count).map(fold).collect::<Result<_, Trouble>>()?;
        Ok(Self { samples, folds, ridge })
    }

    /// Error (%) of each sample.
    pub(super) fn errors(&self) -> Vec<Option<f64>> {
        let mut errors = vec![None; self.samples.w.len()];
        for fold in &self.folds {
            let own = self.samples.select(&fold.own).errors(&fold.estimates);
            fold.own.iter().zip(own).for_each(|(i, error)| errors[*i] = error);
        }
        errors
    }

    /// λ after a step of −`RIDGE_RATE` d ln L/d ln λ, at most a factor of e; L is the mean error.
    pub(super) fn next_ridge(&self) -> f64 {
        let mean = 0.01 * mean_error(&self.errors()).unwrap_or_default();
        let weights = self.samples.equal_weights();
        let slope = |fold: &Fold| {
            let (z, _) = self.sensitivity(fold, &weights);
            -2.0 * self.ridge * z.w.iter().zip(&fold.linear.w).map(|(z, w)| z * w).sum::<f64>()
        };
        let slope = self.folds.iter().map(slope).sum::<f64>() / mean;
        let step = if slope.is_finite() { (-RIDGE_RATE * slope).clamp(-1.0, 1.0) } else { 0.0 };
        ridge::within_grid(self.ridge * step.exp())
    }

    /// dL/dx (N, T, C) with these weights v (N).
    pub(super) fn vjp(&self, weights: &[f64]) -> Vec<f64> {
        let one = self.samples.x.len() / self.samples.w.len();
        let mut cotangent = vec![0.0; self.samples.x.len()];
        let mut add = |numbers: &[usize], values: &[f64]| {
            for (i, values) in numbers.iter().zip(values.chunks_exact(one)) {
                cotangent[i * one..][..one].iter_mut().zip(values).for_each(|(sum, x)| *sum += x);
            }
        };
        for fold in &self.folds {
            let (z, residual) = self.sensitivity(fold, weights);
            add(&fold.own, &fold.linear.predict_vjp(&residual));
            let others = self.samples.select(&fold.others);
            let estimates = fold.linear.predict(&others.x);
            add(&fold.others, &through_weights(&others, &fold.linear, &estimates, &z));
        }
        cotangent
    }

    /// z_f, and ∂L/∂f̂ on the fold's own samples.
    fn sensitivity(&self, fold: &Fold, weights: &[f64]) -> (Linear, Vec<f64>) {
        let test = self.samples.select(&fold.own);
        let weights: Vec<f64> = fold.own.iter().map(|&i| weights[i]).collect();
        let residual = test.weighted_residual(&weights, &fold.estimates);
        (fold.fit.sensitivity(&fold.linear.weights_vjp(&test.x, &residual)), residual)
    }
}

#[cfg(test)]
mod tests;
