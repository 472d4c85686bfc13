//! Pages: question and answers, then figures with data, then tables. No network access; the only script animates waves.

use std::fmt::{self, Display, Formatter, Write};

use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde_json::Value;

use super::number::number;
use super::picture::{Legend, Picture, keys};
use super::style::page_style;
use super::table::{Table, readable};

/// A figure: pictures side by side under one caption.
#[derive(Debug, Clone)]
pub struct Figure {
    /// Name of its files and anchor.
    pub name: &'static str,
    /// Heading.
    pub title: String,
    /// What was measured, and how to read it.
    pub caption: String,
    /// Legend of the marks.
    pub legend: Legend,
    /// Its pictures.
    pub pictures: Vec<Picture>,
    /// Animations, on pages only.
    pub moving: Option<Markup>,
    /// Whether pictures are small.
    pub small: bool,
    /// The plotted data (CSV).
    pub data: String,
}

/// An answer in words.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// Whether the answer is good or bad; `None`: neither, or undecided.
    pub verdict: Option<bool>,
    /// The sentence.
    pub text: String,
    /// The figure that it belongs to; empty: shown before all figures.
    pub figure: &'static str,
}

impl Answer {
    /// An answer.
    pub fn new(figure: &'static str, verdict: Option<bool>, text: String) -> Self {
        Self { verdict, text, figure }
    }
}

/// A complete page. Drops its possibly large `content` before returning.
pub fn page(title: &str, question: &str, content: Markup) -> String {
    let style = html! { style { (PreEscaped(page_style())) } };
    let body = html! { body { main { h1 { (title) } p class="question" { (question) } (content) } } };
    drop(content);
    document(title, &style, &body)
}

/// A complete HTML document; `head`: style and scripts.
pub fn document(title: &str, head: &Markup, body: &Markup) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) }
                (head)
            }
            (body)
        }
    }
    .into_string()
}

/// A list of answers.
pub fn answers<'a>(list: impl IntoIterator<Item = &'a Answer>) -> Markup {
    let class = |verdict| match verdict {
        Some(true) => "good",
        Some(false) => "bad",
        None => "open",
    };
    let mut list = list.into_iter().peekable();
    html! {
        @if list.peek().is_some() {
            ul class="answer" { @for answer in list { li class=(class(answer.verdict)) { (prose(&answer.text)) } } }
        }
    }
}

impl Figure {
    /// A figure with pictures of usual size and no animation.
    pub fn new(
        name: &'static str,
        title: &str,
        caption: impl Into<String>,
        legend: Legend,
        pictures: Vec<Picture>,
        data: Table,
    ) -> Self {
        let (title, caption) = (title.into(), caption.into());
        Self { name, title, caption, legend, pictures, moving: None, small: false, data: data.csv() }
    }

    /// As [`Self::new`]; `None` without pictures.
    pub fn some(
        name: &'static str,
        title: &str,
        caption: impl Into<String>,
        legend: Legend,
        pictures: Vec<Picture>,
        data: impl FnOnce() -> Table,
    ) -> Option<Self> {
        (!pictures.is_empty()).then(|| Self::new(name, title, caption, legend, pictures, data()))
    }

    /// With small pictures, and optionally an animation.
    pub fn small(self, moving: Option<Markup>) -> Self {
        Self { moving, small: true, ..self }
    }

    /// The figure on a page, below its answers from `said`.
    pub fn html(&self, said: &[Answer]) -> Markup {
        html! {
            h2 id=(self.name) { (self.title) }
            (answers(said.iter().filter(|answer| answer.figure == self.name)))
            figure {
                (keys(&self.legend))
                div class=(if self.small { "plots small" } else { "plots" }) {
                    @for picture in &self.pictures {
                        // widens wide plots, to keep their font size
                        @let wide = Some(picture.view[2]).filter(|width| picture.class == "plot" && *width > 400.0);
                        div class=[wide.map(|width| format!("broad w{:.0}", (width / 80.0).ceil().min(10.0)))] { h3 { (picture.title) } (picture.svg(None)) }
                    }
                    @if let Some(moving) = &self.moving { div class="wide" { (moving) } }
                }
                figcaption { (prose(&self.caption)) " " (download(self.name, &self.data)) }
            }
        }
    }
}

