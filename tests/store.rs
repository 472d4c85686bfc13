//! The store keeps all records exactly once, and none of a stale attempt.

use metasense::cluster::merge::{Extent, merge};
use metasense::plan::PlannedTrial;
use metasense::reader::Reader;
use metasense::store::{RunPlan, Store, StoreError, StoredArray, npy_bytes};
use metasense_schemas::record::{
    BodyRecord, CastRecord, Checkpoint, NetworkRecord, Parts, Provenance, ReadingRecord, SpreadRecord,
    StepRecord, TrialResult, UnderRecord,
};
use metasense_schemas::spec::{SweepSpec, TrialSpec};
use serde_json::json;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};

const BODY: &str = r#"{"columns": 6, "rows": 6, "spacing": 15.0, "ligament_length": 2.25, "density": 1e-8,
    "stiffness": {"stretch": 3.0, "shear": 0.5, "bend": 1.0}}"#;

pub fn sweep() -> SweepSpec {
    let body: serde_json::Value = serde_json::from_str(BODY).unwrap();
    serde_json::from_value(json!({"name": "s", "body": body, "stimuli": {"kind": "bell"},
        "sweep": {"panels": [2], "sensors": [1]}}))
    .unwrap()
}

pub fn trial(order: usize) -> PlannedTrial {
    let sweep = serde_json::to_value(sweep()).unwrap();
    let mut spec = json!({"point": {"panels": 2, "sensors": 1, "placement": order, "seed": 1},
        "panel_units": [31, 34], "sensor_units": [21]});
    for key in ["body", "time", "solver", "sensors", "stimuli", "brain", "optimise", "evaluation", "feasible"]
    {
        spec[key] = sweep[key].clone();
    }
    let spec: TrialSpec = serde_json::from_value(spec).unwrap();
    let hash = format!("{order:032x}");
    PlannedTrial {
        hash,
        training: spec.training(),
        spec,
        order,
        units: 36,
        design_parameters: 168,
        brain_parameters: 13_122,
        trains: true,
        cost: Parts { steps: 0.0, comparison: 1.0 },
        weight: Parts { steps: 0, comparison: 1 },
        pause: None,
    }
}

fn spread(error: f64) -> SpreadRecord {
    SpreadRecord { median: Some(0.5 * error), p90: Some(2.0 * error), above: error as u32 }
}

pub fn result() -> TrialResult {
    let network = |error: f64| NetworkRecord {
        error_test: Some(error),
        error_holdout: Some(error + 1.0),
        losses: (1..=1000).map(|i| 1.0 / i as f32).collect(),
        outcome: "ok".into(),
        spread: Some(spread(error)),
        ..Default::default()
    };
    let body = |error| BodyRecord {
        design: vec![0.5; 168],
        networks: vec![network(error), network(error + 2.0)],
        readings: vec![ReadingRecord { spread: Some(spread(error)), ..Default::default() }],
        ..Default::default()
    };
    let cast = CastRecord {
        reader: "records".into(),
        error: Some(4.0),
        spread: Some(spread(4.0)),
        ridge: Some(1e-4),
        share: Some(1e-2),
        ..Default::default()
    };
    let under = UnderRecord { error: Some(9.0), spread: Some(spread(9.0)), ..Default::default() };
    TrialResult {
        initial: body(20.0),
        optimised: body(10.0),
        best_step: 3,
        casts: [vec![], vec![cast]],
        under: vec![under],
        ..Default::default()
    }
}

async fn value(db: &std::path::Path, sql: &str) -> serde_json::Value {
    let mut reader = Reader::open(db).await.unwrap();
    reader.query::<metasense::look::Table>(sql).await.unwrap().rows[0][0].clone()
}

