//! Plots: two axes, lines, bands, dots. Colours are classes and follow the theme, unlike those of plotting crates.

use maud::{Markup, PreEscaped, html};

use super::number::number;
use super::picture::{LETTER, Picture};

/// Scale of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// Linear.
    Linear,
    /// Logarithmic; values must be above 0.
    Log,
}

/// An axis.
#[derive(Debug, Clone)]
pub struct Axis {
    label: String,
    scale: Scale,
    range: [f64; 2],
    ticks: Vec<(f64, String)>,
}

impl Axis {
    /// An axis with some margin around all finite values (logarithmic: above 0).
    pub fn new(label: &str, scale: Scale, values: impl IntoIterator<Item = f64>) -> Self {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for v in values.into_iter().filter(|v| v.is_finite() && (scale == Scale::Linear || *v > 0.0)) {
            (low, high) = (low.min(v), high.max(v));
        }
        if low > high {
            (low, high) = (1.0, 2.0);
        }
        let range = match scale {
            Scale::Linear => {
                let air = if high > low { 0.04 * (high - low) } else { 0.5 * high.abs().max(1.0) };
                // an axis from 0 has no margin there
                [if low >= 0.0 && low - air <= 0.0 { low.min(0.0) } else { low - air }, high + air]
            }
            Scale::Log => {
                let air = (high / low).powf(0.06).max(1.08);
                [low / air, high * air]
            }
        };
        let ticks = match scale {
            Scale::Linear => linear_ticks(range),
            Scale::Log => log_ticks(range),
        };
        Self { label: label.into(), scale, range, ticks: numbered(ticks) }
    }

    /// With these ticks only.
    pub fn with_ticks(self, ticks: Vec<f64>) -> Self {
        self.with_names(numbered(ticks))
    }

    /// With these labels at these positions only.
    pub fn with_names(mut self, names: Vec<(f64, String)>) -> Self {
        self.ticks = names;
        self
    }

    /// Position of a value, 0 to 1.
    fn place(&self, value: f64) -> f64 {
        let [low, high] = self.range;
        match self.scale {
            Scale::Linear => (value - low) / (high - low),
            Scale::Log => (value.max(low * 1e-3) / low).ln() / (high / low).ln(),
        }
    }
}

fn numbered(ticks: Vec<f64>) -> Vec<(f64, String)> {
    ticks.into_iter().map(|t| (t, number(t))).collect()
}

fn linear_ticks([low, high]: [f64; 2]) -> Vec<f64> {
    let rough = (high - low) / 5.0;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|d| d * power).into_iter().find(|s| *s >= rough).unwrap_or(rough);
    if step == 0.0 || !step.is_finite() {
        return vec![low];
    }
    let first = (low / step).ceil() as i64;
    (first..).map(|i| i as f64 * step).take_while(|t| *t <= high).collect()
}

fn log_ticks([low, high]: [f64; 2]) -> Vec<f64> {
    let decades = (high / low).log10();
    if decades < 0.25 {
        return linear_ticks([low, high]);
    }
    let digits: &[f64] = match decades {
        d if d < 0.7 => &[1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0],
        d if d < 1.2 => &[1.0, 1.5, 2.0, 3.0, 5.0, 7.0],
        d if d < 3.0 => &[1.0, 2.0, 5.0],
        _ => &[1.0],
    };
    let powers = low.log10().floor() as i32..=high.log10().ceil() as i32;
    let all = powers.flat_map(|p| digits.iter().map(move |d| d * 10f64.powi(p)));
    all.filter(|t| (low..=high).contains(t)).collect()
}

/// A plot under construction.
#[derive(Debug, Clone)]
pub struct Plot {
    title: String,
    x: Axis,
    y: Axis,
    size: [f64; 2],
    right: f64,
    marks: String,
}

/// Margins for labels: left, right, top, bottom (px).
const MARGIN: [f64; 4] = [58.0, 12.0, 10.0, 40.0];
/// Least width of the axis beside notes (px): long notes widen the plot.
const LEAST_AXIS: f64 = 240.0;

impl Plot {
    /// An empty plot of default size.
    pub fn new(title: &str, x: Axis, y: Axis) -> Self {
        let marks = String::new();
        Self { title: title.into(), x, y, size: [400.0, 264.0], right: MARGIN[1], marks }
    }

    /// With another size (px).
    pub fn sized(mut self, width: f64, height: f64) -> Self {
        self.size = [width, height];
        self
    }

