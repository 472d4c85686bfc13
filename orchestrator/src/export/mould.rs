//! The mould in which a body is cast, as a closed surface (binary STL, mm).
//!
//! A plate with the body's shape sunk into it: floor `wall` thick, cavity `height` deep, `wall` around it. The surface
//! is the rectangle below, its four sides, the plate's face with the cavity cut out, the cavity's sides, its bottom. All
//! share the outline's corners, so that the surface closes by construction; it is checked nevertheless.

use std::collections::HashMap;

use super::outline::{Invalid, Outline, Point, doubled_area};

/// Measures of a mould (mm).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mould {
    /// Depth of the cavity: height of the body.
    pub height: f64,
    /// Thickness of floor and rim.
    pub wall: f64,
    /// How much the cavity is larger than the body on every side.
    pub clearance: f64,
}

/// A triangle of corners.
type Triangle = [[f64; 3]; 3];

/// The mould of a body.
///
/// # Errors
/// If the clearance closes a void.
pub fn stl(outline: &Outline, mould: &Mould) -> Result<Vec<u8>, Invalid> {
    let triangles = surface(&outline.grown(mould.clearance)?, mould);
    assert!(is_closed(&triangles), "a mould's surface that is not closed");
    let mut bytes = Vec::with_capacity(84 + 50 * triangles.len());
    bytes.extend([b' '; 80]);
    bytes.extend((triangles.len() as u32).to_le_bytes());
    for [a, b, c] in triangles {
        let (u, v) = (minus(b, a), minus(c, a));
        let normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        let length = normal.iter().map(|x| x * x).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
        for x in normal.map(|x| x / length).into_iter().chain(a).chain(b).chain(c) {
            bytes.extend((x as f32).to_le_bytes());
        }
        bytes.extend([0; 2]);
    }
    Ok(bytes)
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn surface(cavity: &Outline, mould: &Mould) -> Vec<Triangle> {
    let (floor, face) = (mould.wall, mould.wall + mould.height);
    let mut triangles = Vec::new();
    let at = |[x, y]: Point, z: f64| [x, y, z];
    let outer = &cavity.loops[0];
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for &i in outer {
        for k in 0..2 {
            low[k] = low[k].min(cavity.points[i][k] - mould.wall);
            high[k] = high[k].max(cavity.points[i][k] + mould.wall);
        }
    }
    let rectangle = [low, [high[0], low[1]], high, [low[0], high[1]]];
    // Below and around.
    for [a, b, c] in [[0, 2, 1], [0, 3, 2]] {
        triangles.push([a, b, c].map(|i: usize| at(rectangle[i], 0.0)));
    }
    for i in 0..4 {
        wall(&mut triangles, rectangle[i], rectangle[(i + 1) % 4], 0.0, face);
    }
    // The cavity: its sides look inward, its bottom upward.
    for corners in &cavity.loops {
        for (i, &a) in corners.iter().enumerate() {
            let b = corners[(i + 1) % corners.len()];
            wall(&mut triangles, cavity.points[b], cavity.points[a], floor, face);
        }
    }
    for piece in &cavity.pieces {
        for i in 1..piece.len() - 1 {
            triangles.push([piece[0], piece[i], piece[i + 1]].map(|i| at(cavity.points[i], floor)));
        }
    }
    // The face: the voids' islands, and the rectangle around the outer loop.
    for corners in &cavity.loops[1..] {
        let island: Vec<Point> = corners.iter().rev().map(|&i| cavity.points[i]).collect();
        triangles.extend(clip_ears(&island).into_iter().map(|t| t.map(|p| at(p, face))));
    }
    let frame = bridged(&rectangle, outer, &cavity.points);
    triangles.extend(clip_ears(&frame).into_iter().map(|t| t.map(|p| at(p, face))));
    triangles
}

/// A vertical rectangle over the side from a to b, seen from its right.
fn wall(triangles: &mut Vec<Triangle>, a: Point, b: Point, low: f64, high: f64) {
    let corner = |[x, y]: Point, z| [x, y, z];
    triangles.push([corner(a, low), corner(b, low), corner(b, high)]);
    triangles.push([corner(a, low), corner(b, high), corner(a, high)]);
}

/// The rectangle with the loop as a hole, joined by a cut from the rectangle's lower left corner to the loop's point
/// that is nearest to it.
fn bridged(rectangle: &[Point; 4], outer: &[usize], points: &[Point]) -> Vec<Point> {
    let far = |i: usize| {
        let p = points[outer[i]];
        (p[0] - rectangle[0][0]).hypot(p[1] - rectangle[0][1])
    };
    let near = (0..outer.len()).min_by(|a, b| far(*a).total_cmp(&far(*b))).expect("a loop has corners");
    let n = outer.len();
    let mut polygon = rectangle.to_vec();
    polygon.push(rectangle[0]);
    // The hole runs clockwise, back to where it began.
    polygon.extend((0..=n).map(|i| points[outer[(near + n - i) % n]]));
    polygon
}

/// A simple polygon (counter-clockwise, touching itself at most along a cut) as triangles over its own corners.
fn clip_ears(polygon: &[Point]) -> Vec<[Point; 3]> {
    let mut rest: Vec<Point> = polygon.to_vec();
    let mut triangles = Vec::new();
    let turn = |a: Point, b: Point, c: Point| (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    while rest.len() > 3 {
        let n = rest.len();
        let ear = |i: usize, least: f64| {
            let [a, b, c] = [(i + n - 1) % n, i, (i + 1) % n].map(|j| rest[j]);
            turn(a, b, c) > least
                && rest.iter().all(|&p| {
                    p == a
                        || p == b
                        || p == c
                        || turn(a, b, p) < 0.0
                        || turn(b, c, p) < 0.0
                        || turn(c, a, p) < 0.0
                })
        };
        // The roundest ear first keeps slivers few; a flat one is clipped where nothing else is left.
        let size = |i: usize| turn(rest[(i + n - 1) % n], rest[i], rest[(i + 1) % n]);
        let i = (0..n)
            .filter(|&i| ear(i, 0.0))
            .max_by(|a, b| size(*a).total_cmp(&size(*b)))
            .or_else(|| (0..n).min_by(|a, b| size(*a).abs().total_cmp(&size(*b).abs())))
            .expect("more than three corners are left");
        triangles.push([rest[(i + n - 1) % n], rest[i], rest[(i + 1) % n]]);
        rest.remove(i);
    }
    triangles.push([rest[0], rest[1], rest[2]]);
    triangles
}

/// Whether every edge of a triangle is met by the same edge the other way, as often.
fn is_closed(triangles: &[Triangle]) -> bool {
    let mut edges: HashMap<[[u64; 3]; 2], i64> = HashMap::new();
    let key = |p: [f64; 3]| p.map(f64::to_bits);
    for t in triangles {
        for i in 0..3 {
            let (a, b) = (key(t[i]), key(t[(i + 1) % 3]));
            if a == b {
                return false;
            }
            let (edge, way) = if a < b { ([a, b], 1) } else { ([b, a], -1) };
            *edges.entry(edge).or_default() += way;
        }
    }
    edges.values().all(|balance| *balance == 0)
}

/// Volume of the cavity (mm³): what has to be poured.
#[must_use]
pub fn poured(outline: &Outline, mould: &Mould) -> f64 {
    let area: f64 = outline.loops.iter().map(|l| 0.5 * doubled_area(&outline.points, l)).sum();
    area * mould.height
}

#[cfg(test)]
mod tests {
    use super::super::outline::tests::squares;
    use super::*;

    /// Closed, and its volume is that of the plate less that of the cavity.
    #[test]
    fn the_mould_is_closed_and_has_its_volume() {
        let outline = Outline::new(&squares(), 1.0).unwrap();
        for clearance in [0.0, 0.15] {
            let mould = Mould { height: 10.0, wall: 3.0, clearance };
            let cavity = outline.grown(clearance).unwrap();
            let triangles = surface(&cavity, &mould);
            assert!(is_closed(&triangles));
            let volume: f64 = triangles
                .iter()
                .map(|[a, b, c]| {
                    let n = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
                    (a[0] * n[0] + a[1] * n[1] + a[2] * n[2]) / 6.0
                })
                .sum();
            let size = |k: usize| {
                let all = || cavity.loops[0].iter().map(|&i| cavity.points[i][k]);
                all().fold(f64::NEG_INFINITY, f64::max) - all().fold(f64::INFINITY, f64::min) + 6.0
            };
            let plate = size(0) * size(1) * 13.0;
            let expected = plate - poured(&cavity, &mould);
            assert!((volume / expected - 1.0).abs() < 1e-9, "{volume} {expected}");
        }
    }

    #[test]
    fn a_surface_with_a_hole_is_not_closed() {
        let outline = Outline::new(&squares(), 1.0).unwrap();
        let mut triangles = surface(&outline, &Mould { height: 10.0, wall: 3.0, clearance: 0.0 });
        triangles.pop();
        assert!(!is_closed(&triangles));
    }
}
