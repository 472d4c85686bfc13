//! The overview: progress of a sweep, answers so far, failures.

use std::sync::Arc;

use axum::extract::{Path, State};
use axum::response::Html;
use maud::{Markup, html};

use super::{DatabaseState, ServerState, framed, live, trial_links, trouble};
use crate::look::{answers, number};
use crate::plan::counted;
use crate::report::K_AND_M;
use crate::serve::steer::of_run;
use crate::serve::{PageError, source};

pub async fn page(
    State(served): State<Arc<ServerState>>,
    Path(at): Path<String>,
) -> Result<Html<String>, PageError> {
    let seen = source(&served, &at)?.current_state().await;
    let parts = [
        ("workers", workers(&at, &seen)),
        ("failures", failures(&at, &seen)),
        ("answers", answered(&seen)),
        ("runs", runs(&seen)),
    ];
    let content = html! {
        (live("progress", &progress(&seen)))
        (of_run(&served, &at))
        @for (id, part) in &parts { (live(id, part)) }
    };
    framed(&served, &at, "", "Overview", Some(seen.generation), &content)
}

fn progress(seen: &DatabaseState) -> Markup {
    let progress = &seen.progress;
    html! {
        (trouble(seen))
        @if seen.checked.is_some() { p class="question" { (progress.summary.replace("->", "→")) } }
        @if let Some(part) = progress.part {
            progress max="1" value=(format!("{part:.4}")) aria-label="finished part of the estimated work" {}
            p class="quiet" {
                (number((1000.0 * part).floor() / 10.0)) " % of the estimated work"
                @if let Some(correction) = progress.correction {
                    "; attempts have taken " (number(correction)) " times their estimate"
                }
                "."
            }
        }
        @if seen.checked.is_some() { p class="quiet" {
            @match progress.run {
                Some(run) => { "A run is active (process " (run) ")." }
                None => "No run on this machine is active.",
            }
        } }
    }
}

fn workers(at: &str, seen: &DatabaseState) -> Markup {
    html! {
        @if !seen.progress.workers.rows.is_empty() {
            h2 { "Workers" }
            (seen.progress.workers.linked(None, trial_links(at)))
        }
    }
}

fn failures(at: &str, seen: &DatabaseState) -> Markup {
    html! {
        @if !seen.failures.rows.is_empty() {
            h2 { "Failures" }
            p class="quiet" { "Grouped by reason and last message. Each trial's page contains its log." }
            @let mut table = seen.failures.clone();
            @let () = table.columns = ["reason", "message", "trial", "trials"].map(String::from).into();
            (table.linked(None, trial_links(at)))
        }
    }
}

fn answered(seen: &DatabaseState) -> Markup {
    let found = &seen.answers;
    let drawn = |name: &str| found.figures.iter().any(|figure| figure.name == name);
    html! {
        @if found.trial_count > 0 {
            h2 { "Answers so far" }
            p class="quiet" {
                "Of " (counted(found.trial_count, "trial")) " that " (if found.trial_count == 1 { "is" } else { "are" })
                " done. Intervals are over placements and seeds, because trials that share these are not independent. " (K_AND_M)
            }
            (answers(found.said.iter().filter(|answer| !drawn(answer.figure))))
            @if found.left > 0 { p class="quiet" { "… and " (found.left) " more: `metasense report` contains all." } }
            @for figure in &found.figures { (figure.html(&found.said)) }
        }
    }
}

fn runs(seen: &DatabaseState) -> Markup {
    html! {
        @if !seen.runs.rows.is_empty() {
            h2 { "Runs" }
            (seen.runs.html(None))
        }
    }
}
