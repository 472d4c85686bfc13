//! One trial: its curves, bodies, CPU time by part, attempts and log.

use std::sync::Arc;

use axum::extract::{Path, State};
use axum::response::Html;
use maud::{Markup, html};
use metasense_lab::replay::drawing;
use metasense_lab::simulate;
use metasense_schemas::spec::TrialSpec;
use serde::Deserialize;

use super::{Query, ServerState, framed, live, query, trouble};
use crate::analysis::setting::flatten;
use crate::cell::brief;
use crate::look::body::Sketch;
use crate::look::short_hash;
use crate::look::wave::course;
use crate::look::{Axis, Figure, Picture, Plot, Scale, Table, legend, number, readable};
use crate::plan::counted;
use crate::provenance;
use crate::reader::{Reader, StoredTrial, quoted};
use crate::report::body::{self, sketch};
use crate::report::load::PARTS;
use crate::report::samples::Replayed;
use crate::serve::steer::of_trial;
use crate::serve::{DatabaseState, PageError, source};
use crate::store::StoreError;

/// Stored data of a trial.
#[derive(Debug)]
pub(super) struct Trial {
    pub hash: String,
    pub state: String,
    pub reason: String,
    pub spec: String,
    pub rows: TrialRows,
    /// Known designs, each with its name and a spec that has its sensors.
    pub designs: Vec<(String, TrialSpec, Vec<f64>)>,
    /// Known designs during training, each after so many outer steps; the initial design first.
    pub course: Vec<(u32, TrialSpec, Vec<f64>)>,
    /// The stored trial, if it contains both bodies.
    pub stored: Option<StoredTrial>,
}

/// Rows of a trial in the views.
#[derive(Debug)]
pub(super) struct TrialRows {
    /// Values from `v_trial`.
    pub facts: Table,
    pub steps: Table,
    /// Number of steps that this trial computed, and their CPU seconds by part.
    pub time: Table,
    pub networks: Table,
    pub curves: Table,
    pub readings: Table,
    pub attempts: Table,
    pub log: Table,
}

/// Columns of a trial; below, of its attempts.
const FACTS: &str = "panels AS forces_K, sensors AS sensors_M, placement, seed, units, layout, brain, trained_with,
  spec->>'$.optimise.objective' AS objective, placed, protocol,
  design_parameters, brain_parameters, holdout_error_initial, holdout_median_initial, holdout_p90_initial,
  holdout_above_initial, holdout_rms_initial, holdout_error_optimised, holdout_median_optimised, holdout_p90_optimised,
  holdout_above_optimised, holdout_rms_optimised, error_initial AS test_error_initial,
  error_optimised AS test_error_optimised, best_step, steps, attempts, seconds AS cpu_seconds, sensor_units,
  sensor_units_optimised, finished_at";
const HOLDOUT: &str = "error_holdout, median_holdout, p90_holdout, above_holdout, rms_holdout";
const ATTEMPTS: &str =
    "attempt, state, reason, steps, round(seconds, 1) AS seconds, cpu_seconds, started_at, code, revision,
  rustc, host, cpu, simd, threads";

