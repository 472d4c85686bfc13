//! Layouts: the units, the nodes that ligaments join, and the nodes that shift together.
//!
//! A unit is a polygon whose nodes are numbered counter-clockwise. Node p of an undisplaced unit lies at h·`shape[unit][p]` from the
//! reference point, h = (spacing − ligament length)/2. Each node group has a 2-vector of the design α; both ends of a ligament are in one
//! group. Lattices repeat a [`Pattern`]; node p of a square lies at h·(cos pπ/2, sin pπ/2).

use super::geometry::{difference, moments};
use super::pattern::{End, Pattern};
use super::rigid::Follower;
use crate::random::{Purpose, Stream};
use std::collections::{BTreeMap, BTreeSet};

/// An elastic ligament between two nodes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ligament {
    /// First end; in a square lattice the right or top node of the left or lower unit.
    pub a: End,
    /// Second end.
    pub b: End,
    /// Reference vector d₀ from a to b (mm).
    pub reference: [f64; 2],
}

/// Place of a node group in a lattice: index of the pattern's link, and the cell where that link ends.
pub type GroupCell = (usize, [i32; 2]);

/// A body without its design; the default has no units.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Layout {
    /// Reference points of the units (mm).
    pub centres: Vec<[f64; 2]>,
    /// Lattice cell (i, j) of each unit, i to the right, j upward; (0, 0) in a body from a file.
    pub grid: Vec<[i32; 2]>,
    /// Undisplaced nodes of each unit relative to its reference point, in units of h.
    pub shape: Vec<Vec<[f64; 2]>>,
    /// Global number of the first node of each unit; the last entry is the number of all nodes.
    pub first: Vec<usize>,
    /// l₀ (mm) of a ligament that lies on the line between two reference points; in a body from a file the mean length.
    pub ligament_length: f64,
    /// Distance of joined reference points (mm); in a body from a file the mean.
    pub spacing: f64,
    /// Ligaments, ordered by kind, then by cell (j outer, i inner).
    pub ligaments: Vec<Ligament>,
    /// Nodes that shift together.
    pub groups: Groups,
    /// Whether each unit has a given shape, to which the limits of feasibility do not apply.
    pub rigid: Vec<bool>,
    /// Factor on the plane density of each unit.
    pub density: Vec<f64>,
    /// Followers among the nodes of each unit.
    pub followers: Vec<Vec<Follower>>,
    /// Whether each unit may carry a sensor: in lattices the interior units.
    pub carriers: Vec<bool>,
}

/// Node groups of a layout. A group shifts as one, by two numbers of α.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Groups {
    /// Group of each node of each unit. `None`: the node is not part of the design, and is fixed or follows others.
    pub of_nodes: Vec<Vec<Option<usize>>>,
    /// Link and cell of each group.
    pub cells: Vec<GroupCell>,
    /// Shift of each group in the initial design per tangent of the angle, in units of h.
    turning: Vec<[f64; 2]>,
}

impl Groups {
    /// Number of groups.
    pub fn count(&self) -> usize {
        self.cells.len()
    }
}

impl Layout {
    /// `columns` × `rows` squares; unit (i, j) has index j·columns + i and reference point (i, j)·spacing.
    pub fn planar(columns: usize, rows: usize, spacing: f64, ligament_length: f64) -> Self {
        Self::sheet(&Pattern::square(), columns, rows, spacing, ligament_length)
    }

    /// A sheet of `rows` rows of `columns` units of a lattice, numbered row by row from the left.
    pub fn sheet(pattern: &Pattern, columns: usize, rows: usize, spacing: f64, ligament_length: f64) -> Self {
        let row = |j: i32| (0..columns as i32).map(move |n| (j, n));
        let units = (0..rows as i32).flat_map(row).map(|(j, n)| pattern.in_row(j, n)).collect();
        Self::of_pattern(pattern, units, [0.0, 0.0], spacing, ligament_length)
    }

