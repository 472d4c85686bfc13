//! The regularisation of linear decoders, by cross-validation over samples.
//!
//! ```text
//! e_i(λ)   error of sample i with weights fitted without its fold
//! λ₀       argmin mean e(λ)
//! λ        the greatest with mean(e(λ) − e(λ₀)) ≤ its standard error, and ≤ a part of mean e(λ₀)
//! ```
//! Residuals within a sample are correlated, so whole samples are left out. One-standard-error rule: Hastie, Tibshirani and
//! Friedman, The Elements of Statistical Learning, 7.10, here with paired differences.

use super::linear::{ScaledSamples, solve};
use crate::brain::linear::Normal;
use crate::stimuli::{folds, members};
use crate::trial::{Trouble, mean_error};

/// Number of folds.
const FOLDS: usize = 5;
/// Exponents of λ = 10², …, 10⁻¹².
const RIDGES: std::ops::RangeInclusive<i32> = -2..=12;
/// λ if no sample has a force.
const NEUTRAL: f64 = 1e-6;
/// With fewer samples all folds test all values. With more, the first fold stops after `WITHOUT` values without an improvement by
/// 1 %.
pub(super) const FEW: usize = 60;
const PATIENCE: usize = 3;
/// The other folds then test the `CANDIDATES` greatest values whose error in the first fold is below `WORSE` times the least.
const CANDIDATES: usize = 4;
const WORSE: f64 = 2.0;
/// Largest excess over the least mean error, relative to it: with few samples; with more.
const EXCESS: [f64; 2] = [0.2, 0.05];

/// Test samples of a fold, and the normal equations of the others.
pub(super) struct FoldSplit {
    pub(super) judges: ScaledSamples,
    pub(super) others: Normal,
}

impl FoldSplit {
    /// Error (%) of each test sample with the weights of these normal equations; `None` without a solution.
    pub(super) fn errors(&self, normal: Normal, ridge: f64) -> Option<Vec<Option<f64>>> {
        let predicted = solve(normal, ridge).ok()?.linear().predict(&self.judges.x);
        let errors = self.judges.errors(&predicted);
        errors.iter().flatten().all(|error| error.is_finite()).then_some(errors)
    }

    /// As `errors`, with weights fitted to the other folds.
    pub(super) fn errors_of_others(&self, ridge: f64) -> Option<Vec<Option<f64>>> {
        self.errors(self.others.clone(), ridge)
    }
}

/// λ for these samples with normal equations `all` and folds `dealt`. Lags share weights as in training.
///
/// # Errors
/// If no λ gives a solution.
pub(super) fn ridge_of(samples: &ScaledSamples, all: &Normal, dealt: &[usize]) -> Result<f64, Trouble> {
    let groups = all.lags().training_groups(samples.sizes.channels);
    let coarse = (groups != all.groups()).then(|| samples.normal_of(all.lags(), groups));
    let (count, parts) = (samples.w.len(), split_folds(samples, coarse.as_ref().unwrap_or(all), dealt));
    one_se_choice(&errors_by_value(ridges(), count >= FEW, parts, FoldSplit::errors_of_others))
}

/// The nearest λ within the grid.
pub(super) fn within_grid(ridge: f64) -> f64 {
    ridge.clamp(10_f64.powi(-RIDGES.end()), 10_f64.powi(-RIDGES.start()))
}

/// Fold of each sample.
pub(crate) fn assign_folds(seed: u64, samples: usize) -> Vec<usize> {
    folds(seed, samples, FOLDS.min(samples))
}

/// Splits the samples into folds, and subtracts each fold from the normal equations of all.
pub(super) fn split_folds(
    samples: &ScaledSamples,
    all: &Normal,
    dealt: &[usize],
) -> impl Iterator<Item = FoldSplit> {
    let members = members(dealt);
    // With one fold, no samples are left to fit.
    let folds = if members.len() > 1 { members } else { Vec::new() };
    folds.into_iter().map(move |own| {
        let test = samples.select(&own);
        let others = all.clone().plus(-1.0, &test.normal_of(all.lags(), all.groups().to_vec()));
        FoldSplit { judges: test, others }
    })
}

/// The grid of λ, greatest first.
pub(crate) fn ridges() -> impl Iterator<Item = f64> {
    RIDGES.map(|decade| 10_f64.powi(-decade))
}

/// The `values`, in order of preference, that have a solution in every fold, with the errors of all samples. `prefilter`: the
/// first fold passes only a few values to the others.
pub(super) fn errors_by_value(
    values: impl Iterator<Item = f64>,
    prefilter: bool,
    parts: impl Iterator<Item = FoldSplit>,
    errors: impl Fn(&FoldSplit, f64) -> Option<Vec<Option<f64>>>,
) -> Vec<(f64, Vec<Option<f64>>)> {
    let mut judged: Vec<(f64, Vec<Option<f64>>)> = values.map(|value| (value, Vec::new())).collect();
    let mut parts = parts.enumerate().peekable();
    while let Some((number, part)) = parts.next() {
        let prefilter = prefilter && number == 0;
        let (mut min_error, mut stale_values) = (f64::INFINITY, 0);
        judged.retain_mut(|(value, errors_so_far)| {
            if prefilter && stale_values == PATIENCE {
                return false;
            }
            let Some(errors) = errors(&part, *value) else { return false };
            let mean = mean_error(&errors).unwrap_or_default();
            stale_values = if mean < 0.99 * min_error { 0 } else { stale_values + 1 };
            min_error = min_error.min(mean);
            errors_so_far.extend(errors);
            true
        });
        if prefilter && parts.peek().is_some() {
            judged.retain(|(_, errors)| mean_error(errors).unwrap_or_default() <= WORSE * min_error);
            judged.truncate(CANDIDATES);
        }
    }
    judged
}

/// The value with the least mean error.
///
/// # Errors
/// If there is no value.
pub(super) fn least(judged: &[(f64, Vec<Option<f64>>)]) -> Result<f64, Trouble> {
    let mean = |errors: &[Option<f64>]| mean_error(errors).unwrap_or(f64::INFINITY);
    let best = judged.iter().min_by(|a, b| mean(&a.1).total_cmp(&mean(&b.1)));
    best.map(|best| best.0).ok_or(Trouble::Singular)
}

/// The first value whose mean error exceeds the least by at most the standard error of the difference, and by at most `EXCESS`.
///
/// # Errors
/// If there is no value.
pub(crate) fn one_se_choice(judged: &[(f64, Vec<Option<f64>>)]) -> Result<f64, Trouble> {
    let mean = |errors: &[Option<f64>]| mean_error(errors).unwrap_or(f64::INFINITY);
    let best = judged.iter().min_by(|a, b| mean(&a.1).total_cmp(&mean(&b.1))).ok_or(Trouble::Singular)?;
    let least = mean(&best.1);
    if least.is_infinite() {
        return Ok(NEUTRAL);
    }
    let as_good = |(_, errors): &&(f64, Vec<Option<f64>>)| {
        let pairs = errors.iter().flatten().zip(best.1.iter().flatten());
        let differences: Vec<f64> = pairs.map(|(a, b)| a - b).collect();
        let count = differences.len() as f64;
        let mean = differences.iter().sum::<f64>() / count;
        let variance = differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (count - 1.0);
        let excess = EXCESS[usize::from(differences.len() >= FEW)];
        mean <= (variance / count).sqrt().min(excess * least)
    };
    Ok(judged.iter().find(as_good).unwrap_or(best).0)
}

#[cfg(test)]
mod tests;
