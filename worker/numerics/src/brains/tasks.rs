//! Sensing tasks besides force histories: which panel, where, how many, how hard, when; all from the same signals.
//!
//! A readout is a ridge regression from the signals of a record, or of a window from its first contact on (`window`), to the labels
//! (`readout`). Classes are ±1; the greatest output wins. The loss of a task is the leave-one-out error 1 − R²; that of several
//! tasks the geometric mean. Samples without force and failed samples are not used.

mod calibration;
mod estimates;
mod network;
mod weights;
mod window;

pub use calibration::Calibration;
pub use estimates::TaskEstimate;
pub(crate) use estimates::task_estimates;
pub(crate) use weights::task_readouts;
pub use weights::{ReadoutWeights, TaskReadouts};

use super::readout::{Basis, Output};
use super::{DecoderState, FitOn, FitResult, Implicit, Learner, Loss};
use crate::random::Purpose;
use crate::trial::{Counters, FAILED, PreparedTrial, Problem, Result, Samples, Trouble, pick};
use window::Window;

/// Share of a sample's greatest force above which a panel counts as struck, and a force as started.
const BEGUN: f64 = 0.1;
/// Least number of records to which a readout is fitted.
pub const RECORDS_MIN: usize = 10;

/// A quantity to estimate from a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SensingTask {
    /// The panel with the greatest force.
    Panel,
    /// The number of panels whose greatest force exceeds a tenth of the sample's.
    Count,
    /// Mean of the panels' positions on the initial body, weighted by their impulses: x and y (mm).
    Position,
    /// The greatest force of each panel (N).
    Peak,
    /// ∫|f| dt of each panel (mN s).
    Impulse,
    /// Time at which a force first exceeds a tenth of the sample's greatest (ms).
    Onset,
    /// The part of the mixture, from 0.
    Kind,
}

impl SensingTask {
    /// All tasks.
    pub const ALL: [Self; 7] =
        [Self::Panel, Self::Count, Self::Position, Self::Peak, Self::Impulse, Self::Onset, Self::Kind];

    /// Name, and unit of the error: % of samples with a wrong class, or that of a mean absolute error.
    pub fn name(self) -> (&'static str, &'static str) {
        match self {
            Self::Panel => ("panel", "%"),
            Self::Count => ("count", "%"),
            Self::Position => ("position", "mm"),
            Self::Peak => ("peak", "N"),
            Self::Impulse => ("impulse", "mN s"),
            Self::Onset => ("onset", "ms"),
            Self::Kind => ("kind", "%"),
        }
    }

    /// Whether its labels are classes.
    pub fn is_class(self) -> bool {
        matches!(self, Self::Panel | Self::Count | Self::Kind)
    }
}

/// What readouts estimate in the training and the final comparison, and from which signals.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Tasks {
    /// The quantities, without onsets if readouts have a window; empty: the decoder estimates the forces.
    pub trained: Vec<SensingTask>,
    /// Number of instants that a readout sees from the first contact on; `None`: the whole record.
    pub window: Option<usize>,
}

/// Label of each record for a task: a class, or values.
pub type Labels = Vec<Vec<f64>>;

/// The classes among labels, ascending.
fn classes(labels: &Labels) -> Vec<f64> {
    let mut classes: Vec<f64> = labels.iter().map(|label| label[0]).collect();
    classes.sort_by(f64::total_cmp);
    classes.dedup();
    classes
}

/// The class with the greatest output.
fn greatest(classes: &[f64], outputs: &[f64]) -> f64 {
    let best = (0..outputs.len()).max_by(|&a, &b| outputs[a].total_cmp(&outputs[b]));
    classes[best.expect("there is a class")]
}

/// Computes labels from forces and parts of a mixture.
#[derive(Debug, Clone, PartialEq)]
pub struct Labeller {
    /// Time between instants (s).
    pub interval: f64,
    /// Position of each panel (mm).
    pub points: Vec<[f64; 2]>,
}