impl Trial {
    pub async fn read(reader: &mut Reader, hash: &str) -> Result<Self, StoreError> {
        let hash = reader.hash_of(hash).await?;
        if let Some(mut source_reader) = reader.open_source_of(&hash).await? {
            let trial = Box::pin(Self::read(&mut source_reader, &hash)).await;
            source_reader.close().await;
            return trial;
        }
        let hash_filter = format!("WHERE hash = {}", quoted(&hash));
        let moves = format!("SELECT result->>'$.moves' FROM trial {hash_filter}");
        let mut ask = async |what: &str, from: &str, more: &str| -> Result<Table, StoreError> {
            reader.query(&format!("SELECT {what} FROM {from} {hash_filter} {more}")).await
        };
        let said = ask(&format!("state, coalesce(reason, ''), spec, ({moves})"), "v_trial", "").await?;
        let [state, reason, spec, moves] =
            [0, 1, 2, 3].map(|i| said.rows[0][i].as_str().unwrap_or_default().to_owned());
        let mut moves: Vec<(u32, Vec<usize>)> = serde_json::from_str(&moves).unwrap_or_default();
        let facts = ask(FACTS, "v_trial", "").await?;
        let steps = "step, error_test, error_train, gradient_norm, step_length, outcome";
        let steps = ask(steps, "v_step", "ORDER BY step").await?;
        let sums = PARTS.map(|(column, _)| format!("sum({column})")).join(", ");
        let time = ask(&format!("count(*), {sums}"), "v_step", "AND attempt > 0").await?;
        let networks = format!("body, network, error_train, error_test, {HOLDOUT}, iterations, outcome");
        let networks = ask(&networks, "v_network", "ORDER BY 1, 2").await?;
        let curves = "body, network, iteration, error_holdout";
        let curves = ask(curves, "v_curve", "AND error_holdout IS NOT NULL ORDER BY 1, 2, 3").await?;
        let readings =
            "body, before AS seconds_before, after AS seconds_after, ridge, error_train, error_test";
        let readings = ask(&format!("{readings}, {HOLDOUT}"), "v_reading", "ORDER BY 2, 3, 1").await?;
        let attempts = ask(ATTEMPTS, "v_attempt", "ORDER BY attempt").await?;
        let log = ask("attempt, at, level, text", "v_log", "ORDER BY attempt, line").await?;
        let stored = reader.stored(&hash).await?.filter(|s| s.designs.iter().all(|d| !d.is_empty()));
        let mut designs = Vec::new();
        if let Some(stored) = &stored {
            for (b, name) in ["initial body", "trained body"].into_iter().enumerate() {
                designs.push((name.to_owned(), stored.specs[b].clone(), stored.designs[b].clone()));
            }
        } else if let Ok(spec) = serde_json::from_str::<TrialSpec>(&spec) {
            if let Ok((_, initial)) = simulate::body(&spec) {
                designs.push(("initial body".into(), spec.clone(), initial));
            }
            if let Ok(Some(now)) = reader.checkpoint(&hash).await {
                let sensor_units = now.moves.last().map_or(spec.sensor_units.clone(), |last| last.1.clone());
                let moved = TrialSpec { sensor_units, ..spec };
                let name = format!("body after {}", counted(now.step as usize, "step"));
                designs.push((name, moved, now.design));
                moves = now.moves;
            }
        }
        let mut course = Vec::new();
        if let Some((_, spec, initial)) = designs.first() {
            course.push((0, spec.clone(), initial.clone()));
            for (step, design) in reader.designs_of(&hash).await? {
                let moved = moves.iter().rfind(|(from, _)| *from <= step);
                let sensor_units = moved.map_or(&spec.sensor_units, |moved| &moved.1).clone();
                course.push((step, TrialSpec { sensor_units, ..spec.clone() }, design));
            }
        }
        let rows = TrialRows { facts, steps, time, networks, curves, readings, attempts, log };
        Ok(Self { hash, state, reason, spec, rows, designs, course, stored })
    }

    /// Points (step from 1, value) of a column of the steps; rows without a number are omitted.
    pub fn column(&self, name: &str) -> Vec<(f64, f64)> {
        let Some(at) = self.rows.steps.columns.iter().position(|column| column == name) else {
            return Vec::new();
        };
        let point = |row: &Vec<serde_json::Value>| Some((row[0].as_f64()? + 1.0, row[at].as_f64()?));
        self.rows.steps.rows.iter().filter_map(point).collect()
    }

    /// Whether another program simulates the body.
    fn is_external(&self) -> bool {
        self.designs.first().is_some_and(|(_, spec, _)| !spec.body.kind.is_polygons())
    }

