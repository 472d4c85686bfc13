//! The body: layout, sizes, material, the design to start from.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The layout of a body's units.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum LayoutKind {
    /// `rows` rows of `columns` units, or what `file` gives: the topmost units are struck downwards, the lowest held.
    Planar,
    /// The units of a lattice whose centres lie in a disc, `columns` spacings across: about a unit where that is odd, about a void where even.
    Circular,
}

/// How the units of a body repeat.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Lattice {
    /// Squares that turn against their neighbours, four ligaments each.
    #[default]
    Square,
    /// Triangles that turn against their neighbours, three ligaments each, around voids of six.
    Kagome,
    /// Hexagons that all turn alike, six ligaments each.
    Triangular,
    /// Squares that all turn alike, so that ligaments lead aslant: four each.
    Chiral,
}

impl Lattice {
    /// The one that is not written.
    #[must_use]
    pub fn is_square(&self) -> bool {
        *self == Self::Square
    }

    /// Whether the initial angle is one of the design, which turns units against their neighbours, and not of the lattice.
    #[must_use]
    pub fn turns(&self) -> bool {
        matches!(self, Self::Square | Self::Kagome)
    }
}

/// A body of any polygons.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Own {
    /// a file, relative to the spec: TOML of these keys, or NPZ of `block_centroids`, `centroid_node_vectors`, `bond_connectivity`.
    File(std::path::PathBuf),
    /// `{ units = [ … ], ligaments = [ … ] }`, the polygons themselves, which is how a trial stores a file's.
    Given(Polygons),
}

/// Polygons and what joins them.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Polygons {
    /// Of each unit its 3 to 12 nodes, of a rigid one any number from 3 on, counter-clockwise. Unit: mm.
    pub units: Vec<Vec<[f64; 2]>>,
    /// From a node to a node: unit, node, unit, node, counted from 0. Both shift together.
    pub ligaments: Vec<[usize; 4]>,
    /// Further nodes (unit, node) that shift together. Default: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub together: Vec<Vec<[usize; 2]>>,
    /// Units whose shape is given, as plates: nodes with ligaments follow the design, the others stay. No limit judges their shape, which may
    /// have reflex corners. Default: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rigid: Vec<usize>,
    /// Nodes of rigid units that follow two nodes with ligaments instead of staying: `[{ node = [20, 3], nodes = [2, 4], by = "x" }]`.
    /// Default: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub follow: Vec<Follow>,
    /// Units whose density is a multiple of the body's: `[{ units = [20, 21], factor = 2 }]`. Default: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub density: Vec<Denser>,
    /// Units that are held where `body.clamp` is left out; `[]`: none. Default: the lowest.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clamp: Option<Vec<usize>>,
    /// Where forces act, of K panels the first K, where `body.panels` and `body.panel_units` are left out. Default: the topmost units.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub panels: Vec<Struck>,
    /// Units that may carry sensors. Default: those of which every node holds a ligament.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensors: Option<Vec<usize>>,
}

/// Units of another density.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Denser {
    /// The units.
    pub units: Vec<usize>,
    /// Their density by that of the body. Unit: 1.
    pub factor: f64,
}

/// A node of a rigid unit that follows two others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Follow {
    /// The unit and the node, which no ligament holds.
    pub node: [usize; 2],
    /// Two nodes of the same unit that ligaments hold.
    pub nodes: [usize; 2],
    /// How the node follows them.
    pub by: FollowBy,
}

/// How a node follows two others of its unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum FollowBy {
    /// It shifts along x by the mean of their shifts.
    X,
    /// It moves with the segment between them, as if fixed to its middle.
    Segment,
    /// It turns about `[0, 0]` by the mean of the angles by which they turn about it.
    Angle,
}

