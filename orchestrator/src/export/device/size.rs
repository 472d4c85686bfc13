//! What an exported brain takes of a 32-bit device, array by array as its file declares them.

use metasense_worker::replay::Convolution;

use super::Numbers;

/// Bytes of constants (.rodata) and of memory (.bss), each array in whole words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Size {
    pub constants: usize,
    pub memory: usize,
}

impl Size {
    /// Of these layers in these numbers, sums of 64 bits where they are `wide`.
    pub fn of(layers: &[Convolution], numbers: Numbers, wide: bool) -> Self {
        let (weight, value) = match numbers {
            Numbers::F32 => (4, 4),
            Numbers::I16 => (2, 2),
            Numbers::I8 => (1, 2),
        };
        let (sum, integers) = (if wide { 8 } else { 4 }, numbers != Numbers::F32);
        let words = |bytes: usize| bytes.next_multiple_of(4);
        let (mut constants, mut memory) = (0, 0);
        for (l, layer) in layers.iter().enumerate() {
            // weights, biases, a row of the table of layers
            constants += words(weight * layer.weights.len()) + 4 * layer.bias.len();
            constants += if integers { 44 } else { 36 };
            if layer.by_input {
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
        let widest = layers.iter().map(|layer| layer.outputs).max().unwrap_or(0);
        memory += sum * widest + 12 * layers.len();
        if layers.len() > 1 {
            memory += words(value * widest);
        }
        Self { constants, memory }
    }
}
