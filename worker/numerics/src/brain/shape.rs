//! The network's sizes, its flat order of weights, and how weights start.
//!
//! ```text
//! a₁ = relu(b₁ + x ∗ w₁)   k = 3, 3M → width        flat: b₁, b₂, b₃, w₁, w₂, w₃,
//! a₂ = relu(b₂ + a₁ ∗ w₂)  k = 3, width → width     each w (kernel, in, out) in C order
//! f̂  = b₃ + a₂ ∗ w₃        k = 1, width → K         stride 1, zero padding
//! ```

use super::kernels::COLUMNS;
use crate::random::{Purpose, Stream};
use std::ops::Range;

/// Sizes of a network and its signals.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shape {
    /// T.
    pub instants: usize,
    /// 3M.
    pub inputs: usize,
    /// Channels of the hidden layers.
    pub width: usize,
    /// K.
    pub outputs: usize,
}

impl Shape {
    /// The number of weights.
    pub fn weights(&self) -> usize {
        self.range(5).end
    }

    /// Where b₁, b₂, b₃, w₁, w₂, w₃ (0…5) lie in the flat order.
    pub fn range(&self, block: usize) -> Range<usize> {
        let lengths = [
            self.width,
            self.width,
            self.outputs,
            3 * self.inputs * self.width,
            3 * self.width * self.width,
            self.width * self.outputs,
        ];
        let start = lengths[..block].iter().sum();
        start..start + lengths[block]
    }

    /// Whether the second layer goes by pairs of instants (`winograd`).
    pub(super) fn paired(&self) -> bool {
        self.instants.is_multiple_of(2)
    }

    /// Channels of a row of hidden activations in memory; those beyond `width` stay 0.
    pub(super) fn stride(&self) -> usize {
        self.width.next_multiple_of(COLUMNS)
    }
}

/// Normal weights of variance 2/fan_in (last layer 1/fan_in), biases 0; `which` tells apart the networks of one seed.
pub fn initial_weights(shape: Shape, seed: u64, which: u64) -> Vec<f64> {
    let mut weights = vec![0.0; shape.weights()];
    let fans = [3 * shape.inputs, 3 * shape.width, shape.width];
    for (layer, (fan_in, gain)) in fans.into_iter().zip([2.0, 2.0, 1.0f64]).enumerate() {
        let mut stream = Stream::new(Purpose::Weights, seed, [which, layer as u64]);
        let deviation = (gain / fan_in as f64).sqrt();
        weights[shape.range(3 + layer)].fill_with(|| deviation * stream.normal());
    }
    weights
}
