//! The limits of a castable design.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Limits of a castable design (degrees, mm).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Feasible {
    /// Least interior angle of a unit (degrees).
    pub min_block_angle: f64,
    /// Greatest interior angle of a unit (degrees).
    pub max_block_angle: f64,
    /// Least void angle at a ligament (degrees).
    pub min_void_angle: f64,
    /// Least angle between a ligament and an edge (degrees).
    pub min_ligament_angle: f64,
    /// Least edge of a unit (mm).
    pub min_edge: f64,
    /// Least distance between units (mm).
    pub clearance: f64,
    /// Least distance where ligaments are involved (mm).
    pub ligament_clearance: f64,
    /// Whether the units that are struck keep their initial shape.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub keep_panels: bool,
    /// Whether the clamped units keep their initial shape.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub keep_clamped: bool,
}

impl Default for Feasible {
    fn default() -> Self {
        Self {
            min_block_angle: 25.0,
            max_block_angle: 170.0,
            min_void_angle: 5.0,
            min_ligament_angle: 10.0,
            min_edge: 3.0,
            clearance: 1.0,
            ligament_clearance: 0.5,
            keep_panels: false,
            keep_clamped: false,
        }
    }
}
