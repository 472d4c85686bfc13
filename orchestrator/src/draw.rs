//! A design as SVG: units, ligaments, panels, sensors, clamps; what holds the design back and what is broken.
//!
//! One SVG unit is one mm; y is turned over, as pages count downward.

use std::fmt::Write as _;

use metasense_worker::design::{Active, Kind, Layout, Violation};

type Point = [f64; 2];

/// What a drawing shows.
pub struct Drawing<'a> {
    /// The body.
    pub layout: &'a Layout,
    /// Its design.
    pub design: &'a [f64],
    /// Units that are held.
    pub clamped: &'a [usize],
    /// Units that are struck, with the direction of the force.
    pub panels: &'a [(usize, Point)],
    /// Units that carry a sensor.
    pub sensors: &'a [usize],
    /// What a sensor on a unit is worth (unit, error in %), where units are coloured by it; sensors are then numbered.
    pub worth: Option<&'a [(usize, f64)]>,
    /// Constraints at their limit.
    pub active: &'a [Active],
    /// Broken constraints.
    pub violations: &'a [Violation],
    /// A line below.
    pub caption: &'a str,
}

const STYLE: &str = "\
.unit{fill:#dbe4ee;stroke:#33475b;stroke-width:.35;stroke-linejoin:round}\
.clamped{fill:url(#held)}.panel{fill:#f3d9a4}.broken{fill:#f4b6b0;stroke:#c1121f;stroke-width:.6}\
.ligament{stroke:#33475b;stroke-width:.9;stroke-linecap:round}\
.force{stroke:#b35c00;stroke-width:.8;fill:none;marker-end:url(#tip)}\
.sensor{fill:#1d7a5f;stroke:#fff;stroke-width:.3}\
.active{stroke:#e07a00;stroke-width:.7;fill:none;stroke-linecap:round}.active-node{fill:#e07a00}\
.wrong{stroke:#c1121f;stroke-width:.9;fill:none;stroke-linecap:round}.wrong-node{fill:#c1121f}\
text{font-family:sans-serif;fill:#33475b}.number{font-size:2.6px;text-anchor:middle;fill:#fff;font-weight:bold}.index{font-size:2px;text-anchor:middle;fill:#7a8b9c}.light{fill:#fff}.caption{font-size:3px}";

/// The drawing as an SVG document.
pub fn svg(drawing: &Drawing<'_>) -> String {
    let units: Vec<[Point; 4]> = drawing
        .layout
        .vertices(drawing.design)
        .into_iter()
        .map(|corners| {
            corners.map(|[x, y]| [if x.is_finite() { x } else { 0.0 }, if y.is_finite() { -y } else { 0.0 }])
        })
        .collect();
    let corners = || units.iter().flatten();
    let end = |axis: usize, pick: fn(f64, f64) -> f64| corners().map(|c| c[axis]).reduce(pick).unwrap_or(0.0);
    let margin = 0.6 * drawing.layout.spacing;
    let (left, top) = (end(0, f64::min) - margin, end(1, f64::min) - 1.6 * margin);
    let legend = legend(drawing);
    let width = (end(0, f64::max) - left + margin).max(90.0);
    let height = end(1, f64::max) - top + margin + 5.0 * (legend.len() + 1) as f64;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"{left:.2} {top:.2} {width:.2} {height:.2}\" \
         width=\"{width:.2}mm\" height=\"{height:.2}mm\">\n<style>{STYLE}</style>\n<defs>\
         <pattern id=\"held\" width=\"2\" height=\"2\" patternUnits=\"userSpaceOnUse\" patternTransform=\"rotate(45)\">\
         <rect width=\"2\" height=\"2\" fill=\"#c3cdd8\"/><path d=\"M0 0V2\" stroke=\"#7a8b9c\" stroke-width=\".8\"/>\
         </pattern><marker id=\"tip\" viewBox=\"0 0 4 4\" refX=\"2\" refY=\"2\" markerWidth=\"4\" markerHeight=\"4\" \
         orient=\"auto\"><path d=\"M0 0L4 2L0 4Z\" fill=\"#b35c00\"/></marker></defs>\n\
         <rect x=\"{left:.2}\" y=\"{top:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" fill=\"#fff\"/>\n"
    );
    draw_body(drawing, &units, &mut out);
    draw_marks(drawing, &units, &mut out);
    let mut line = end(1, f64::max) + margin + 3.0;
    let from = left + 0.5 * margin;
    for (class, shape, text) in legend {
        let _ = match shape {
            Shape::Line => writeln!(out, "<path class=\"{class}\" d=\"M{from:.2} {:.2}h5\"/>", line - 1.0),
            Shape::Dot => writeln!(
                out,
                "<circle class=\"{class}\" cx=\"{:.2}\" cy=\"{:.2}\" r=\"1\"/>",
                from + 2.5,
                line - 1.0
            ),
            Shape::Box => writeln!(
                out,
                "<rect class=\"{class}\" x=\"{from:.2}\" y=\"{:.2}\" width=\"5\" height=\"3\"/>",
                line - 2.6
            ),
        };
        let _ = writeln!(
            out,
            "<text class=\"caption\" x=\"{:.2}\" y=\"{line:.2}\">{}</text>",
            from + 7.0,
            escaped(&text)
        );
        line += 5.0;
    }
    let _ = writeln!(
        out,
        "<text class=\"caption\" x=\"{from:.2}\" y=\"{line:.2}\">{}</text>\n</svg>",
        escaped(drawing.caption)
    );
    out
}

