//! A decoder as layers from signals to forces, and their outputs in single precision, summed in the order of a device.
//!
//! ```text
//! y[t] = b + Σ_i w_i Σ_j x[t − before + (s_i + j) d]      j = 0 … span_i − 1, s_i = Σ of the spans before i; x = 0 outside a sample
//! ```
//! A network's layers pass on max(y, 0) and have spans of 1. In a linear decoder, four long lags share a weight. The linear layer
//! of a stacked decoder passes on x[t], then y[t].

use std::ops::{AddAssign, Mul};

use metasense_numerics::brain::linear::{Lags, Sizes};
use metasense_numerics::brain::{Architecture, Layer};
use metasense_numerics::stimuli::targets;
use metasense_numerics::trial::Samples;
use metasense_schemas::spec::TrialSpec;
use metasense_worker::invalid::invalid;
use metasense_worker::run::NoResult;

use super::{LinearReplay, Replay, ReplayDecoder};
use crate::prepare::prepared;

/// A layer of a decoder.
#[derive(Debug, Clone, PartialEq)]
pub struct Convolution {
    /// Number of instants summed per tap.
    pub spans: Vec<usize>,
    /// d (instants).
    pub dilation: usize,
    /// Instants before t that the layer uses.
    pub before: usize,
    /// Number of channels of x.
    pub inputs: usize,
    /// Number of channels of y.
    pub outputs: usize,
    /// Whether the layer is a linear decoder: w is (inputs, outputs, taps), and sums follow this order; else (taps, outputs,
    /// inputs).
    pub linear: bool,
    /// w.
    pub weights: Vec<f64>,
    /// b.
    pub bias: Vec<f64>,
}

impl Convolution {
    /// The layer of a linear decoder, with zero weights.
    pub fn linear(lags: Lags, inputs: usize, outputs: usize) -> Self {
        let spans: Vec<usize> = lags.groups().iter().map(ExactSizeIterator::len).collect();
        let weights = vec![0.0; spans.len() * inputs * outputs];
        let (dilation, before, bias) = (1, lags.before, vec![0.0; outputs]);
        Self { spans, dilation, before, inputs, outputs, linear: true, weights, bias }
    }

    /// The layers of a network, with zero weights.
    pub fn network(architecture: &Architecture, mut inputs: usize, outputs: usize) -> Vec<Self> {
        let all = architecture.layers();
        let layer = |(l, layer): (usize, &Layer)| {
            let reach = (layer.kernel - 1) * layer.dilation;
            let width = if l + 1 < all.len() { architecture.width() } else { outputs };
            let inputs = std::mem::replace(&mut inputs, width);
            Self {
                spans: vec![1; layer.kernel],
                dilation: layer.dilation,
                before: if architecture.causal() { reach } else { reach / 2 },
                inputs,
                outputs: width,
                linear: false,
                weights: vec![0.0; layer.kernel * inputs * width],
                bias: vec![0.0; width],
            }
        };
        all.iter().enumerate().map(layer).collect()
    }

    /// Largest number of channels that a layer computes or passes on.
    pub fn widest(layers: &[Self]) -> usize {
        let made = layers.iter().map(|layer| layer.outputs);
        made.chain(layers[1..].iter().map(|layer| layer.inputs)).max().unwrap_or(0)
    }

    /// Instants between the first and last input of a sum, inclusive.
    pub fn slots(&self) -> usize {
        (self.spans.iter().sum::<usize>() - 1) * self.dilation + 1
    }

    /// Instants after t that the layer uses.
    pub fn after(&self) -> usize {
        self.slots() - 1 - self.before
    }

    /// Input, output and tap of weight `i`.
    pub fn of_weight(&self, i: usize) -> [usize; 3] {
        let (taps, inputs, outputs) = (self.spans.len(), self.inputs, self.outputs);
        match self.linear {
            true => [i / (taps * outputs), i / taps % outputs, i % taps],
            false => [i % inputs, i / inputs % outputs, i / (inputs * outputs)],
        }
    }

