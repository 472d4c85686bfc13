//! Feasible designs: limits, exact check, and projection.
//!
//! `violations` checks a design with simple polygon tests (`exact.rs`). `project` finds the nearest feasible design by a short
//! sequence of linearised convex programs in Clarabel (`rows.rs`, `program.rs`) and verifies it with the exact check.
//!
//! ```text
//! minimise Σ w (α − target)²   subject to c(α) ≥ 0: angles, edges, distances
//! ```
//! The shape of a rigid unit has no limits; other parts keep their distance from each of its edges.

mod exact;
mod linear;
mod overlap;
mod program;
mod project;
mod random;
mod rows;
#[cfg(test)]
mod tests;

pub use exact::{Violation, ViolationKind};
pub use linear::{LinearLimits, LinearRow};
pub use overlap::{Overlaps, overlaps};
pub use project::{Active, Projection, Stage, Status, distance};

use crate::body::{Freedom, Layout};

/// Limits of feasible designs (rad, mm).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Whether limits apply; if not, every finite design is feasible.
    pub enforced: bool,
    /// Least interior angle of a unit.
    pub min_block_angle: f64,
    /// Greatest interior angle of a unit.
    pub max_block_angle: f64,
    /// Least void angle at a ligament.
    pub min_void_angle: f64,
    /// Least angle between a ligament and an edge of its unit.
    pub min_ligament_angle: f64,
    /// Least length of a unit's edge.
    pub min_edge: f64,
    /// Least distance between units.
    pub clearance: f64,
    /// Least distance between a ligament and a unit that it does not join, or another ligament.
    pub ligament_clearance: f64,
}

/// The defaults of a spec.
impl Default for Limits {
    fn default() -> Self {
        Self {
            enforced: true,
            min_block_angle: 25_f64.to_radians(),
            max_block_angle: 170_f64.to_radians(),
            min_void_angle: 5_f64.to_radians(),
            min_ligament_angle: 10_f64.to_radians(),
            min_edge: 3.0,
            clearance: 1.0,
            ligament_clearance: 0.5,
        }
    }
}

/// The designs that a body can have.
pub trait Castable {
    /// The feasible design nearest to `target` in the metric `weights` (per coordinate; `None`: Euclidean), or `previous`; the status
    /// says which.
    fn project(&mut self, previous: &[f64], target: &[f64], weights: Option<&[f64]>) -> Projection;
}

impl Castable for FeasibleSet {
    fn project(&mut self, previous: &[f64], target: &[f64], weights: Option<&[f64]>) -> Projection {
        FeasibleSet::project(self, previous, target, weights)
    }
}

/// The set of feasible designs of a layout.
pub struct FeasibleSet {
    layout: Layout,
    limits: Limits,
    rows: rows::Rows,
    program: program::Program,
}

impl FeasibleSet {
    /// Feasible designs of `layout` within `limits`; nodes of `fixed_units` stay where the previous design has them.
    pub fn new(layout: &Layout, limits: Limits, fixed_units: &[usize]) -> Self {
        let mut fixed = vec![false; layout.groups.count()];
        for &unit in fixed_units {
            for &group in layout.groups.of_nodes[unit].iter().flatten() {
                fixed[group] = true;
            }
        }
        let (rows, program) = (rows::Rows::new(layout, limits), program::Program::new(fixed));
        Self { layout: layout.clone(), limits, rows, program }
    }

    /// As [`FeasibleSet::new`], with shifts tied in blocks of `tie` cells. Targets and previous designs must have the same initial
    /// design and [`Freedom`]; results then have it too, up to rounding.
    pub fn moving(layout: &Layout, limits: Limits, tie: [usize; 2], frozen: &[usize]) -> Self {
        let freedom = Freedom::new(layout, tie, frozen);
        let mut set = Self::new(layout, limits, frozen);
        set.program.leader = freedom.is_tied().then(|| freedom.leaders().to_vec());
        set
    }

    /// Every constraint that `design` violates, sorted by unit; empty if feasible. Independent of the projection.
    pub fn violations(&self, design: &[f64]) -> Vec<Violation> {
        exact::violations(&self.layout, &self.limits, design)
    }
}
