//! Quantities that are shown in two places have the same value in both. Each is computed both ways on synthetic databases.

use std::collections::BTreeMap;
use std::path::Path;

use crate::common::{Bench, TINY};
use crate::synthetic;
use metasense::analysis::{BodyState, DecisionTerms, Question, Set, Trial};
use metasense::cluster::merge::{Extent, merge};
use metasense::look::Table;
use metasense::plan::{Plan, PlannedTrial as Planned};
use metasense::progress::Observer;
use metasense::reader::Reader;
use metasense::report::load::{finished_trials, story};
use metasense::serve::Trials;
use metasense::store::{LogLevel, RunPlan, Store};
use metasense_schemas::record::{
    BandRecord, BodyRecord, CastRecord, Checkpoint, NetworkRecord, Provenance, ReadingRecord, SpreadRecord,
    StepRecord, StepSeconds, TrialResult,
};

const STEPS: u32 = 4;

fn provenance() -> Provenance {
    let text = |text: &str| text.to_owned();
    Provenance {
        code: text("c"),
        revision: None,
        rustc: text("r"),
        host: text("h"),
        cpu: None,
        simd: text("avx2"),
        threads: 1,
    }
}

fn step(step: u32) -> StepRecord {
    let seconds = StepSeconds { simulate: 0.5, train: 0.25, differentiate: 0.125, ..StepSeconds::default() };
    StepRecord {
        step,
        error_test: Some(40.0 - f64::from(step)),
        outcome: "ok".into(),
        seconds,
        ..StepRecord::default()
    }
}

fn result(trial: &Planned, error: f64) -> TrialResult {
    let network = |factor: f64| NetworkRecord {
        error_test: Some(factor * error),
        error_train: Some(0.5 * factor * error),
        error_holdout: Some(2.0 * factor * error),
        losses: vec![1.0, 0.5],
        outcome: "ok".into(),
        spread: Some(SpreadRecord { median: Some(1.5 * factor * error), p90: Some(4.0 * error), above: 1 }),
        ..NetworkRecord::default()
    };
    let reading = ReadingRecord {
        before: 3,
        after: 2,
        error_test: Some(error),
        error_holdout: Some(3.0 * error),
        ..ReadingRecord::default()
    };
    let body = || BodyRecord {
        design: vec![0.0; 80],
        networks: (0..trial.spec.evaluation.networks()).map(|n| network(1.0 + n as f64)).collect(),
        readings: vec![reading.clone()],
        ..BodyRecord::default()
    };
    let cast = |cast: u32| CastRecord {
        cast,
        reader: "casts".into(),
        error: Some(error + f64::from(cast)),
        outcome: "ok".into(),
        ..CastRecord::default()
    };
    let band = |cast: u32| BandRecord {
        reader: "casts".into(),
        cast: Some(cast),
        method: "conformal".into(),
        kind: "instant".into(),
        level: 0.9,
        coverage: Some(0.8 + 0.01 * f64::from(cast)),
        outcome: "ok".into(),
        ..BandRecord::default()
    };
    let (casts, bands): (Vec<_>, Vec<_>) = ((0..10).map(cast).collect(), (0..10).map(band).collect());
    TrialResult {
        initial: body(),
        optimised: body(),
        best_step: 3,
        seconds_evaluation: 1.5,
        simd: "avx2".into(),
        casts: [casts.clone(), casts],
        bands: [bands.clone(), bands],
        ..TrialResult::default()
    }
}

/// Records steps of an attempt.
async fn steps(store: &mut Store, hash: &str, attempt: u32, range: std::ops::Range<u32>) {
    for n in range {
        let checkpoint = Checkpoint { step: n + 1, design: vec![f64::from(n); 80], ..Checkpoint::default() };
        store.record_step(hash, attempt, &step(n), &checkpoint).await.unwrap();
    }
}

