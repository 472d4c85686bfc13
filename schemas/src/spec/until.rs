//! Questions that end a sweep early (`[until]`).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;

/// Questions that end a sweep when they are answered; the grid is an upper limit.
#[skip_serializing_none]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Until {
    /// Gain by training (error of the initial body divided by that of the trained body), until the width of its interval is this
    /// fraction of the gain. Unit: 1. Default: none.
    pub paired: Option<f64>,
    /// The smallest M whose error on the trained body exceeds that of the best M by at most this fraction. Unit: 1. Default:
    /// none.
    pub within: Option<f64>,
    /// The M beyond which more sensors on the trained body gain little: the elbow of the logarithm of its error. Needs four
    /// values of M. `analyse` also tests errors in per cent and a smooth decay, so it may find no elbow.
    pub elbow: bool,
    /// The fewest sensors on the trained body that beat the most sensors on the initial body.
    pub fewer: bool,
    /// Whether the error of the trained body falls with the number of design parameters.
    pub complexity: bool,
    /// Probability that an answer is right, for each question and setting separately. Unit: 1.
    pub confidence: f64,
    /// Upper limits of the sweep. Without it, the lists of `[sweep]`.
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

/// Upper limits of a sweep.
#[skip_serializing_none]
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AtMost {
    /// Placements. Default: `sweep.placements`.
    pub placements: Option<usize>,
    /// Seeds: those of `sweep.seeds`, then the numbers after the last one. Default: `sweep.seeds`.
    pub seeds: Option<usize>,
    /// CPU time of all trials; beyond it no further trial starts. Unit: h. Default: no limit.
    pub hours: Option<f64>,
}
