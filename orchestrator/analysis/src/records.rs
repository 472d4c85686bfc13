//! Errors of bodies on measured or simulated records. The error of a record is the mean over seeds of networks that were not
//! trained on it, or the error of the inverse decoder.
//!
//! Intervals are over records; bodies under the same forces share the resampled records. They do not cover other networks,
//! which the spread over folds and seeds shows.

use super::numbers::{deviation, mean, quantile};
use super::paired::iteration_ratio;
use super::resample::{Interval, LEAST_UNITS, SEED};
use super::tables::ends;
use super::trial::CurvePoint;
use metasense_numerics::random::Draw;
use metasense_render::{Table, row};

/// Errors of one body.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyErrors {
    /// The body.
    pub body: String,
    /// Signals of training and evaluation.
    pub by: SignalSource,
    /// Error of each record (%), mean over seeds; `None` if it has none.
    pub errors: Vec<Option<f64>>,
    /// Mean error on training records (%).
    pub error_train: Option<f64>,
    /// Mean error of the networks of each seed (%).
    pub by_seed: Vec<f64>,
    /// Mean error of the records of each fold (%).
    pub by_fold: Vec<f64>,
    /// Mean error on records not used in training, at some iterations.
    pub progress: Vec<CurvePoint>,
    /// Agreement of the signals of the model or the twin with the measured ones.
    pub agreement: Option<Agreement>,
    /// Results of the inverse decoder.
    pub posterior: Option<InverseResults>,
}

/// Further results of the inverse decoder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InverseResults {
    /// Fraction of the true forces within the 95 % bands (%).
    pub coverage: f64,
    /// Number of descents that did not converge.
    pub unconverged: usize,
    /// Number of records that its model does not explain.
    pub unexplained: usize,
    /// CPU time per record (s).
    pub seconds: f64,
}

/// Signals that train the networks and on which they are evaluated; for the inverse decoder, the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SignalSource {
    /// Measured signals.
    Measured,
    /// The held-out set of the trial.
    Holdout,
    /// Signals of the trial's model.
    Simulated,
    /// Training with signals of a twin, evaluation on measured ones.
    Twin,
}

impl SignalSource {
    /// Name in tables.
    pub fn name(self) -> &'static str {
        ["measured", "holdout", "simulated", "twin"][self as usize]
    }
}

/// Agreement of two bodies' signals, with equal weight per channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreement {
    /// Correlation coefficient, mean over channels.
    pub correlation: f64,
    /// ‖difference‖/‖measured‖, root mean square over channels (%).
    pub difference: f64,
    /// Delay of the measured signals at the largest correlation (instants).
    pub lag: i64,
}

/// Largest lag, in either direction (instants).
const LAGS: i64 = 20;

impl Agreement {
    /// Compares signals of shape (N, T, channels).
    pub fn of(measured: &[f64], simulated: &[f64], [instants, channels]: [usize; 2]) -> Self {
        // pairs of values of a channel within each record
        let pairs = |c: usize, lag: i64| {
            let shift = lag * channels as i64;
            let at = (c..measured.len()).step_by(channels);
            let inside = at.filter(move |at| {
                let n = (at / channels % instants) as i64 - lag;
                (0..instants as i64).contains(&n)
            });
            inside.map(move |at| (measured[at], simulated[(at as i64 - shift) as usize]))
        };
        let correlation = |lag: i64| {
            let of_channel = |c: usize| {
                let count = pairs(c, lag).count() as f64;
                let mean = pairs(c, lag).fold([0.0; 2], |[a, b], (m, s)| [a + m / count, b + s / count]);
                let [mm, ss, ms] = pairs(c, lag).fold([0.0; 3], |[mm, ss, ms], (m, s)| {
                    let (m, s) = (m - mean[0], s - mean[1]);
                    [mm + m * m, ss + s * s, ms + m * s]
                });
                ms / (mm * ss).sqrt().max(f64::MIN_POSITIVE)
            };
            (0..channels).map(of_channel).sum::<f64>() / channels as f64
        };
        let of_channel = |c: usize| {
            let power = pairs(c, 0).map(|(m, _)| m * m).sum::<f64>();
            pairs(c, 0).map(|(m, s)| (m - s).powi(2)).sum::<f64>() / power.max(f64::MIN_POSITIVE)
        };
        let difference = (0..channels).map(of_channel).sum::<f64>() / channels as f64;
        let most = LAGS.min(instants as i64 / 4);
        let lags: Vec<(f64, i64)> = (-most..=most).map(|lag| (correlation(lag), lag)).collect();
        // of equal correlations, as of constant signals, the least lag
        let order = |a: &(f64, i64), b: &(f64, i64)| a.0.total_cmp(&b.0).then(b.1.abs().cmp(&a.1.abs()));
        let best = lags.into_iter().max_by(order).map_or(0, |best| best.1);
        Self { correlation: correlation(0), difference: 100.0 * difference.sqrt(), lag: best }
    }
}