/// A database with trials of all kinds: one that trains a body which two others evaluate (one of them after a killed attempt);
/// restarted, failed, cancelled, pending and running trials; and one that other code computes again.
async fn made_up(db: &Path) -> Plan {
    let spec = TINY
        .replace(
            "sensors = [1, 2]",
            "sensors = [1]\nseeds = [1, 2, 3]\n\"brain.kind\" = [\"linear\", \"stacked\", \"cnn\"]",
        )
        .replace("iterations = 4\n", "iterations = 4\nbrain = \"linear\"\n");
    let plan = Plan::new("tiny.toml", spec).unwrap();
    let mut store = Store::open(db).await.unwrap();
    store.set_provenance(provenance());
    store.begin_sweep(&plan.spec, &plan.source.text, &plan.trials).await.unwrap();
    let of_seed = |seed: u64| plan.trials.iter().filter(move |t| t.spec.point.seed == seed);
    let planned: [Vec<&Planned>; 3] = [1, 2, 3].map(|seed| of_seed(seed).collect());
    let [one, two, three] =
        planned.clone().map(|trials| trials.into_iter().map(|t| t.hash.as_str()).collect::<Vec<_>>());
    let run = RunPlan { shard: (1, 1), workers: (1, 1), trials: 9, estimated_seconds: 9.0 };
    let run = store.begin_run(&run).await.unwrap();
    // trains, with setup time outside the steps
    let attempt = store.begin_attempt(one[0]).await.unwrap();
    steps(&mut store, one[0], attempt, 0..STEPS).await;
    store.record_cpu_seconds(one[0], attempt, 10.0).await.unwrap();
    store.finish(one[0], attempt, &result(planned[0][0], 10.0), &[]).await.unwrap();
    // evaluate the body that it trained
    for (n, hash) in one[1..].iter().enumerate() {
        let attempt = store.begin_attempt(hash).await.unwrap();
        assert!(store.resume_checkpoint(hash, attempt, None).await.unwrap().is_some(), "{hash}");
        store.record_cpu_seconds(hash, attempt, 2.0 + n as f64).await.unwrap();
        if n == 0 {
            store.fail(hash, attempt, "worker_killed(9)", false).await.unwrap();
            let attempt = store.begin_attempt(hash).await.unwrap();
            store.record_cpu_seconds(hash, attempt, 4.0).await.unwrap();
            store.finish(hash, attempt, &result(planned[0][1 + n], 20.0), &[]).await.unwrap();
        } else {
            store.finish(hash, attempt, &result(planned[0][1 + n], 30.0), &[]).await.unwrap();
        }
    }
    // restarted, so that steps occur twice; from an earlier version, which measured no CPU time
    let attempt = store.begin_attempt(two[0]).await.unwrap();
    steps(&mut store, two[0], attempt, 0..2).await;
    store.fail(two[0], attempt, "stopped", false).await.unwrap();
    let attempt = store.begin_attempt(two[0]).await.unwrap();
    steps(&mut store, two[0], attempt, 0..STEPS).await;
    store.finish(two[0], attempt, &result(planned[1][0], 5.0), &[]).await.unwrap();
    // failed, cancelled, running
    let attempt = store.begin_attempt(two[1]).await.unwrap();
    store.record_cpu_seconds(two[1], attempt, 7.0).await.unwrap();
    store.log(two[1], attempt, LogLevel::Error, "no reason").await.unwrap();
    store.fail(two[1], attempt, "non_finite", true).await.unwrap();
    store.fail_pending(two[2], "cancelled").await.unwrap();
    // computed by other code, and marked for repetition
    let attempt = store.begin_attempt(three[0]).await.unwrap();
    steps(&mut store, three[0], attempt, 0..STEPS).await;
    store.record_cpu_seconds(three[0], attempt, 100.0).await.unwrap();
    store.finish(three[0], attempt, &result(planned[2][0], 1.0), &[]).await.unwrap();
    store.set_provenance(Provenance { code: "other".into(), ..provenance() });
    assert_eq!(store.redo_other_code(&[three[0]]).await.unwrap(), 1);
    let attempt = store.begin_attempt(three[0]).await.unwrap();
    steps(&mut store, three[0], attempt, 0..3).await;
    store.record_cpu_seconds(three[0], attempt, 3.0).await.unwrap();
    store.end_run(&run, "interrupted", 4, 1).await.unwrap();
    store.close().await.unwrap();
    plan
}

