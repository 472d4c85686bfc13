//! A database of an earlier build of this version opens and resumes; older versions are refused.
//!
//! `tests/databases/v15.sqlite` was made by `cargo test --test program upgrade -- --ignored`: two trials, one done, one interrupted
//! after a step.

use std::path::{Path, PathBuf};

use crate::common::{Bench, SPEC};
use metasense::plan::Plan;
use metasense::reader::Reader;
use metasense::store::Store;
use metasense_schemas::database::VERSION;
use metasense_schemas::record::{BodyRecord, Checkpoint, NetworkRecord, StepRecord, TrialResult};

pub fn database() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../tests/databases/v{VERSION}.sqlite"))
}

/// The sweep of that database, with the defaults of version 1 as values: defaults may change, but hashes must not.
fn plan() -> Plan {
    let then = "[optimise]\nprotocol = \"paper\"\niterations = 100\nlearning_rate = 0.1\n\
                [solver]\nmethod = \"tsit5\"\ntolerance = 1e-6\n[evaluation]\nseeds = 1\n";
    let spec = SPEC.replace("test = 4\n", "test = 4\nholdout = 60\n");
    Plan::new("s.toml", format!("{spec}{then}")).unwrap()
}

fn checkpoint() -> Checkpoint {
    Checkpoint { step: 1, design: vec![0.5; 168], weights: vec![0.25; 8], ..Default::default() }
}

fn result() -> TrialResult {
    let body = |error: f64| BodyRecord {
        design: vec![0.5; 168],
        networks: vec![NetworkRecord {
            error_test: Some(error),
            error_holdout: Some(error),
            losses: vec![1.0, 0.5],
            outcome: "ok".into(),
            ..Default::default()
        }],
        ..Default::default()
    };
    TrialResult { initial: body(20.0), optimised: body(10.0), ..Default::default() }
}

#[tokio::test]
#[ignore = "makes the database that the other tests keep for ever"]
async fn make_the_database_of_this_version() {
    let path = database();
    assert!(!path.exists(), "{} is there already", path.display());
    let plan = plan();
    let mut store = Store::open(&path).await.unwrap();
    store.begin_sweep(&plan.spec, &plan.source.text, &plan.trials).await.unwrap();
    let (done, open) = (&plan.trials[0].hash, &plan.trials[1].hash);
    let step = StepRecord { outcome: "ok".into(), projection: "untouched".into(), ..Default::default() };
    for hash in [done, open] {
        store.begin_attempt(hash).await.unwrap();
        store.record_step(hash, 1, &step, &checkpoint()).await.unwrap();
    }
    store.finish(done, 1, &result(), &[]).await.unwrap();
    store.close().await.unwrap();
}

#[tokio::test]
async fn a_database_of_an_earlier_build_goes_on() {
    let bench = Bench::new();
    let db = bench.path("old.sqlite");
    std::fs::copy(database(), &db).unwrap();
    let plan = plan();
    let mut store = Store::open(&db).await.unwrap();
    store.begin_sweep(&plan.spec, &plan.source.text, &plan.trials).await.unwrap();
    // Equal hashes: finished trials count as done.
    let open = &plan.trials[1].hash;
    assert_eq!(store.settled().await.unwrap(), std::slice::from_ref(&plan.trials[0].hash));
    assert_eq!(store.checkpoint(open).await.unwrap(), Some(checkpoint()));
    assert_eq!(store.begin_attempt(open).await.unwrap(), 2);
    store.finish(open, 2, &result(), &[]).await.unwrap();
    store.close().await.unwrap();
    let mut reader = Reader::open(&db).await.unwrap();
    let sql = "SELECT group_concat(state), sum(error_optimised), sum(steps) FROM v_trial";
    let rows = reader.query::<metasense::look::Table>(sql).await.unwrap().rows;
    assert_eq!(rows, [[serde_json::json!("done,done"), 20.0.into(), 2.into()]]);
}

/// Reading, writing or merging an older database gives an error and leaves the file unchanged.
#[test]
fn older_databases_are_refused() {
    let bench = Bench::new();
    let mut bytes = std::fs::read(database()).unwrap();
    bytes[60..64].copy_from_slice(&13u32.to_be_bytes()); // user_version in the header
    std::fs::write(bench.path("old.sqlite"), &bytes).unwrap();
    bench.file("tiny.toml", crate::common::TINY);
    for words in [
        &["query", "old.sqlite", "SELECT 1"][..],
        &["run", "tiny.toml", "--db", "old.sqlite"],
        &["cluster", "merge", "old.sqlite", "--out", "new.sqlite"],
    ] {
        let ended = bench.metasense(words);
        let said = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert!(said.contains("has version 13") && said.contains("older version"), "{words:?}: {said}");
        assert_eq!(ended.status.code(), Some(2), "{words:?}: {said}");
    }
    assert_eq!(std::fs::read(bench.path("old.sqlite")).unwrap(), bytes);
}
