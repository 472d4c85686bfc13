//! The constraints of the projection: smooth functions c(α) ≥ 0 in mm, with gradients, of features near their limits.
//!
//! Nodes move with their group, so a row depends on at most three groups. Angles are multiplied by their shorter edge. Nodes
//! without a group are constant within a program; followers are updated before the next. Two disjoint convex pieces have a row
//! per near (corner, edge) pair, with the exact gradient at the closest point. Overlapping pieces are separated along the edge
//! normal of least overlap.

use super::Limits;
use crate::body::{End, Layout, difference as sub, dot as inner, edges};
use std::f64::consts::{PI, TAU};

type Point = [f64; 2];

/// Identifies a row. Rows are sorted by key, so equal keys imply equal sparsity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Key {
    pub kind: RowKind,
    /// Indices of nodes among all nodes, or of ligaments, depending on `kind`.
    pub at: [u32; 3],
}

/// Kind of a row, and its indices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) enum RowKind {
    /// Length of an edge: its first node.
    Edge,
    /// Least interior angle: node.
    AngleLow,
    /// Greatest interior angle: node.
    AngleHigh,
    /// Angle between ligament and edge: node; 0 for the next edge, 1 for the previous one.
    Ligament,
    /// Void angle: node of the first end; ligament.
    Void,
    /// Distance of two corners: both.
    Corners,
    /// Distance of a corner from an edge: the corner, the edge's two nodes.
    Side,
    /// As `Side`, for overlapping pieces.
    Through,
}

/// One linearised constraint: c(α + d) ≈ value + Σ gradient·d ≥ 0.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row {
    pub key: Key,
    pub value: f64,
    terms: [(u32, Point); 3],
    count: usize,
    /// Whether a ligament is involved.
    pub bar: bool,
}

impl Row {
    /// (group, gradient) of each group on which the row depends.
    pub fn terms(&self) -> &[(u32, Point)] {
        &self.terms[..self.count]
    }

    /// The row for tied groups: sums gradients of groups with the same leader, and drops fixed groups.
    pub fn tied(&self, leader: &[usize], fixed: &[bool]) -> Self {
        let mut tied = Self { count: 0, ..*self };
        for &(group, gradient) in self.terms().iter().filter(|t| !fixed[t.0 as usize]) {
            let leader = leader[group as usize] as u32;
            let at = tied.terms().iter().position(|t| t.0 == leader).unwrap_or(tied.count);
            if at == tied.count {
                tied.terms[at] = (leader, [0.0; 2]);
                tied.count += 1;
            }
            (0..2).for_each(|c| tied.terms[at].1[c] += gradient[c]);
        }
        tied
    }

    /// The linearised value after a step.
    pub fn value_after(&self, step: &[f64]) -> f64 {
        let gain = |&(g, d): &(u32, Point)| d[0] * step[2 * g as usize] + d[1] * step[2 * g as usize + 1];
        self.value + self.terms().iter().map(gain).sum::<f64>()
    }
}

/// A unit, an edge of a rigid unit, or a ligament (two corners each).
#[derive(Debug, Clone)]
struct Piece {
    nodes: Vec<u32>,
    /// The units to which it belongs.
    units: [u32; 2],
}

impl Piece {
    fn is_closed(&self) -> bool {
        self.nodes.len() > 2
    }

    fn is_ligament(&self) -> bool {
        self.units[0] != self.units[1]
    }

    /// Edges from node to node; an open piece has one.
    fn edges(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        let count = if self.is_closed() { self.nodes.len() } else { 1 };
        edges(self.nodes.len()).take(count).map(|(p, s)| (self.nodes[p], self.nodes[s]))
    }
}

/// A layout, prepared for the enumeration of rows.
#[derive(Debug, Clone)]
pub(super) struct Rows {
    limits: Limits,
    layout: Layout,
    base: Vec<Point>,
    group: Vec<Option<u32>>,
    /// Per node: its unit, the next and the previous node, and its position in the unit's shape.
    unit: Vec<u32>,
    next: Vec<u32>,
    last: Vec<u32>,
    shape: Vec<Point>,
    pieces: Vec<Piece>,
    /// Node at a, node at b, direction from a to b.
    ligaments: Vec<(u32, u32, Point)>,
    units: usize,
    cell: f64,
}

/// Pairs of near pieces, valid while no coordinate moves by more than half of `margin`.
#[derive(Debug, Clone)]
pub(super) struct Near {
    pairs: Vec<(u32, u32)>,
    origin: Vec<f64>,
    margin: f64,
}

