//! Databases merge into the same rows in any order, any number of times; all omissions are listed.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Duration;

use crate::common::SPEC;
use metasense::cluster::merge::{Extent, FindingKind, MergeError, Summary, merge};
use metasense::plan::Plan;
use metasense::reader::Reader;
use metasense::store::{RunPlan, Store, StoreError, StoredArray, npy_bytes};
use metasense_schemas::record::{BodyRecord, Checkpoint, NetworkRecord, StepRecord, TrialResult};
use proptest::prelude::*;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};

/// State of a copy of a trial.
#[derive(Debug, Clone, Copy)]
enum TrialState {
    /// Done, with error and instruction set.
    Done(f64, &'static str),
    /// Given up after one step, with a reason.
    Failed(&'static str),
    /// Interrupted after this number of steps.
    Steps(u32),
    /// Killed with its run after this number of steps.
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

async fn live(store: &mut Store, hash: &str, life: TrialState) {
    let attempt = store.begin_attempt(hash).await.unwrap();
    match life {
        TrialState::Done(error, simd) => {
            let network =
                NetworkRecord { error_test: Some(error), losses: vec![1.0, 0.5], ..Default::default() };
            let body = BodyRecord { design: vec![error], networks: vec![network], ..Default::default() };
            let result = TrialResult {
                initial: body.clone(),
                optimised: body,
                simd: simd.into(),
                ..Default::default()
            };
            steps(store, hash, attempt, 4).await;
            let npy = npy_bytes(&[1], &[error]);
            let array = StoredArray { name: "forces", shape: &[1], npy: &npy };
            store.finish(hash, attempt, &result, &[array]).await.unwrap();
        }
        TrialState::Failed(reason) => {
            steps(store, hash, attempt, 1).await;
            store.fail(hash, attempt, reason, true).await.unwrap();
        }
        TrialState::Steps(n) => {
            steps(store, hash, attempt, n).await;
            store.fail(hash, attempt, "stopped", false).await.unwrap();
        }
        TrialState::Killed(n) => steps(store, hash, attempt, n).await,
    }
}

/// A database of a sweep in which these trials, by index in the plan, have these states.
async fn database(path: &Path, plan: &Plan, shard: u32, lives: &[(usize, TrialState)]) {
    // Times have milliseconds: all databases get different ones.
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

/// Nine databases with all combinations: partial ones and their later states, trials done twice by one instruction set and by two,
/// with and without the designs that older versions did not store, failed in one and done in another, two sweeps with common
/// trials, an older schema.
fn pool() -> &'static [PathBuf] {
    static POOL: OnceLock<(tempfile::TempDir, Vec<PathBuf>)> = OnceLock::new();
    let make = || {
        // in the build folder, because statics are never dropped
        let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
        let at = |name: &str| folder.path().join(format!("{name}.sqlite"));
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let (s, other) = (plan("s"), plan("other"));
            database(
                &at("c-partial"),
                &s,
                1,
                &[(0, TrialState::Done(5.0, "avx2")), (3, TrialState::Killed(2))],
            )
            .await;
            std::fs::copy(at("c-partial"), at("a-later")).unwrap();
            database(&at("a-later"), &s, 1, &[(3, TrialState::Done(6.0, "avx2"))]).await;
            database(&at("b-again"), &s, 1, &[(0, TrialState::Done(5.0, "avx2")), (3, TrialState::Steps(3))])
                .await;
            let mut older = SqliteConnectOptions::new().filename(at("b-again")).connect().await.unwrap();
            let deleted =
                sqlx::query("DELETE FROM artifact WHERE name LIKE 'design_step_%'").execute(&mut older).await;
            assert_eq!(deleted.unwrap().rows_affected(), 7);
            older.close().await.unwrap();
            database(&at("d-wide"), &s, 1, &[(0, TrialState::Done(5.1, "avx512"))]).await;
            database(&at("e-differs"), &s, 1, &[(3, TrialState::Done(6.5, "avx2"))]).await;
            database(
                &at("f-failed"),
                &s,
                2,
                &[(1, TrialState::Failed("non_finite")), (4, TrialState::Failed("worker_killed(9)"))],
            )
            .await;
            database(
                &at("g-done"),
                &other,
                2,
                &[(1, TrialState::Done(7.0, "avx2")), (4, TrialState::Steps(3))],
            )
            .await;
            database(&at("h-open"), &other, 2, &[(1, TrialState::Steps(2)), (4, TrialState::Steps(2))]).await;
            std::fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/databases/v15.sqlite"), at("v15"))
                .unwrap();
        });
        let names =
            ["a-later", "b-again", "c-partial", "d-wide", "e-differs", "f-failed", "g-done", "h-open", "v15"];
        let files = names.iter().map(|name| at(name)).collect();
        (folder, files)
    };
    // in a new thread, because the first caller may be in a runtime
    &POOL.get_or_init(|| std::thread::spawn(make).join().expect("databases are made")).1
}

fn merged(files: &[PathBuf], out: &Path) -> Result<Summary, MergeError> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(merge(Extent::Whole, files, out))
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

/// All contents of a database except row ids.
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
    #![proptest_config(ProptestConfig { cases: 8, failure_persistence: None, ..ProptestConfig::default() })]

