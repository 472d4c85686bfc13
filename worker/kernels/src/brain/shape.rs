//! The network's layers and sizes, its flat order of weights, and how weights start.
//!
//! ```text
//! a_l[t] = relu(b_l + Σ_i a_(l−1)[t + i·d_l − before_l] w_l[i])   l = 1 … n − 1, a_0 = x (T, 3M), zero outside
//! f̂[t]   = b_n + Σ_i a_(n−1)[t + i·d_n − before_n] w_n[i]         width → K
//! before_l = (k_l − 1) d_l / 2, or all of (k_l − 1) d_l where causal
//! ```
//! Flat: b₁ … b_n, w₁ … w_n, each w (kernel, in, out) in C order. The paper's: kernels 3, 3, 1, width 64.

use super::tiles::COLUMNS;
use crate::random::{Purpose, Stream};
use std::ops::Range;

/// The most layers that a network may have.
pub const LAYERS_MAX: usize = 16;

/// The kernel of a layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Layer {
    /// Its taps k; odd, unless the network is causal.
    pub kernel: usize,
    /// Instants d from a tap to the next.
    pub dilation: usize,
}

/// A network without its inputs and outputs.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Architecture {
    width: usize,
    causal: bool,
    count: usize,
    layers: [Layer; LAYERS_MAX],
}

impl Architecture {
    /// Hidden layers of `width` channels and an output layer; each convolution looks to both sides, or, if `causal`, back only.
    ///
    /// # Panics
    /// If there are fewer than 2 layers or more than `LAYERS_MAX`, a size is 0, or a kernel that looks to both sides is even.
    pub fn new(width: usize, kernels: &[usize], dilations: &[usize], causal: bool) -> Self {
        let count = kernels.len();
        assert!((2..=LAYERS_MAX).contains(&count) && dilations.len() == count, "{kernels:?} {dilations:?}");
        assert!(width > 0 && kernels.iter().chain(dilations).all(|&n| n > 0), "{kernels:?} {dilations:?}");
        assert!(causal || kernels.iter().all(|k| k % 2 == 1), "even kernels of {kernels:?} have no centre");
        let mut layers = [Layer::default(); LAYERS_MAX];
        for (layer, (&kernel, &dilation)) in layers.iter_mut().zip(kernels.iter().zip(dilations)) {
            *layer = Layer { kernel, dilation };
        }
        Self { width, causal, count, layers }
    }

    /// The paper's, of any width.
    pub fn paper(width: usize) -> Self {
        Self::new(width, &[3, 3, 1], &[1, 1, 1], false)
    }

    /// Channels of the hidden layers.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Whether no answer depends on a later instant.
    pub fn causal(&self) -> bool {
        self.causal
    }

    /// The layers, from the inputs to the output.
    pub fn layers(&self) -> &[Layer] {
        &self.layers[..self.count]
    }
}

impl std::fmt::Debug for Architecture {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { width, causal, .. } = self;
        write!(f, "{width} wide{}", if *causal { ", causal" } else { "" })?;
        f.debug_list().entries(self.layers().iter().map(|l| (l.kernel, l.dilation))).finish()
    }
}

/// Sizes of a network and its signals.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shape {
    /// T.
    pub instants: usize,
    /// 3M.
    pub inputs: usize,
    /// K.
    pub outputs: usize,
    /// The layers.
    pub architecture: Architecture,
}

impl Shape {
    /// The number of weights.
    pub fn weights(&self) -> usize {
        self.range(2 * self.layers() - 1).end
    }

    /// The number of layers n.
    pub fn layers(&self) -> usize {
        self.architecture.count
    }

    /// Where b₁ … b_n, w₁ … w_n (0 … 2n − 1) lie in the flat order.
    pub fn range(&self, block: usize) -> Range<usize> {
        let n = self.layers();
        let length = |block: usize| {
            let conv = self.conv(block % n);
            if block < n { conv.outputs } else { conv.kernel * conv.inputs * conv.outputs }
        };
        let start = (0..block).map(length).sum();
        start..start + length(block)
    }