/// Where a force acts, and how.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Struck {
    /// The unit. Default: must be given without `base`; with one, all that are held.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<usize>,
    /// Where its force points. Default: down, on a circular body inward.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub direction: Option<[f64; 2]>,
    /// The unit's node that the force acts on, wherever the design moves it. Default: the unit's centroid.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub node: Option<usize>,
    /// Where the force acts, from that point. Unit: mm. Default: `[0, 0]`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at: Option<[f64; 2]>,
    /// In place of one force two opposite ones, so far apart: they turn the unit, anticlockwise where this is above 0. Unit: mm.
    /// Default: no couple.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub couple: Option<f64>,
    /// In place of a force, an acceleration along the direction, the force over this mass: of what the held units are fixed to; or of the
    /// `unit` alone, which then moves so whatever the ligaments pull, and does not turn. Unit: Mg. Default: a force.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base: Option<f64>,
}

/// Which units are held.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Clamp {
    /// `"bottom"`, the lowest units, `"ends"`, these and the topmost, `"sides"`, the leftmost and rightmost ones (planar), `"hub"`,
    /// the innermost units (circular), or `"none"`, no unit.
    Rule(ClampRule),
    /// a list of units.
    Units(Vec<usize>),
}

/// A named set of clamped units.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ClampRule {
    /// The lowest units of a planar body.
    Bottom,
    /// The lowest and the topmost units of a planar body.
    Ends,
    /// The leftmost and the rightmost units of a planar body.
    Sides,
    /// The innermost unit of a circular body, or those around the void in its middle.
    Hub,
    /// No unit: the body moves as a whole.
    None,
}

/// Units that are held in part, as on a roller or in a slot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Guide {
    /// Which units: a list, or a rule of `body.clamp`.
    pub units: Clamp,
    /// What is held of each: its ways along x and y, and its turning.
    pub holds: Vec<Way>,
}

/// A way in which a unit can move.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Way {
    /// Along x.
    X,
    /// Along y.
    Y,
    /// About its centroid.
    Turn,
}

/// The design that a body starts from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged, deny_unknown_fields)]
pub enum Design {
    /// a file, relative to the spec: NPY of α in the order of MODEL.md, of shape (n) or (n/2, 2), or CSV of nodes (`unit,node,x,y`, mm).
    File(std::path::PathBuf),
    /// `{ random = SEED, spread = 0.25 }`, rotated squares with every node moved at random, by at most that part of the spacing,
    /// projected onto the nearest castable design.
    Random {
        /// The seed.
        random: u64,
        /// The most that a node is moved by along x and along y, as a part of the spacing.
        #[serde(default = "Design::spread", skip_serializing_if = "Design::is_usual")]
        spread: f64,
    },
    /// `{ shifts = [ … ] }`, α itself (mm), which is how a trial stores a file's design.
    Shifts {
        /// α, in the order of MODEL.md.
        shifts: Vec<f64>,
    },
}

impl Design {
    /// How far the nodes of a random body are moved where it does not say.
    pub const SPREAD: f64 = 0.25;

    fn spread() -> f64 {
        Self::SPREAD
    }

    fn is_usual(spread: &f64) -> bool {
        *spread == Self::SPREAD
    }
}

