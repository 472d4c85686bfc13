//! Feasible designs: the limits of what can be cast, the test of them, and the projection onto them.
//!
//! `violations` judges by plain polygon tests (`exact.rs`). `project` goes to the nearest feasible design by a short
//! sequence of convex programs in Clarabel, linearised (`rows.rs`, `program.rs`), and lets the judge have the last word.
//!
//! ```text
//! minimise Σ w (α − target)²   subject to c(α) ≥ 0: angles, edges, distances
//! ```
//! No limit judges the shape of a rigid unit; what is beside it keeps its distance from each of its edges.

mod exact;
mod linear;
mod overlap;
mod program;
mod project;
mod random;
mod rows;
#[cfg(test)]
mod tests;

pub use exact::{Kind, Violation};
pub use linear::{LinearLimits, LinearRow};
pub use overlap::{Overlaps, overlaps};
pub use project::{Active, Projection, Stage, Status};

use crate::body::{Freedom, Layout};

/// The limits of a castable design (rad, mm).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Whether there are any; without, all finite designs pass.
    pub enforced: bool,
    /// Least interior angle of a unit.
    pub min_block_angle: f64,
    /// Greatest interior angle of a unit.
    pub max_block_angle: f64,
    /// Least void angle at a ligament.
    pub min_void_angle: f64,
    /// Least angle between a ligament and an edge of its unit.
    pub min_ligament_angle: f64,
    /// Least edge of a unit.
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
    /// The feasible design nearest to `target` in the metric `weights` (per coordinate; none: Euclidean), or `previous`; the status
    /// says which.
    fn project(&mut self, previous: &[f64], target: &[f64], weights: Option<&[f64]>) -> Projection;
}

impl Castable for Feasible {
    fn project(&mut self, previous: &[f64], target: &[f64], weights: Option<&[f64]>) -> Projection {
        Feasible::project(self, previous, target, weights)
    }
}

/// The feasible designs of one layout.
pub struct Feasible {
    layout: Layout,
    limits: Limits,
    rows: rows::Rows,
    program: program::Program,
    /// Per group: held at its previous shift.
    fixed: Vec<bool>,
    /// Per group the first of those that move with it, where some do.
    leader: Option<Vec<usize>>,
}

impl Feasible {
    /// The designs of `layout` within `limits`; the nodes of `fixed_units` stay where the previous design has them.
    pub fn new(layout: &Layout, limits: Limits, fixed_units: &[usize]) -> Self {
        let mut fixed = vec![false; layout.group_count];
        for &unit in fixed_units {
            for &group in layout.groups[unit].iter().flatten() {
                fixed[group] = true;
            }
        }
        let rows = rows::Rows::new(layout, limits);
        Self {
            layout: layout.clone(),
            limits,
            rows,
            program: program::Program::default(),
            fixed,
            leader: None,
        }
    }

    /// The designs that can be cast and had: where shifts are tied by blocks of `tie` cells, units `frozen`, or `kept`. Targets and
    /// previous designs are to be of one and the same initial design and [`Freedom`], so are the answers, but for rounding.
    pub fn moving(
        layout: &Layout,
        limits: Limits,
        tie: [usize; 2],
        frozen: &[usize],
        kept: &[usize],
    ) -> Self {
        let freedom = Freedom::of(layout, tie, frozen, kept);
        let leader = freedom.is_tied().then(|| freedom.leaders().to_vec());
        Self { leader, ..Self::new(layout, limits, &[frozen, kept].concat()) }
    }

    /// Every constraint that `design` breaks, unit by unit; empty: it can be cast. Independent of the projection.
    pub fn violations(&self, design: &[f64]) -> Vec<Violation> {
        exact::violations(&self.layout, &self.limits, design)
    }
}