impl Labeller {
    /// Label of forces (T, K) (N) of this part of a mixture.
    pub fn label(&self, task: SensingTask, forces: &[f64], part: usize) -> Vec<f64> {
        let (panels, interval) = (self.points.len(), self.interval);
        let of = |k: usize| forces.iter().skip(k).step_by(panels).map(|f| f.abs());
        let impulse = |k: usize| 1e3 * interval * of(k).sum::<f64>();
        let peaks: Vec<f64> = (0..panels).map(|k| of(k).fold(0.0, f64::max)).collect();
        let most = peaks.iter().copied().fold(0.0, f64::max);
        let begun = |f: &f64| f.abs() > BEGUN * most;
        match task {
            SensingTask::Panel => vec![peaks.iter().position(|peak| *peak == most).unwrap_or(0) as f64],
            SensingTask::Count => vec![peaks.iter().filter(|peak| begun(peak)).count() as f64],
            SensingTask::Position => {
                let total: f64 = (0..panels).map(impulse).sum();
                let mean = |d: usize| (0..panels).map(|k| impulse(k) * self.points[k][d]).sum::<f64>();
                [0, 1].map(|d| mean(d) / total.max(f64::MIN_POSITIVE)).to_vec()
            }
            SensingTask::Peak => peaks,
            SensingTask::Impulse => (0..panels).map(impulse).collect(),
            SensingTask::Onset => {
                let at = forces.iter().position(begun).map_or(0, |at| at / panels);
                vec![1e3 * interval * (at + 1) as f64]
            }
            SensingTask::Kind => vec![part as f64],
        }
    }

    /// The tasks whose labels differ among samples with these forces (N, T, K) (N) and parts (N). Samples without force do not
    /// count.
    pub fn varied(&self, forces: &[f64], parts: &[usize], instants: usize) -> Vec<SensingTask> {
        let samples = || forces.chunks_exact(instants * self.points.len()).zip(parts);
        let varies = |task: &SensingTask| {
            let has_force = |(own, _): &(&[f64], &usize)| own.iter().any(|f| *f != 0.0);
            let mut labels = samples().filter(has_force).map(|(own, part)| self.label(*task, own, *part));
            let first = labels.next();
            labels.any(|label| first.as_ref() != Some(&label))
        };
        SensingTask::ALL.into_iter().filter(varies).collect()
    }
}

impl Problem {
    /// The labels of the trial's forces.
    pub fn labeller(&self) -> Labeller {
        let scene = &self.scene;
        let points = match scene.layout.units() {
            0 => vec![[0.0; 2]; scene.panels.len()],
            _ => {
                let geometry = scene.geometry(&self.initial);
                let foot = |panel: &crate::dynamics::Panel| {
                    panel.foot(geometry.centroids[panel.unit], &geometry.vertices[panel.unit])
                };
                scene.panels.iter().map(foot).collect()
            }
        };
        Labeller { interval: self.interval(), points }
    }
}

/// Readouts of several tasks, fitted to the same records.
#[derive(Debug, Clone)]
pub struct Readout {
    basis: Basis,
    fits: Vec<TaskFit>,
}

/// The readout of a task.
#[derive(Debug, Clone)]
struct TaskFit {
    task: SensingTask,
    /// Classes, ascending; empty for values.
    classes: Vec<f64>,
    /// One per class or value.
    outputs: Vec<Output>,
    /// Σ (y − mean y)² over records and outputs.
    variation: f64,
}

impl TaskFit {
    fn new(task: SensingTask, basis: &Basis, labels: &Labels) -> Self {
        let classes = if task.is_class() { classes(labels) } else { Vec::new() };
        let mut fit = Self { task, classes, outputs: Vec::new(), variation: 0.0 };
        let targets: Labels = labels.iter().map(|label| fit.targets(label)).collect();
        let column = |k: usize| targets.iter().map(|target| target[k]).collect::<Vec<_>>();
        for targets in (0..targets[0].len()).map(column) {
            let mean = targets.iter().sum::<f64>() / targets.len() as f64;
            fit.variation += targets.iter().map(|y| (y - mean).powi(2)).sum::<f64>();
            fit.outputs.push(basis.fit(targets));
        }
        fit
    }

    /// Values of the outputs that stand for a label.
    fn targets(&self, label: &[f64]) -> Vec<f64> {
        match self.task.is_class() {
            true => self.classes.iter().map(|class| if label[0] == *class { 1.0 } else { -1.0 }).collect(),
            false => label.to_vec(),
        }
    }

