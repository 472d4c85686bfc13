//! Tests of `outline`.

use super::super::tests::squares;
use super::*;

/// A mould without clearance for ligaments of this width.
pub fn mould(width: f64) -> Mould {
    Mould { width, height: 10.0, wall: 3.0, clearance: 0.0, pocket: None }
}

/// Area of a unit.
fn area_of(unit: &[[f64; 2]]) -> f64 {
    (0..unit.len())
        .map(|p| (unit[p], unit[(p + 1) % unit.len()]))
        .map(|(a, b)| 0.5 * (a[0] * b[1] - a[1] * b[0]))
        .sum()
}

pub fn area_of_units(drawing: &Drawing) -> f64 {
    drawing.units.iter().map(|unit| area_of(unit)).sum()
}

/// Nine units have four voids. A ligament adds at least the strip between the corners that it joins, less the parts of units beside
/// it, and at most all points within half its width.
#[test]
fn the_outline_is_one_outer_loop_and_a_loop_a_void() {
    let drawing = squares();
    let outline = Outline::new(&drawing, &mould(1.0)).unwrap();
    assert_eq!((outline.loops.len(), outline.parted), (5, 0));
    let unit = 2.0 * (6.375 / 20f64.to_radians().cos()).powi(2);
    let added = outline.area() - 9.0 * unit;
    assert!(added > 12.0 * 2.25 && added < 12.0 * 3.25, "{added}, units {}", 9.0 * unit);
    // only the ends of ligaments are rounded
    assert!(outline.loops.iter().map(Vec::len).sum::<usize>() < 36 + 24 * 14, "{:?}", outline.loops);
}

/// A clearance adds its product with the perimeter to the area, and keeps one loop per void.
#[test]
fn a_clearance_moves_every_side_outward() {
    let body = Outline::new(&squares(), &mould(1.0)).unwrap();
    let around: f64 = body
        .loops
        .iter()
        .flat_map(|l| l.iter().zip(l.iter().cycle().skip(1)))
        .map(|(a, b)| f64::from(a.x - b.x).hypot(f64::from(a.y - b.y)) * body.pitch)
        .sum();
    let grown = Outline::new(&squares(), &Mould { clearance: 0.1, ..mould(1.0) }).unwrap();
    assert_eq!(grown.loops.len(), 5);
    let added = grown.area() - body.area();
    assert!((added / (0.1 * around) - 1.0).abs() < 0.03, "{added} around {around}");
    for void in &body.loops[1..] {
        assert!(grown.loops[1..].iter().filter(|l| l.iter().all(|p| void.contains_point(*p))).count() == 1);
    }
    let closed = Outline::new(&squares(), &Mould { clearance: 5.0, ..mould(1.0) });
    assert_eq!(closed, Err(NoOutline::Closed(5.0)));
}

#[test]
fn ligaments_as_wide_as_voids_are_refused() {
    let wide = Outline::new(&squares(), &mould(12.0));
    assert!(matches!(wide, Err(NoOutline::TooWide { voids: 4, .. })), "{wide:?}");
}

#[test]
fn units_that_nothing_joins_are_refused() {
    let mut drawing = squares();
    drawing.ligaments.retain(|l| l.iter().all(|end| end[0] < 20.0));
    assert_eq!(Outline::new(&drawing, &mould(1.0)), Err(NoOutline::Apart(4)));
}
