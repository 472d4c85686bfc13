//! Layers and sizes of a network, the flat order of its weights, and their initial values.
//!
//! ```text
//! a_l[t] = relu(b_l + Σ_i a_(l−1)[t + i·d_l − before_l] w_l[i])   l = 1 … n − 1, a_0 = x (T, 3M), zero outside
//! f̂[t]   = b_n + Σ_i a_(n−1)[t + i·d_n − before_n] w_n[i]         width → K
//! before_l = (k_l − 1) d_l / 2, or all of (k_l − 1) d_l where causal
//! ```
//! Flat: b₁ … b_n, w₁ … w_n, each w (kernel, in, out) in C order. The paper uses kernels 3, 3, 1 and width 64.

use super::tiles::COLUMNS;
use crate::random::{Purpose, Stream};
use std::ops::Range;

/// Largest number of layers.
pub const LAYERS_MAX: usize = 16;

/// Kernel of a layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Layer {
    /// Number of taps k; odd unless the network is causal.
    pub kernel: usize,
    /// Instants d between taps.
    pub dilation: usize,
}

/// Layers of a network; numbers of inputs and outputs are in [`Shape`].
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Architecture {
    width: usize,
    causal: bool,
    count: usize,
    layers: [Layer; LAYERS_MAX],
}

impl Architecture {
    /// Hidden layers of `width` channels and an output layer. Convolutions are centred, or use only earlier instants if
    /// `causal`.
    ///
    /// # Panics
    /// If the number of layers is not in 2 … `LAYERS_MAX`, a size is 0, or a centred kernel is even.
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

    /// The paper's layers with any width.
    pub fn paper(width: usize) -> Self {
        Self::new(width, &[3, 3, 1], &[1, 1, 1], false)
    }

    /// Channels of the hidden layers.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Whether predictions depend only on the present and earlier instants.
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

/// Sizes of a network and of its signals.
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

    /// Range of block b₁ … b_n, w₁ … w_n (0 … 2n − 1) in the flat order.
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

    /// Padded number of channels of hidden activations in memory; channels beyond the width stay 0.
    pub(super) fn stride(&self) -> usize {
        self.architecture.width.next_multiple_of(COLUMNS)
    }
}

/// Sizes of a layer. Its input is padded by `before` rows of zeros at the start and `after` at the end, the cotangent of its
/// output by `after` and `before`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Conv {
    pub instants: usize,
    pub kernel: usize,
    pub dilation: usize,
    pub before: usize,
    pub after: usize,
    pub inputs: usize,
    pub outputs: usize,
    /// Distances between rows of the input and of the output.
    pub input_stride: usize,
    pub output_stride: usize,
    /// Whether `winograd` computes pairs of instants.
    pub paired: bool,
}

impl Conv {
    /// Length of a padded input.
    pub fn input_len(&self) -> usize {
        (self.before + self.instants + self.after) * self.input_stride
    }

    /// Index of the first instant in a padded input.
    pub fn input_start(&self) -> usize {
        self.before * self.input_stride
    }

    /// Length of a padded cotangent of the output.
    pub fn output_len(&self) -> usize {
        (self.before + self.instants + self.after) * self.output_stride
    }

    /// Index of the first instant in a padded cotangent.
    pub fn output_start(&self) -> usize {
        self.after * self.output_stride
    }

    /// Convolution from inputs to outputs.
    pub fn forward(&self) -> Convolution {
        self.sweep(self.inputs, self.input_stride, self.output_stride)
    }

    /// Convolution from cotangents of outputs to those of inputs; weights reversed in time and transposed.
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

/// A convolution in the form of `kernels`: contiguous rows form one tap.
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

/// Initial weights: normal with variance 2/fan_in (last layer 1/fan_in), biases 0. `which` numbers the networks of one seed.
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

/// Multiplies the weights of input c by `factors[c]`, so that predictions from x equal earlier predictions from x · `factors`
/// (3M). Inputs beyond the factors keep their weights.
pub fn scale_inputs(shape: Shape, weights: &mut [f32], factors: &[f64]) {
    let Conv { inputs, outputs, .. } = shape.conv(0);
    for tap in weights[shape.range(shape.layers())].chunks_exact_mut(inputs * outputs) {
        for (row, factor) in tap.chunks_exact_mut(outputs).zip(factors) {
            row.iter_mut().for_each(|w| *w = (f64::from(*w) * factor) as f32);
        }
    }
}