/// Least length of an edge that has a direction (mm).
const POINTLIKE: f64 = 1e-9;

fn scale(s: f64, a: Point) -> Point {
    [s * a[0], s * a[1]]
}
fn norm(a: Point) -> f64 {
    inner(a, a).sqrt()
}
/// ∂(direction angle)/∂a.
fn swing(a: Point) -> Point {
    let square = inner(a, a);
    [-a[1] / square, a[0] / square]
}
/// The angle, shifted by multiples of 2π into [centre − π, centre + π).
fn near_centre(angle: f64, centre: f64) -> f64 {
    (angle - centre + PI).rem_euclid(TAU) + centre - PI
}

impl Rows {
    pub fn new(layout: &Layout, limits: Limits) -> Self {
        let units = layout.units();
        let half = layout.half();
        let base = layout.vertices(&vec![0.0; layout.design_len()]).concat();
        let group =
            layout.groups.of_nodes.iter().flatten().map(|group| group.map(|group| group as u32)).collect();
        let nodes = |u: usize| layout.first[u] as u32..layout.first[u + 1] as u32;
        let mut pieces: Vec<Piece> =
            (0..units).map(|u| Piece { nodes: nodes(u).collect(), units: [u as u32; 2] }).collect();
        let ends =
            (0..units).flat_map(|unit| (0..layout.shape[unit].len()).map(move |node| End { unit, node }));
        let of = |to: fn(&Layout, End) -> End| {
            ends.clone().map(|end| layout.number(to(layout, end)) as u32).collect()
        };
        let (next, last): (Vec<u32>, Vec<u32>) = (of(Layout::next), of(Layout::previous));
        let mut ligaments = Vec::new();
        for ligament in &layout.ligaments {
            let (a, b) = (&ligament.a, &ligament.b);
            let [na, nb] = [*a, *b].map(|end| layout.number(end) as u32);
            pieces.push(Piece { nodes: vec![na, nb], units: [a.unit as u32, b.unit as u32] });
            ligaments.push((na, nb, ligament.reference));
        }
        for u in (0..units).filter(|u| layout.rigid[*u]) {
            let edge = |&n: &u32| Piece { nodes: vec![n, next[n as usize]], units: [u as u32; 2] };
            let edges: Vec<Piece> = pieces[u].nodes.iter().map(edge).collect();
            pieces.extend(edges);
        }
        let cell = 2.0 * half.abs().max(1e-3);
        let unit = ends.map(|end| end.unit as u32).collect();
        Self {
            limits,
            layout: layout.clone(),
            base,
            group,
            unit,
            next,
            last,
            shape: layout.shape.concat(),
            pieces,
            ligaments,
            units,
            cell,
        }
    }

    fn place(&self, design: &[f64]) -> Vec<Point> {
        if self.layout.rigid.contains(&true) {
            return self.layout.vertices(design).concat();
        }
        let shift = |group: Option<u32>, d: usize| group.map_or(0.0, |g| design[2 * g as usize + d]);
        let place = |(b, &group): (&Point, &Option<u32>)| [b[0] + shift(group, 0), b[1] + shift(group, 1)];
        self.base.iter().zip(&self.group).map(place).collect()
    }

    /// The unit of a node.
    pub fn unit(&self, n: usize) -> usize {
        self.unit[n] as usize
    }

    /// The first node of a unit.
    pub fn first(&self, unit: usize) -> usize {
        self.pieces[unit].nodes[0] as usize
    }

    /// The unit at the other end of ligament `l` from node `n`.
    pub fn across(&self, n: usize, l: usize) -> usize {
        let (a, b, _) = self.ligaments[l];
        self.unit(if n == a as usize { b } else { a } as usize)
    }

