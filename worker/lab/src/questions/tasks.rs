//! Errors of readouts of every task, fitted to one body's signals, and of the decoder of the forces.
//!
//! `direct` is ridge regression from the signals of the whole record to the labels (`brains::Readout`). `decoded` is the label of
//! forces that a linear decoder estimates. Samples without force and failed samples are not used.

use metasense_numerics::brain::prediction_error;
use metasense_numerics::brains::{Labeller, Labels, Readout, Task, classes};
use metasense_numerics::student::student;

/// Samples of a body, for training and for testing.
#[derive(Debug, Clone, Copy)]
pub struct Observations<'a> {
    /// Signals (N, T × channels), of comparable size.
    pub signals: &'a [f64],
    /// Forces (N, T, K) (N).
    pub forces: &'a [f64],
    /// Forces (N, T, K) (N) that a linear decoder estimates.
    pub decoded: &'a [f64],
    /// Training samples.
    pub train: &'a [usize],
    /// Test samples.
    pub judge: &'a [usize],
    /// Number of instants T.
    pub instants: usize,
    /// Computes labels from forces.
    pub labeller: &'a Labeller,
}

/// Result of a task.
#[derive(Debug, Clone, PartialEq)]
pub struct TaskEstimate {
    /// Name of the task, and unit of its error.
    pub task: (&'static str, &'static str),
    /// `"direct"` or `"decoded"`.
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
}

/// Estimates the forces and all tasks whose labels vary among the training samples; also returns the other tasks.
pub fn tasks(observations: &Observations) -> (Vec<TaskEstimate>, Vec<Task>) {
    let &Observations { train, judge, instants, labeller, .. } = observations;
    let varied = labeller.varied(&observations.pick(observations.forces, train), instants);
    let constant = Task::ALL.into_iter().filter(|task| !varied.contains(task)).collect();
    let known: Vec<(Task, Labels)> =
        varied.iter().map(|task| (*task, observations.labels(*task, observations.forces, train))).collect();
    let mut found = vec![observations.of_forces()];
    if known.is_empty() {
        return (found, constant);
    }
    let readout = Readout::new(&observations.pick(observations.signals, train), &known);
    let direct = readout.estimates(&observations.pick(observations.signals, judge));
    for ((task, known), direct) in known.into_iter().zip(direct) {
        let [truth, decoded] = [observations.forces, observations.decoded]
            .map(|forces| observations.labels(task, forces, judge));
        let trivial = vec![trivial(task, &known); truth.len()];
        let trivial = Score::of(task, &truth, &trivial).error;
        for (readout, estimated) in [("direct", direct), ("decoded", decoded)] {
            let Score { error, interval, score } = Score::of(task, &truth, &estimated);
            let least = match task {
                Task::Panel | Task::Count => 50.0 / truth.len() as f64,
                Task::Onset => 500.0 * labeller.interval / truth.len() as f64,
                Task::Position | Task::Peak | Task::Impulse => 0.0,
            };
            let (task, samples) = (task.name(), truth.len());
            found.push(TaskEstimate { task, readout, error, interval, least, trivial, samples, score });
        }
    }
    (found, constant)
}

impl Observations<'_> {
    /// Values of the listed samples.
    fn pick(&self, values: &[f64], samples: &[usize]) -> Vec<f64> {
        let count = self.forces.len() / (self.instants * self.labeller.points.len());
        let len = values.len() / count;
        samples.iter().flat_map(|&i| &values[i * len..][..len]).copied().collect()
    }

    fn labels(&self, task: Task, forces: &[f64], samples: &[usize]) -> Labels {
        let len = self.instants * self.labeller.points.len();
        samples.iter().map(|&i| self.labeller.label(task, &forces[i * len..][..len])).collect()
    }

    /// Mean error of the decoded forces (%).
    fn of_forces(&self) -> TaskEstimate {
        let [truth, said] = [self.forces, self.decoded].map(|forces| self.pick(forces, self.judge));
        let errors = prediction_error(&truth, &said, self.labeller.points.len(), self.instants);
        let errors: Vec<f64> = errors.into_iter().flatten().collect();
        let (error, interval) = mean(&errors);
        let squares = truth.iter().zip(&said).map(|(f, said)| (f - said).powi(2)).sum::<f64>();
        let average = truth.iter().sum::<f64>() / truth.len() as f64;
        let score = 1.0 - squares / truth.iter().map(|f| (f - average).powi(2)).sum::<f64>();
        let (least, trivial, samples) = (0.0, 100.0, errors.len());
        TaskEstimate {
            task: ("forces", "%"),
            readout: "decoded",
            error,
            interval,
            least,
            trivial,
            samples,
            score,
        }
    }
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
        let squares = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
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
