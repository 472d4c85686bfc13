//! Errors of readouts of every task, fitted to one body's signals, and of the decoder of the forces.
//!
//! `direct` is ridge regression from the signals of the record, or of its window, to the labels ([`Readout`]); in a window, `network`
//! is a small network per task. `decoded` is the label of forces that a linear decoder estimates. Samples without force and failed
//! samples are not used.

use super::network::Network;
use super::window::{Window, shifted};
use super::{Calibration, Labeller, Labels, RECORDS_MIN, Readout, SensingTask, classes};
use crate::Pool;
use crate::brain::linear::Sizes;
use crate::brain::prediction_error;
use crate::student::student;
use crate::trial::{Decoder, PreparedTrial, Result, Samples, Trouble, pick};

/// Result of a task.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TaskEstimate {
    /// Name of the task, and unit of its error.
    pub task: (&'static str, &'static str),
    /// `"direct"`, `"network"` or `"decoded"`.
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

/// Labels that a readout estimates, with its name; calibration of classes.
type Estimated = (&'static str, Labels, Option<Calibration>);

/// Samples of a body.
struct Observations {
    /// Signals in their windows (N, len × channels), of comparable size.
    signals: Vec<f64>,
    /// First instants of the windows (N).
    starts: Vec<usize>,
    /// Forces (N, T, K) (N).
    forces: Vec<f64>,
    /// Parts of the mixture (N).
    parts: Vec<usize>,
}

impl Observations {
    /// Labels of these forces (N, T, K) for a task.
    fn labels(&self, labeller: &Labeller, task: SensingTask, forces: &[f64]) -> Labels {
        let samples = forces.chunks_exact(forces.len() / self.parts.len()).zip(&self.parts);
        samples.map(|(own, part)| labeller.label(task, own, *part)).collect()
    }
}

/// Readouts of all tasks whose labels vary among the training samples.
struct Fits<'a> {
    labeller: &'a Labeller,
    /// Labels of the training samples, by task.
    known: Vec<(SensingTask, Labels)>,
    readout: Option<Readout>,
    /// The window of networks, and one network per task.
    networks: Option<(&'a Window, Vec<Network>)>,
}

impl<'a> Fits<'a> {
    /// Fits readouts; with a window and a seed, also trains networks.
    fn new(
        known: &Observations,
        instants: usize,
        labeller: &'a Labeller,
        networks: Option<(&'a Window, u64, &Pool)>,
    ) -> Self {
        let varied = labeller.varied(&known.forces, &known.parts, instants).into_iter();
        let labels: Vec<(SensingTask, Labels)> =
            varied.map(|task| (task, known.labels(labeller, task, &known.forces))).collect();
        let move_back = |(task, labels): &(SensingTask, Labels)| {
            (*task, shifted(*task, labels.clone(), &known.starts, labeller.interval, -1.0))
        };
        let in_window: Vec<(SensingTask, Labels)> = labels.iter().map(move_back).collect();
        let readout = (!labels.is_empty()).then(|| Readout::new(&known.signals, &in_window));
        let train = |(window, seed, pool): (&'a Window, u64, &Pool)| {
            let sums = window.sums(&known.signals);
            let one = |(task, labels): &(SensingTask, Labels)| {
                pool.heartbeat().beat();
                Network::new(seed, *task, &sums, labels)
            };
            (window, in_window.iter().map(one).collect())
        };
        Self { labeller, networks: networks.map(train), known: labels, readout }
    }

    /// Labels that readouts and networks estimate from the signals of test samples, per task.
    fn estimates(&self, test: &Observations, truths: &[Labels]) -> Vec<Vec<Estimated>> {
        let Some(readout) = &self.readout else { return Vec::new() };
        let direct = readout.estimates(&test.signals).into_iter();
        let direct = direct.zip(readout.calibrations(&self.known, &test.signals, truths));
        let mut found: Vec<Vec<_>> =
            direct.map(|(labels, calibration)| vec![("direct", labels, calibration)]).collect();
        if let Some((window, networks)) = &self.networks {
            let sums = window.sums(&test.signals);
            for (k, network) in networks.iter().enumerate() {
                let (labels, calibration) = network.estimates(&sums, &truths[k], self.known[k].1.len());
                found[k].push(("network", labels, calibration));
            }
        }
        for ((task, _), own) in self.known.iter().zip(&mut found) {
            for (_, labels, _) in own {
                *labels = shifted(*task, std::mem::take(labels), &test.starts, self.labeller.interval, 1.0);
            }
        }
        found
    }
}

/// Estimates of the forces, and of all tasks whose labels vary among the training samples, on the held-out set. The training, test
/// and held-out samples are those of one body; `casts` are held-out samples of its casts. A cast that fails has the trivial error.
///
/// # Errors
/// If training or held-out samples with force are too few, or the linear decoder has no solution.
pub(crate) fn task_estimates(
    trial: &PreparedTrial,
    sets: &[Samples; 3],
    casts: impl Iterator<Item = Result<Samples>>,
) -> Result<Vec<TaskEstimate>> {
    let Sizes { instants, channels, .. } = sets[0].sizes;
    let ([train, _, holdout], scales) = (trial.problem.parts(), &trial.scales);
    let window = Window::of(trial);
    // with the signals of the whole record
    let observe = |set: &Samples, parts: &[usize]| {
        let used = set.with_force();
        if used.len() < RECORDS_MIN {
            return Err(Trouble::FewForces);
        }
        let Samples { signals: whole, targets: forces, .. } = set.select(&used);
        let inputs = scales.inputs(&whole);
        let starts = window.starts(&inputs);
        let signals = window.signals(&inputs, &starts);
        Ok((Observations { signals, starts, forces, parts: pick(parts, parts.len(), &used) }, whole))
    };
    let (known, _) = observe(&sets[0], &train)?;
    let labeller = trial.problem.labeller();
    let networks = trial.problem.tasks.window.map(|_| (&window, trial.problem.seed, trial.pool));
    let fits = Fits::new(&known, instants, &labeller, networks);
    let decoder = Decoder::whole(instants, channels);
    let fitted = decoder.fit(trial.problem.seed, &sets[0], Some(scales.channels.clone()), trial.pool)?;
    let estimates = |test: &Samples| {
        let (test, whole) = observe(test, &holdout)?;
        Ok(tasks(&fits, &test, &fitted.predict(&whole)))
    };
    let mut found = estimates(&sets[2])?;
    let casts: Vec<Result<Vec<TaskEstimate>>> = casts.map(|cast| estimates(&cast?)).collect();
    for (n, nominal) in found.iter_mut().enumerate().filter(|_| !casts.is_empty()) {
        let error =
            |cast: &Result<Vec<TaskEstimate>>| cast.as_ref().map_or(nominal.trivial, |own| own[n].error);
        nominal.casts = Some(casts.iter().map(error).sum::<f64>() / casts.len() as f64);
    }
    Ok(found)
}

/// Estimates of the forces and all tasks on test samples, whose forces (N, T, K) (N) a linear decoder estimates as `decoded`.
fn tasks(fits: &Fits, test: &Observations, decoded: &[f64]) -> Vec<TaskEstimate> {
    let labeller = fits.labeller;
    let mut found = vec![of_forces(&test.forces, decoded, labeller, test.parts.len())];
    let struck = test.labels(labeller, SensingTask::Panel, &test.forces);
    let truths: Vec<Labels> =
        fits.known.iter().map(|(task, _)| test.labels(labeller, *task, &test.forces)).collect();
    let from_signals = fits.estimates(test, &truths);
    for (((task, known), truth), read) in fits.known.iter().zip(&truths).zip(from_signals) {
        let task = *task;
        let decoded = test.labels(labeller, task, decoded);
        let trivial = TaskEstimate::of(task, truth, &vec![trivial(task, known); truth.len()]).error;
        // forces do not determine the part that generated them
        let decoded = (task != SensingTask::Kind).then_some(("decoded", decoded, None));
        for (readout, estimated, calibration) in read.into_iter().chain(decoded) {
            let least = match task {
                SensingTask::Panel | SensingTask::Count | SensingTask::Kind => 50.0 / truth.len() as f64,
                SensingTask::Onset => 500.0 * labeller.interval / truth.len() as f64,
                SensingTask::Position | SensingTask::Peak | SensingTask::Impulse => 0.0,
            };
            let detail = detail(task, truth, &estimated, &struck);
            let scored = TaskEstimate::of(task, truth, &estimated);
            found.push(TaskEstimate { readout, least, trivial, detail, calibration, ..scored });
        }
    }
    found
}

/// Confusion counts of classes, or the mean error of positions per struck panel, as in [`TaskEstimate::detail`].
fn detail(task: SensingTask, truth: &Labels, estimated: &Labels, struck: &Labels) -> Vec<[f64; 3]> {
    let mut rows: Vec<[f64; 3]> = truth
        .iter()
        .zip(estimated)
        .zip(struck)
        .filter_map(|((truth, estimated), struck)| match task {
            _ if task.is_class() => Some([truth[0], estimated[0], 1.0]),
            SensingTask::Position => Some([struck[0], squares(truth, estimated).sqrt(), 1.0]),
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

/// Mean error of decoded forces (N, T, K) (%), with their true ones.
fn of_forces(truth: &[f64], said: &[f64], labeller: &Labeller, samples: usize) -> TaskEstimate {
    let panels = labeller.points.len();
    let errors = prediction_error(truth, said, panels, truth.len() / panels / samples);
    let errors: Vec<f64> = errors.into_iter().flatten().collect();
    let (error, interval) = mean(&errors);
    let average = truth.iter().sum::<f64>() / truth.len() as f64;
    let score = 1.0 - squares(truth, said) / truth.iter().map(|f| (f - average).powi(2)).sum::<f64>();
    let (task, readout, samples) = (("forces", "%"), "decoded", errors.len());
    TaskEstimate { task, readout, error, interval, trivial: 100.0, samples, score, ..TaskEstimate::default() }
}

/// Label without use of signals.
fn trivial(task: SensingTask, known: &Labels) -> Vec<f64> {
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

impl TaskEstimate {
    /// Compares estimated with true labels: Wilson's interval for classes, Student's t for values. The error of a position is a
    /// distance. Sets only the task, the number of samples, the error, its interval and the score.
    pub(super) fn of(task: SensingTask, truth: &Labels, found: &Labels) -> Self {
        let n = truth.len() as f64;
        let own = Self { task: task.name(), samples: truth.len(), ..Self::default() };
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
            return Self { error: 100.0 * error_rate, interval, score, ..own };
        }
        let error = |(a, b): (&Vec<f64>, &Vec<f64>)| match task {
            SensingTask::Position => squares(a, b).sqrt(),
            _ => a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f64>() / a.len() as f64,
        };
        let (error, interval) = mean(&pairs().map(error).collect::<Vec<_>>());
        let average = trivial(task, truth);
        let variation: f64 = truth.iter().map(|label| squares(label, &average)).sum();
        let score = 1.0 - pairs().map(|(a, b)| squares(a, b)).sum::<f64>() / variation;
        Self { error, interval, score, ..own }
    }
}

#[cfg(test)]
mod tests;
