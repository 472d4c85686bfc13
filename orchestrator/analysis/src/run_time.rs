//! Error against run time: smallest test error so far against CPU seconds, per trial and protocol.
//!
//! Times to an error are censored: a trial may end before it reaches the error. The median is that of Kaplan and Meier (1958).
//! Its interval interpolates between order statistics (Hettmansperger and Sheather 1986) of one time per unit. It needs six
//! units: the range of five contains the median in only 93.8 % of cases.

use super::numbers::{geometric_mean, in_order};
use super::paired::first_at;
use super::resample::Resampling;
use super::trial::{Cluster, Trial};

/// Seconds, and smallest error (%) so far.
pub type ErrorAtTime = (f64, f64);

/// Returns the indices of the points of the Pareto front of seconds and error, by ascending seconds.
pub fn pareto(points: &[ErrorAtTime]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.retain(|&i| points[i].0.is_finite() && points[i].1.is_finite());
    order.sort_by(|&i, &j| points[i].0.total_cmp(&points[j].0).then(points[i].1.total_cmp(&points[j].1)));
    let mut least = f64::INFINITY;
    order.retain(|&i| {
        let better = points[i].1 < least;
        least = least.min(points[i].1);
        better
    });
    order
}

/// A possibly censored time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CensoredTime {
    /// Placement and seed.
    pub cluster: Cluster,
    /// Seconds until the error was reached, or until the end.
    pub seconds: f64,
    /// Whether the error was reached.
    pub reached: bool,
}

impl CensoredTime {
    /// Returns the time of a trial to an error (%); `None` without steps.
    pub fn new(trial: &Trial, error: f64) -> Option<Self> {
        let reached = first_at(&trial.history, error);
        let seconds = reached.or(trial.history.last().map(|last| last.0))?;
        Some(Self { cluster: trial.cluster, seconds, reached: reached.is_some() })
    }
}

/// Median time to an error.
#[derive(Debug, Clone, PartialEq)]
pub struct MedianTime {
    /// Seconds; `None` if fewer than half of the runs reach the error.
    pub median: Option<f64>,
    /// Ends of its 95 % interval (s); `None` with too few units, or if the runs ended too early.
    pub ends: [Option<f64>; 2],
    /// Units of the interval, or why there is none.
    pub over: String,
}

/// Smallest number of units for an interval of the median.
const LEAST_UNITS: usize = 6;

/// Returns the median over runs, with its interval over units.
pub fn median_time(runs: &[CensoredTime]) -> MedianTime {
    let resampling = Resampling::new(&runs.iter().map(|r| r.cluster).collect::<Vec<_>>());
    let of_unit = |units: &[usize], unit: usize| -> (f64, bool) {
        let own = runs.iter().zip(units).filter(|(_, u)| **u == unit).map(|(r, _)| (r.seconds, r.reached));
        let own: Vec<(f64, bool)> = own.collect();
        let last = own.iter().map(|r| r.0).fold(0.0, f64::max);
        median(&own).map_or((last, false), |seconds| (seconds, true))
    };
    let units = resampling.units().map(|units| {
        let count = units.iter().max().map_or(0, |most| most + 1);
        (0..count).map(|unit| of_unit(units, unit)).collect::<Vec<_>>()
    });
    let ends = units.and_then(|units| order_statistics(&units));
    let over = resampling.over();
    MedianTime {
        median: median(&runs.iter().map(|r| (r.seconds, r.reached)).collect::<Vec<_>>()),
        ends: ends.unwrap_or_default(),
        over: match ends.is_none() && resampling.has_enough_units() {
            true => format!("no interval, too few units: {over}"),
            false => over,
        },
    }
}

/// Returns the time by which this share of the runs has reached the error, by the Kaplan–Meier estimator; `None`: never.
/// `runs`: seconds, and whether the error was reached.
fn kaplan_meier(runs: &[(f64, bool)], share: f64) -> Option<f64> {
    let mut runs = runs.to_vec();
    // a run that ends when another one reaches the error counts as still running
    runs.sort_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
    let mut survival = 1.0;
    for (i, (seconds, reached)) in runs.iter().enumerate() {
        if *reached {
            survival *= 1.0 - 1.0 / (runs.len() - i) as f64;
        }
        if survival <= 1.0 - share + 1e-9 {
            return Some(*seconds);
        }
    }
    None
}

/// Returns the median; of an even number of runs, the mean of the two middle times.
fn median(runs: &[(f64, bool)]) -> Option<f64> {
    let below = kaplan_meier(runs, 0.5)?;
    let above = kaplan_meier(runs, 0.5 + 0.5 / runs.len() as f64);
    Some(if runs.len().is_multiple_of(2) {
        above.map_or(below, |above| 0.5 * (below + above))
    } else {
        below
    })
}

