//! Resources that a decoder needs on a device, counted from the arrays that `metasense export --format c` declares.

use metasense_schemas::spec::{BrainKind, TrialSpec};
use metasense_worker::problem::{Invalid, architecture, lags};

use crate::replay::Convolution;

/// Resources of one decoder on a 32-bit device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Demands {
    /// Look-ahead (instants).
    pub delay: usize,
    /// Constants in .rodata (bytes), each array in whole words.
    pub constants: usize,
    /// Memory in .bss (bytes), each array in whole words.
    pub memory: usize,
    /// Multiply-adds per reading.
    pub operations: usize,
}

/// Bytes per weight, per value between layers and per sum, in 32-bit floats.
const FLOATS: [usize; 3] = [4; 3];

impl Demands {
    /// Resources for layers with these sizes (bytes) of weights, values between layers, and sums; weights of less than four bytes
    /// are integers.
    pub fn of(layers: &[Convolution], [weight, value, sum]: [usize; 3]) -> Self {
        let integers = weight < 4;
        let words = |bytes: usize| bytes.next_multiple_of(4);
        let (mut constants, mut memory) = (0, 0);
        for (l, layer) in layers.iter().enumerate() {
            // Weights, biases, and one row of the layer table.
            constants += words(weight * layer.weights.len()) + 4 * layer.bias.len();
            constants += if integers { 44 } else { 36 };
            if layer.linear {
                constants += words(layer.spans.len());
                memory += 4 * layer.spans.len();
            }
            if integers && l + 1 < layers.len() {
                constants += words(5 * layer.outputs);
            }
            memory += words(value * layer.slots() * layer.inputs);
        }
        if integers {
            constants += 4 * (layers[0].inputs + layers[layers.len() - 1].outputs);
        }
        let widest = Convolution::widest(layers);
        memory += sum * widest + 12 * layers.len();
        if layers.len() > 1 {
            memory += words(value * widest);
        }
        let delay = layers.iter().map(Convolution::after).sum();
        let operations = layers.iter().map(|layer| layer.weights.len()).sum();
        Self { delay, constants, memory, operations }
    }

    /// Resources of a trial's decoder in 32-bit floats; `None` for an inverse decoder, which has no export for devices.
    ///
    /// # Errors
    /// If the trial's network is invalid.
    pub fn of_trial(trial: &TrialSpec) -> Result<Option<Self>, Invalid> {
        let (inputs, outputs) = (trial.signals(), trial.point.panels);
        let linear = || vec![Convolution::linear(lags(&trial.time, trial.brain.memory), inputs, outputs)];
        let network = |inputs| Ok(Convolution::network(&architecture(trial)?, inputs, outputs));
        let layers = match trial.brain.kind {
            BrainKind::Linear => linear(),
            BrainKind::Cnn => network(inputs)?,
            BrainKind::Stacked => [linear(), network(inputs + outputs)?].concat(),
            BrainKind::Inverse => return Ok(None),
        };
        Ok(Some(Self::of(&layers, FLOATS)))
    }
}