/// One number per trial.
async fn by_trial(reader: &mut Reader, sql: &str) -> BTreeMap<String, Option<f64>> {
    let rows = reader.query::<Table>(sql).await.unwrap_or_else(|e| panic!("{sql}: {e}")).rows;
    rows.into_iter().map(|row| (row[0].as_str().unwrap().to_owned(), row[1].as_f64())).collect()
}

fn same(name: &str, left: &BTreeMap<String, Option<f64>>, right: &BTreeMap<String, Option<f64>>) {
    assert!(!left.is_empty(), "{name}: nothing is compared");
    assert_eq!(left.keys().collect::<Vec<_>>(), right.keys().collect::<Vec<_>>(), "{name}");
    for (hash, x) in left {
        let y = &right[hash];
        let near =
            x.zip(*y).map_or(x.is_none() && y.is_none(), |(x, y)| (x - y).abs() <= 1e-9 * x.abs().max(1.0));
        assert!(near, "{name} of {hash}: {x:?}, {y:?}");
    }
}

fn of_trials(trials: &[Trial], number: &dyn Fn(&Trial) -> Option<f64>) -> BTreeMap<String, Option<f64>> {
    trials.iter().map(|trial| (trial.hash.clone(), number(trial))).collect()
}

fn total(values: &BTreeMap<String, Option<f64>>) -> f64 {
    values.values().flatten().sum()
}

/// SQL for one number per trial, from its rows of a view.
fn per_trial_sql(number: &str, view: &str, and: &str, of: &str) -> String {
    format!("SELECT t.hash, (SELECT {number} FROM {view} x WHERE x.hash = t.hash {and}) FROM trial t {of}")
}

const DONE: &str = "WHERE t.state = 'done'";

/// Seconds from the views, from the loader of `analyse` and `report`, and from the table of `analyse`.
async fn seconds_agree(reader: &mut Reader, finished: &[Trial]) {
    let of = |number: &dyn Fn(&Trial) -> Option<f64>| of_trials(finished, number);
    let seconds = by_trial(reader, "SELECT hash, seconds FROM v_trial").await;
    let attempts = per_trial_sql("sum(cpu_seconds)", "v_attempt", "AND NOT x.redone", "");
    same("seconds of attempts", &seconds, &by_trial(reader, &attempts).await);
    let done = by_trial(reader, &format!("SELECT hash, seconds FROM v_trial t {DONE}")).await;
    same("seconds of `analyse`", &done, &of(&|trial| Some(trial.spent)));
    same("seconds by part", &done, &of(&|trial| Some(trial.seconds.iter().map(|part| part.1).sum())));
    let table = Question::Seconds.answer(finished, DecisionTerms::default());
    let [all, first] = ["all", "simulate"].map(|name| table.column(name));
    for row in &table.rows {
        let parts: f64 = row[first.min(all + 1)..].iter().filter_map(serde_json::Value::as_f64).sum();
        assert!((row[all].as_f64().unwrap() - parts).abs() < 1e-9, "{row:?}");
    }
    let (steps, times) = (
        per_trial_sql("sum(seconds)", "v_step", "", DONE),
        per_trial_sql("max(seconds)", "v_error_time", "", DONE),
    );
    let times = by_trial(reader, &times).await;
    same("seconds of steps", &by_trial(reader, &steps).await, &times);
    same("time to an error", &times, &of(&|trial| trial.history.last().map(|last| last.0)));
    let best = by_trial(reader, &per_trial_sql("min(best_error_test)", "v_error_time", "", DONE)).await;
    same("best error", &best, &of(&|trial| trial.history.last().map(|last| last.1)));
}