/// All stages of a trial, read through the views and after reopening.
#[tokio::test]
async fn what_is_recorded_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("new/s.sqlite");
    let trials = [trial(0), trial(1)];
    let mut store = Store::open(&db).await.unwrap();
    store.begin_sweep(&sweep(), "text", &trials).await.unwrap();
    store.begin_sweep(&sweep(), "text", &trials).await.unwrap();
    let hash = &trials[0].hash;
    assert_eq!(store.checkpoint(hash).await.unwrap(), None);
    assert_eq!(store.begin_attempt(hash).await.unwrap(), 1);
    let step = StepRecord {
        error_test: Some(f64::NAN),
        ridge: Some(0.25),
        outcome: "ok".into(),
        ..Default::default()
    };
    let checkpoint = Checkpoint { step: 1, design: vec![0.25; 168], ..Default::default() };
    store.record_step(hash, 1, &step, &checkpoint).await.unwrap();
    assert_eq!(store.checkpoint(hash).await.unwrap().as_ref(), Some(&checkpoint));

    // A dead run: its attempt is closed, and its trial resumes.
    drop(store);
    let mut store = Store::open(&db).await.unwrap();
    store.begin_sweep(&sweep(), "text", &trials).await.unwrap();
    assert_eq!(value(&db, "SELECT reason FROM v_attempt").await, "orchestrator_lost");
    // The attempt ended with its last step, however late this is found.
    let ended = "SELECT a.ended_at = p.recorded_at FROM attempt a JOIN step p ON p.trial_id = a.trial_id";
    assert_eq!(value(&db, ended).await, json!(1));
    assert_eq!(store.begin_attempt(hash).await.unwrap(), 2);
    let stale = store.record_step(hash, 1, &step, &checkpoint).await;
    assert!(matches!(stale, Err(StoreError::Stale(_, 1))), "{stale:?}");
    let npy = npy_bytes(&[1, 2, 3], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    let forces = StoredArray { name: "forces", shape: &[1, 2, 3], npy: &npy };
    store.finish(hash, 2, &result(), &[forces]).await.unwrap();
    assert_eq!(store.settled().await.unwrap(), std::slice::from_ref(hash));
    assert_eq!(store.checkpoint(hash).await.unwrap(), None);

    let other = &trials[1].hash;
    store.begin_batch().await.unwrap();
    let attempt = store.begin_attempt(other).await.unwrap();
    store.fail(other, attempt, "worker_killed(9)", false).await.unwrap();
    let attempt = store.begin_attempt(other).await.unwrap();
    store.fail(other, attempt, "non_finite", true).await.unwrap();
    store.commit_batch().await.unwrap();
    store.close().await.unwrap();

    assert_eq!(std::fs::read_dir(db.parent().unwrap()).unwrap().count(), 1, "one file alone is left");
    for (sql, expected) in [
        ("SELECT count(*) FROM v_trial", json!(2)),
        ("SELECT error_initial FROM v_trial WHERE state = 'done'", json!(21.0)),
        ("SELECT holdout_error_optimised FROM v_trial WHERE state = 'done'", json!(12.0)),
        (
            "SELECT concat_ws(' ', holdout_median_initial, holdout_p90_optimised, holdout_above_initial, holdout_above_optimised,
               holdout_rms_optimised = 10 * sqrt(12.0)) FROM v_trial WHERE state = 'done'",
            json!("10.5 22.0 22 12 1"),
        ),
        ("SELECT group_concat(median_holdout || ' ' || p90_holdout || ' ' || above_holdout) FROM v_network WHERE body = 'initial'",
         json!("10.0 40.0 20,11.0 44.0 22")),
        ("SELECT concat_ws(' ', median_holdout, p90_holdout, above_holdout) FROM v_reading WHERE body = 'initial'", json!("10.0 40.0 20")),
        ("SELECT concat_ws(' ', median, p90, above, rms, ridge, kappa) FROM v_cast", json!("2.0 8.0 4 20.0 0.0001 0.01")),
        ("SELECT concat_ws(' ', median, p90, above, rms) FROM v_under", json!("4.5 18.0 9 30.0")),
        ("SELECT ridge FROM v_step", json!(0.25)),
        ("SELECT sweep FROM v_trial LIMIT 1", json!("s")),
        ("SELECT reason FROM v_trial WHERE state = 'failed'", json!("non_finite")),
        ("SELECT count(*) FROM v_step", json!(1)),
        ("SELECT error_test IS NULL FROM v_step", json!(1)),
        (
            "SELECT group_concat(state || coalesce(reason, '')) FROM v_attempt",
            json!("failedorchestrator_lost,done,failedworker_killed(9),failednon_finite"),
        ),
        ("SELECT count(*) FROM v_network", json!(4)),
        ("SELECT min(loss) FROM v_curve", json!(f64::from(1.0f32 / 1000.0))),
        ("SELECT count(*) FROM v_error_time", json!(1)),
        ("SELECT group_concat(name) FROM artifact WHERE shape = '[1,2,3]'", json!("forces")),
        ("SELECT spec->>'$.body.columns' FROM v_trial LIMIT 1", json!(6)),
    ] {
        assert_eq!(value(&db, sql).await, expected, "{sql}");
    }
}

