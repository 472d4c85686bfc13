//! A body: units, ligaments, what is at its limit or broken, panels with the direction of the blow, sensors.

use maud::{Markup, html};
use metasense_worker::design::{Kind, Violation};
use metasense_worker::replay::Drawing;

use super::{Legend, Picture, file};

type Point = [f64; 2];

/// What a picture lies within: left, top, width, height (mm), y downward.
pub type Frame = [f64; 4];

/// A frame around all of these bodies, so that they are drawn alike.
#[must_use]
pub fn frame(drawings: &[&Drawing]) -> Frame {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for corner in drawings.iter().flat_map(|d| d.units.iter().flatten()) {
        for i in 0..2 {
            low[i] = low[i].min(corner[i]);
            high[i] = high[i].max(corner[i]);
        }
    }
    let air = 0.75 * drawings.first().map_or(1.0, |d| d.spacing);
    [low[0] - air, -high[1] - air, high[0] - low[0] + 2.0 * air, high[1] - low[1] + 2.0 * air]
}

/// What a unit has beside its shape.
#[derive(Debug, Clone, Default)]
pub struct Unit {
    /// Its class in place of the usual one.
    pub class: Option<String>,
    /// Where it is moved to.
    pub transform: Option<String>,
    /// Its style.
    pub style: Option<String>,
}

/// What a drawing shows beside the body.
#[derive(Debug, Clone, Copy, Default)]
pub struct Notes<'a> {
    /// Whether units and sensors are numbered.
    pub numbers: bool,
    /// Broken constraints.
    pub violations: &'a [Violation],
}

/// The whole drawing.
#[must_use]
pub fn body(
    drawing: &Drawing,
    view: Frame,
    title: &str,
    notes: Notes,
    unit: impl Fn(usize) -> Unit,
) -> Picture {
    let turned: Vec<[Point; 4]> = drawing.units.iter().map(|u| u.map(|[x, y]| [x, -y])).collect();
    let broken = |u: usize| notes.violations.iter().any(|v| v.node.is_none() && v.units.contains(&u));
    let class = |u: usize| {
        let clamped = if drawing.clamped.contains(&u) { " clamped" } else { "" };
        format!("unit{clamped}{}", if broken(u) { " broken" } else { "" })
    };
    let marks = html! {
        @for [[ax, ay], [bx, by]] in &drawing.ligaments {
            path class="ligament" d=(format!("M{ax:.3} {:.3}L{bx:.3} {:.3}", -ay, -by)) {}
        }
        @for (u, corners) in turned.iter().enumerate() {
            @let points = corners.map(|[x, y]| format!("{x:.3},{y:.3}")).join(" ");
            @let Unit { class: other, transform, style } = unit(u);
            polygon class=(other.unwrap_or_else(|| class(u))) points=(points) transform=[transform] style=[style] {}
        }
        @for a in &drawing.active { (mark(a.kind, a.units, Some(a.node), ["active", "active-node"], &turned)) }
        @for v in notes.violations { (mark(v.kind, v.units, v.node, ["wrong", "wrong-node"], &turned)) }
        @if notes.numbers {
            @for (u, corners) in turned.iter().enumerate().filter(|(u, _)| !drawing.sensors.contains(u)) {
                @let [x, y] = middle(corners);
                text class="index" x=(format!("{x:.2}")) y=(format!("{:.2}", y + 0.7)) { (u) }
            }
        }
        (panels_and_sensors(drawing, notes.numbers))
    };
    Picture { title: title.into(), class: "body", view, marks }
}

/// A body as a file of its own, without the constraints that hold it.
#[must_use]
pub fn picture(drawing: Drawing, title: &str) -> String {
    let drawing = Drawing { active: Vec::new(), ..drawing };
    let drawn = body(&drawing, frame(&[&drawing]), title, Notes::default(), |_| Unit::default());
    file(&[drawn], 1, 640.0, &Legend::default())
}

/// What a drawing has, by number.
#[must_use]
pub fn legend(drawing: &Drawing, violations: &[Violation]) -> Legend {
    let kinds = [
        (drawing.clamped.len(), "unit clamped", "clamped unit", "clamped units"),
        (drawing.panels.len(), "arrow", "input panel", "input panels"),
        (drawing.sensors.len(), "dot sensor", "sensor", "sensors"),
        (drawing.active.len(), "active", "constraint at its limit", "constraints at their limit"),
        (violations.len(), "wrong", "broken constraint", "broken constraints"),
    ];
    let told = |(n, class, one, many)| (class, format!("{n} {}", if n == 1 { one } else { many }));
    kinds.into_iter().filter(|kind| kind.0 > 0).map(told).collect()
}

