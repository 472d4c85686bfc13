//! Writes the results of a database into one HTML file: no network, no scripts but the animation's, both themes, phone and print.

pub mod answers;
pub mod body;
pub mod brains;
pub mod casts;
pub mod check;
pub mod claims;
pub mod figures;
pub mod fit;
pub mod load;
pub mod modes;
pub mod records;
pub mod samples;
pub mod search;
pub mod strips;
mod tasks;
mod transfer;
mod words;

use maud::{Markup, PreEscaped, html};

use crate::analysis::numbers::{distinct, in_order};
use crate::analysis::resample::{REPLICATES, SEED};
use crate::analysis::{DecisionTerms, Question, Trial};
use crate::look::wave::SCRIPT;
use crate::look::{Answer, Figure, Table, answers as listed, contents, download, omitted_rows_note, page};
use crate::reader::{CodeVersion, StoredTrial};

/// All data of a report.
#[derive(Debug, Default)]
pub struct ReportData {
    /// The sweeps, with their specs.
    pub sweeps: Vec<StoredSweep>,
    /// State of all trials.
    pub states: States,
    /// Finished trials.
    pub trials: Vec<Trial>,
    /// The code that computed them.
    pub code_versions: Vec<CodeVersion>,
    /// Caveats about the numbers.
    pub caveats: Vec<String>,
    /// The replayed trial, if one is stored whole.
    pub stored: Option<StoredTrial>,
    /// Terms of the decision on M.
    pub terms: DecisionTerms,
    /// Searches for a design, or why one cannot be evaluated.
    pub searches: Vec<Result<search::SearchState, String>>,
}

/// Numbers of trials, and the rows that are shown.
#[derive(Debug, Clone, Default)]
pub struct States {
    /// Number of trials.
    pub all: usize,
    /// Number of finished trials.
    pub done: usize,
    /// Number of failed trials without cancelled ones.
    pub failed: usize,
    /// The rows that a page shows.
    pub first: Table,
    /// All rows as CSV.
    pub csv: String,
}

/// A sweep in the database.
#[derive(Debug, Clone, Default)]
pub struct StoredSweep {
    /// Its name.
    pub name: String,
    /// Text of the spec file.
    pub text: String,
    /// Version of the program that started it.
    pub version: String,
    /// Time of its start.
    pub created_at: String,
    /// Whether it has a `[goal]`.
    pub searched: bool,
}

/// The figures of a story, and why some are missing.
pub fn figures(story: &ReportData, threads: usize) -> (Vec<Figure>, Option<String>) {
    let trials = &story.trials;
    let first = [
        search::figure(&story.searches),
        figures::pairs(trials),
        brains::figure(trials),
        casts::figure(trials),
        transfer::figure(trials),
        tasks::figure(trials),
        figures::sensors(trials, story.terms),
        figures::placed_sensors(trials),
        figures::random_bodies(trials),
    ];
    let mut drawn: Vec<Figure> = first.into_iter().flatten().collect();
    let replayed = match &story.stored {
        Some(stored) if !stored.spec().body.kind.is_polygons() => {
            Ok(body::drawn(stored).into_iter().collect())
        }
        Some(stored) => samples::Replayed::new(stored, threads)
            .and_then(|replayed| replayed.figures(None))
            .map_err(|e| e.to_string()),
        None if trials.is_empty() => Err("no trial is done yet".into()),
        None => Err("no trial's designs are stored".into()),
    };
    let rest = [figures::losses(trials), figures::complexity(trials), figures::run_time(trials)];
    let missing = replayed.as_ref().err().cloned();
    drawn.extend(replayed.into_iter().flatten().chain(rest.into_iter().flatten()));
    (drawn, missing)
}

/// Definition of an error, at the top of the page.
const RATIO_OF_ENERGIES: &str = "An error is a ratio of energies, 100·Σ(f − f̂)²/Σf² per sample, averaged over samples: an error of \
    5.7 % is an RMS error of 24 %. A median is over the same samples and is robust against a few large errors.";

/// Explains the symbols of labels and tables.
pub const K_AND_M: &str = "K is the number of forces, one per input panel; M is the number of sensors.";