/// Ratio of two mean errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeanRatio {
    /// Mean of the first divided by mean of the second. Above 1: the second body is better.
    pub ratio: f64,
    /// 95 % interval over records; `None` with too few records.
    pub interval: Option<Interval>,
}

/// Returns the ratio of mean errors. `paired`: both bodies have the same records, which are drawn together.
pub fn mean_ratio(first: &BodyErrors, second: &BodyErrors, paired: bool) -> Option<MeanRatio> {
    let groups: Vec<Vec<Errors>> = match paired {
        true => {
            let both = first.errors.iter().zip(&second.errors).filter_map(|(a, b)| Some([(*a)?, (*b)?]));
            vec![both.map(|pair| pair.map(Some)).collect()]
        }
        false => vec![
            first.known().into_iter().map(|e| [Some(e), None]).collect(),
            second.known().into_iter().map(|e| [None, Some(e)]).collect(),
        ],
    };
    if groups.iter().any(Vec::is_empty) {
        return None;
    }
    let (log_ratio, _) = log_ratio(&groups)?;
    Some(MeanRatio { ratio: log_ratio.exp(), interval: interval(&groups) })
}

/// Errors of a record on both bodies.
type Errors = [Option<f64>; 2];

/// Sums over records per body, and over records with both errors.
#[derive(Default)]
struct Sums {
    count: [f64; 2],
    sum: [f64; 2],
    squares: [f64; 2],
    both: f64,
    products: f64,
}

impl Sums {
    fn add(&mut self, record: Errors) {
        for (body, error) in record.into_iter().enumerate() {
            if let Some(error) = error {
                self.count[body] += 1.0;
                self.sum[body] += error;
                self.squares[body] += error * error;
            }
        }
        if let [Some(first), Some(second)] = record {
            self.both += 1.0;
            self.products += first * second;
        }
    }

    /// Returns ln of the ratio of mean errors (first over second body; 1 in place of a missing mean) and its standard error by
    /// the influence function.
    fn log_ratio(&self) -> Option<(f64, f64)> {
        let (mut log, mut variance) = (0.0, 0.0);
        let mean = |body: usize| self.sum[body] / self.count[body];
        let pairs = |body: usize| self.count[body] * (self.count[body] - 1.0);
        for (body, sign) in [(0, 1.0), (1, -1.0)].into_iter().filter(|(body, _)| self.count[*body] > 0.0) {
            log += sign * mean(body).ln();
            variance += (self.squares[body] / mean(body).powi(2) - self.count[body]) / pairs(body);
        }
        if self.both > 0.0 {
            let shared = self.products / (mean(0) * mean(1)) - self.both;
            variance -= 2.0 * shared / (pairs(0) * pairs(1)).sqrt();
        }
        log.is_finite().then(|| (log, variance.max(0.0).sqrt()))
    }
}

/// Number of replicates; 2.5 % of one more is a whole number.
const STUDENTISED: usize = 999;