/// Arrows at the panels and dots at the sensors.
fn panels_and_sensors(drawing: &Drawing, numbers: bool) -> Markup {
    let pitch = drawing.spacing;
    let arrow = |&(unit, [dx, dy]): &(usize, Point)| {
        // it ends at the unit's middle, or before it where a number stands there, and begins outside
        let ([x, y], dy) = (drawing.centroids[unit], -dy);
        let before = if numbers { 0.5 } else { 0.0 };
        let at = |along: f64, aside: f64| {
            let along = along - before;
            [x + pitch * (along * dx - aside * dy), -y + pitch * (along * dy + aside * dx)]
        };
        let ([a, b], [c, d]) = (at(0.5 * before - 0.95, 0.0), at(-0.3, 0.0));
        let tip = [at(-0.3, 0.14), at(-0.3, -0.14), at(0.0, 0.0)].map(|[x, y]| format!("{x:.2},{y:.2}"));
        (format!("M{a:.2} {b:.2}L{c:.2} {d:.2}"), tip.join(" "))
    };
    html! {
        @for (k, panel) in drawing.panels.iter().enumerate() {
            @let (shaft, tip) = arrow(panel);
            g class="panel" { title { "panel " (k) ": unit " (panel.0) } path d=(shaft) {} polygon points=(tip) {} }
        }
        @for (m, &unit) in drawing.sensors.iter().enumerate() {
            @let [x, y] = drawing.centroids[unit];
            circle class="sensor" cx=(format!("{x:.2}")) cy=(format!("{:.2}", -y)) r=(format!("{:.2}", 0.17 * pitch)) {
                title { "sensor " (m) ": unit " (unit) }
            }
            @if numbers {
                text class="number" x=(format!("{x:.2}")) y=(format!("{:.2}", 1.0 - y)) { (m + 1) }
            }
        }
    }
}

/// What a constraint holds, as line or dot: a class for each. `units` with y downward.
fn mark(kind: Kind, of: [usize; 2], node: Option<usize>, class: [&str; 2], units: &[[Point; 4]]) -> Markup {
    let corners = &units[of[0]];
    let line = |[x, y]: Point, [s, t]: Point| {
        html! { path class=(class[0]) d=(format!("M{x:.3} {y:.3}L{s:.3} {t:.3}")) {} }
    };
    let dot = |[x, y]: Point, r: &str| {
        html! { circle class=(class[1]) cx=(format!("{x:.3}")) cy=(format!("{y:.3}")) r=(r) {} }
    };
    match (kind, node) {
        (Kind::Edge, Some(p)) => line(corners[p], corners[(p + 1) % 4]),
        (Kind::Clearance | Kind::Overlap, _) => {
            let (a, b) = closest(corners, &units[of[1]]);
            line(a, b)
        }
        (Kind::LigamentClearance, Some(p)) => line(corners[p], closest(&[corners[p]], &units[of[1]]).1),
        (Kind::VoidAngle, Some(p)) => {
            // an arc's chord, drawn in the void beside the node
            let (here, next) = (corners[p], corners[(p + 1) % 4]);
            let along = [0, 1].map(|i| here[i] + 0.35 * (next[i] - here[i]));
            let (_, b) = closest(&[along], &units[of[1]]);
            line(along, if b == along { middle(&units[of[1]]) } else { b })
        }
        (_, Some(p)) => dot(corners[p], ".8"),
        (_, None) => dot(middle(corners), "1.2"),
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

#[cfg(test)]
pub(crate) mod tests {
    use metasense_worker::design::Active;

    use super::*;

    /// 3 × 3 rotated squares of 20°, pitch 15 mm, ligaments 2.25 mm long.
    pub fn squares() -> Drawing {
        squares_moved(|_, _| [0.0; 2])
    }

    /// The same with every joint, two corners and the ligament between them, moved: the one right of unit u by
    /// `shift(u, 0)`, the one above it by `shift(u, 1)`, and free corners by nothing.
    pub fn squares_moved(shift: impl Fn(usize, usize) -> [f64; 2]) -> Drawing {
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
        for &[(u, p), other] in &joints {
            let [x, y] = shift(u, p);
            for (unit, corner) in [(u, p), other] {
                let [cx, cy]: [f64; 2] = units[unit][corner];
                units[unit][corner] = [cx + x, cy + y];
            }
        }
        let corner = |(u, p): (usize, usize)| -> [f64; 2] {
            let unit: &[[f64; 2]; 4] = &units[u];
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

    /// A gap as a line between its units, an angle as a dot at its corner; y downward.
    #[test]
    fn what_holds_a_body_is_drawn_where_it_is() {
        let mut drawing = squares();
        let [x, y] = drawing.units[4][2];
        let held = |kind, units| Active { kind, units, node: 2, slack: 0.0 };
        drawing.active = vec![held(Kind::Clearance, [4, 5]), held(Kind::BlockAngleLow, [4, 4])];
        let drawn = body(&drawing, frame(&[&drawing]), "", Notes::default(), |_| Unit::default());
        let svg = drawn.marks.into_string();
        assert_eq!(svg.matches("class=\"active\"").count(), 1, "{svg}");
        let dot = format!("class=\"active-node\" cx=\"{x:.3}\" cy=\"{:.3}\"", -y);
        assert!(svg.contains(&dot), "{dot} is not in {svg}");
    }
}
