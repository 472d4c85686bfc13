//! The outline of a body with ligaments of some width: one outer loop, and a loop a void.
//!
//! Units are convex quadrilaterals joined corner to corner, so the outline follows from who is joined to whom: along an
//! edge of a unit counter-clockwise, at a corner with a ligament across on its near side, else round the corner. Every
//! loop has the body on its left: the outer one runs counter-clockwise, those of voids clockwise. Nothing is clipped.

use metasense_worker::replay::Drawing;

/// A point (mm).
pub type Point = [f64; 2];

/// Loops of corners, and the pieces that fill the body between them.
#[derive(Debug, Clone, PartialEq)]
pub struct Outline {
    /// All corners.
    pub points: Vec<Point>,
    /// Loops as indices of corners, the body on their left; the outer one first.
    pub loops: Vec<Vec<usize>>,
    /// Convex pieces that make up the body, counter-clockwise: units, then ligaments.
    pub pieces: Vec<Vec<usize>>,
}

/// Why there is no outline.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Invalid {
    /// Two ligaments, or a ligament and the far corner, meet on an edge.
    #[error(
        "ligaments {width} mm wide do not fit the edges of unit {unit}; make them narrower with --ligament-width"
    )]
    TooWide {
        /// Width (mm).
        width: f64,
        /// The unit.
        unit: usize,
    },
    /// The body is not one piece.
    #[error("the body falls apart into {0} pieces")]
    Apart(usize),
    /// The cavity runs into itself.
    #[error("a clearance of {0} mm closes a void of the body; choose less with --clearance")]
    Closed(f64),
}

