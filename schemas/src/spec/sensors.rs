//! Where and how the body is read.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The frame in which accelerations are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Frame {
    /// Fixed axes.
    #[default]
    World,
    /// Turning with the unit, as a glued chip reads.
    Body,
}

/// Where and how the body is read.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Sensors {
    /// World or body frame.
    pub frame: Frame,
    /// Lists of units instead of `sweep.placements`; a trial with M sensors takes every list of M units.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub placements: Option<Vec<Vec<usize>>>,
}