    /// The units of a lattice whose reference points lie in the disc of diameter `across`·spacing about the origin, row by row from the
    /// left. The centre is a unit if `across` is odd, and a void if it is even.
    pub fn circular(pattern: &Pattern, across: usize, spacing: f64, ligament_length: f64) -> Self {
        let (units, centre) = pattern.in_disc(across as i32);
        Self::of_pattern(pattern, units, centre.map(|c| -c * spacing), spacing, ligament_length)
    }

    /// The given units of a pattern, each by cell and index in the cell, in this order.
    fn of_pattern(
        pattern: &Pattern,
        units: Vec<([i32; 2], usize)>,
        origin: [f64; 2],
        spacing: f64,
        ligament_length: f64,
    ) -> Self {
        let index: BTreeMap<([i32; 2], usize), usize> =
            units.iter().enumerate().map(|(u, &unit)| (unit, u)).collect();
        assert_eq!(index.len(), units.len(), "duplicate units");
        let at = |cell: [i32; 2], member: usize| index.get(&(cell, member)).copied();
        let mut scan: Vec<[i32; 2]> = units.iter().map(|unit| unit.0).collect();
        scan.sort_by_key(|&[i, j]| (j, i));
        scan.dedup();

        let mut ligaments = Vec::new();
        let mut groups: Vec<Vec<Option<usize>>> =
            units.iter().map(|&(_, member)| vec![None; pattern.units[member].nodes.len()]).collect();
        let (mut group_cells, mut turning) = (Vec::new(), Vec::new());
        for (kind, link) in pattern.links.iter().enumerate() {
            let [di, dj] = link.cells;
            for &[i, j] in &scan {
                if let (Some(a), Some(b)) = (at([i, j], link.from.unit), at([i + di, j + dj], link.to.unit)) {
                    ligaments
                        .push([End { unit: a, node: link.from.node }, End { unit: b, node: link.to.node }]);
                }
            }
            let places: BTreeSet<[i32; 2]> =
                scan.iter().flat_map(|&[i, j]| [[i, j], [i + di, j + dj]]).collect();
            for [i, j] in places {
                let ends =
                    [(at([i - di, j - dj], link.from.unit), link.from), (at([i, j], link.to.unit), link.to)];
                if ends.iter().all(|end| end.0.is_none()) {
                    continue;
                }
                for (unit, end) in ends {
                    if let Some(unit) = unit {
                        groups[unit][end.node] = Some(group_cells.len());
                    }
                }
                let [x, y] = pattern.units[link.to.unit].nodes[link.to.node];
                let sense = pattern.sense([i, j], link.to.unit);
                turning.push([-y * sense + 0.0, x * sense + 0.0]);
                group_cells.push((kind, [i, j]));
            }
        }
        let place = |&([i, j], member): &([i32; 2], usize)| {
            [0, 1].map(|d| origin[d] + pattern.centre([i, j], member)[d] * spacing)
        };
        let layout = Self {
            centres: units.iter().map(place).collect(),
            grid: units.iter().map(|unit| unit.0).collect(),
            shape: units.iter().map(|&(_, member)| pattern.units[member].nodes.clone()).collect(),
            spacing,
            ligament_length,
            groups: Groups { of_nodes: groups, cells: group_cells, turning },
            ..Self::default()
        };
        layout.completed(&ligaments)
    }

