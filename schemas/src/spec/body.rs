//! Keys of `[body]`: layout, sizes, material, initial design.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;

use super::external::{BodyKind, Description};
use super::is_default;

/// The layout of a body's units.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum LayoutKind {
    /// `rows` rows of `columns` units, or the body of `file`. Forces act downwards on the topmost units; the lowest units are
    /// held.
    #[default]
    Planar,
    /// The units whose centres lie in a disc of `columns` spacings in diameter. The centre is a unit for odd `columns` and a void
    /// for even `columns`.
    Circular,
}

/// Lattice of a body's units.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Lattice {
    /// Counter-rotating squares with four ligaments each.
    #[default]
    Square,
    /// Counter-rotating triangles with three ligaments each, around voids of six units.
    Kagome,
    /// Hexagons with six ligaments each, all rotated in the same direction.
    Triangular,
    /// Squares with four oblique ligaments each, all rotated in the same direction.
    Chiral,
}

impl Lattice {
    /// Whether the initial angle belongs to the design (units counter-rotate) and not to the lattice.
    pub fn turns(&self) -> bool {
        matches!(self, Self::Square | Self::Kagome)
    }
}

/// A body of arbitrary polygons.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Own {
    /// a file, relative to the spec: TOML of these keys, or NPZ of `block_centroids`, `centroid_node_vectors`, `bond_connectivity`.
    File(std::path::PathBuf),
    /// `{ units = [ … ], ligaments = [ … ] }`, the polygons themselves, as a trial stores the contents of a file.
    Given(Polygons),
}

/// Polygons and ligaments of a body.
#[skip_serializing_none]
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Polygons {
    /// Nodes of each unit, counter-clockwise: 3 to 12, at least 3 in a rigid unit. Unit: mm.
    pub units: Vec<Vec<[f64; 2]>>,
    /// Ligaments as unit, node, unit, node, counted from 0. Both nodes shift together.
    pub ligaments: Vec<[usize; 4]>,
    /// Further nodes (unit, node) that shift together. Default: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub together: Vec<Vec<[usize; 2]>>,
    /// Rigid units (plates): nodes with ligaments follow the design, the others stay. Their shape has no limits and may have
    /// reflex corners. Default: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rigid: Vec<usize>,
    /// Nodes of rigid units that follow two nodes with ligaments instead of staying: `[{ node = [20, 3], nodes = [2, 4], by = "x" }]`.
    /// Default: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub follow: Vec<Follow>,
    /// Units whose density is a multiple of the body's: `[{ units = [20, 21], factor = 2 }]`. Default: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub density: Vec<Denser>,
    /// Units that are held if `body.clamp` is omitted; `[]`: none. Default: the lowest.
    pub clamp: Option<Vec<usize>>,
    /// Where forces act, if `body.panels` and `body.panel_units` are omitted; trials with K panels use the first K. Default: the
    /// topmost units.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub panels: Vec<Struck>,
    /// Units that may carry sensors. Default: those whose nodes all have ligaments.
    pub sensors: Option<Vec<usize>>,
}

/// Units with another density.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Denser {
    /// The units.
    pub units: Vec<usize>,
    /// Density of these units relative to that of the body. Unit: 1.
    pub factor: f64,
}

/// A node of a rigid unit that follows two others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Follow {
    /// Unit and node; the node has no ligament.
    pub node: [usize; 2],
    /// Two nodes of the same unit that have ligaments.
    pub nodes: [usize; 2],
    /// How the node follows them.
    pub by: FollowBy,
}

/// How a node follows two others of its unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum FollowBy {
    /// Shifts along x by the mean of their shifts.
    X,
    /// Moves with the segment between them, as if fixed to its middle.
    Segment,
    /// Rotates about `[0, 0]` by the mean of their angles of rotation.
    Angle,
}

