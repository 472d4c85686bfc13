//! The code and the log of a result are stored with it and persist.

use std::path::Path;

use crate::common::{Bench, SPEC, TINY, results};
use metasense::cluster::merge::{Extent, merge};
use metasense::plan::Plan;
use metasense::provenance;
use metasense::store::{LogLevel, Store};
use metasense_schemas::record::{Checkpoint, StepRecord};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, Executor};

async fn change(db: &Path, sql: &str) {
    let mut connection = SqliteConnectOptions::new().filename(db).connect().await.unwrap();
    connection.execute(AssertSqlSafe(sql.to_owned())).await.unwrap();
    connection.close().await.unwrap();
}

fn said(bench: &Bench, arguments: &[&str]) -> String {
    String::from_utf8_lossy(&bench.metasense(arguments).stderr).into_owned()
}

/// A trial of other code is reported and, on request, repeated with the same bits. The copy of the other code does not return by a
/// merge.
#[tokio::test]
async fn what_other_code_has_made_is_told_and_made_again() {
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    bench.output(&["run", "tiny.toml"]);
    let (db, old) = ("results/tiny.sqlite", "results/old.sqlite");
    let code = provenance::code();
    let made = "SELECT DISTINCT code, simd IS NOT NULL AND host <> '' AND rustc LIKE 'rustc 1.%' AND threads = 1 FROM v_attempt";
    assert_eq!(
        bench.output(&["query", db, made, "--format", "csv"]).lines().nth(1),
        Some(&*format!("{code},1"))
    );
    let before = results(&bench, db);
    let [status, analyse] = [["status", db], ["analyse", db]];
    assert!(!said(&bench, &status).contains("different code"), "one code is not mixed");
    let other = "UPDATE attempt SET code = 'f00d', revision = 'abc-dirty' WHERE trial_id = (SELECT min(id) FROM trial)";
    change(&bench.path(db), other).await;
    for command in [&status, &analyse] {
        let said = said(&bench, command);
        let told = [
            "different code",
            "1 trial by f00d (abc-dirty)",
            &format!("1 trial by {code}"),
            "--redo-other-code",
        ];
        assert!(told.iter().all(|words| said.contains(words)), "{command:?}: {said}");
    }
    assert!(said(&bench, &["run", "tiny.toml"]).contains("nothing left to do"));
    std::fs::copy(bench.path(db), bench.path(old)).unwrap();
    bench.output(&["run", "tiny.toml", "--redo-other-code"]);
    assert_eq!(results(&bench, db), before);
    let attempts = "SELECT attempt, code, redone FROM v_attempt ORDER BY sensors, attempt";
    let found = bench.output(&["query", db, attempts, "--format", "csv"]);
    assert_eq!(found, format!("attempt,code,redone\n1,f00d,1\n2,{code},0\n1,{code},0\n"));
    assert!(!said(&bench, &status).contains("different code"));
    let out = bench.path("merged.sqlite");
    let summary = merge(Extent::Whole, &[bench.path(old), bench.path(db)], &out).await.unwrap();
    assert!(summary.findings.is_empty(), "{:?}", summary.findings);
    assert_eq!(bench.output(&["query", "merged.sqlite", attempts, "--format", "csv"]), found);
}

/// On request, a search first repeats trainings and judgements by other code, and failed trials.
#[tokio::test]
async fn a_search_makes_again_what_other_code_has_made() {
    let bench = Bench::new();
    let goal = "placements = 1\n[goal]\nerror = 1e6\n";
    bench.file(
        "tiny.toml",
        &TINY.replace("iterations = 10\nwidth = 16", "kind = \"linear\"").replace("[1, 2]", "[1]"),
    );
    bench.file("s.toml", &(std::fs::read_to_string(bench.path("tiny.toml")).unwrap() + goal));
    let db = "results/tiny.sqlite";
    let table = bench.output(&["design", "s.toml", "--format", "csv"]);
    let made = format!(
        "SELECT state, code = '{}' AS own, count(*) AS n FROM v_trial GROUP BY 1, 2",
        provenance::code()
    );
    let made = ["query", db, &made, "--format", "csv"];
    let first = bench.output(&made);
    change(&bench.path(db), "UPDATE attempt SET code = 'f00d'").await;
    assert_ne!(bench.output(&made), first);
    assert_eq!(bench.output(&["design", "s.toml", "--format", "csv"]), table, "nothing is asked for");
    assert_ne!(bench.output(&made), first);
    assert_eq!(bench.output(&["design", "s.toml", "--redo-other-code", "--format", "csv"]), table);
    assert_eq!(bench.output(&made), first);

    // the chosen body
    let chosen = "UPDATE trial SET state = 'failed', reason = 'out_of_memory' WHERE seed = 1";
    change(&bench.path(db), chosen).await;
    let failed = bench.metasense(&["design", "s.toml"]);
    let told = String::from_utf8_lossy(&failed.stderr);
    assert!(failed.status.code() == Some(1) && told.contains("1 trial failed"), "{told}");
    assert_eq!(bench.output(&["design", "s.toml", "--retry-failed", "--format", "csv"]), table);
    assert_eq!(bench.output(&made), first);
}

