//! Weights as the kernels read them: rows padded to whole panels, and panels for both directions.

use super::kernels::{COLUMNS, Kernels};
use super::real::Real;
use super::shape::Shape;
use super::winograd::form;
use std::ops::Range;

/// Where b₁, b₂, b₃, w₁, w₂, w₃ᵀ (0…5) lie in the padded order: rows of `stride` channels, w₃ transposed to (K, stride).
pub fn padded_range(shape: Shape, block: usize) -> Range<usize> {
    let p = shape.stride();
    let lengths = [p, p, shape.outputs, 3 * shape.inputs * p, 3 * p * p, shape.outputs * p];
    let start = lengths[..block].iter().sum();
    start..start + lengths[block]
}

/// Length of the padded order.
pub fn padded_len(shape: Shape) -> usize {
    padded_range(shape, 5).end
}

/// Calls `pair(flat, padded)` with the position of every weight in the flat and in the padded order.
#[inline(always)]
fn pairs(shape: Shape, mut pair: impl FnMut(usize, usize)) {
    let (n, p) = (shape.width, shape.stride());
    let (flat, padded) = (|block| shape.range(block).start, |block| padded_range(shape, block).start);
    for block in 0..2 {
        (0..n).for_each(|c| pair(flat(block) + c, padded(block) + c));
    }
    (0..shape.outputs).for_each(|k| pair(flat(2) + k, padded(2) + k));
    for row in 0..3 * shape.inputs {
        (0..n).for_each(|o| pair(flat(3) + row * n + o, padded(3) + row * p + o));
    }
    for (kernel, c) in (0..3).flat_map(|kernel| (0..n).map(move |c| (kernel, c))) {
        let (from, to) = (flat(4) + (kernel * n + c) * n, padded(4) + (kernel * p + c) * p);
        (0..n).for_each(|o| pair(from + o, to + o));
    }
    for c in 0..n {
        (0..shape.outputs).for_each(|k| pair(flat(5) + c * shape.outputs + k, padded(5) + k * p + c));
    }
}

/// Writes a padded gradient in the flat order.
pub fn unpad<F: Real>(shape: Shape, padded: &[F], flat: &mut [F]) {
    pairs(shape, |f, p| flat[f] = padded[p]);
}

/// One set of weights in all forms that the sweeps need.
#[derive(Debug, Clone)]
pub struct Packed<F> {
    padded: Vec<F>,
    /// Forward: (3·3M, stride) and (3·stride, stride).
    pub w1: Vec<F>,
    /// As `w1`.
    pub w2: Vec<F>,
    /// As `w2`, in the four forms of `winograd` (4·stride, stride); the one that is used by pairs of instants.
    pub w2_pairs: Vec<F>,
    /// Backward: flipped in time, transposed; the first layer's columns are inputs, padded.
    pub w1_back: Vec<F>,
    /// As `w1_back`.
    pub w2_back: Vec<F>,
    /// As `w2_pairs`.
    pub w2_back_pairs: Vec<F>,
    /// Backward through the last layer: (K, stride).
    pub w3_back: Vec<F>,
}

impl<F: Real> Packed<F> {
    /// All weights 0.
    pub fn zeros(shape: Shape) -> Self {
        let (p, zeros) = (shape.stride(), |n| vec![F::ZERO; n]);
        Self {
            padded: zeros(padded_len(shape)),
            w1: zeros(3 * shape.inputs * p),
            w2: zeros(3 * p * p),
            w2_pairs: zeros(4 * p * p),
            w2_back_pairs: zeros(4 * p * p),
            w1_back: zeros(3 * p * shape.inputs.next_multiple_of(COLUMNS)),
            w2_back: zeros(3 * p * p),
            w3_back: zeros(shape.outputs * p),
        }
    }

    /// Overwrites every form by these weights. Allocates nothing.
    ///
    /// # Panics
    /// If there are not `shape.weights()` of them.
    pub fn fill(&mut self, kernels: &Kernels<F>, shape: Shape, flat: &[F]) {
        assert_eq!(flat.len(), shape.weights(), "weights of {shape:?}");
        let (p, inputs) = (shape.stride(), shape.inputs);
        let padded = &mut self.padded;
        pairs(shape, |f, p| padded[p] = flat[f]);
        let [w1, w2, w3] = [3, 4, 5].map(|block| &self.padded[padded_range(shape, block)]);
        kernels.pack(3 * inputs, p, |d, c| w1[d * p + c], &mut self.w1);
        if !shape.paired() || F::REFERENCE_ORDER {
            kernels.pack(3 * p, p, |d, c| w2[d * p + c], &mut self.w2);
        }
        if shape.paired() {
            kernels.pack(4 * p, p, |d, c| form(d / p, |k| w2[(k * p + d % p) * p + c]), &mut self.w2_pairs);
            let back = |d: usize, c| form(d / p, |k| w2[((2 - k) * p + c) * p + d % p]);
            kernels.pack(4 * p, p, back, &mut self.w2_back_pairs);
        } else {
            kernels.pack(3 * p, p, |d, c| w2[((2 - d / p) * p + c) * p + d % p], &mut self.w2_back);
        }
        kernels.pack(shape.outputs, p, |k, c| w3[k * p + c], &mut self.w3_back);
        let columns = inputs.next_multiple_of(COLUMNS);
        let back =
            |d: usize, c| if c < inputs { w1[((2 - d / p) * inputs + c) * p + d % p] } else { F::ZERO };
        kernels.pack(3 * p, columns, back, &mut self.w1_back);
    }

    /// b₁, b₂, b₃ or w₃ᵀ (block 0, 1, 2, 5), padded.
    pub fn block(&self, shape: Shape, block: usize) -> &[F] {
        &self.padded[padded_range(shape, block)]
    }
}
