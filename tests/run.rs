//! A sweep runs end to end in worker processes, resumes after `kill -9`, and repeats nothing.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::common::processes::{eventually, kill};
use crate::common::{Bench, SPEC, TINY, results};
use metasense::plan::Plan;
use metasense::processes::{WorkerProcess, workers_of};
use metasense::store::Store;
use metasense_schemas::record::{Checkpoint, StepRecord};
use metasense_worker::simd::NAMES;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};

#[test]
fn a_sweep_runs_once_and_only_what_is_new_is_added() {
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    let table = bench.output(&["run", "tiny.toml", "--format", "json"]);
    let rows: serde_json::Value = serde_json::from_str(&table).unwrap();
    assert_eq!(rows.as_array().map(Vec::len), Some(2), "{table}");
    for row in rows.as_array().unwrap() {
        assert_eq!(row["state"], "done", "{table}");
        let errors = [
            "test_error_initial",
            "test_error_optimised",
            "holdout_error_initial",
            "holdout_error_optimised",
        ];
        assert!(errors.iter().all(|name| row[name].as_f64().is_some_and(|e| e > 0.0)), "{table}");
    }
    let before = results(&bench, "results/tiny.sqlite");
    let names = "SELECT group_concat(DISTINCT name ORDER BY name), count(*), (SELECT count(*) FROM v_curve) FROM v_artifact";
    assert_eq!(
        bench.output(&["query", "results/tiny.sqlite", names, "--format", "csv"]).lines().nth(1),
        Some(
            "\"alpha_initial,alpha_optimised,band_instant_initial,band_instant_optimised,band_sample_initial,\
             band_sample_optimised,design_step_1,design_step_2,design_step_3,design_step_4,losses_initial_0,losses_initial_1,losses_initial_2,losses_optimised_0,\
             losses_optimised_1,losses_optimised_2,weights_initial_0,weights_optimised_0\",36,120"
        )
    );

    let recognised = || {
        let start = Instant::now();
        let again = bench.metasense(&["run", "tiny.toml"]);
        let said = String::from_utf8_lossy(&again.stderr).into_owned();
        assert!(said.contains("nothing left to do") && said.contains("results/tiny.sqlite"), "{said}");
        start.elapsed()
    };
    // The minimum of several runs, because the machine may be loaded.
    let took = (0..5).map(|_| recognised()).min().unwrap();
    assert!(took < Duration::from_millis(300), "recognised after {took:?}");
    assert_eq!(results(&bench, "results/tiny.sqlite"), before);

    bench.file("tiny.toml", &TINY.replace("[1, 2]", "[1, 2, 3]"));
    let more = bench.output(&["run", "tiny.toml", "--format", "csv"]);
    assert_eq!(more.lines().count(), 1 + 3, "{more}");
    let attempts = "SELECT sensors, attempt FROM v_attempt ORDER BY sensors";
    assert_eq!(
        bench.output(&["query", "results/tiny.sqlite", attempts, "--format", "csv"]),
        "sensors,attempt\n1,1\n2,1\n3,1\n"
    );
}

/// Every instruction set: workers and a foreground trial use and record it, with the same bits; if the machine lacks it, nothing
/// starts.
#[test]
fn the_instruction_set_asked_for_is_the_one_used() {
    let bench = Bench::new();
    bench.file("tiny.toml", &TINY.replace("[1, 2]", "[1]"));
    let row = |text: &str| -> serde_json::Value { serde_json::from_str::<Vec<_>>(text).unwrap().remove(0) };
    for simd in NAMES {
        let db = format!("{simd}.sqlite");
        let run = bench.metasense(&["run", "tiny.toml", "--simd", simd, "--db", &db]);
        let said = String::from_utf8_lossy(&run.stderr);
        if run.status.code() == Some(2) {
            assert!(
                said.contains(&format!("this machine does not support {simd}")) && simd != NAMES[0],
                "{said}"
            );
            assert!(!bench.path(&db).exists(), "{simd} was begun");
            continue;
        }
        assert!(run.status.success(), "{simd}: {said}");
        let sql = "SELECT simd, hash, holdout_error_optimised FROM v_trial";
        let ran = row(&bench.output(&["query", &db, sql, "--format", "json"]));
        let hash = ran["hash"].as_str().unwrap();
        let alone = row(&bench.output(&["trial", "tiny.toml", hash, "--simd", simd, "--format", "json"]));
        assert_eq!([&ran["simd"], &alone["simd"]], [simd, simd]);
        assert_eq!(ran["holdout_error_optimised"], alone["holdout_error_optimised"], "{simd}");
    }
    assert_eq!(bench.metasense(&["run", "tiny.toml", "--simd", "sse"]).status.code(), Some(2));
}