    /// A body of arbitrary polygons with nodes in mm, counter-clockwise. Reference points are the means of the nodes. Each entry of
    /// `together` is a set of nodes that shift together. In `rigid` units, nodes without ligaments are fixed unless listed in `followers`
    /// as (unit, follower). Spacing and ligament length are means over the ligaments between units that are not rigid, if any exist.
    pub fn of_polygons(
        polygons: &[Vec<[f64; 2]>],
        ligaments: &[[End; 2]],
        together: &[Vec<End>],
        rigid: &[usize],
        followers: &[(usize, Follower)],
    ) -> Self {
        let mean = |points: &[[f64; 2]]| {
            [0, 1].map(|d| points.iter().map(|q| q[d]).sum::<f64>() / points.len() as f64)
        };
        let length = |[x, y]: [f64; 2]| x.hypot(y);
        let centres: Vec<[f64; 2]> = polygons.iter().map(|points| mean(points)).collect();
        let free = |[a, b]: &&[End; 2]| !rigid.contains(&a.unit) && !rigid.contains(&b.unit);
        let some_free = ligaments.iter().any(|ends| free(&ends));
        let measured = || ligaments.iter().filter(move |ends| !some_free || free(ends));
        let count = measured().count().max(1) as f64;
        let pitch = measured().map(|[a, b]| length(difference(centres[b.unit], centres[a.unit])));
        let bare = |[a, b]: &[End; 2]| length(difference(polygons[b.unit][b.node], polygons[a.unit][a.node]));
        let spacing = pitch.sum::<f64>() / count;
        let ligament_length = measured().map(bare).sum::<f64>() / count;
        let half = 0.5 * (spacing - ligament_length);
        let relative = |(points, c): (&Vec<[f64; 2]>, &[f64; 2])| {
            points.iter().map(|q| difference(*q, *c).map(|x| x / half)).collect()
        };

        // Each set of nodes that shift together is represented by its least end.
        let mut joined: BTreeMap<End, End> = BTreeMap::new();
        let root = |joined: &BTreeMap<End, End>, mut end: End| {
            while let Some(&next) = joined.get(&end) {
                end = next;
            }
            end
        };
        let pairs = ligaments.iter().map(|l| &l[..]).chain(together.iter().map(|t| &t[..]));
        for ends in pairs {
            for pair in ends.windows(2) {
                let [a, b] = [pair[0], pair[1]].map(|end| root(&joined, end));
                if a != b {
                    joined.insert(a.max(b), a.min(b));
                }
            }
        }
        let (mut number, mut groups) = (BTreeMap::new(), Vec::new());
        let ligament_ends: BTreeSet<End> = ligaments.iter().flatten().copied().collect();
        for (unit, points) in polygons.iter().enumerate() {
            let is_rigid = rigid.contains(&unit);
            let of = |node: usize| {
                let (end, count) = (End { unit, node }, number.len());
                let moves = !is_rigid || ligament_ends.contains(&end);
                moves.then(|| *number.entry(root(&joined, end)).or_insert(count))
            };
            groups.push((0..points.len()).map(of).collect());
        }
        let groups = Groups {
            of_nodes: groups,
            cells: (0..number.len()).map(|group| (group, [0; 2])).collect(),
            turning: vec![[0.0; 2]; number.len()],
        };
        let grid = vec![[0; 2]; polygons.len()];
        let shape = polygons.iter().zip(&centres).map(relative).collect();
        let layout = Self { centres, grid, shape, spacing, ligament_length, groups, ..Self::default() };
        let mut layout = layout.completed(ligaments);
        rigid.iter().for_each(|&unit| layout.rigid[unit] = true);
        followers.iter().for_each(|&(unit, follower)| layout.followers[unit].push(follower));
        layout
    }

    /// Adds ligaments and defaults to a layout that has units, lengths and groups.
    fn completed(mut self, ligaments: &[[End; 2]]) -> Self {
        let count = self.units();
        self.first = vec![0];
        for nodes in &self.shape {
            self.first.push(self.first[self.first.len() - 1] + nodes.len());
        }
        self.ligaments = ligaments.iter().map(|&[a, b]| Ligament { a, b, reference: [0.0; 2] }).collect();
        (self.rigid, self.density) = (vec![false; count], vec![1.0; count]);
        self.followers = vec![Vec::new(); count];
        self.carriers = self.boundary().iter().map(|edge| !edge).collect();
        self.set_references();
        self
    }

    /// Undisplaced position of a node (mm).
    fn undisplaced(&self, end: End) -> [f64; 2] {
        let ([x, y], [p, q]) = (self.centres[end.unit], self.shape[end.unit][end.node]);
        [x + self.half() * p, y + self.half() * q]
    }

