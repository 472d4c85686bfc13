//! Initial against optimised body, paired by trial.
//!
//! The ratio of the two errors of a trial compares bodies under the same stimuli, sensors and initial weights. The mean
//! of ln(ratio) over trials has an interval over placements and seeds ([`Resampling`]).

use std::collections::BTreeMap;

use super::data::once;
use super::numbers::geometric_mean;
use super::resample::{Interval, Resampling};
use super::trial::{Body, Cluster, CurvePoint, Set, Trial};

/// A ratio over trials.
#[derive(Debug, Clone, PartialEq)]
pub struct Ratio {
    /// Trials that have both values.
    pub trials: usize,
    /// Trials whose ratio is above 1.
    pub above_one: usize,
    /// Geometric mean; above 1 the optimised body is the better one.
    pub ratio: f64,
    /// Its 95 % interval; `None` where there are too few units to tell.
    pub interval: Option<Interval>,
    /// The chance of a ratio that far from 1, either way, if the true one is 1.
    pub chance: Option<f64>,
    /// The true ratio that such trials would tell from 1 in four of five sweeps.
    pub tells: Option<f64>,
    /// The units that the interval is over, or that are too few.
    pub over: String,
}

impl Ratio {
    /// The geometric mean of positive ratios with its interval over placements and seeds; `None` of no ratios.
    pub fn of(ratios: &[(Cluster, f64)]) -> Option<Self> {
        // By cluster, whose trials are drawn and left out together: how many, and the sum of their logarithms.
        let mut sums: BTreeMap<Cluster, [f64; 2]> = BTreeMap::new();
        for (cluster, ratio) in ratios {
            let sum = sums.entry(*cluster).or_default();
            *sum = [sum[0] + 1.0, sum[1] + ratio.ln()];
        }
        let (clusters, sums): (Vec<Cluster>, Vec<[f64; 2]>) = sums.into_iter().unzip();
        Self::weighed(&Resampling::new(&clusters), &sums, ratios.iter().filter(|(_, r)| *r > 1.0).count())
    }

    /// The same over other units.
    pub fn over(units: &Resampling, ratios: &[f64]) -> Option<Self> {
        let logs: Vec<[f64; 2]> = ratios.iter().map(|r| [1.0, r.ln()]).collect();
        Self::weighed(units, &logs, ratios.iter().filter(|r| **r > 1.0).count())
    }

    /// Of sums of logarithms with their counts, one a weight.
    pub(super) fn weighed(units: &Resampling, sums: &[[f64; 2]], above_one: usize) -> Option<Self> {
        let mean = |weights: &[f64]| {
            let both =
                weights.iter().zip(sums).fold([0.0; 2], |[n, sum], (w, s)| [n + w * s[0], sum + w * s[1]]);
            Some(both[1] / both[0]).filter(|mean| mean.is_finite())
        };
        let trials = sums.iter().map(|s| s[0]).sum::<f64>() as usize;
        Self::by(units, trials, above_one, mean)
    }

    /// The ratio whose logarithm is a statistic of weighed trials.
    pub(super) fn by(
        units: &Resampling,
        trials: usize,
        above_one: usize,
        logarithm: impl Fn(&[f64]) -> Option<f64>,
    ) -> Option<Self> {
        let judged = units.judged(&logarithm);
        Some(Self {
            trials,
            above_one,
            ratio: logarithm(&units.even())?.exp(),
            interval: judged.map(|j| j.interval.map(f64::exp)),
            chance: judged.map(|j| j.chance),
            tells: judged.map(|j| j.tells.exp()),
            over: units.over(),
        })
    }
}

/// Of each trial that has both, the first value over the second.
pub(super) fn ratio_of(trials: &[&Trial], values: impl Fn(&Trial) -> Option<[f64; 2]>) -> Option<Ratio> {
    let of = once(trials, values).map(|(t, [a, b])| (t.cluster, a / b));
    Ratio::of(&of.collect::<Vec<_>>())
}

/// Error of the initial over error of the optimised body.
pub fn error_ratio(trials: &[&Trial], set: Set) -> Option<Ratio> {
    ratio_of(trials, |t| Some([t.error(Body::Initial, set)?, t.error(Body::Optimised, set)?]))
}

/// The same after long training.
pub fn long_ratio(trials: &[&Trial], set: Set) -> Option<Ratio> {
    ratio_of(trials, |t| Some([t.long_error(Body::Initial, set)?, t.long_error(Body::Optimised, set)?]))
}

/// The ratio by medians over samples, where it leads to another verdict than that by means of the same trials, and both verdicts.
pub fn disagreement(ratio: impl Fn(Set) -> Option<Ratio>) -> Option<(Ratio, String)> {
    let (mean, median) = (ratio(Set::Holdout)?, ratio(Set::Median)?);
    let verdict = |ratio: &Ratio| match ratio.interval.and_then(Interval::is_above_one) {
        Some(true) => "above 1",
        Some(false) => "below 1",
        None => "undecided",
    };
    let (by_means, by_medians) = (verdict(&mean), verdict(&median));
    let text = format!("{by_means} by means, {by_medians} by medians");
    (mean.trials == median.trials && by_means != by_medians).then_some((median, text))
}

/// By what two trainings are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Progress {
    /// Training loss, at every iteration.
    Loss,
    /// Error on the holdout, at some hundred iterations.
    Error,
}

impl Progress {
    /// Both, the more telling first.
    pub const ALL: [Self; 2] = [Self::Error, Self::Loss];

    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Loss => "training loss",
            Self::Error => "holdout error",
        }
    }
}

/// The first iteration at which a curve is no more than `target`.
pub fn first_at(curve: &[CurvePoint], target: f64) -> Option<u32> {
    curve.iter().find(|(_, value)| *value <= target).map(|(iteration, _)| *iteration)
}

/// Iterations of training on the initial body over those on the optimised body until both first have the value that the
/// worse of the two ends at its best; `None` where a curve is empty.
pub fn iteration_ratio(initial: &[CurvePoint], optimised: &[CurvePoint]) -> Option<f64> {
    let least = |curve: &[CurvePoint]| curve.iter().map(|p| p.1).fold(f64::INFINITY, f64::min);
    let target = least(initial).max(least(optimised));
    Some(f64::from(first_at(initial, target)?) / f64::from(first_at(optimised, target)?))
}

/// [`iteration_ratio`] over trials, each the geometric mean over its networks.
pub fn iterations(trials: &[&Trial], by: Progress) -> Option<Ratio> {
    let of = |t: &Trial| Some(geometric_mean(&t.iterations[by as usize])).filter(|mean| mean.is_finite());
    let ratios: Vec<(Cluster, f64)> = once(trials, of).map(|(t, ratio)| (t.cluster, ratio)).collect();
    Ratio::of(&ratios)
}

/// Trials by the schedule of their comparison's learning rate: one that falls to nothing meets a target late, whatever the
/// body, so that ratios of iterations under different ones are not mixed.
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
