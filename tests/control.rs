//! A run is steered from another terminal, by real processes: what is asked happens, is told, and changes no result.

mod common;

use std::fs::File;
use std::process::{Child, Command, Output};
use std::time::{Duration, Instant};

use common::{Bench, TINY, results};
use metasense::plan::Plan;

/// Six trials, and eight.
fn specs() -> [String; 2] {
    let long = TINY.replace("iterations = 4\n", "iterations = 24\n");
    ["[1, 2, 3]", "[1, 2, 3, 4]"].map(|seeds| long.replace("[1, 2]", &format!("[1, 2]\nseeds = {seeds}")))
}

/// A run in a folder; dropped, it is killed.
struct Run<'a> {
    bench: &'a Bench,
    child: Child,
}

impl<'a> Run<'a> {
    fn start(bench: &'a Bench, arguments: &[&str]) -> Self {
        let file = |name| File::create(bench.path(name)).unwrap();
        let child = Command::new(env!("CARGO_BIN_EXE_metasense"))
            .args(["run", "s.toml", "--db", "s.sqlite"])
            .args(arguments)
            .current_dir(bench.path(""))
            .stdout(file("said.csv"))
            .stderr(file("told"))
            .spawn()
            .unwrap();
        Self { bench, child }
    }

    /// Waits until the run takes commands and its workers are busy.
    fn busy(&self, workers: &str) {
        self.until(|| self.asks(&["state"]).1.contains(workers));
    }