    /// Pairs whose bounding boxes come within their gap + `window` if each coordinate moves by up to `margin`/2.
    pub fn near(&self, design: &[f64], window: f64, margin: f64) -> Near {
        let at = self.place(design);
        let reach = 0.5 * (self.limits.clearance.max(self.limits.ligament_clearance).max(0.0) + window)
            + 0.5 * margin;
        let boxes: Vec<[f64; 4]> = self
            .pieces
            .iter()
            .map(|piece| {
                let mut b = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
                for &n in &piece.nodes {
                    let [x, y] = at[n as usize];
                    b = [b[0].min(x - reach), b[1].min(y - reach), b[2].max(x + reach), b[3].max(y + reach)];
                }
                b
            })
            .collect();
        // Sort pieces into the cells that they cover; compare pieces that cover too many cells with all.
        let index = |x: f64| (x / self.cell).floor().clamp(-1e9, 1e9) as i64;
        let mut cells: Vec<(i64, i64, u32)> = Vec::with_capacity(4 * boxes.len());
        let mut large = Vec::new();
        for (i, b) in boxes.iter().enumerate() {
            let span = [index(b[0]), index(b[2]), index(b[1]), index(b[3])];
            if (span[1] - span[0] + 1) * (span[3] - span[2] + 1) > 64 {
                large.push(i as u32);
                continue;
            }
            for cx in span[0]..=span[1] {
                for cy in span[2]..=span[3] {
                    cells.push((cx, cy, i as u32));
                }
            }
        }
        cells.sort_unstable();
        let mut pairs = Vec::new();
        let mut consider = |i: u32, j: u32| {
            let (i, j) = (i.min(j), i.max(j));
            let (p, q) = (&boxes[i as usize], &boxes[j as usize]);
            if p[0] > q[2] || q[0] > p[2] || p[1] > q[3] || q[1] > p[3] {
                return;
            }
            let (one, other) = (&self.pieces[i as usize], &self.pieces[j as usize]);
            let whole = |piece: &Piece| piece.is_closed() && self.layout.rigid[piece.units[0] as usize];
            let joined =
                |one: &Piece, other: &Piece| !one.is_ligament() && other.units.contains(&one.units[0]);
            if joined(one, other) || joined(other, one) || whole(one) || whole(other) {
                return;
            }
            pairs.push((i, j));
        };
        let mut from = 0;
        while from < cells.len() {
            let here = (cells[from].0, cells[from].1);
            let to = from + cells[from..].iter().take_while(|c| (c.0, c.1) == here).count();
            for a in from..to {
                for b in a + 1..to {
                    consider(cells[a].2, cells[b].2);
                }
            }
            from = to;
        }
        for &i in &large {
            for j in 0..boxes.len() as u32 {
                if j != i {
                    consider(i, j);
                }
            }
        }
        pairs.sort_unstable();
        pairs.dedup();
        Near { pairs, origin: design.to_vec(), margin }
    }

    /// Updates `near` if the design has moved too far for it.
    pub fn refresh(&self, near: &mut Near, design: &[f64], window: f64) {
        let moved = near.origin.iter().zip(design).fold(0.0_f64, |m, (a, b)| m.max((a - b).abs()));
        if moved.is_nan() || moved > 0.5 * near.margin {
            *near = self.near(design, window, near.margin);
        }
    }

    /// Every row with a value below `window`, sorted by key; `window` must not exceed that of `near`.
    pub fn collect(&self, near: &Near, design: &[f64], window: f64) -> Vec<Row> {
        let at = self.place(design);
        let mut rows = Vec::new();
        for u in 0..self.units as u32 {
            self.unit_rows(&at, u, window, &mut rows);
        }
        for l in 0..self.ligaments.len() as u32 {
            self.ligament_rows(&at, l, window, &mut rows);
        }
        for &(i, j) in &near.pairs {
            let (a, b, first) = (&self.pieces[i as usize], &self.pieces[j as usize], rows.len());
            let bar = a.is_ligament() || b.is_ligament();
            let gap = if bar { self.limits.ligament_clearance } else { self.limits.clearance };
            self.gap_rows(&at, a, b, gap, window, &mut rows);
            rows[first..].iter_mut().for_each(|row| row.bar = bar);
        }
        rows.sort_by(|a, b| a.key.cmp(&b.key).then(a.value.total_cmp(&b.value)));
        rows.dedup_by(|b, a| a.key == b.key);
        rows
    }

    /// Adds a row of (node, gradient) terms: sums nodes of one group, and drops rows that depend on none.
    fn row(&self, key: Key, value: f64, gradient: &[(u32, Point)], rows: &mut Vec<Row>) {
        let mut row = Row { key, value, terms: [(0, [0.0; 2]); 3], count: 0, bar: false };
        for &(node, g) in gradient {
            let Some(group) = self.group[node as usize] else { continue };
            match row.terms[..row.count].iter_mut().find(|t| t.0 == group) {
                Some(term) => term.1 = [term.1[0] + g[0], term.1[1] + g[1]],
                None => {
                    row.terms[row.count] = (group, g);
                    row.count += 1;
                }
            }
        }
        if row.terms[..row.count].iter().any(|t| t.1[0].abs() + t.1[1].abs() > 1e-12) && value.is_finite() {
            rows.push(row);
        }
    }

