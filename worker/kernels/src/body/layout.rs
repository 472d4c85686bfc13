//! Layouts: which units there are, which nodes the ligaments join, and which nodes move together.
//!
//! A unit is a polygon, its nodes numbered counter-clockwise; undisplaced, node p lies at h·(its place in the unit's shape) from
//! the unit's reference point, h = (spacing − ligament length)/2. Each node group has a 2-vector of the design α, and the ends of
//! a ligament are in one group. Lattices repeat a [`Pattern`]; a square's node p lies at h·(cos pπ/2, sin pπ/2).

use super::geometry::moments;
use super::pattern::{End, Pattern};
use super::rigid::Follower;
use crate::random::{Purpose, Stream};
use std::collections::{BTreeMap, BTreeSet};

/// An elastic ligament between two nodes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ligament {
    /// Where it begins; in a square lattice the right or top node of the left or lower unit.
    pub a: End,
    /// Where it ends.
    pub b: End,
    /// d₀ (mm), from a to b.
    pub reference: [f64; 2],
}

/// Where a node group is in a lattice: the pattern's ligament that its nodes belong to, and the cell where that ends.
pub type GroupCell = (usize, [i32; 2]);

/// A body without its design; the default has no units.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Layout {
    /// Reference points of the units (mm).
    pub centres: Vec<[f64; 2]>,
    /// Cells (i, j) of the lattice that the units lie in, i to the right, j upward; of a body from a file all (0, 0).
    pub grid: Vec<[i32; 2]>,
    /// Nodes of each unit relative to its reference point, undisplaced, in units of h.
    pub shape: Vec<Vec<[f64; 2]>>,
    /// Number of the first node of each unit where all nodes are counted, and how many there are.
    pub first: Vec<usize>,
    /// h (mm).
    pub half: f64,
    /// l₀ (mm), of a ligament along the line between two reference points; of a body from a file the mean.
    pub ligament_length: f64,
    /// Distance of neighbouring reference points (mm); of a body from a file the mean.
    pub spacing: f64,
    /// One kind of the pattern after another, by cells (j outer, i inner).
    pub ligaments: Vec<Ligament>,
    /// Node group of each node of each unit; none of nodes that are no part of the design: they stay, or follow others.
    pub groups: Vec<Vec<Option<usize>>>,
    /// Of each unit whether its shape is given, and no limit judges it.
    pub rigid: Vec<bool>,
    /// By what the plane density of each unit is multiplied.
    pub density: Vec<f64>,
    /// Of each unit its nodes that follow others.
    pub followers: Vec<Vec<Follower>>,
    /// Of each node group.
    pub group_cells: Vec<GroupCell>,
    /// Number of node groups.
    pub group_count: usize,
    /// How a group shifts where units turn against their neighbours, per tangent of the angle, in units of h.
    turning: Vec<[f64; 2]>,
    /// Whether a node of a unit holds no ligament.
    pub boundary: Vec<bool>,
    /// Whether a unit may carry a sensor: those inside, or what a file says.
    pub carriers: Vec<bool>,
}

/// The units of a layout: reference points, cells, nodes relative to them.
struct Units {
    centres: Vec<[f64; 2]>,
    grid: Vec<[i32; 2]>,
    shape: Vec<Vec<[f64; 2]>>,
}

/// The node groups of a layout: of each node, and each one's cell and turning.
struct Groups {
    of_nodes: Vec<Vec<Option<usize>>>,
    cells: Vec<GroupCell>,
    turning: Vec<[f64; 2]>,
}

impl Layout {
    /// `columns` × `rows` squares; unit (i, j) has index j·columns + i and reference point (i, j)·spacing.
    pub fn planar(columns: usize, rows: usize, spacing: f64, ligament_length: f64) -> Self {
        Self::sheet(&Pattern::square(), columns, rows, spacing, ligament_length)
    }

    /// `rows` rows of `columns` units of a lattice, one above the other, row by row from the left.
    pub fn sheet(pattern: &Pattern, columns: usize, rows: usize, spacing: f64, ligament_length: f64) -> Self {
        let row = |j: i32| (0..columns as i32).map(move |n| (j, n));
        let units = (0..rows as i32).flat_map(row).map(|(j, n)| pattern.in_row(j, n)).collect();
        Self::of_pattern(pattern, units, [0.0, 0.0], spacing, ligament_length)
    }