    /// Any subset in any order with any repetition: in one merge, in successive merges, and merges of merges.
    #[test]
    fn order_and_repetition_make_no_difference(chosen in prop::collection::vec(0usize..9, 1..8), cut in 0usize..8) {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        // Files are sorted by name before merging, so other names give another order.
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
        pool().iter().filter(|file| !file.ends_with("v15.sqlite") && !file.ends_with("c-partial.sqlite"))
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

/// Omissions are listed: bits within one instruction set, outcomes, work; also shards that never ran.
#[test]
fn what_disagrees_or_is_left_out_is_listed() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out.sqlite");
    let summary = merged(pool(), &out).unwrap();
    let (s, file) = (plan("s"), |i: usize| pool()[i].clone());
    let found: Vec<_> =
        summary.findings.iter().map(|f| (f.kind, &f.hash, f.other.clone(), f.what.as_str())).collect();
    let hash = |i: usize| &s.trials[i].hash;
    let bits = "error_initial error_optimised alpha_initial alpha_optimised forces network";
    let mut expected = vec![
        (FindingKind::Bits, hash(3), file(4), bits),
        (
            FindingKind::Outcome,
            hash(1),
            file(5),
            "failed in the discarded copy (non_finite), done in the kept copy",
        ),
        (FindingKind::LeftOut, hash(3), file(1), "pending (stopped): 1 attempts with 3 steps"),
        (FindingKind::LeftOut, hash(1), file(7), "pending (stopped): 1 attempts with 2 steps"),
        (FindingKind::LeftOut, hash(4), file(5), "failed (worker_killed(9)): 1 attempts with 1 steps"),
        (FindingKind::LeftOut, hash(4), file(7), "pending (stopped): 1 attempts with 2 steps"),
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
    // Both sweeps contain all trials; `s` came first.
    let named = ask(&out, "SELECT DISTINCT sweep FROM v_trial ORDER BY 1");
    assert!(!named.contains(&"[\"other\"]".to_owned()), "{named:?}");
}

/// Files that are not databases, of a newer version or truncated are refused by name; the rest is merged.
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

/// A database of an active run can be merged; a merge into it is refused.
#[tokio::test]
async fn a_live_database_can_be_read_but_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let (db, out) = (folder.path().join("live.sqlite"), folder.path().join("out.sqlite"));
    let s = plan("s");
    let mut store = Store::open(&db).await.unwrap();
    store.begin_sweep(&s.spec, &s.source.text, &s.trials).await.unwrap();
    live(&mut store, &s.trials[0].hash, TrialState::Done(5.0, "avx2")).await;
    live(&mut store, &s.trials[1].hash, TrialState::Killed(2)).await;
    let summary = merge(Extent::Whole, std::slice::from_ref(&db), &out).await.unwrap();
    assert_eq!((summary.trials, summary.read), (6, 1));
    let refused = merge(Extent::Whole, std::slice::from_ref(&out), &db).await;
    assert!(matches!(refused, Err(MergeError::Store(StoreError::InUse(..)))), "{refused:?}");
    let mut reader = Reader::open(&out).await.unwrap();
    let states = reader
        .query::<metasense::look::Table>("SELECT state, count(*) FROM v_trial GROUP BY 1")
        .await
        .unwrap();
    assert_eq!(serde_json::to_string(&states.rows).unwrap(), r#"[["done",1],["pending",5]]"#);
    // Resumes from the state of the active run.
    let mut merged = Store::open(&out).await.unwrap();
    merged.begin_sweep(&s.spec, &s.source.text, &s.trials).await.unwrap();
    assert_eq!(merged.checkpoint(&s.trials[1].hash).await.unwrap().map(|c| c.step), Some(2));
}

/// A database with one finished trial.
async fn one(path: &Path, name: &str, trial: usize) {
    database(path, &plan(name), 1, &[(trial, TrialState::Done(5.0, "avx2"))]).await;
}

/// Names and contents of all files in a folder, including hidden ones.
fn files(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let paths = folder.read_dir().unwrap().map(|entry| entry.unwrap().path()).filter(|path| path.is_file());
    let mut files: Vec<_> = paths.map(|path| (path.clone(), std::fs::read(path).unwrap())).collect();
    files.sort();
    files
}

/// A text file, a database of a newer version, a damaged one, one damaged in the middle, a folder: an error before anything
/// changes.
#[tokio::test]
async fn a_result_that_cannot_be_read_is_refused_and_left_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    one(&at("a.sqlite"), "s", 0).await;
    let whole = std::fs::read(&pool()[0]).unwrap();
    std::fs::write(at("notes.txt"), "mine alone ".repeat(200)).unwrap();
    std::fs::write(at("short.txt"), "mine").unwrap();
    let mut newer = whole.clone();
    newer[60..64].copy_from_slice(&99u32.to_be_bytes());
    std::fs::write(at("newer.sqlite"), newer).unwrap();
    std::fs::write(at("cut.sqlite"), &whole[..whole.len() / 2]).unwrap();
    let mut holed = whole.clone();
    holed[8192..whole.len() - 4096].fill(0xa5);
    std::fs::write(at("holed.sqlite"), holed).unwrap();
    std::fs::create_dir(at("folder")).unwrap();
    let before = files(folder.path());
    for (out, why) in [
        ("notes.txt", "not a metasense database"),
        ("short.txt", "not a metasense database"),
        ("newer.sqlite", "version 99"),
        ("cut.sqlite", "malformed"),
        ("holed.sqlite", "malformed"),
        ("folder", "not a regular file"),
    ] {
        let refused = merge(Extent::Whole, &[at("a.sqlite")], &at(out)).await.unwrap_err();
        let said = metasense::exit::chain(&refused);
        assert!(said.contains(why) && said.contains(out), "{out}: {said}");
        assert!(files(folder.path()) == before, "{out}: a file has changed");
    }
}

/// A run that starts on a result during its first merge waits, is refused, or comes first; its records are never lost.
#[test]
fn a_run_and_a_merge_do_not_take_a_file_from_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let inputs: Vec<PathBuf> = (0..12).map(|i| folder.path().join(format!("in-{i}.sqlite"))).collect();
    runtime.block_on(async {
        for (i, input) in inputs.iter().enumerate() {
            one(input, &format!("s{i}"), 0).await;
        }
    });
    let mut between = 0;
    for round in 0..12 {
        let out = folder.path().join(format!("out-{round}.sqlite"));
        let merging = std::thread::spawn({
            let (inputs, out) = (inputs.clone(), out.clone());
            move || merged(&inputs, &out)
        });
        std::thread::sleep(Duration::from_millis(round * 4));
        let recorded = runtime.block_on(async {
            let own = plan("own");
            let opened = Store::open(&out).await;
            let mut store = match opened {
                Ok(store) => store,
                Err(StoreError::InUse(..)) => return false,
                Err(error) => panic!("{error}"),
            };
            store.begin_sweep(&own.spec, &own.source.text, &own.trials).await.unwrap();
            between += u64::from(!merging.is_finished());
            // As long as a run would hold it.
            tokio::time::sleep(Duration::from_millis(20)).await;
            store.close().await.unwrap();
            true
        });
        let merge_done = match merging.join().unwrap() {
            Ok(_) => true,
            Err(MergeError::Store(StoreError::InUse(..))) => false,
            Err(error) => panic!("{error}"),
        };
        assert!(recorded || merge_done, "both were refused");
        let sweeps = ask(&out, "SELECT count(*), sum(name = 'own') FROM sweep");
        let expected = 12 * u64::from(merge_done) + u64::from(recorded);
        assert_eq!(sweeps, [format!("[{expected},{}]", u64::from(recorded))], "round {round}");
    }
    println!("{between} runs held the file while a merge had begun");
}

