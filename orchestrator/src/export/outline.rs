//! The outline of a body with ligaments of some width: one outer loop, and one loop per void.
//!
//! A body is the union of its units and of strips along its ligaments. A strip contains all points within half its width of the
//! ligament. It merges with edges and other strips, and leaves no notch at corners. The region within a clearance of the body is a
//! union of such strips around edges. Coordinates are integers, so that rounding cannot break loops.

use i_triangle::i_overlay::core::fill_rule::FillRule;
use i_triangle::i_overlay::core::overlay::IntOverlayOptions;
use i_triangle::i_overlay::core::simplify::Simplify;
use i_triangle::i_overlay::i_float::int::point::IntPoint;
use i_triangle::i_overlay::i_shape::int::area::Area;
use i_triangle::i_overlay::i_shape::int::path::ContourExtension;
use i_triangle::i_overlay::i_shape::int::shape::{IntContour, IntShape};
use metasense_lab::replay::Drawing;

/// A point of the grid.
pub type GridPoint = IntPoint<i32>;

/// Lengths of a mould (mm).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mould {
    /// Width of the body's ligaments.
    pub width: f64,
    /// Depth of the cavity, equal to the height of the body.
    pub height: f64,
    /// Thickness of floor and rim.
    pub wall: f64,
    /// Distance between body and cavity on every side.
    pub clearance: f64,
    /// Length, width and depth of a chip's pocket.
    pub pocket: Option<[f64; 3]>,
}

/// The outline, with pockets and holes.
#[derive(Debug, Clone, PartialEq)]
pub struct Outline {
    /// Loops on the grid, the body on their left: the outer one first, counter-clockwise, then those of voids, clockwise.
    pub loops: IntShape<i32>,
    /// Pitch of the grid (mm).
    pub pitch: f64,
    /// Number of additional voids, where wide ligaments touch parts that they do not join.
    pub parted: usize,
    /// Pockets in the body's lower side, counter-clockwise.
    pub pockets: Vec<IntContour<i32>>,
    /// Holes for screws through held units, counter-clockwise.
    pub holes: Vec<IntContour<i32>>,
}

/// Why there is no outline.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum NoOutline {
    #[error(
        "the body consists of {0} separate pieces and cannot be cast in one mould; --format svg shows them"
    )]
    Apart(usize),
    #[error(
        "ligaments {width:.2} mm wide, the width that body.stiffness implies, leave {left} of the body's {voids} voids; reduce \
         body.stiffness.bend (or body.material.ligament_width) and train again"
    )]
    TooWide { width: f64, left: usize, voids: usize },
    /// `left`: smallest distance of a corner to an edge (mm), below 0 outside.
    #[error(
        "a pocket of {size} mm leaves {left:.2} mm of unit {unit} around it, less than {POCKET_WALL} mm; a pocket {:.1} mm smaller in length and width would fit, \
         or a body of larger units (body.spacing)",
        2.0 * (POCKET_WALL - left)
    )]
    Pocket { size: String, left: f64, unit: usize },
    #[error("a clearance of {0} mm closes or divides a void of the body; reduce clearance in --mould")]
    Closed(f64),
}

/// Diameter of a screw hole (mm): M3, ISO 273, medium.
pub const HOLE: f64 = 3.4;

/// Minimum wall around a pocket or a hole (mm).
pub const POCKET_WALL: f64 = 1.0;

/// Corners (mm) of a pocket in a unit, and their smallest distance to an edge of the unit (mm).
fn pocket(
    drawing: &Drawing,
    unit: usize,
    [along, across]: [f64; 2],
    offset: [f64; 2],
    tilt: f64,
) -> ([[f64; 2]; 4], f64) {
    let (sin, cos) = tilt.sin_cos();
    let [x, y] = [0, 1].map(|d| drawing.centroids[unit][d] + offset[d]);
    let corner = |[p, q]: [f64; 2]| {
        let (p, q) = (0.5 * along * p, 0.5 * across * q);
        [x + cos * p - sin * q, y + sin * p + cos * q]
    };
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(corner);
    let left = corners.iter().map(|q| depth_within(&drawing.units[unit], *q)).fold(f64::INFINITY, f64::min);
    (corners, left)
}

