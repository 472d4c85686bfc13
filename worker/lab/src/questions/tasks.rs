//! Sensing tasks besides force histories: which panel, how many, how hard, when; all from the same signals.
//!
//! `direct` is ridge regression from the signals of the whole record to the labels, with λ by leave-one-out (Hastie, Tibshirani
//! and Friedman, The Elements of Statistical Learning, eq. 7.64). Classes are ±1; the greatest output wins. `decoded` is the
//! label of forces that a linear decoder estimates. Samples without force and failed samples are not used.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use metasense_numerics::student::student;

/// Share of a sample's greatest force above which a panel counts as struck, and a force as started.
const BEGUN: f64 = 0.1;

/// A quantity to estimate from a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Task {
    /// The panel with the greatest force.
    Panel,
    /// The number of panels whose greatest force exceeds a tenth of the sample's.
    Count,
    /// The greatest force of each panel (N).
    Peak,
    /// ∫|f| dt of each panel (mN s).
    Impulse,
    /// Time at which a force first exceeds a tenth of the sample's greatest (ms).
    Onset,
}

impl Task {
    /// All tasks.
    pub const ALL: [Self; 5] = [Self::Panel, Self::Count, Self::Peak, Self::Impulse, Self::Onset];

    /// Name, and unit of the error: % of samples with a wrong class, or that of a mean absolute error.
    pub fn name(self) -> (&'static str, &'static str) {
        match self {
            Self::Panel => ("panel", "%"),
            Self::Count => ("count", "%"),
            Self::Peak => ("peak", "N"),
            Self::Impulse => ("impulse", "mN s"),
            Self::Onset => ("onset", "ms"),
        }
    }

    /// Whether its labels are classes.
    pub fn is_class(self) -> bool {
        matches!(self, Self::Panel | Self::Count)
    }

    /// Label of forces (T, K) at intervals `interval` (s).
    fn label(self, forces: &[f64], panels: usize, interval: f64) -> Vec<f64> {
        let of = |k: usize| forces.iter().skip(k).step_by(panels).map(|f| f.abs());
        let peaks: Vec<f64> = (0..panels).map(|k| of(k).fold(0.0, f64::max)).collect();
        let most = peaks.iter().copied().fold(0.0, f64::max);
        let begun = |f: &f64| f.abs() > BEGUN * most;
        match self {
            Self::Panel => vec![peaks.iter().position(|peak| *peak == most).unwrap_or(0) as f64],
            Self::Count => vec![peaks.iter().filter(|peak| begun(peak)).count() as f64],
            Self::Peak => peaks,
            Self::Impulse => (0..panels).map(|k| 1e3 * interval * of(k).sum::<f64>()).collect(),
            Self::Onset => {
                let at = forces.iter().position(begun).map_or(0, |at| at / panels);
                vec![1e3 * interval * (at + 1) as f64]
            }
        }
    }
}

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
    /// Number of panels K.
    pub panels: usize,
    /// Time between instants (s).
    pub interval: f64,
}

/// Result of a task.
#[derive(Debug, Clone, PartialEq)]
pub struct TaskEstimate {
    /// The task.
    pub task: Task,
    /// `"direct"` or `"decoded"`.
    pub readout: &'static str,
    /// Error in the task's unit.
    pub error: f64,
    /// 95 % confidence interval over samples.
    pub interval: [f64; 2],
    /// Resolution of the error: half the contribution of one wrong class, or of one instant; 0 without such steps.
    pub least: f64,
    /// Error of the most frequent class, or of the training samples' mean.
    pub trivial: f64,
    /// Number of test samples.
    pub samples: usize,
}

/// Estimates all tasks whose labels vary among the training samples; also returns the other tasks.
pub fn tasks(observations: &Observations) -> (Vec<TaskEstimate>, Vec<Task>) {
    let basis = Basis::new(observations);
    let (varied, constant): (Vec<Task>, Vec<Task>) = Task::ALL.into_iter().partition(|task| {
        let labels: Vec<Vec<f64>> =
            observations.train.iter().map(|&i| observations.label(*task, observations.forces, i)).collect();
        labels.iter().any(|label| *label != labels[0])
    });
    let read = |task: &Task| {
        let labels = |samples: &[usize], forces: &[f64]| -> Vec<Vec<f64>> {
            samples.iter().map(|&i| observations.label(*task, forces, i)).collect()
        };
        let [known, truth] =
            [observations.train, observations.judge].map(|samples| labels(samples, observations.forces));
        let decoded = labels(observations.judge, observations.decoded);
        let direct = if task.is_class() { basis.classes(&known) } else { basis.values(&known) };
        let trivial = vec![trivial(*task, &known); truth.len()];
        let trivial = Score::of(*task, &truth, &trivial).error;
        [("direct", direct), ("decoded", decoded)].map(|(readout, found)| {
            let Score { error, interval } = Score::of(*task, &truth, &found);
            let least = match task {
                Task::Panel | Task::Count => 50.0 / truth.len() as f64,
                Task::Onset => 500.0 * observations.interval / truth.len() as f64,
                Task::Peak | Task::Impulse => 0.0,
            };
            TaskEstimate { task: *task, readout, error, interval, least, trivial, samples: truth.len() }
        })
    };
    (varied.iter().flat_map(read).collect(), constant)
}

impl Observations<'_> {
    fn label(&self, task: Task, forces: &[f64], sample: usize) -> Vec<f64> {
        let len = self.instants * self.panels;
        task.label(&forces[sample * len..][..len], self.panels, self.interval)
    }
}

