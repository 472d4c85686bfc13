//! Pictures of bodies: units, ligaments, active and violated constraints, panels with force directions, sensors.

use maud::{Markup, html};

use super::picture::{Legend, Picture, file};

/// x and y (mm).
pub type Position = [f64; 2];

/// Bounding box of a picture: left, top, width, height (mm), y downward.
pub type ViewBox = [f64; 4];

/// A body to be drawn; lengths in mm, y upward.
#[derive(Debug, Clone, Default)]
pub struct Sketch {
    /// Corners of every unit.
    pub units: Vec<Vec<Position>>,
    /// Centroids of the units.
    pub centroids: Vec<Position>,
    /// Ends of every ligament.
    pub ligaments: Vec<[Position; 2]>,
    /// The two corners (unit, node) that each ligament joins.
    pub joints: Vec<[(usize, usize); 2]>,
    /// Input panels, as arrows.
    pub panels: Vec<Arrow>,
    /// Units that carry sensors.
    pub sensors: Vec<usize>,
    /// Clamped units.
    pub clamped: Vec<usize>,
    /// Guided units.
    pub guided: Vec<usize>,
    /// Active constraints.
    pub held: Vec<Mark>,
    /// Violated constraints.
    pub broken: Vec<Mark>,
    /// Units that violate a constraint as a whole.
    pub violating_units: Vec<usize>,
    /// Spacing of the grid.
    pub spacing: f64,
}

/// An input panel, with the effect of a positive force.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrow {
    /// The unit.
    pub unit: usize,
    /// Where the force acts (mm, y upward).
    pub foot: Position,
    /// Unit vector of the force; `None`: a couple.
    pub direction: Option<[f64; 2]>,
    /// Sign of a couple: 1 is anticlockwise.
    pub sense: f64,
}

/// Position of a constraint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Mark {
    /// Between two points.
    Line(Position, Position),
    /// At a point, with the dot's radius.
    Dot(Position, f64),
}

/// A frame around all these bodies, for equal scales.
pub fn frame<'a>(bodies: impl IntoIterator<Item = &'a Sketch>) -> ViewBox {
    let (mut low, mut high, mut spacing) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2], None);
    for sketch in bodies {
        spacing.get_or_insert(sketch.spacing);
        for corner in sketch.units.iter().flatten() {
            for i in 0..2 {
                low[i] = low[i].min(corner[i]);
                high[i] = high[i].max(corner[i]);
            }
        }
    }
    let air = 0.75 * spacing.unwrap_or(1.0);
    [low[0] - air, -high[1] - air, high[0] - low[0] + 2.0 * air, high[1] - low[1] + 2.0 * air]
}

/// Appearance of a unit.
#[derive(Debug, Clone, Default)]
pub struct UnitStyle {
    /// Class instead of the default.
    pub class: Option<String>,
    /// SVG transform.
    pub transform: Option<String>,
    /// CSS style.
    pub style: Option<String>,
}

/// What is numbered in a body. Numbered bodies have a scale bar.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Numbering {
    /// Nothing.
    None,
    /// Units.
    Units,
    /// Units, nodes and sensors.
    All,
}

/// Font size of a number in `figure.css` (mm).
const INDEX: f64 = 2.2;

/// Shift of a node's number towards the middle of its unit, as a fraction of their distance.
const INWARD: f64 = 0.25;

impl Sketch {
    /// The body with default units.
    pub fn picture(&self, view: ViewBox, title: &str, numbers: Numbering) -> Picture {
        self.drawn(view, title, numbers, |_| UnitStyle::default())
    }

    /// The body.
    pub fn drawn(
        &self,
        view: ViewBox,
        title: &str,
        numbers: Numbering,
        unit: impl Fn(usize) -> UnitStyle,
    ) -> Picture {
        let size = if numbers == Numbering::All { 0.147 } else { 0.18 } * self.spacing;
        let bar = 10f64.powf(self.spacing.log10().floor());
        let [left, floor] = [view[0] + 0.5 * self.spacing, view[1] + view[3] - 0.25 * self.spacing];
        let index = |x: f64, y: f64, text: &str| {
            let place = format!("translate({x:.2} {y:.2}) scale({:.3})", size / INDEX);
            html! { text class="index" transform=(place) { (text) } }
        };
        let class = |u: usize| {
            let support = match (self.clamped.contains(&u), self.guided.contains(&u)) {
                (true, _) => " clamped",
                (_, true) => " guided",
                _ => "",
            };
            format!("unit{support}{}", if self.violating_units.contains(&u) { " broken" } else { "" })
        };
        let marks = html! {
            @for [[ax, ay], [bx, by]] in &self.ligaments {
                path class="ligament" d=(format!("M{ax:.3} {:.3}L{bx:.3} {:.3}", -ay, -by)) {}
            }
            @for (u, corners) in self.units.iter().enumerate() {
                @let points = corners.iter().map(|[x, y]| format!("{x:.3},{:.3}", -y)).collect::<Vec<_>>().join(" ");
                @let UnitStyle { class: other, transform, style } = unit(u);
                polygon class=(other.unwrap_or_else(|| class(u))) points=(points) transform=[transform] style=[style] {}
            }
            @for at in &self.held { (mark(at, ["active", "active-node"])) }
            @for at in &self.broken { (mark(at, ["wrong", "wrong-node"])) }
            @if numbers != Numbering::None {
                @for (u, corners) in self.units.iter().enumerate() {
                    @let [x, y] = middle(corners);
                    // above a sensor's disc
                    @let down = if self.sensors.contains(&u) { -0.2 * self.spacing } else { 0.32 * size };
                    (index(x, down - y, &u.to_string()))
                }
                path class="scale" d=(format!("M{left:.3} {floor:.3}h{bar}")) {}
                (index(left + 0.5 * bar, floor - 0.4 * size, &format!("{bar} mm")))
            }
            @if numbers == Numbering::All {
                @for corners in &self.units {
                    @let [x, y] = middle(corners);
                    @for (p, q) in corners.iter().enumerate() {
                        @let [at_x, at_y] = [q[0] + INWARD * (x - q[0]), q[1] + INWARD * (y - q[1])];
                        text class="index node" x=(format!("{at_x:.2}")) y=(format!("{:.2}", 0.4 - at_y)) { (p) }
                    }
                }
            }
            (panels_and_sensors(self, numbers))
        };
        Picture { title: title.into(), class: "body", view, marks }
    }

