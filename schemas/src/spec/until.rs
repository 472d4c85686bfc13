//! When a sweep knows enough.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Questions that end a sweep when they are settled; the grid is then the most that it may become.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Until {
    /// Error of the initial over that of the optimised body, to an interval this part of it wide.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub paired: Option<f64>,
    /// The smallest M whose error on the optimised body is within this part of the best M's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub within: Option<f64>,
    /// Where more sensors on the optimised body stop to pay.
    pub elbow: bool,
    /// The fewest sensors on the optimised body that beat the most on the initial one.
    pub fewer: bool,
    /// Whether the optimised body's error falls with the number of design parameters.
    pub complexity: bool,
    /// Least probability that an answer is right, each question and setting by itself.
    pub confidence: f64,
    /// The most that may be run, where it is not the lists of the sweep.
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
    /// Placements, for `sweep.placements`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub placements: Option<usize>,
    /// Seeds: those of `sweep.seeds` and as many after the last one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seeds: Option<usize>,
    /// CPU hours of all trials; no further ones are begun beyond.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hours: Option<f64>,
}