/// With few file descriptors, all inputs are merged, or the result is unchanged and the merge gives the reason.
#[test]
fn a_shortage_of_descriptors_refuses_no_input() {
    let folder = tempfile::tempdir().unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let inputs = folder.path().join("in");
    std::fs::create_dir(&inputs).unwrap();
    for i in 0..60 {
        std::fs::copy(&pool()[i % 8], inputs.join(format!("{i}.sqlite"))).unwrap();
    }
    let out = folder.path().join("out.sqlite");
    let mut merges = 0;
    for limit in [64, 30, 16, 14, 12, 10, 8, 6] {
        let _ = std::fs::remove_file(&out);
        runtime.block_on(one(&out, "own", 0));
        let before = std::fs::read(&out).unwrap();
        let script = format!("ulimit -n {limit}; exec \"$0\" cluster merge in --out out.sqlite");
        let mut command = std::process::Command::new("sh");
        command.args(["-c", &script, env!("CARGO_BIN_EXE_metasense")]).current_dir(folder.path());
        let output = command.output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!said.contains("refused"), "{limit}: {said}");
        if said.contains("from 60 databases") {
            merges += 1;
            assert_eq!(ask(&out, "SELECT sum(name = 'own') FROM sweep"), ["[1]"]);
        } else {
            assert!(!output.status.success() && std::fs::read(&out).unwrap() == before, "{limit}: {said}");
        }
    }
    assert!((1..8).contains(&merges), "{merges} merges of 8");
}

