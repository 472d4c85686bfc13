//! Weights in the layout of the kernels: rows padded to whole registers, and panels for both directions.

use super::kernels::{Kernels, Real};
use super::shape::{Conv, Shape};
use super::winograd::form;
use std::ops::Range;

/// Range of block b₁ … b_n, w₁ … w_n (0 … 2n − 1) in the padded order: each w is (kernel, in, stride), the last (kernel,
/// K, stride).
pub fn padded_range(shape: Shape, block: usize) -> Range<usize> {
    let n = shape.layers();
    let length = |block: usize| {
        let conv = shape.conv(block % n);
        match (block < n, block % n + 1 == n) {
            (true, _) => conv.output_stride,
            (false, true) => conv.kernel * conv.outputs * conv.input_stride,
            (false, false) => conv.kernel * conv.inputs * conv.output_stride,
        }
    };
    let start = (0..block).map(length).sum();
    start..start + length(block)
}

/// Length of the padded order.
pub fn padded_len(shape: Shape) -> usize {
    padded_range(shape, 2 * shape.layers() - 1).end
}

/// Range of Q₀, Q₁, Q₂, −Q₃ of layer l + 1 (`winograd`) among those of all layers; empty if the layer has none.
pub fn pairs_range(shape: Shape, l: usize) -> Range<usize> {
    let length = |l: usize| {
        let conv = shape.conv(l);
        if conv.paired { 4 * conv.inputs * conv.output_stride } else { 0 }
    };
    let start = (0..l).map(length).sum();
    start..start + length(l)
}

/// Calls `pair(flat, padded)` with the positions of every weight in the flat and in the padded order.
#[inline(always)]
fn pairs(shape: Shape, mut pair: impl FnMut(usize, usize)) {
    let n = shape.layers();
    for block in 0..2 * n {
        let (flat, padded, conv) =
            (shape.range(block).start, padded_range(shape, block).start, shape.conv(block % n));
        let (p, outputs) = (conv.output_stride, conv.outputs);
        if block + 1 == 2 * n {
            for (tap, c) in (0..conv.kernel).flat_map(|tap| (0..conv.inputs).map(move |c| (tap, c))) {
                let (from, to) = (flat + (tap * conv.inputs + c) * outputs, padded + c);
                (0..outputs).for_each(|k| pair(from + k, to + (tap * outputs + k) * conv.input_stride));
            }
        } else {
            let rows = if block < n { 1 } else { conv.kernel * conv.inputs };
            for row in 0..rows {
                (0..outputs).for_each(|o| pair(flat + row * outputs + o, padded + row * p + o));
            }
        }
    }
}

/// Copies a padded gradient to the flat order.
pub fn unpad<F: Real>(shape: Shape, padded: &[F], flat: &mut [F]) {
    pairs(shape, |f, p| flat[f] = padded[p]);
}

/// Entries of a contiguous row, for `Kernels::pack`.
fn entries<F: Real>(row: &[F]) -> impl Fn(usize) -> F {
    move |c| row[c]
}

/// Weights of one layer for one direction.
#[derive(Debug, Clone, Default)]
pub struct Panels<F> {
    /// (kernel·in, out), for `Kernels::product`.
    pub direct: Vec<F>,
    /// The four forms of `winograd` (4·in, out), for `Kernels::pairs`.
    pub pairs: Vec<F>,
}

/// Weights in all layouts of the sweeps.
#[derive(Debug, Clone)]
pub struct Packed<F> {
    padded: Vec<F>,
    /// From inputs to outputs, for every layer except the last.
    pub forward: Vec<Panels<F>>,
    /// From outputs to inputs, for every layer: reversed in time and transposed.
    pub back: Vec<Panels<F>>,
}

impl<F: Real> Packed<F> {
    /// Zero weights.
    pub fn zeros(shape: Shape) -> Self {
        let panels = |conv: Conv, rows: usize, columns: usize, direct: bool| Panels {
            direct: vec![F::ZERO; if direct { conv.kernel * rows * columns } else { 0 }],
            pairs: vec![F::ZERO; if conv.paired { 4 * rows * columns } else { 0 }],
        };
        let convs = || (0..shape.layers()).map(|l| shape.conv(l));
        let forward = convs().take(shape.layers() - 1);
        Self {
            padded: vec![F::ZERO; padded_len(shape)],
            forward: forward
                .map(|c| panels(c, c.inputs, c.output_stride, !c.paired || F::REFERENCE_ORDER))
                .collect(),
            back: convs().map(|c| panels(c, c.outputs, c.back().columns, !c.paired)).collect(),
        }
    }

    /// Sets all layouts to these weights. Does not allocate.
    ///
    /// # Panics
    /// If their number is not `shape.weights()`.
    pub fn fill(&mut self, kernels: &Kernels<F>, shape: Shape, flat: &[F]) {
        assert_eq!(flat.len(), shape.weights(), "weights of {shape:?}");
        let n = shape.layers();
        let padded = &mut self.padded;
        pairs(shape, |f, p| padded[p] = flat[f]);
        for l in 0..n - 1 {
            let (conv, w) = (shape.conv(l), &self.padded[padded_range(shape, n + l)]);
            let Conv { kernel, inputs, outputs, output_stride: p, .. } = conv;
            let (forward, back) = (&mut self.forward[l], &mut self.back[l]);
            if !forward.direct.is_empty() {
                let row = |d: usize| entries(&w[d * p..][..p]);
                kernels.pack(kernel * inputs, p, row, &mut forward.direct);
            }
            // Columns of `back` beyond the inputs stay 0.
            let columns = conv.back().columns;
            if conv.paired {
                let row = |d: usize| {
                    let w = [0, 1, 2].map(|k| &w[(k * inputs + d % inputs) * p..][..p]);
                    move |c: usize| form(d / inputs, |k| w[k][c])
                };
                kernels.pack(4 * inputs, p, row, &mut forward.pairs);
                let row = |d: usize| {
                    let (i, output) = (d / outputs, d % outputs);
                    move |c: usize| match c < inputs {
                        true => form(i, |k| w[((2 - k) * inputs + c) * p + output]),
                        false => F::ZERO,
                    }
                };
                kernels.pack(4 * outputs, columns, row, &mut back.pairs);
            } else {
                let row = |d: usize| {
                    let (k, output) = (kernel - 1 - d / outputs, d % outputs);
                    move |c: usize| if c < inputs { w[(k * inputs + c) * p + output] } else { F::ZERO }
                };
                kernels.pack(kernel * outputs, columns, row, &mut back.direct);
            }
        }
        let (conv, w) = (shape.conv(n - 1), &self.padded[padded_range(shape, 2 * n - 1)]);
        let Conv { kernel, outputs, input_stride: p, .. } = conv;
        let row = |d: usize| entries(&w[((kernel - 1 - d / outputs) * outputs + d % outputs) * p..][..p]);
        kernels.pack(kernel * outputs, p, row, &mut self.back[n - 1].direct);
    }

    /// A padded bias b₁ … b_n or the last w (block 0 … n − 1, 2n − 1).
    pub fn block(&self, shape: Shape, block: usize) -> &[F] {
        &self.padded[padded_range(shape, block)]
    }
}