enum Shape {
    Line,
    Dot,
    Box,
}

/// Only what the drawing has.
fn legend(drawing: &Drawing<'_>) -> Vec<(&'static str, Shape, String)> {
    let mut lines = Vec::new();
    let mut add = |count: usize, class, shape, one: &str, many: &str| {
        if count > 0 {
            lines.push((class, shape, format!("{count} {}", if count == 1 { one } else { many })));
        }
    };
    add(drawing.clamped.len(), "unit clamped", Shape::Box, "clamped unit", "clamped units");
    add(drawing.panels.len(), "unit panel", Shape::Box, "input panel", "input panels");
    add(drawing.sensors.len(), "sensor", Shape::Dot, "sensor", "sensors");
    add(drawing.active.len(), "active", Shape::Line, "constraint at its limit", "constraints at their limit");
    add(drawing.violations.len(), "wrong", Shape::Line, "broken constraint", "broken constraints");
    lines
}

fn draw_body(drawing: &Drawing<'_>, units: &[[Point; 4]], out: &mut String) {
    for ligament in &drawing.layout.ligaments {
        let [x, y] = units[ligament.a.unit][ligament.a.node];
        let [s, t] = units[ligament.b.unit][ligament.b.node];
        let _ = writeln!(out, "<path class=\"ligament\" d=\"M{x:.3} {y:.3}L{s:.3} {t:.3}\"/>");
    }
    let broken = |u: usize| drawing.violations.iter().any(|v| v.node.is_none() && v.units.contains(&u));
    for (u, corners) in units.iter().enumerate() {
        let mut class = String::from("unit");
        for (applies, name) in [
            (drawing.clamped.contains(&u), " clamped"),
            (drawing.panels.iter().any(|p| p.0 == u), " panel"),
            (broken(u), " broken"),
        ] {
            class.push_str(if applies { name } else { "" });
        }
        let shade = drawing.worth.and_then(|worth| rank(worth, u)).map(shade).unwrap_or_default();
        let points: Vec<String> = corners.iter().map(|[x, y]| format!("{x:.3},{y:.3}")).collect();
        let _ = writeln!(out, "<polygon class=\"{class}\"{shade} points=\"{}\"/>", points.join(" "));
    }
    for (u, corners) in units.iter().enumerate() {
        let [x, y] = middle(corners);
        if let Some(number) = drawing.sensors.iter().position(|sensor| *sensor == u) {
            let _ = writeln!(out, "<circle class=\"sensor\" cx=\"{x:.3}\" cy=\"{y:.3}\" r=\"1.8\"/>");
            if drawing.worth.is_some() {
                let below = y + 0.9;
                let number = number + 1;
                let _ = writeln!(out, "<text class=\"number\" x=\"{x:.3}\" y=\"{below:.3}\">{number}</text>");
            }
        } else {
            let dark = drawing.worth.and_then(|worth| rank(worth, u)).is_some_and(|rank| rank < 0.6);
            let class = if dark { "index light" } else { "index" };
            let _ = writeln!(out, "<text class=\"{class}\" x=\"{x:.3}\" y=\"{:.3}\">{u}</text>", y + 0.7);
        }
    }
    let length = 0.55 * drawing.layout.spacing;
    for &(u, [dx, dy]) in drawing.panels {
        // The arrow ends where it meets the unit's box.
        let [x, y] = middle(&units[u]);
        let reach = units[u].iter().map(|c| (x - c[0]) * dx - (y - c[1]) * dy).fold(0.0, f64::max) + 1.5;
        let (x1, y1) = (x - reach * dx, y + reach * dy);
        let (x0, y0) = (x1 - length * dx, y1 + length * dy);
        let _ = writeln!(out, "<path class=\"force\" d=\"M{x0:.3} {y0:.3}L{x1:.3} {y1:.3}\"/>");
    }
}