    /// Layer l + 1 with all its sizes.
    pub(super) fn conv(&self, l: usize) -> Conv {
        let Architecture { width, causal, count, layers } = self.architecture;
        let (Layer { kernel, dilation }, last) = (layers[l], l + 1 == count);
        let reach = (kernel - 1) * dilation;
        let before = if causal { reach } else { reach / 2 };
        let hidden = (width, self.stride());
        let (inputs, input_stride) = if l == 0 { (self.inputs, self.inputs) } else { hidden };
        let (outputs, output_stride) = if last { (self.outputs, self.outputs) } else { hidden };
        Conv {
            instants: self.instants,
            kernel,
            dilation,
            before,
            after: reach - before,
            inputs,
            outputs,
            input_stride,
            output_stride,
            paired: kernel == 3 && dilation == 1 && l > 0 && !last && self.instants.is_multiple_of(2),
        }
    }

    /// Channels of a row of hidden activations in memory; those beyond the width stay 0.
    pub(super) fn stride(&self) -> usize {
        self.architecture.width.next_multiple_of(COLUMNS)
    }
}

/// A layer's sizes. Its input is padded by `before` and `after` rows of zeros, the cotangent of its output the other way round.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Conv {
    pub instants: usize,
    pub kernel: usize,
    pub dilation: usize,
    pub before: usize,
    pub after: usize,
    pub inputs: usize,
    pub outputs: usize,
    /// From a row of the input, or of the output, to the next.
    pub input_stride: usize,
    pub output_stride: usize,
    /// Whether it goes by pairs of instants (`winograd`).
    pub paired: bool,
}

impl Conv {
    /// Numbers of a padded input.
    pub fn input_len(&self) -> usize {
        (self.before + self.instants + self.after) * self.input_stride
    }

    /// Where its first instant begins.
    pub fn input_start(&self) -> usize {
        self.before * self.input_stride
    }

    /// Numbers of a padded cotangent of the output.
    pub fn output_len(&self) -> usize {
        (self.before + self.instants + self.after) * self.output_stride
    }

    /// Where its first instant begins.
    pub fn output_start(&self) -> usize {
        self.after * self.output_stride
    }

    /// From inputs to outputs, weights as they are.
    pub fn forward(&self) -> Convolution {
        self.sweep(self.inputs, self.input_stride, self.output_stride)
    }

    /// From cotangents of outputs to those of inputs, weights flipped in time and transposed.
    pub fn back(&self) -> Convolution {
        self.sweep(self.outputs, self.output_stride, self.input_stride.next_multiple_of(COLUMNS))
    }

    fn sweep(&self, channels: usize, lda: usize, columns: usize) -> Convolution {
        let whole = self.dilation == 1 && channels == lda;
        let (taps, depth) = if whole { (1, self.kernel * channels) } else { (self.kernel, channels) };
        let (rows, paired) = (self.instants, self.paired);
        Convolution { rows, channels, lda, columns, taps, step: self.dilation * lda, depth, paired }
    }
}

/// A convolution as `kernels` take it: rows that follow each other without a gap are one tap.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Convolution {
    pub rows: usize,
    pub channels: usize,
    pub lda: usize,
    pub columns: usize,
    pub taps: usize,
    pub step: usize,
    pub depth: usize,
    pub paired: bool,
}

/// Normal weights of variance 2/fan_in (last layer 1/fan_in), biases 0; `which` tells apart the networks of one seed.
pub fn initial_weights(shape: Shape, seed: u64, which: u64) -> Vec<f64> {
    let mut weights = vec![0.0; shape.weights()];
    let n = shape.layers();
    for layer in 0..n {
        let conv = shape.conv(layer);
        let gain = if layer + 1 == n { 1.0f64 } else { 2.0 };
        let mut stream = Stream::new(Purpose::Weights, seed, [which, layer as u64]);
        let deviation = (gain / (conv.kernel * conv.inputs) as f64).sqrt();
        weights[shape.range(n + layer)].fill_with(|| deviation * stream.normal());
    }
    weights
}

/// Weights that say of x what they said of x · `factors` (3M); inputs beyond the factors stay as they are.
pub fn scale_inputs(shape: Shape, weights: &mut [f32], factors: &[f64]) {
    let Conv { inputs, outputs, .. } = shape.conv(0);
    for tap in weights[shape.range(shape.layers())].chunks_exact_mut(inputs * outputs) {
        for (row, factor) in tap.chunks_exact_mut(outputs).zip(factors) {
            row.iter_mut().for_each(|w| *w = (f64::from(*w) * factor) as f32);
        }
    }
}