/// As after a kill: a step is only in the log (WAL) beside the file.
async fn left_behind(path: &Path) {
    let folder = tempfile::tempdir().unwrap();
    let (db, s) = (folder.path().join("db.sqlite"), plan("s"));
    let mut store = Store::open(&db).await.unwrap();
    store.begin_sweep(&s.spec, &s.source.text, &s.trials).await.unwrap();
    live(&mut store, &s.trials[0].hash, TrialState::Killed(2)).await;
    for end in ["", "-wal"] {
        std::fs::copy(folder.path().join(format!("db.sqlite{end}")), format!("{}{end}", path.display()))
            .unwrap();
    }
}

/// The log (WAL) counts for a merge, a query and a run, also behind a link and where its index cannot be created.
#[tokio::test]
async fn a_log_is_read_behind_a_link_and_in_a_folder_that_cannot_be_written() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let steps = async |db: &Path| {
        let mut reader = Reader::open(db).await.unwrap();
        let table: metasense::look::Table = reader.query("SELECT count(*) FROM v_step").await.unwrap();
        reader.close().await;
        table.rows[0][0].as_u64()
    };
    for (round, readonly) in [false, true].into_iter().enumerate() {
        let (db, link) = (at(&format!("db{round}.sqlite")), at(&format!("link{round}.sqlite")));
        left_behind(&db).await;
        std::os::unix::fs::symlink(&db, &link).unwrap();
        let index = at(&format!("db{round}.sqlite-shm"));
        if readonly {
            // Nobody can create an index there, not even root.
            std::fs::create_dir(&index).unwrap();
        }
        let before = files(folder.path());
        let out = at(&format!("out{round}"));
        let summary = merge(Extent::Whole, std::slice::from_ref(&link), &out).await.unwrap();
        assert!(summary.refused.is_empty(), "{:?}", summary.refused);
        assert_eq!(steps(&out).await, Some(2), "merged, {readonly}");
        std::fs::remove_file(&out).unwrap();
        assert!(files(folder.path()) == before, "an input has changed");
        assert_eq!(steps(&link).await, Some(2), "read, {readonly}");
        if !readonly {
            let mut store = Store::open(&link).await.unwrap();
            let s = plan("s");
            store.begin_sweep(&s.spec, &s.source.text, &s.trials).await.unwrap();
            assert_eq!(store.checkpoint(&s.trials[0].hash).await.unwrap().map(|c| c.step), Some(2));
        }
    }
}

