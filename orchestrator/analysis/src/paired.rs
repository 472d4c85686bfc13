//! Initial against trained body, paired by trial.
//!
//! The two errors of a trial have the same forces, sensors and initial weights. The mean of ln(ratio) over trials has an
//! interval over placements and seeds ([`Resampling`]).

use std::collections::BTreeMap;

use super::data::without_repeats;
use super::numbers::geometric_mean;
use super::resample::{Interval, Resampling};
use super::trial::{BodyState, Cluster, CurvePoint, Set, Trial};

/// A mean ratio over trials.
#[derive(Debug, Clone, PartialEq)]
pub struct Ratio {
    /// Number of trials with both values.
    pub trials: usize,
    /// Number of trials with a ratio above 1.
    pub above_one: usize,
    /// Geometric mean. For errors, above 1: the trained body is better.
    pub ratio: f64,
    /// Its 95 % interval; `None` with too few units.
    pub interval: Option<Interval>,
    /// Two-sided p-value of the hypothesis that the true ratio is 1.
    pub p_value: Option<f64>,
    /// True ratio that such trials would distinguish from 1 with a power of 80 %.
    pub detectable: Option<f64>,
    /// Units of the interval, or why there is none.
    pub over: String,
}

impl Ratio {
    /// Returns the geometric mean of positive ratios with its interval over placements and seeds; `None` without ratios.
    pub fn of(ratios: impl IntoIterator<Item = (Cluster, f64)>) -> Option<Self> {
        // Count and sum of logarithms per cluster; its trials are drawn together.
        let (mut sums, mut above_one) = (BTreeMap::<Cluster, [f64; 2]>::new(), 0);
        for (cluster, ratio) in ratios {
            let sum = sums.entry(cluster).or_default();
            *sum = [sum[0] + 1.0, sum[1] + ratio.ln()];
            above_one += usize::from(ratio > 1.0);
        }
        let (clusters, sums): (Vec<Cluster>, Vec<[f64; 2]>) = sums.into_iter().unzip();
        Self::weighed(&Resampling::new(&clusters), &sums, above_one)
    }

    /// The same with other units of inference; one ratio per trial of `units`.
    pub fn over(units: &Resampling, ratios: &[f64]) -> Option<Self> {
        let logs: Vec<[f64; 2]> = ratios.iter().map(|r| [1.0, r.ln()]).collect();
        Self::weighed(units, &logs, ratios.iter().filter(|r| **r > 1.0).count())
    }

    /// The same from count and sum of logarithms per weight.
    pub(super) fn weighed(units: &Resampling, sums: &[[f64; 2]], above_one: usize) -> Option<Self> {
        let mean = |weights: &[f64]| {
            let both =
                weights.iter().zip(sums).fold([0.0; 2], |[n, sum], (w, s)| [n + w * s[0], sum + w * s[1]]);
            Some(both[1] / both[0]).filter(|mean| mean.is_finite())
        };
        let trials = sums.iter().map(|s| s[0]).sum::<f64>() as usize;
        Self::by(units, trials, above_one, mean)
    }

    /// The same for a ratio whose logarithm is a statistic of weighted trials.
    pub(super) fn by(
        units: &Resampling,
        trials: usize,
        above_one: usize,
        logarithm: impl Fn(&[f64]) -> Option<f64>,
    ) -> Option<Self> {
        let judged = units.judged(&logarithm);
        let ratio = logarithm(&units.equal_weights())?.exp();
        let interval = judged.map(|j| j.interval.map(f64::exp));
        let (p_value, detectable) = judged.map(|j| (j.chance, j.tells.exp())).unzip();
        Some(Self { trials, above_one, ratio, interval, p_value, detectable, over: units.over() })
    }
}

/// Ratio of the first value to the second, over trials that have both.
pub(super) fn ratio_of(trials: &[&Trial], values: impl Fn(&Trial) -> Option<[f64; 2]>) -> Option<Ratio> {
    Ratio::of(without_repeats(trials, values).map(|(t, [a, b])| (t.cluster, a / b)))
}