    /// Inputs of the next layer: `y`, after `x` if this layer is a linear decoder.
    pub(super) fn handed_on<T: Copy>(&self, x: &[T], y: Vec<T>) -> Vec<T> {
        if !self.linear {
            return y;
        }
        let instants = x.chunks_exact(self.inputs).zip(y.chunks_exact(self.outputs));
        instants.flat_map(|(x, y)| [x, y].concat()).collect()
    }

    /// Sums (T, outputs) for one sample (T, inputs). Each starts with the bias; products follow in the order of the weights.
    pub(super) fn sums<T>(&self, weights: &[T], bias: &[T], x: &[T]) -> Vec<T>
    where
        T: Copy + Default + AddAssign + Mul<Output = T>,
    {
        let (instants, taps, inputs) = (x.len() / self.inputs, self.spans.len(), self.inputs);
        let mut y = Vec::with_capacity(instants * self.outputs);
        let mut seen = vec![T::default(); taps * inputs];
        let row = if self.linear { taps } else { inputs };
        for t in 0..instants {
            seen.fill(T::default());
            // Index relative to `before` instants ahead of the sample.
            let mut at = t;
            for (tap, span) in self.spans.iter().enumerate() {
                for n in (0..*span).map(|j| at + j * self.dilation) {
                    if (self.before..self.before + instants).contains(&n) {
                        for (c, x) in x[(n - self.before) * inputs..][..inputs].iter().enumerate() {
                            seen[if self.linear { c * taps + tap } else { tap * inputs + c }] += *x;
                        }
                    }
                }
                at += span * self.dilation;
            }
            y.extend_from_slice(bias);
            let y = &mut y[t * self.outputs..];
            for (seen, w) in seen.chunks_exact(row).zip(weights.chunks_exact(row * self.outputs)) {
                for (y, w) in y.iter_mut().zip(w.chunks_exact(row)) {
                    w.iter().zip(seen).for_each(|(w, x)| *y += *w * *x);
                }
            }
        }
        y
    }
}

/// A decoder as layers from signals (mm/s², rad/s) to forces (N), with the scales of a replay.
///
/// # Errors
/// If the spec is invalid.
///
/// # Panics
/// If the weights do not match the trial's network.
pub fn layers(trial: &TrialSpec, own: &ReplayDecoder, replay: &Replay) -> Result<Vec<Convolution>, NoResult> {
    if let ReplayDecoder::Network(_) = own
        && replay.has_offset()
    {
        let remedy =
            "has no layers to export, because signals are padded with the middle of their range: export npz";
        return Err(NoResult::Rejected(invalid("brain.scaling", "\"minmax\"", remedy).to_string()));
    }
    let mut layers = match own {
        ReplayDecoder::Linear(linear) => vec![of_linear(linear, replay)],
        ReplayDecoder::Network(weights) => of_network(trial, weights, replay)?,
        ReplayDecoder::Stacked(linear, weights) => {
            let mut first = of_linear(linear, replay);
            // Normalised forces, as the network expects them.
            let deviation = |i: usize| replay.force_deviation[first.of_weight(i)[1]];
            first.weights = first.weights.iter().enumerate().map(|(i, w)| w / deviation(i)).collect();
            let scales = replay.force_mean.iter().zip(&replay.force_deviation);
            first.bias.iter_mut().zip(scales).for_each(|(b, (mean, deviation))| *b = (*b - mean) / deviation);
            [vec![first], of_network(trial, weights, replay)?].concat()
        }
    };
    // The network of a stacked decoder also uses signals.
    let take_signals = if layers[0].linear { 2 } else { 1 };
    for layer in layers.iter_mut().take(take_signals) {
        for i in 0..layer.weights.len() {
            if let Some(scale) = replay.signal_scale.get(layer.of_weight(i)[0]) {
                layer.weights[i] /= scale;
            }
        }
    }
    Ok(layers)
}

/// Layer from normalised signals to forces (N).
fn of_linear(LinearReplay { lags, w, b, .. }: &LinearReplay, replay: &Replay) -> Convolution {
    let channels = replay.signal_scale.len();
    let mut layer = Convolution::linear(*lags, channels, replay.force_mean.len());
    let firsts: Vec<usize> = lags.groups().iter().map(|group| group.start).collect();
    for i in 0..layer.weights.len() {
        let [c, k, tap] = layer.of_weight(i);
        layer.weights[i] = w[(k * lags.count() + firsts[tap]) * channels + c];
    }
    layer.bias.clone_from(b);
    layer
}