/// A view in place of a table, a computed column, or a default: small files that would become large.
#[tokio::test]
async fn what_an_input_does_not_hold_as_rows_is_not_copied() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    one(&at("good.sqlite"), "s", 1).await;
    for (i, sql) in [
        "DROP VIEW v_artifact; DROP TABLE artifact; CREATE VIEW artifact AS SELECT id AS trial_id, 'a' || value AS name,
           '[1]' AS shape, zeroblob(1000000) AS bytes FROM trial, json_each('[1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]')",
        "DROP TABLE log; CREATE TABLE log (trial_id INTEGER NOT NULL, attempt INTEGER NOT NULL, line INTEGER NOT NULL,
           at TEXT NOT NULL, level TEXT NOT NULL, text TEXT NOT NULL AS (hex(zeroblob(1000000))));
         INSERT INTO log SELECT id, 1, 1, '', 'info' FROM trial",
        "PRAGMA writable_schema = ON; UPDATE sqlite_schema SET sql =
           replace(sql, 'text TEXT NOT NULL', 'text TEXT NOT NULL DEFAULT ''long''') WHERE name = 'log'",
    ]
    .into_iter()
    .enumerate()
    {
        let hostile = at(&format!("hostile{i}.sqlite"));
        one(&hostile, "s", 0).await;
        let mut db = SqliteConnectOptions::new().filename(&hostile).connect().await.unwrap();
        sqlx::raw_sql(sqlx::AssertSqlSafe(sql.to_owned())).execute(&mut db).await.unwrap();
        db.close().await.unwrap();
        let out = at("out.sqlite");
        let summary = merge(Extent::Whole, &[at("good.sqlite"), hostile.clone()], &out).await.unwrap();
        assert_eq!((summary.read, summary.refused.len()), (1, 1), "{i}: {:?}", summary.refused);
        assert!(summary.refused[0].1.contains("not a stored column"), "{:?}", summary.refused);
        assert!(out.metadata().unwrap().len() < 1_000_000);
        std::fs::remove_file(&out).unwrap();
    }
    // Additions by users are harmless.
    let mut db = SqliteConnectOptions::new().filename(at("good.sqlite")).connect().await.unwrap();
    sqlx::raw_sql("CREATE TABLE note (text); CREATE VIEW mine AS SELECT hash FROM trial; ALTER TABLE trial ADD COLUMN note TEXT")
        .execute(&mut db)
        .await
        .unwrap();
    db.close().await.unwrap();
    assert_eq!(merge(Extent::Whole, &[at("good.sqlite")], &at("out.sqlite")).await.unwrap().refused, []);
}