    fn unit_rows(&self, at: &[Point], u: u32, window: f64, rows: &mut Vec<Row>) {
        let limits = &self.limits;
        if self.layout.rigid[u as usize] {
            return;
        }
        for &here in &self.pieces[u as usize].nodes {
            let (next, last) = (self.next[here as usize], self.last[here as usize]);
            let [onward, back] = [next, last].map(|n| sub(at[n as usize], at[here as usize]));
            let (length, before) = (norm(onward), norm(back));
            if length - limits.min_edge < window {
                let along = if length > POINTLIKE {
                    scale(1.0 / length, onward)
                } else {
                    let away = sub(self.shape[next as usize], self.shape[here as usize]);
                    scale(1.0 / norm(away), away)
                };
                let key = Key { kind: RowKind::Edge, at: [here, 0, 0] };
                self.row(key, length - limits.min_edge, &[(next, along), (here, scale(-1.0, along))], rows);
            }
            if length < POINTLIKE || before < POINTLIKE {
                continue;
            }
            let centre = 0.5 * (limits.min_block_angle + limits.max_block_angle);
            let angle = near_centre(back[1].atan2(back[0]) - onward[1].atan2(onward[0]), centre);
            let size = length.min(before);
            let (g_next, g_last) = (scale(-size, swing(onward)), scale(size, swing(back)));
            let g_here = [-g_next[0] - g_last[0], -g_next[1] - g_last[1]];
            let low = size * (angle - limits.min_block_angle);
            if low < window {
                let key = Key { kind: RowKind::AngleLow, at: [here, 0, 0] };
                self.row(key, low, &[(next, g_next), (last, g_last), (here, g_here)], rows);
            }
            let high = size * (limits.max_block_angle - angle);
            if high < window {
                let key = Key { kind: RowKind::AngleHigh, at: [here, 0, 0] };
                let terms =
                    [(next, g_next), (last, g_last), (here, g_here)].map(|(n, g)| (n, scale(-1.0, g)));
                self.row(key, high, &terms, rows);
            }
        }
    }

    /// At the end `n` of a ligament that leaves along `away`, for the next and the previous edge: the angle to the ligament
    /// through the void, its gradient in the far node, that node, and the edge's length.
    fn ligament_sides(&self, at: &[Point], n: u32, away: Point) -> Option<[(f64, Point, u32, f64); 2]> {
        let (next, last) = (self.next[n as usize], self.last[n as usize]);
        let (onward, back) = (sub(at[next as usize], at[n as usize]), sub(at[last as usize], at[n as usize]));
        let lengths = [norm(onward), norm(back)];
        if lengths[0].min(lengths[1]) < POINTLIKE {
            return None;
        }
        let direction = away[1].atan2(away[0]);
        let mut first = (onward[1].atan2(onward[0]) - direction).rem_euclid(TAU);
        let mut second = (direction - back[1].atan2(back[0])).rem_euclid(TAU);
        if first + second > TAU {
            // The ligament runs through the unit: count the smaller excess as negative.
            if first > second { first -= TAU } else { second -= TAU }
        }
        Some([(first, swing(onward), next, lengths[0]), (second, scale(-1.0, swing(back)), last, lengths[1])])
    }

    fn ligament_rows(&self, at: &[Point], l: u32, window: f64, rows: &mut Vec<Row>) {
        let (na, nb, along) = self.ligaments[l as usize];
        let ends = (self.ligament_sides(at, na, along), self.ligament_sides(at, nb, scale(-1.0, along)));
        for (node, sides) in [(na, ends.0), (nb, ends.1)] {
            for (which, (angle, by_far, far, length)) in sides.into_iter().flatten().enumerate() {
                let value = length * (angle - self.limits.min_ligament_angle);
                if value < window {
                    let g = scale(length, by_far);
                    let key = Key { kind: RowKind::Ligament, at: [node, which as u32, 0] };
                    self.row(key, value, &[(far, g), (node, scale(-1.0, g))], rows);
                }
            }
        }
        if let (Some(a), Some(b)) = ends {
            for (node, one, other) in [(na, a[0], b[1]), (nb, b[0], a[1])] {
                let size = one.3.min(other.3);
                let value = size * (one.0 + other.0 - PI - self.limits.min_void_angle);
                if value < window {
                    let (g, k) = (scale(size, one.1), scale(size, other.1));
                    let key = Key { kind: RowKind::Void, at: [node, l, 0] };
                    let terms = [(one.2, g), (other.2, k), (node, [-g[0] - k[0], -g[1] - k[1]])];
                    self.row(key, value, &terms, rows);
                }
            }
        }
    }

