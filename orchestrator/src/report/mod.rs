//! From a database to one HTML file to look at: no network, no scripts but the animation's, both themes, phone and print.

mod alone;
pub mod answers;
pub mod body;
pub mod brains;
pub mod figures;
pub mod fit;
pub mod load;
pub mod modes;
pub mod plot;
pub mod records;
pub mod samples;
pub mod strips;

use std::fmt::Write as _;

pub use alone::standalone;
use answers::Answer;
pub use figures::Figure;
use plot::escape;

use crate::analysis::{Question, Terms, Trial};
use crate::look::{Table, number};
use crate::provenance::{self, Made};
use crate::store::Stored;
use serde_json::Value;

/// Everything that a report tells.
#[derive(Debug, Clone)]
pub struct Story {
    /// The sweeps, with their specs.
    pub sweeps: Vec<Sweep>,
    /// All trials with their states.
    pub settled: Table,
    /// Those that are done.
    pub trials: Vec<Trial>,
    /// By what code.
    pub made: Vec<Made>,
    /// The one that is replayed, where one is stored whole.
    pub stored: Option<Stored>,
    /// What a decision on M weighs.
    pub terms: Terms,
}

/// A sweep as the database knows it.
#[derive(Debug, Clone)]
pub struct Sweep {
    /// Its name.
    pub name: String,
    /// The spec file as it was written.
    pub text: String,
    /// Version of the program that began it.
    pub version: String,
    /// When.
    pub created_at: String,
}

/// The figures of a story, and why some are missing.
#[must_use]
pub fn figures(story: &Story, threads: usize) -> (Vec<Figure>, Option<String>) {
    let trials = &story.trials;
    let mut drawn: Vec<Figure> = [
        figures::pairs(trials),
        brains::figure(trials),
        figures::sensors(trials, story.terms),
        figures::placed_sensors(trials),
        figures::random_bodies(trials),
    ]
    .into_iter()
    .flatten()
    .collect();
    let replayed = match &story.stored {
        Some(stored) => samples::figures(stored, threads).map_err(|e| e.to_string()),
        None if trials.is_empty() => Err("no trial is done yet".into()),
        None => Err("no trial's designs are stored".into()),
    };
    let rest = [figures::losses(trials), figures::complexity(trials), figures::run_time(trials)];
    let (replayed, missing) = match replayed {
        Ok(figures) => (figures, None),
        Err(why) => (Vec::new(), Some(why)),
    };
    drawn.extend(replayed);
    drawn.extend(rest.into_iter().flatten());
    (drawn, missing)
}

/// The whole page.
#[must_use]
pub fn html(story: &Story, figures: &[Figure], missing: Option<&str>) -> String {
    let name = story.sweeps.iter().map(|s| s.name.as_str()).collect::<Vec<_>>().join(", ");
    let title = format!("metasense: {}", if name.is_empty() { "report" } else { &name });
    let mut content = format!(
        "<h1>{}</h1><p class=\"question\">Does training the body make sensing better, how many sensors are enough, and \
         what did it cost?</p>",
        escape(&title)
    );
    content.push_str(&summary(story));
    for figure in figures {
        content.push_str(&figure_html(figure));
    }
    if let Some(why) = missing {
        let _ = write!(
            content,
            "<p class=\"quiet\">Forces, samples, bodies and waves are not drawn: {}.</p>",
            escape(why)
        );
    }
    content.push_str("<h2>Tables</h2>");
    for question in [
        Question::Paired,
        Question::Brains,
        Question::Iterations,
        Question::Long,
        Question::Elbow,
        Question::Fewer,
        Question::Placements,
        Question::Placed,
        Question::Random,
        Question::Nonlinear,
        Question::Complexity,
        Question::TimeTo,
        Question::Seconds,
    ] {
        let table = question.answer(&story.trials, story.terms);
        if !table.rows.is_empty() && question.was_put(&story.trials) {
            let _ = write!(
                content,
                "<p class=\"quiet tables\">{}</p>{}",
                escape(question.title()),
                match table.sole_verdict() {
                    Some(verdict) => format!("<p>{}</p>", escape(verdict)),
                    None => table_html(&table.without_empty_columns()),
                }
            );
        }
    }
    let _ = write!(
        content,
        "<h2>Trials</h2>{}{}",
        table_html(&story.settled) + &beyond(&story.settled),
        download("trials", &story.settled)
    );
    content.push_str(&provenance(story));
    page(&title, &content)
}

/// A page of its own in the report's look.
fn page(title: &str, content: &str) -> String {
    include_str!("page.html")
        .replace("{{title}}", &escape(title))
        .replace("{{style}}", include_str!("figure.css"))
        .replace("{{content}}", content)
}

fn summary(story: &Story) -> String {
    let mut list = answer_list(&answers::answers(&story.trials, story.terms));
    let state = story.settled.columns.iter().position(|c| c == "state");
    let count = |name: &str| {
        state.map_or(0, |i| story.settled.rows.iter().filter(|r| r[i].as_str() == Some(name)).count())
    };
    let (done, failed, all) = (count("done"), count("failed"), story.settled.rows.len());
    let class = if failed > 0 { "bad" } else { "open" };
    let _ = write!(
        list,
        "<li class=\"{class}\">{done} of {all} trials are done, {failed} failed{}. Ratios are geometric means over trials, \
         their intervals over placements and seeds: trials that share these are not independent.</li>",
        if failed > 0 { " (reasons in the table of trials)" } else { "" }
    );
    if let Some(mixed) = provenance::mixed(&story.made) {
        let _ = write!(list, "<li class=\"bad\">{}.</li>", escape(&mixed));
    }
    list.push_str("</ul>");
    list
}