/// `gc` lists and removes leftovers of ended processes, and copies of a shard whose rows are all in the last copy. Files of another
/// machine's processes, and copies with rows of their own, stay.
#[test]
fn gc_removes_what_holds_nothing_of_its_own() {
    let bench = crate::common::Bench::new();
    let mark = metasense::files::own_mark();
    let host = mark.rsplit_once('-').unwrap().0;
    let ended = u32::MAX;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let shards = bench.path("results/s.shards");
    let [contained, own_row, later] =
        [1, 2, 3].map(|n| shards.join(format!("shard-1-of-3.{n}-{host}-{ended}.sqlite")));
    runtime.block_on(async {
        let s = plan("s");
        database(&contained, &s, 1, &[(0, TrialState::Done(5.0, "avx2")), (3, TrialState::Steps(2))]).await;
        std::fs::copy(&contained, &later).unwrap();
        std::fs::copy(&contained, &own_row).unwrap();
        database(&own_row, &s, 1, &[(1, TrialState::Done(5.0, "avx2"))]).await;
        database(&later, &s, 1, &[(4, TrialState::Done(5.0, "avx2"))]).await;
    });
    let left = [format!(".a.svg.{host}-{ended}.tmp"), format!("shard-1-of-3.4-{host}-{ended}.tmp")];
    let stays =
        [format!(".a.svg.{mark}.tmp"), format!(".b.svg.elsewhere-{ended}.tmp"), "notes.tmp".to_owned()];
    for name in left.iter().chain(&stays) {
        std::fs::write(shards.join(name), "x").unwrap();
    }
    let listed = bench.metasense(&["cluster", "gc"]);
    assert_eq!(String::from_utf8_lossy(&listed.stdout).lines().count(), 2 + 3, "{listed:?}");
    assert_eq!(files(&shards).len(), 8);
    bench.output(&["cluster", "gc", "--yes"]);
    let mut expected: Vec<PathBuf> = stays.iter().map(|name| shards.join(name)).collect();
    expected.extend([own_row, later]);
    expected.sort();
    assert_eq!(files(&shards).into_iter().map(|file| file.0).collect::<Vec<_>>(), expected);
}

/// The same rows as from a whole merge, except the largest ones, which refer to the inputs.
#[test]
fn facts_are_all_that_a_whole_merge_says_but_for_steps_curves_and_arrays() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    merged(pool(), &at("whole")).unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(merge(Extent::Facts, pool(), &at("facts"))).unwrap();
    for file in pool().iter().rev() {
        let read =
            runtime.block_on(merge(Extent::Facts, std::slice::from_ref(file), &at("stepwise"))).unwrap();
        assert_eq!((read.read, read.known), (1, 0));
    }
    for sql in [
        "SELECT hash, state, reason, error_optimised, best_step, attempts, seconds, sweep, code, placed FROM v_trial",
        "SELECT hash, attempt, state, reason, steps, started_at, ended_at, code, redone FROM v_attempt",
        "SELECT * FROM v_network",
        "SELECT * FROM v_run",
        "SELECT * FROM v_log",
        "SELECT name, text, spec, version, created_at FROM sweep",
    ] {
        let sorted = |db: &str| {
            let mut rows = ask(&at(db), sql);
            rows.sort();
            rows
        };
        assert_eq!(sorted("facts"), sorted("whole"), "{sql}");
        assert_eq!(sorted("stepwise"), sorted("whole"), "{sql}");
    }
    for table in ["step", "curve", "artifact", "checkpoint"] {
        assert_eq!(ask(&at("facts"), &format!("SELECT count(*) FROM {table}")), ["[0]"], "{table}");
    }
    // Each trial's file contains the trial in its latest state.
    let homes = "SELECT t.hash, t.state, s.file FROM elsewhere e JOIN trial t ON t.id = e.trial_id JOIN source s ON s.id = e.source_id";
    let homes = ask(&at("facts"), homes);
    assert_eq!(homes.len(), ask(&at("facts"), "SELECT hash FROM trial").len());
    for home in homes {
        let [hash, state, file] = serde_json::from_str::<[String; 3]>(&home).unwrap();
        let there =
            format!("SELECT count(*) FROM trial WHERE hash = '{hash}' AND state IN ('{state}', 'running')");
        // A copy, because reading upgrades an older database, which other tests read.
        std::fs::copy(&file, at("home")).unwrap();
        assert_eq!(ask(&at("home"), &there), ["[1]"], "{home}");
    }
    // Facts cannot be resumed, and whole trials do not mix with facts.
    let facts = runtime.block_on(async {
        let mut store = Store::open(at("facts")).await.unwrap();
        let s = plan("s");
        store.begin_sweep(&s.spec, &s.source.text, &s.trials).await
    });
    assert!(matches!(facts, Err(StoreError::FactsAlone(..))), "{facts:?}");
    assert!(matches!(merged(&pool()[..1], &at("facts")), Err(MergeError::Result { .. })));
    let mixed = runtime.block_on(merge(Extent::Facts, &pool()[..1], &at("whole")));
    assert!(matches!(mixed, Err(MergeError::NotFacts(_))), "{mixed:?}");
    assert_eq!(merged(&[at("facts"), pool()[0].clone()], &at("more")).unwrap().refused.len(), 1);
}