/// Side (mm, in steps of 0.5) of the largest square pocket that fits into every sensor's unit, up to 100; 0 if none fits.
pub fn largest_pocket(drawing: &Drawing, offset: [f64; 2], tilt: f64) -> f64 {
    let fits = |side: &f64| {
        let fits = |&unit: &usize| pocket(drawing, unit, [*side; 2], offset, tilt).1 >= POCKET_WALL;
        drawing.sensors.iter().all(fits)
    };
    (1..=200).map(|halves| 0.5 * f64::from(halves)).take_while(fits).last().unwrap_or(0.0)
}

/// Held units without a chip that have room for a screw at their centroid.
pub fn screwed(drawing: &Drawing) -> impl Iterator<Item = usize> {
    let place = |&unit: &usize| {
        depth_within(&drawing.units[unit], drawing.centroids[unit]) >= 0.5 * HOLE + POCKET_WALL
            && !drawing.sensors.contains(&unit)
    };
    drawing.clamped.iter().copied().filter(place)
}

/// Maximum distance between an arc and its chords (mm).
const SAGITTA: f64 = 0.005;

/// Minimum area of a void (mm²); smaller ones are filled.
const SMALLEST: f64 = 0.05;

impl Outline {
    /// The outline of the mould's cavity: the body, and all points within the clearance.
    ///
    /// # Errors
    /// If the body is not connected, or if ligaments or clearance close a void.
    pub fn new(drawing: &Drawing, mould: &Mould) -> Result<Self, NoOutline> {
        let all = drawing.units.iter().flatten().flatten();
        let reach = all.fold(0.0f64, |r, x| r.max(x.abs())) + mould.wall + mould.width + mould.clearance;
        // Coordinates have 24 bits, so that single precision (STL) represents them exactly.
        let pitch = (reach.log2().ceil() - 24.0).exp2();
        let body = united(drawing, 0.5 * mould.width, 0.0, pitch)?;
        // Number of inner faces of units and ligaments as a connected plane graph.
        let voids = (drawing.ligaments.len() + 1).saturating_sub(drawing.units.len());
        let left = body.len() - 1;
        let Some(parted) = left.checked_sub(voids) else {
            return Err(NoOutline::TooWide { width: mould.width, left, voids });
        };
        if mould.clearance == 0.0 {
            return Ok(Self { loops: body, pitch, parted, pockets: Vec::new(), holes: Vec::new() });
        }
        let loops = united(drawing, 0.5 * mould.width + mould.clearance, mould.clearance, pitch)?;
        let within = |void: &IntContour<i32>| loops[1..].iter().filter(|l| void.contains_point(l[0])).count();
        match body[1..].iter().all(|void| within(void) == 1) {
            true => Ok(Self { loops, pitch, parted, pockets: Vec::new(), holes: Vec::new() }),
            false => Err(NoOutline::Closed(mould.clearance)),
        }
    }

    /// Adds a pocket for a chip in each sensor's unit, `offset` (mm) from its centroid and turned by `tilt` (rad), and a screw hole
    /// in each held unit that has room for it ([`screwed`]).
    ///
    /// # Errors
    /// If a pocket would leave a wall thinner than [`POCKET_WALL`].
    pub fn with_inserts(
        mut self,
        drawing: &Drawing,
        mould: &Mould,
        offset: [f64; 2],
        tilt: f64,
    ) -> Result<Self, NoOutline> {
        let circle = |[x, y]: [f64; 2]| {
            let turns = (0..24).map(|i| (f64::from(i) * std::f64::consts::TAU / 24.0).sin_cos());
            turns.map(|(sin, cos)| onto([x + 0.5 * HOLE * cos, y + 0.5 * HOLE * sin], self.pitch)).collect()
        };
        self.holes = screwed(drawing).map(|unit| circle(drawing.centroids[unit])).collect();
        let Some([along, across, _]) = mould.pocket else { return Ok(self) };
        for &unit in &drawing.sensors {
            let (corners, left) = pocket(drawing, unit, [along, across], offset, tilt);
            if left < POCKET_WALL {
                return Err(NoOutline::Pocket { size: format!("{along}x{across}"), left, unit });
            }
            self.pockets.push(corners.iter().map(|q| onto(*q, self.pitch)).collect());
        }
        Ok(self)
    }