/// The whole page.
pub fn html(story: ReportData, figures: &[Figure], missing: Option<&str>) -> String {
    let names = in_order(story.sweeps.iter().map(|s| s.name.as_str()));
    let title = format!("metasense: {}", if names.is_empty() { "report".into() } else { names.join(", ") });
    let states = &story.states;
    let mut said = search::answers(&story.searches);
    said.extend(answers::answers(&story.trials, story.terms));
    let drawn = |answer: &&Answer| figures.iter().any(|figure| figure.name == answer.figure);
    let first = said.iter().filter(|answer| !drawn(answer));
    // the data of figures answer these questions
    let drawn_alone = [Question::Sensors, Question::Sizes, Question::Front];
    let told = Question::all().iter().filter(|q| !drawn_alone.contains(q) && q.was_put(&story.trials));
    let tables = told.map(|q| (q, q.answer(&story.trials, story.terms)));
    let content = html! {
        p { (RATIO_OF_ENERGIES) " " (K_AND_M) }
        (listed(first.chain(&state(&story))))
        (contents(figures, &[TABLES, TRIALS, PROVENANCE]))
        @for figure in figures { (figure.html(&said)) }
        @if let Some(why) = missing {
            p class="quiet" { "Figures of forces, samples, bodies and waves are missing: " (why) "." }
        }
        h2 id=(TABLES[0]) { (TABLES[1]) }
        @for (question, table) in tables.filter(|(_, table)| !table.rows.is_empty()) {
            p class="quiet tables" { (question.title()) }
            @match table.sole_verdict() {
                Some(verdict) => p { (verdict) },
                None => (table.without_empty_columns().html(None)),
            }
        }
        h2 id=(TRIALS[0]) { (TRIALS[1]) }
        (states.first.html(None))
        (omitted_rows_note(states.all))
        (download("trials", &states.csv))
        (provenance(&story))
        @if figures.iter().any(|figure| figure.moving.is_some()) { script { (PreEscaped(SCRIPT)) } }
    };
    let question = "Does training the body reduce the error, how many sensors are enough, and how much time did it take?";
    // With many trials, their data is larger than the page.
    drop(story);
    page(&title, question, content)
}

/// Anchors and headings of the sections after the figures.
const TABLES: [&str; 2] = ["tables", "Tables"];
const TRIALS: [&str; 2] = ["trials", "Trials"];
const PROVENANCE: [&str; 2] = ["provenance", "Spec, versions, seeds"];

/// Numbers of trials, and caveats about their code.
fn state(story: &ReportData) -> Vec<Answer> {
    let States { all, done, failed, .. } = story.states;
    let why = if failed > 0 { " (reasons in the table of trials)" } else { "" };
    let text = format!(
        "{done} of {all} trials are done, {failed} failed{why}. Ratios are geometric means over trials. Intervals are over \
         placements and seeds, because trials that share these are not independent."
    );
    let caveats = story.caveats.iter().map(|caveat| Answer::new("", Some(false), format!("{caveat}.")));
    let state = Answer::new("", (failed > 0).then_some(false), text);
    std::iter::once(state).chain(caveats).collect()
}

fn provenance(story: &ReportData) -> Markup {
    let seeds = distinct(story.trials.iter().map(|t| t.cluster.seed));
    let seeds = seeds.iter().map(u64::to_string).collect::<Vec<_>>().join(", ");
    html! {
        h2 id=(PROVENANCE[0]) { (PROVENANCE[1]) }
        @for CodeVersion { code, revisions, trials } in &story.code_versions {
            p {
                "Trials by code " (code)
                @if !revisions.is_empty() { " (commit " (revisions.join(", ")) ")" }
                ": " (trials) "."
            }
        }
        p {
            "Seeds of the finished trials: " (if seeds.is_empty() { "none" } else { &seeds }) ". Bootstrap: all ways to draw, or "
            (REPLICATES) " of them, seed " (SEED) ". Report by metasense " (env!("CARGO_PKG_VERSION")) "."
        }
        @for sweep in &story.sweeps {
            p { "Sweep " b { (sweep.name) } ", started " (sweep.created_at) " by metasense " (sweep.version) ":" }
            pre { (sweep.text) }
        }
    }
}

#[cfg(test)]
mod tests;
