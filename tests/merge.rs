//! Databases merge into the same rows in any order, any number of times; nothing is dropped without a word.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Duration;

use crate::common::SPEC;
use metasense::cluster::merge::{Kind, MergeError, Summary, merge};
use metasense::plan::Plan;
use metasense::store::{Array, Reader, RunPlan, Store, StoreError, npy_bytes};
use metasense_schemas::record::{BodyEvaluation, Checkpoint, NetworkEvaluation, StepRecord, TrialResult};
use proptest::prelude::*;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};

/// What a copy of a trial has come to.
#[derive(Debug, Clone, Copy)]
enum Life {
    /// Done with this error by this instruction set.
    Done(f64, &'static str),
    /// Given up after a step.
    Failed(&'static str),
    /// Interrupted after so many steps.
    Steps(u32),
    /// Killed with its run after so many steps.
    Killed(u32),
}

fn plan(name: &str) -> Plan {
    let text = SPEC
        .replace("\"s\"", &format!("{name:?}"))
        .replace("sensors = [1, 2]", "sensors = [1, 2]\nseeds = [1, 2, 3]")
        .replace("[sweep]", "[optimise]\niterations = 4\n[sweep]");
    Plan::new("s.toml", text).unwrap()
}

async fn steps(store: &mut Store, hash: &str, attempt: u32, count: u32) {
    for step in 0..count {
        let record =
            StepRecord { step, outcome: "ok".into(), loss_test: Some(f64::from(step)), ..Default::default() };
        let design = vec![f64::from(step)];
        let checkpoint = Checkpoint { step: step + 1, design, ..Default::default() };
        store.record_step(hash, attempt, &record, &checkpoint).await.unwrap();
    }
}

async fn live(store: &mut Store, hash: &str, life: Life) {
    let attempt = store.begin_attempt(hash).await.unwrap();
    match life {
        Life::Done(error, simd) => {
            let network =
                NetworkEvaluation { error_test: Some(error), losses: vec![1.0, 0.5], ..Default::default() };
            let body = BodyEvaluation { design: vec![error], networks: vec![network], ..Default::default() };
            let result = TrialResult {
                initial: body.clone(),
                optimised: body,
                simd: simd.into(),
                ..Default::default()
            };
            steps(store, hash, attempt, 4).await;
            let npy = npy_bytes(&[1], &[error]);
            let array = Array { name: "forces", shape: &[1], npy: &npy };
            store.finish(hash, attempt, &result, &[array]).await.unwrap();
        }
        Life::Failed(reason) => {
            steps(store, hash, attempt, 1).await;
            store.fail(hash, attempt, reason).await.unwrap();
        }
        Life::Steps(n) => {
            steps(store, hash, attempt, n).await;
            store.give_up_attempt(hash, attempt, "stopped").await.unwrap();
        }
        Life::Killed(n) => steps(store, hash, attempt, n).await,
    }
}

/// A database of a sweep in which these trials, by their place in the plan, have come so far.
async fn database(path: &Path, plan: &Plan, shard: u32, lives: &[(usize, Life)]) {
    // Times are in milliseconds: no two databases are of one time.
    tokio::time::sleep(Duration::from_millis(3)).await;
    let mut store = Store::open(path).await.unwrap();
    let trials: Vec<_> = plan
        .trials
        .iter()
        .filter(|t| t.order as u32 % 3 + 1 == shard || lives.iter().any(|l| l.0 == t.order))
        .cloned()
        .collect();
    store.begin_sweep(&plan.spec, &plan.source.text, &trials).await.unwrap();
    let run = RunPlan { shard: (shard, 3), workers: (2, 1), trials: 2, estimated_seconds: 1.0 };
    let run = store.begin_run(&run).await.unwrap();
    for (i, life) in lives {
        live(&mut store, &plan.trials[*i].hash, *life).await;
    }
    store.end_run(&run, "interrupted", 0, 0).await.unwrap();
    store.close().await.unwrap();
}

/// Nine databases with all that can meet: partial ones and their later states, trials done twice by one instruction set
/// and by two, with and without the designs that older versions did not keep, failed in one and done in another, two sweeps
/// that share their trials, an older schema.
fn pool() -> &'static [PathBuf] {
    static POOL: OnceLock<(tempfile::TempDir, Vec<PathBuf>)> = OnceLock::new();
    let make = || {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(format!("{name}.sqlite"));
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let (s, other) = (plan("s"), plan("other"));
            database(&at("c-partial"), &s, 1, &[(0, Life::Done(5.0, "avx2")), (3, Life::Killed(2))]).await;
            std::fs::copy(at("c-partial"), at("a-later")).unwrap();
            database(&at("a-later"), &s, 1, &[(3, Life::Done(6.0, "avx2"))]).await;
            database(&at("b-again"), &s, 1, &[(0, Life::Done(5.0, "avx2")), (3, Life::Steps(3))]).await;
            let mut older = SqliteConnectOptions::new().filename(at("b-again")).connect().await.unwrap();
            let deleted =
                sqlx::query("DELETE FROM artifact WHERE name LIKE 'design_step_%'").execute(&mut older).await;
            assert_eq!(deleted.unwrap().rows_affected(), 7);
            older.close().await.unwrap();
            database(&at("d-wide"), &s, 1, &[(0, Life::Done(5.1, "avx512"))]).await;
            database(&at("e-differs"), &s, 1, &[(3, Life::Done(6.5, "avx2"))]).await;
            database(
                &at("f-failed"),
                &s,
                2,
                &[(1, Life::Failed("non_finite")), (4, Life::Failed("worker_killed(9)"))],
            )
            .await;
            database(&at("g-done"), &other, 2, &[(1, Life::Done(7.0, "avx2")), (4, Life::Steps(3))]).await;
            database(&at("h-open"), &other, 2, &[(1, Life::Steps(2)), (4, Life::Steps(2))]).await;
            std::fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/databases/v1.sqlite"), at("v1"))
                .unwrap();
        });
        let names =
            ["a-later", "b-again", "c-partial", "d-wide", "e-differs", "f-failed", "g-done", "h-open", "v1"];
        let files = names.iter().map(|name| at(name)).collect();
        (folder, files)
    };
    &POOL.get_or_init(make).1
}

