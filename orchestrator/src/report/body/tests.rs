//! Tests of drawn bodies.

use super::*;
use crate::export::tests::squares;
use crate::look::body::{Arrow, Numbering};
use crate::look::wave::course;

/// A clearance is a line between its units, an angle a dot at its corner; y points down.
#[test]
fn what_holds_a_body_is_drawn_where_it_is() {
    let mut drawing = squares();
    let [x, y] = drawing.units[4][2];
    let held = |kind, units| Active { kind, units, node: 2, slack: 0.0 };
    drawing.active = vec![held(ViolationKind::Clearance, [4, 5]), held(ViolationKind::BlockAngleLow, [4, 4])];
    let drawn = sketch(&drawing, &[]);
    let svg = drawn.picture(frame([&drawn]), "", Numbering::Units).marks.into_string();
    assert_eq!(svg.matches("class=\"active\"").count(), 1, "{svg}");
    let dot = format!("class=\"active-node\" cx=\"{x:.3}\" cy=\"{:.3}\"", -y);
    assert!(svg.contains(&dot), "{dot} is not in {svg}");
    // nine units and a bar of 10 mm
    assert!(svg.matches("class=\"index\"").count() == 10 && svg.contains(">10 mm<"), "{svg}");
}

/// The data contain the corners of every design, and the displacement of panel and sensor since the first design. The panel moves
/// with its unit, the sensor to another unit.
#[test]
fn a_course_has_every_design_and_where_its_marks_have_gone() {
    let squares = || sketch(&squares(), &[]);
    let mut designs = [(0, squares()), (8, squares())];
    for (_, sketch) in &mut designs {
        let panel = Arrow { unit: 0, foot: sketch.centroids[0], direction: Some([1.0, 0.0]), sense: 0.0 };
        (sketch.panels, sketch.sensors) = (vec![panel], vec![1]);
    }
    let [_, (_, last)] = &mut designs;
    last.units[0].iter_mut().for_each(|[x, y]| (*x, *y) = (*x + 1.5, *y - 0.25));
    last.centroids[0] = [last.centroids[0][0] + 1.5, last.centroids[0][1] - 0.25];
    last.sensors = vec![2];
    let page = course(&designs, 50).into_string();
    let data = page.split("hidden>").nth(1).unwrap().split('<').next().unwrap();
    let lines: Vec<Vec<f64>> =
        data.lines().map(|line| line.split(',').map(|x| x.parse().unwrap()).collect()).collect();
    let [joints, first, last] = &lines[..] else { panic!("{data}") };
    assert_eq!(joints.len(), 2 * designs[0].1.ligaments.len());
    for (l, ends) in designs[0].1.ligaments.iter().enumerate() {
        for (end, [x, y]) in ends.iter().enumerate() {
            let corner = 1 + 2 * joints[2 * l + end] as usize;
            assert!((first[corner] - x).abs() < 1e-3 && (first[corner + 1] + y).abs() < 1e-3, "{l} {end}");
        }
    }
    assert!((first[0], first.len(), last.len()) == (0.0, 1 + 9 * 8 + 4, 1 + 9 * 8 + 4), "{data}");
    assert_eq!(first[73..], [0.0; 4]);
    assert_eq!((last[0], &last[73..]), (8.0, &[1.5, 0.25, 15.0, 0.0][..]));
    assert!((last[1] - first[1] - 1.5).abs() < 1e-3 && last[9..73] == first[9..73], "{data}");
    assert!(page.contains("max=\"1\"") && page.contains("aria-valuetext=\"step 0 of 50\""), "{page}");
    assert_eq!(page.matches("<script").count(), 0, "numbers alone");
}
