//! A small network from the signals of a window to labels: one hidden layer of tanh units.
//!
//! ```text
//! o = C tanh(A x + a) + c     loss: mean square of o − y for values, cross-entropy of softmax(o) for classes, + ½ DECAY |A, C|²
//! ```
//! Signals and values are scaled to mean 0 and deviation 1 over the training records. Full-batch Adam whose rate falls as a cosine.

use super::calibration::{Calibration, calibration, softmax};
use super::{Labels, SensingTask, classes, greatest};
use crate::brain::{Adam, cosine};
use crate::random::{Purpose, Stream};
use nalgebra::{DMatrix, RowDVector};

/// Units of the hidden layer.
const HIDDEN: usize = 32;
/// Weight decay, iterations of Adam, and its first rate: chosen on seeds 51 … 53 of `position-two-core`.
const DECAY: f64 = 1e-3;
const ITERATIONS: usize = 2000;
const RATE: f64 = 3e-3;

/// Means and deviations of columns; a constant column has deviation 1.
#[derive(Debug, Clone)]
struct Scale(RowDVector<f64>, RowDVector<f64>);

impl Scale {
    fn of(x: &DMatrix<f64>) -> Self {
        Self(x.row_mean(), x.row_variance().map(|v| if v > 0.0 { v.sqrt() } else { 1.0 }))
    }

    fn applied(&self, mut x: DMatrix<f64>) -> DMatrix<f64> {
        x.row_iter_mut().for_each(|mut row| row.zip_zip_apply(&self.0, &self.1, |x, m, d| *x = (*x - m) / d));
        x
    }

    fn undone(&self, mut x: DMatrix<f64>) -> DMatrix<f64> {
        x.row_iter_mut().for_each(|mut row| row.zip_zip_apply(&self.0, &self.1, |x, m, d| *x = *x * d + m));
        x
    }
}

/// A network for one task.
#[derive(Debug, Clone)]
pub(super) struct Network {
    /// Classes, ascending; empty for values.
    classes: Vec<f64>,
    signals: Scale,
    values: Scale,
    /// A (p, HIDDEN), a, C (HIDDEN, outputs), c.
    weights: Vec<f64>,
}

impl Network {
    /// Trains a network on the signals (N, p) and labels of N records.
    pub(super) fn new(seed: u64, task: SensingTask, signals: &[f64], labels: &Labels) -> Self {
        let (n, found) = (labels.len(), if task.is_class() { classes(labels) } else { Vec::new() });
        let x = DMatrix::from_row_slice(n, signals.len() / n, signals);
        let y = match found.is_empty() {
            true => DMatrix::from_fn(n, labels[0].len(), |i, k| labels[i][k]),
            false => DMatrix::from_fn(n, found.len(), |i, k| f64::from(u8::from(labels[i][0] == found[k]))),
        };
        let (inputs, values) = (Scale::of(&x), Scale::of(&y));
        let x = inputs.applied(x);
        let y = if found.is_empty() { values.applied(y) } else { y };
        let mut stream = Stream::new(Purpose::Weights, seed, [task as u64, 1 << 32]);
        let [first, second] = [x.ncols(), HIDDEN].map(|inputs| (inputs as f64).powf(-0.5));
        let mut weights = vec![0.0; length(x.ncols(), y.ncols())];
        let (a, rest) = weights.split_at_mut(x.ncols() * HIDDEN);
        a.iter_mut().for_each(|w| *w = first * stream.normal());
        rest[HIDDEN..][..HIDDEN * y.ncols()].iter_mut().for_each(|w| *w = second * stream.normal());
        let (mut adam, rate) = (Adam::new(weights.len()), cosine(RATE, ITERATIONS));
        for iteration in 0..ITERATIONS {
            let (_, gradient) = loss(&weights, &x, &y, !found.is_empty());
            adam.step(&mut weights, &gradient, rate(iteration));
        }
        Self { classes: found, signals: inputs, values, weights }
    }

