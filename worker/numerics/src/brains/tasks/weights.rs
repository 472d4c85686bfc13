//! Readouts of the trial's tasks as weights of the signals, for a device.

use super::{Labelled, Labels, Readout, SensingTask, TaskEstimate, greatest};
use crate::trial::{PreparedTrial, Result, Samples, pick};

/// A readout as weights of sums of the signals over blocks of instants: output = constant + Σ weight · sum / scale.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadoutWeights {
    /// The task.
    pub task: SensingTask,
    /// Classes, ascending; empty for values.
    pub classes: Vec<f64>,
    /// Weights (blocks · channels) and constant per output. Two classes have one output, above 0 for the first.
    pub outputs: Vec<(Vec<f64>, f64)>,
}

impl ReadoutWeights {
    /// The label that these outputs stand for: the class of the greatest output, or the values.
    pub fn label(&self, outputs: &[f64]) -> Vec<f64> {
        match self.classes[..] {
            [] => outputs.to_vec(),
            [first, second] => vec![if outputs[0] > 0.0 { first } else { second }],
            _ => vec![greatest(&self.classes, outputs)],
        }
    }

    /// Held-out error in the task's unit of estimated labels.
    pub fn error(&self, truth: &Labels, estimated: &Labels) -> f64 {
        TaskEstimate::of(self.task, truth, estimated).error
    }
}

impl Readout {
    /// The readouts as weights of the signals to which they were fitted.
    fn weights(&self) -> Vec<ReadoutWeights> {
        let of = |fit: &super::TaskFit| {
            // outputs of two classes are opposite
            let count = if fit.classes.len() == 2 { 1 } else { fit.outputs.len() };
            let outputs = fit.outputs[..count].iter().map(|output| self.basis.weights(output)).collect();
            ReadoutWeights { task: fit.task, classes: fit.classes.clone(), outputs }
        };
        self.fits.iter().map(of).collect()
    }
}

/// Readouts of the trial's tasks on a body, and held-out samples to test them.
#[derive(Debug, Clone, PartialEq)]
pub struct TaskReadouts {
    /// One per task.
    pub readouts: Vec<ReadoutWeights>,
    /// Instants of the window, from the first reading above a threshold on.
    pub window: usize,
    /// Threshold per signal channel (mm/s², rad/s); negative: the window starts with the record.
    pub thresholds: Vec<f64>,
    /// Instants per block of the window; the last block may have fewer.
    pub block: usize,
    /// Divisor per signal channel.
    pub scales: Vec<f64>,
    /// Signals (n, T, channels) of the held-out samples with force (mm/s², rad/s).
    pub signals: Vec<f64>,
    /// First instants of their windows; `None` without contact.
    pub contacts: Vec<Option<usize>>,
    /// Their sums in the windows (n, blocks, channels).
    pub sums: Vec<f64>,
    /// Their labels per task.
    pub labels: Vec<Labels>,
}

/// Fits readouts of the trial's tasks to the training samples of a body.
///
/// # Errors
/// If the training samples are too few or too similar.
pub(crate) fn task_readouts(trial: &PreparedTrial, sets: &[Samples; 3]) -> Result<TaskReadouts> {
    let [train, _, holdout] = trial.problem.parts();
    let known = Labelled::of(trial, &sets[0], &train);
    let sums = known.window.sums(&known.signals);
    let readouts = Labelled { signals: sums, ..known }.fit()?.weights();
    let Labelled { used, window, starts, tasks, .. } = Labelled::of(trial, &sets[2], &holdout);
    let signals = pick(&sets[2].signals, sets[2].count(), &used);
    let scales = trial.scales.channels.clone();
    let thresholds = window.thresholds.iter().zip(&scales).map(|(least, scale)| least * scale).collect();
    Ok(TaskReadouts {
        readouts,
        window: window.len,
        thresholds,
        block: window.block(),
        scales,
        sums: window.sums(&window.signals(&signals, &starts)),
        contacts: window.contacts(&trial.scales.inputs(&signals)).collect(),
        signals,
        labels: tasks.into_iter().map(|(_, labels)| labels).collect(),
    })
}