fn sub(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

fn cross(a: Point, b: Point) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

fn unit_vector(a: Point) -> Point {
    let length = a[0].hypot(a[1]);
    [a[0] / length, a[1] / length]
}

/// Twice the area on the left.
pub fn doubled_area(points: &[Point], corners: &[usize]) -> f64 {
    let next = corners.iter().cycle().skip(1);
    corners.iter().zip(next).map(|(&a, &b)| cross(points[a], points[b])).sum()
}

impl Outline {
    /// The outline of a body whose ligaments are `width` mm wide.
    ///
    /// # Errors
    /// If the ligaments are too wide for the edges that they join, or the body is not connected.
    pub fn new(drawing: &Drawing, width: f64) -> Result<Self, Invalid> {
        let units = drawing.units.len();
        let mut joined: Vec<[Option<(usize, usize)>; 4]> = vec![[None; 4]; units];
        for &[(a, p), (b, q)] in &drawing.joints {
            joined[a][p] = Some((b, q));
            joined[b][q] = Some((a, p));
        }
        // Edge p of a unit runs from corner p to p + 1; each has a first and a last point of its own.
        let mut points = Vec::with_capacity(8 * units);
        for (unit, corners) in drawing.units.iter().enumerate() {
            for p in 0..4 {
                let (from, to) = (corners[p], corners[(p + 1) % 4]);
                let along = unit_vector(sub(to, from));
                let length = along[0] * (to[0] - from[0]) + along[1] * (to[1] - from[1]);
                // How far from a corner the ligament's side leaves the edge.
                let reach = |corner: usize, edge: Point| -> Option<f64> {
                    let Some((v, q)) = joined[unit][corner] else { return Some(0.0) };
                    let axis = unit_vector(sub(drawing.units[v][q], corners[corner]));
                    let sine = cross(axis, edge).abs();
                    (sine > 1e-3).then(|| 0.5 * width / sine)
                };
                let (Some(first), Some(last)) = (reach(p, along), reach((p + 1) % 4, [-along[0], -along[1]]))
                else {
                    return Err(Invalid::TooWide { width, unit });
                };
                if first + last >= length {
                    return Err(Invalid::TooWide { width, unit });
                }
                points.push([from[0] + first * along[0], from[1] + first * along[1]]);
                points.push([to[0] - last * along[0], to[1] - last * along[1]]);
            }
        }
        let first = |unit: usize, p: usize| 2 * (4 * unit + p);
        let last = |unit: usize, p: usize| first(unit, p) + 1;
        // A corner without ligament is one point, known by the edge that begins there.
        let ends = |unit: usize, p: usize| match joined[unit][(p + 1) % 4] {
            Some(_) => vec![first(unit, p), last(unit, p)],
            None => vec![first(unit, p)],
        };
        let mut seen = vec![false; 4 * units];
        let mut loops = Vec::new();
        for start in 0..4 * units {
            let mut edge = start;
            let mut corners = Vec::new();
            while !seen[edge] {
                seen[edge] = true;
                let (unit, p) = (edge / 4, edge % 4);
                corners.extend(ends(unit, p));
                let (unit, p) = joined[unit][(p + 1) % 4].unwrap_or((unit, (p + 1) % 4));
                edge = 4 * unit + p;
            }
            if !corners.is_empty() {
                loops.push(corners);
            }
        }
        let outer = loops.iter().filter(|l| doubled_area(&points, l) > 0.0).count();
        if outer != 1 {
            return Err(Invalid::Apart(outer));
        }
        loops.sort_by(|a, b| doubled_area(&points, b).total_cmp(&doubled_area(&points, a)));
        let mut pieces: Vec<Vec<usize>> =
            (0..units).map(|u| (0..4).flat_map(|p| ends(u, p)).collect()).collect();
        for &[(a, p), (b, q)] in &drawing.joints {
            // Round a ligament: along a's edge's end, to b, back.
            pieces.push(vec![last(a, (p + 3) % 4), first(b, q), last(b, (q + 3) % 4), first(a, p)]);
        }
        Ok(Self { points, loops, pieces })
    }

    /// With every side moved outward by `clearance` (mm), corners mitred.
    ///
    /// # Errors
    /// If a void closes.
    pub fn grown(&self, clearance: f64) -> Result<Self, Invalid> {
        let mut grown = self.clone();
        for corners in &self.loops {
            let n = corners.len();
            for i in 0..n {
                let [before, here, after] =
                    [(i + n - 1) % n, i, (i + 1) % n].map(|j| self.points[corners[j]]);
                let (a, b) = (unit_vector(sub(here, before)), unit_vector(sub(after, here)));
                // Outward is to the right. The mitre: move by c along both normals at once.
                let (na, nb) = ([a[1], -a[0]], [b[1], -b[0]]);
                let scale = clearance / (1.0 + na[0] * nb[0] + na[1] * nb[1]).max(1e-6);
                grown.points[corners[i]] =
                    [here[0] + scale * (na[0] + nb[0]), here[1] + scale * (na[1] + nb[1])];
            }
        }
        let kept = |l: &Vec<usize>| {
            let (before, after) = (doubled_area(&self.points, l), doubled_area(&grown.points, l));
            before * after > 0.0 && is_simple(&grown.points, l)
        };
        if self.loops.iter().all(kept) { Ok(grown) } else { Err(Invalid::Closed(clearance)) }
    }
}

/// Whether no two sides of a loop that are not neighbours cross.
fn is_simple(points: &[Point], corners: &[usize]) -> bool {
    let n = corners.len();
    let side = |i: usize| (points[corners[i % n]], points[corners[(i + 1) % n]]);
    let crosses = |(a, b): (Point, Point), (c, d): (Point, Point)| {
        let turn = |p, q, r| cross(sub(q, p), sub(r, p));
        turn(a, b, c) * turn(a, b, d) < 0.0 && turn(c, d, a) * turn(c, d, b) < 0.0
    };
    (0..n).all(|i| (i + 2..n).filter(|&j| !(i == 0 && j == n - 1)).all(|j| !crosses(side(i), side(j))))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// 3 × 3 rotated squares of 20°, pitch 15 mm, ligaments 2.25 mm long.
    pub fn squares() -> Drawing {
        let (n, pitch, half) = (3usize, 15.0, 6.375);
        let mut units = Vec::new();
        let mut joints = Vec::new();
        for j in 0..n {
            for i in 0..n {
                let angle = 20f64.to_radians() * if (i + j) % 2 == 0 { 1.0 } else { -1.0 };
                units.push(std::array::from_fn(|p| {
                    let turn = angle + p as f64 * std::f64::consts::FRAC_PI_2;
                    let radius = half / angle.cos();
                    [i as f64 * pitch + radius * turn.cos(), j as f64 * pitch + radius * turn.sin()]
                }));
                if i + 1 < n {
                    joints.push([(j * n + i, 0), (j * n + i + 1, 2)]);
                }
                if j + 1 < n {
                    joints.push([(j * n + i, 1), (j * n + n + i, 3)]);
                }
            }
        }
        let corner = |(u, p): (usize, usize)| -> Point {
            let unit: &[Point; 4] = &units[u];
            unit[p]
        };
        let ligaments = joints.iter().map(|&[a, b]| [corner(a), corner(b)]).collect();
        let centroids = (0..n * n).map(|u| [(u % n) as f64 * pitch, (u / n) as f64 * pitch]).collect();
        Drawing {
            ligaments,
            joints,
            centroids,
            panels: vec![(7, [0.0, -1.0])],
            sensors: vec![4],
            clamped: vec![0, 1, 2],
            active: vec![],
            spacing: pitch,
            clock: vec![],
            units,
        }
    }

    /// Four voids in nine units; the loops' areas are those of units and ligaments, less what these overlap.
    #[test]
    fn the_outline_is_one_outer_loop_and_a_loop_a_void() {
        let drawing = squares();
        let outline = Outline::new(&drawing, 1.0).unwrap();
        assert_eq!(outline.loops.len(), 5);
        let loops: f64 = outline.loops.iter().map(|l| 0.5 * doubled_area(&outline.points, l)).sum();
        let pieces: f64 = outline.pieces.iter().map(|l| 0.5 * doubled_area(&outline.points, l)).sum();
        let unit = 2.0 * (6.375 / 20f64.to_radians().cos()).powi(2);
        assert!((loops - pieces).abs() < 1e-9, "{loops} {pieces}");
        assert!(loops > 9.0 * unit && loops < 9.0 * unit + 12.0 * 3.25, "{loops}, units {}", 9.0 * unit);
    }

    #[test]
    fn growing_moves_every_side_outward() {
        let outline = Outline::new(&squares(), 1.0).unwrap();
        let grown = outline.grown(0.1).unwrap();
        for (before, after) in outline.loops.iter().zip(&grown.loops) {
            let (a, b) = (doubled_area(&outline.points, before), doubled_area(&grown.points, after));
            assert!(b > a, "{a} {b}");
        }
        assert_eq!(outline.grown(5.0), Err(Invalid::Closed(5.0)));
    }

    #[test]
    fn ligaments_wider_than_the_edges_are_refused() {
        assert!(matches!(Outline::new(&squares(), 9.0), Err(Invalid::TooWide { .. })));
    }
}