/// Where a force acts, and how.
#[skip_serializing_none]
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Struck {
    /// The unit. Default: with `base`, all held units; otherwise it must be given.
    pub unit: Option<usize>,
    /// Direction of the force. Default: down, on a circular body inward.
    pub direction: Option<[f64; 2]>,
    /// Node of the unit on which the force acts; it follows the design. Default: the unit's centroid.
    pub node: Option<usize>,
    /// Offset of the point of action from the node or centroid. Unit: mm. Default: `[0, 0]`.
    pub at: Option<[f64; 2]>,
    /// A couple instead of a force: the distance of two opposite forces. Positive values rotate the unit anticlockwise. Unit: mm.
    /// Default: no couple.
    pub couple: Option<f64>,
    /// A prescribed acceleration instead of a force: force divided by this mass, along the direction. It accelerates the base of
    /// the held units or, with `unit`, that unit alone, without rotation and regardless of its ligaments. Unit: Mg. Default: a
    /// force.
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
    /// Held coordinates of each unit: displacement along x and y, and rotation.
    pub holds: Vec<Way>,
}

/// A coordinate of a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Way {
    /// Along x.
    X,
    /// Along y.
    Y,
    /// Rotation about its centroid.
    Turn,
}

/// The design that a body starts from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged, deny_unknown_fields)]
pub enum Design {
    /// a file, relative to the spec: NPY of α in the order of MODEL.md, of shape (n) or (n/2, 2), or CSV of nodes (`unit,node,x,y`, mm).
    File(std::path::PathBuf),
    /// `{ random = SEED, spread = 0.25 }`, rotated squares with every node moved at random by at most this fraction of the
    /// spacing, projected onto the nearest feasible design.
    Random {
        /// The seed.
        random: u64,
        /// Largest displacement of a node along x and along y, as a fraction of the spacing.
        #[serde(default = "Design::spread", skip_serializing_if = "Design::is_usual")]
        spread: f64,
    },
    /// `{ shifts = [ … ] }`, α itself (mm), as a trial stores the design of a file.
    Shifts {
        /// α, in the order of MODEL.md.
        shifts: Vec<f64>,
    },
}

impl Design {
    /// Default of `spread`.
    pub const SPREAD: f64 = 0.25;

    fn spread() -> f64 {
        Self::SPREAD
    }

    fn is_usual(spread: &f64) -> bool {
        *spread == Self::SPREAD
    }
}