fn merged(files: &[PathBuf], out: &Path) -> Result<Summary, MergeError> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(merge(files, out))
}

fn ask(db: &Path, sql: &str) -> Vec<String> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let mut reader = Reader::open(db).await.unwrap();
        let rows =
            reader.query::<metasense::look::Table>(sql).await.unwrap_or_else(|e| panic!("{sql}: {e}")).rows;
        reader.close().await;
        rows.iter().map(|row| serde_json::to_string(row).unwrap()).collect()
    })
}

/// All that a database says, without its own numbers for rows.
fn rows(db: &Path) -> Vec<String> {
    let mut all = Vec::new();
    for sql in [
        "SELECT * FROM v_trial",
        "SELECT hash, result, created_at FROM trial",
        "SELECT * FROM v_step",
        "SELECT * FROM v_network",
        "SELECT * FROM v_curve",
        "SELECT * FROM v_attempt",
        "SELECT hash, name, shape, hex(bytes) FROM v_artifact",
        "SELECT * FROM v_run",
        "SELECT t.hash, c.step, hex(c.bytes) FROM checkpoint c JOIN trial t ON t.id = c.trial_id",
        "SELECT name, text, spec, version, created_at FROM sweep",
        "SELECT s.name, t.hash, x.position FROM sweep_trial x JOIN sweep s ON s.id = x.sweep_id JOIN trial t ON t.id = x.trial_id",
    ] {
        let mut rows = ask(db, sql);
        rows.sort();
        all.push(sql.to_owned());
        all.extend(rows);
    }
    all
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 16, failure_persistence: None, ..ProptestConfig::default() })]

    /// Any subset in any order with any repetition: at once, one after the other, and merged of merged.
    #[test]
    fn order_and_repetition_make_no_difference(chosen in prop::collection::vec(0usize..9, 1..8), cut in 0usize..8) {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        // Files are sorted by name before they are merged: other names for another order.
        let named = |order: &[usize], prefix: &str| -> Vec<PathBuf> {
            order.iter().enumerate().map(|(place, i)| {
                let link = at(&format!("{prefix}{place}.sqlite"));
                std::os::unix::fs::symlink(&pool()[*i], &link).unwrap();
                link
            }).collect()
        };
        let files = named(&chosen, "chosen");
        merged(&files, &at("at-once")).unwrap();
        let expected = rows(&at("at-once"));

        let backwards: Vec<usize> = chosen.iter().rev().copied().collect();
        merged(&named(&backwards, "backwards"), &at("reversed")).unwrap();
        prop_assert_eq!(&rows(&at("reversed")), &expected);

        for file in &files {
            merged(std::slice::from_ref(file), &at("stepwise")).unwrap();
        }
        prop_assert_eq!(&rows(&at("stepwise")), &expected);

        let (left, right) = files.split_at(cut.min(files.len()));
        for (part, name) in [(left, "left.sqlite"), (right, "right.sqlite")] {
            if !part.is_empty() {
                merged(part, &at(name)).unwrap();
            }
        }
        let parts: Vec<PathBuf> = [at("right.sqlite"), at("left.sqlite")].into_iter().filter(|p| p.exists()).collect();
        merged(&parts, &at("of-merged")).unwrap();
        prop_assert_eq!(&rows(&at("of-merged")), &expected);
    }
}

