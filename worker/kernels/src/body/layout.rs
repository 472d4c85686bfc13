//! Layouts: which units there are, which nodes the ligaments join, and which nodes move together.
//!
//! One general form for planar lattices and circular bodies: a set of cells of a square grid. Node p of a unit is
//! numbered counter-clockwise from the right and, undisplaced, lies at h·(cos pπ/2, sin pπ/2) from the unit's
//! reference point, h = (spacing − ligament length)/2. Each node group has a 2-vector of the design α.

use crate::random::{Purpose, Stream};
use std::collections::BTreeMap;

/// A node of a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct End {
    /// Unit index.
    pub unit: usize,
    /// 0 right, 1 top, 2 left, 3 bottom.
    pub node: usize,
}

/// An elastic ligament between two nodes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ligament {
    /// Right or top node of the left or lower unit.
    pub a: End,
    /// Left or bottom node of the right or upper unit.
    pub b: End,
    /// d₀ (mm), from a to b.
    pub reference: [f64; 2],
}

/// A body without its design.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    /// Reference points of the units (mm).
    pub centres: Vec<[f64; 2]>,
    /// Grid cells (i, j) of the units, i to the right, j upward.
    pub grid: Vec<[i32; 2]>,
    /// h (mm).
    pub half: f64,
    /// l₀ (mm).
    pub ligament_length: f64,
    /// Pitch of the grid (mm).
    pub spacing: f64,
    /// Horizontal ones (j outer, i inner), then vertical ones.
    pub ligaments: Vec<Ligament>,
    /// Node group of each node of each unit.
    pub groups: Vec<[usize; 4]>,
    /// (vertical?, i, j) of each node group: node 2 (or 3) of unit (i, j) and node 0 (or 1) of its left (lower) neighbour.
    pub group_cells: Vec<(bool, [i32; 2])>,
    /// Number of node groups.
    pub group_count: usize,
    /// Whether a unit has fewer than four neighbours.
    pub boundary: Vec<bool>,
}

impl Layout {
    /// `columns` × `rows` units; unit (i, j) has index j·columns + i and reference point (i, j)·spacing.
    pub fn planar(columns: usize, rows: usize, spacing: f64, ligament_length: f64) -> Self {
        let cells = (0..rows as i32).flat_map(|j| (0..columns as i32).map(move |i| [i, j])).collect();
        Self::from_cells(cells, [0.0, 0.0], spacing, ligament_length)
    }

    /// The cells of an `across` × `across` grid whose centres lie in the disc of diameter `across`·spacing, centred on 0.
    pub fn circular(across: usize, spacing: f64, ligament_length: f64) -> Self {
        let n = across as i32;
        // In half pitches from the disc's centre; no centre lies on the rim, as odd and even squares differ mod 8.
        let inside = |&[i, j]: &[i32; 2]| (2 * i - n + 1).pow(2) + (2 * j - n + 1).pow(2) <= n * n;
        let cells = (0..n).flat_map(|j| (0..n).map(move |i| [i, j])).filter(inside).collect();
        let origin = -0.5 * (n - 1) as f64 * spacing;
        Self::from_cells(cells, [origin, origin], spacing, ligament_length)
    }

    /// A body of any cells of the grid, in the order given.
    pub fn from_cells(cells: Vec<[i32; 2]>, origin: [f64; 2], spacing: f64, ligament_length: f64) -> Self {
        let index: BTreeMap<[i32; 2], usize> = cells.iter().enumerate().map(|(u, &cell)| (cell, u)).collect();
        assert_eq!(index.len(), cells.len(), "cells repeat");
        let at = |i: i32, j: i32| index.get(&[i, j]).copied();
        let mut scan = cells.clone();
        scan.sort_by_key(|&[i, j]| (j, i));

        let mut ligaments = Vec::new();
        for vertical in [false, true] {
            let reference = if vertical { [0.0, ligament_length] } else { [ligament_length, 0.0] };
            let (di, dj) = if vertical { (0, 1) } else { (1, 0) };
            for &[i, j] in &scan {
                if let (Some(a), Some(b)) = (at(i, j), at(i + di, j + dj)) {
                    let node = usize::from(vertical);
                    ligaments.push(Ligament {
                        a: End { unit: a, node },
                        b: End { unit: b, node: node + 2 },
                        reference,
                    });
                }
            }
        }

        let mut groups = vec![[usize::MAX; 4]; cells.len()];
        let mut group_cells = Vec::new();
        for vertical in [false, true] {
            let (di, dj) = if vertical { (0, 1) } else { (1, 0) };
            let mut places: Vec<[i32; 2]> =
                cells.iter().flat_map(|&[i, j]| [[i, j], [i + di, j + dj]]).collect();
            places.sort_unstable();
            places.dedup();
            for [i, j] in places {
                let node = usize::from(vertical);
                for (unit, node) in [(at(i - di, j - dj), node), (at(i, j), node + 2)] {
                    if let Some(unit) = unit {
                        groups[unit][node] = group_cells.len();
                    }
                }
                group_cells.push((vertical, [i, j]));
            }
        }

        let boundary = cells.iter().map(|&[i, j]| {
            [(1, 0), (0, 1), (-1, 0), (0, -1)].iter().any(|&(a, b)| at(i + a, j + b).is_none())
        });
        Self {
            centres: cells
                .iter()
                .map(|&[i, j]| [origin[0] + f64::from(i) * spacing, origin[1] + f64::from(j) * spacing])
                .collect(),
            half: 0.5 * (spacing - ligament_length),
            ligament_length,
            spacing,
            ligaments,
            groups,
            group_count: group_cells.len(),
            group_cells,
            boundary: boundary.collect(),
            grid: cells,
        }
    }