/// If a file that a spec names has changed, earlier trials stay, because no spec can repeat them.
#[tokio::test]
async fn trials_of_a_file_that_has_changed_stay() {
    let bench = Bench::new();
    let drawn = |seed: u32| {
        let random = TINY.replace("columns = 4", &format!("design = {{ random = {seed} }}\ncolumns = 4"));
        bench.file("random.toml", &random);
        bench.output(&["body", "draw", "random.toml", "--out", "a.svg", "--design-out", "a.npy"]);
    };
    let text = TINY.replace("columns = 4", "design = \"a.npy\"\ncolumns = 4").replace("[1, 2]", "[1]");
    bench.file("s.toml", &text);
    drawn(1);
    let before = bench.output(&["run", "s.toml", "--format", "csv"]);
    drawn(2);
    change(&bench.path("results/tiny.sqlite"), "UPDATE attempt SET code = 'f00d'").await;
    let after = bench.output(&["run", "s.toml", "--redo-other-code", "--format", "csv"]);
    assert!(after.lines().count() == 2 && after != before, "{before}{after}");
    let states = "SELECT state, code = 'f00d' AS other, holdout_error_optimised > 0 AS read FROM v_trial ORDER BY other";
    let states = ["query", "results/tiny.sqlite", states, "--format", "csv"];
    assert_eq!(bench.output(&states), "state,other,read\ndone,0,1\ndone,1,1\n");
    let failed = "UPDATE trial SET state = 'failed', reason = 'out_of_memory' WHERE id = (SELECT trial_id FROM attempt WHERE code = 'f00d')";
    change(&bench.path("results/tiny.sqlite"), failed).await;
    assert_eq!(bench.output(&["run", "s.toml", "--retry-failed", "--format", "csv"]), after);
    assert!(bench.output(&states).contains("failed,1,"));
}

/// A run's discarded result of other code does not remove the results of a database that computed the same trials itself.
#[tokio::test]
async fn a_result_outlives_one_that_was_thrown_away_elsewhere() {
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    let [a, b] = ["a.sqlite", "b.sqlite"].map(|name| {
        bench.output(&["run", "tiny.toml", "--db", name]);
        bench.path(name)
    });
    change(&b, "UPDATE attempt SET code = 'f00d'").await;
    let plan = Plan::new("tiny.toml", TINY.into()).unwrap();
    let mut store = Store::open(&b).await.unwrap();
    store.set_provenance(provenance::this_machine(1));
    let hashes: Vec<&str> = plan.trials.iter().map(|trial| trial.hash.as_str()).collect();
    assert_eq!(store.redo_other_code(&hashes).await.unwrap(), hashes.len());
    store.close().await.unwrap();
    let expected = results(&bench, "a.sqlite");
    for (out, inputs) in [("ab.sqlite", [&a, &b]), ("ba.sqlite", [&b, &a])] {
        merge(Extent::Whole, &inputs.map(Clone::clone), &bench.path(out)).await.unwrap();
        assert_eq!(results(&bench, out), expected);
    }
}

/// A trial that other code started is resumed, and both codes are stored; on request it restarts.
#[tokio::test]
async fn a_trial_of_two_codes_names_both() {
    let bench = Bench::new();
    let plan = Plan::new("s.toml", SPEC.into()).unwrap();
    let (db, hash) = (bench.path("s.sqlite"), &plan.trials[0].hash);
    let open = async || {
        let mut store = Store::open(&db).await.unwrap();
        store.set_provenance(provenance::this_machine(1));
        store.begin_sweep(&plan.spec, SPEC, &plan.trials).await.unwrap();
        store
    };
    for step in 0..2 {
        let mut store = open().await;
        let attempt = store.begin_attempt(hash).await.unwrap();
        let record = StepRecord { step, ..Default::default() };
        let checkpoint = Checkpoint { step: step + 1, ..Default::default() };
        store.record_step(hash, attempt, &record, &checkpoint).await.unwrap();
        store.close().await.unwrap();
        if step == 0 {
            change(&db, "UPDATE attempt SET code = NULL").await;
        }
    }
    let state = "SELECT code, steps FROM v_trial WHERE steps > 0 OR code IS NOT NULL";
    let both = format!("code,steps\nunknown {},2\n", provenance::code());
    assert_eq!(bench.output(&["query", "s.sqlite", state, "--format", "csv"]), both);
    let mut store = open().await;
    assert!(store.checkpoint(hash).await.unwrap().is_some());
    let hashes: Vec<&str> = plan.trials.iter().map(|trial| trial.hash.as_str()).collect();
    // only the given hashes
    assert_eq!(store.redo_other_code(&hashes[1..]).await.unwrap(), 0);
    assert_eq!(store.redo_other_code(&hashes).await.unwrap(), 1);
    assert_eq!(store.redo_other_code(&hashes).await.unwrap(), 0);
    assert_eq!((store.checkpoint(hash).await.unwrap(), store.begin_attempt(hash).await.unwrap()), (None, 3));
    store.close().await.unwrap();
    assert_eq!(bench.output(&["query", "s.sqlite", state, "--format", "csv"]), "code,steps\n");
}

