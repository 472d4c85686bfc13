//! Error against run time: best test error so far over seconds of CPU, per trial and protocol.
//!
//! Time to an error is a question of survival: a trial that ended without getting there was only watched that long. The
//! median is Kaplan and Meier's (1958); its interval lies between order statistics, interpolated (Hettmansperger and
//! Sheather 1986), of one time a unit: it needs six units, since of five the least and the greatest hold the median in
//! 93.8 % of cases alone.

use super::numbers::{geometric_mean, in_order};
use super::resample::Resampling;
use super::trial::{Cluster, Trial};

/// What a run has reached: seconds, and best error (%) so far.
pub type Reached = (f64, f64);

/// The points that no other beats in both seconds and error, by rising seconds; the index of each is given too.
pub fn pareto(points: &[Reached]) -> Vec<usize> {
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

/// Seconds until a run's best error is no more than `error`.
pub fn time_to(history: &[Reached], error: f64) -> Option<f64> {
    history.iter().find(|(_, best)| *best <= error).map(|(seconds, _)| *seconds)
}

/// A run watched for some seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Watched {
    /// Its placement and seed.
    pub cluster: Cluster,
    /// Until it got there, or ended.
    pub seconds: f64,
    /// Whether it got there.
    pub reached: bool,
}

impl Watched {
    /// A trial's way to an error (%); `None` of one without steps.
    pub fn new(trial: &Trial, error: f64) -> Option<Self> {
        let reached = time_to(&trial.history, error);
        let seconds = reached.or(trial.history.last().map(|last| last.0))?;
        Some(Self { cluster: trial.cluster, seconds, reached: reached.is_some() })
    }
}

/// When half of the runs have got there.
#[derive(Debug, Clone, PartialEq)]
pub struct MedianTime {
    /// Seconds; `None`: fewer than half ever do.
    pub median: Option<f64>,
    /// Ends of its 95 % interval (s), each where runs were watched long enough.
    pub ends: [Option<f64>; 2],
    /// The units that the interval is over, or that are too few.
    pub over: String,
}

/// Units below which a median's interval has no ends.
const LEAST_UNITS: usize = 6;

/// The median over runs, with its interval over units.
pub fn median_time(runs: &[Watched]) -> MedianTime {
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
        over: match ends.is_none() && resampling.can_tell() {
            true => format!("too few to tell: {over}"),
            false => over,
        },
    }
}

/// When `share` of the runs have got there, by Kaplan and Meier's curve; `None`: never.
fn kaplan_meier(runs: &[(f64, bool)], share: f64) -> Option<f64> {
    let mut runs = runs.to_vec();
    // a run that ends as another gets there was still under way
    runs.sort_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
    let mut on_the_way = 1.0;
    for (i, (seconds, reached)) in runs.iter().enumerate() {
        if *reached {
            on_the_way *= 1.0 - 1.0 / (runs.len() - i) as f64;
        }
        if on_the_way <= 1.0 - share + 1e-9 {
            return Some(*seconds);
        }
    }
    None
}

/// Half-way between the runs in the middle of an even number.
fn median(runs: &[(f64, bool)]) -> Option<f64> {
    let below = kaplan_meier(runs, 0.5)?;
    let above = kaplan_meier(runs, 0.5 + 0.5 / runs.len() as f64);
    Some(if runs.len().is_multiple_of(2) {
        above.map_or(below, |above| 0.5 * (below + above))
    } else {
        below
    })
}

/// Ends of the median's 95 % interval, of enough runs: between the d-th and the next of n order statistics from either end, on ln t.
fn order_statistics(runs: &[(f64, bool)]) -> Option<[Option<f64>; 2]> {
    // Runs that ended before the median say little about it.
    let half = median(runs).unwrap_or(0.0);
    let n = runs.iter().filter(|(seconds, reached)| *reached || *seconds >= half).count();
    if n < LEAST_UNITS {
        return None;
    }
    // Of intervals between the d-th from below and the d-th from above: 1 − 2 P(Binomial(n, ½) < d).
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

/// The best error at some seconds; `None` before the first step's end.
pub fn best_at(history: &[Reached], seconds: f64) -> Option<f64> {
    history[..history.partition_point(|(s, _)| *s <= seconds)].last().map(|(_, best)| *best)
}

/// Geometric mean over runs of the best error so far at `count` times, spaced evenly in ln s from when all runs have a
/// first error to the end of the longest; a run that has ended keeps its last.
pub fn mean_history(histories: &[&[Reached]], count: usize) -> Vec<Reached> {
    let histories: Vec<&&[Reached]> = histories.iter().filter(|h| !h.is_empty()).collect();
    let start = histories.iter().map(|h| h[0].0).fold(0.0, f64::max);
    let end = histories.iter().map(|h| h[h.len() - 1].0).fold(0.0, f64::max);
    if histories.is_empty() || start <= 0.0 || end <= start {
        return Vec::new();
    }
    (0..count)
        .map(|i| {
            // The ends exactly: rounding must not fall short of the first error.
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

/// Parts of the time, each once, in the order in which trials name them: a trial without steps has fewer.
pub fn parts(trials: &[&Trial]) -> Vec<&'static str> {
    in_order(trials.iter().flat_map(|trial| &trial.seconds).map(|(part, _)| *part))
}

/// Mean seconds a trial of each of these parts.
pub fn mean_seconds(trials: &[&Trial], parts: &[&'static str]) -> Vec<f64> {
    let of = |trial: &&Trial, part| trial.seconds.iter().find(|of| of.0 == part).map_or(0.0, |of| of.1);
    parts.iter().map(|part| trials.iter().map(|t| of(t, *part)).sum::<f64>() / trials.len() as f64).collect()
}

/// Round errors (1, 1.5, 2, 3, 5, 7 × 10^n) that all but the easiest runs reach and the best ones do: between the
/// largest first error and the least last one.
pub fn round_errors(histories: &[&[Reached]]) -> Vec<f64> {
    let first = histories.iter().filter_map(|h| h.first()).map(|p| p.1).fold(0.0, f64::max);
    let last = histories.iter().filter_map(|h| h.last()).map(|p| p.1).fold(f64::INFINITY, f64::min);
    let mut errors: Vec<f64> = (-3..6)
        .flat_map(|power| [1.0, 1.5, 2.0, 3.0, 5.0, 7.0].map(|digit| digit * 10f64.powi(power)))
        .filter(|e| (last..first).contains(e))
        .collect();
    errors.reverse();
    errors.truncate(6);
    errors
}

#[cfg(test)]
mod tests;
