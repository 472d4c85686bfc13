//! The mould in which a body is cast, as a closed surface (binary STL, mm).
//!
//! A plate with a cavity of the body's shape: floor `wall` thick, cavity `height` deep, `wall` around it. The surface consists of
//! the rectangle below, four sides, the face with the cavity cut out, and the cavity's sides and bottom. From the bottom rise a
//! block per chip pocket and a pin per screw hole. All share the outline's corners, so that the surface closes by construction;
//! this is also checked.

use std::collections::HashMap;

use i_triangle::i_overlay::i_shape::int::shape::IntShape;
use i_triangle::int::unchecked::IntUncheckedTriangulatable;

use super::outline::{GridPoint, Mould, Outline};

/// A triangle of corners (mm).
type Triangle = [[f64; 3]; 3];

/// The mould with this cavity, which has the same lengths.
pub fn stl(cavity: &Outline, mould: &Mould) -> Vec<u8> {
    let triangles = surface(cavity, mould);
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
    bytes
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn surface(cavity: &Outline, mould: &Mould) -> Vec<Triangle> {
    let (floor, face) = (mould.wall, mould.wall + mould.height);
    let at = |p: GridPoint, z: f64| {
        let [x, y] = cavity.mm(p);
        [x, y, z]
    };
    let mut triangles = Vec::new();
    let outer = &cavity.loops[0];
    let rim = (mould.wall / cavity.pitch).ceil() as i32;
    let (xs, ys) = (|| outer.iter().map(|p| p.x), || outer.iter().map(|p| p.y));
    let (left, right) = (xs().min().unwrap_or(0) - rim, xs().max().unwrap_or(0) + rim);
    let (low, high) = (ys().min().unwrap_or(0) - rim, ys().max().unwrap_or(0) + rim);
    let rectangle = vec![
        GridPoint::new(left, low),
        GridPoint::new(right, low),
        GridPoint::new(right, high),
        GridPoint::new(left, high),
    ];
    // Bottom and sides.
    for corners in [[0, 2, 1], [0, 3, 2]] {
        triangles.push(corners.map(|i: usize| at(rectangle[i], 0.0)));
    }
    // A vertical rectangle over the side from a to b, seen from its right.
    let wall = |triangles: &mut Vec<Triangle>, a: GridPoint, b: GridPoint, [z, top]: [f64; 2]| {
        triangles.push([at(a, z), at(b, z), at(b, top)]);
        triangles.push([at(a, z), at(b, top), at(a, top)]);
    };
    for i in 0..4 {
        wall(&mut triangles, rectangle[i], rectangle[(i + 1) % 4], [0.0, face]);
    }
    // The cavity: sides face inward, the bottom upward.
    for corners in &cavity.loops {
        for (i, &a) in corners.iter().enumerate() {
            wall(&mut triangles, corners[(i + 1) % corners.len()], a, [floor, face]);
        }
    }
    // The bottom with its inserts, and the face: islands of voids, and the rectangle around the outer loop.
    let reversed = |corners: &[GridPoint]| corners.iter().rev().copied().collect::<Vec<_>>();
    let block = floor + mould.pocket.map_or(0.0, |pocket| pocket[2]);
    let pockets = cavity.pockets.iter().map(|corners| (corners, block));
    let inserts: Vec<_> = pockets.chain(cavity.holes.iter().map(|corners| (corners, face))).collect();
    for &(corners, top) in &inserts {
        for (i, &a) in corners.iter().enumerate() {
            wall(&mut triangles, a, corners[(i + 1) % corners.len()], [floor, top]);
        }
        triangles.extend(filled(&vec![corners.clone()]).map(|t| t.map(|p| at(p, top))));
    }
    let bottom = cavity.loops.iter().cloned().chain(inserts.iter().map(|(corners, _)| reversed(corners)));
    triangles.extend(filled(&bottom.collect()).map(|t| t.map(|p| at(p, floor))));
    for void in &cavity.loops[1..] {
        triangles.extend(filled(&vec![reversed(void)]).map(|t| t.map(|p| at(p, face))));
    }
    triangles.extend(filled(&vec![rectangle, reversed(outer)]).map(|t| t.map(|p| at(p, face))));
    triangles
}

/// Triangulates a polygon with holes over its own corners.
fn filled(polygon: &IntShape<i32>) -> impl Iterator<Item = [GridPoint; 3]> + use<> {
    let mesh = polygon.uncheck_triangulate().into_delaunay().into_triangulation::<u32>();
    mesh.triangles().collect::<Vec<_>>().into_iter()
}

/// Whether every edge occurs as often in either direction.
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

#[cfg(test)]
mod tests;
