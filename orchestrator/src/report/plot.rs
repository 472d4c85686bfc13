//! A small SVG plot: two axes, lines, bands, points. Colours are CSS classes, so that it follows the page's theme.

use std::fmt::Write as _;

use crate::look::number;

/// How an axis runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// Evenly.
    Linear,
    /// By factors; values must be above 0.
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
    /// An axis that holds all finite values (of a logarithmic one: all above 0), with a little air.
    #[must_use]
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
                // An axis that starts at nothing starts there exactly.
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

    /// With these ticks and no others.
    #[must_use]
    pub fn with_ticks(self, ticks: Vec<f64>) -> Self {
        self.with_names(numbered(ticks))
    }

    /// With these texts at these places and no others.
    #[must_use]
    pub fn with_names(mut self, names: Vec<(f64, String)>) -> Self {
        self.ticks = names;
        self
    }

    /// Where a value lies, 0 to 1.
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
    powers
        .flat_map(|p| digits.iter().map(move |d| d * 10f64.powi(p)))
        .filter(|t| (low..=high).contains(t))
        .collect()
}

/// Text that is safe inside HTML and SVG.
#[must_use]
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// A plot in the making.
#[derive(Debug, Clone)]
pub struct Plot {
    title: String,
    x: Axis,
    y: Axis,
    size: [f64; 2],
    marks: String,
}

/// Room for tick labels and axis labels: left, right, top, bottom.
const MARGIN: [f64; 4] = [52.0, 12.0, 26.0, 40.0];

impl Plot {
    /// An empty plot of the usual size.
    #[must_use]
    pub fn new(title: &str, x: Axis, y: Axis) -> Self {
        Self { title: title.into(), x, y, size: [400.0, 280.0], marks: String::new() }
    }

    /// Of another size (px).
    #[must_use]
    pub fn sized(mut self, width: f64, height: f64) -> Self {
        self.size = [width, height];
        self
    }

    fn at(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let [left, right, top, bottom] = MARGIN;
        let [width, height] = self.size;
        let (px, py) = (self.x.place(x), self.y.place(y));
        (left + px * (width - left - right), height - bottom - py * (height - top - bottom))
    }

    fn path(&self, points: impl IntoIterator<Item = (f64, f64)>) -> String {
        let mut path = String::new();
        for point in points.into_iter().filter(|p| p.0.is_finite() && p.1.is_finite()) {
            let (x, y) = self.at(point);
            let _ = write!(path, "{}{x:.1} {y:.1}", if path.is_empty() { "M" } else { "L" });
        }
        path
    }

    /// A line through points, in the style of a class.
    pub fn line(&mut self, class: &str, points: impl IntoIterator<Item = (f64, f64)>) {
        let path = self.path(points);
        let _ = write!(self.marks, "<path class=\"line {class}\" d=\"{path}\"/>");
    }

    /// The area between lows and highs: (x, low, high).
    pub fn band(&mut self, class: &str, points: &[(f64, f64, f64)]) {
        let there = points.iter().map(|p| (p.0, p.2));
        let back = points.iter().rev().map(|p| (p.0, p.1));
        let path = self.path(there.chain(back));
        let _ = write!(self.marks, "<path class=\"band {class}\" d=\"{path}Z\"/>");
    }

    /// Dots, each with a text that shows when pointed at.
    pub fn dots(&mut self, class: &str, points: impl IntoIterator<Item = ((f64, f64), String)>) {
        self.circles(&format!("dot {class}"), 3.2, points);
    }

    /// Circles around points, each with such a text.
    pub fn rings(&mut self, class: &str, points: impl IntoIterator<Item = ((f64, f64), String)>) {
        self.circles(class, 5.5, points);
    }

    fn circles(&mut self, class: &str, r: f64, points: impl IntoIterator<Item = ((f64, f64), String)>) {
        for (point, text) in points {
            let (x, y) = self.at(point);
            let _ = write!(
                self.marks,
                "<circle class=\"{class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{r}\"><title>{}</title></circle>",
                escape(&text)
            );
        }
    }

