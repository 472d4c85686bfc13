//! What a brain asks of the device that it runs on, told by its trial alone: as `metasense export --format c` writes it.

use metasense_numerics::trial::BrainKind;
use metasense_schemas::spec::TrialSpec;

use crate::problem::{Invalid, problem};

/// Of one brain, in 32-bit numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Demands {
    /// Instants that it looks ahead.
    pub delay: usize,
    /// Bytes of constants and of working memory.
    pub bytes: usize,
    /// Multiply-adds a reading.
    pub operations: usize,
}

/// A layer: instants that each tap adds up, instants between taps, instants that it looks ahead, outputs.
type Layer = (Vec<usize>, usize, usize, usize);

/// Of a trial's brain; `None` of a stacked or an inverse one, which has no form for a device.
///
/// # Errors
/// If the spec stands for no trial.
pub fn demands(trial: &TrialSpec) -> Result<Option<Demands>, Invalid> {
    let problem = problem(trial)?;
    let (channels, panels) = (trial.signals(), problem.scene.panels.len());
    let layers: Vec<Layer> = match problem.reader {
        BrainKind::Linear => {
            let lags = problem.decoder.lags;
            vec![(lags.groups().iter().map(ExactSizeIterator::len).collect(), 1, lags.after, panels)]
        }
        BrainKind::Network => {
            let shape = problem.reader_shape();
            let (all, causal) = (shape.architecture.layers(), shape.architecture.causal());
            let layer = |(l, layer): (usize, &metasense_numerics::brain::Layer)| {
                let reach = (layer.kernel - 1) * layer.dilation;
                let outputs = if l + 1 < all.len() { shape.architecture.width() } else { panels };
                (vec![1; layer.kernel], layer.dilation, if causal { 0 } else { reach - reach / 2 }, outputs)
            };
            all.iter().enumerate().map(layer).collect()
        }
        BrainKind::Stacked | BrainKind::Inverse => return Ok(None),
    };
    // the arrays that an exported file declares, in whole words
    let linear = problem.reader == BrainKind::Linear;
    let mut found = Demands { delay: 0, bytes: 0, operations: 0 };
    let (count, mut inputs, mut widest) = (layers.len(), channels, 0);
    for (spans, dilation, after, outputs) in layers {
        let (weights, slots) =
            (spans.len() * inputs * outputs, (spans.iter().sum::<usize>() - 1) * dilation + 1);
        found.delay += after;
        found.operations += weights;
        // weights, biases, a row of the table of layers; the readings that it keeps
        found.bytes += 4 * (weights + outputs) + 36 + 4 * slots * inputs;
        if linear {
            found.bytes += spans.len().next_multiple_of(4) + 4 * spans.len();
        }
        (inputs, widest) = (outputs, widest.max(outputs));
    }
    found.bytes += 12 * count + 4 * widest * count.min(2);
    Ok(Some(found))
}