/// A list that is still open.
fn answer_list(answers: &[Answer]) -> String {
    let mut list = String::from("<ul class=\"answer\">");
    for (verdict, text) in answers {
        let class = match verdict {
            Some(true) => "good",
            Some(false) => "bad",
            None => "open",
        };
        let _ = write!(list, "<li class=\"{class}\">{}</li>", prose(text));
    }
    list
}

fn figure_html(figure: &Figure) -> String {
    let mut html = format!("<h2 id=\"{}\">{}</h2><figure>", figure.name, escape(&figure.title));
    if !figure.legend.is_empty() {
        html.push_str("<div class=\"legend\">");
        for (class, text) in &figure.legend {
            let _ = write!(html, "<span><i class=\"{class}\"></i>{}</span>", escape(text));
        }
        html.push_str("</div>");
    }
    let small = if figure.small { " small" } else { "" };
    let _ = write!(html, "<div class=\"plots{small}\">");
    for plot in &figure.plots {
        let wide = if plot.starts_with("<div class=\"wave\"") { " class=\"wide\"" } else { "" };
        let _ = write!(html, "<div{wide}>{plot}</div>");
    }
    let _ = write!(
        html,
        "</div><figcaption>{} {}</figcaption></figure>",
        prose(&figure.caption),
        download(figure.name, &figure.data)
    );
    html
}

/// Text whose units stay on the line of their numbers.
fn prose(text: &str) -> String {
    escape(text).replace(" %", "&nbsp;%").replace(" mm", "&nbsp;mm")
}

/// A link that holds a table as CSV.
fn download(name: &str, table: &Table) -> String {
    format!(
        "<a download=\"{name}.csv\" href=\"data:text/csv;charset=utf-8,{}\">data (CSV)</a>",
        percent(&table.shortened().csv())
    )
}

fn percent(text: &str) -> String {
    let mut out = String::with_capacity(text.len() * 3 / 2);
    for byte in text.bytes() {
        match byte {
            b'A'..=b'Z' | b'a'..=b'z' | b'0'..=b'9' | b'-' | b'.' | b'_' | b',' => out.push(byte as char),
            _ => drop(write!(out, "%{byte:02X}")),
        }
    }
    out
}

/// Rows of a table that the page shows; its data hold all.
const MOST_ROWS: usize = 1000;

/// How many rows a table has beyond those.
fn beyond(table: &Table) -> String {
    match table.rows.len().checked_sub(MOST_ROWS) {
        None | Some(0) => String::new(),
        Some(more) => format!("<p class=\"quiet\">… and {more} more, in the data.</p>"),
    }
}

fn table_html(table: &Table) -> String {
    let text: Vec<bool> =
        (0..table.columns.len()).map(|i| table.rows.iter().any(|r| r[i].is_string())).collect();
    let mut html = String::from("<div class=\"scroll\"><table><thead><tr>");
    for (column, text) in table.columns.iter().zip(&text) {
        let class = if *text { " class=\"text\"" } else { "" };
        let _ = write!(html, "<th{class}>{}</th>", escape(&column.replace('_', " ")));
    }
    html.push_str("</tr></thead><tbody>");
    let state = table.columns.iter().position(|c| c == "state");
    for row in table.rows.iter().take(MOST_ROWS) {
        let failed = state.is_some_and(|i| row[i] == "failed");
        html.push_str(if failed { "<tr class=\"failed\">" } else { "<tr>" });
        for (value, text) in row.iter().zip(&text) {
            let shown = match value {
                Value::Null => String::new(),
                Value::String(text) => escape(text),
                Value::Number(n) if n.is_f64() => number(n.as_f64().unwrap_or(f64::NAN)),
                other => other.to_string(),
            };
            let class = match (*text, shown.len() > 48) {
                (true, true) => " class=\"text wide\"",
                (true, false) => " class=\"text\"",
                _ => "",
            };
            let _ = write!(html, "<td{class}>{shown}</td>");
        }
        html.push_str("</tr>");
    }
    html.push_str("</tbody></table></div>");
    html
}

fn provenance(story: &Story) -> String {
    let mut html = String::from("<h2>Spec, versions, seeds</h2>");
    for Made { code, revisions, trials } in &story.made {
        let commits =
            if revisions.is_empty() { String::new() } else { format!(" (commit {})", revisions.join(", ")) };
        let _ = write!(html, "<p>Trials by code {}{}: {trials}.</p>", escape(code), escape(&commits));
    }
    let mut seeds: Vec<u64> = story.trials.iter().map(|t| t.cluster.seed).collect();
    seeds.sort_unstable();
    seeds.dedup();
    let seeds = seeds.iter().map(u64::to_string).collect::<Vec<_>>().join(", ");
    let _ = write!(
        html,
        "<p>Seeds of the trials that are done: {}. Bootstrap: {} replicates, seed {}. Report by metasense {}.</p>",
        if seeds.is_empty() { "none" } else { &seeds },
        crate::analysis::resample::REPLICATES,
        crate::analysis::resample::SEED,
        env!("CARGO_PKG_VERSION")
    );
    for sweep in &story.sweeps {
        let _ = write!(
            html,
            "<p>Sweep <b>{}</b>, begun {} by metasense {}:</p><pre>{}</pre>",
            escape(&sweep.name),
            escape(&sweep.created_at),
            escape(&sweep.version),
            escape(&sweep.text)
        );
    }
    html
}