/// The keys in which a trial differs from the nearest one, and the code of that one.
#[test]
fn status_names_the_keys_by_which_a_trial_is_another() {
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    bench.output(&["run", "tiny.toml"]);
    let expanded = |spec: &str| {
        let rows = bench.output(&["expand", spec, "--format", "csv"]);
        rows.lines().nth(1).unwrap().split(',').next().unwrap().to_owned()
    };
    let hash = expanded("tiny.toml");
    let own = said(&bench, &["status", "tiny.toml", &hash]);
    assert!(own.contains(&format!("trial {hash}: done")) && own.contains(provenance::code()), "{own}");
    bench.file(
        "other.toml",
        &TINY.replace("iterations = 4", "iterations = 5").replace("batch = 4", "batch = 3"),
    );
    let other = expanded("other.toml");
    let why = ["status", "other.toml", &other[..8], "--db", "results/tiny.sqlite", "--format", "csv"];
    assert_eq!(bench.output(&why), "key,here,nearest\noptimise.batch,3,4\noptimise.iterations,5,4\n");
    let said = said(&bench, &why);
    let told = [&*other, "is not in", &hash, "differs in 2 keys", provenance::code(), "rustc 1.", "4 steps"];
    assert!(told.iter().all(|words| said.contains(words)), "{said}");
}

/// Too many lines, too long a line, and the end of an attempt: the log is shown, bounded, and kept by a merge.
#[tokio::test]
async fn what_was_said_stays_with_the_trial() {
    let bench = Bench::new();
    let plan = Plan::new("s.toml", SPEC.into()).unwrap();
    let hash = &plan.trials[0].hash;
    let mut store = Store::open(bench.path("s.sqlite")).await.unwrap();
    store.begin_sweep(&plan.spec, SPEC, &plan.trials).await.unwrap();
    let attempt = store.begin_attempt(hash).await.unwrap();
    for line in 0..150 {
        let text = format!("line {line}: {}", "ä".repeat(if line == 3 { 10_000 } else { 3 }));
        store.log(hash, attempt, LogLevel::Warn, &text).await.unwrap();
    }
    store.log(hash, attempt, LogLevel::Error, "non_finite: sample 3").await.unwrap();
    store.fail(hash, attempt, "non_finite", true).await.unwrap();
    store.close().await.unwrap();
    merge(Extent::Whole, &[bench.path("s.sqlite")], &bench.path("merged.sqlite")).await.unwrap();
    for db in ["s.sqlite", "merged.sqlite"] {
        let bounds = "SELECT count(*), max(length(text)), max(line) FROM v_log";
        let bounds = bench.output(&["query", db, bounds, "--format", "csv"]);
        assert_eq!(bounds.lines().nth(1), Some("101,2002,101"), "{db}");
        let status = bench.metasense(&["status", db]);
        let told = String::from_utf8_lossy(&status.stderr).into_owned();
        let expected =
            format!("failed: 1 trial: non_finite: sample 3 (metasense status {db} {})", &hash[..8]);
        assert!(status.status.code() == Some(1) && told.contains(&expected), "{db}: {told}");
        let one = bench.metasense(&["status", db, &hash[..8], "--format", "csv"]);
        let lines = String::from_utf8_lossy(&one.stdout).into_owned();
        let [first, last] = [1, 101].map(|n| lines.lines().nth(n).unwrap_or_default());
        assert!(
            first.contains("warn,line 0: äää") && last.ends_with("error,non_finite: sample 3"),
            "{lines}"
        );
        let attempts = String::from_utf8_lossy(&one.stderr).into_owned();
        assert!(attempts.contains("attempt 1: failed (non_finite), 0 steps; code "), "{attempts}");
    }
}