    /// An SVG file of the body with ligaments of this width (mm) and all numbers, without active constraints.
    pub fn file(mut self, title: &str, width: f64) -> String {
        self.held.clear();
        let mut picture = self.picture(frame([&self]), title, Numbering::All);
        picture.marks =
            html! { style { ".body .ligament{stroke-width:" (format!("{width:.3}")) "}" } (picture.marks) };
        file(&[picture], 1, 640.0, &Legend::default())
    }

    /// Legend of the visible elements, with their numbers.
    pub fn legend(&self) -> Legend {
        let kinds = [
            (self.clamped.len(), "unit clamped", "clamped unit", "clamped units"),
            (self.guided.len(), "unit guided", "guided unit", "guided units"),
            (self.panels.len(), "arrow", "input panel", "input panels"),
            (self.sensors.len(), "dot sensor", "sensor", "sensors"),
            (self.held.len(), "active", "constraint at its limit", "constraints at their limit"),
            (self.broken.len(), "wrong", "violated constraint", "violated constraints"),
        ];
        let told = |(n, class, one, many)| (class, format!("{n} {}", if n == 1 { one } else { many }));
        kinds.into_iter().filter(|kind| kind.0 > 0).map(told).collect()
    }
}

/// Arrows at the panels and dots at the sensors.
fn panels_and_sensors(sketch: &Sketch, numbers: Numbering) -> Markup {
    let pitch = sketch.spacing;
    let arrow = |panel: &Arrow| {
        // the arrow ends at the point of action, or before a number there
        let [x, y] = panel.foot;
        let Some([dx, dy]) = panel.direction.map(|[dx, dy]| [dx, -dy]) else {
            return turning(panel.sense, [x, -y], pitch);
        };
        let before =
            if numbers != Numbering::None && panel.foot == sketch.centroids[panel.unit] { 0.5 } else { 0.0 };
        let at = |along: f64, aside: f64| {
            let along = along - before;
            [x + pitch * (along * dx - aside * dy), -y + pitch * (along * dy + aside * dx)]
        };
        let ([a, b], [c, d]) = (at(0.5 * before - 0.95, 0.0), at(-0.3, 0.0));
        let tip = [at(-0.3, 0.14), at(-0.3, -0.14), at(0.0, 0.0)].map(|[x, y]| format!("{x:.2},{y:.2}"));
        (format!("M{a:.2} {b:.2}L{c:.2} {d:.2}"), tip.join(" "))
    };
    html! {
        @for (k, panel) in sketch.panels.iter().enumerate() {
            @let (shaft, tip) = arrow(panel);
            g class="panel" { title { "panel " (k) ": unit " (panel.unit) } path d=(shaft) {} polygon points=(tip) {} }
        }
        @for (m, &unit) in sketch.sensors.iter().enumerate() {
            @let [x, y] = sketch.centroids[unit];
            circle class="sensor" cx=(format!("{x:.2}")) cy=(format!("{:.2}", -y)) r=(format!("{:.2}", 0.17 * pitch)) {
                title { "sensor " (m) ": unit " (unit) }
            }
            @if numbers == Numbering::All {
                text class="number" x=(format!("{x:.2}")) y=(format!("{:.2}", 1.0 - y)) { (m) }
            }
        }
    }
}

/// Three quarters of a circle around a point, and its tip; anticlockwise if `sense` is 1.
fn turning(sense: f64, [x, y]: Position, pitch: f64) -> (String, String) {
    let r = 0.36 * pitch;
    let at = |along: f64, aside: f64| format!("{:.2},{:.2}", x + sense * aside * pitch, y + along * pitch);
    let (from, sweep, top) = (x - sense * r, if sense > 0.0 { 0 } else { 1 }, y - r);
    let shaft = format!("M{from:.2} {y:.2}A{r:.2} {r:.2} 0 1 {sweep} {x:.2} {top:.2}");
    (shaft, [at(-0.5, 0.05), at(-0.22, 0.05), at(-0.36, -0.25)].join(" "))
}

/// A mark, with a class for lines or for dots.
fn mark(at: &Mark, [line, dot]: [&str; 2]) -> Markup {
    match at {
        Mark::Line([x, y], [s, t]) => {
            html! { path class=(line) d=(format!("M{x:.3} {:.3}L{s:.3} {:.3}", -y, -t)) {} }
        }
        Mark::Dot([x, y], r) => {
            html! { circle class=(dot) cx=(format!("{x:.3}")) cy=(format!("{:.3}", -y)) r=(r) {} }
        }
    }
}

/// The mean of a unit's corners.
pub fn middle(corners: &[Position]) -> Position {
    [0, 1].map(|c| corners.iter().map(|q| q[c]).sum::<f64>() / corners.len() as f64)
}
