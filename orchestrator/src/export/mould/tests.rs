//! Tests of `mould`.

use metasense_lab::replay::Drawing;

use super::super::outline::tests::{area_of_units, mould};
use super::super::tests::{squares, squares_moved};
use super::*;

fn volume(triangles: &[Triangle]) -> f64 {
    let of = |[a, b, c]: &Triangle| {
        let n = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
        (a[0] * n[0] + a[1] * n[1] + a[2] * n[2]) / 6.0
    };
    triangles.iter().map(of).sum()
}

/// Checks that the surface is closed and has the volume of the plate less that of the cavity.
fn check(drawing: &Drawing, mould: &Mould, what: &str) -> Outline {
    let cavity =
        Outline::new(drawing, mould).and_then(|cavity| cavity.with_inserts(drawing, mould, [0.3, -0.2], 0.4));
    let cavity = cavity.unwrap_or_else(|e| panic!("{what}: {e}"));
    let held = drawing.clamped.iter().filter(|u| !drawing.sensors.contains(u)).count();
    assert!(cavity.holes.len() <= held, "{what}: {} holes in {held} held units", cavity.holes.len());
    let triangles = surface(&cavity, mould);
    assert!(is_closed(&triangles), "{what}");
    let size = |k: usize| {
        let all = || cavity.loops[0].iter().map(|p| cavity.mm(*p)[k]);
        all().fold(f64::NEG_INFINITY, f64::max) - all().fold(f64::INFINITY, f64::min) + 2.0 * mould.wall
    };
    let expected = size(0) * size(1) * (mould.wall + mould.height) - cavity.volume(mould);
    let volume = volume(&triangles);
    assert!((volume / expected - 1.0).abs() < 1e-6, "{what}: {volume} {expected}");
    cavity
}

#[test]
fn the_mould_is_closed_and_has_its_volume() {
    for clearance in [0.0, 0.15] {
        let cavity = check(&squares(), &Mould { clearance, ..mould(1.0) }, &format!("clearance {clearance}"));
        assert_eq!(cavity.holes.len(), squares().clamped.len());
    }
}

/// Under each sensor stands a block of the pocket's size; a pocket that leaves too little of its unit is refused.
#[test]
fn chips_have_their_pockets() {
    let drawing = Drawing { sensors: vec![0, 4], ..squares() };
    let with = |pocket| Mould { pocket: Some(pocket), ..mould(1.0) };
    let plain = check(&drawing, &mould(1.0), "without");
    let [own, bare] = [(with([5.0, 4.0, 2.5]), 2), (mould(1.0), 0)].map(|(mould, pockets)| {
        let cavity = check(&drawing, &mould, "pockets");
        assert_eq!(cavity.pockets.len(), pockets);
        cavity.volume(&mould)
    });
    assert!((bare - own - 2.0 * 5.0 * 4.0 * 2.5).abs() < 1e-3, "{own} {bare}");
    let refused = plain.with_inserts(&drawing, &with([9.0, 4.0, 2.5]), [0.0; 2], 0.0).unwrap_err();
    assert!(matches!(refused, super::super::outline::NoOutline::Pocket { unit: 0, .. }), "{refused}");
    let side = super::super::outline::largest_pocket(&drawing, [0.0; 2], 0.0);
    let fits = |side: f64| {
        check(&drawing, &mould(1.0), "")
            .with_inserts(&drawing, &with([side, side, 1.0]), [0.0; 2], 0.0)
            .is_ok()
    };
    assert!(side > 0.0 && fits(side) && !fits(side + 0.5), "{side}");
}

/// The first unit's ligament to the right continues the unit's lower edge, within 0.02° as in a trained body.
#[test]
fn a_ligament_that_goes_on_along_an_edge_is_cast() {
    for turn in [0.0, 0.02, -0.02] {
        let mut drawing = squares();
        let [corner, before] = [drawing.units[0][0], drawing.units[0][3]];
        let edge = (corner[1] - before[1]).atan2(corner[0] - before[0]);
        let (sin, cos) = (edge + f64::to_radians(turn)).sin_cos();
        let end = [corner[0] + 2.25 * cos, corner[1] + 2.25 * sin];
        drawing.units[1][2] = end;
        drawing.ligaments[0] = [corner, end];
        for width in [0.2, 1.0, 1.5] {
            let what = format!("{turn}° from the edge, {width} mm wide");
            let cavity = check(&drawing, &mould(width), &what);
            let (units, area) = (area_of_units(&drawing), cavity.area());
            assert!(area > units + 12.0 * 1.9 * width, "{what}: {area}, units {units}");
            assert_eq!((cavity.loops.len(), cavity.parted), (5, 0), "{what}");
        }
    }
}

/// Two ligaments of a unit begin 1.3 mm apart; with a width of 1.5 mm they merge there.
#[test]
fn ligaments_that_overlap_are_cast() {
    let drawing = squares_moved(|unit, p| match (unit, p) {
        (0, 0) => [-3.0, 1.5],
        (0, 1) => [4.9, -1.6],
        _ => [0.0; 2],
    });
    let apart = check(&drawing, &mould(0.5), "apart");
    let cavity = check(&drawing, &mould(1.5), "overlapping");
    assert_eq!(cavity.loops.len(), 5);
    let units = area_of_units(&drawing);
    assert!(units < apart.area() && apart.area() < cavity.area(), "{units} {}", cavity.area());
}

/// Joints moved by up to 2.4 mm in any direction, as in trained bodies and beyond.
#[test]
fn moved_bodies_are_cast_in_one_piece() {
    for case in 0..40 {
        let by = |k: usize| 1.7 * (1e3 * ((case * 100 + k) as f64)).sin();
        let drawing = squares_moved(|unit, p| [by(4 * unit + 2 * p), by(4 * unit + 2 * p + 1)]);
        for (width, clearance) in [(0.3, 0.0), (1.0, 0.0), (1.0, 0.1), (2.0, 0.05)] {
            let what = format!("case {case}, {width} mm wide, clearance {clearance}");
            let cavity = check(&drawing, &Mould { clearance, ..mould(width) }, &what);
            let (units, area) = (area_of_units(&drawing), cavity.area());
            assert!(area > units, "{what}: {area}, units {units}");
        }
    }
}

#[test]
fn a_surface_with_a_hole_is_not_closed() {
    let mould = mould(1.0);
    let mut triangles = surface(&Outline::new(&squares(), &mould).unwrap(), &mould);
    triangles.pop();
    assert!(!is_closed(&triangles));
}
