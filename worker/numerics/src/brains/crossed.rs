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
use crate::brain::linear::{Lags, Linear, Normal};
use crate::trial::{Trouble, mean_error, pick};

/// Step of ln λ per unit of −d ln L/d ln λ: about the inverse of its second derivative near the minimum, measured as 0.1 … 0.2.
const RIDGE_RATE: f64 = 5.0;

/// Normal equations of each fold's samples, of which `members` has the numbers.
pub(super) fn fold_equations(samples: &ScaledSamples, members: &[Vec<usize>], lags: Lags) -> Vec<Normal> {
    let groups = lags.training_groups(samples.sizes.channels);
    members.iter().map(|own| samples.select(own).normal_of(lags, groups.clone())).collect()
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
    /// Numbers of the fold's samples.
    own: Vec<usize>,
    linear: Linear,
    /// Its estimates of all samples of the body.
    estimates: Vec<f64>,
    /// z_f of the mean error of each cast.
    sensitivities: Vec<Linear>,
}

impl CrossValidation {
    /// Fits a decoder per fold; `members` and `parts` have the numbers and normal equations of each fold's samples, `all` the
    /// equations of these and of earlier samples. Equally many samples of each cast follow each other.
    ///
    /// # Errors
    /// If a fold's decoder has no solution.
    pub(super) fn new(
        samples: ScaledSamples,
        casts: usize,
        members: Vec<Vec<usize>>,
        parts: &[Normal],
        all: &Normal,
        ridge: f64,
    ) -> Result<Self, Trouble> {
        let count = samples.w.len();
        let mut errors = vec![None; count];
        let mut fold = |(own, part): (Vec<usize>, &Normal)| {
            let fit = solve(all.clone().plus(-1.0, part), ridge)?;
            let linear = fit.linear();
            let estimates = linear.predict(&samples.x);
            let of_all = samples.errors(&estimates);
            own.iter().for_each(|&i| errors[i] = of_all[i]);
            let own_x = pick(&samples.x, count, &own);
            let mut fold = Fold { own, linear, estimates, sensitivities: Vec::new() };
            for cast in 0..casts {
                let mut by_cast = vec![0.0; casts];
                by_cast[cast] = 1.0;
                let residual = pick(&fold.residual(&samples, &by_cast), count, &fold.own);
                fold.sensitivities.push(fit.sensitivity(&fold.linear.weights_vjp(&own_x, &residual)));
            }
            Ok(fold)
        };
        let folds = members.into_iter().zip(parts).map(&mut fold).collect::<Result<_, Trouble>>()?;
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
        let mut cotangent = vec![0.0; self.samples.x.len()];
        for fold in &self.folds {
            let (residual, z) = (fold.residual(&self.samples, by_cast), fold.sensitivity(by_cast));
            let mut others = self.samples.clone();
            fold.own.iter().for_each(|&i| others.w[i] = 0.0);
            let of_fold = through_weights(&others, &fold.linear, &fold.estimates, &z, &residual);
            cotangent.iter_mut().zip(of_fold).for_each(|(sum, x)| *sum += x);
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

    /// Derivative of the casts' mean errors (as fractions) with these weights in the estimates; 0 outside the fold.
    fn residual(&self, samples: &ScaledSamples, by_cast: &[f64]) -> Vec<f64> {
        let each = samples.w.len() / by_cast.len();
        let known = |cast: usize| {
            let own = (cast * each..(cast + 1) * each).filter(|&i| samples.w[i] > 0.0 || samples.failed[i]);
            own.count().max(1) as f64
        };
        let mut divisors = vec![f64::INFINITY; samples.w.len()];
        self.own.iter().for_each(|&i| divisors[i] = known(i / each) / by_cast[i / each]);
        samples.divided_residual(&divisors, &self.estimates)
    }
}

#[cfg(test)]
mod tests;
