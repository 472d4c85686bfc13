//! The sweep map: grids of M across and placements, or another setting that varies, down, coloured by an error. There is one grid per
//! K, size of the body, kind of placement, and decoders.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use axum::extract::{Path, State};
use axum::response::Html;
use maud::html;
use serde::Deserialize;

use super::{Query, ServerState, framed, live, query, to_trial, trouble};
use crate::analysis::kinds::{brains, format_brains};
use crate::analysis::numbers::geometric_mean;
use crate::cell::plain;
use crate::look::Picture;
use crate::look::grid::{Cell, grid};
use crate::look::number;
use crate::plan::counted;
use crate::report::K_AND_M;
use crate::serve::trials::{TrialRow, condition};
use crate::serve::{PageError, source};

/// Quantities that colour cells, with their descriptions.
const BY: [(&str, &str); 5] = [
    ("holdout_optimised", "held-out error of the trained body (%)"),
    ("holdout_initial", "held-out error of the initial body (%)"),
    ("test_optimised", "test error of the trained body (%)"),
    ("gain", "held-out error of the initial body divided by that of the trained body"),
    ("cpu_seconds", "CPU time (s)"),
];
/// Rows of a grid by default.
const PLACEMENT: &str = "placement";
/// Maximum number of grids on a page, and of cells along a side.
const MOST: usize = 60;

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct MapQuery {
    q: String,
    by: String,
    down: String,
}

pub async fn page(
    State(served): State<Arc<ServerState>>,
    Path(at): Path<String>,
    Query(asked): Query<MapQuery>,
) -> Result<Html<String>, PageError> {
    let seen = source(&served, &at)?.current_state().await;
    let by = BY.iter().find(|(key, _)| *key == asked.by).unwrap_or(&BY[0]);
    let (found, wrong) = seen.trials.asked(&asked.q, "");
    let down = seen.trials.keys.keys().find(|key| **key == asked.down).map_or(PLACEMENT, String::as_str);
    let (pictures, left, [least, most]) = grids(&at, &found, by.0, down);
    let drawn = html! {
        (trouble(&seen))
        @if let Some(wrong) = &wrong { p class="trouble" role="alert" { (wrong) } }
        p class="quiet" {
            (counted(found.len(), "trial")) ". A cell shows the geometric mean over its trials (over seeds and all other \
             settings). "
            @if most > 0.0 {
                "The colour scale is logarithmic, from pale (" (number(least)) ") to strong (" (number(most)) "). "
            }
            "A click shows its trials. " (K_AND_M)
        }
        div class="grids" { @for picture in &pictures { figure { h2 { (picture.title) } (picture.svg(Some(picture.view))) } } }
        @if left > 0 { p class="quiet" { "… and " (counted(left, "grid")) " more: use the filter to see them." } }
    };
    let content = html! {
        form method="get" class="line" {
            label { "Coloured by " select name="by" {
                @for (key, text) in BY { option value=(key) selected[key == by.0] { (text) } }
            } }
            label { "down " select name="down" {
                @for key in std::iter::once(PLACEMENT).chain(seen.trials.keys.keys().map(String::as_str)) {
                    option value=(key) selected[key == down] { (key) }
                }
            } }
            label { "of trials with " input name="q" type="search" value=(asked.q) placeholder="seed=1" autocomplete="off" spellcheck="false"; }
            button { "Show" }
        }
        (live("grids", &drawn))
    };
    framed(&served, &at, "map", "Sweep map", Some(seen.generation), &content)
}

/// Filter conditions for a cell's kind of placement, decoders and objective; `None` if they cannot be written.
fn alike(row: &TrialRow) -> Option<String> {
    ["sensors.search", "brain.kind", "optimise.brain", "optimise.objective", "optimise.objective.cvar"]
        .into_iter()
        .map(|path| (path, row.cell(path)))
        .filter(|(_, value)| !value.is_null())
        .map(|(path, value)| Some(format!(" {}", condition(path, &plain(&value))?)))
        .collect()
}

