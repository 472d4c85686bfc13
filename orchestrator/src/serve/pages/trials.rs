//! All trials: one page of those that meet conditions, sorted.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::extract::{Path, State};
use axum::response::Html;
use maud::{Markup, html};
use serde::Deserialize;
use serde_json::Value;

use super::{Query, ServerState, framed, live, query, to_trial, trouble};
use crate::cell::plain;
use crate::look::{number, short_hash};
use crate::plan::counted;
use crate::serve::trials::{NUMBERS, TrialRow, condition};
use crate::serve::{PageError, source};

/// Number of trials on a page.
const ON_A_PAGE: usize = 100;

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct TrialsQuery {
    q: String,
    sort: String,
    page: usize,
}

pub async fn page(
    State(served): State<Arc<ServerState>>,
    Path(at): Path<String>,
    Query(asked): Query<TrialsQuery>,
) -> Result<Html<String>, PageError> {
    let seen = source(&served, &at)?.current_state().await;
    let (found, wrong) = seen.trials.asked(&asked.q, &asked.sort);
    let pages = found.len().div_ceil(ON_A_PAGE).max(1);
    let page_number = asked.page.clamp(1, pages);
    let shown = &found[(page_number - 1) * ON_A_PAGE..found.len().min(page_number * ON_A_PAGE)];
    let to = |page: usize| query(&[("q", &asked.q), ("sort", &asked.sort), ("page", &page.to_string())]);
    let rows = html! {
        (trouble(&seen))
        p role="status" {
            @match &wrong {
                Some(wrong) => span class="trouble" { (wrong) },
                None => { (counted(found.len(), "trial")) " of " (seen.trials.rows.len()) }
            }
        }
        @if !shown.is_empty() {
            form method="get" action="compare" {
                (table(&at, &asked, shown, &seen.trials.keys))
                p { button { "Compare two ticked trials" } }
            }
        }
        @if pages > 1 {
            nav class="pages" aria-label="Pages of trials" {
                @if page_number > 1 { a href=(to(1)) { "First" } a href=(to(page_number - 1)) rel="prev" { "Previous" } }
                span { "Page " (page_number) " of " (pages) }
                @if page_number < pages { a href=(to(page_number + 1)) rel="next" { "Next" } a href=(to(pages)) { "Last" } }
            }
        }
    };
    let content = html! {
        form method="get" role="search" {
            label for="q" { "Conditions (all must hold)" }
            div class="line" {
                input id="q" name="q" type="search" value=(asked.q) placeholder="K=4 M<=3 state=done" autocomplete="off" spellcheck="false";
                @if !asked.sort.is_empty() { input type="hidden" name="sort" value=(asked.sort); }
                button { "Filter" }
            }
        }
        (keys(&asked, &seen.trials.keys))
        (live("rows", &rows))
    };
    framed(&served, &at, "trials", "Trials", Some(seen.generation), &content)
}

/// The keys to filter by.
fn keys(asked: &TrialsQuery, keys: &std::collections::BTreeMap<String, Vec<String>>) -> Markup {
    let with = |term: String| query(&[("q", format!("{} {term}", asked.q).trim()), ("sort", &asked.sort)]);
    html! {
        details id="keys" {
            summary { "Keys" }
            p class="quiet" {
                "A condition is a key, one of = != < <= > >= ~ (contains), and a value. Keys are columns (hash, state, reason"
                @for (name, _) in NUMBERS { ", " (name) } ") and the paths of the spec. Keys that differ between trials:"
            }
            dl {
                @for (key, values) in keys {
                    dt { (key) " " a href=(query(&[("q", &asked.q), ("sort", key)])) { "sort" } }
                    dd { @for value in values {
                        @if let Some(term) = condition(key, value) { a href=(with(term)) { (value) } } @else { (value) }
                        " "
                    } }
                }
            }
        }
    }
}

/// Maximum number of columns of keys that differ between trials; others are sorted and filtered by name.
const MOST_KEYS: usize = 6;

fn table(
    at: &str,
    asked: &TrialsQuery,
    shown: &[&Arc<TrialRow>],
    keys: &BTreeMap<String, Vec<String>>,
) -> Markup {
    let (sorted, down) = asked.sort.strip_prefix('-').map_or((asked.sort.as_str(), false), |key| (key, true));
    let mut extra: Vec<&str> = keys.keys().map(String::as_str).take(MOST_KEYS).collect();
    if !sorted.is_empty() && !known(sorted) && !extra.contains(&sorted) {
        extra.push(sorted);
    }
    let head = |key: &str, text: &str| {
        let by = if sorted == key && !down { format!("-{key}") } else { key.to_owned() };
        let order = (sorted == key).then_some(if down { "descending" } else { "ascending" });
        html! {
            th aria-sort=[order] class=[(!NUMBERS.iter().any(|(name, _)| *name == key)).then_some("text")] {
                a href=(query(&[("q", &asked.q), ("sort", &by)])) { (text) }
            }
        }
    };
    // medians and counts only where a shown trial has them
    let says = |name: &str| {
        !["median_", "above_"].iter().any(|part| name.starts_with(part))
            || shown.iter().any(|row| row.number(name).is_some_and(|x| x > 0.0))
    };
    let numbers: Vec<(&str, &str)> = NUMBERS.into_iter().filter(|(name, _)| says(name)).collect();
    html! {
        div class="scroll" {
            table class="trials" {
                thead { tr {
                    th class="text" { "compare" } (head("hash", "trial")) (head("state", "state"))
                    @for key in &extra { (head(key, key)) }
                    @for (name, text) in &numbers { (head(name, text)) }
                    (head("reason", "reason"))
                } }
                tbody { @for row in shown {
                    tr class=[(row.state == "failed").then_some("failed")] {
                        td class="text" { input type="checkbox" name="trial" value=(row.hash) aria-label={ "compare " (short_hash(&row.hash)) }; }
                        td class="text" { a href=(to_trial(at, &row.hash)) { (short_hash(&row.hash)) } }
                        td class="text" { (row.state) }
                        @for key in &extra { td class="text" { (text(&row.cell(key))) } }
                        @for (name, _) in &numbers { td { (text(&row.cell(name))) } }
                        td class="text" { (row.reason) }
                    }
                } }
            }
        }
    }
}

fn known(key: &str) -> bool {
    ["hash", "state", "reason"].contains(&key) || NUMBERS.iter().any(|(name, _)| *name == key)
}

fn text(cell: &Value) -> String {
    match cell.as_f64() {
        Some(x) if x.fract() == 0.0 && x.abs() < 1e9 => format!("{x:.0}"),
        Some(x) => number(x),
        None => plain(cell),
    }
}