#[test]
fn a_merge_of_one_database_is_that_database() {
    let folder = tempfile::tempdir().unwrap();
    for file in
        pool().iter().filter(|file| !file.ends_with("v1.sqlite") && !file.ends_with("c-partial.sqlite"))
    {
        let out = folder.path().join(file.file_name().unwrap());
        let before = std::fs::read(file).unwrap();
        merged(std::slice::from_ref(file), &out).unwrap();
        assert!(std::fs::read(file).unwrap() == before, "{} was written to", file.display());
        assert_eq!(rows(&out), rows(file));
        assert!(
            folder.path().read_dir().unwrap().all(|e| e
                .unwrap()
                .path()
                .extension()
                .is_some_and(|e| e == "sqlite"))
        );
    }
}

/// What was not kept is named: bits within one instruction set, outcomes, work; shards that have never run too.
#[test]
fn what_disagrees_or_is_left_out_is_listed() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out.sqlite");
    let summary = merged(pool(), &out).unwrap();
    let (s, file) = (plan("s"), |i: usize| pool()[i].clone());
    let found: Vec<_> =
        summary.findings.iter().map(|f| (f.kind, &f.hash, f.other.clone(), f.what.as_str())).collect();
    let hash = |i: usize| &s.trials[i].hash;
    let bits = "error_initial error_optimised alpha_initial alpha_optimised forces";
    let mut expected = vec![
        (Kind::Bits, hash(3), file(4), bits),
        (Kind::Outcome, hash(1), file(5), "failed there (non_finite), done here"),
        (Kind::LeftOut, hash(3), file(1), "pending (stopped): 1 attempts with 3 steps"),
        (Kind::LeftOut, hash(1), file(7), "pending (stopped): 1 attempts with 2 steps"),
        (Kind::LeftOut, hash(4), file(5), "failed (worker_killed(9)): 1 attempts with 1 steps"),
        (Kind::LeftOut, hash(4), file(7), "pending (stopped): 1 attempts with 2 steps"),
    ];
    expected.sort();
    let mut found = found;
    found.sort();
    assert_eq!(found, expected);
    assert_eq!(
        (summary.covered, summary.not_compared),
        (3, 1),
        "older states and equal bits; other instructions"
    );
    assert_eq!(summary.missing, [("s".to_owned(), 3, vec![3]), ("other".to_owned(), 3, vec![1, 3])]);
    assert!(summary.refused.is_empty(), "{:?}", summary.refused);
    let states = ask(
        &out,
        "SELECT state, reason, count(*) FROM v_trial WHERE sweep <> 's' OR true GROUP BY 1, 2 ORDER BY 1, 2",
    );
    assert!(states[0].starts_with("[\"done\",null,"), "{states:?}");
    // Both sweeps have all trials; `s` brought them.
    let named = ask(&out, "SELECT DISTINCT sweep FROM v_trial ORDER BY 1");
    assert!(!named.contains(&"[\"other\"]".to_owned()), "{named:?}");
}