/// Text with non-breaking spaces before units; text between backticks becomes code.
pub fn prose(text: &str) -> Markup {
    let text = text.replace(" %", "\u{a0}%").replace(" mm", "\u{a0}mm");
    html! {
        @for (part, number) in text.split('`').zip(0..) {
            @if number % 2 == 1 { code { (part) } } @else { (part) }
        }
    }
}

/// Links to the figures of a page and to the sections that follow them: anchor and heading of each.
pub fn contents(figures: &[Figure], sections: &[[&str; 2]]) -> Markup {
    let of_figures = figures.iter().map(|figure| [figure.name, &figure.title]);
    html! {
        ol class="quiet contents" {
            @for [anchor, title] in of_figures.chain(sections.iter().copied()) { li { a href={ "#" (anchor) } { (title) } } }
        }
    }
}

/// A link that contains a table as CSV.
pub fn download(name: &str, csv: &str) -> Markup {
    html! { a download=(format!("{name}.csv")) href={ "data:text/csv;charset=utf-8," (Encoded(csv)) } { "data (CSV)" } }
}

/// Percent-encoded text for an address.
pub struct Encoded<'a>(pub &'a str);

impl Display for Encoded<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let kept = |byte: u8| byte.is_ascii_alphanumeric() || b"-._,".contains(&byte);
        self.0.bytes().try_for_each(|byte| match kept(byte) {
            true => f.write_char(byte as char),
            false => write!(f, "%{byte:02X}"),
        })
    }
}

/// A note on the number of rows that a page omits.
pub fn omitted_rows_note(all: usize) -> Markup {
    html! { @if all > MOST_ROWS { p class="quiet" { "… and " (all - MOST_ROWS) " more, in the data." } } }
}

/// Greatest number of rows that a page shows; the CSV data contain all.
pub const MOST_ROWS: usize = 1000;

impl Table {
    /// The table on a page; with a `name`, also its CSV data.
    pub fn html(&self, name: Option<&str>) -> Markup {
        self.linked(name, |_, _| None)
    }

    /// As [`Self::html`], with links: `to` returns the address for a column and value.
    pub fn linked(&self, name: Option<&str>, to: impl Fn(&str, &Value) -> Option<String>) -> Markup {
        let text = |column: usize| self.rows.iter().any(|row| row[column].is_string());
        let text: Vec<bool> = (0..self.columns.len()).map(text).collect();
        let class = |text: bool, length: usize| match (text, length > 30) {
            (true, true) => Some("text wide"),
            (true, false) => Some("text"),
            _ => None,
        };
        let state = self.columns.iter().position(|column| column == "state");
        html! {
            div class="scroll" {
                table {
                    thead { tr { @for (column, text) in self.columns.iter().zip(&text) {
                        th class=[class(*text, 0)] { (column.replace('_', " ")) }
                    } } }
                    tbody { @for row in self.rows.iter().take(MOST_ROWS) {
                        tr class=[state.filter(|i| row[*i] == "failed").map(|_| "failed")] {
                            @for ((value, text), column) in row.iter().zip(&text).zip(&self.columns) {
                                @let shown = readable(value, number);
                                td class=[class(*text, shown.len())] {
                                    @match to(column, value) {
                                        Some(address) => a href=(address) { (shown) },
                                        None => (shown),
                                    }
                                }
                            }
                        }
                    } }
                }
            }
            (omitted_rows_note(self.rows.len()))
            @if let Some(name) = name { (download(name, &self.csv())) }
        }
    }
}