/// Two specs with a common trial in one database: the trial keeps the name of the first, and `status` lists both; likewise after a
/// merge.
#[tokio::test]
async fn a_trial_keeps_the_name_of_the_sweep_that_brought_it() {
    let folder = tempfile::tempdir().unwrap();
    let (db, merged) = (folder.path().join("s.sqlite"), folder.path().join("merged.sqlite"));
    let mut store = Store::open(&db).await.unwrap();
    let other = SweepSpec { name: "other".into(), ..sweep() };
    for _ in 0..2 {
        // a run, a longer version, another spec with a common and an own trial, the first again
        store.begin_sweep(&sweep(), "text", &[trial(0)]).await.unwrap();
        store.begin_sweep(&sweep(), "longer text", &[trial(0), trial(1)]).await.unwrap();
        tokio::time::sleep(std::time::Duration::from_millis(3)).await; // time distinguishes them
        store.begin_sweep(&other, "text", &[trial(1), trial(2)]).await.unwrap();
    }
    store.close().await.unwrap();
    merge(Extent::Whole, std::slice::from_ref(&db), &merged).await.unwrap();
    // a third sweep in the merged database
    let mut store = Store::open(&merged).await.unwrap();
    let third = SweepSpec { name: "third".into(), ..sweep() };
    store.begin_sweep(&third, "text", &[trial(2), trial(3)]).await.unwrap();
    store.close().await.unwrap();
    let names = "SELECT group_concat(sweep) FROM (SELECT sweep FROM v_trial ORDER BY hash)";
    assert_eq!(value(&db, names).await, "s,s,other");
    assert_eq!(value(&merged, names).await, "s,s,other,third");
    let status = std::process::Command::new(env!("CARGO_BIN_EXE_metasense"))
        .args(["status", merged.to_str().unwrap(), "--format", "csv"])
        .output()
        .unwrap();
    assert!(status.status.success(), "{}", String::from_utf8_lossy(&status.stderr));
    let rows = String::from_utf8(status.stdout).unwrap();
    let shown: Vec<&str> = rows.lines().skip(1).map(|row| row.split(",pending").next().unwrap()).collect();
    assert_eq!(shown, ["\"other, third\"", "s", "\"s, other\"", "third"], "{rows}");
}

/// At most twenty designs of a trial are kept, including the last. They are the same bytes after any stops and repeated steps.
#[tokio::test]
async fn the_designs_that_stay_depend_on_the_number_of_steps_alone() {
    let folder = tempfile::tempdir().unwrap();
    let design = |step: u32| -> Vec<f64> { (0..168).map(|i| f64::from(step) + f64::from(i) / 3.0).collect() };
    for (steps, expected) in
        [(3, vec![1, 2, 3]), (20, (1..=20).collect()), (50, (2..=50).step_by(3).collect())]
    {
        let mut trial = trial(0);
        trial.spec.optimise.iterations = Some(steps as usize);
        let mut kept = Vec::new();
        // in one run; and killed in the middle, with two repeated steps
        for (name, ways) in [("once", [0..0, 0..steps]), ("twice", [0..steps / 2 + 1, steps / 2 - 1..steps])]
        {
            let db = folder.path().join(format!("{name}{steps}.sqlite"));
            for way in ways {
                let mut store = Store::open(&db).await.unwrap();
                store.begin_sweep(&sweep(), "text", std::slice::from_ref(&trial)).await.unwrap();
                let attempt = store.begin_attempt(&trial.hash).await.unwrap();
                store.begin_batch().await.unwrap();
                for step in way {
                    let record = StepRecord { step, ..Default::default() };
                    let checkpoint =
                        Checkpoint { step: step + 1, design: design(step + 1), ..Default::default() };
                    store.record_step(&trial.hash, attempt, &record, &checkpoint).await.unwrap();
                }
                store.commit_batch().await.unwrap();
            }
            let mut reader = Reader::open(&db).await.unwrap();
            let arrays = reader.arrays_of(&trial.hash).await.unwrap();
            let bytes: usize = arrays.iter().map(|array| array.npy().unwrap().len()).sum();
            assert_eq!(bytes, arrays.len() * (128 + 4 * 168));
            kept.push(
                arrays
                    .into_iter()
                    .map(|array| (array.name.clone(), array.npy().unwrap().to_vec()))
                    .collect::<Vec<_>>(),
            );
            let found = reader.designs_of(&trial.hash).await.unwrap();
            assert_eq!(found.iter().map(|f| f.0).collect::<Vec<_>>(), expected);
            for (step, found) in found {
                let off = found.iter().zip(design(step)).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max);
                assert!(off < 1e-5, "step {step}: {off} mm");
            }
        }
        assert_eq!(kept[0], kept[1], "{steps} steps");
    }
}