    pub fn drawings(&self) -> Vec<(String, String, Sketch)> {
        let drawn = |(name, spec, design): &(String, TrialSpec, Vec<f64>)| {
            drawing(spec, design).ok().map(|drawing| (name.clone(), name.clone(), sketch(&drawing, &[])))
        };
        self.designs.iter().filter_map(drawn).collect()
    }
}

/// A plot of curves, each with class and points; `None` without points.
pub(super) fn curves(title: &str, [x, y]: [&str; 2], lines: &[(&str, Vec<(f64, f64)>)]) -> Option<Picture> {
    let points = || lines.iter().flat_map(|line| &line.1);
    points().next()?;
    let x = Axis::new(x, Scale::Linear, points().map(|p| p.0).chain([0.0]));
    let mut plot = Plot::new(title, x, Axis::new(y, Scale::Log, points().map(|p| p.1)));
    for (class, points) in lines {
        plot.line(class, points.iter().copied());
        // of a trial that has just begun
        if let [only] = points[..] {
            plot.dots(class, [(only, number(only.1))]);
        }
    }
    Some(plot.picture())
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct TrialQuery {
    /// Not empty: simulate the trial again.
    replay: String,
    /// The sample to show.
    sample: String,
}

pub async fn page(
    State(served): State<Arc<ServerState>>,
    Path((at, hash)): Path<(String, String)>,
    Query(asked): Query<TrialQuery>,
) -> Result<Html<String>, PageError> {
    let seen = source(&served, &at)?.current_state().await;
    if seen.checked.is_none() {
        let why = live("facts", &trouble(&seen));
        return framed(&served, &at, "trial", "Trial", Some(seen.generation), &why);
    }
    let trial = Reader::with_reader(&seen.db, async |reader| Trial::read(reader, &hash).await).await?;
    let replayed = match &trial.stored {
        Some(stored) if !asked.replay.is_empty() => {
            let again = replayed(&served, stored).await?;
            let sample = asked.sample.parse::<usize>().ok();
            let drawing = Arc::clone(&again);
            let work =
                tokio::task::spawn_blocking(move || drawing.figures(sample).map_err(|e| e.to_string()));
            let figures = work.await.map_err(|e| e.to_string()).and_then(|figures| figures);
            Some((again, figures.map_err(PageError::Asked)?))
        }
        _ => None,
    };
    let following = replayed.is_none();
    let title = format!("Trial {}", short_hash(&trial.hash));
    let parts = [("networks", networks(&trial)), ("time", time(&trial)), ("attempts", attempts(&trial))];
    let content = html! {
        (live("facts", &facts(&seen, &trial)))
        @if trial.state != "done" { (of_trial(&served, &at, &trial.hash)) }
        (live("curves", &curves_of(&trial)))
        (live("bodies", &bodies_of(&trial)))
        // not live, so that the slider keeps its position; only the designs are replaced
        (course_of(&trial))
        @for (id, part) in &parts { (live(id, part)) }
        @if !trial.is_external() { section id="replay" {
            h2 { "Forces and waves" }
            @match (&replayed, &trial.stored) {
                (Some((again, figures)), _) => {
                    (samples(again, &asked.sample))
                    @for figure in figures.iter().filter(|f| f.name != "bodies" && f.name != "modes") { (figure.html(&[])) }
                }
                (None, Some(_)) => {
                    p { a href="?replay=1#replay" { "Simulate both bodies again" } " to see true and predicted forces of each sample, and the wave. This takes as long as one outer step on one thread." }
                }
                (None, None) => p class="quiet" { "Available once the trial is done." }
            }
        } }
        (spec(&trial))
    };
    framed(&served, &at, "trial", &title, following.then_some(seen.generation), &content)
}

/// Simulates the trial again, unless it is the one that is kept.
async fn replayed(served: &ServerState, stored: &StoredTrial) -> Result<Arc<Replayed>, PageError> {
    let _turn = served.replays.acquire().await.expect("it is never closed");
    let kept = served.replayed.lock().expect("nobody panics with it").clone();
    if let Some((_, again)) = kept.filter(|(of, _)| of == stored) {
        return Ok(again);
    }
    let of = stored.clone();
    let work = tokio::task::spawn_blocking(move || Replayed::new(&of, 1).map_err(|e| e.to_string()));
    let again = work.await.map_err(|e| e.to_string()).and_then(|again| again).map_err(PageError::Asked)?;
    let again = Arc::new(again);
    *served.replayed.lock().expect("nobody panics with it") = Some((stored.clone(), Arc::clone(&again)));
    Ok(again)
}

/// A choice of samples to show: four, or one of the test set.
fn samples(again: &Replayed, chosen: &str) -> Markup {
    let error = |error: Option<f64>| error.map_or("–".into(), number);
    let chosen_index = again.test.iter().position(|n| n.to_string() == chosen);
    let to = |i: usize| format!("?replay=1&sample={}#replay", again.test[i]);
    html! {
        form method="get" action="#replay" class="line" {
            input type="hidden" name="replay" value="1";
            label { "Show " select name="sample" {
                option value="" { "four typical samples" }
                @for n in &again.test {
                    @let [initial, optimised] = again.errors(*n);
                    option value=(n) selected[n.to_string() == chosen] { "sample " (n) ": " (error(initial)) " → " (error(optimised)) " %" }
                }
            } }
            button { "Show" }
            @if let Some(before) = chosen_index.and_then(|chosen_index| chosen_index.checked_sub(1)) { a rel="prev" href=(to(before)) { "Previous" } }
            @let after = chosen_index.map_or(0, |chosen_index| chosen_index + 1);
            @if after < again.test.len() { a rel="next" href=(to(after)) { (if chosen_index.is_some() { "Next" } else { "One by one" }) } }
        }
    }
}

fn facts(seen: &DatabaseState, trial: &Trial) -> Markup {
    let facts =
        trial.rows.facts.columns.iter().zip(&trial.rows.facts.rows[0]).filter(|(_, value)| !value.is_null());
    html! {
        (trouble(seen))
        p class="question" { (trial.state) @if !trial.reason.is_empty() { ": " (trial.reason) } }
        @if let Some(caveat) = trial.stored.as_ref().and_then(|stored| provenance::unresolved(&stored.solver)) {
            p { "Warning: " (caveat) "." }
        }
        dl class="facts" {
            @for (name, value) in facts {
                div { dt { (name.replace('_', " ")) } dd {
                    (readable(value, number))
                } }
            }
        }
        p { a href=(format!("../compare{}", query(&[("a", &trial.hash)]))) { "Compare with another" } }
    }
}

fn curves_of(trial: &Trial) -> Markup {
    let (test, train) = (trial.column("error_test"), trial.column("error_train"));
    let mut keys = legend(&[("optimised", "test set, which selects the body")]);
    if !train.is_empty() {
        keys.push(("front", "training set".into()));
    }
    let lines = [("front", train), ("optimised", test)];
    let steps = curves("Error during training of the body", ["outer step", "error (%)"], &lines);
    let error_points = |body: &str| -> Vec<(f64, f64)> {
        let own = trial.rows.curves.rows.iter().filter(|row| row[0] == body && row[1] == 0);
        own.filter_map(|row| row[2].as_f64().zip(row[3].as_f64())).collect()
    };
    let lines = [("initial", error_points("initial")), ("optimised", error_points("optimised"))];
    let axes = ["iteration of the decoder", "held-out error (%)"];
    let fresh = curves("New network on each body", axes, &lines);
    let data = trial.rows.steps.clone();
    html! {
        @if let Some(steps) = steps {
            (Figure::new("steps", "Steps", "Error of the decoder that is trained together with the body, after each outer step.", keys, vec![steps], data).html(&[]))
        }
        @if let Some(fresh) = fresh {
            (Figure::new(
                "fresh", "New networks", "Held-out error of the first network of the comparison during its training, on the initial and the trained body.",
                legend(&[("initial", "initial body"), ("optimised", "trained body")]), vec![fresh], trial.rows.curves.clone(),
            ).html(&[]))
        }
    }
}

fn bodies_of(trial: &Trial) -> Markup {
    if let Some(figure) = trial.stored.as_ref().and_then(body::drawn) {
        return figure.html(&[]);
    }
    let drawings = trial.drawings();
    if drawings.is_empty() {
        return html! {};
    }
    let caption = "Units with their numbers, ligaments, panels, sensors. Clamped units are shaded.";
    body::figure("body", "Bodies", caption, &drawings).html(&[])
}

/// The designs so far, by step; empty if none has been or will be stored.
fn course_of(trial: &Trial) -> Markup {
    let drawn = |(step, spec, design): &(u32, TrialSpec, Vec<f64>)| {
        Some((*step, sketch(&drawing(spec, design).ok()?, &[])))
    };
    let designs: Vec<_> = trial.course.iter().filter_map(drawn).collect();
    let steps = trial.course.first().map_or(0, |initial| initial.1.optimise.steps());
    let open = ["pending", "running"].contains(&trial.state.as_str());
    html! {
        @if designs.len() > 1 || open && !designs.is_empty() {
            h2 id="course" { "The body during training" }
            figure {
                div class="plots" { div { (course(&designs, steps)) } }
                figcaption { "The design after selected outer steps, with interpolation between them. Panels and sensors move with it." }
            }
        }
    }
}

fn networks(trial: &Trial) -> Markup {
    html! {
        @if !trial.rows.networks.rows.is_empty() { h2 { "Networks on both bodies" } (trial.rows.networks.without_empty_columns().html(None)) }
        @if !trial.rows.readings.rows.is_empty() {
            h2 { "Linear decoders by memory (time before and after the instant)" }
            (trial.rows.readings.without_empty_columns().html(None))
        }
    }
}

/// CPU time of the steps that this trial computed.
fn time(trial: &Trial) -> Markup {
    let (count, sums) = trial.rows.time.rows[0].split_first().expect("a number of steps, and sums");
    let sums: Vec<_> = PARTS.iter().zip(sums).map(|(part, s)| (part.1, s.as_f64().unwrap_or(0.0))).collect();
    let all: f64 = sums.iter().map(|part| part.1).sum();
    html! {
        @if all > 0.0 {
            h2 { "CPU time of " (counted(count.as_u64().unwrap_or(0) as usize, "step")) }
            table class="parts" {
                thead { tr { th class="text" { "part" } th { "CPU seconds" } th { "share (%)" } th class="text" {} } }
                tbody { @for (part, seconds) in sums {
                    tr {
                        td class="text" { (part) } td { (number(seconds)) } td { (number(100.0 * seconds / all)) }
                        td class="text" { meter min="0" max="1" value=(format!("{:.4}", seconds / all)) aria-label=(part) {} }
                    }
                } }
            }
        }
    }
}

fn attempts(trial: &Trial) -> Markup {
    html! {
        @if !trial.rows.attempts.rows.is_empty() { h2 { "Attempts" } (trial.rows.attempts.without_empty_columns().html(None)) }
        @if !trial.rows.log.rows.is_empty() { h2 { "Log" } (trial.rows.log.html(None)) }
    }
}

fn spec(trial: &Trial) -> Markup {
    let Ok(spec) = serde_json::from_str(&trial.spec) else { return html! {} };
    html! {
        details id="spec" {
            summary { "Spec" }
            dl class="facts" { @for (key, value) in flatten(&spec) { div { dt { (key) } dd { (brief(&value)) } } } }
            p class="quiet" { "Hash " (trial.hash) }
        }
    }
}
