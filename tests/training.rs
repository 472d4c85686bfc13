//! A body is trained once for all decoders: trials that train the same body resume from the most advanced of them.

use metasense::store::Store;
use metasense_schemas::record::{Checkpoint, Moments, Provenance, StepRecord};

use crate::common::{Bench, TINY, results};

/// A body trained with a linear decoder and evaluated with these decoders.
fn read_by(brains: &str) -> String {
    let spec = TINY
        .replace("sensors = [1, 2]", &format!("sensors = [1]\n\"brain.kind\" = [{brains}]"))
        .replace("[optimise]", "[optimise]\nbrain = \"linear\"");
    let networks = brains.contains("cnn") || brains.contains("stacked");
    if networks { spec } else { spec.replace("[brain]\niterations = 10\nwidth = 16\n", "") }
}

const READERS: [&str; 3] = ["cnn", "linear", "stacked"];

fn rows(bench: &Bench, sql: &str) -> Vec<Vec<String>> {
    let csv = bench.output(&["query", "results/tiny.sqlite", sql, "--format", "csv"]);
    csv.lines().skip(1).map(|line| line.split(',').map(str::to_owned).collect()).collect()
}

/// Steps that each attempt computed itself, and steps of each trial, by decoder.
const STEPS: &str =
    "SELECT t.brain, max(a.steps), t.steps, t.state FROM v_trial t JOIN v_attempt a ON a.hash = t.hash
    GROUP BY t.hash ORDER BY t.brain";

/// All rows of the results, sorted.
fn sorted(results: &[String]) -> Vec<Vec<String>> {
    let lines = |csv: &String| {
        let mut lines: Vec<String> = csv.lines().map(str::to_owned).collect();
        lines.sort();
        lines.dedup();
        lines
    };
    results.iter().map(lines).collect()
}

/// On one and two workers, one trial computes the steps; all trials have the same bits as alone.
#[test]
fn one_trial_trains_for_all() {
    let alone: Vec<Vec<String>> = READERS
        .iter()
        .map(|kind| {
            let bench = Bench::new();
            bench.file("s.toml", &read_by(&format!("{kind:?}")));
            bench.output(&["run", "s.toml", "--workers", "1"]);
            results(&bench, "results/tiny.sqlite")
        })
        .collect();
    let mut together = vec![String::new(); alone[0].len()];
    alone.iter().for_each(|of| together.iter_mut().zip(of).for_each(|(all, of)| *all += of));
    for workers in ["1", "2"] {
        let bench = Bench::new();
        bench.file("s.toml", &read_by("\"cnn\", \"linear\", \"stacked\""));
        bench.output(&["run", "s.toml", "--workers", workers]);
        let steps = rows(&bench, STEPS);
        let made: Vec<&str> = steps.iter().map(|row| row[1].as_str()).collect();
        assert_eq!(made, ["4", "0", "0"], "{steps:?}");
        assert!(steps.iter().all(|row| row[2..] == ["4", "done"]), "{steps:?}");
        assert_eq!(sorted(&results(&bench, "results/tiny.sqlite")), sorted(&together), "{workers} workers");
        let said = "SELECT count(*), count(DISTINCT l.text) FROM v_log l WHERE l.text LIKE 'resumes after step 4 of trial %'";
        assert_eq!(rows(&bench, said), [["2", "1"]]);
        let spent =
            "SELECT count(*) FROM v_step s JOIN v_attempt a ON a.hash = s.hash AND a.attempt = s.attempt";
        assert_eq!(rows(&bench, spent), [["4"]], "others' steps are no attempt's");
    }
}

/// A decoder added later trains no body, and neither do casts. An inverse decoder, whose body is simulated in double precision,
/// trains its own.
#[test]
fn what_comes_later_finds_the_body() {
    let (bench, alone) = (Bench::new(), Bench::new());
    bench.file("s.toml", &read_by("\"linear\""));
    bench.output(&["run", "s.toml"]);
    let stacked = read_by("\"stacked\"");
    for bench in [&bench, &alone] {
        bench.file("s.toml", &stacked);
        bench.output(&["run", "s.toml"]);
    }
    let own = "SELECT hash, error_initial, error_optimised, holdout_error_optimised, best_step FROM v_trial WHERE brain = 'stacked'";
    assert_eq!(rows(&bench, own), rows(&alone, own));
    bench.file("s.toml", &read_by("\"inverse\""));
    bench.output(&["run", "s.toml"]);
    let made: Vec<_> = rows(&bench, STEPS).into_iter().map(|row| row[..3].join(" ")).collect();
    assert_eq!(made, ["inverse 4 4", "linear 4 4", "stacked 0 4"]);

    // casts are added later: the bodies exist
    let casts = "[variation]\nstretch = 0.05\n[evaluation]\ncasts = 1\n[sweep]";
    bench.file("s.toml", &read_by("\"linear\"").replace("[sweep]", casts));
    bench.output(&["run", "s.toml"]);
    let later = "SELECT max(a.steps), t.steps FROM v_trial t JOIN v_attempt a ON a.hash = t.hash
        WHERE t.spec->>'$.evaluation.casts' = 1";
    assert_eq!(rows(&bench, later), [["0", "4"]]);
}

