//! Bodies judged by records: each record's error is that of networks that have not seen it, a mean over seeds, or of the inverse brain.
//!
//! Intervals are for records drawn anew, of bodies under the same blows the same ones. They say how much other records
//! would differ, not other networks: for that there is the spread over folds and seeds.

use super::numbers::{deviation, mean, quantile};
use super::paired::iteration_ratio;
use super::resample::{Interval, LEAST_UNITS, SEED};
use super::trial::CurvePoint;
use metasense_numerics::random::Draw;
use metasense_render::{Table, row};

/// A body's errors by fresh networks.
#[derive(Debug, Clone, PartialEq)]
pub struct Judged {
    /// The body.
    pub body: String,
    /// Whose signals train and are read.
    pub by: By,
    /// Error of each record (%), a mean over seeds; `None` where there is none.
    pub errors: Vec<Option<f64>>,
    /// Mean error on training records (%).
    pub error_train: Option<f64>,
    /// Mean error of each seed's networks (%).
    pub by_seed: Vec<f64>,
    /// Mean error of each fold's records (%).
    pub by_fold: Vec<f64>,
    /// Mean error on unseen records at some iterations.
    pub progress: Vec<CurvePoint>,
    /// Of the model's or the twin's signals: how they agree with the measured ones.
    pub agreement: Option<Agreement>,
    /// Of the inverse brain.
    pub posterior: Option<Said>,
}

/// What the inverse brain says besides, of so many records.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Said {
    /// Part of the true forces that lies in the 95 % bands (%).
    pub coverage: f64,
    /// Descents that did not converge.
    pub unconverged: usize,
    /// Records that its model does not explain.
    pub unexplained: usize,
    /// CPU time of a record (s).
    pub seconds: f64,
}

/// Whose signals train the networks, and are read by them; by an inverse brain whose model reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum By {
    /// Measured ones.
    Measured,
    /// The trial's holdout.
    Holdout,
    /// Those of the trial's model.
    Simulated,
    /// Those of a twin train, measured ones are read.
    Twin,
}

impl By {
    /// The name by which people know it.
    pub fn name(self) -> &'static str {
        ["measured", "holdout", "simulated", "twin"][self as usize]
    }
}

/// How two bodies' signals agree, channels at equal weight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreement {
    /// Mean over channels of the coefficient of correlation.
    pub correlation: f64,
    /// Root mean square over channels of ‖difference‖/‖measured‖ (%).
    pub difference: f64,
    /// By how many instants the measured signals come later, where they correlate best.
    pub lag: i64,
}

/// Lags that are looked at, in instants, either way.
const LAGS: i64 = 20;

impl Agreement {
    /// Of signals (N, T, channels).
    pub fn of(measured: &[f64], simulated: &[f64], [instants, channels]: [usize; 2]) -> Self {
        // pairs of a channel, of the same record
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
        let best = lags.iter().max_by(|a, b| a.0.total_cmp(&b.0)).map_or(0, |best| best.1);
        Self { correlation: correlation(0), difference: 100.0 * difference.sqrt(), lag: best }
    }
}

/// The mean of the first over the mean of the second, with its interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeanRatio {
    /// Above 1 the second body is the better one.
    pub ratio: f64,
    /// 95 % over records; `None` of few.
    pub interval: Option<Interval>,
}

/// Ratio of mean errors. `paired`: record by record under the same blows, so that both are drawn together.
pub fn mean_ratio(first: &Judged, second: &Judged, paired: bool) -> Option<MeanRatio> {
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

/// A record's errors on both bodies.
type Errors = [Option<f64>; 2];

/// Sums over records, of each body and of records that have both errors.
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

    /// ln of the mean error on the first body over that on the second, 1 where no record has one, and its standard error by the
    /// influence of each record.
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

/// Replicates: 2.5 % of one more than these are whole.
const STUDENTISED: usize = 999;

/// The 95 % interval of that ratio by the studentised bootstrap, records drawn within their groups (Hall, Ann. Stat. 16, 927, 1988):
/// errors of records are skewed, and Student's t would leave out the mean too often. `None` of too few records.
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
        // all records say the same
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

/// Of the mean of positive errors, over records.
pub(super) fn mean_interval(errors: &[f64]) -> Option<Interval> {
    interval(&[errors.iter().map(|error| [Some(*error), None]).collect()])
}

impl Judged {
    fn known(&self) -> Vec<f64> {
        self.errors.iter().flatten().copied().collect()
    }

    /// Mean error over records (%).
    pub fn error(&self) -> Option<f64> {
        mean(&self.known())
    }
}

/// What only brains that are trained on records have, and what only the inverse one.
const OF_TRAINED: [&str; 4] = ["error_train", "spread_folds", "spread_seeds", "iterations_ratio"];
const OF_INVERSE: [&str; 4] = ["coverage", "not_converged", "unexplained", "cpu_seconds"];

/// A row a body and kind of signals; ratios are to the first body's row of the same kind. `delta` is an instant's length (s).
pub fn table(judged: &[Judged], paired: bool, delta: f64) -> Table {
    let columns = "body signals records error_train error_test test_low test_high median p90 above spread_folds \
        spread_seeds ratio ratio_low ratio_high iterations_ratio correlation difference lag coverage \
        not_converged unexplained cpu_seconds";
    let row = |body: &Judged| {
        let first = judged.iter().find(|other| other.by == body.by);
        let first = first.filter(|first| first.body != body.body);
        let ratio = first.and_then(|first| mean_ratio(first, body, paired));
        let mut known = body.known();
        known.sort_by(f64::total_cmp);
        let part = |q| (!known.is_empty()).then(|| quantile(&known, q));
        let test = mean_interval(&known);
        row![
            body.body,
            body.by.name(),
            body.errors.len(),
            body.error_train,
            body.error(),
            test.map(|i| i.low),
            test.map(|i| i.high),
            part(0.5),
            part(0.9),
            known.iter().filter(|error| **error > 100.0).count(),
            deviation(&body.by_fold),
            deviation(&body.by_seed),
            ratio.map(|r| r.ratio),
            ratio.and_then(|r| r.interval).map(|i| i.low),
            ratio.and_then(|r| r.interval).map(|i| i.high),
            first.and_then(|first| iteration_ratio(&first.progress, &body.progress)),
            body.agreement.map(|a| a.correlation),
            body.agreement.map(|a| a.difference),
            body.agreement.map(|a| a.lag as f64 * delta),
            body.posterior.map(|said| said.coverage),
            body.posterior.map(|said| said.unconverged),
            body.posterior.map(|said| said.unexplained),
            body.posterior.map(|said| said.seconds)
        ]
    };
    let mut table = Table::new(columns, judged.iter().map(row));
    let inverse = judged.iter().any(|body| body.posterior.is_some());
    table.drop_columns(if inverse { &OF_TRAINED } else { &OF_INVERSE });
    table
}

#[cfg(test)]
mod tests;
