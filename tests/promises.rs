//! Messages about the end of a run are true: steps in progress, time, and effect of the same command. Tests of other messages:
//! shards in `shards.rs` and `queues.rs`, shortages in `shortages.rs`, bad input in `bad_input.rs`, progress of commands in
//! `evaluate.rs`, `identify.rs` and `comparison.rs`.

use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::common::processes::{children, eventually, kill};
use crate::common::{Bench, TINY, results};

fn start(bench: &Bench, arguments: &str) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
    command.args(arguments.split_whitespace()).current_dir(bench.path(""));
    command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Waits until the database has more steps than before.
fn comes_further(bench: &Bench, before: u64) {
    let steps = || (bench.number("s.sqlite", "SELECT count(*) FROM v_step") > before).then_some(());
    eventually(Duration::from_secs(60), steps).expect("the run comes further");
}

/// One sweep, ended in every possible way: the exit code is the documented one, only the step in progress is repeated, no trial
/// fails, and the same command gives the results of an undisturbed run.
#[test]
fn whatever_ends_a_run_the_same_command_goes_on() {
    let bench = Bench::new();
    bench.file("s.toml", &TINY.replace("iterations = 4\n", "iterations = 450\n"));
    bench.output(&["run", "s.toml", "--db", "whole.sqlite"]);
    let ways = ["int", "term", "hup", "stop", "kill", "short"];
    for way in ways {
        let before = bench.number("s.sqlite", "SELECT count(*) FROM v_step");
        if way == "short" {
            let script =
                format!("ulimit -n 60; exec {} run s.toml --db s.sqlite", env!("CARGO_BIN_EXE_metasense"));
            let output =
                Command::new("bash").args(["-c", &script]).current_dir(bench.path("")).output().unwrap();
            assert_eq!(output.status.code(), Some(5), "{}", said(&output));
            continue;
        }
        let run = start(&bench, "run s.toml --db s.sqlite --workers 1");
        comes_further(&bench, before);
        let asked = Instant::now();
        match way {
            "int" => kill(run.id(), libc::SIGINT),
            "term" => kill(run.id(), libc::SIGTERM),
            "hup" => kill(run.id(), libc::SIGHUP),
            "kill" => kill(run.id(), libc::SIGKILL),
            _ => assert!(bench.output(&["control", "s.sqlite", "stop"]).contains("10 s")),
        }
        let output = run.wait_with_output().unwrap();
        let code = if way == "kill" { None } else { Some(4) };
        assert_eq!(output.status.code(), code, "{way}: {}", said(&output));
        assert!(way == "kill" || said(&output).contains("10 s"), "{way}: {}", said(&output));
        assert!(asked.elapsed() < Duration::from_secs(10), "{way}: steps are short: {:?}", asked.elapsed());
    }
    let output = bench.metasense(&["run", "s.toml", "--db", "s.sqlite"]);
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    assert_eq!(results(&bench, "s.sqlite"), results(&bench, "whole.sqlite"));
    let charged = "SELECT count(*) FROM v_attempt WHERE state = 'failed' AND reason NOT IN ('stopped', 'orchestrator_lost')";
    assert_eq!(bench.number("s.sqlite", charged), 0, "a trial is charged");
    let again = "SELECT sum(a.steps) - (SELECT count(*) FROM step) FROM attempt a";
    assert!(bench.number("s.sqlite", again) <= 1, "steps that were recorded are done again");
}

/// Steps longer than the grace time, which is the spec's or the command line's, are not waited for.
#[test]
fn a_step_that_takes_too_long_is_not_waited_for() {
    let bench = Bench::new();
    let slow = TINY.replace("samples = 8\n", "samples = 24000\n").replace("batch = 4", "batch = 23990");
    let slow = slow.replace("[1, 2]", "[1]").replace("test = 2", "test = 8");
    bench.file("s.toml", &slow.replace("[sweep]", "[run]\ngrace = 0.5\n[sweep]"));
    for arguments in ["", "--grace 0.3", "run.grace=0.3"] {
        let run = start(&bench, &format!("run s.toml {arguments} --db s.sqlite"));
        let worker =
            || children(run.id()).into_iter().find(|pid| metasense::processes::cpu_seconds(*pid) > Some(0.5));
        eventually(Duration::from_secs(60), worker).expect("a worker works");
        let asked = Instant::now();
        kill(run.id(), libc::SIGINT);
        let output = run.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(4), "{}", said(&output));
        let promised = if arguments.is_empty() { "0.5 s" } else { "0.3 s" };
        assert!(said(&output).contains(promised), "{}", said(&output));
        assert!(asked.elapsed() < Duration::from_secs(5), "{:?}", asked.elapsed());
        assert_eq!(bench.number("s.sqlite", "SELECT count(*) FROM v_step"), 0, "{}", said(&output));
    }
    let hashes = "SELECT count(DISTINCT hash) FROM v_trial";
    assert_eq!(bench.number("s.sqlite", hashes), 1, "the grace is no part of a trial");
}