/// Repeatedly killed with its workers after each new step, then left alone.
#[test]
fn a_run_that_is_killed_goes_on_to_the_same_results() {
    let bench = Bench::new();
    bench.file("tiny.toml", &TINY.replace("iterations = 4", "iterations = 100"));
    bench.output(&["run", "tiny.toml", "--db", "whole.sqlite"]);
    let steps = || {
        let sql = "SELECT count(*) FROM v_step";
        let output = bench.metasense(&["query", "killed.sqlite", sql, "--format", "csv"]);
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        text.lines().nth(1).and_then(|n| n.parse::<u32>().ok()).unwrap_or(0)
    };
    for _ in 0..3 {
        let before = steps();
        let mut run = bench.start(&["run", "tiny.toml", "--db", "killed.sqlite"]);
        let deadline = Instant::now() + Duration::from_secs(60);
        while steps() == before && run.try_wait().unwrap().is_none() {
            assert!(Instant::now() < deadline, "no step within a minute");
        }
        run.kill().unwrap();
        run.wait().unwrap();
    }
    bench.output(&["run", "tiny.toml", "--db", "killed.sqlite"]);
    assert_eq!(results(&bench, "killed.sqlite"), results(&bench, "whole.sqlite"));
    let lost = "SELECT count(*) > 0 FROM v_attempt WHERE reason = 'orchestrator_lost'";
    assert!(
        bench.output(&["query", "killed.sqlite", lost, "--format", "csv"]).ends_with("1\n"),
        "nothing was killed"
    );
}

/// A trial with a damaged checkpoint, or one of another version, restarts with a message and gives the same results.
#[tokio::test]
async fn a_checkpoint_that_is_of_no_use_is_not_overlooked() {
    let bench = Bench::new();
    let text = TINY.replace("[1, 2]", "[1]");
    bench.file("tiny.toml", &text);
    bench.output(&["run", "tiny.toml", "--db", "whole.sqlite"]);
    let plan = Plan::new("tiny.toml", text).unwrap();
    let hash = &plan.trials[0].hash;
    let whole = Checkpoint { step: 2, ..Checkpoint::default() }.to_bytes();
    let newer = [&[99], &whole[1..]].concat();
    for (bytes, expected) in [(newer, "version 99"), (whole[..whole.len() - 1].to_vec(), "damaged")] {
        let db = bench.path("old.sqlite");
        let _ = std::fs::remove_file(&db);
        let mut store = Store::open(&db).await.unwrap();
        store.begin_sweep(&plan.spec, &plan.source.text, &plan.trials).await.unwrap();
        store.begin_attempt(hash).await.unwrap();
        let step = StepRecord { outcome: "ok".into(), ..StepRecord::default() };
        store.record_step(hash, 1, &step, &Checkpoint::default()).await.unwrap();
        store.close().await.unwrap();
        let mut db = SqliteConnectOptions::new().filename(db).connect().await.unwrap();
        sqlx::query("UPDATE checkpoint SET bytes = ?, digest = NULL")
            .bind(bytes)
            .execute(&mut db)
            .await
            .unwrap();
        db.close().await.unwrap();
        let run = bench.metasense(&["run", "tiny.toml", "--db", "old.sqlite"]);
        let said = String::from_utf8_lossy(&run.stderr).into_owned();
        assert!(
            run.status.success() && said.contains("restarting, because") && said.contains(expected),
            "{said}"
        );
        assert_eq!(results(&bench, "old.sqlite"), results(&bench, "whole.sqlite"));
    }
}