    /// With room on the right for notes at line ends.
    pub fn with_room<'a>(mut self, notes: impl IntoIterator<Item = &'a str>) -> Self {
        let longest = notes.into_iter().map(|note| note.chars().count()).max().unwrap_or(0);
        self.right = MARGIN[1].max(10.0 + LETTER * longest as f64);
        self.size[0] = self.size[0].max(MARGIN[0] + LEAST_AXIS + self.right);
        self
    }

    /// Position of a point (px).
    fn at(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let ([left, _, top, bottom], [width, height]) = (MARGIN, self.size);
        let (px, py) = (self.x.place(x), self.y.place(y));
        (left + px * (width - left - self.right), height - bottom - py * (height - top - bottom))
    }

    fn path(&self, points: impl IntoIterator<Item = (f64, f64)>) -> String {
        let finite = points.into_iter().filter(|p| p.0.is_finite() && p.1.is_finite());
        let places = finite.map(|point| self.at(point)).enumerate();
        places.map(|(i, (x, y))| format!("{}{x:.1} {y:.1}", if i == 0 { "M" } else { "L" })).collect()
    }

    fn add(&mut self, mark: Markup) {
        self.marks.push_str(&mark.0);
    }

    /// A line through points, in the style of a class.
    pub fn line(&mut self, class: &str, points: impl IntoIterator<Item = (f64, f64)>) {
        let d = self.path(points);
        if !d.is_empty() {
            self.add(html! { path class=(format!("line {class}")) d=(d) {} });
        }
    }

    /// The area between low and high values: (x, low, high).
    pub fn band(&mut self, class: &str, points: &[(f64, f64, f64)]) {
        let there = points.iter().map(|p| (p.0, p.2));
        let back = points.iter().rev().map(|p| (p.0, p.1));
        self.add(html! { path class=(format!("band {class}")) d=(self.path(there.chain(back)) + "Z") {} });
    }

    /// Dots with tooltips.
    pub fn dots(&mut self, class: &str, points: impl IntoIterator<Item = ((f64, f64), String)>) {
        self.circles(&format!("dot {class}"), "3.2", points);
    }

    /// Rings around points, with tooltips.
    pub fn rings(&mut self, points: impl IntoIterator<Item = ((f64, f64), String)>) {
        self.circles("ring", "5.5", points);
    }

    fn circles(&mut self, class: &str, r: &str, points: impl IntoIterator<Item = ((f64, f64), String)>) {
        for (point, text) in points {
            let (x, y) = self.at(point);
            self.add(html! {
                circle class=(class) cx=(format!("{x:.1}")) cy=(format!("{y:.1}")) r=(r) { title { (text) } }
            });
        }
    }

    /// A text beside the right end of a line: to its right if there is room, or else above.
    pub fn note(&mut self, point: (f64, f64), text: &str) {
        let (x, y) = self.at(point);
        let fits = x + 6.0 + LETTER * text.chars().count() as f64 <= self.size[0];
        let (x, y, anchor) = if fits { (x + 6.0, y + 4.0, "start") } else { (x, y - 5.0, "end") };
        self.add(label("note", [x, y], anchor, text));
    }

    /// A vertical line with a text at its right, at the top; without room there, at its left, at the bottom, away from falling
    /// curves. `row`: offset of the text in lines.
    pub fn vertical(&mut self, class: &str, x: f64, text: &str, row: usize) {
        let [_, _, top, bottom] = MARGIN;
        let px = self.at((x, self.y.range[0])).0;
        let fits = px + 4.0 + LETTER * text.chars().count() as f64 <= self.size[0];
        let (floor, down) = (self.size[1] - bottom, 13.0 * row as f64);
        let (at, y, anchor) =
            if fits { (px + 4.0, top + 10.0 + down, "start") } else { (px - 4.0, floor - 6.0 - down, "end") };
        let line = format!("M{px:.1} {floor:.1}V{top}");
        self.add(html! { path class=(format!("mark {class}")) d=(line) {} });
        self.add(label(&format!("note {class}"), [at, y], anchor, text));
    }

    /// The finished plot.
    pub fn picture(self) -> Picture {
        let ([left, _, top, bottom], [width, height]) = (MARGIN, self.size);
        let (right, floor) = (width - self.right, height - bottom);
        let middle = 0.5 * (top + floor);
        let marks = html! {
            @for (tick, name) in &self.x.ticks {
                @let x = self.at((*tick, self.y.range[0])).0;
                path class="grid" d=(format!("M{x:.1} {top}V{floor:.1}")) {}
                (label("tick", [x, floor + 14.0], "middle", name))
            }
            @for (tick, name) in &self.y.ticks {
                @let y = self.at((self.x.range[0], *tick)).1;
                path class="grid" d=(format!("M{left} {y:.1}H{right:.1}")) {}
                (label("tick", [left - 5.0, y + 3.5], "end", name))
            }
            path class="axis" d=(format!("M{left} {top}V{floor:.1}H{right:.1}")) {}
            (PreEscaped(&self.marks))
            (label("label", [0.5 * (left + right), height - 7.0], "middle", &self.x.label))
            g transform=(format!("rotate(-90 11 {middle:.1})")) { (label("label", [11.0, middle], "middle", &self.y.label)) }
        };
        Picture { title: self.title, class: "plot", view: [0.0, 0.0, width, height], marks }
    }
}

/// A text in a picture.
pub(super) fn label(class: &str, [x, y]: [f64; 2], anchor: &str, text: &str) -> Markup {
    html! { text class=(class) x=(format!("{x:.1}")) y=(format!("{y:.1}")) text-anchor=(anchor) { (text) } }
}

#[cfg(test)]
mod tests;
