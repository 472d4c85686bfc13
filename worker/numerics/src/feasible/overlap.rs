//! Overlaps and inverted units of designs without limits.
//!
//! ```text
//! |A ∩ B| = Σ s_i s_j |T_i ∩ T_j|      T_i: triangle of the origin and an edge of A, s_i its orientation
//! ```
//! In a unit whose edges cross, each part counts as often as the edges wind around it.

use crate::body::{Layout, edges, moments};

type Point = [f64; 2];

/// Numbers and areas of overlapping and inverted units.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Overlaps {
    /// Number of overlapping pairs of units.
    pub pairs: usize,
    /// Total area of the overlaps (mm²).
    pub area: f64,
    /// Number of inverted units: their nodes run clockwise.
    pub inverted: usize,
    /// Total area of the inverted units (mm²).
    pub inverted_area: f64,
}

impl std::fmt::Display for Overlaps {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { pairs, area, inverted, inverted_area } = self;
        write!(
            f,
            "{pairs} pairs of units overlap ({area:.3} mm²), {inverted} units are inverted ({inverted_area:.3} mm²)"
        )
    }
}

/// Smallest area that counts as an overlap (mm²).
const TOUCHING: f64 = 1e-9;

/// Overlaps of a design.
///
/// # Panics
/// If the design's length differs from the layout's.
pub fn overlaps(layout: &Layout, design: &[f64]) -> Overlaps {
    let units = layout.vertices(design);
    let mut found = Overlaps::default();
    for area in units.iter().map(|nodes| moments(nodes).area).filter(|area| *area < 0.0) {
        (found.inverted, found.inverted_area) = (found.inverted + 1, found.inverted_area - area);
    }
    let side = |nodes: &[Point], d: usize| {
        let of = |pick: fn(f64, f64) -> f64, from| nodes.iter().map(|q| q[d]).fold(from, pick);
        [of(f64::min, f64::INFINITY), of(f64::max, f64::NEG_INFINITY)]
    };
    let boxes: Vec<[[f64; 2]; 2]> = units.iter().map(|nodes| [side(nodes, 0), side(nodes, 1)]).collect();
    for (a, one) in units.iter().enumerate() {
        for (b, other) in units.iter().enumerate().skip(a + 1) {
            if (0..2).any(|d| boxes[a][d][0] > boxes[b][d][1] || boxes[b][d][0] > boxes[a][d][1]) {
                continue;
            }
            let area = shared(one, other);
            if area > TOUCHING {
                (found.pairs, found.area) = (found.pairs + 1, found.area + area);
            }
        }
    }
    found
}

/// |A ∩ B| of simple polygons of either orientation.
fn shared(one: &[Point], other: &[Point]) -> f64 {
    let origin = one[0];
    let fan = |nodes: &[Point]| -> Vec<(f64, [Point; 3])> {
        let triangle = |(p, s): (usize, usize)| {
            let [a, b] = [nodes[p], nodes[s]];
            let doubled = cross(origin, a, b);
            (doubled.signum(), if doubled < 0.0 { [origin, b, a] } else { [origin, a, b] }, doubled)
        };
        let some = edges(nodes.len()).map(triangle).filter(|(.., doubled)| *doubled != 0.0);
        some.map(|(sense, nodes, _)| (sense, nodes)).collect()
    };
    let (one, other) = (fan(one), fan(other));
    let pairs = one.iter().flat_map(|(s, a)| other.iter().map(move |(t, b)| s * t * clipped(a, b)));
    pairs.sum::<f64>().abs()
}

/// Twice the signed area of a triangle; positive if its points run counter-clockwise.
fn cross(a: Point, b: Point, c: Point) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Area of the intersection of two counter-clockwise triangles, by clipping along each edge.
fn clipped(triangle: &[Point; 3], by: &[Point; 3]) -> f64 {
    let mut left = triangle.to_vec();
    for (s, t) in edges(3) {
        let inside = |q: &Point| cross(by[s], by[t], *q);
        let mut next = Vec::with_capacity(left.len() + 1);
        for (p, q) in edges(left.len()) {
            let ([a, b], [u, v]) = ([left[p], left[q]], [inside(&left[p]), inside(&left[q])]);
            if u >= 0.0 {
                next.push(a);
            }
            if (u > 0.0 && v < 0.0) || (u < 0.0 && v > 0.0) {
                let part = u / (u - v);
                next.push([0, 1].map(|d| a[d] + part * (b[d] - a[d])));
            }
        }
        left = next;
        if left.len() < 3 {
            return 0.0;
        }
    }
    moments(&left).area.max(0.0)
}
