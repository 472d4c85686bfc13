//! The force histories.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Kind of force histories.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum StimuliKind {
    /// Smooth bell pulses.
    Bell,
}

/// The force histories. Intervals are `[least, most]` of a uniform draw per sample and panel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Stimuli {
    /// What kind of histories.
    pub kind: StimuliKind,
    /// N: samples that train and test the brain.
    #[serde(default = "stimuli_samples")]
    pub samples: usize,
    /// How many of the N are the test set.
    #[serde(default = "stimuli_test")]
    pub test: usize,
    /// Further samples that neither loop ever sees.
    #[serde(default = "stimuli_holdout")]
    pub holdout: usize,
    /// Amplitude A (N).
    #[serde(default = "amplitude")]
    pub amplitude: [f64; 2],
    /// Width W (s).
    #[serde(default = "width")]
    pub width: [f64; 2],
    /// Onset O (s).
    #[serde(default = "onset")]
    pub onset: [f64; 2],
    /// Peak position p, as a part of the width.
    #[serde(default = "peak")]
    pub peak: [f64; 2],
    /// Power q.
    #[serde(default = "power")]
    pub power: [f64; 2],
}

fn stimuli_samples() -> usize {
    300
}
fn stimuli_test() -> usize {
    30
}
fn stimuli_holdout() -> usize {
    60
}
fn amplitude() -> [f64; 2] {
    [0.15, 0.5]
}
fn width() -> [f64; 2] {
    [0.06, 0.25]
}
fn onset() -> [f64; 2] {
    [0.0, 0.5]
}
fn peak() -> [f64; 2] {
    [0.35, 0.65]
}
fn power() -> [f64; 2] {
    [1.5, 4.0]
}
