//! Probabilities of classes, and their calibration on held-out records.
//!
//! ```text
//! p = softmax(β · outputs)     β: the least logarithmic loss of the leave-one-out outputs of the N training records
//! ```
//! 1/β is the temperature of Guo et al. (ICML 2017). The target of a true class is 1 − 1/(N + 2) (Platt 1999), so β is finite.

use super::{Labels, Readout, SensingTask, TaskFit};

/// Range of β, and number of its halvings.
const SHARPNESS: [f64; 2] = [1e-3, 1e3];
const HALVINGS: usize = 40;
/// Number of intervals of equal length of the probability of an estimated class.
const BINS: usize = 10;

/// Calibration of the probabilities of a task's classes.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// Mean of −ln p of the true class.
    pub log_loss: f64,
    /// Expected calibration error (%): mean over samples of |frequency − probability| in their bin.
    pub error: f64,
    /// Per bin with samples: mean probability of the estimated class, its frequency as the true class, number of samples.
    pub bins: Vec<[f64; 3]>,
}

/// Probabilities of classes with these outputs.
pub(super) fn softmax<'a>(outputs: impl Iterator<Item = &'a f64> + Clone, sharpness: f64) -> Vec<f64> {
    let most = outputs.clone().copied().fold(f64::NEG_INFINITY, f64::max);
    let parts: Vec<f64> = outputs.map(|output| (sharpness * (output - most)).exp()).collect();
    let sum: f64 = parts.iter().sum();
    parts.iter().map(|part| part / sum).collect()
}

impl TaskFit {
    /// β, from the labels of the training records.
    fn sharpness(&self, known: &Labels) -> f64 {
        let missed = 1.0 / (known.len() + 2) as f64;
        let of = |(i, label): (usize, &Vec<f64>)| {
            let targets = self.targets(label);
            let left_out = targets.iter().zip(&self.outputs).map(|(y, output)| y + output.residuals[i]);
            let outputs: Vec<f64> = left_out.collect();
            let share = |y: f64| if y > 0.0 { 1.0 - missed } else { missed / (targets.len() - 1) as f64 };
            let wanted: f64 = targets.iter().zip(&outputs).map(|(y, output)| share(*y) * output).sum();
            (outputs, wanted)
        };
        let records: Vec<(Vec<f64>, f64)> = known.iter().enumerate().map(of).collect();
        // the loss is convex in β
        let slope = |sharpness: f64| -> f64 {
            let mean = |outputs: &[f64]| -> f64 {
                softmax(outputs.iter(), sharpness).iter().zip(outputs).map(|(p, output)| p * output).sum()
            };
            records.iter().map(|(outputs, wanted)| mean(outputs) - wanted).sum()
        };
        let [mut low, mut high] = SHARPNESS;
        for _ in 0..HALVINGS {
            let middle = (low * high).sqrt();
            *(if slope(middle) < 0.0 { &mut low } else { &mut high }) = middle;
        }
        low
    }
}

impl Readout {
    /// Calibration of each task on records with these signals (n, p) and labels; `None` for values. `known` are the labels of the
    /// training records.
    pub(super) fn calibrations(
        &self,
        known: &[(SensingTask, Labels)],
        signals: &[f64],
        truth: &[Labels],
    ) -> Vec<Option<Calibration>> {
        let of = |((fit, (task, known)), truth): ((&TaskFit, &(SensingTask, Labels)), &Labels)| {
            let sharpness = task.is_class().then(|| fit.sharpness(known))?;
            let outputs = self.basis.predict(&fit.outputs, signals);
            let probabilities: Vec<Vec<f64>> =
                outputs.row_iter().map(|row| softmax(row.iter(), sharpness)).collect();
            Some(calibration(&fit.classes, &probabilities, truth, known.len()))
        };
        self.fits.iter().zip(known).zip(truth).map(of).collect()
    }
}

/// Calibration of probabilities of these classes, of a readout fitted to `known` records.
pub(super) fn calibration(
    classes: &[f64],
    probabilities: &[Vec<f64>],
    truth: &Labels,
    known: usize,
) -> Calibration {
    let mut sums = [[0.0; 3]; BINS];
    let mut log_loss = 0.0;
    for (p, label) in probabilities.iter().zip(truth) {
        let class = classes.iter().position(|class| *class == label[0]);
        // a class that no training record has
        log_loss -= class.map_or(1.0 / (known + 2) as f64, |k| p[k].max(f64::MIN_POSITIVE)).ln();
        let most = p.iter().copied().fold(0.0, f64::max);
        let bin = &mut sums[((BINS as f64 * most) as usize).min(BINS - 1)];
        let right = class.is_some_and(|k| p[k] == most);
        *bin = [bin[0] + most, bin[1] + f64::from(u8::from(right)), bin[2] + 1.0];
    }
    let n = truth.len() as f64;
    let error = 100.0 * sums.iter().map(|[p, right, _]| (p - right).abs()).sum::<f64>() / n;
    let bins =
        sums.iter().filter(|sum| sum[2] > 0.0).map(|[p, right, count]| [p / count, right / count, *count]);
    Calibration { log_loss: log_loss / n, error, bins: bins.collect() }
}