    /// The same grid with ligaments of another length: its units are smaller by what they are longer.
    #[must_use]
    pub fn with_ligament_length(&self, ligament_length: f64) -> Self {
        let mut own = Self { half: 0.5 * (self.spacing - ligament_length), ligament_length, ..self.clone() };
        let lengthened = |d: f64| if d == 0.0 { 0.0 } else { ligament_length };
        own.ligaments.iter_mut().for_each(|ligament| ligament.reference = ligament.reference.map(lengthened));
        own
    }

    /// Number of units.
    pub fn units(&self) -> usize {
        self.centres.len()
    }

    /// Length of α: one 2-vector a node group.
    pub fn design_len(&self) -> usize {
        2 * self.group_count
    }

    /// Rotated squares of ±`angle` (rad), alternating as on a chessboard.
    pub fn initial_design(&self, angle: f64) -> Vec<f64> {
        let shift = |&(vertical, [i, j]): &(bool, [i32; 2])| {
            let tangent = if (i + j).rem_euclid(2) == 0 { angle.tan() } else { -angle.tan() };
            if vertical { [self.half * tangent, 0.0] } else { [0.0, -self.half * tangent] }
        };
        self.group_cells.iter().flat_map(shift).collect()
    }

    /// Position of a node relative to its unit's reference point (mm).
    pub fn node(&self, design: &[f64], unit: usize, node: usize) -> [f64; 2] {
        let base = [[self.half, 0.0], [0.0, self.half], [-self.half, 0.0], [0.0, -self.half]][node];
        let group = self.groups[unit][node];
        [base[0] + design[2 * group], base[1] + design[2 * group + 1]]
    }

    /// Absolute node positions (mm).
    pub fn vertices(&self, design: &[f64]) -> Vec<[[f64; 2]; 4]> {
        assert_eq!(design.len(), self.design_len(), "length of the design");
        let place = |u: usize| {
            std::array::from_fn(|p| {
                let q = self.node(design, u, p);
                [self.centres[u][0] + q[0], self.centres[u][1] + q[1]]
            })
        };
        (0..self.units()).map(place).collect()
    }

    /// The k input panels of a planar body, from left to right: units of the top row, symmetric about its middle.
    /// None where they would not be k different units.
    pub fn planar_panels(columns: usize, rows: usize, k: usize) -> Option<Vec<usize>> {
        if k == 0 || rows == 0 {
            return None;
        }
        let column = |q: usize| if 2 * q < k { (2 * q + 1) * columns / (2 * k) } else { usize::MAX };
        let panel = |q: usize| if 2 * q < k { column(q) } else { columns - 1 - column(k - 1 - q) };
        let panels: Vec<usize> = (0..k).map(panel).collect();
        let distinct = panels.windows(2).all(|w| w[0] < w[1]) && panels[k - 1] < columns;
        distinct.then(|| panels.iter().map(|c| (rows - 1) * columns + c).collect())
    }

    /// k of the eight input panels of a circular body, evenly spaced from direction 0 on, with their inward directions.
    /// None unless k divides eight and the units differ.
    pub fn circular_panels(&self, k: usize) -> Option<Vec<(usize, [f64; 2])>> {
        if k == 0 || 8 % k != 0 {
            return None;
        }
        let panel = |q: usize| {
            let angle = (q * 8 / k) as f64 * std::f64::consts::FRAC_PI_4;
            let (s, c) = angle.sin_cos();
            // Nearest in angle; of two as near the one further anticlockwise, then the outer one.
            let key = |u: usize| {
                let [x, y] = self.centres[u];
                let off = (c * y - s * x).atan2(c * x + s * y);
                ((off.abs() * 1e9).round() as i64, off < 0.0, (-1e6 * x.hypot(y)) as i64)
            };
            let unit = (0..self.units()).filter(|&u| self.boundary[u]).min_by_key(|&u| key(u))?;
            Some((unit, [-c, -s]))
        };
        let panels: Vec<_> = (0..k).map(panel).collect::<Option<_>>()?;
        let mut units: Vec<usize> = panels.iter().map(|p| p.0).collect();
        units.sort_unstable();
        units.dedup();
        (units.len() == k).then_some(panels)
    }

    /// The units of the bottom row (the least j).
    pub fn bottom(&self) -> Vec<usize> {
        let least = self.grid.iter().map(|c| c[1]).min();
        (0..self.units()).filter(|&u| Some(self.grid[u][1]) == least).collect()
    }

    /// The innermost unit of a circular body, or the innermost four.
    pub fn hub(&self) -> Vec<usize> {
        let radius = |u: usize| self.centres[u][0].hypot(self.centres[u][1]);
        let least = (0..self.units()).map(radius).fold(f64::INFINITY, f64::min);
        (0..self.units()).filter(|&u| radius(u) < least + 0.1 * self.spacing).collect()
    }

    /// Whether the cells of two units are at least so far apart (mm).
    pub fn apart(&self, a: usize, b: usize, distance: f64) -> bool {
        let [p, q] = [a, b].map(|unit| self.centres[unit]);
        (p[0] - q[0]).hypot(p[1] - q[1]) >= distance * (1.0 - 1e-9)
    }

    /// Placement `p`: an order of the interior free units, of which a body with M sensors takes the first M.
    pub fn placement(&self, p: u64, clamped: &[usize]) -> Vec<usize> {
        let interior: Vec<usize> =
            (0..self.units()).filter(|u| !self.boundary[*u] && !clamped.contains(u)).collect();
        let mut stream = Stream::new(Purpose::Placement, 0, [p, self.units() as u64]);
        stream.permutation(interior.len()).into_iter().map(|i| interior[i]).collect()
    }
}
