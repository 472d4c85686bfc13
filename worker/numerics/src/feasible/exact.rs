//! The exact check: which constraints a design violates, by simple polygon tests on its vertices.
//!
//! It shares no code with the projection and has no linearisation, no cut-off and no margin. Distances are those of segments (0
//! if they cross or one polygon contains the other); angles come from `atan2`.

#![allow(clippy::neg_cmp_op_on_partial_ord, reason = "a NaN must break a limit, not pass it")]

use super::Limits;
use crate::body::{Layout, edges};
use std::borrow::Cow;
use std::f64::consts::{PI, TAU};
use std::fmt;

type Point = [f64; 2];

/// Kinds of violated constraints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ViolationKind {
    /// A coordinate is NaN or infinite.
    NotFinite,
    /// The edges of a unit cross, or the unit is inverted.
    NotSimple,
    /// An edge of a unit is too short (mm).
    Edge,
    /// An interior angle is too small (rad).
    BlockAngleLow,
    /// An interior angle is too large (rad).
    BlockAngleHigh,
    /// The angle between a ligament and an edge of its unit is too small (rad); negative if the ligament runs through the unit.
    LigamentAngle,
    /// A void angle is too small (rad).
    VoidAngle,
    /// Two units overlap.
    Overlap,
    /// Two units are too close (mm).
    Clearance,
    /// A ligament is too close to a unit that it does not join, or to another ligament (mm).
    LigamentClearance,
}

impl ViolationKind {
    /// Name in commands.
    pub fn name(self) -> &'static str {
        match self {
            ViolationKind::NotFinite => "not finite",
            ViolationKind::NotSimple => "not simple",
            ViolationKind::Edge => "edge",
            ViolationKind::BlockAngleLow => "least interior angle",
            ViolationKind::BlockAngleHigh => "greatest interior angle",
            ViolationKind::LigamentAngle => "ligament angle",
            ViolationKind::VoidAngle => "void angle",
            ViolationKind::Overlap => "overlap",
            ViolationKind::Clearance => "clearance",
            ViolationKind::LigamentClearance => "ligament clearance",
        }
    }
}

/// A constraint that a design violates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Violation {
    /// Kind of constraint.
    pub kind: ViolationKind,
    /// The units; equal if only one is concerned. For a ligament, the unit of its first end.
    pub units: [usize; 2],
    /// Node of the first unit, if the constraint belongs to a node or to the edge that starts there.
    pub node: Option<usize>,
    /// Value (mm or rad).
    pub value: f64,
    /// Limit (mm or rad).
    pub limit: f64,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b] = self.units;
        let node = self.node.unwrap_or(0);
        let (value, limit) = (self.value, self.limit);
        let (angle, bound) = (value.to_degrees(), limit.to_degrees());
        match self.kind {
            ViolationKind::NotFinite => write!(f, "unit {a}, node {node}: a coordinate is not finite"),
            ViolationKind::NotSimple => write!(f, "unit {a}: its edges cross, or it is inverted"),
            ViolationKind::Edge => write!(f, "unit {a}, edge from node {node}: {value:.4} mm < {limit} mm"),
            ViolationKind::BlockAngleLow => {
                write!(f, "unit {a}, node {node}: interior angle {angle:.3}° < {bound:.3}°")
            }
            ViolationKind::BlockAngleHigh => {
                write!(f, "unit {a}, node {node}: interior angle {angle:.3}° > {bound:.3}°")
            }
            ViolationKind::LigamentAngle => {
                write!(f, "unit {a}, node {node}: {angle:.3}° between edge and ligament < {bound:.3}°")
            }
            ViolationKind::VoidAngle => {
                write!(f, "units {a} and {b}, node {node} of {a}: void angle {angle:.3}° < {bound:.3}°")
            }
            ViolationKind::Overlap => write!(f, "units {a} and {b} overlap"),
            ViolationKind::Clearance => write!(f, "units {a} and {b}: {value:.4} mm apart < {limit} mm"),
            ViolationKind::LigamentClearance => {
                write!(f, "ligament at unit {a}, node {node}, and unit {b}: {value:.4} mm apart < {limit} mm")
            }
        }
    }
}

/// Every constraint that `design` violates, sorted by unit; empty if the design is feasible.
///
/// # Panics
/// If the design's length differs from the layout's.
pub fn violations(layout: &Layout, limits: &Limits, design: &[f64]) -> Vec<Violation> {
    assert_eq!(design.len(), layout.design_len(), "length of the design");
    let units = layout.vertices(design);
    let mut found = Vec::new();
    for (u, corners) in units.iter().enumerate() {
        for (p, corner) in corners.iter().enumerate() {
            if !(corner[0].is_finite() && corner[1].is_finite()) {
                found.push(broken(ViolationKind::NotFinite, [u, u], Some(p), f64::NAN, 0.0));
            }
        }
    }
    if found.is_empty() && limits.enforced {
        for (u, corners) in units.iter().enumerate() {
            judge_unit(u, corners, limits, layout.rigid[u], &mut found);
        }
        judge_ligaments(layout, &units, limits, &mut found);
        judge_distances(layout, &units, limits, &mut found);
        found.sort_by_key(|v| (v.units, v.kind, v.node));
    }
    found
}

