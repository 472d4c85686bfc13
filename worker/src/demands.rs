//! What a brain asks of the device that it runs on, array by array as `metasense export --format c` declares them; what a trial asks of the
//! machine.

pub mod memory;

use metasense_schemas::spec::{BrainKind, TrialSpec};

use crate::problem::{Invalid, architecture, lags};
use crate::replay::Convolution;

/// Of one brain on a 32-bit device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Demands {
    /// Instants that it looks ahead.
    pub delay: usize,
    /// Bytes of constants (.rodata), each array in whole words.
    pub constants: usize,
    /// Bytes of memory (.bss) likewise.
    pub memory: usize,
    /// Multiply-adds a reading.
    pub operations: usize,
}

/// Bytes of a weight, of what goes from layer to layer, and of a sum, in 32-bit floats.
const FLOATS: [usize; 3] = [4; 3];

impl Demands {
    /// Of layers whose weights, values between layers, and sums have so many bytes; weights of less than four are integers.
    #[must_use]
    pub fn of(layers: &[Convolution], [weight, value, sum]: [usize; 3]) -> Self {
        let integers = weight < 4;
        let words = |bytes: usize| bytes.next_multiple_of(4);
        let (mut constants, mut memory) = (0, 0);
        for (l, layer) in layers.iter().enumerate() {
            // weights, biases, a row of the table of layers
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

    /// Of a trial's brain in 32-bit floats; `None` of an inverse one, which has no form for a device.
    ///
    /// # Errors
    /// If the trial has no such network.
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