/// Sizes and material of a body.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Where the units are.
    #[serde(default = "planar")]
    pub layout: LayoutKind,
    /// How the units repeat. Default: `"square"`.
    #[serde(default, skip_serializing_if = "Lattice::is_square")]
    pub lattice: Lattice,
    /// A body of any polygons, in place of `columns`, `rows`, `spacing`, `ligament_length` and `initial_angle`. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<Own>,
    /// Units that are held. Default: `"bottom"` for a planar body, `"hub"` for a circular one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clamp: Option<Clamp>,
    /// Units that are held in part, as on a roller or in a slot: `[{ units = "sides", holds = ["x"] }]`. Default: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub guides: Vec<Guide>,
    /// By how much held units are brought together along x and y before a sample, as parts of the way between the outermost of them;
    /// below 0: drawn apart. The sample begins where the body then is at rest. Unit: 1. Default: `[0, 0]`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub compression: Option<[f64; 2]>,
    /// Whether ligaments have linear strain measures; displacements of nodes stay exact.
    #[serde(default)]
    pub linearised: bool,
    /// Units that are struck, on their centroids. Default: by the rule in MODEL.md.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub panel_units: Option<Vec<usize>>,
    /// Where and how forces act, of K panels the first K, in place of `panel_units`: `[{ unit = 34, node = 1 }, { unit = 34, couple = 5 }]`.
    /// Default: `panel_units`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub panels: Vec<Struck>,
    /// Angle by which the forces on all panels are turned, anticlockwise, from down on a planar body and from inward on a circular
    /// one. Unit: degrees. Default: 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub panel_angle: Option<f64>,
    /// Units in a row; of a circular body its diameter in spacings. Default: must be given without `file`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub columns: Option<usize>,
    /// Rows of units; must be left out of a circular body. Default: must be given for a planar body.
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
    /// Distance between the centres of joined units. Unit: mm. Default: must be given without `file`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spacing: Option<f64>,
    /// Length of a ligament at rest, of units that are not turned. Unit: mm. Default: must be given without `file`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ligament_length: Option<f64>,
    /// Angle by which the units of the initial design are rotated. Unit: degrees.
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
    /// Damping of every unit along x, along y and in turning, in place of `damping_ratio`. Unit: N·s/mm, N·s/mm, N·mm·s. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub damping: Option<[f64; 3]>,
    /// Whose masses and moments of inertia units have. Default: `"design"`.
    #[serde(default, skip_serializing_if = "Inertia::is_own")]
    pub inertia: Inertia,
    /// Stiffness of the ligaments. Default: must be given without `material`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stiffness: Option<Stiffness>,
    /// What the body is cast of and how thick: gives `density` and `stiffness` by the formulas of MODEL.md, in their place.
    /// Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub material: Option<Material>,
    /// Contact between the edges of neighbouring units; without it units may pass through each other under strong forces. Default: no
    /// contact.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub contact: Option<Contact>,
    /// Moment k_θ δ (1 + a δ + b δ²) of a ligament that bends by δ, in place of k_θ δ; two rests where a² > 4b. δ is above 0 where
    /// its units turn on as a positive `initial_angle` turns them; where it turns none against another, or `file` gives the body, where the
    /// unit at the ligament's second end turns anticlockwise. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hinge: Option<Hinge>,
}

/// Whose masses and moments of inertia the units of a design have.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Inertia {
    /// Their own.
    #[default]
    Design,
    /// Those of the body without `design`, whatever shape training gives the units.
    Initial,
}

impl Inertia {
    /// The one that is not written.
    #[must_use]
    pub fn is_own(&self) -> bool {
        *self == Self::Design
    }
}

fn planar() -> LayoutKind {
    LayoutKind::Planar
}
fn initial_angle() -> f64 {
    25.0
}
fn damping_ratio() -> f64 {
    Body::DAMPING_RATIO
}

impl Body {
    /// `damping_ratio` where it is not given.
    pub const DAMPING_RATIO: f64 = 0.02;

    /// `columns`, 0 where a file gives the units.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.columns.unwrap_or(0)
    }

    /// `rows`, or as many as columns.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows.unwrap_or(self.columns())
    }

    /// The polygons that it is made of, where these and no lattice are given.
    #[must_use]
    pub fn polygons(&self) -> Option<&Polygons> {
        match &self.file {
            Some(Own::Given(given)) => Some(given),
            _ => None,
        }
    }

    /// `spacing` and `ligament_length`; a plan fills them in from a file.
    #[must_use]
    pub fn lengths(&self) -> [f64; 2] {
        [self.spacing, self.ligament_length].map(|length| length.unwrap_or(f64::NAN))
    }
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

/// The law by which ligaments bend: k_θ δ (1 + a δ + b δ²).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Hinge {
    /// a. The second rest is the root of 1 + a δ + b δ² that is farther from 0, δ > 0 where a < 0. Unit: 1/rad.
    #[serde(default)]
    pub quadratic: f64,
    /// b, above 0. Unit: 1/rad².
    pub cubic: f64,
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