/// If a run is repeatedly killed while one trial trains for all, results are the same, and no step occurs twice.
#[test]
fn kills_leave_one_training() {
    let spec = read_by("\"cnn\", \"linear\", \"stacked\"").replace("iterations = 4", "iterations = 300");
    let (calm, killed) = (Bench::new(), Bench::new());
    for bench in [&calm, &killed] {
        bench.file("s.toml", &spec);
    }
    calm.output(&["run", "s.toml", "--workers", "2"]);
    let mut kills = 0;
    for wait in [150, 250, 350, 450, 600] {
        let mut run = killed.start(&["run", "s.toml", "--workers", "2"]);
        std::thread::sleep(std::time::Duration::from_millis(wait));
        kills += u32::from(run.try_wait().unwrap().is_none());
        run.kill().unwrap();
        run.wait().unwrap();
    }
    assert!(kills >= 2, "{kills} kills");
    killed.output(&["run", "s.toml", "--workers", "2"]);
    let [calm, killed] = [&calm, &killed].map(|bench| results(bench, "results/tiny.sqlite"));
    assert_eq!(calm, killed);
}

/// Training by other code is repeated. A paused trial takes over no steps beyond its limit. A finished trial, or one in its
/// comparison, passes on only the state after training.
#[tokio::test]
async fn a_body_is_handed_on() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = Store::open(folder.path().join("s.sqlite")).await.unwrap();
    let trials: Vec<_> = [0, 1].map(crate::store::trial).into();
    let trials: Vec<_> = trials
        .into_iter()
        .map(|mut trial| {
            trial.spec.optimise = trial.spec.optimise.resolved();
            metasense::plan::PlannedTrial { training: "body".into(), ..trial }
        })
        .collect();
    let [first, second] = [&trials[0].hash, &trials[1].hash];
    let made = |code: &str| Provenance {
        code: code.into(),
        revision: None,
        rustc: "rustc".into(),
        host: "here".into(),
        cpu: None,
        simd: "avx2".into(),
        threads: 1,
    };
    store.set_provenance(made("one"));
    store.begin_sweep(&crate::store::sweep(), "text", &trials).await.unwrap();
    store.begin_attempt(first).await.unwrap();
    store.begin_attempt(second).await.unwrap();
    let step = |step| StepRecord { step, outcome: "ok".into(), ..Default::default() };
    let checkpoint = Checkpoint {
        design: vec![0.25; 168],
        weights: vec![1.0; 3],
        weight_moments: Moments { first: vec![2.0; 3], second: vec![3.0; 3], steps: 9 },
        comparison: Some(Box::default()),
        caution: 1.0,
        ..Default::default()
    };
    for n in [0, 1] {
        let checkpoint = Checkpoint { step: n + 1, ..checkpoint.clone() };
        store.record_step(first, 1, &step(n), &checkpoint).await.unwrap();
    }
    assert_eq!(store.bodies().await.unwrap()["body"], 2);
    assert_eq!(store.resume_checkpoint(second, 1, Some(1)).await.unwrap(), None, "it is to pause before");
    store.set_provenance(made("two"));
    assert_eq!(store.resume_checkpoint(second, 1, None).await.unwrap(), None, "other code");
    assert!(store.bodies().await.unwrap().is_empty());
    store.set_provenance(made("one"));
    let found = store.resume_checkpoint(second, 1, None).await.unwrap().expect("a body");
    let same_network = Checkpoint { step: 2, comparison: None, ..checkpoint.clone() };
    assert_eq!(found, same_network, "the network trains the body");
    assert_eq!(
        store.resume_checkpoint(second, 1, None).await.unwrap(),
        Some(found.clone()),
        "it is its own by now"
    );
    // an attempt by other code that was killed before its own first step still has the body
    store.set_provenance(made("two"));
    store.begin_attempt(second).await.unwrap();
    assert_eq!(store.resume_checkpoint(second, 2, None).await.unwrap(), Some(found), "by both codes");
    assert!(store.bodies().await.unwrap().is_empty(), "nothing is by the second code alone");
    store.set_provenance(made("one"));

    store.finish(first, 1, &crate::store::result(), &[]).await.unwrap();
    let found = store.resume_checkpoint(second, 2, None).await.unwrap().expect("a body");
    let steps = trials[0].spec.optimise.steps() as u32;
    assert_eq!(found, Checkpoint::after_training(steps, vec![0.5; 168], 3));
    store.close().await.unwrap();
}