    /// Sets the reference vectors of the undisplaced body. A ligament on the line between two reference points has the length l₀.
    fn set_references(&mut self) {
        let reference = |&Ligament { a, b, .. }: &Ligament| {
            let away = difference(self.centres[b.unit], self.centres[a.unit]);
            let straight = away.map(|x| x / away[0].hypot(away[1]) * self.ligament_length);
            let bare = difference(self.undisplaced(b), self.undisplaced(a));
            let off = (bare[0] - straight[0]).hypot(bare[1] - straight[1]);
            if off < 1e-9 * self.spacing { straight } else { bare }
        };
        let references: Vec<[f64; 2]> = self.ligaments.iter().map(reference).collect();
        self.ligaments.iter_mut().zip(references).for_each(|(ligament, d)| ligament.reference = d);
    }

    /// The same layout with another ligament length; the units shrink as the ligaments grow.
    pub fn with_ligament_length(&self, ligament_length: f64) -> Self {
        let mut resized = Self { ligament_length, ..self.clone() };
        resized.set_references();
        resized
    }

    /// Number of units.
    pub fn units(&self) -> usize {
        self.centres.len()
    }

    /// h = (spacing − ligament length)/2 (mm).
    pub fn half(&self) -> f64 {
        0.5 * (self.spacing - self.ligament_length)
    }

    /// Whether each unit has a node without a ligament.
    pub fn boundary(&self) -> Vec<bool> {
        let joined: BTreeSet<End> =
            self.ligaments.iter().flat_map(|ligament| [ligament.a, ligament.b]).collect();
        let free = |(unit, nodes): (usize, &Vec<[f64; 2]>)| {
            (0..nodes.len()).any(|node| !joined.contains(&End { unit, node }))
        };
        self.shape.iter().enumerate().map(free).collect()
    }

    /// Length of α: two per node group.
    pub fn design_len(&self) -> usize {
        2 * self.groups.count()
    }

    /// The design whose units are rotated by ±`angle` (rad) against their neighbours; zeros if the lattice or the file does not allow that.
    pub fn initial_design(&self, angle: f64) -> Vec<f64> {
        let tangent = self.half() * angle.tan();
        self.groups.turning.iter().flat_map(|turn| turn.map(|t| t * tangent + 0.0)).collect()
    }

    /// Positions of a unit's nodes relative to its reference point (mm).
    pub fn place(&self, design: &[f64], unit: usize, nodes: &mut [[f64; 2]]) {
        for ((node, base), group) in nodes.iter_mut().zip(&self.shape[unit]).zip(&self.groups.of_nodes[unit])
        {
            let shift = group.map_or([0.0; 2], |group| [design[2 * group], design[2 * group + 1]]);
            *node = [self.half() * base[0] + shift[0], self.half() * base[1] + shift[1]];
        }
        let [x, y] = self.centres[unit];
        for follower in &self.followers[unit] {
            let [p, q] = follower.place(self.bases(unit, follower), self.leaders(unit, follower, nodes));
            nodes[follower.node] = [p - x, q - y];
        }
    }

    /// Undisplaced positions of a follower and of its two leaders (mm).
    pub(crate) fn bases(&self, unit: usize, follower: &Follower) -> [[f64; 2]; 3] {
        let Follower { node, of: [a, b], .. } = *follower;
        [node, a, b].map(|node| self.undisplaced(End { unit, node }))
    }

    /// Present positions of the two leaders of a follower (mm).
    fn leaders(&self, unit: usize, follower: &Follower, nodes: &[[f64; 2]]) -> [[f64; 2]; 2] {
        let [x, y] = self.centres[unit];
        follower.of.map(|node| [x + nodes[node][0], y + nodes[node][1]])
    }