    /// A point of the grid in mm.
    pub fn mm(&self, point: GridPoint) -> [f64; 2] {
        [point.x, point.y].map(|x| f64::from(x) * self.pitch)
    }

    /// Area (mm²).
    pub fn area(&self) -> f64 {
        self.mm2(&self.loops)
    }

    /// Volume of the cavity (mm³).
    pub fn volume(&self, mould: &Mould) -> f64 {
        (self.area() - self.mm2(&self.holes)) * mould.height
            - self.mm2(&self.pockets) * mould.pocket.map_or(0.0, |pocket| pocket[2])
    }

    fn mm2(&self, loops: &[IntContour<i32>]) -> f64 {
        loops.iter().map(|l| l.area_two()).sum::<i64>() as f64 * 0.5 * self.pitch * self.pitch
    }
}

/// The union of all units, enlarged by `around`, and of strips of half width `half` along the ligaments.
fn united(drawing: &Drawing, half: f64, around: f64, pitch: f64) -> Result<IntShape<i32>, NoOutline> {
    let onto = |point| onto(point, pitch);
    let mut pieces: Vec<IntContour<i32>> =
        drawing.units.iter().map(|unit| unit.iter().map(|p| onto(*p)).collect()).collect();
    let mut strip = |a, b, radius| pieces.push(strip(a, b, radius).map(onto).collect());
    for &[a, b] in &drawing.ligaments {
        strip(a, b, half);
    }
    if around > 0.0 {
        for unit in &drawing.units {
            for p in 0..unit.len() {
                strip(unit[p], unit[(p + 1) % unit.len()], around);
            }
        }
    }
    let options =
        IntOverlayOptions { min_output_area: (SMALLEST / (pitch * pitch)) as u64, ..Default::default() };
    let mut shapes = pieces.simplify(FillRule::NonZero, options);
    match shapes.len() {
        1 => Ok(shapes.remove(0)),
        n => Err(NoOutline::Apart(n)),
    }
}

/// The grid point nearest to a point (mm).
fn onto([x, y]: [f64; 2], pitch: f64) -> GridPoint {
    GridPoint::new((x / pitch).round() as i32, (y / pitch).round() as i32)
}

/// Smallest distance of a point to the edges of a convex unit, counter-clockwise; below 0 outside.
fn depth_within(unit: &[[f64; 2]], [x, y]: [f64; 2]) -> f64 {
    let from_edge = |p: usize| {
        let ([a, b], [c, d]) = (unit[p], unit[(p + 1) % unit.len()]);
        ((c - a) * (y - b) - (d - b) * (x - a)) / (c - a).hypot(d - b)
    };
    (0..unit.len()).map(from_edge).fold(f64::INFINITY, f64::min)
}

/// The polygon around all points within `radius` of the segment from a to b, counter-clockwise.
fn strip(a: [f64; 2], b: [f64; 2], radius: f64) -> impl Iterator<Item = [f64; 2]> {
    use std::f64::consts::{FRAC_PI_2, PI};
    let chord = 2.0 * (1.0 - SAGITTA / radius).max(0.0).acos();
    let chords = (PI / chord).ceil();
    let ahead = (b[1] - a[1]).atan2(b[0] - a[0]);
    [(b, ahead - FRAC_PI_2), (a, ahead + FRAC_PI_2)].into_iter().flat_map(move |(end, from)| {
        (0..=chords as u32).map(move |i| {
            let (sin, cos) = (from + PI * f64::from(i) / chords).sin_cos();
            [end[0] + radius * cos, end[1] + radius * sin]
        })
    })
}

#[cfg(test)]
pub(crate) mod tests;