#[tokio::test]
async fn only_one_writer_at_a_time() {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("s.sqlite");
    let store = Store::open(&db).await.unwrap();
    let second = Store::open(&db).await;
    assert!(matches!(second, Err(StoreError::InUse(..))), "{second:?}");
    drop(store);
    Store::open(&db).await.unwrap();
}

#[tokio::test]
async fn foreign_and_newer_databases_are_refused_untouched() {
    let folder = tempfile::tempdir().unwrap();
    let foreign = folder.path().join("notes.txt");
    std::fs::write(
        &foreign,
        "no database at all, but long enough to be taken for one at first sight".repeat(20),
    )
    .unwrap();
    let before = std::fs::read(&foreign).unwrap();
    assert!(matches!(Store::open(&foreign).await, Err(StoreError::NotOurs(..))));
    assert_eq!(std::fs::read(&foreign).unwrap(), before);

    let newer = folder.path().join("newer.sqlite");
    Store::open(&newer).await.unwrap().close().await.unwrap();
    let mut bytes = std::fs::read(&newer).unwrap();
    bytes[60..64].copy_from_slice(&99u32.to_be_bytes()); // user_version in the header
    std::fs::write(&newer, &bytes).unwrap();
    let refused = Store::open(&newer).await;
    assert!(matches!(refused, Err(StoreError::Newer(_, 99))), "{refused:?}");
    assert_eq!(std::fs::read(&newer).unwrap(), bytes);
}

/// 16 trials per batch, each with attempt, step and result, beside a reader that queries continuously.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_reader_that_queries_all_the_time_causes_no_lock_error() {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("s.sqlite");
    let trials: Vec<PlannedTrial> = (0..400).map(trial).collect();
    let mut store = Store::open(&db).await.unwrap();
    store.begin_sweep(&sweep(), "text", &trials).await.unwrap();
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    let (first, read_once) = tokio::sync::oneshot::channel::<()>();
    let path = db.clone();
    let reading = tokio::spawn(async move {
        let (mut stopped, mut first) = (stopped, Some(first));
        let mut reader = Reader::open(&path).await.unwrap();
        while stopped.try_recv().is_err() {
            reader
                .query::<metasense::look::Table>(
                    "SELECT count(*), sum(seconds), max(error_initial) FROM v_trial",
                )
                .await
                .unwrap();
            if let Some(first) = first.take() {
                first.send(()).unwrap();
            }
        }
    });
    read_once.await.unwrap();
    let small = TrialResult::default();
    let start = std::time::Instant::now();
    for batch in trials.chunks(16) {
        store.begin_batch().await.unwrap();
        for trial in batch {
            let attempt = store.begin_attempt(&trial.hash).await.unwrap();
            store
                .record_step(&trial.hash, attempt, &StepRecord::default(), &Checkpoint::default())
                .await
                .unwrap();
            store.finish(&trial.hash, attempt, &small, &[]).await.unwrap();
        }
        store.commit_batch().await.unwrap();
    }
    println!("{:.0} trials/s", 400.0 / start.elapsed().as_secs_f64());
    stop.send(()).unwrap();
    reading.await.unwrap();
    assert_eq!(store.settled().await.unwrap().len(), 400);
}

/// If the clock is set back during an attempt, no time is negative.
#[tokio::test]
async fn no_time_is_negative() {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("s.sqlite");
    let mut store = Store::open(&db).await.unwrap();
    store.begin_sweep(&sweep(), "text", &[trial(0)]).await.unwrap();
    let later = async || {
        use sqlx::{ConnectOptions, Connection};
        let mut other = sqlx::sqlite::SqliteConnectOptions::new().filename(&db).connect().await.unwrap();
        let sql = "UPDATE attempt SET started_at = '2999-01-01T00:00:00.000Z' WHERE ended_at IS NULL";
        assert_eq!(sqlx::query(sql).execute(&mut other).await.unwrap().rows_affected(), 1);
        other.close().await.unwrap();
    };
    for end in 0..3 {
        let attempt = store.begin_attempt(&trial(0).hash).await.unwrap();
        later().await;
        match end {
            0 => store.fail(&trial(0).hash, attempt, "stopped", false).await.unwrap(),
            1 => drop(store.begin_attempt(&trial(0).hash).await.unwrap()),
            _ => {
                drop(store);
                store = Store::open(&db).await.unwrap();
            }
        }
    }
    store.begin_sweep(&sweep(), "text", &[trial(0)]).await.unwrap();
    assert_eq!(value(&db, "SELECT sum(seconds >= 0) FROM v_attempt").await, 4);
}