    /// Leave-one-out error 1 − R².
    fn loss(&self) -> f64 {
        self.outputs.iter().map(Output::squares).sum::<f64>() / self.variation
    }
}

impl Readout {
    /// Fits readouts to the signals (N, p) of N records with these labels per task.
    pub fn new(signals: &[f64], tasks: &[(SensingTask, Labels)]) -> Self {
        let basis = Basis::new(signals, tasks[0].1.len());
        let fits = tasks.iter().map(|(task, labels)| TaskFit::new(*task, &basis, labels)).collect();
        Self { basis, fits }
    }

    /// Estimated labels per task, from the signals (n, p) of any records.
    pub fn estimates(&self, signals: &[f64]) -> Vec<Labels> {
        let estimate = |fit: &TaskFit| {
            let outputs = self.basis.predict(&fit.outputs, signals);
            let rows = outputs.row_iter().map(|row| row.iter().copied().collect());
            if fit.task.is_class() {
                rows.map(|own: Vec<f64>| vec![greatest(&fit.classes, &own)]).collect()
            } else {
                rows.collect()
            }
        };
        self.fits.iter().map(estimate).collect()
    }

    /// Error (%) of records with these signals (n, p) and labels per task: squared errors of the outputs relative to their mean
    /// variation among the records of the fit; the mean over tasks.
    fn errors(&self, signals: &[f64], tasks: &[(SensingTask, Labels)]) -> Vec<f64> {
        let mut errors = vec![0.0; tasks[0].1.len()];
        for (fit, (_, labels)) in self.fits.iter().zip(tasks) {
            let outputs = self.basis.predict(&fit.outputs, signals);
            let scale = 100.0 * self.basis.records() as f64 / fit.variation / self.fits.len() as f64;
            for ((error, row), label) in errors.iter_mut().zip(outputs.row_iter()).zip(labels) {
                let squares = row.iter().zip(fit.targets(label)).map(|(said, y)| (said - y).powi(2));
                *error += scale * squares.sum::<f64>();
            }
        }
        errors
    }

    /// Geometric mean of the tasks' leave-one-out errors 1 − R².
    pub(crate) fn loss(&self) -> f64 {
        (self.fits.iter().map(|fit| fit.loss().ln()).sum::<f64>() / self.fits.len() as f64).exp()
    }

    /// Cotangent of the loss on the signals (N, p).
    pub(crate) fn loss_vjp(&self) -> Vec<f64> {
        let part = self.loss() / self.fits.len() as f64;
        let outputs = self.fits.iter().flat_map(|fit| {
            let factor = part / (fit.loss() * fit.variation);
            fit.outputs.iter().map(move |output| (factor, output))
        });
        self.basis.squares_vjp(outputs)
    }
}

/// Samples of a trial that have labels.
struct Labelled {
    /// Their indices.
    used: Vec<usize>,
    window: Window,
    /// First instant of each one's window.
    starts: Vec<usize>,
    /// Signals in the window (n, len·3M), divided by the trial's scales.
    signals: Vec<f64>,
    tasks: Vec<(SensingTask, Labels)>,
}

impl Labelled {
    /// Of these samples, which have these parts of the mixture.
    fn of(trial: &PreparedTrial, samples: &Samples, parts: &[usize]) -> Self {
        let used = samples.with_force();
        let len = samples.sizes.instants * samples.sizes.outputs;
        let forces = |i: usize| &samples.targets[i * len..][..len];
        let (whole, window) =
            (trial.scales.inputs(&pick(&samples.signals, samples.count(), &used)), Window::of(trial));
        let starts = window.starts(&whole);
        let labeller = trial.problem.labeller();
        let label = |task: SensingTask, i: usize| labeller.label(task, forces(i), parts[i]);
        let labels = |task: &SensingTask| (*task, used.iter().map(|&i| label(*task, i)).collect::<Labels>());
        let tasks = trial.problem.tasks.trained.iter().map(labels).collect();
        let signals = window.signals(&whole, &starts);
        Self { used, window, starts, signals, tasks }
    }

    /// # Errors
    /// If there are too few records, or a label does not vary.
    fn fit(&self) -> Result<Readout> {
        if self.used.len() < RECORDS_MIN {
            return Err(Trouble::FewForces);
        }
        let readout = Readout::new(&self.signals, &self.tasks);
        let varied = readout.fits.iter().all(|fit| fit.variation > 0.0);
        if varied { Ok(readout) } else { Err(Trouble::FewForces) }
    }