/// A second merge does not open unchanged inputs, which may even be damaged. It opens changed inputs, and all inputs after trials
/// were removed.
#[test]
fn a_second_merge_reads_only_what_is_new() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let files: Vec<PathBuf> = (0..4).map(|i| at(&format!("in-{i}.sqlite"))).collect();
    for (i, file) in files.iter().enumerate() {
        runtime.block_on(one(file, &format!("s{i}"), 0));
    }
    let out = at("out.sqlite");
    merged(&files[..2], &out).unwrap();
    // Same size and time of modification.
    let (kept, stamp) = (std::fs::read(&files[0]).unwrap(), files[0].metadata().unwrap().modified().unwrap());
    let put = |bytes: &[u8]| {
        use std::io::Write;
        let mut file = std::fs::OpenOptions::new().write(true).open(&files[0]).unwrap();
        file.write_all(bytes).unwrap();
        file.set_modified(stamp).unwrap();
    };
    put(&vec![0xa5; kept.len()]);
    let second = merged(&files[..3], &out).unwrap();
    assert_eq!((second.read, second.known, second.refused.len()), (3, 2, 0), "the result is none of them");
    let before = out.metadata().unwrap().modified().unwrap();
    let third = merged(&files[..3], &out).unwrap();
    assert_eq!((third.read, third.known, third.trials), (3, 3, second.trials));
    assert_eq!(out.metadata().unwrap().modified().unwrap(), before, "nothing new was written all the same");
    put(&kept);
    runtime.block_on(database(&files[1], &plan("s1"), 1, &[(1, TrialState::Done(5.0, "avx2"))]));
    assert_eq!(merged(&files, &out).unwrap().known, 2, "one has changed, one is new");
    merged(&files, &at("at-once.sqlite")).unwrap();
    assert_eq!(rows(&out), rows(&at("at-once.sqlite")));
    let hash = plan("s0").trials[0].hash.clone();
    runtime.block_on(async {
        let mut store = Store::open(&out).await.unwrap();
        store.remove([hash.as_str()].into_iter()).await.unwrap();
        store.close().await.unwrap();
    });
    assert_eq!(merged(&files, &out).unwrap().known, 0);
    assert_eq!(rows(&out), rows(&at("at-once.sqlite")), "what was taken out came again");
}

/// A trial cancelled while pending is also cancelled in a result that has it as pending.
#[tokio::test]
async fn a_trial_that_is_cancelled_while_it_waits_is_so_in_the_result() {
    let folder = tempfile::tempdir().unwrap();
    let [shard, out] = ["shard.sqlite", "out.sqlite"].map(|name| folder.path().join(name));
    let plan = plan("s");
    database(&shard, &plan, 1, &[(0, TrialState::Steps(2))]).await;
    merge(Extent::Whole, std::slice::from_ref(&shard), &out).await.unwrap();
    let mut store = Store::open(&shard).await.unwrap();
    let waiting = &plan.trials[3];
    store.begin_sweep(&plan.spec, &plan.source.text, std::slice::from_ref(waiting)).await.unwrap();
    store.fail_pending(&waiting.hash, "cancelled").await.unwrap();
    store.close().await.unwrap();
    merge(Extent::Whole, std::slice::from_ref(&shard), &out).await.unwrap();
    let states = format!("SELECT state || ' ' || reason FROM trial WHERE hash = '{}'", waiting.hash);
    let mut reader = Reader::open(&out).await.unwrap();
    assert_eq!(reader.query::<metasense::look::Table>(&states).await.unwrap().rows, [["failed cancelled"]]);
    reader.close().await;
}

