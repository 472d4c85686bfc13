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
    /// `"bottom"`, the bottom row (planar), or `"hub"`, the innermost units (circular).
    Rule(ClampRule),
    /// a list of units.
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
    /// a file, relative to the spec: NPY of α in the order of MODEL.md, or CSV of nodes (`unit,node,x,y`, mm).
    File(std::path::PathBuf),
    /// `{ random = SEED }`, rotated squares with every node moved at random, projected onto the nearest castable design.
    Random {
        /// The seed.
        random: u64,
    },
    /// `{ shifts = [ … ] }`, α itself (mm), which is how a trial stores a file's design.
    Shifts {
        /// α, in the order of MODEL.md.
        shifts: Vec<f64>,
    },
}

/// Sizes and material of a body.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Where the units are.
    #[serde(default = "planar")]
    pub layout: LayoutKind,
    /// Units that are held. Default: `"bottom"` for a planar body, `"hub"` for a circular one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clamp: Option<Clamp>,
    /// Whether ligaments have linear strain measures; displacements of nodes stay exact.
    #[serde(default)]
    pub linearised: bool,
    /// Units that are struck. Default: by the rule in MODEL.md.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub panel_units: Option<Vec<usize>>,
    /// Angle by which the forces on all panels are turned, anticlockwise, from down on a planar body and from inward on a circular
    /// one. Unit: degrees. Default: 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub panel_angle: Option<f64>,
    /// Units along x; of a circular body across its diameter.
    pub columns: usize,
    /// Units along y; must be left out of a circular body. Default: must be given for a planar body.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rows: Option<usize>,
    /// Diameter of a circular body. If given, `spacing` becomes `diameter / columns`; lengths of a unit, limits in mm and the
    /// design's learning rate scale in proportion, `stiffness.bend` with the square: the same sheet cut finer. Unit: mm.
    /// Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub diameter: Option<f64>,
    /// Width of a planar body along x, with the same effect as `diameter`. Unit: mm. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub width: Option<f64>,
    /// Distance between the centres of neighbouring cells. Unit: mm.
    pub spacing: f64,
    /// Length of a ligament at rest. Unit: mm.
    pub ligament_length: f64,
    /// Angle by which the squares of the initial design are rotated. Unit: degrees.
    #[serde(default = "initial_angle")]
    pub initial_angle: f64,
    /// The design to start from. Default: rotated squares.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub design: Option<Design>,
    /// Mass per area. Unit: Mg/mm². Default: must be given without `material`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub density: Option<f64>,
    /// Damping of each degree of freedom relative to its critical damping (ζ). Unit: 1.
    #[serde(default = "damping_ratio")]
    pub damping_ratio: f64,
    /// Stiffness of the ligaments. Default: must be given without `material`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stiffness: Option<Stiffness>,
    /// What the body is cast of and how thick: gives `density` and `stiffness` by the formulas of MODEL.md, in their place.
    /// Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub material: Option<Material>,
    /// Contact between the edges of neighbouring units. Default: no contact.
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
    /// Stretching of a ligament (k_l). Unit: N/mm.
    pub stretch: f64,
    /// Shearing of a ligament (k_s). Unit: N/mm.
    pub shear: f64,
    /// Bending of a ligament (k_θ). Unit: N·mm/rad.
    pub bend: f64,
}

/// A rubber that one can buy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Rubber {
    /// The paper's silicone: 100 % modulus 22 psi (0.152 MPa), specific gravity 1.07 (Smooth-On's technical bulletin of the Dragon
    /// Skin series).
    #[serde(rename = "Dragon Skin 10")]
    DragonSkin10,
}

impl Rubber {
    /// Nominal stress at 100 % strain (MPa) and density (Mg/mm³).
    #[must_use]
    pub fn figures(self) -> (f64, f64) {
        const PSI: f64 = 6.894_757e-3;
        match self {
            Self::DragonSkin10 => (22.0 * PSI, 1.07e-9),
        }
    }
}

/// What a body is cast of.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Material {
    /// A rubber that one can buy: its modulus and density, where these keys are left out. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rubber: Option<Rubber>,
    /// Young's modulus at small strain. Unit: MPa. Default: the rubber's (0.26 of Dragon Skin 10).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub modulus: Option<f64>,
    /// Mass per volume. Unit: Mg/mm³. Default: the rubber's (1.07e-9 of Dragon Skin 10).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub density: Option<f64>,
    /// Thickness of the sheet. Unit: mm.
    pub thickness: f64,
    /// Width of a ligament in the plane, across its length. Unit: mm.
    pub ligament_width: f64,
}

/// Contact between the edges that face each other across a ligament.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Contact {
    /// Contact stiffness (k_c). Unit: N·mm/rad².
    pub stiffness: f64,
    /// Angle between two edges at which the contact energy becomes infinite (ψ_min). Unit: degrees.
    pub min_angle: f64,
    /// Angle between two edges below which contact begins (ψ_c). Unit: degrees.
    pub cutoff_angle: f64,
}

impl Default for Contact {
    fn default() -> Self {
        Self { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 5.0 }
    }
}