    /// Adds to `design` the gradient for the cotangents `bar` of a unit's nodes at positions `nodes`. The cotangent of a follower passes to
    /// its leaders.
    pub fn place_vjp(&self, unit: usize, nodes: &[[f64; 2]], bar: &mut [[f64; 2]], design: &mut [f64]) {
        for follower in &self.followers[unit] {
            let own = std::mem::take(&mut bar[follower.node]);
            let leaders = self.leaders(unit, follower, nodes);
            let of = follower.vjp(self.bases(unit, follower), leaders, own);
            for (node, [x, y]) in follower.of.into_iter().zip(of) {
                bar[node] = [bar[node][0] + x, bar[node][1] + y];
            }
        }
        for (group, bar) in self.groups.of_nodes[unit].iter().zip(bar) {
            let Some(group) = *group else { continue };
            design[2 * group] += bar[0];
            design[2 * group + 1] += bar[1];
        }
    }

    /// Absolute node positions of each unit (mm).
    pub fn vertices(&self, design: &[f64]) -> Vec<Vec<[f64; 2]>> {
        assert_eq!(design.len(), self.design_len(), "length of the design");
        let unit = |unit: usize| {
            let (mut nodes, [x, y]) = (vec![[0.0; 2]; self.shape[unit].len()], self.centres[unit]);
            self.place(design, unit, &mut nodes);
            nodes.iter_mut().for_each(|node| *node = [x + node[0], y + node[1]]);
            nodes
        };
        (0..self.units()).map(unit).collect()
    }

    /// Number of nodes of all units.
    pub fn nodes(&self) -> usize {
        self.first[self.units()]
    }

    /// Global number of a node.
    pub fn number(&self, end: End) -> usize {
        self.first[end.unit] + end.node
    }

    /// The next node of the same unit, counter-clockwise.
    pub fn next(&self, end: End) -> End {
        End { node: (end.node + 1) % self.shape[end.unit].len(), ..end }
    }

    /// The previous node of the same unit.
    pub fn previous(&self, end: End) -> End {
        let count = self.shape[end.unit].len();
        End { node: (end.node + count - 1) % count, ..end }
    }

    /// Mean area A of the undisplaced units (mm²), and their mean polar second moment of area divided by A²/6 (1 for squares).
    pub fn mean_unit(&self) -> (f64, f64) {
        let (mut area, mut polar) = (0.0, 0.0);
        for nodes in &self.shape {
            let own = moments(nodes);
            (area, polar) = (area + own.area, polar + own.polar);
        }
        let count = self.units() as f64;
        let area = area / count;
        (area * self.half().powi(2), 0.5 * (polar / count) / area.powi(2))
    }

    /// The k panels of a sheet, from left to right: k of the topmost units, symmetric about their middle. `None` if the topmost units do
    /// not yield k different panels.
    pub fn top_panels(&self, k: usize) -> Option<Vec<usize>> {
        let top = self.top();
        let columns = top.len();
        if k == 0 || k > columns {
            return None;
        }
        let column = |q: usize| (2 * q + 1) * columns / (2 * k);
        let panel = |q: usize| if 2 * q < k { column(q) } else { columns - 1 - column(k - 1 - q) };
        let panels: Vec<usize> = (0..k).map(panel).collect();
        let distinct = panels.windows(2).all(|w| w[0] < w[1]) && panels[k - 1] < columns;
        distinct.then(|| panels.iter().map(|&c| top[c]).collect())
    }

    /// The topmost units, from left to right.
    pub fn top(&self) -> Vec<usize> {
        let mut top = self.level(self.centres.iter().map(|c| c[1]).fold(f64::NEG_INFINITY, f64::max));
        top.sort_by(|&u, &v| self.centres[u][0].total_cmp(&self.centres[v][0]));
        top
    }

    /// Units whose reference points have the height `height` (mm).
    fn level(&self, height: f64) -> Vec<usize> {
        let near = |u: &usize| (self.centres[*u][1] - height).abs() < 1e-6 * self.spacing;
        (0..self.units()).filter(near).collect()
    }

