//! What a brain asks of the device that it runs on, told by its trial alone: as `metasense export --format c` writes it.

use metasense_numerics::trial::BrainKind;
use metasense_schemas::spec::TrialSpec;

use crate::problem::{Invalid, problem};

/// Of one brain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Demands {
    /// Instants that it looks ahead.
    pub delay: usize,
    /// Numbers that it consists of: weights and biases.
    pub constants: usize,
    /// Numbers of working memory: the inputs that its layers keep, two outputs, and counters.
    pub working: usize,
    /// Multiply-adds a reading.
    pub operations: usize,
}

impl Demands {
    /// Memory of 32-bit numbers (bytes).
    #[must_use]
    pub fn bytes(&self) -> usize {
        4 * (self.constants + self.working)
    }
}

/// Of a trial's brain; `None` of a stacked or an inverse one, which has no form for a device.
///
/// # Errors
/// If the spec stands for no trial.
pub fn demands(trial: &TrialSpec) -> Result<Option<Demands>, Invalid> {
    let problem = problem(trial)?;
    let (channels, panels) = (trial.signals(), problem.scene.panels.len());
    // taps, dilation, instants ahead, outputs of each layer
    let layers: Vec<[usize; 4]> = match problem.reader {
        BrainKind::Linear => {
            let lags = problem.decoder.lags;
            vec![[lags.count(), 1, lags.after, panels]]
        }
        BrainKind::Network => {
            let shape = problem.reader_shape();
            let (all, causal) = (shape.architecture.layers(), shape.architecture.causal());
            let layer = |(l, layer): (usize, &_)| {
                let metasense_numerics::brain::Layer { kernel, dilation } = *layer;
                let reach = (kernel - 1) * dilation;
                let outputs = if l + 1 < all.len() { shape.architecture.width() } else { panels };
                [kernel, dilation, if causal { 0 } else { reach - reach / 2 }, outputs]
            };
            all.iter().enumerate().map(layer).collect()
        }
        BrainKind::Stacked | BrainKind::Inverse => return Ok(None),
    };
    let mut found = Demands { delay: 0, constants: 0, working: 0, operations: 0 };
    let (count, mut inputs, mut widest) = (layers.len(), channels, 0);
    for [taps, dilation, after, outputs] in layers {
        found.delay += after;
        found.operations += taps * inputs * outputs;
        found.constants += (taps * inputs + 1) * outputs;
        found.working += ((taps - 1) * dilation + 1) * inputs;
        (inputs, widest) = (outputs, widest.max(outputs));
    }
    // two outputs at a time, and three counters a layer
    found.working += 2 * widest + 3 * count;
    Ok(Some(found))
}
