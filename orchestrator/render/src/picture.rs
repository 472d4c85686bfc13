//! A picture: an SVG element with a title, for pages and files.

use maud::{Markup, PreEscaped, html};

use super::style::{LEVELS, file_style};

/// Entries of a legend: the class of a mark, and its text.
pub type Legend = Vec<(&'static str, String)>;

/// Entries of a legend.
pub fn legend(entries: &[(&'static str, &str)]) -> Legend {
    entries.iter().map(|(class, text)| (*class, (*text).to_owned())).collect()
}

/// A picture.
#[derive(Debug, Clone)]
pub struct Picture {
    /// Heading and accessible name.
    pub title: String,
    /// CSS class, the kind of picture.
    pub class: &'static str,
    /// Left, top, width and height of the view box.
    pub view: [f64; 4],
    /// SVG elements.
    pub marks: Markup,
}

impl Picture {
    /// Whether the picture contains marks of a legend entry. Always true except for plots, whose marks have the legend's class names.
    pub fn shows(&self, key: &str) -> bool {
        let mut classes = self.marks.0.split("class=\"").skip(1).filter_map(|mark| mark.split('"').next());
        let name = key.rsplit(' ').next().unwrap_or(key);
        self.class != "plot" || classes.any(|class| class.split(' ').any(|word| word == name))
    }

    /// The SVG element; `place`: left, top, width, height within another.
    pub fn svg(&self, place: Option<[f64; 4]>) -> Markup {
        let side = |i: usize| place.map(|p| format!("{:.1}", p[i]));
        let view = self.view.map(|x| format!("{x:.2}")).join(" ");
        html! {
            svg class=(self.class) x=[side(0)] y=[side(1)] width=[side(2)] height=[side(3)]
                viewBox=(view) role="img" aria-label=(self.title) { (self.marks) }
        }
    }
}

/// Height of a text line and width of a letter (px).
const LINE: f64 = 17.0;
pub(super) const LETTER: f64 = 6.2;
/// Width and height of a legend's mark (px).
const MARK: [f64; 2] = [22.0, 10.0];

/// An SVG file of this width (px): the legend, then pictures in rows of `columns`.
pub fn file(pictures: &[Picture], columns: usize, width: f64, legend: &Legend) -> String {
    let (mut x, mut top) = (width, 0.0);
    let mut keys = Vec::new();
    for (class, text) in legend {
        let needs = MARK[0] + 20.0 + LETTER * text.chars().count() as f64;
        if x + needs > width {
            (x, top) = (4.0, top + LINE);
        }
        keys.push(html! {
            g transform=(format!("translate({x:.0} {:.0})", top - LINE + 4.0)) {
                (mark(class)) text x=(MARK[0] + 6.0) y="9" { (text) }
            }
        });
        x += needs;
    }
    let wide = width / columns as f64;
    let mut cells = Vec::new();
    for row in pictures.chunks(columns) {
        let titles: Vec<_> = row.iter().map(|p| lines(&p.title, (wide / LETTER) as usize)).collect();
        let head = LINE * titles.iter().map(Vec::len).max().unwrap_or(0) as f64;
        let height = |p: &Picture| wide * p.view[3] / p.view[2];
        for (i, (picture, title)) in row.iter().zip(titles).enumerate() {
            let left = i as f64 * wide;
            cells.push(html! {
                @for (line, text) in title.iter().enumerate() {
                    text class="title" x=(format!("{:.1}", left + 4.0))
                        y=(format!("{:.1}", top + LINE * (line + 1) as f64 - 4.0)) { (text) }
                }
                (picture.svg(Some([left, top + head, wide, height(picture)])))
            });
        }
        top += head + row.iter().map(height).fold(0.0, f64::max) + 4.0;
    }
    let label = pictures.iter().map(|p| p.title.as_str()).collect::<Vec<_>>().join("; ");
    html! {
        svg xmlns="http://www.w3.org/2000/svg" viewBox=(format!("0 0 {width:.0} {top:.0}"))
            role="img" aria-label=(label) {
            style { (PreEscaped(file_style())) }
            rect class="page" width="100%" height="100%" {}
            @for key in keys { (key) }
            @for cell in cells { (cell) }
        }
    }
    .into_string()
}

/// Wraps a text to `most` letters per line where words allow; empty for an empty text.
pub fn lines(text: &str, most: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= most => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

/// A legend on a page.
pub(super) fn keys(legend: &Legend) -> Markup {
    html! {
        @if !legend.is_empty() {
            div class="legend" {
                @for (class, text) in legend {
                    span {
                        svg class="key" viewBox=(format!("0 0 {} {}", MARK[0], MARK[1])) aria-hidden="true" { (mark(class)) }
                        (text)
                    }
                }
            }
        }
    }
}

/// The mark of a legend entry.
fn mark(class: &str) -> Markup {
    html! {
        @match class.split_once(' ').map_or(class, |(kind, _)| kind) {
            "speed" => {
                @for i in 0..=4 {
                    rect class=(format!("s{}", i * LEVELS / 4)) x=(4.4 * f64::from(i as u8)) y="1" width="4.4" height="8" {}
                }
            }
            "arrow" => { g class="panel" { path d="M0 5H15" {} polygon points="14,1.5 14,8.5 22,5" {} } }
            "unit" => { rect class=(class) x="4" y="1" width="14" height="8" {} }
            "dot" => { circle class=(class) cx="11" cy="5" r="4" {} }
            "ring" => { circle class=(class) cx="11" cy="5" r="4.5" {} }
            "active" | "wrong" => { path class=(class) d="M0 5H22" {} }
            _ => { path class=(format!("line {class}")) d="M0 5H22" {} }
        }
    }
}

#[cfg(test)]
mod tests;