fn broken(kind: ViolationKind, units: [usize; 2], node: Option<usize>, value: f64, limit: f64) -> Violation {
    Violation { kind, units, node, value, limit }
}

fn minus(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

fn cross(a: Point, b: Point) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// Angle from a to b, counter-clockwise, in [0, 2π).
fn turn(a: Point, b: Point) -> f64 {
    let angle = cross(a, b).atan2(dot(a, b));
    if angle < 0.0 { angle + TAU } else { angle }
}

fn judge_unit(u: usize, corners: &[Point], limits: &Limits, rigid: bool, found: &mut Vec<Violation>) {
    let count = corners.len();
    let edge = |p: usize| [corners[p], corners[(p + 1) % count]];
    let apart = |p: usize, q: usize| q - p > 1 && q - p < count - 1;
    let crossing = (0..count).any(|p| {
        (p + 1..count).filter(|&q| apart(p, q)).any(|q| {
            let ([a, b], [c, d]) = (edge(p), edge(q));
            segments_cross(a, b, c, d)
        })
    });
    let fan = |p: usize| cross(minus(corners[p], corners[0]), minus(corners[p + 1], corners[0]));
    let area: f64 = (1..count - 1).map(fan).sum();
    if crossing || !(area > 0.0) {
        found.push(broken(ViolationKind::NotSimple, [u, u], None, area, 0.0));
    }
    if rigid {
        return;
    }
    for p in 0..count {
        let onward = minus(corners[(p + 1) % count], corners[p]);
        let back = minus(corners[(p + count - 1) % count], corners[p]);
        let edge = onward[0].hypot(onward[1]);
        if !(edge >= limits.min_edge) {
            found.push(broken(ViolationKind::Edge, [u, u], Some(p), edge, limits.min_edge));
        }
        let angle = turn(onward, back);
        if !(angle >= limits.min_block_angle) {
            found.push(broken(ViolationKind::BlockAngleLow, [u, u], Some(p), angle, limits.min_block_angle));
        }
        if !(angle <= limits.max_block_angle) {
            found.push(broken(ViolationKind::BlockAngleHigh, [u, u], Some(p), angle, limits.max_block_angle));
        }
    }
}

/// Angles between a ligament that leaves node p along `away` and the edges to the next and previous node, each measured through
/// the void; negative if the ligament runs through the unit.
fn beside_ligament(corners: &[Point], p: usize, away: Point) -> [f64; 2] {
    let count = corners.len();
    let next = turn(away, minus(corners[(p + 1) % count], corners[p]));
    let previous = turn(minus(corners[(p + count - 1) % count], corners[p]), away);
    if next + previous <= TAU {
        [next, previous]
    } else if next > previous {
        [next - TAU, previous]
    } else {
        [next, previous - TAU]
    }
}

fn judge_ligaments(layout: &Layout, units: &[Vec<Point>], limits: &Limits, found: &mut Vec<Violation>) {
    for ligament in &layout.ligaments {
        let (a, b) = (&ligament.a, &ligament.b);
        let along = ligament.reference;
        let at_a = beside_ligament(&units[a.unit], a.node, along);
        let at_b = beside_ligament(&units[b.unit], b.node, [-along[0], -along[1]]);
        let least = limits.min_ligament_angle;
        for (units, node, angles) in [([a.unit, b.unit], a.node, at_a), ([b.unit, a.unit], b.node, at_b)] {
            for angle in angles.into_iter().filter(|angle| !(*angle >= least)) {
                found.push(broken(ViolationKind::LigamentAngle, units, Some(node), angle, least));
            }
        }
        // A void lies between the next edge of one end and the previous edge of the other.
        for (units, node, angle) in [
            ([a.unit, b.unit], a.node, at_a[0] + at_b[1] - PI),
            ([b.unit, a.unit], b.node, at_b[0] + at_a[1] - PI),
        ] {
            if !(angle >= limits.min_void_angle) {
                found.push(broken(ViolationKind::VoidAngle, units, Some(node), angle, limits.min_void_angle));
            }
        }
    }
}

/// A unit or a ligament, for checks of distances.
struct Piece<'a> {
    corners: Cow<'a, [Point]>,
    least: Point,
    most: Point,
    /// The unit twice, or the ligament's two units.
    units: [usize; 2],
    /// First node of a ligament; `None` for a unit.
    node: Option<usize>,
}

impl<'a> Piece<'a> {
    fn new(points: Cow<'a, [Point]>, units: [usize; 2], node: Option<usize>) -> Self {
        let end = |axis: usize, pick: fn(f64, f64) -> f64| {
            points.iter().map(|q| q[axis]).reduce(pick).unwrap_or(0.0)
        };
        Self {
            least: [end(0, f64::min), end(1, f64::min)],
            most: [end(0, f64::max), end(1, f64::max)],
            corners: points,
            units,
            node,
        }
    }