/// The grids, the number of omitted ones, and the smallest and the largest value.
fn grids(at: &str, found: &[&Arc<TrialRow>], by: &str, down: &str) -> (Vec<Picture>, usize, [f64; 2]) {
    type Cells = BTreeMap<(String, u64), Vec<Arc<TrialRow>>>;
    let mut cells_by_grid: BTreeMap<(u64, u64, &str, [String; 2]), Cells> = BTreeMap::new();
    let whole = |row: &TrialRow, name| row.number(name).unwrap_or(0.0) as u64;
    for row in found {
        let placed = row.setting.get("sensors.search").and_then(|v| v.as_str()).unwrap_or("random");
        let brains = brains(&row.setting);
        let key = (whole(row, "K"), whole(row, "units"), placed, brains);
        let cell = (plain(&row.cell(down)), whole(row, "M"));
        cells_by_grid.entry(key).or_default().entry(cell).or_default().push(Arc::clone(row));
    }
    let value = |rows: &[Arc<TrialRow>]| {
        let one = |row: &Arc<TrialRow>| match by {
            "gain" => Some(row.number("holdout_initial")? / row.number("holdout_optimised")?),
            _ => row.number(by),
        };
        let values: Vec<f64> = rows.iter().filter_map(one).filter(|x| x.is_finite() && *x > 0.0).collect();
        (!values.is_empty()).then(|| geometric_mean(&values))
    };
    let all: Vec<f64> = cells_by_grid.values().flat_map(BTreeMap::values).filter_map(|r| value(r)).collect();
    let [least, most] =
        [all.iter().copied().fold(f64::INFINITY, f64::min), all.iter().copied().fold(0.0, f64::max)];
    let part = |x: f64| if most > least { (x / least).ln() / (most / least).ln() } else { 0.5 };
    let omitted_count = cells_by_grid.len().saturating_sub(MOST);
    let picture = |((panels, units, placed, brains), cells): (&(u64, u64, &str, [String; 2]), &Cells)| {
        let who = format_brains(brains);
        let title = format!("K = {panels}, {}, sensors {placed}, {who}", counted(*units as usize, "unit"));
        let across: BTreeSet<u64> = cells.keys().map(|key| key.1).collect();
        let across: Vec<u64> = across.into_iter().take(MOST).collect();
        let rows: BTreeSet<&String> = cells.keys().map(|key| &key.0).collect();
        let mut rows: Vec<String> = rows.into_iter().cloned().collect();
        let number_of = |text: &String| text.parse().unwrap_or(f64::INFINITY);
        rows.sort_by(|a, b| number_of(a).total_cmp(&number_of(b)));
        rows.truncate(MOST);
        let cell = |name: &String, sensors: u64| {
            let Some(rows) = cells.get(&(name.clone(), sensors)) else { return Cell::default() };
            let done = rows.iter().filter(|row| row.state == "done").count();
            let to = match &rows[..] {
                [row] => Some(to_trial(at, &row.hash)),
                rows => condition(down, name).zip(alike(&rows[0])).map(|(own, same)| {
                    let asked = format!("K={panels} M={sensors} {own} units={units}{same}");
                    format!("trials{}", query(&[("q", &asked)]))
                }),
            };
            let (told, all) = (value(rows), counted(rows.len(), "trial"));
            let state = if rows.iter().any(|row| row.state == "running") { "…" } else { "–" };
            let title = format!("M = {sensors}, {down} {name}: {done} of {all} done");
            Cell { text: told.map_or(state.into(), number), part: told.map_or(0.0, part), title, to }
        };
        let drawn: Vec<Vec<Cell>> =
            rows.iter().map(|name| across.iter().map(|m| cell(name, *m)).collect()).collect();
        let across: Vec<String> = across.iter().map(u64::to_string).collect();
        grid(&title, ("sensors M", &across), (down, &rows), &drawn)
    };
    (cells_by_grid.iter().take(MOST).map(picture).collect(), omitted_count, [least, most])
}