/// Errors and probabilities of finished trials from the views and the loader.
async fn errors_agree(reader: &mut Reader, finished: &[Trial]) {
    let of = |number: &dyn Fn(&Trial) -> Option<f64>| of_trials(finished, number);
    for (b, body) in BodyState::ALL.into_iter().enumerate() {
        let (name, of_body) = (body.name(), format!("AND x.body = '{}'", body.name()));
        for (set, column, of_network) in [
            (Set::Test, format!("error_{name}"), "error_test"),
            (Set::Holdout, format!("holdout_error_{name}"), "error_holdout"),
            (Set::Median, format!("holdout_median_{name}"), "median_holdout"),
        ] {
            let view = by_trial(reader, &format!("SELECT hash, {column} FROM v_trial t {DONE}")).await;
            same(&column, &view, &of(&|trial| trial.error(body, set)));
            let ordinary = format!("{of_body} AND x.network < t.spec->>'$.evaluation.seeds'");
            let networks = per_trial_sql(&format!("avg({of_network})"), "v_network", &ordinary, DONE);
            same(&format!("{column} of networks"), &view, &by_trial(reader, &networks).await);
        }
        let linear = format!("SELECT hash, linear_holdout_error_{name} FROM v_trial t {DONE}");
        let linear = by_trial(reader, &linear).await;
        let readings = per_trial_sql("error_holdout", "v_reading", &format!("{of_body} AND x.whole"), DONE);
        same("linear brain", &linear, &by_trial(reader, &readings).await);
        same("linear brain", &linear, &of(&|trial| trial.readings.first().and_then(|r| r.errors[b][1])));
        for (q, place) in [(50, 0), (90, 1)] {
            let view = per_trial_sql(&format!("percentile(error, {q})"), "v_cast", &of_body, DONE);
            let quantile = |t: &Trial| t.casts.iter().find(|c| c.body == body).map(|c| c.errors[place]);
            same("casts", &by_trial(reader, &view).await, &of(&quantile));
        }
        let covered = per_trial_sql("avg(instants_covered)", "v_cast", &of_body, "");
        let of_casts = format!("{of_body} AND x.kind = 'instant' AND x.casting IS NOT NULL");
        let bands = per_trial_sql("avg(coverage)", "v_band", &of_casts, "");
        same("coverage", &by_trial(reader, &covered).await, &by_trial(reader, &bands).await);
    }
}

/// Counts from `status`, views, report and pages.
async fn counts_agree(reader: &mut Reader, db: &Path) {
    let [seconds, steps, attempts] = {
        let mut found = Vec::new();
        for column in ["seconds", "steps", "attempts"] {
            found.push(by_trial(reader, &format!("SELECT hash, {column} FROM v_trial")).await);
        }
        found.try_into().unwrap()
    };
    same("steps", &steps, &by_trial(reader, &per_trial_sql("count(*)", "v_step", "", "")).await);
    same("attempts", &attempts, &by_trial(reader, &per_trial_sql("count(*)", "v_attempt", "", "")).await);
    let words = ["status", db.to_str().unwrap(), "--format", "json"];
    let status = std::process::Command::new(env!("CARGO_BIN_EXE_metasense")).args(words).output().unwrap();
    let status: Vec<BTreeMap<String, serde_json::Value>> = serde_json::from_slice(&status.stdout).unwrap();
    let of_status = |column: &str| status.iter().filter_map(|row| row[column].as_f64()).sum::<f64>();
    assert!((of_status("seconds") - total(&seconds)).abs() < 0.06 * status.len() as f64, "{status:?}");
    assert_eq!(of_status("trials"), seconds.len() as f64);
    assert_eq!(of_status("attempts"), total(&attempts));
    let computed = "SELECT coalesce(sum(steps), 0) FROM v_attempt WHERE NOT redone";
    let computed = reader.query::<Table>(computed).await.unwrap().rows[0][0].as_f64().unwrap();
    assert_eq!(of_status("steps"), computed);
    let in_state = |state: &str, but: &[&str]| -> f64 {
        let is = |row: &&BTreeMap<String, serde_json::Value>| {
            row["state"] == state && !but.iter().any(|why| row["reason"] == *why)
        };
        status.iter().filter(is).map(|row| row["trials"].as_f64().unwrap()).sum()
    };
    let told = story(reader, None, DecisionTerms::default()).await.unwrap().states;
    let progress = Observer::default().look(reader).await.unwrap();
    for (name, of_status, of_report, of_page) in [
        ("all", of_status("trials"), told.all, progress.trials[0]),
        ("done", in_state("done", &[]), told.done, progress.trials[1]),
        ("failed", in_state("failed", &["cancelled"]), told.failed, progress.trials[2]),
    ] {
        assert_eq!(
            (of_report as f64, of_page as f64),
            (of_status, of_status),
            "{name}: {}",
            progress.summary
        );
    }
    let said = format!("{computed} steps in {} attempts", total(&attempts));
    assert!(progress.summary.contains(&said), "{}", progress.summary);
    let pages = Trials::of(db).await.unwrap();
    for (column, expected) in [("cpu_seconds", &seconds), ("steps", &steps), ("attempts", &attempts)] {
        let shown = pages.rows.iter().map(|row| (row.hash.clone(), row.cell(column).as_f64())).collect();
        same(&format!("{column} of pages"), expected, &shown);
    }
}