    /// Error (%) of each sample; `None` without force.
    fn errors(&self, readout: &Readout, samples: &Samples) -> Vec<Option<f64>> {
        let mut errors: Vec<Option<f64>> =
            samples.failed.iter().map(|failed| failed.then_some(FAILED)).collect();
        if !self.used.is_empty() {
            let found = readout.errors(&self.signals, &self.tasks);
            self.used.iter().zip(found).for_each(|(&i, error)| errors[i] = Some(error));
        }
        errors
    }
}

/// Error (%) of each training, test and held-out sample with readouts of the trial's tasks fitted to the training samples.
///
/// # Errors
/// If the training samples are too few or too similar.
pub(crate) fn task_errors(trial: &PreparedTrial, sets: &[Samples; 3]) -> Result<[Vec<Option<f64>>; 3]> {
    let parts = trial.problem.parts();
    let labelled = [0, 1, 2].map(|set| Labelled::of(trial, &sets[set], &parts[set]));
    let readout = labelled[0].fit()?;
    Ok([0, 1, 2].map(|set| labelled[set].errors(&readout, &sets[set])))
}

/// Readouts that train a body: each fit is to the newest body's samples alone.
pub(super) struct TaskLearner<'a> {
    trial: &'a PreparedTrial<'a>,
    fitted: Option<(Labelled, Readout)>,
}

impl<'a> TaskLearner<'a> {
    pub(super) fn new(trial: &'a PreparedTrial<'a>) -> Self {
        Self { trial, fitted: None }
    }

    fn fitted(&self) -> &(Labelled, Readout) {
        self.fitted.as_ref().expect("it has been fitted")
    }
}

impl Learner for TaskLearner<'_> {
    /// The newest, and the one to which a failed step returns.
    fn bodies(&self) -> usize {
        2
    }

    fn includes_age(&self, _: u32) -> bool {
        false
    }

    fn fit(&mut self, on: FitOn, step: u32, _: &mut DecoderState, _: &mut Counters) -> Result<FitResult> {
        let problem = &self.trial.problem;
        let (samples, parts) = match on {
            FitOn::Recent(bodies, _) => {
                let newest = *bodies.last().expect("the newest");
                let (first, count) = (u64::from(step) * newest.count() as u64, newest.count());
                (newest, problem.parts_of(Purpose::Fresh, first, count))
            }
            FitOn::Optimum(train) | FitOn::Alike(train) => {
                let [parts, ..] = problem.parts();
                (train, parts)
            }
        };
        let labelled = Labelled::of(self.trial, samples, &parts);
        let readout = labelled.fit()?;
        let loss = readout.loss();
        self.fitted = Some((labelled, readout));
        Ok(FitResult { loss, error: Some(100.0 * loss), ridge: None })
    }

    /// That of the samples of the last fit.
    fn loss_vjp(&mut self, samples: &Samples, _: Loss) -> (Option<f64>, Vec<f64>) {
        let (labelled, readout) = self.fitted();
        let mut cotangent = vec![0.0; samples.signals.len()];
        let (len, count) = (cotangent.len() / samples.count(), labelled.used.len());
        let found = self.trial.scales.inputs_vjp(&readout.loss_vjp());
        let records = labelled.used.iter().zip(&labelled.starts);
        for ((&i, &start), own) in records.zip(found.chunks_exact(found.len() / count)) {
            labelled.window.add_vjp(own, start, &mut cotangent[i * len..][..len]);
        }
        (None, cotangent)
    }

    fn implicit(&mut self, _: &Samples, _: &Samples, _: &mut Counters) -> (Vec<f64>, Option<Implicit>) {
        unreachable!("the spec is refused: the loss contains the fit")
    }

    /// The leave-one-out error on the test samples (%): a readout of a step's few samples would rank bodies by these.
    fn error(&mut self, test: &Samples) -> Option<f64> {
        let [_, parts, _] = self.trial.problem.parts();
        Labelled::of(self.trial, test, &parts).fit().ok().map(|readout| 100.0 * readout.loss())
    }
}

#[cfg(test)]
mod tests;