/// Sizes and material of a body.
#[skip_serializing_none]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// What simulates the body. Default: `"polygons"`.
    #[serde(default, skip_serializing_if = "is_default")]
    pub kind: BodyKind,
    /// Program and arguments of an external body. Files are relative to the spec. Default: must be given with `kind = "external"`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub command: Vec<String>,
    /// Longest time of one call of an external body. Unit: s. Default: 600.
    pub time_limit: Option<f64>,
    /// What the program of an external body answers, as a trial stores it.
    #[schemars(skip)]
    pub description: Option<Description>,
    /// Arrangement of the units.
    #[serde(default)]
    pub layout: LayoutKind,
    /// Lattice of the units. Default: `"square"`.
    #[serde(default, skip_serializing_if = "is_default")]
    pub lattice: Lattice,
    /// A body of arbitrary polygons, in place of `columns`, `rows`, `spacing`, `ligament_length` and `initial_angle`. Default: none.
    pub file: Option<Own>,
    /// Units that are held. Default: `"bottom"` for a planar body, `"hub"` for a circular one.
    pub clamp: Option<Clamp>,
    /// Units with some coordinates held, as on a roller or in a slot: `[{ units = "sides", holds = ["x"] }]`. Default: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub guides: Vec<Guide>,
    /// Compression along x and y before a sample, as a fraction of the distance between the outermost held units; negative:
    /// extension. The sample begins at rest in the compressed body. Unit: 1. Default: `[0, 0]`.
    pub compression: Option<[f64; 2]>,
    /// Whether ligaments use linearised strains. Displacements of nodes stay exact.
    #[serde(default)]
    pub linearised: bool,
    /// Units on whose centroids forces act. Default: by the rule in MODEL.md.
    pub panel_units: Option<Vec<usize>>,
    /// Where and how forces act, instead of `panel_units`; trials with K panels use the first K: `[{ unit = 34, node = 1 }, {
    /// unit = 34, couple = 5 }]`. Default: `panel_units`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub panels: Vec<Struck>,
    /// Units per row; diameter in spacings of a circular body. Default: must be given without `file`.
    pub columns: Option<usize>,
    /// Rows of units; not for circular bodies. Default: must be given for a planar body.
    pub rows: Option<usize>,
    /// Diameter of a circular body. If given, `spacing` becomes `diameter / columns`. Lengths of units, limits in mm and the
    /// design's learning rate scale in proportion, `stiffness.bend` with the square, as if the same sheet were divided more finely. Unit:
    /// mm. Default: none.
    pub diameter: Option<f64>,
    /// Width of a planar body along x, with the same effect as `diameter`. Unit: mm. Default: none.
    pub width: Option<f64>,
    /// Distance between the centres of joined units. Unit: mm. Default: must be given without `file`.
    pub spacing: Option<f64>,
    /// Length of a ligament at rest, for units that are not rotated. Unit: mm. Default: must be given without `file`.
    pub ligament_length: Option<f64>,
    /// Angle by which the units of the initial design are rotated. Unit: degrees.
    #[serde(default = "initial_angle")]
    pub initial_angle: f64,
    /// The design to start from. Default: rotated squares.
    pub design: Option<Design>,
    /// Mass per area. Unit: Mg/mm². Default: must be given without `material`.
    pub density: Option<f64>,
    /// Factor ζ of the dampers of each unit (formula in MODEL.md). It is not the modal damping ratio, which `metasense body modes`
    /// prints: slow modes have more damping. Unit: 1.
    #[serde(default = "damping_ratio")]
    pub damping_ratio: f64,
    /// Damping coefficients of every unit along x, along y and in rotation, instead of `damping_ratio`. Unit: N·s/mm, N·s/mm,
    /// N·mm·s. Default: none.
    pub damping: Option<[f64; 3]>,
    /// Design that sets the masses and moments of inertia of the units. Default: `"design"`.
    #[serde(default, skip_serializing_if = "is_default")]
    pub inertia: Inertia,
    /// Stiffness of the ligaments. Default: must be given without `material`.
    pub stiffness: Option<Stiffness>,
    /// Material and thickness; determine `density` and `stiffness` (formulas in MODEL.md). Default: none.
    pub material: Option<Material>,
    /// Contact between the edges of neighbouring units; without it units may pass through each other under strong forces. Default: no
    /// contact.
    pub contact: Option<Contact>,
}

/// Design that sets the masses and moments of inertia of the units.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Inertia {
    /// The current design.
    #[default]
    Design,
    /// The body without `design`; training does not change them.
    Initial,
}

fn initial_angle() -> f64 {
    25.0
}
fn damping_ratio() -> f64 {
    Body::DAMPING_RATIO
}

impl Body {
    /// Default of `damping_ratio`.
    pub const DAMPING_RATIO: f64 = 0.02;

    /// `columns`, or 0 if a file gives the units.
    pub fn columns(&self) -> usize {
        self.columns.unwrap_or(0)
    }

    /// `rows`; default `columns`.
    pub fn rows(&self) -> usize {
        self.rows.unwrap_or(self.columns())
    }

    /// The polygons of the body, if it is not a lattice.
    pub fn polygons(&self) -> Option<&Polygons> {
        match &self.file {
            Some(Own::Given(given)) => Some(given),
            _ => None,
        }
    }

    /// `spacing` and `ligament_length` (mm); the plan sets them for a file.
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

/// A commercial rubber.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Rubber {
    /// The paper's silicone: 100 % modulus 22 psi (0.152 MPa), specific gravity 1.07 (Smooth-On's technical bulletin of the Dragon
    /// Skin series).
    #[serde(rename = "Dragon Skin 10")]
    DragonSkin10,
}

/// Material of the sheet.
#[skip_serializing_none]
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Material {
    /// A commercial rubber: sets modulus and density if these keys are omitted. Default: none.
    pub rubber: Option<Rubber>,
    /// Young's modulus at small strain. Unit: MPa. Default: the rubber's (0.26 for Dragon Skin 10).
    pub modulus: Option<f64>,
    /// Mass per volume. Unit: Mg/mm³. Default: the rubber's (1.07e-9 for Dragon Skin 10).
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
