//! Converts a trial's body into the sketch that `look` draws.

use maud::html;
use metasense_lab::replay::{Drawing, Panel};
use metasense_worker::design::{Active, Violation, ViolationKind};

use crate::analysis::BodyState;
use crate::look::body::{Arrow, Mark, Numbering, Position, Sketch, frame, middle};
use crate::look::{Figure, Picture, Table, legend, row};
use crate::reader::StoredTrial;

/// The body with its active and violated constraints.
pub fn sketch(drawing: &Drawing, violations: &[Violation]) -> Sketch {
    let Drawing { units, centroids, ligaments, joints, panels, sensors, clamped, guided, spacing, .. } =
        drawing;
    let held = |a: &Active| mark(a.kind, a.units, Some(a.node), units);
    let arrow = |&(panel, foot): &(Panel, Position)| {
        let direction = (!panel.is_couple()).then_some(panel.direction);
        Arrow { unit: panel.unit, foot, direction, sense: panel.moment.signum() }
    };
    let broken = |v: &Violation| mark(v.kind, v.units, v.node, units);
    Sketch {
        units: units.clone(),
        centroids: centroids.clone(),
        ligaments: ligaments.clone(),
        joints: joints.clone(),
        panels: panels.iter().map(arrow).collect(),
        sensors: sensors.clone(),
        clamped: clamped.clone(),
        guided: guided.clone(),
        held: drawing.active.iter().map(held).collect(),
        broken: violations.iter().map(broken).collect(),
        violating_units: violations.iter().filter(|v| v.node.is_none()).flat_map(|v| v.units).collect(),
        spacing: *spacing,
    }
}

/// A figure of bodies side by side at one scale; each with title, name in the data and sketch.
pub fn figure(
    name: &'static str,
    title: &str,
    caption: impl Into<String>,
    bodies: &[(String, String, Sketch)],
) -> Figure {
    let view = frame(bodies.iter().map(|body| &body.2));
    let mut entries = vec![("arrow", "input panel"), ("dot sensor", "sensor")];
    if bodies.iter().any(|body| !body.2.held.is_empty()) {
        entries.push(("active", "constraint at its limit"));
    }
    let rows = bodies.iter().flat_map(|(_, name, sketch)| {
        let corners = |(unit, corners): (usize, &Vec<Position>)| {
            corners.iter().enumerate().map(|(node, [x, y])| row![name, unit, node, x, y]).collect::<Vec<_>>()
        };
        sketch.units.iter().enumerate().flat_map(corners).collect::<Vec<_>>()
    });
    let pictures =
        bodies.iter().map(|(title, _, sketch)| sketch.picture(view, title, Numbering::Units)).collect();
    Figure::new(name, title, caption, legend(&entries), pictures, Table::new("body unit node x y", rows))
}

/// The drawings that an external body's program made of both bodies; `None` without drawings. As images they run no scripts.
pub fn drawn(stored: &StoredTrial) -> Option<Figure> {
    let name = stored.spec().body.description.as_ref().map_or("", |description| &description.name);
    let picture = |(body, svg): (BodyState, &String)| {
        let sides = svg.split_once("viewBox=\"").map_or("", |(_, rest)| rest.split('"').next().unwrap_or(""));
        let view: Vec<f64> = sides.split([' ', ',']).filter_map(|side| side.parse().ok()).collect();
        let ratio = if view.len() == 4 { view[3] / view[2] } else { 1.0 };
        let height = if (0.1..=10.0).contains(&ratio) { 100.0 * ratio } else { 100.0 };
        let title = format!("{} body", body.word());
        let encoded: String = svg.bytes().map(|byte| format!("%{byte:02X}")).collect();
        let marks =
            html! { image width="100" height=(height) href=(format!("data:image/svg+xml,{encoded}")) {} };
        Picture { title, class: "body", view: [0.0, 0.0, 100.0, height], marks }
    };
    let pictures: Vec<_> = BodyState::ALL.into_iter().zip(&stored.drawings).map(picture).collect();
    let numbers = (0..).zip(stored.designs[0].iter().zip(&stored.designs[1]));
    let data =
        || Table::new("number initial optimised", numbers.map(|(i, (a, b)): (usize, _)| row![i, a, b]));
    let caption = format!("Initial and trained body, drawn by {name}.");
    Figure::some("bodies", "The body before and after", caption, legend(&[]), pictures, data)
}

/// The mark of a constraint: a line or a dot.
fn mark(kind: ViolationKind, of: [usize; 2], node: Option<usize>, units: &[Vec<Position>]) -> Mark {
    let (corners, other) = (&units[of[0]], &units[of[1]]);
    match (kind, node) {
        (ViolationKind::Edge, Some(p)) => Mark::Line(corners[p], corners[(p + 1) % corners.len()]),
        (ViolationKind::Clearance | ViolationKind::Overlap, _) => {
            let (a, b) = closest(corners, other);
            Mark::Line(a, b)
        }
        (ViolationKind::LigamentClearance, Some(p)) => {
            Mark::Line(corners[p], closest(&[corners[p]], other).1)
        }
        (ViolationKind::VoidAngle, Some(p)) => {
            // chord of the angle, in the void beside the node
            let (here, next) = (corners[p], corners[(p + 1) % corners.len()]);
            let along = [0, 1].map(|i| here[i] + 0.35 * (next[i] - here[i]));
            let (_, b) = closest(&[along], other);
            Mark::Line(along, if b == along { middle(other) } else { b })
        }
        (_, Some(p)) => Mark::Dot(corners[p], 0.8),
        (_, None) => Mark::Dot(middle(corners), 1.2),
    }
}

/// The closest points of two polygons.
fn closest(a: &[Position], b: &[Position]) -> (Position, Position) {
    let mut best = (f64::INFINITY, a[0], b[0]);
    for (corners, ring, swap) in [(a, b, false), (b, a, true)] {
        for &p in corners {
            for i in 0..ring.len() {
                let (s, t) = (ring[i], ring[(i + 1) % ring.len()]);
                let along = [t[0] - s[0], t[1] - s[1]];
                let square = along[0] * along[0] + along[1] * along[1];
                let part = ((p[0] - s[0]) * along[0] + (p[1] - s[1]) * along[1]) / square;
                let part = if square > 0.0 { part.clamp(0.0, 1.0) } else { 0.0 };
                let q = [s[0] + part * along[0], s[1] + part * along[1]];
                let distance = (p[0] - q[0]).hypot(p[1] - q[1]);
                if distance < best.0 {
                    best = if swap { (distance, q, p) } else { (distance, p, q) };
                }
            }
        }
    }
    (best.1, best.2)
}

#[cfg(test)]
mod tests;