    fn until(&self, mut holds: impl FnMut() -> bool) {
        let began = Instant::now();
        while !holds() {
            assert!(began.elapsed() < Duration::from_secs(60), "{}", self.told());
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// What it said on standard error.
    fn told(&self) -> String {
        std::fs::read_to_string(self.bench.path("told")).unwrap()
    }

    fn control(&self, words: &[&str]) -> Output {
        self.bench.metasense(&[&["control", "s.sqlite"], words].concat())
    }

    /// Exit code and words.
    fn asks(&self, words: &[&str]) -> (Option<i32>, String) {
        let output = self.control(words);
        let said = [output.stdout, output.stderr].concat();
        (output.status.code(), String::from_utf8(said).unwrap())
    }

    fn asked(&self, words: &[&str], code: i32, expected: &str) {
        let (found, said) = self.asks(words);
        assert!(found == Some(code) && said.contains(expected), "{words:?}: {found:?}: {said}");
    }

    fn count(&self, sql: &str) -> String {
        let sql = format!("SELECT {sql}");
        self.bench.output(&["query", "s.sqlite", &sql, "--format", "csv"]).lines().nth(1).unwrap().to_owned()
    }

    /// To the end; the exit code.
    fn wait(&mut self) -> Option<i32> {
        let began = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.code();
            }
            assert!(began.elapsed() < Duration::from_secs(120), "{}", self.told());
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Run<'_> {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The folder with the first spec, and the database of the second, undisturbed.
fn bench() -> Bench {
    let bench = Bench::new();
    let [first, second] = specs();
    bench.file("s.toml", &second);
    bench.output(&["run", "s.toml", "--db", "whole.sqlite"]);
    bench.file("s.toml", &first);
    bench
}

/// Each command once, most of them in a pause; what is refused changes nothing. What comes of it all is what comes without.
#[test]
fn a_run_does_what_it_is_asked_and_comes_to_the_same_results() {
    let bench = bench();
    let hashes: Vec<String> =
        Plan::new("s.toml", specs()[0].clone()).unwrap().trials.into_iter().map(|trial| trial.hash).collect();
    let mut run = Run::start(&bench, &["--workers", "1", "--format", "csv"]);
    run.busy("running: 1 of 1 worker busy");
    run.until(|| run.count("count(*) FROM v_step") != "0");

    run.asked(&["pause"], 0, "paused: 1 running trial is taken back");
    run.until(|| run.asks(&["state"]).1.contains("paused: 0 of 1 worker busy"));
    run.until(|| run.count("count(*) FROM v_attempt WHERE state = 'running'") == "0");
    let steps = run.count("count(*) FROM v_step");
    run.asked(&["cancel", &hashes[0]], 0, "cancelled\n");
    run.asked(&["cancel", &hashes[1][..12]], 0, "cancelled\n");
    run.asked(&["next", &hashes[5]], 0, "goes to the next worker");
    run.asked(&["workers", "2"], 0, "workers: 1 before, 2 from now on");

    run.asked(&["cancel", &hashes[0]], 1, "refused: the trial is given up already (cancelled)");
    run.asked(&["next", "no-such"], 1, "refused: no-such: no trial");
    run.asked(&["workers", "0"], 2, "0 is not in");
    run.asked(&["cancel", "a b"], 2, "no command");
    run.asked(&["dance"], 2, "unrecognized subcommand");
    bench.file("s.toml", &specs()[0].replace("samples = 8", "samples = -8"));
    run.asked(&["reload"], 1, "refused: s.toml");
    bench.file("s.toml", &specs()[0].replace("\"tiny\"", "\"other\""));
    run.asked(&["reload"], 1, "its name is \"other\"");
    bench.file("s.toml", &specs()[1].replace("seeds = [1, ", "seeds = ["));
    run.asked(&["reload"], 0, "trials added: 2; no longer in the spec, and run all the same: 2\n");
    bench.file("s.toml", &specs()[1]);
    run.asked(&["reload"], 0, "trials added: 0\n");
    assert_eq!(run.count("count(*) FROM v_step"), steps, "nothing has gone on");

    run.asked(&["resume"], 0, "goes on: trials that wait: 6\n");
    assert_eq!(run.wait(), Some(0), "{}", run.told());
    run.asked(&["state"], 2, "no run holds s.sqlite");
    assert!(!bench.path("s.sqlite.control").exists());

    let table = std::fs::read_to_string(bench.path("said.csv")).unwrap();
    assert_eq!(table.lines().filter(|line| line.contains(",done,")).count(), 6, "{table}");
    let order =
        "group_concat(hash, ' ') FROM (SELECT hash FROM v_attempt ORDER BY started_at, attempt LIMIT 2)";
    assert_eq!(run.count(order), format!("{} {}", hashes[0], hashes[5]));
    let cancelled = "count(*), sum(reason = 'cancelled'), sum(attempts), (SELECT count(*) FROM checkpoint) FROM v_trial WHERE state = 'failed'";
    assert_eq!(run.count(cancelled), "2,2,1,1");
    let log = std::fs::read_to_string(bench.path("s.log")).unwrap();
    for word in ["pause", "resume", "workers 2", "reload", &format!("next {}", hashes[5])] {
        assert!(log.contains(&format!("command={word} done=true")), "{word}: {log}");
        assert!(run.told().contains(&format!("control: {word}: ")), "{word}: {}", run.told());
    }

    let again = bench.metasense(&["run", "s.toml", "--db", "s.sqlite"]);
    let said = String::from_utf8_lossy(&again.stderr);
    assert_eq!(again.status.code(), Some(0), "{said}");
    assert!(said.contains("nothing left to do") && said.contains("2 trials cancelled on request"), "{said}");
    bench.output(&["run", "s.toml", "--db", "s.sqlite", "--retry-failed"]);
    assert_eq!(results(&bench, "s.sqlite"), results(&bench, "whole.sqlite"));
}

/// A running trial that is cancelled, a stop, and a run that is killed: its socket is in nobody's way.
#[test]
fn what_runs_is_taken_back_and_what_is_killed_leaves_nothing_in_the_way() {
    let bench = bench();
    bench.file("s.toml", &specs()[1]);
    let mut run = Run::start(&bench, &["--workers", "2"]);
    run.busy("2 of 2 workers busy");
    let running = "hash FROM v_attempt WHERE state = 'running' ORDER BY hash LIMIT 1";
    run.until(|| run.bench.metasense(&["query", "s.sqlite", &format!("SELECT {running}")]).status.success());
    let hash = run.count(running);
    run.asked(&["next", &hash], 1, "refused: the trial is running already");
    run.asked(&["cancel", &hash], 0, "it ends after its step in progress");
    let ended =
        format!("count(*) FROM v_trial WHERE hash = '{hash}' AND state = 'failed' AND reason = 'cancelled'");
    run.until(|| run.count(&ended) == "1");
    run.asked(&["workers", "1"], 0, "workers: 2 before, 1 from now on");
    run.busy("1 of 1 worker busy");
    run.asked(&["stop"], 0, "stopping: 1 running trial is taken back");
    assert_eq!(run.wait(), Some(4), "{}", run.told());
    let others = "count(*) FROM v_attempt WHERE state = 'failed' AND reason NOT IN ('stopped', 'cancelled')";
    assert_eq!(run.count(others), "0", "something else has ended an attempt");

    let mut run = Run::start(&bench, &["--retry-failed"]);
    run.busy("busy");
    run.child.kill().unwrap();
    run.child.wait().unwrap();
    assert!(bench.path("s.sqlite.control").exists());
    run.asked(&["pause"], 2, "no run holds s.sqlite");
    bench.output(&["run", "s.toml", "--db", "s.sqlite"]);
    assert!(!bench.path("s.sqlite.control").exists());
    assert_eq!(results(&bench, "s.sqlite"), results(&bench, "whole.sqlite"));
    let nowhere = bench.metasense(&["control", "none.sqlite", "pause"]);
    assert_eq!(nowhere.status.code(), Some(2));
}