/// Layers from normalised inputs to forces (N).
fn of_network(trial: &TrialSpec, weights: &[f32], replay: &Replay) -> Result<Vec<Convolution>, NoResult> {
    let (shape, panels) = (prepared(trial)?.reader_shape(), replay.force_mean.len());
    let mut layers = Convolution::network(&shape.architecture, shape.inputs, panels);
    let count = layers.len();
    for (l, layer) in layers.iter_mut().enumerate() {
        let stored = &weights[shape.range(count + l)];
        for i in 0..layer.weights.len() {
            let [c, o, tap] = layer.of_weight(i);
            layer.weights[i] = f64::from(stored[(tap * layer.inputs + c) * layer.outputs + o]);
        }
        layer.bias = weights[shape.range(l)].iter().map(|b| f64::from(*b)).collect();
    }
    let last = layers.last_mut().expect("a network has layers");
    let inputs = last.inputs;
    let deviation = |i: usize| replay.force_deviation[i / inputs % panels];
    last.weights.iter_mut().enumerate().for_each(|(i, w)| *w *= deviation(i));
    let scales = replay.force_deviation.iter().zip(&replay.force_mean);
    last.bias.iter_mut().zip(scales).for_each(|(b, (deviation, mean))| *b = *b * deviation + mean);
    Ok(layers)
}

/// Layers in single precision.
#[derive(Debug, Clone, PartialEq)]
pub struct SinglePrecision {
    layers: Vec<Convolution>,
    weights: Vec<[Vec<f32>; 2]>,
}

impl SinglePrecision {
    /// Rounds layers to single precision.
    pub fn new(layers: &[Convolution]) -> Self {
        let rounded = |values: &[f64]| values.iter().map(|v| *v as f32).collect();
        let weights = layers.iter().map(|l| [rounded(&l.weights), rounded(&l.bias)]).collect();
        Self { layers: layers.to_vec(), weights }
    }

    /// Forces (T, K) (N) for the signals (T, channels) of a sample.
    pub fn read(&self, signals: &[f64]) -> Vec<f32> {
        self.read_by_layers(signals, &mut |_, _| {})
    }

    /// As `read`; passes the number and inputs (T, inputs) of each layer to `meet`.
    pub(super) fn read_by_layers(&self, signals: &[f64], meet: &mut dyn FnMut(usize, &[f32])) -> Vec<f32> {
        let mut x: Vec<f32> = signals.iter().map(|v| *v as f32).collect();
        for (l, (layer, [weights, bias])) in self.layers.iter().zip(&self.weights).enumerate() {
            meet(l, &x);
            let mut y = layer.sums(weights, bias, &x);
            if l + 1 < self.layers.len() {
                y.iter_mut().filter(|_| !layer.linear).for_each(|y| *y = y.max(0.0));
                y = layer.handed_on(&x, y);
            }
            x = y;
        }
        x
    }
}

/// Mean held-out error (%) of the estimates `read` (T, K) (N) from a sample's signals (T, channels); `None` without a held-out
/// set.
pub fn holdout_error(replay: &Replay, read: &dyn Fn(&[f64]) -> Vec<f32>) -> Option<f64> {
    let (channels, outputs) = (replay.signal_scale.len(), replay.force_mean.len());
    let instants = replay.signals.len() / replay.split.len() / channels;
    let targets = targets(&replay.forces, instants, false);
    let all = Samples::new(Sizes { instants, channels, outputs }, replay.signals.clone(), targets);
    let of: Vec<usize> = (0..replay.split.len()).filter(|&i| replay.split[i] == 2).collect();
    let holdout = all.with_failed(replay.failed.clone()).select(&of);
    let said = holdout.signals.chunks_exact(instants * channels).flat_map(read);
    holdout.error(&said.map(f64::from).collect::<Vec<_>>())
}