/// Label without use of signals.
fn trivial(task: Task, known: &[Vec<f64>]) -> Vec<f64> {
    if task.is_class() {
        let count = |label: &&Vec<f64>| known.iter().filter(|other| other == label).count();
        return known.iter().max_by_key(count).expect("there are training samples").clone();
    }
    (0..known[0].len())
        .map(|k| known.iter().map(|label| label[k]).sum::<f64>() / known.len() as f64)
        .collect()
}

/// An error and its interval.
struct Score {
    error: f64,
    interval: [f64; 2],
}

impl Score {
    /// Compares estimated with true labels: Wilson's interval for classes, Student's t for values.
    fn of(task: Task, truth: &[Vec<f64>], found: &[Vec<f64>]) -> Self {
        let n = truth.len() as f64;
        let pairs = truth.iter().zip(found);
        if task.is_class() {
            let error_rate = pairs.filter(|(a, b)| a != b).count() as f64 / n;
            let z = student(truth.len() - 1);
            let (middle, scale) = ((error_rate + z * z / (2.0 * n)), 1.0 + z * z / n);
            let half = z * (error_rate * (1.0 - error_rate) / n + z * z / (4.0 * n * n)).sqrt();
            let interval =
                [(middle - half) / scale, (middle + half) / scale].map(|x| 100.0 * x.clamp(0.0, 1.0));
            return Self { error: 100.0 * error_rate, interval };
        }
        let of = |(a, b): (&Vec<f64>, &Vec<f64>)| {
            a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f64>() / a.len() as f64
        };
        let errors: Vec<f64> = pairs.map(of).collect();
        let error = errors.iter().sum::<f64>() / n;
        let variance = errors.iter().map(|e| (e - error).powi(2)).sum::<f64>() / (n - 1.0);
        let half = student(truth.len() - 1) * (variance / n).sqrt();
        Self { error, interval: [(error - half).max(0.0), error + half] }
    }
}

/// Inner products of the samples' centred signals, for ridge regressions to any labels.
struct Basis {
    /// Eigenvectors and eigenvalues for the training samples.
    own: SymmetricEigen<f64, nalgebra::Dyn>,
    /// Products of test samples with training samples.
    others: DMatrix<f64>,
}

/// Exponents of λ = 10² … 10⁻⁸ times the mean eigenvalue.
const RIDGES: std::ops::RangeInclusive<i32> = -2..=8;
/// Eigenvalues below this share of the greatest count as 0; centring leaves one of this size by rounding.
const ROUNDING: f64 = 1e-12;

impl Basis {
    fn new(seen: &Observations) -> Self {
        let len = seen.signals.len() / (seen.forces.len() / (seen.instants * seen.panels));
        let rows = |samples: &[usize]| {
            DMatrix::from_fn(samples.len(), len, |i, j| seen.signals[samples[i] * len + j])
        };
        let (mut train, mut judge) = (rows(seen.train), rows(seen.judge));
        let mean = train.row_mean();
        for rows in [&mut train, &mut judge] {
            rows.row_iter_mut().for_each(|mut row| row -= &mean);
        }
        let mut own = SymmetricEigen::new(&train * train.transpose());
        let least = ROUNDING * own.eigenvalues.max();
        own.eigenvalues.apply(|value| *value = if *value < least { 0.0 } else { *value });
        Self { own, others: judge * train.transpose() }
    }

    /// Labels of the test samples; each output has its own λ.
    fn values(&self, known: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let outputs: Vec<DVector<f64>> = (0..known[0].len())
            .map(|k| self.predicted(&DVector::from_iterator(known.len(), known.iter().map(|label| label[k]))))
            .collect();
        (0..self.others.nrows()).map(|i| outputs.iter().map(|output| output[i]).collect()).collect()
    }

    /// Class with the greatest output; outputs are fitted to 1 for their class and −1 for others.
    fn classes(&self, known: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let mut classes: Vec<f64> = known.iter().map(|label| label[0]).collect();
        classes.sort_by(f64::total_cmp);
        classes.dedup();
        let sign = |is: bool| if is { 1.0 } else { -1.0 };
        let coded: Vec<Vec<f64>> = known
            .iter()
            .map(|label| classes.iter().map(|class| sign(label[0] == *class)).collect())
            .collect();
        let greatest = |outputs: &Vec<f64>| {
            let best = (0..classes.len()).max_by(|&a, &b| outputs[a].total_cmp(&outputs[b]));
            vec![classes[best.expect("there is a class")]]
        };
        self.values(&coded).iter().map(greatest).collect()
    }

    /// Mean y + K' (K + λ)⁻¹ (y − mean y), λ with the least leave-one-out error, whose residuals are λα / (λ (K + λ)⁻¹ᵢᵢ − 1/n).
    fn predicted(&self, y: &DVector<f64>) -> DVector<f64> {
        let SymmetricEigen { eigenvectors: q, eigenvalues } = &self.own;
        let (scale, mean, n) = (eigenvalues.mean().max(f64::MIN_POSITIVE), y.mean(), y.len());
        let turned = q.tr_mul(&y.add_scalar(-mean));
        let solved = RIDGES.map(|decade| {
            let ridge = scale * 10f64.powi(-decade);
            let inverse = eigenvalues.map(|value| 1.0 / (value + ridge));
            let weights = q * inverse.component_mul(&turned);
            let residual = |i: usize| {
                let own: f64 = (0..n).map(|j| q[(i, j)].powi(2) * inverse[j]).sum();
                ridge * weights[i] / (ridge * own - 1.0 / n as f64)
            };
            ((0..n).map(|i| residual(i).powi(2)).sum::<f64>(), weights)
        });
        let (_, weights) = solved.min_by(|a, b| a.0.total_cmp(&b.0)).expect("there is a λ");
        (&self.others * weights).add_scalar(mean)
    }
}

#[cfg(test)]
mod tests;