/// The rank of a unit's error, from 0, the best, to 1.
fn rank(worth: &[(usize, f64)], unit: usize) -> Option<f64> {
    let own = worth.iter().find(|(u, _)| *u == unit)?.1;
    let better = worth.iter().filter(|(_, error)| *error < own).count();
    Some(better as f64 / (worth.len() - 1).max(1) as f64)
}

/// The fill of a unit of this rank: dark is best.
fn shade(part: f64) -> String {
    // from deep blue to nearly white
    let [r, g, b] =
        [[28.0, 238.0], [84.0, 243.0], [140.0, 248.0]].map(|[from, to]| from + part * (to - from));
    format!(" style=\"fill:rgb({r:.0},{g:.0},{b:.0})\"")
}

fn draw_marks(drawing: &Drawing<'_>, units: &[[Point; 4]], out: &mut String) {
    for active in drawing.active {
        mark(active.kind, active.units, Some(active.node), ["active", "active-node"], units, out);
    }
    for violation in drawing.violations {
        mark(violation.kind, violation.units, violation.node, ["wrong", "wrong-node"], units, out);
    }
}

/// What a constraint holds, as line or dot: `class` for each. `units` with y downward.
pub(crate) fn mark(
    kind: Kind,
    of: [usize; 2],
    node: Option<usize>,
    class: [&str; 2],
    units: &[[Point; 4]],
    out: &mut String,
) {
    let corners = &units[of[0]];
    let line = |[x, y]: Point, [s, t]: Point| {
        format!("<path class=\"{}\" d=\"M{x:.3} {y:.3}L{s:.3} {t:.3}\"/>\n", class[0])
    };
    match (kind, node) {
        (Kind::Edge, Some(p)) => out.push_str(&line(corners[p], corners[(p + 1) % 4])),
        (Kind::Clearance | Kind::Overlap, _) => {
            let (a, b) = closest(corners, &units[of[1]]);
            out.push_str(&line(a, b));
        }
        (Kind::LigamentClearance, Some(p)) => {
            let (_, b) = closest(&[corners[p]], &units[of[1]]);
            out.push_str(&line(corners[p], b));
        }
        (Kind::VoidAngle, Some(p)) => {
            // An arc's chord, drawn in the void beside the node.
            let (here, next) = (corners[p], corners[(p + 1) % 4]);
            let other = middle(&units[of[1]]);
            let along = [here[0] + 0.35 * (next[0] - here[0]), here[1] + 0.35 * (next[1] - here[1])];
            let (_, b) = closest(&[along], &units[of[1]]);
            out.push_str(&line(along, if b == along { other } else { b }));
        }
        (_, Some(p)) => {
            let [x, y] = corners[p];
            let _ = writeln!(out, "<circle class=\"{}\" cx=\"{x:.3}\" cy=\"{y:.3}\" r=\".8\"/>", class[1]);
        }
        (_, None) => {
            let [x, y] = middle(corners);
            let _ = writeln!(out, "<circle class=\"{}\" cx=\"{x:.3}\" cy=\"{y:.3}\" r=\"1.2\"/>", class[1]);
        }
    }
}

fn middle(corners: &[Point; 4]) -> Point {
    [0, 1].map(|c| corners.iter().map(|q| q[c]).sum::<f64>() / 4.0)
}

/// The closest points of two rings of corners.
fn closest(a: &[Point], b: &[Point]) -> (Point, Point) {
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

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}