    /// k of the eight panels of a disc with their inward directions, evenly spaced from angle 0. `None` unless k divides eight and the
    /// units differ.
    pub fn circular_panels(&self, k: usize) -> Option<Vec<(usize, [f64; 2])>> {
        if k == 0 || 8 % k != 0 {
            return None;
        }
        let boundary = self.boundary();
        let panel = |q: usize| {
            let angle = (q * 8 / k) as f64 * std::f64::consts::FRAC_PI_4;
            let (s, c) = angle.sin_cos();
            // Smallest difference of angle; ties go to the unit further anticlockwise, then to the outer one.
            let key = |u: usize| {
                let [x, y] = self.centres[u];
                let off = (c * y - s * x).atan2(c * x + s * y);
                ((off.abs() * 1e9).round() as i64, off < 0.0, (-1e6 * x.hypot(y)) as i64)
            };
            let unit = (0..self.units()).filter(|&u| boundary[u]).min_by_key(|&u| key(u))?;
            Some((unit, [-c, -s]))
        };
        let panels: Vec<_> = (0..k).map(panel).collect::<Option<_>>()?;
        let units: BTreeSet<usize> = panels.iter().map(|p| p.0).collect();
        (units.len() == k).then_some(panels)
    }

    /// The lowest units.
    pub fn bottom(&self) -> Vec<usize> {
        self.level(self.centres.iter().map(|c| c[1]).fold(f64::INFINITY, f64::min))
    }

    /// The lowest and the topmost units of a sheet, in ascending order.
    pub fn ends(&self) -> Vec<usize> {
        let (bottom, top) = (self.bottom(), self.top());
        (0..self.units()).filter(|u| bottom.contains(u) || top.contains(u)).collect()
    }

    /// The leftmost and the rightmost unit of every row of a lattice. In a body from a file: the units within 0.6 spacings of the left or
    /// right extreme.
    pub fn sides(&self) -> Vec<usize> {
        let is_lattice = self.grid.iter().any(|cell| *cell != self.grid[0]);
        let (row, leeway) = (|u: usize| self.grid[u][1], if is_lattice { 1e-6 } else { 0.6 } * self.spacing);
        let mut ends: BTreeMap<i32, [f64; 2]> = BTreeMap::new();
        for u in 0..self.units() {
            let x = self.centres[u][0];
            let [left, right] = ends.entry(row(u)).or_insert([x; 2]);
            (*left, *right) = (left.min(x), right.max(x));
        }
        let is_end = |u: &usize| {
            let ([left, right], x) = (ends[&row(*u)], self.centres[*u][0]);
            x < left + leeway || x > right - leeway
        };
        (0..self.units()).filter(is_end).collect()
    }

    /// The innermost unit of a disc, or the units around its central void.
    pub fn hub(&self) -> Vec<usize> {
        let radius = |u: usize| self.centres[u][0].hypot(self.centres[u][1]);
        let least = (0..self.units()).map(radius).fold(f64::INFINITY, f64::min);
        (0..self.units()).filter(|&u| radius(u) < least + 0.1 * self.spacing).collect()
    }

    /// Whether the reference points of two units are at least `distance` apart (mm).
    pub fn are_apart(&self, a: usize, b: usize, distance: f64) -> bool {
        let [p, q] = [a, b].map(|unit| self.centres[unit]);
        (p[0] - q[0]).hypot(p[1] - q[1]) >= distance * (1.0 - 1e-9)
    }

    /// Placement `p`: a permutation of the units that may carry sensors and are not clamped. A body with M sensors uses the first M.
    pub fn placement(&self, p: u64, clamped: &[usize]) -> Vec<usize> {
        let interior: Vec<usize> =
            (0..self.units()).filter(|u| self.carriers[*u] && !clamped.contains(u)).collect();
        let mut stream = Stream::new(Purpose::Placement, 0, [p, self.units() as u64]);
        stream.permutation(interior.len()).into_iter().map(|i| interior[i]).collect()
    }
}