/// A failed trial stays failed until `--retry-failed`, which runs its next attempt.
#[tokio::test]
async fn a_failed_trial_is_run_again_on_request_alone() {
    let bench = Bench::new();
    bench.file("tiny.toml", &TINY.replace("[1, 2]", "[1]"));
    let plan = Plan::new("tiny.toml", TINY.replace("[1, 2]", "[1]")).unwrap();
    let hash = &plan.trials[0].hash;
    let mut store = Store::open(bench.path("results/tiny.sqlite")).await.unwrap();
    store.begin_sweep(&plan.spec, &plan.source.text, &plan.trials).await.unwrap();
    store.begin_attempt(hash).await.unwrap();
    store.fail(hash, 1, "time_limit", true).await.unwrap();
    store.close().await.unwrap();
    let settled = bench.metasense(&["run", "tiny.toml"]);
    let said = String::from_utf8_lossy(&settled.stderr).into_owned();
    assert_eq!(settled.status.code(), Some(1), "{said}");
    assert!(said.contains("(time_limit)") && said.contains("--retry-failed"), "{said}");
    for args in [&["run", "tiny.toml"][..], &["status", "results/tiny.sqlite"]] {
        assert_eq!(bench.closed(args), Some(1), "{args:?}");
    }
    let refused =
        bench.metasense(&["export", "results/tiny.sqlite", hash, "--format", "npy", "--out", "d.npy"]);
    let why = String::from_utf8_lossy(&refused.stderr);
    let expected = "failed: time_limit; `metasense run SPEC --retry-failed` resumes it";
    assert!(refused.status.code() == Some(2) && why.contains(expected), "{why}");
    bench.output(&["run", "tiny.toml", "--retry-failed"]);
    let attempts = "SELECT attempt, state, coalesce(reason, '') FROM v_attempt ORDER BY attempt";
    assert_eq!(
        bench
            .output(&["query", "results/tiny.sqlite", attempts, "--format", "csv"])
            .lines()
            .skip(1)
            .collect::<Vec<_>>(),
        ["1,failed,time_limit", "2,done,"]
    );
}

/// A linear decoder that needs more memory than its worker may use fails at the first attempt with that reason.
#[test]
fn memory_that_is_not_to_be_had_is_a_reason_of_its_own() {
    let bench = Bench::new();
    let text = TINY.replace("sensors = [1, 2]", "sensors = [4]").replace("samples = 20", "samples = 250");
    bench.file("tiny.toml", &text.replace("[sweep]", "[run]\nmemory = 120\n[sweep]"));
    let run = bench.metasense(&["run", "tiny.toml", "--db", "t.sqlite"]);
    let said = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(1), "{said}");
    assert!(said.contains("out_of_memory"), "{said}");
    let attempts = "SELECT attempt, reason FROM v_attempt";
    assert_eq!(
        bench.output(&["query", "t.sqlite", attempts, "--format", "csv"]),
        "attempt,reason\n1,out_of_memory\n"
    );
    let log = std::fs::read_to_string(bench.path("t.log")).unwrap();
    assert!(log.contains("raise `memory` in [run]"), "{log}");
}

/// A foreground trial has the errors of the same trial in a run.
#[test]
fn a_trial_in_the_foreground_is_the_trial_of_the_run() {
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    bench.output(&["run", "tiny.toml", "--workers", "1"]);
    let hash = bench.output(&[
        "query",
        "results/tiny.sqlite",
        "SELECT hash FROM v_trial LIMIT 1",
        "--format",
        "csv",
    ]);
    let hash = hash.lines().nth(1).unwrap();
    let alone = bench.output(&["trial", "tiny.toml", &hash[..8], "--threads", "2", "--format", "csv"]);
    let sql = format!(
        "SELECT error_initial, error_optimised, holdout_error_initial, holdout_error_optimised FROM v_trial \
         WHERE hash = '{hash}'"
    );
    let ran = bench.output(&["query", "results/tiny.sqlite", &sql, "--format", "csv"]);
    assert!(alone.contains(&format!("{hash},{},", ran.lines().nth(1).unwrap())), "{alone}\n{ran}");
    assert!(
        alone.starts_with("hash,test_error_initial,test_error_optimised,holdout_error_initial,"),
        "{alone}"
    );
}

/// The lock is free only after the run has written everything.
#[test]
fn a_run_holds_its_database_until_its_outcome_is_recorded() {
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    let mut run = Command::new(env!("CARGO_BIN_EXE_metasense"))
        .args(["run", "tiny.toml", "--db", "t.sqlite"])
        .current_dir(bench.path(""))
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let began = Instant::now();
    while !std::fs::read_to_string(bench.path("t.log")).unwrap_or_default().contains("worker started") {
        assert!(began.elapsed() < Duration::from_secs(60), "no worker is started within a minute");
        std::thread::sleep(Duration::from_millis(2));
    }
    let file = std::fs::File::open(bench.path("t.sqlite")).unwrap();
    assert!(file.try_lock().is_err(), "the run does not hold its database");
    // Without a pause, because closing and reopening would free the lock for some microseconds.
    while file.try_lock().is_err() {
        assert!(began.elapsed() < Duration::from_secs(60), "the run does not end within a minute");
    }
    let outcome = bench.output(&["query", "t.sqlite", "SELECT outcome FROM v_run", "--format", "csv"]);
    assert_eq!(outcome, "outcome\ncomplete\n");
    drop(file);
    let mut said = String::new();
    std::io::Read::read_to_string(&mut run.stderr.take().unwrap(), &mut said).unwrap();
    assert!(run.wait().unwrap().success(), "{said}");
}

