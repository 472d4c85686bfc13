//! Errors of readouts of every task, fitted to one body's signals, and of the decoder of the forces.
//!
//! `direct` is ridge regression from the signals of the record, or of its window, to the labels ([`Readout`]). `decoded` is the label of
//! forces that a linear decoder estimates. In a window, `kernel` is kernel ridge regression. Samples without force and failed samples are not used.

use super::window::{Window, shifted};
use super::{Calibration, Labeller, Labels, RECORDS_MIN, Readout, Task, classes};
use crate::brain::linear::Sizes;
use crate::brain::prediction_error;
use crate::student::student;
use crate::trial::{Decoder, Samples, Trial, Trouble, pick};

/// Result of a task.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TaskEstimate {
    /// Name of the task, and unit of its error.
    pub task: (&'static str, &'static str),
    /// `"direct"`, `"kernel"` or `"decoded"`.
    pub readout: &'static str,
    /// Error in the task's unit.
    pub error: f64,
    /// 95 % confidence interval over samples.
    pub interval: [f64; 2],
    /// Resolution of the error: half the contribution of one wrong class, or of one instant; 0 without such steps.
    pub least: f64,
    /// Error of the most frequent class, of the training samples' mean, or of zero forces.
    pub trivial: f64,
    /// Number of test samples.
    pub samples: usize,
    /// Balanced accuracy (%) of classes; R² of values.
    pub score: f64,
    /// Of a class, true class, estimated class, number of samples; of a position, panel with the greatest force, mean error (mm),
    /// number of samples; else empty.
    pub detail: Vec<[f64; 3]>,
    /// Calibration of the probabilities of classes, except of decoded ones.
    pub calibration: Option<Calibration>,
    /// Mean error over casts of the body, with the readout fitted to the body as designed.
    pub casts: Option<f64>,
}

