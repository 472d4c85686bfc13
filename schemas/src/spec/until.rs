//! When a sweep knows enough.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Questions that end a sweep when they are settled; the grid is then the most that it may become.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Until {
    /// The gain: error of the initial over error of the optimised body, until its interval is this fraction of it wide.
    /// Unit: 1. Default: not asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub paired: Option<f64>,
    /// The smallest M whose error on the optimised body exceeds the best M's by at most this fraction. Unit: 1. Default: not
    /// asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub within: Option<f64>,
    /// The M beyond which more sensors on the optimised body gain little, where the logarithm of its error bends; needs four values of M.
    /// `analyse` asks in per cent, too, and whether a smooth decay does as well, so that it may still find none.
    pub elbow: bool,
    /// The fewest sensors on the optimised body that beat the most on the initial one.
    pub fewer: bool,
    /// Whether the optimised body's error falls with the number of design parameters.
    pub complexity: bool,
    /// Probability that an answer is right, of each question and setting by itself. Unit: 1.
    pub confidence: f64,
    /// The most that may be run. Without it, that is what the lists of the sweep say.
    pub at_most: AtMost,
}

impl Default for Until {
    fn default() -> Self {
        Self {
            paired: None,
            within: None,
            elbow: false,
            fewer: false,
            complexity: false,
            confidence: 0.95,
            at_most: AtMost::default(),
        }
    }
}

/// The most that may be run.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AtMost {
    /// Placements. Default: `sweep.placements`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub placements: Option<usize>,
    /// Seeds: those of `sweep.seeds`, then the numbers after the last one. Default: `sweep.seeds`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seeds: Option<usize>,
    /// CPU time of all trials; beyond it no trial is begun. Unit: h. Default: no limit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hours: Option<f64>,
}