/// If every trial dies on a machine, here because each worker is killed in its first step, the run ends before the trials' retries
/// are used up. It names the machine, and all trials resume elsewhere.
#[test]
fn a_machine_on_which_trials_die_one_after_the_other_fails_none_of_them() {
    let bench = Bench::new();
    bench.file("s.toml", &(SPEC.to_owned() + "seeds = [1, 2, 3, 4, 5, 6]\n[run]\nbackoff = 0.0\n"));
    let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
    command.args(["run", "s.toml", "--workers", "2"]).current_dir(bench.path("")).stdout(Stdio::null());
    let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
    let kill_workers = || {
        // A worker with a trial has the trial's hash as its name.
        let is_busy = |worker: &WorkerProcess| worker.name.bytes().all(|byte| byte.is_ascii_hexdigit());
        for worker in workers_of(child.id()).into_iter().filter(is_busy) {
            kill(worker.pid, libc::SIGKILL);
        }
        child.try_wait().unwrap()
    };
    let ended = eventually(Duration::from_secs(60), kill_workers).expect("the run ends within a minute");
    let said = std::io::read_to_string(child.stderr.unwrap()).unwrap();
    assert_eq!(ended.code(), Some(5), "{said}");
    let host = metasense::files::host();
    assert!(said.contains(&format!("{host} is unfit")) && said.contains("worker_killed(9)"), "{said}");
    let asked = |sql| bench.output(&["query", "results/s.sqlite", sql, "--format", "csv"]);
    let trials = asked("SELECT state, count(*), sum(attempts) FROM v_trial GROUP BY 1");
    assert!(["pending,12,10\n", "pending,12,11\n"].iter().any(|row| trials.ends_with(row)), "{trials}");
    assert_eq!(asked("SELECT outcome FROM v_run"), "outcome\nunfit\n");
}

/// A run that is stopped ends with its code, even if its final table cannot be printed.
#[test]
fn a_stopped_run_that_cannot_print_is_a_stopped_run() {
    let bench = Bench::new();
    bench.file("tiny.toml", &TINY.replace("iterations = 4\n", "iterations = 100000\n"));
    let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
    command.args(["run", "tiny.toml"]).current_dir(bench.path("")).stdout(full).stderr(Stdio::piped());
    let run = command.spawn().unwrap();
    let log = || std::fs::read_to_string(bench.path("results/tiny.log")).unwrap_or_default();
    let begun = || log().contains("worker started").then_some(());
    eventually(Duration::from_secs(20), begun).expect("a worker starts within 20 s");
    kill(run.id(), libc::SIGTERM);
    let output = run.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(4) && said.contains("error: writing the output"), "{said}");
}

/// Under nohup, closing the terminal does not end the run; without nohup it ends the run cleanly.
#[test]
fn an_ignored_hangup_stays_ignored() {
    // The second run has far to go when the terminal closes, on any machine.
    for (shell, iterations, code) in [("trap '' HUP; ", 100, 0), ("", 100_000, 4)] {
        let bench = Bench::new();
        bench.file("tiny.toml", &TINY.replace("iterations = 4\n", &format!("iterations = {iterations}\n")));
        let script = format!("{shell}exec {} run tiny.toml", env!("CARGO_BIN_EXE_metasense"));
        let mut command = Command::new("sh");
        command.args(["-c", &script]).current_dir(bench.path("")).stdout(Stdio::null()).stderr(Stdio::null());
        let mut child = command.spawn().unwrap();
        let log = || std::fs::read_to_string(bench.path("results/tiny.log")).unwrap_or_default();
        let begun = || log().contains("worker started").then_some(());
        eventually(Duration::from_secs(20), begun).expect("a worker starts within 20 s");
        kill(child.id(), libc::SIGHUP);
        let ended = eventually(Duration::from_secs(60), || child.try_wait().unwrap());
        assert_eq!(ended.expect("the run ends within a minute").code(), Some(code), "{shell}");
    }
}