/// Sums are unchanged after a whole merge and after a merge of facts.
async fn merged_agrees(reader: &mut Reader, db: &Path, folder: &Path) {
    for extent in [Extent::Whole, Extent::Facts] {
        let out = folder.join(format!("{extent:?}.sqlite"));
        merge(extent, &[db.to_owned()], &out).await.unwrap();
        let mut merged = Reader::open(&out).await.unwrap();
        for sql in [
            "SELECT hash, seconds FROM v_trial",
            "SELECT hash, attempts FROM v_trial",
            "SELECT hash, steps FROM v_trial WHERE state = 'done'",
        ] {
            same(sql, &by_trial(reader, sql).await, &by_trial(&mut merged, sql).await);
        }
        let spent = |trial: &Trial| Some(trial.spent);
        let [before, after] = [finished_trials(reader).await, finished_trials(&mut merged).await];
        same("merged", &of_trials(&before.unwrap(), &spent), &of_trials(&after.unwrap(), &spent));
        merged.close().await;
    }
}

async fn agrees(db: &Path, folder: &Path) {
    let mut reader = Reader::open(db).await.unwrap();
    let finished = finished_trials(&mut reader).await.unwrap();
    seconds_agree(&mut reader, &finished).await;
    errors_agree(&mut reader, &finished).await;
    counts_agree(&mut reader, db).await;
    merged_agrees(&mut reader, db, folder).await;
    reader.close().await;
}

#[tokio::test]
async fn sums_agree_wherever_they_are_shown() {
    let bench = Bench::new();
    let db = bench.path("made-up.sqlite");
    made_up(&db).await;
    agrees(&db, &bench.path("")).await;
    // a shared body counts once, for the trial that trained it
    let mut reader = Reader::open(&db).await.unwrap();
    let finished = finished_trials(&mut reader).await.unwrap();
    let spent: f64 = finished.iter().map(|trial| trial.spent).sum();
    assert_eq!(spent, 10.0 + (2.0 + 4.0) + 3.0 + 4.0 * 0.875 + 1.5);
    let trained =
        finished.iter().filter(|trial| trial.seconds.iter().any(|part| part.0 == "simulate" && part.1 > 0.0));
    assert_eq!(trained.count(), 2);
    // histories are as if each trial had trained its body itself
    assert!(finished.iter().all(|trial| trial.history.last().unwrap().0 == 4.0 * 0.875));
    reader.close().await;
}

#[tokio::test]
async fn sums_agree_in_a_large_database() {
    let bench = Bench::new();
    let db = bench.path("synthetic.sqlite");
    tokio::task::spawn_blocking({
        let db = db.clone();
        move || synthetic::write(&db)
    })
    .await
    .unwrap();
    agrees(&db, &bench.path("")).await;
}