    /// Estimated labels of records with these signals (n, p); of classes, calibration on these labels after training on `known`
    /// records.
    pub(super) fn estimates(
        &self,
        signals: &[f64],
        truth: &Labels,
        known: usize,
    ) -> (Labels, Option<Calibration>) {
        let rows: Labels =
            self.outputs(signals).row_iter().map(|row| row.iter().copied().collect()).collect();
        if self.classes.is_empty() {
            return (rows, None);
        }
        let probabilities: Vec<Vec<f64>> = rows.iter().map(|own| softmax(own.iter(), 1.0)).collect();
        let labels = rows.iter().map(|own| vec![greatest(&self.classes, own)]).collect();
        (labels, Some(calibration(&self.classes, &probabilities, truth, known)))
    }

    /// Outputs (n × outputs) of the signals (n, p) of any records: values, or logits of the classes.
    fn outputs(&self, signals: &[f64]) -> DMatrix<f64> {
        let inputs = self.signals.0.len();
        let x = self.signals.applied(DMatrix::from_row_slice(signals.len() / inputs, inputs, signals));
        let found = forward(&self.weights, &x, self.values.0.len()).1;
        if self.classes.is_empty() { self.values.undone(found) } else { found }
    }
}

/// Number of weights.
fn length(inputs: usize, outputs: usize) -> usize {
    HIDDEN * (inputs + 1 + outputs) + outputs
}

/// Hidden and output activations.
fn forward(weights: &[f64], x: &DMatrix<f64>, outputs: usize) -> (DMatrix<f64>, DMatrix<f64>) {
    let (a, rest) = weights.split_at(x.ncols() * HIDDEN);
    let (b, rest) = rest.split_at(HIDDEN);
    let (c, d) = rest.split_at(HIDDEN * outputs);
    let layer = |x: &DMatrix<f64>, w: &[f64], bias: &[f64]| {
        let mut sum = x * DMatrix::from_column_slice(x.ncols(), bias.len(), w);
        sum.column_iter_mut().zip(bias).for_each(|(mut column, bias)| column.add_scalar_mut(*bias));
        sum
    };
    let hidden = layer(x, a, b).map(f64::tanh);
    let out = layer(&hidden, c, d);
    (hidden, out)
}

/// Loss and its gradient in the weights.
fn loss(weights: &[f64], x: &DMatrix<f64>, y: &DMatrix<f64>, is_class: bool) -> (f64, Vec<f64>) {
    let (hidden, out) = forward(weights, x, y.ncols());
    let mut delta = out.clone();
    let value = match is_class {
        true => {
            let mut sum = 0.0;
            for (i, y) in y.row_iter().enumerate() {
                let row = softmax(out.row(i).iter(), 1.0);
                sum -= row.iter().zip(y.iter()).map(|(p, y)| y * p.max(f64::MIN_POSITIVE).ln()).sum::<f64>();
                delta.row_mut(i).copy_from_slice(&row);
            }
            delta = (delta - y) / y.nrows() as f64;
            sum / y.nrows() as f64
        }
        false => {
            delta -= y;
            let mean = delta.norm_squared() / y.len() as f64;
            delta *= 2.0 / y.len() as f64;
            mean
        }
    };
    let c = &weights[(x.ncols() + 1) * HIDDEN..][..HIDDEN * y.ncols()];
    let c = DMatrix::from_column_slice(HIDDEN, y.ncols(), c);
    let inner = (&delta * c.transpose()).zip_map(&hidden, |d, h| d * (1.0 - h * h));
    let sums = |m: &DMatrix<f64>| m.row_sum().iter().copied().collect::<Vec<_>>();
    let parts = [
        (x.tr_mul(&inner).as_slice().to_vec(), DECAY),
        (sums(&inner), 0.0),
        (hidden.tr_mul(&delta).as_slice().to_vec(), DECAY),
        (sums(&delta), 0.0),
    ];
    let (mut gradient, mut squares) = (Vec::with_capacity(weights.len()), 0.0);
    for (part, decay) in parts {
        let own = &weights[gradient.len()..][..part.len()];
        squares += decay * own.iter().map(|w| w * w).sum::<f64>();
        gradient.extend(part.iter().zip(own).map(|(g, w)| g + decay * w));
    }
    (value + 0.5 * squares, gradient)
}

#[cfg(test)]
mod tests;
