//! Bodies judged by records: each record's error is that of networks that have not seen it, a mean over seeds, or of the inverse brain.
//!
//! Intervals are for records drawn anew, of bodies under the same blows the same ones. They say how much other records
//! would differ, not other networks: for that there is the spread over folds and seeds.

use super::numbers::{deviation, mean};
use super::paired::iteration_ratio;
use super::resample::{Interval, Resampling};
use super::trial::CurvePoint;
use crate::look::{Table, row};

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

/// Ratio of mean errors. `paired`: record by record under the same blows, so that both leave out the same one.
pub fn mean_ratio(first: &Judged, second: &Judged, paired: bool) -> Option<MeanRatio> {
    let both = first.errors.iter().zip(&second.errors).filter_map(|(a, b)| Some([(*a)?, (*b)?]));
    // of each record its error on either body
    let records: Vec<[Option<f64>; 2]> = match paired {
        true => both.map(|pair| pair.map(Some)).collect(),
        false => {
            let second = second.known().into_iter().map(|e| [None, Some(e)]);
            first.known().into_iter().map(|e| [Some(e), None]).chain(second).collect()
        }
    };
    let log_ratio = |weights: &[f64]| {
        let [a, b] = [0, 1].map(|body: usize| {
            let of_body = records.iter().zip(weights).filter_map(|(r, w)| Some([w * r[body]?, *w]));
            let [sum, weight] = of_body.fold([0.0; 2], |[s, n], [e, w]| [s + e, n + w]);
            sum / weight
        });
        Some((a / b).ln()).filter(|l| l.is_finite())
    };
    let ratio = log_ratio(&vec![1.0; records.len()])?.exp();
    let interval = over_records(records.len()).interval(log_ratio).map(|i| i.map(f64::exp));
    Some(MeanRatio { ratio, interval })
}

/// Records are independent of each other.
fn over_records(count: usize) -> Resampling {
    Resampling::of([(["record", "records"], (0..count as u64).collect())])
}

/// Of the mean of positive errors, over records.
pub(super) fn mean_interval(errors: &[f64]) -> Option<Interval> {
    let log_mean = |weights: &[f64]| {
        let sum: f64 = weights.iter().zip(errors).map(|(w, e)| w * e).sum();
        Some((sum / weights.iter().sum::<f64>()).ln()).filter(|l| l.is_finite())
    };
    over_records(errors.len()).interval(log_mean).map(|i| i.map(f64::exp))
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
    let columns = "body signals records error_train error_test test_low test_high spread_folds \
        spread_seeds ratio ratio_low ratio_high iterations_ratio correlation difference lag coverage \
        not_converged unexplained cpu_seconds";
    let row = |body: &Judged| {
        let first = judged.iter().find(|other| other.by == body.by);
        let first = first.filter(|first| first.body != body.body);
        let ratio = first.and_then(|first| mean_ratio(first, body, paired));
        let test = mean_interval(&body.known());
        row![
            body.body,
            body.by.name(),
            body.errors.len(),
            body.error_train,
            body.error(),
            test.map(|i| i.low),
            test.map(|i| i.high),
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