/// Elapsed times are measured by a monotonic clock.
#[tokio::test]
async fn elapsed_times_do_not_follow_the_clock() {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("s.sqlite");
    let mut store = Store::open(&db).await.unwrap();
    store.begin_sweep(&sweep(), "text", &[trial(0)]).await.unwrap();
    let plan = RunPlan { shard: (1, 1), workers: (1, 1), trials: 1, estimated_seconds: 1.0 };
    let run = store.begin_run(&plan).await.unwrap();
    let attempt = store.begin_attempt(&trial(0).hash).await.unwrap();
    store.fail(&trial(0).hash, attempt, "stopped", false).await.unwrap();
    store.end_run(&run, "interrupted", 0, 0).await.unwrap();
    store.close().await.unwrap();
    let mut other = SqliteConnectOptions::new().filename(&db).connect().await.unwrap();
    let set = "UPDATE run SET ended_at = '2050-01-01T00:00:00.000Z'; UPDATE attempt SET ended_at = '2000-01-01T00:00:00.000Z'";
    sqlx::raw_sql(set).execute(&mut other).await.unwrap();
    other.close().await.unwrap();
    for view in ["v_run", "v_attempt"] {
        let sql = format!("SELECT seconds >= 0 AND seconds < 60 FROM {view}");
        assert_eq!(value(&db, &sql).await, 1, "{view}");
    }
}

/// A trial whose checkpoint is damaged resumes from the checkpoint of another trial with the same body, unless that is damaged too.
#[tokio::test]
async fn a_damaged_checkpoint_gives_way_to_another_trials() {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("s.sqlite");
    let trials = [0, 1].map(|order| PlannedTrial { training: "same".into(), ..trial(order) });
    let [own, other] = [0, 1].map(|i: usize| trials[i].hash.as_str());
    let mut store = Store::open(&db).await.unwrap();
    let text = |text: &str| text.to_owned();
    let (code, rustc, host, simd) = (text("c"), text("r"), text("h"), text("avx2"));
    store.set_provenance(Provenance { code, revision: None, rustc, host, cpu: None, simd, threads: 1 });
    store.begin_sweep(&sweep(), "text", &trials).await.unwrap();
    for (hash, steps) in [(own, 1), (other, 2)] {
        let attempt = store.begin_attempt(hash).await.unwrap();
        for step in 0..steps {
            let record = StepRecord { step, outcome: "ok".into(), ..Default::default() };
            let checkpoint = Checkpoint { step: step + 1, design: vec![0.5; 168], ..Default::default() };
            store.record_step(hash, attempt, &record, &checkpoint).await.unwrap();
        }
        store.fail(hash, attempt, "stopped", false).await.unwrap();
    }
    let mut disk = SqliteConnectOptions::new().filename(&db).connect().await.unwrap();
    let mut damage = async |hash: &str| {
        let sql = "UPDATE checkpoint SET bytes = zeroblob(length(bytes)) WHERE trial_id = (SELECT id FROM trial WHERE hash = ?)";
        sqlx::query(sql).bind(hash).execute(&mut disk).await.unwrap();
    };
    damage(own).await;
    let attempt = store.begin_attempt(own).await.unwrap();
    let found = store.resume_checkpoint(own, attempt, None).await.unwrap();
    assert_eq!(found.map(|found| found.step), Some(2));
    let said = "SELECT group_concat(text) FROM v_log";
    assert!(value(&db, said).await.as_str().unwrap().contains("checksum"), "{}", value(&db, said).await);
    damage(own).await;
    damage(other).await;
    let attempt = store.begin_attempt(own).await.unwrap();
    let found = store.resume_checkpoint(own, attempt, None).await;
    assert!(matches!(&found, Err(StoreError::Damaged(hash, _)) if hash == own), "{found:?}");
    disk.close().await.unwrap();
}