    /// A text beside the right end of a line: behind it where there is room, or else above.
    pub fn note(&mut self, point: (f64, f64), text: &str) {
        let (x, y) = self.at(point);
        let fits = x + 6.0 + 6.5 * text.chars().count() as f64 <= self.size[0];
        let (x, y, anchor) = if fits { (x + 6.0, y + 4.0, "start") } else { (x, y - 5.0, "end") };
        let _ = write!(
            self.marks,
            "<text class=\"note\" x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{}</text>",
            escape(text)
        );
    }

    /// A vertical line across the plot with a text at its top, `row` lines down.
    pub fn vertical(&mut self, class: &str, x: f64, text: &str, row: usize) {
        let [_, _, top, bottom] = MARGIN;
        let px = self.at((x, self.y.range[0])).0;
        let (low, high) = (self.size[1] - bottom, top);
        let fits = px + 4.0 + 6.5 * text.chars().count() as f64 <= self.size[0];
        let (at, anchor) = if fits { (px + 4.0, "start") } else { (px - 4.0, "end") };
        let _ = write!(
            self.marks,
            "<path class=\"mark {class}\" d=\"M{px:.1} {low:.1}L{px:.1} {high:.1}\"/>\
             <text class=\"note {class}\" x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"{anchor}\">{}</text>",
            high + 10.0 + 13.0 * row as f64,
            escape(text)
        );
    }

    /// The finished SVG element.
    #[must_use]
    pub fn svg(&self) -> String {
        let [left, right, top, bottom] = MARGIN;
        let [width, height] = self.size;
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"plot\" viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{}\">",
            escape(&self.title)
        );
        let _ = write!(svg, "<text class=\"title\" x=\"{left}\" y=\"16\">{}</text>", escape(&self.title));
        for (tick, name) in &self.x.ticks {
            let x = self.at((*tick, self.y.range[0])).0;
            let _ = write!(
                svg,
                "<path class=\"grid\" d=\"M{x:.1} {top}V{:.1}\"/><text class=\"tick\" x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                height - bottom,
                height - bottom + 14.0,
                escape(name)
            );
        }
        for (tick, name) in &self.y.ticks {
            let y = self.at((self.x.range[0], *tick)).1;
            let _ = write!(
                svg,
                "<path class=\"grid\" d=\"M{left} {y:.1}H{:.1}\"/><text class=\"tick\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                width - right,
                left - 5.0,
                y + 3.5,
                escape(name)
            );
        }
        let _ = write!(
            svg,
            "<path class=\"axis\" d=\"M{left} {top}V{:.1}H{:.1}\"/>{}",
            height - bottom,
            width - right,
            self.marks
        );
        let _ = write!(
            svg,
            "<text class=\"label\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            0.5 * (left + width - right),
            height - 7.0,
            escape(&self.x.label)
        );
        let middle = 0.5 * (top + height - bottom);
        let _ = write!(
            svg,
            "<text class=\"label\" x=\"11\" y=\"{middle:.1}\" text-anchor=\"middle\" transform=\"rotate(-90 11 {middle:.1})\">{}</text></svg>",
            escape(&self.y.label)
        );
        svg
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_lie_within_the_axis_and_are_few() {
        for (scale, low, high) in [
            (Scale::Linear, 0.0, 1.0),
            (Scale::Log, 4.0, 31.0),
            (Scale::Log, 1.0, 1e4),
            (Scale::Log, 20.0, 24.0),
            (Scale::Log, 89.0, 103.0),
        ] {
            let axis = Axis::new("", scale, [low, high]);
            assert!((2..=9).contains(&axis.ticks.len()), "{low} {high}: {:?}", axis.ticks);
            assert!(axis.ticks.iter().all(|t| (0.0..=1.0).contains(&axis.place(t.0))), "{:?}", axis.ticks);
        }
    }

    #[test]
    fn text_cannot_leave_its_element() {
        let plot = Plot::new("<a>&\"", Axis::new("", Scale::Linear, []), Axis::new("", Scale::Linear, []));
        assert!(plot.svg().contains("&lt;a&gt;&amp;&quot;") && !plot.svg().contains("<a>"));
    }
}