    /// The units of a lattice whose reference points lie in the disc of diameter `across`·spacing about 0, row by row from the left. In the
    /// middle is a unit where `across` is odd, a void where it is even.
    pub fn circular(pattern: &Pattern, across: usize, spacing: f64, ligament_length: f64) -> Self {
        let (units, centre) = pattern.in_disc(across as i32);
        Self::of_pattern(pattern, units, centre.map(|c| -c * spacing), spacing, ligament_length)
    }

    /// Units of a pattern by cell and place in it, in the order given.
    fn of_pattern(
        pattern: &Pattern,
        units: Vec<([i32; 2], usize)>,
        origin: [f64; 2],
        spacing: f64,
        ligament_length: f64,
    ) -> Self {
        let index: BTreeMap<([i32; 2], usize), usize> =
            units.iter().enumerate().map(|(u, &unit)| (unit, u)).collect();
        assert_eq!(index.len(), units.len(), "units repeat");
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
            let mut places: Vec<[i32; 2]> =
                scan.iter().flat_map(|&[i, j]| [[i, j], [i + di, j + dj]]).collect();
            places.sort_unstable();
            places.dedup();
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
        let places = Units {
            centres: units.iter().map(place).collect(),
            grid: units.iter().map(|unit| unit.0).collect(),
            shape: units.iter().map(|&(_, member)| pattern.units[member].nodes.clone()).collect(),
        };
        let groups = Groups { of_nodes: groups, cells: group_cells, turning };
        Self::assembled(places, [spacing, ligament_length], &ligaments, groups)
    }

    /// A body of any polygons, each by its nodes (mm) counter-clockwise, joined by ligaments; `together` are further nodes that shift
    /// together. Reference points are the means of a polygon's nodes. Nodes of `rigid` units that no ligament holds stay, but for
    /// those that follow others (of a unit each). Spacing and ligament length are the means over ligaments between other units, if
    /// there are any.
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
        let between = |a: [f64; 2], b: [f64; 2]| [b[0] - a[0], b[1] - a[1]];
        let centres: Vec<[f64; 2]> = polygons.iter().map(|points| mean(points)).collect();
        let free = |[a, b]: &&[End; 2]| !rigid.contains(&a.unit) && !rigid.contains(&b.unit);
        let some_free = ligaments.iter().any(|ends| free(&ends));
        let measured = || ligaments.iter().filter(move |ends| !some_free || free(ends));
        let count = measured().count().max(1) as f64;
        let pitch = measured().map(|[a, b]| length(between(centres[a.unit], centres[b.unit])));
        let bare = |[a, b]: &[End; 2]| length(between(polygons[a.unit][a.node], polygons[b.unit][b.node]));
        let spacing = pitch.sum::<f64>() / count;
        let ligament_length = measured().map(bare).sum::<f64>() / count;
        let half = 0.5 * (spacing - ligament_length);
        let relative = |(points, c): (&Vec<[f64; 2]>, &[f64; 2])| {
            points.iter().map(|q| between(*c, *q).map(|x| x / half)).collect()
        };