/// Differences between two copies of one run are listed in any order of the files. If checksums show which copy is damaged, the
/// other is kept.
#[tokio::test]
async fn copies_of_one_run_that_differ_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let plan = plan("s");
    let lives = [(0, TrialState::Done(5.0, "avx2")), (3, TrialState::Steps(2))];
    database(&at("whole.sqlite"), &plan, 1, &lives).await;
    let [done, open] = [0, 3].map(|order: usize| plan.trials[order].hash.clone());
    let zeroed = "bytes = zeroblob(length(bytes))";
    let of_done = "WHERE state = 'done'";
    let bits = |what| vec![(FindingKind::Bits, what)];
    let forces = vec![(FindingKind::Damaged, "forces"), (FindingKind::Bits, "forces")];
    for (sql, hash, expected, whole_is_kept) in [
        (
            format!("UPDATE trial SET holdout_error_optimised = 99 {of_done}"),
            &done,
            bits("holdout_error_optimised"),
            false,
        ),
        ("UPDATE trial SET result = json_set(result, '$.best_step', 7)".into(), &done, bits("result"), false),
        ("UPDATE network SET error_test = 99".into(), &done, bits("network"), false),
        (
            format!(
                "UPDATE step SET loss_test = 99 WHERE step = 1 AND trial_id = (SELECT id FROM trial {of_done})"
            ),
            &done,
            bits("step"),
            false,
        ),
        (
            format!("UPDATE trial SET spec = json_set(spec, '$.point.seed', 9) {of_done}"),
            &done,
            bits("spec"),
            false,
        ),
        (format!("UPDATE artifact SET {zeroed} WHERE name = 'forces'"), &done, forces, true),
        (format!("UPDATE checkpoint SET {zeroed}"), &open, vec![(FindingKind::Damaged, "checkpoint")], true),
    ] {
        for changed in ["a.sqlite", "z.sqlite"] {
            std::fs::copy(at("whole.sqlite"), at(changed)).unwrap();
            let options = SqliteConnectOptions::new().filename(at(changed)).foreign_keys(false);
            let mut disk = options.disable_statement_logging().connect().await.unwrap();
            sqlx::raw_sql(sqlx::AssertSqlSafe(sql.clone())).execute(&mut disk).await.unwrap();
            disk.close().await.unwrap();
            let summary =
                merge(Extent::Whole, &[at("whole.sqlite"), at(changed)], &at("out.sqlite")).await.unwrap();
            let found: Vec<_> = summary.findings.iter().map(|f| (f.kind, f.what.as_str())).collect();
            assert_eq!(found, expected, "{sql} in {changed}: {:?}", summary.findings);
            for finding in &summary.findings {
                assert_eq!(&finding.hash, hash, "{sql}");
                let files = [finding.kept.clone(), finding.other.clone()];
                assert!(!whole_is_kept || files == [at("whole.sqlite"), at(changed)], "{sql}: {files:?}");
            }
            if whole_is_kept {
                let mut store = Store::open(at("out.sqlite")).await.unwrap();
                store.begin_sweep(&plan.spec, &plan.source.text, &plan.trials).await.unwrap();
                assert_eq!(store.checkpoint(&open).await.unwrap().map(|c| c.step), Some(2), "{sql}");
                store.close().await.unwrap();
            }
            std::fs::remove_file(at("out.sqlite")).unwrap();
            std::fs::remove_file(at(changed)).unwrap();
        }
    }
    // the paths of recorded forces are not compared
    for name in ["p", "q"] {
        std::fs::copy(at("whole.sqlite"), at(name)).unwrap();
        let options = SqliteConnectOptions::new().filename(at(name)).disable_statement_logging();
        let mut disk = options.connect().await.unwrap();
        let recorded = format!("json('{{\"files\": [\"{name}\"]}}')");
        let sql = format!("UPDATE trial SET spec = json_set(spec, '$.stimuli.recorded', {recorded})");
        sqlx::raw_sql(sqlx::AssertSqlSafe(sql)).execute(&mut disk).await.unwrap();
        disk.close().await.unwrap();
    }
    let summary = merge(Extent::Whole, &[at("p"), at("q")], &at("out.sqlite")).await.unwrap();
    assert_eq!((summary.findings, summary.covered), (vec![], 2));
}