    fn gap_rows(&self, at: &[Point], a: &Piece, b: &Piece, gap: f64, window: f64, rows: &mut Vec<Row>) {
        let (apart, normal, owner_first, edge) = separation(at, a, b);
        if apart - gap >= window {
            return;
        }
        if apart > 0.0 {
            for (corner_of, edge_of) in [(a, b), (b, a)] {
                for &n in &corner_of.nodes {
                    for (s, t) in edge_of.edges() {
                        self.side_row(at, n, s, t, gap, window, rows);
                    }
                }
            }
            return;
        }
        // Overlapping: separate along the edge normal of least overlap.
        let (edge_of, corner_of) = if owner_first { (a, b) } else { (b, a) };
        let (s, t) = edge;
        let reach =
            edge_of.nodes.iter().fold(f64::NEG_INFINITY, |m, &n| m.max(inner(normal, at[n as usize])));
        let along = sub(at[t as usize], at[s as usize]);
        for &n in &corner_of.nodes {
            let value = inner(normal, at[n as usize]) - reach - gap;
            if value < window {
                let part = (inner(sub(at[n as usize], at[s as usize]), along)
                    / inner(along, along).max(1e-18))
                .clamp(0.0, 1.0);
                let key = Key { kind: RowKind::Through, at: [n, s, t] };
                let g = [(n, normal), (s, scale(part - 1.0, normal)), (t, scale(-part, normal))];
                self.row(key, value, &g, rows);
            }
        }
    }

    /// Distance of corner n from the closest point of the edge from s to t.
    fn side_row(&self, at: &[Point], n: u32, s: u32, t: u32, gap: f64, window: f64, rows: &mut Vec<Row>) {
        let (corner, start) = (at[n as usize], at[s as usize]);
        let along = sub(at[t as usize], start);
        let square = inner(along, along);
        let part =
            if square > 0.0 { (inner(sub(corner, start), along) / square).clamp(0.0, 1.0) } else { 0.0 };
        let across = sub(sub(corner, start), scale(part, along));
        let distance = norm(across);
        if distance - gap >= window || distance < POINTLIKE {
            return;
        }
        let g = scale(1.0 / distance, across);
        if part == 0.0 || part == 1.0 {
            let m = if part == 0.0 { s } else { t };
            let key = Key { kind: RowKind::Corners, at: [n.min(m), n.max(m), 0] };
            self.row(key, distance - gap, &[(n, g), (m, scale(-1.0, g))], rows);
        } else {
            let key = Key { kind: RowKind::Side, at: [n, s, t] };
            self.row(key, distance - gap, &[(n, g), (s, scale(part - 1.0, g)), (t, scale(-part, g))], rows);
        }
    }
}

/// Greatest separation of two convex pieces along a normal of one of their edges (negative: they overlap), that normal (outward),
/// whether `a` owns the edge, and the edge.
fn separation(at: &[Point], a: &Piece, b: &Piece) -> (f64, Point, bool, (u32, u32)) {
    let mut best = (f64::NEG_INFINITY, [0.0; 2], true, (0, 0));
    for (owner, other, first) in [(a, b, true), (b, a, false)] {
        for (s, t) in owner.edges() {
            let along = sub(at[t as usize], at[s as usize]);
            let length = norm(along);
            if length < POINTLIKE {
                continue;
            }
            let normal = [along[1] / length, -along[0] / length];
            let mut directions =
                [normal, scale(-1.0, normal), scale(1.0 / length, along), scale(-1.0 / length, along)];
            let used = if owner.is_closed() { &mut directions[..1] } else { &mut directions[..] };
            for n in used {
                let far =
                    owner.nodes.iter().fold(f64::NEG_INFINITY, |m, &q| m.max(inner(*n, at[q as usize])));
                let near = other.nodes.iter().fold(f64::INFINITY, |m, &q| m.min(inner(*n, at[q as usize])));
                if near - far > best.0 {
                    best = (near - far, *n, first, (s, t));
                }
            }
        }
    }
    best
}
