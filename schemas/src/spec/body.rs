//! The body: layout, sizes, material, the design to start from.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The layout of a body's units.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum LayoutKind {
    /// `columns` × `rows` units on a square grid.
    Planar,
    /// The units of a square lattice whose centres lie inside a disc, `columns` across.
    Circular,
}

/// Which units are held.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Clamp {
    /// `"bottom"`: the bottom row (planar); `"hub"`: the innermost units (circular).
    Rule(ClampRule),
    /// Unit indices.
    Units(Vec<usize>),
}

/// A named set of clamped units.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ClampRule {
    /// The bottom row of a planar body.
    Bottom,
    /// The innermost 2 × 2 units, or the one, of a circular body.
    Hub,
}

/// The design that a body starts from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged, deny_unknown_fields)]
pub enum Design {
    /// A file, from the spec's folder: NPY of α in the order of MODEL.md, or CSV of nodes (`unit,node,x,y`, mm).
    File(std::path::PathBuf),
    /// `{ random = SEED }`: rotated squares with every node moved at random, then made castable.
    Random {
        /// The seed.
        random: u64,
    },
    /// `{ shifts = [ … ] }`: α itself (mm); what a file becomes in a trial.
    Shifts {
        /// α, in the order of MODEL.md.
        shifts: Vec<f64>,
    },
}

/// Sizes and material of a body.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Planar or circular.
    #[serde(default = "planar")]
    pub layout: LayoutKind,
    /// Which units are held; by default the bottom row (planar) or the hub (circular).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clamp: Option<Clamp>,
    /// Linear strain measures (node displacements stay exact).
    #[serde(default)]
    pub linearised: bool,
    /// Input panels by unit, instead of the rule in MODEL.md.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub panel_units: Option<Vec<usize>>,
    /// Units along x; across the diameter where circular.
    pub columns: usize,
    /// Units along y; where circular: left out of a spec, equal to `columns` in a trial.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rows: Option<usize>,
    /// Of a circular body (mm). Given, the lengths of a unit and its limits follow from it, in the proportions that they are
    /// written in: `spacing` is `diameter / columns`, and `stiffness.bend` goes with its square. Not in a trial.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub diameter: Option<f64>,
    /// Of a planar body along x (mm), likewise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub width: Option<f64>,
    /// Pitch of the units (mm).
    pub spacing: f64,
    /// Length of a ligament at rest (mm).
    pub ligament_length: f64,
    /// Angle of the rotated squares of the initial design (degrees).
    #[serde(default = "initial_angle")]
    pub initial_angle: f64,
    /// The design to start from, instead of the rotated squares: a file, or `{ random = SEED }`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub design: Option<Design>,
    /// Plane density (Mg/mm²).
    pub density: f64,
    /// ζ: damping of a degree of freedom relative to its own critical one.
    #[serde(default = "damping_ratio")]
    pub damping_ratio: f64,
    /// Ligament stiffnesses.
    pub stiffness: Stiffness,
    /// Contact between neighbouring units; left out: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub contact: Option<Contact>,
}

fn planar() -> LayoutKind {
    LayoutKind::Planar
}
fn initial_angle() -> f64 {
    25.0
}
fn damping_ratio() -> f64 {
    0.02
}

/// Ligament stiffnesses.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Stiffness {
    /// k_l (N/mm).
    pub stretch: f64,
    /// k_s (N/mm).
    pub shear: f64,
    /// k_θ (N·mm/rad).
    pub bend: f64,
}

/// Contact between the edges that face each other across a ligament.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Contact {
    /// k_c (N·mm/rad²).
    pub stiffness: f64,
    /// ψ_min (degrees).
    pub min_angle: f64,
    /// ψ_c (degrees).
    pub cutoff_angle: f64,
}

impl Default for Contact {
    fn default() -> Self {
        Self { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 5.0 }
    }
}