/// Returns the 95 % interval of that ratio by the studentised bootstrap within groups (Hall, Ann. Stat. 16, 927, 1988). Errors
/// of records are skewed, so Student's t would cover too rarely. `None` with too few records.
fn interval(groups: &[Vec<Errors>]) -> Option<Interval> {
    if groups.iter().any(|group| group.len() < LEAST_UNITS) {
        return None;
    }
    let (whole, error) = log_ratio(groups)?;
    let studentised = |replicate: usize| {
        let (mut draw, mut sums) = (Draw::numbered(SEED, replicate as u64), Sums::default());
        for group in groups {
            (0..group.len()).for_each(|_| sums.add(group[draw.below(group.len())]));
        }
        let (log, error) = sums.log_ratio()?;
        Some((log - whole) / error).filter(|t| t.is_finite())
    };
    let mut found: Vec<f64> = (0..STUDENTISED).filter_map(studentised).collect();
    found.sort_by(f64::total_cmp);
    if found.is_empty() {
        // all records have the same error
        return (error == 0.0).then(|| Interval { low: whole.exp(), high: whole.exp() });
    }
    let [low, high] = [0.025, 0.975].map(|q| quantile(&found, q));
    Some(Interval { low: whole - high * error, high: whole - low * error }.map(f64::exp))
}

fn log_ratio(groups: &[Vec<Errors>]) -> Option<(f64, f64)> {
    let mut sums = Sums::default();
    groups.iter().flatten().for_each(|record| sums.add(*record));
    sums.log_ratio()
}

/// Returns the interval of the mean of positive errors over records.
pub(super) fn mean_interval(errors: &[f64]) -> Option<Interval> {
    interval(&[errors.iter().map(|error| [Some(*error), None]).collect()])
}

impl BodyErrors {
    fn known(&self) -> Vec<f64> {
        self.errors.iter().flatten().copied().collect()
    }

    /// Mean error over records (%).
    pub fn error(&self) -> Option<f64> {
        mean(&self.known())
    }
}

/// Columns that apply only to trained decoders, and only to the inverse decoder.
const OF_TRAINED: [&str; 4] = ["error_train", "spread_folds", "spread_seeds", "iterations_ratio"];
const OF_INVERSE: [&str; 4] = ["coverage", "not_converged", "unexplained", "cpu_seconds"];

/// Returns one row per body and kind of signals; ratios are to the first body's row of the same kind. `delta`: time per instant
/// (s).
pub fn table(judged: &[BodyErrors], paired: bool, delta: f64) -> Table {
    let columns = "body signals records error_train error_test test_low test_high median p90 above spread_folds \
        spread_seeds ratio ratio_low ratio_high iterations_ratio correlation difference lag coverage \
        not_converged unexplained cpu_seconds";
    let row = |body: &BodyErrors| {
        let first = judged.iter().find(|other| other.by == body.by);
        let first = first.filter(|first| first.body != body.body);
        let ratio = first.and_then(|first| mean_ratio(first, body, paired));
        let mut known = body.known();
        known.sort_by(f64::total_cmp);
        let part = |q| (!known.is_empty()).then(|| quantile(&known, q));
        let [low, high] = ends(mean_interval(&known));
        let [ratio_low, ratio_high] = ends(ratio.and_then(|r| r.interval));
        let iterations = first.and_then(|first| iteration_ratio(&first.progress, &body.progress));
        let above = known.iter().filter(|error| **error > 100.0).count();
        let (agreement, inverse) = (body.agreement, body.posterior);
        [
            row![body.body, body.by.name(), body.errors.len(), body.error_train, body.error(), low, high],
            row![part(0.5), part(0.9), above, deviation(&body.by_fold), deviation(&body.by_seed)],
            row![ratio.map(|r| r.ratio), ratio_low, ratio_high, iterations],
            row![agreement.map(|a| a.correlation), agreement.map(|a| a.difference)],
            row![agreement.map(|a| a.lag as f64 * delta), inverse.map(|i| i.coverage)],
            row![inverse.map(|i| i.unconverged), inverse.map(|i| i.unexplained), inverse.map(|i| i.seconds)],
        ]
        .concat()
    };
    let mut table = Table::new(columns, judged.iter().map(row));
    let inverse = judged.iter().any(|body| body.posterior.is_some());
    table.drop_columns(if inverse { &OF_TRAINED } else { &OF_INVERSE });
    table
}

#[cfg(test)]
mod tests;