    fn edges(&self) -> impl Iterator<Item = (Point, Point)> + '_ {
        let count = if self.node.is_none() { self.corners.len() } else { 1 };
        edges(self.corners.len()).take(count).map(|(p, s)| (self.corners[p], self.corners[s]))
    }

    /// Whether the winding number about a point is not zero.
    fn holds(&self, point: Point) -> bool {
        let mut winding = 0;
        for (from, to) in self.edges() {
            let side = cross(minus(to, from), minus(point, from));
            if from[1] <= point[1] && to[1] > point[1] && side > 0.0 {
                winding += 1;
            } else if from[1] > point[1] && to[1] <= point[1] && side < 0.0 {
                winding -= 1;
            }
        }
        self.node.is_none() && winding != 0
    }
}

fn judge_distances(layout: &Layout, units: &[Vec<Point>], limits: &Limits, found: &mut Vec<Violation>) {
    let mut pieces: Vec<Piece> = units
        .iter()
        .enumerate()
        .map(|(u, corners)| Piece::new(Cow::Borrowed(corners), [u, u], None))
        .collect();
    for ligament in &layout.ligaments {
        let (a, b) = (&ligament.a, &ligament.b);
        let bar = [units[a.unit][a.node], units[b.unit][b.node]];
        pieces.push(Piece::new(Cow::Owned(bar.to_vec()), [a.unit, b.unit], Some(a.node)));
    }
    let reach = limits.clearance.max(limits.ligament_clearance).max(0.0);
    pieces.sort_by(|p, q| p.least[0].total_cmp(&q.least[0]));
    for (i, one) in pieces.iter().enumerate() {
        for other in &pieces[i + 1..] {
            if other.least[0] > one.most[0] + reach {
                break;
            }
            if other.least[1] <= one.most[1] + reach && one.least[1] <= other.most[1] + reach {
                judge_pair(one, other, limits, found);
            }
        }
    }
}

fn judge_pair(one: &Piece, other: &Piece, limits: &Limits, found: &mut Vec<Violation>) {
    let units_only = one.node.is_none() && other.node.is_none();
    let limit = if units_only { limits.clearance } else { limits.ligament_clearance };
    if one.node.is_none() != other.node.is_none() {
        // Angle limits keep a ligament clear of the units that it joins.
        let (unit, bar) = if one.node.is_none() { (one, other) } else { (other, one) };
        if bar.units.contains(&unit.units[0]) {
            return;
        }
    }
    let inside = other.corners.iter().any(|q| one.holds(*q)) || one.corners.iter().any(|q| other.holds(*q));
    let mut distance = if inside { 0.0 } else { f64::INFINITY };
    for (a0, a1) in one.edges() {
        for (b0, b1) in other.edges() {
            distance = distance.min(segment_distance(a0, a1, b0, b1));
        }
    }
    if distance > 0.0 && distance >= limit {
        return;
    }
    if units_only {
        let kind = if distance > 0.0 { ViolationKind::Clearance } else { ViolationKind::Overlap };
        let (a, b) = (one.units[0].min(other.units[0]), one.units[0].max(other.units[0]));
        found.push(broken(kind, [a, b], None, distance, limit));
    } else {
        let (bar, thing) = match (one.node, other.node) {
            (Some(n), Some(m)) if (one.units[0], n) > (other.units[0], m) => (other, one),
            (Some(_), _) => (one, other),
            _ => (other, one),
        };
        let units = [bar.units[0], thing.units[0]];
        found.push(broken(ViolationKind::LigamentClearance, units, bar.node, distance, limit));
    }
}

/// Whether two segments have a common point.
fn segments_cross(a0: Point, a1: Point, b0: Point, b1: Point) -> bool {
    let side = |p: Point, q: Point, r: Point| {
        cross(minus(q, p), minus(r, p)).partial_cmp(&0.0).map_or(0, |order| order as i32)
    };
    let within =
        |p: Point, q: Point, r: Point| (0..2).all(|c| r[c] >= p[c].min(q[c]) && r[c] <= p[c].max(q[c]));
    let (s1, s2, s3, s4) = (side(a0, a1, b0), side(a0, a1, b1), side(b0, b1, a0), side(b0, b1, a1));
    (s1 * s2 < 0 && s3 * s4 < 0)
        || (s1 == 0 && within(a0, a1, b0))
        || (s2 == 0 && within(a0, a1, b1))
        || (s3 == 0 && within(b0, b1, a0))
        || (s4 == 0 && within(b0, b1, a1))
}

fn point_distance(p: Point, s0: Point, s1: Point) -> f64 {
    let along = minus(s1, s0);
    let length = dot(along, along);
    let part = if length > 0.0 { (dot(minus(p, s0), along) / length).clamp(0.0, 1.0) } else { 0.0 };
    let away = [p[0] - s0[0] - part * along[0], p[1] - s0[1] - part * along[1]];
    dot(away, away).sqrt()
}

fn segment_distance(a0: Point, a1: Point, b0: Point, b1: Point) -> f64 {
    if segments_cross(a0, a1, b0, b1) {
        return 0.0;
    }
    point_distance(a0, b0, b1)
        .min(point_distance(a1, b0, b1))
        .min(point_distance(b0, a0, a1))
        .min(point_distance(b1, a0, a1))
}
