//! Limits of feasible designs (`[feasible]`).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Limits of a design that can be cast (degrees, mm).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Feasible {
    /// Whether designs are limited. `false`: any design is accepted, and results state overlapping units. Default: true.
    #[serde(skip_serializing_if = "bool::clone")]
    pub limits: bool,
    /// Smallest interior angle of a unit. Unit: degrees.
    pub min_block_angle: f64,
    /// Largest interior angle of a unit. Unit: degrees.
    pub max_block_angle: f64,
    /// Smallest angle of the void between two units at a ligament. Unit: degrees.
    pub min_void_angle: f64,
    /// Smallest angle between a ligament and an edge. Unit: degrees.
    pub min_ligament_angle: f64,
    /// Shortest edge of a unit. Unit: mm.
    pub min_edge: f64,
    /// Smallest distance between units. Unit: mm.
    pub clearance: f64,
    /// Smallest distance between a ligament and a unit, or two ligaments. Unit: mm.
    pub ligament_clearance: f64,
}

impl Default for Feasible {
    fn default() -> Self {
        Self {
            limits: true,
            min_block_angle: 25.0,
            max_block_angle: 170.0,
            min_void_angle: 5.0,
            min_ligament_angle: 10.0,
            min_edge: 3.0,
            clearance: 1.0,
            ligament_clearance: 0.5,
        }
    }
}
