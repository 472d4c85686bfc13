//! Constraints on a design: which shifts are frozen, and which are tied.
//!
//! ```text
//! α = α₀ + P z      dL/dz = Pᵀ dL/dα      P: one column per block and axis, entries 0 and 1
//! ```
//! A block consists of the groups of p × q cells with the same kind of ligament; frozen groups have rows of zeros. Vectors in z keep the
//! length of α: the value of a block is stored at its first group, the leader.

use super::{GroupCell, Layout};
use std::collections::BTreeMap;

/// The matrix P.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Freedom {
    /// First group of each group's block; a free group is its own leader.
    leader: Vec<usize>,
    frozen: Vec<bool>,
    /// Of α.
    length: usize,
}

impl Freedom {
    /// Ties the groups in blocks of p × q cells and freezes all groups of `frozen_units`.
    ///
    /// # Panics
    /// If p or q is 0.
    pub fn new(layout: &Layout, [p, q]: [usize; 2], frozen_units: &[usize]) -> Self {
        let mut frozen = vec![false; layout.groups.count()];
        let groups_of_unit = |unit: &usize| layout.groups.of_nodes[*unit].iter().flatten();
        frozen_units.iter().flat_map(groups_of_unit).for_each(|&group| frozen[group] = true);
        let mut first: BTreeMap<GroupCell, usize> = BTreeMap::new();
        // blocks start at the body's lower left corner; with oblique rows it lies left of cell 0
        let least = |d: usize| layout.groups.cells.iter().map(|(_, cell)| cell[d]).min().unwrap_or(0);
        let [left, low] = [least(0), least(1)];
        let leader = layout.groups.cells.iter().enumerate().map(|(group, &(kind, [i, j]))| {
            let block = (kind, [(i - left) / p as i32, (j - low) / q as i32]);
            if frozen[group] { group } else { *first.entry(block).or_insert(group) }
        });
        Self { leader: leader.collect(), frozen, length: 2 * layout.groups.count() }
    }

    /// All of `length` numbers move, each alone.
    pub fn unconstrained(length: usize) -> Self {
        let pairs = length.div_ceil(2);
        Self { leader: (0..pairs).collect(), frozen: vec![false; pairs], length }
    }

    /// Whether all shifts are independent.
    pub fn is_whole(&self) -> bool {
        !self.is_tied() && !self.frozen.contains(&true)
    }

    /// Whether any shifts are tied.
    pub fn is_tied(&self) -> bool {
        self.leader.iter().enumerate().any(|(group, &leader)| leader != group)
    }

    /// First group of each group's block.
    pub fn leaders(&self) -> &[usize] {
        &self.leader
    }

    /// Length of z.
    pub fn parameters(&self) -> usize {
        self.coordinates().len()
    }

    fn leads(&self, group: usize) -> bool {
        self.leader[group] == group && !self.frozen[group]
    }

    /// Indices in α at which z is stored.
    pub fn coordinates(&self) -> Vec<usize> {
        (0..self.length).filter(|i| self.leads(i / 2)).collect()
    }

    /// Pᵀ applied to a gradient in α. The result is stored at the leaders and is zero elsewhere.
    pub fn vjp(&self, gradient: &[f64]) -> Vec<f64> {
        let mut reduced = vec![0.0; gradient.len()];
        for (i, g) in gradient.iter().enumerate().filter(|(i, _)| !self.frozen[i / 2]) {
            reduced[2 * self.leader[i / 2] + i % 2] += g;
        }
        reduced
    }

    /// P applied to the z stored at the leaders.
    pub fn spread(&self, z: &[f64]) -> Vec<f64> {
        let at = |i: usize| if self.frozen[i / 2] { 0.0 } else { z[2 * self.leader[i / 2] + i % 2] };
        (0..z.len()).map(at).collect()
    }

    /// The design α₀ + P z whose leaders have the shifts of `design`.
    pub fn snap(&self, initial: &[f64], design: Vec<f64>) -> Vec<f64> {
        if self.is_whole() {
            return design;
        }
        let at = |i: usize| match (self.frozen[i / 2], 2 * self.leader[i / 2] + i % 2) {
            (true, _) => initial[i],
            (false, leader) if leader == i => design[i],
            (false, leader) => initial[i] + (design[leader] - initial[leader]),
        };
        (0..design.len()).map(at).collect()
    }
}