/// Training and test samples of a body.
struct Observations<'a> {
    /// Signals of both sets in their windows (N, len × channels), of comparable size.
    signals: [&'a [f64]; 2],
    /// First instants of the windows of both sets (N).
    starts: [&'a [usize]; 2],
    /// Forces of both sets (N, T, K) (N).
    forces: [&'a [f64]; 2],
    /// Parts of the mixture of both sets (N).
    parts: [&'a [usize]; 2],
    /// Forces of the test set (N, T, K) (N) that a linear decoder estimates.
    decoded: &'a [f64],
    /// Whether windows start with the contact.
    windowed: bool,
    /// Number of instants T.
    instants: usize,
    /// Computes labels.
    labeller: &'a Labeller,
}

/// Estimates of the forces, and of all tasks whose labels vary among the training samples, on the held-out set. The training, test
/// and held-out samples are those of one body; `casts` are held-out samples of its casts. A cast that fails has the trivial error.
///
/// # Errors
/// If training or held-out samples with force are too few, or the linear decoder has no solution.
pub(crate) fn task_estimates(
    trial: &Trial,
    sets: &[Samples; 3],
    casts: impl Iterator<Item = Result<Samples, Trouble>>,
) -> Result<Vec<TaskEstimate>, Trouble> {
    let Sizes { instants, channels, .. } = sets[0].sizes;
    let ([train, _, holdout], scales) = (trial.problem.parts(), &trial.scales);
    let with_force = |set: &Samples, parts: &[usize]| {
        let used = set.with_force();
        let found = (set.select(&used), pick(parts, parts.len(), &used));
        if used.len() < RECORDS_MIN { Err(Trouble::FewForces) } else { Ok(found) }
    };
    let (known, known_parts) = with_force(&sets[0], &train)?;
    let window = Window::of(trial);
    let seen = |signals: &[f64]| {
        let whole = scales.inputs::<f64>(signals);
        let starts = window.starts(&whole);
        (window.signals(&whole, &starts), starts)
    };
    let (inputs, starts) = seen(&known.signals);
    let decoder = Decoder::whole(instants, channels);
    let fitted = decoder.fit(trial.problem.seed, &sets[0], Some(scales.channels.clone()), trial.pool)?;
    let labeller = trial.problem.labeller();
    let estimates = |test: &Samples| {
        let (test, parts) = with_force(test, &holdout)?;
        let (test_inputs, test_starts) = seen(&test.signals);
        Ok(tasks(&Observations {
            signals: [&inputs, &test_inputs],
            starts: [&starts, &test_starts],
            forces: [&known.targets, &test.targets],
            parts: [&known_parts, &parts],
            decoded: &fitted.predict(&test.signals),
            windowed: trial.problem.tasks.window.is_some(),
            instants,
            labeller: &labeller,
        }))
    };
    let mut found = estimates(&sets[2])?;
    let casts: Vec<Result<Vec<TaskEstimate>, Trouble>> = casts.map(|cast| estimates(&cast?)).collect();
    for (n, nominal) in found.iter_mut().enumerate().filter(|_| !casts.is_empty()) {
        let error =
            |cast: &Result<Vec<TaskEstimate>, _>| cast.as_ref().map_or(nominal.trivial, |own| own[n].error);
        nominal.casts = Some(casts.iter().map(error).sum::<f64>() / casts.len() as f64);
    }
    Ok(found)
}

/// Estimates the forces and all tasks whose labels vary among the training samples.
fn tasks(observations: &Observations) -> Vec<TaskEstimate> {
    let &Observations { signals, starts, forces, parts, decoded, windowed, instants, labeller } =
        observations;
    let labels = |task: Task, forces: &[f64], parts: &[usize]| -> Labels {
        let samples = forces.chunks_exact(instants * labeller.points.len()).zip(parts);
        samples.map(|(own, part)| labeller.label(task, own, *part)).collect()
    };
    let varied = labeller.varied(forces[0], parts[0], instants).into_iter();
    let known: Vec<(Task, Labels)> = varied.map(|task| (task, labels(task, forces[0], parts[0]))).collect();
    let mut found = vec![observations.of_forces()];
    if known.is_empty() {
        return found;
    }
    let struck = labels(Task::Panel, forces[1], parts[1]);
    let moved = |task, labels, starts, sign| shifted(task, labels, starts, labeller.interval, sign);
    let in_window: Vec<(Task, Labels)> =
        known.iter().map(|(task, labels)| (*task, moved(*task, labels.clone(), starts[0], -1.0))).collect();
    let mut readouts = vec![("direct", Readout::new(signals[0], &in_window))];
    if windowed {
        readouts.push(("kernel", Readout::with_kernel(signals[0], &in_window)));
    }
    let truths: Vec<Labels> = known.iter().map(|(task, _)| labels(*task, forces[1], parts[1])).collect();
    let mut read: Vec<_> = readouts
        .iter()
        .map(|(name, readout)| {
            let calibrations = readout.calibrations(&known, signals[1], &truths);
            (*name, readout.estimates(signals[1]).into_iter().zip(calibrations))
        })
        .collect();
    for ((task, known), truth) in known.into_iter().zip(truths) {
        let from_signals = read.iter_mut().map(|(name, estimates)| {
            let (estimated, calibration) = estimates.next().expect("one per task");
            (*name, moved(task, estimated, starts[1], 1.0), calibration)
        });
        let decoded = labels(task, decoded, parts[1]);
        let trivial = error_of(task, &truth, &vec![trivial(task, &known); truth.len()]);
        // forces do not determine the part that generated them
        let decoded = (task != Task::Kind).then_some(("decoded", decoded, None));
        for (readout, estimated, calibration) in from_signals.chain(decoded) {
            let Score { error, interval, score } = Score::of(task, &truth, &estimated);
            let least = match task {
                Task::Panel | Task::Count | Task::Kind => 50.0 / truth.len() as f64,
                Task::Onset => 500.0 * labeller.interval / truth.len() as f64,
                Task::Position | Task::Peak | Task::Impulse => 0.0,
            };
            let detail = detail(task, &truth, &estimated, &struck);
            let (task, samples) = (task.name(), truth.len());
            found.push(TaskEstimate {
                task,
                readout,
                error,
                interval,
                least,
                trivial,
                samples,
                score,
                detail,
                calibration,
                casts: None,
            });
        }
    }
    found
}

/// Confusion counts of classes, or the mean error of positions per struck panel, as in [`TaskEstimate::detail`].
fn detail(task: Task, truth: &Labels, estimated: &Labels, struck: &Labels) -> Vec<[f64; 3]> {
    let mut rows: Vec<[f64; 3]> = truth
        .iter()
        .zip(estimated)
        .zip(struck)
        .filter_map(|((truth, estimated), struck)| match task {
            _ if task.is_class() => Some([truth[0], estimated[0], 1.0]),
            Task::Position => Some([struck[0], squares(truth, estimated).sqrt(), 1.0]),
            _ => None,
        })
        .collect();
    let key = |row: &[f64; 3]| [row[0], if task.is_class() { row[1] } else { 0.0 }];
    rows.sort_by(|a, b| key(a).partial_cmp(&key(b)).expect("classes are numbers"));
    let merged = rows.chunk_by(|a, b| key(a) == key(b)).map(|same| {
        let count = same.len() as f64;
        [same[0][0], same.iter().map(|row| row[1]).sum::<f64>() / count, count]
    });
    merged.collect()
}

/// Σ (a − b)².
fn squares(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum()
}

impl Observations<'_> {
    /// Mean error of the decoded forces (%).
    fn of_forces(&self) -> TaskEstimate {
        let (truth, said) = (self.forces[1], self.decoded);
        let errors = prediction_error(truth, said, self.labeller.points.len(), self.instants);
        let errors: Vec<f64> = errors.into_iter().flatten().collect();
        let (error, interval) = mean(&errors);
        let average = truth.iter().sum::<f64>() / truth.len() as f64;
        let score = 1.0 - squares(truth, said) / truth.iter().map(|f| (f - average).powi(2)).sum::<f64>();
        TaskEstimate {
            task: ("forces", "%"),
            readout: "decoded",
            error,
            interval,
            trivial: 100.0,
            samples: errors.len(),
            score,
            ..TaskEstimate::default()
        }
    }
}

/// Error of estimated labels in the task's unit.
pub(super) fn error_of(task: Task, truth: &Labels, estimated: &Labels) -> f64 {
    Score::of(task, truth, estimated).error
}

/// Label without use of signals.
fn trivial(task: Task, known: &Labels) -> Vec<f64> {
    if task.is_class() {
        let count = |label: &&Vec<f64>| known.iter().filter(|other| other == label).count();
        return known.iter().max_by_key(count).expect("there are training samples").clone();
    }
    (0..known[0].len())
        .map(|k| known.iter().map(|label| label[k]).sum::<f64>() / known.len() as f64)
        .collect()
}

/// Mean of errors, and Student's 95 % interval.
fn mean(errors: &[f64]) -> (f64, [f64; 2]) {
    let n = errors.len() as f64;
    let error = errors.iter().sum::<f64>() / n;
    let variance = errors.iter().map(|e| (e - error).powi(2)).sum::<f64>() / (n - 1.0);
    let half = student(errors.len() - 1) * (variance / n).sqrt();
    (error, [(error - half).max(0.0), error + half])
}

/// An error and its interval; balanced accuracy (%) or R².
struct Score {
    error: f64,
    interval: [f64; 2],
    score: f64,
}

impl Score {
    /// Compares estimated with true labels: Wilson's interval for classes, Student's t for values. The error of a position is a
    /// distance.
    fn of(task: Task, truth: &Labels, found: &Labels) -> Self {
        let n = truth.len() as f64;
        let pairs = || truth.iter().zip(found);
        if task.is_class() {
            let error_rate = pairs().filter(|(a, b)| a != b).count() as f64 / n;
            let z = student(truth.len() - 1);
            let (middle, scale) = ((error_rate + z * z / (2.0 * n)), 1.0 + z * z / n);
            let half = z * (error_rate * (1.0 - error_rate) / n + z * z / (4.0 * n * n)).sqrt();
            let interval =
                [(middle - half) / scale, (middle + half) / scale].map(|x| 100.0 * x.clamp(0.0, 1.0));
            let classes = classes(truth);
            let recall = |class: &f64| {
                let own: Vec<bool> = pairs().filter(|(a, _)| a[0] == *class).map(|(a, b)| a == b).collect();
                own.iter().filter(|right| **right).count() as f64 / own.len() as f64
            };
            let score = 100.0 * classes.iter().map(recall).sum::<f64>() / classes.len() as f64;
            return Self { error: 100.0 * error_rate, interval, score };
        }
        let error = |(a, b): (&Vec<f64>, &Vec<f64>)| match task {
            Task::Position => squares(a, b).sqrt(),
            _ => a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f64>() / a.len() as f64,
        };
        let (error, interval) = mean(&pairs().map(error).collect::<Vec<_>>());
        let average: Vec<f64> =
            (0..truth[0].len()).map(|k| truth.iter().map(|label| label[k]).sum::<f64>() / n).collect();
        let variation: f64 = truth.iter().map(|label| squares(label, &average)).sum();
        let score = 1.0 - pairs().map(|(a, b)| squares(a, b)).sum::<f64>() / variation;
        Self { error, interval, score }
    }
}

#[cfg(test)]
mod tests;