/// Error of the initial body divided by that of the trained body.
pub fn error_ratio(trials: &[&Trial], set: Set) -> Option<Ratio> {
    ratio_of(trials, |t| Some([t.error(BodyState::Initial, set)?, t.error(BodyState::Optimised, set)?]))
}

/// The same after long training.
pub fn long_ratio(trials: &[&Trial], set: Set) -> Option<Ratio> {
    ratio_of(trials, |t| {
        Some([t.long_error(BodyState::Initial, set)?, t.long_error(BodyState::Optimised, set)?])
    })
}

/// Returns the ratio by medians over samples, and both verdicts, if they differ from the verdict by means of the same trials.
pub fn disagreement(ratio: impl Fn(Set) -> Option<Ratio>) -> Option<(Ratio, String)> {
    let (mean, median) = (ratio(Set::Holdout)?, ratio(Set::Median)?);
    let verdict = |ratio: &Ratio| match ratio.interval.and_then(Interval::is_above_one) {
        Some(true) => "above 1",
        Some(false) => "below 1",
        None => "undecided",
    };
    let text = differing([verdict(&mean), verdict(&median)]).filter(|_| mean.trials == median.trials);
    text.map(|text| (median, text))
}

/// The verdicts by means and by medians over samples, if they differ.
pub(super) fn differing([by_means, by_medians]: [&str; 2]) -> Option<String> {
    (by_means != by_medians).then(|| format!("{by_means} by means, {by_medians} by medians"))
}

/// Quantity by which the training of two networks is compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrainingMeasure {
    /// Training loss, at every iteration.
    Loss,
    /// Held-out error, at the iterations at which it is recorded.
    Error,
}

impl TrainingMeasure {
    /// Both, the more informative first.
    pub const ALL: [Self; 2] = [Self::Error, Self::Loss];

    /// Name in tables.
    pub fn name(self) -> &'static str {
        ["training loss", "holdout error"][self as usize]
    }
}

/// Returns the first iteration or time at which a curve is at most `target`.
pub fn first_at<T: Copy>(curve: &[(T, f64)], target: f64) -> Option<T> {
    curve.iter().find(|(_, value)| *value <= target).map(|(at, _)| *at)
}

/// Returns the iterations on the initial body divided by those on the trained body, until each first reaches the larger of the
/// two curves' minima. `None` if a curve is empty.
pub fn iteration_ratio(initial: &[CurvePoint], optimised: &[CurvePoint]) -> Option<f64> {
    let least = |curve: &[CurvePoint]| curve.iter().map(|p| p.1).fold(f64::INFINITY, f64::min);
    let target = least(initial).max(least(optimised));
    Some(f64::from(first_at(initial, target)?) / f64::from(first_at(optimised, target)?))
}

/// [`iteration_ratio`] over trials; geometric mean over the networks of a trial.
pub fn iterations(trials: &[&Trial], by: TrainingMeasure) -> Option<Ratio> {
    let of = |t: &Trial| Some(geometric_mean(&t.iterations[by as usize])).filter(|mean| mean.is_finite());
    Ratio::of(without_repeats(trials, of).map(|(t, ratio)| (t.cluster, ratio)))
}

/// Groups trials by the learning rate schedule of the comparison. A rate that falls to zero delays the target for any body, so
/// ratios under different schedules are not mixed.
pub fn schedules<'a>(trials: &[&'a Trial]) -> Vec<(&'a str, Vec<&'a Trial>)> {
    let mut found: BTreeMap<&str, Vec<&Trial>> = BTreeMap::new();
    for trial in trials {
        let rate = trial.setting.text("evaluation.schedule");
        found.entry(rate.unwrap_or("unknown")).or_default().push(trial);
    }
    found.into_iter().collect()
}

#[cfg(test)]
mod tests;