/// Files that are no database, of a newer version, or cut short are refused by name; the rest is merged.
#[test]
fn what_cannot_be_read_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("notes.sqlite"), "no database at all, but long enough to be taken for one".repeat(20))
        .unwrap();
    let mut newer = std::fs::read(&pool()[0]).unwrap();
    newer[60..64].copy_from_slice(&99u32.to_be_bytes()); // user_version in the header
    std::fs::write(at("newer.sqlite"), newer).unwrap();
    let whole = std::fs::read(&pool()[0]).unwrap();
    std::fs::write(at("cut.sqlite"), &whole[..whole.len() / 2]).unwrap();
    let files =
        [at("cut.sqlite"), at("newer.sqlite"), at("notes.sqlite"), at("none.sqlite"), pool()[5].clone()];
    let summary = merged(&files, &at("out")).unwrap();
    let mut refused: Vec<_> =
        summary.refused.iter().map(|(p, why)| (p.file_name().unwrap().to_str().unwrap(), why)).collect();
    refused.sort();
    let names: Vec<_> = refused.iter().map(|r| r.0).collect();
    assert_eq!(names, ["cut.sqlite", "newer.sqlite", "none.sqlite", "notes.sqlite"], "{refused:?}");
    assert!(
        refused[1].1.contains("version 99") && refused[3].1.contains("not a metasense database"),
        "{refused:?}"
    );
    merged(&pool()[5..6], &at("alone")).unwrap();
    assert_eq!(rows(&at("out")), rows(&at("alone")));
    assert!(matches!(merged(&files[..4], &at("nothing")), Err(MergeError::Nothing { .. })));
    assert!(!at("nothing").exists());
}

/// A run that goes on is merged as it stands; a merge into the database of one is refused.
#[tokio::test]
async fn a_live_database_can_be_read_but_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let (db, out) = (folder.path().join("live.sqlite"), folder.path().join("out.sqlite"));
    let s = plan("s");
    let mut store = Store::open(&db).await.unwrap();
    store.begin_sweep(&s.spec, &s.source.text, &s.trials).await.unwrap();
    live(&mut store, &s.trials[0].hash, Life::Done(5.0, "avx2")).await;
    live(&mut store, &s.trials[1].hash, Life::Killed(2)).await;
    let summary = merge(std::slice::from_ref(&db), &out).await.unwrap();
    assert_eq!((summary.trials, summary.read), (6, 1));
    let refused = merge(std::slice::from_ref(&out), &db).await;
    assert!(matches!(refused, Err(MergeError::Store(StoreError::InUse { .. }))), "{refused:?}");
    let mut reader = Reader::open(&out).await.unwrap();
    let states = reader
        .query::<metasense::look::Table>("SELECT state, count(*) FROM v_trial GROUP BY 1")
        .await
        .unwrap();
    assert_eq!(serde_json::to_string(&states.rows).unwrap(), r#"[["done",1],["pending",5]]"#);
    // Goes on where the live one stood.
    let mut merged = Store::open(&out).await.unwrap();
    merged.begin_sweep(&s.spec, &s.source.text, &s.trials).await.unwrap();
    assert_eq!(merged.checkpoint(&s.trials[1].hash).await.unwrap().map(|c| c.step), Some(2));
}