/// Returns the ends of the 95 % interval of the median: interpolated in ln t between the d-th and the next order statistic from
/// either end. `None` with too few runs.
fn order_statistics(runs: &[(f64, bool)]) -> Option<[Option<f64>; 2]> {
    // Runs that ended before the median contain little information on it.
    let half = median(runs).unwrap_or(0.0);
    let n = runs.iter().filter(|(seconds, reached)| *reached || *seconds >= half).count();
    if n < LEAST_UNITS {
        return None;
    }
    // Coverage between the d-th value from below and from above: 1 − 2 P(Binomial(n, ½) < d).
    let holds = |d: usize| {
        let mut term = 0.5f64.powi(n as i32);
        let mut below = 0.0;
        for k in 0..d {
            below += term;
            term *= (n - k) as f64 / (k + 1) as f64;
        }
        1.0 - 2.0 * below
    };
    let d = (1..n / 2).take_while(|&d| holds(d) >= 0.95).last().unwrap_or(1);
    let part = ((holds(d) - 0.95) / (holds(d) - holds(d + 1))).max(0.0);
    let inward = (n - d) as f64 * part / (d as f64 + (n - 2 * d) as f64 * part);
    let at = |rank: usize| kaplan_meier(runs, (rank as f64 - 0.5) / n as f64);
    let between = |outer: usize, inner: usize| {
        Some(((1.0 - inward) * at(outer)?.ln() + inward * at(inner)?.ln()).exp())
    };
    Some([between(d, d + 1), between(n + 1 - d, n - d)])
}

/// Returns the smallest error until `seconds`; `None` before the end of the first step.
pub fn best_at(history: &[ErrorAtTime], seconds: f64) -> Option<f64> {
    history[..history.partition_point(|(s, _)| *s <= seconds)].last().map(|(_, best)| *best)
}

/// Returns the geometric mean over runs of the smallest error so far, at `count` times spaced evenly in ln s, from the first
/// time at which all runs have an error to the end of the longest run. Runs that have ended keep their last error.
pub fn mean_history(histories: &[&[ErrorAtTime]], count: usize) -> Vec<ErrorAtTime> {
    let histories: Vec<&&[ErrorAtTime]> = histories.iter().filter(|h| !h.is_empty()).collect();
    let start = histories.iter().map(|h| h[0].0).fold(0.0, f64::max);
    let end = histories.iter().map(|h| h[h.len() - 1].0).fold(0.0, f64::max);
    if histories.is_empty() || start <= 0.0 || end <= start {
        return Vec::new();
    }
    (0..count)
        .map(|i| {
            // The ends are exact, because rounding could fall before the first error.
            let seconds = match i {
                0 => start,
                i if i + 1 == count => end,
                i => start * (end / start).powf(i as f64 / (count - 1) as f64),
            };
            let errors: Vec<f64> = histories.iter().filter_map(|h| best_at(h, seconds)).collect();
            (seconds, geometric_mean(&errors))
        })
        .collect()
}

/// Returns the distinct parts of the time, in order of appearance. Trials without steps have fewer parts.
pub fn parts(trials: &[&Trial]) -> Vec<&'static str> {
    in_order(trials.iter().flat_map(|trial| &trial.seconds).map(|(part, _)| *part))
}

/// Mean seconds per trial of each part.
pub fn mean_seconds(trials: &[&Trial], parts: &[&'static str]) -> Vec<f64> {
    let of = |trial: &&Trial, part| trial.seconds.iter().find(|of| of.0 == part).map_or(0.0, |of| of.1);
    parts.iter().map(|part| trials.iter().map(|t| of(t, *part)).sum::<f64>() / trials.len() as f64).collect()
}

/// Returns up to six round errors (1, 1.5, 2, 3, 5, 7 × 10^n), descending, between the smallest last and the largest first
/// error.
pub fn round_errors(histories: &[&[ErrorAtTime]]) -> Vec<f64> {
    let first = histories.iter().filter_map(|h| h.first()).map(|p| p.1).fold(0.0, f64::max);
    let last = histories.iter().filter_map(|h| h.last()).map(|p| p.1).fold(f64::INFINITY, f64::min);
    let round = (-3..6).flat_map(|n| [1.0, 1.5, 2.0, 3.0, 5.0, 7.0].map(|digit| digit * 10f64.powi(n)));
    let mut errors: Vec<f64> = round.filter(|e| (last..first).contains(e)).collect();
    errors.reverse();
    errors.truncate(6);
    errors
}

#[cfg(test)]
mod tests;
