//! Signals and targets in the layout of the kernels, and batches that refer to them without copying.

use super::kernels::Real;
use super::shape::Shape;

/// Samples: x (N, before + T + after, 3M) including the rows of zeros that the first layer reads, y (N, T, K). The caller
/// normalises both.
#[derive(Debug, Clone)]
pub struct Data<F> {
    shape: Shape,
    samples: usize,
    x: Vec<F>,
    y: Vec<F>,
    output_weights: Vec<F>,
}

impl<F: Real> Data<F> {
    /// Data from x (N, T, 3M) and y (N, T, K).
    ///
    /// # Panics
    /// If the lengths do not match the same N.
    pub fn new(shape: Shape, x: &[F], y: &[F]) -> Self {
        let samples = y.len() / (shape.instants * shape.outputs);
        let mut data = Self::zeros(shape, samples);
        let (nx, ny) = (shape.instants * shape.inputs, shape.instants * shape.outputs);
        assert_eq!(y.len(), samples * ny, "y of {shape:?}");
        assert_eq!(x.len(), samples * nx, "x of {samples} samples of {shape:?}");
        for n in 0..samples {
            data.set(n, &x[n * nx..(n + 1) * nx], &y[n * ny..(n + 1) * ny]);
        }
        data
    }

    /// Memory for N samples, to be filled by `set`.
    pub fn zeros(shape: Shape, samples: usize) -> Self {
        Self {
            shape,
            samples,
            x: vec![F::ZERO; samples * shape.conv(0).input_len()],
            y: vec![F::ZERO; samples * shape.instants * shape.outputs],
            output_weights: vec![F::from_f64(1.0); shape.outputs],
        }
    }

    /// Sets the weights of the outputs in the loss. σ_k² converts a loss of normalised targets to physical units.
    ///
    /// # Panics
    /// If the number of weights is not K.
    pub fn with_output_weights(mut self, weights: &[f64]) -> Self {
        assert_eq!(weights.len(), self.shape.outputs);
        self.output_weights = weights.iter().map(|&w| F::from_f64(w)).collect();
        self
    }

    /// Sets sample n to x (T, 3M) and y (T, K).
    ///
    /// # Panics
    /// If n or a length is out of range.
    pub fn set(&mut self, n: usize, x: &[F], y: &[F]) {
        let (conv, instants) = (self.shape.conv(0), self.shape.instants * self.shape.inputs);
        self.x[n * conv.input_len() + conv.input_start()..][..instants].copy_from_slice(x);
        self.y[n * y.len()..(n + 1) * y.len()].copy_from_slice(y);
    }

    /// Sizes of the network.
    pub fn shape(&self) -> Shape {
        self.shape
    }

    /// All samples, in order.
    pub fn all(&self) -> Batch<'_, F> {
        Batch { data: self, which: None }
    }

    /// The given samples, in the given order.
    ///
    /// # Panics
    /// If an index is out of range.
    pub fn batch<'a>(&'a self, which: &'a [usize]) -> Batch<'a, F> {
        let samples = self.samples;
        assert!(which.iter().all(|&n| n < samples), "index out of range: {samples} samples, batch {which:?}");
        Batch { data: self, which: Some(which) }
    }
}

/// A selection of samples of `Data`.
#[derive(Debug, Clone, Copy)]
pub struct Batch<'a, F> {
    data: &'a Data<F>,
    which: Option<&'a [usize]>,
}

impl<'a, F: Real> Batch<'a, F> {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.which.map_or(self.data.samples, <[usize]>::len)
    }

    /// Whether the batch is empty.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Sizes of the network.
    pub fn shape(&self) -> Shape {
        self.data.shape
    }

    /// Weights of the outputs in the loss.
    pub(super) fn output_weights(&self) -> &'a [F] {
        &self.data.output_weights
    }

    /// Padded x, and y (T, K), of sample i of the batch.
    pub(super) fn sample(&self, i: usize) -> (&'a [F], &'a [F]) {
        let n = self.which.map_or(i, |which| which[i]);
        let shape = self.data.shape;
        let (nx, ny) = (shape.conv(0).input_len(), shape.instants * shape.outputs);
        (&self.data.x[n * nx..(n + 1) * nx], &self.data.y[n * ny..(n + 1) * ny])
    }

    /// Weighted mean square of the targets: the loss of the prediction 0.
    pub fn target_power(&self) -> f64 {
        let mut sum = 0.0;
        for i in 0..self.len() {
            for row in self.sample(i).1.chunks_exact(self.data.shape.outputs) {
                for (y, w) in row.iter().zip(&self.data.output_weights) {
                    sum += y.to_f64() * y.to_f64() * w.to_f64();
                }
            }
        }
        sum / (self.len() * self.data.shape.instants * self.data.shape.outputs) as f64
    }
}