        // The least end of those that shift together stands for them.
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
        let held: BTreeSet<End> = ligaments.iter().flatten().copied().collect();
        for (unit, points) in polygons.iter().enumerate() {
            let is_rigid = rigid.contains(&unit);
            let of = |node: usize| {
                let (end, count) = (End { unit, node }, number.len());
                let moves = !is_rigid || held.contains(&end);
                moves.then(|| *number.entry(root(&joined, end)).or_insert(count))
            };
            groups.push((0..points.len()).map(of).collect());
        }
        let places = Units {
            grid: vec![[0; 2]; polygons.len()],
            shape: polygons.iter().zip(&centres).map(relative).collect(),
            centres,
        };
        let groups = Groups {
            of_nodes: groups,
            cells: (0..number.len()).map(|group| (group, [0; 2])).collect(),
            turning: vec![[0.0; 2]; number.len()],
        };
        let mut layout = Self::assembled(places, [spacing, ligament_length], ligaments, groups);
        rigid.iter().for_each(|&unit| layout.rigid[unit] = true);
        followers.iter().for_each(|&(unit, follower)| layout.followers[unit].push(follower));
        layout
    }

    fn assembled(
        Units { centres, grid, shape }: Units,
        [spacing, ligament_length]: [f64; 2],
        ligaments: &[[End; 2]],
        groups: Groups,
    ) -> Self {
        let mut boundary = vec![false; centres.len()];
        let joined: BTreeSet<End> = ligaments.iter().flatten().copied().collect();
        for (unit, nodes) in shape.iter().enumerate() {
            boundary[unit] = (0..nodes.len()).any(|node| !joined.contains(&End { unit, node }));
        }
        let mut first = vec![0];
        shape.iter().for_each(|nodes| first.push(first[first.len() - 1] + nodes.len()));
        let mut layout = Self {
            centres,
            grid,
            shape,
            first,
            half: 0.5 * (spacing - ligament_length),
            ligament_length,
            spacing,
            ligaments: ligaments.iter().map(|&[a, b]| Ligament { a, b, reference: [0.0; 2] }).collect(),
            group_count: groups.cells.len(),
            groups: groups.of_nodes,
            rigid: vec![false; boundary.len()],
            density: vec![1.0; boundary.len()],
            followers: vec![Vec::new(); boundary.len()],
            group_cells: groups.cells,
            turning: groups.turning,
            carriers: boundary.iter().map(|edge| !edge).collect(),
            boundary,
        };
        layout.refer();
        layout
    }

    /// Ligaments from node to node of the undisplaced units: l₀ long where they lie on the line between two reference points.
    fn refer(&mut self) {
        let place = |end: End| {
            let ([x, y], [p, q]) = (self.centres[end.unit], self.shape[end.unit][end.node]);
            [x + self.half * p, y + self.half * q]
        };
        let reference = |ligament: &Ligament| {
            let [a, b] = [ligament.a, ligament.b];
            let (c, d) = (self.centres[a.unit], self.centres[b.unit]);
            let away = [d[0] - c[0], d[1] - c[1]];
            let straight = away.map(|x| x / away[0].hypot(away[1]) * self.ligament_length);
            let (p, q) = (place(a), place(b));
            let bare = [q[0] - p[0], q[1] - p[1]];
            let off = (bare[0] - straight[0]).hypot(bare[1] - straight[1]);
            if off < 1e-9 * self.spacing { straight } else { bare }
        };
        let references: Vec<[f64; 2]> = self.ligaments.iter().map(reference).collect();
        self.ligaments.iter_mut().zip(references).for_each(|(ligament, d)| ligament.reference = d);
    }

    /// The same lattice with ligaments of another length: its units are smaller by what they are longer.
    #[must_use]
    pub fn with_ligament_length(&self, ligament_length: f64) -> Self {
        let mut own = Self { half: 0.5 * (self.spacing - ligament_length), ligament_length, ..self.clone() };
        own.refer();
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

    /// Units turned by ±`angle` (rad) against their neighbours; where a lattice cannot, or a file gives the units, as they are.
    pub fn initial_design(&self, angle: f64) -> Vec<f64> {
        let tangent = self.half * angle.tan();
        self.turning.iter().flat_map(|turn| turn.map(|t| t * tangent + 0.0)).collect()
    }

    /// Positions of a unit's nodes relative to its reference point (mm).
    pub fn place(&self, design: &[f64], unit: usize, nodes: &mut [[f64; 2]]) {
        for ((node, base), group) in nodes.iter_mut().zip(&self.shape[unit]).zip(&self.groups[unit]) {
            let shift = group.map_or([0.0; 2], |group| [design[2 * group], design[2 * group + 1]]);
            *node = [self.half * base[0] + shift[0], self.half * base[1] + shift[1]];
        }
        let [x, y] = self.centres[unit];
        for follower in &self.followers[unit] {
            let [p, q] = follower.place(self.bases(unit, follower), self.leaders(unit, follower, nodes));
            nodes[follower.node] = [p - x, q - y];
        }
    }

    /// Where a follower and those that it follows are undisplaced (mm).
    pub(crate) fn bases(&self, unit: usize, follower: &Follower) -> [[f64; 2]; 3] {
        let ([x, y], Follower { node, of: [a, b], .. }) = (self.centres[unit], *follower);
        [node, a, b].map(|node| {
            let [p, q] = self.shape[unit][node];
            [x + self.half * p, y + self.half * q]
        })
    }

    /// Where those are that it follows (mm).
    fn leaders(&self, unit: usize, follower: &Follower, nodes: &[[f64; 2]]) -> [[f64; 2]; 2] {
        let [x, y] = self.centres[unit];
        follower.of.map(|node| [x + nodes[node][0], y + nodes[node][1]])
    }

    /// Adds to `design` what cotangents of a unit's nodes make of it, these being where they are. Those of followers go to those
    /// that they follow.
    pub fn place_vjp(&self, unit: usize, nodes: &[[f64; 2]], bar: &mut [[f64; 2]], design: &mut [f64]) {
        for follower in &self.followers[unit] {
            let own = std::mem::take(&mut bar[follower.node]);
            let leaders = self.leaders(unit, follower, nodes);
            let of = follower.vjp(self.bases(unit, follower), leaders, own);
            for (node, [x, y]) in follower.of.into_iter().zip(of) {
                bar[node] = [bar[node][0] + x, bar[node][1] + y];
            }
        }
        for (group, bar) in self.groups[unit].iter().zip(bar) {
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

    /// How many nodes all units have.
    pub fn nodes(&self) -> usize {
        self.first[self.units()]
    }

    /// A node's place among all.
    pub fn number(&self, end: End) -> usize {
        self.first[end.unit] + end.node
    }

    /// The node after one on its unit.
    pub fn next(&self, end: End) -> End {
        End { node: (end.node + 1) % self.shape[end.unit].len(), ..end }
    }

    /// The node before one on its unit.
    pub fn previous(&self, end: End) -> End {
        let count = self.shape[end.unit].len();
        End { node: (end.node + count - 1) % count, ..end }
    }

    /// Mean area A of the undisplaced units (mm²), and their mean polar second moment of area by A²/6: 1 for squares.
    pub fn mean_unit(&self) -> (f64, f64) {
        let (mut area, mut polar) = (0.0, 0.0);
        for nodes in &self.shape {
            let own = moments(nodes);
            (area, polar) = (area + own.area, polar + own.polar);
        }
        let count = self.units() as f64;
        let area = area / count;
        (area * self.half.powi(2), 0.5 * (polar / count) / area.powi(2))
    }

    /// The k input panels of a sheet, from left to right: of its topmost units, symmetric about their middle.
    /// None where they would not be k different units.
    pub fn top_panels(&self, k: usize) -> Option<Vec<usize>> {
        let top = self.top();
        let columns = top.len();
        if k == 0 || k > columns {
            return None;
        }
        let column = |q: usize| if 2 * q < k { (2 * q + 1) * columns / (2 * k) } else { usize::MAX };
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

    /// Units whose reference points are so high (mm).
    fn level(&self, height: f64) -> Vec<usize> {
        let near = |u: &usize| (self.centres[*u][1] - height).abs() < 1e-6 * self.spacing;
        (0..self.units()).filter(near).collect()
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

    /// The lowest units.
    pub fn bottom(&self) -> Vec<usize> {
        self.level(self.centres.iter().map(|c| c[1]).fold(f64::INFINITY, f64::min))
    }

    /// The lowest and the topmost units of a planar body, in order.
    pub fn ends(&self) -> Vec<usize> {
        let (bottom, top) = (self.bottom(), self.top());
        (0..self.units()).filter(|u| bottom.contains(u) || top.contains(u)).collect()
    }

    /// The leftmost and the rightmost unit of every row of a lattice; of a body from a file those as far to a side as neighbours of
    /// the outermost are not.
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

    /// The innermost unit of a circular body, or those around the void in its middle.
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
            (0..self.units()).filter(|u| self.carriers[*u] && !clamped.contains(u)).collect();
        let mut stream = Stream::new(Purpose::Placement, 0, [p, self.units() as u64]);
        stream.permutation(interior.len()).into_iter().map(|i| interior[i]).collect()
    }
}
