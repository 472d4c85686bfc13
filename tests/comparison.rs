//! The comparison at the end of a trial is stopped, killed and resumed like outer steps, with the same bits as the result.

use std::collections::BTreeSet;
use std::process::Child;
use std::time::{Duration, Instant};

use crate::common::processes::{children, eventually, is_alive, kill, rows};
use crate::common::roll::{self, Roll};
use crate::common::{Bench, TINY, results};

/// Maximum time until a run ends after Ctrl-C: two seconds, and two more if other tests load cores and disk.
const STOPPED: Duration = Duration::from_secs(4);

/// Trials whose four steps take less than a second, and whose comparison takes longer than the two seconds between checkpoints.
fn long(sensors: &str, iterations: u32) -> String {
    let text = TINY.replace("[1, 2]", sensors);
    text.replace("[sweep]", &format!("[evaluation]\nseeds = 1\nlong_iterations = {iterations}\n[sweep]"))
}

/// A run in its own process; dropping it kills the process.
struct Run(Child);

impl Run {
    fn start(bench: &Bench, db: &str) -> Self {
        Self(bench.start(&["run", "long.toml", "--db", db]))
    }

    fn code(&mut self) -> Option<i32> {
        let ended = eventually(Duration::from_secs(120), || self.0.try_wait().unwrap());
        ended.expect("the run ends within two minutes").code()
    }

    /// Sends a signal; returns exit code and time until the end.
    fn stop(&mut self, signal: i32) -> (Option<i32>, Duration) {
        let asked = Instant::now();
        kill(self.0.id(), signal);
        (self.code(), asked.elapsed())
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Stopped twice during a network's training, the second time soon after it resumed.
#[test]
fn a_stop_on_request_ends_a_comparison_at_once_and_nothing_of_it_is_lost() {
    let bench = Bench::new();
    bench.file("long.toml", &long("[1]", 48_000));
    bench.output(&["run", "long.toml", "--db", "whole.sqlite"]);
    let saved = || bench.number("s.sqlite", "SELECT length(bytes) FROM checkpoint WHERE step = 4");
    let more_than = |size| {
        let more = || Some(saved()).filter(|saved| *saved > size);
        eventually(Duration::from_secs(60), more).expect("the comparison goes on")
    };
    let mut before = 0;
    for signal in [libc::SIGINT, libc::SIGTERM] {
        let mut run = Run::start(&bench, "s.sqlite");
        if signal == libc::SIGINT {
            before = more_than(more_than(0));
            std::thread::sleep(Duration::from_millis(100));
        } else {
            // Between the worker's start and its first checkpoint.
            let worker = || children(run.0.id()).first().copied();
            eventually(Duration::from_secs(60), worker).expect("a worker is started");
            std::thread::sleep(Duration::from_millis(100));
        }
        let (code, took) = run.stop(signal);
        println!("ended {took:?} after signal {signal}, {} bytes saved, {before} before", saved());
        assert!(code == Some(4) && took < STOPPED, "{code:?} after {took:?}");
        // not compared with the first stop: the optimiser's state of a network is dropped when the network is trained
        assert!(saved() >= before + u64::from(signal == libc::SIGINT), "{} bytes, {before} before", saved());
    }
    assert_eq!(Run::start(&bench, "s.sqlite").code(), Some(0));
    assert_eq!(results(&bench, "s.sqlite"), results(&bench, "whole.sqlite"));
    let attempts = rows(&bench.path("s.sqlite"), "SELECT state, reason, steps FROM attempt ORDER BY number");
    assert_eq!(attempts, [r#"["failed","stopped",4]"#, r#"["failed","stopped",0]"#, r#"["done",null,0]"#]);
    // Setup and lost work count as well.
    let seconds = rows(
        &bench.path("s.sqlite"),
        "SELECT (SELECT min(cpu_seconds) FROM attempt) > 0,
           abs(t.seconds - (SELECT sum(cpu_seconds) FROM attempt)) < 1e-9,
           t.seconds > (SELECT sum(seconds) FROM v_step) + t.seconds_evaluation FROM v_trial t",
    );
    assert_eq!(seconds, ["[1,1,1]"]);
}

/// Training that lasts longer than the silence limit counts as progress; a hang within it is detected.
#[test]
fn a_long_training_is_no_silence_and_a_hang_within_it_is_one() {
    let bench = Bench::new();
    let text = long("[1]", 0).replace("long_iterations = 0", "").replace("batch = 4", "protocol = \"paper\"");
    let text = text.replace("iterations = 10\n", "iterations = 10000000\n");
    bench.file(
        "long.toml",
        &text.replace("[sweep]", "[run]\nno_progress = 3.0\nretries = 1\ngrace = 0.5\n[sweep]"),
    );
    let mut run = Run::start(&bench, "s.sqlite");
    let worker = || children(run.0.id()).first().copied();
    eventually(Duration::from_secs(60), worker).expect("a worker is started");
    std::thread::sleep(Duration::from_secs(6));
    let attempts = || rows(&bench.path("s.sqlite"), "SELECT state, reason FROM attempt ORDER BY number");
    assert_eq!(attempts(), [r#"["running",null]"#]);
    kill(worker().unwrap(), libc::SIGSTOP);
    let hung = || attempts().contains(&r#"["failed","no_progress"]"#.to_owned()).then_some(());
    assert!(eventually(Duration::from_secs(6), hung).is_some(), "{:?}", attempts());
    assert_eq!(run.stop(libc::SIGINT).0, Some(4));
}

/// A stop abandons an outer step that exceeds the grace time; the next run repeats the step.
#[test]
fn a_stop_on_request_does_not_wait_for_a_long_step() {
    let bench = Bench::new();
    let paper = long("[1]", 0).replace("batch = 4", "protocol = \"paper\"");
    let paper = paper.replace("long_iterations = 0", "").replace("iterations = 10", "iterations = 10000000");
    bench.file("long.toml", &paper.replace("[sweep]", "[run]\ngrace = 1.0\n[sweep]"));
    let mut run = Run::start(&bench, "s.sqlite");
    let begun = || (bench.number("s.sqlite", "SELECT count(*) FROM attempt") == 1).then_some(());
    eventually(Duration::from_secs(60), begun).expect("the trial is begun");
    std::thread::sleep(Duration::from_millis(500));
    let (code, took) = run.stop(libc::SIGINT);
    println!("ended after {took:?}");
    assert!(code == Some(4) && took < STOPPED, "{code:?} after {took:?}");
    let attempts = rows(&bench.path("s.sqlite"), "SELECT state, reason, steps FROM attempt");
    assert_eq!(attempts, [r#"["failed","stopped",0]"#]);
    assert_eq!(rows(&bench.path("s.sqlite"), "SELECT state FROM trial"), [r#"["pending"]"#]);
}

/// Four kills (`KILLS=N` for more, `KILL_SEED=N` to repeat) of a worker, the run, or both, at random moments until the sweep is
/// done. Every other kill waits for a new checkpoint, so that the sweep ends.
#[test]
fn kills_in_the_middle_of_comparisons_leave_the_results_of_an_undisturbed_run() {
    let bench = Bench::new();
    bench.file("long.toml", &long("[1, 2]", 20_000));
    bench.output(&["run", "long.toml", "--db", "whole.sqlite"]);
    let expected = results(&bench, "whole.sqlite");
    let least = roll::number("KILLS").unwrap_or(4);
    let (mut kills, mut within, mut sweeps, mut roll) = (0, 0, 0, Roll::new());
    while kills < least {
        let db = format!("killed-{sweeps}.sqlite");
        sweeps += 1;
        // attempts in which each run was killed; a run may be killed before it has recorded its predecessor's
        let mut counted = BTreeSet::new();
        let of = |state: &str| {
            let sql =
                format!("SELECT trial_id, number FROM attempt WHERE state = '{state}' AND cpu_seconds > 0");
            rows(&bench.path(&db), &sql).into_iter().collect::<BTreeSet<_>>()
        };
        let come = || {
            let sql = "SELECT (SELECT count(*) FROM step) + (SELECT count(*) FROM trial WHERE state = 'done') \
                       + coalesce((SELECT sum(length(bytes)) FROM checkpoint), 0)";
            bench.number(&db, sql)
        };
        let ended = 'runs: loop {
            let mut run = Run::start(&bench, &db);
            loop {
                let (before, began) = (come(), Instant::now());
                let patience = if roll.below(2) == 0 { roll.below(1500) } else { 60_000 };
                while come() == before && began.elapsed() < Duration::from_millis(patience) {
                    if let Some(status) = run.0.try_wait().unwrap() {
                        break 'runs status;
                    }
                    std::thread::sleep(Duration::from_millis(10));
                }
                std::thread::sleep(Duration::from_millis(roll.below(1000)));
                let workers = children(run.0.id());
                let Some(&worker) = workers.get(roll.place(workers.len())) else { continue };
                kills += 1;
                within += bench.number(&db, "SELECT max(step = 4) FROM checkpoint");
                match roll.below(3) {
                    0 => kill(worker, libc::SIGKILL),
                    which => {
                        kill(run.0.id(), libc::SIGKILL);
                        if which == 1 {
                            kill(worker, libc::SIGKILL);
                        }
                        let gone = || workers.iter().all(|pid| !is_alive(*pid)).then_some(());
                        assert!(
                            eventually(Duration::from_secs(5), gone).is_some(),
                            "workers outlive their run"
                        );
                        // a thread of the run may still finish a write
                        run.0.wait().unwrap();
                        counted.extend(of("running"));
                        break;
                    }
                }
            }
        };
        assert_eq!(ended.code(), Some(0), "after {kills} kills");
        assert_eq!(results(&bench, &db), expected, "after {kills} kills");
        let failed = of("failed");
        assert!(failed.is_superset(&counted), "seconds of {counted:?} were known, of {failed:?} still are");
    }
    println!("{kills} kills in {sweeps} sweeps, {within} of them within a comparison");
}

/// Without the initial body, tables, messages and exports omit it, and all else is unchanged. Adding it later trains no body again.
#[test]
fn the_initial_body_is_compared_only_where_somebody_asks() {
    let bench = Bench::new();
    let text = TINY.replace("[1, 2]", "[1]").replace("[sweep]", "[evaluation]\nseeds = 1\n[sweep]");
    bench.file("both.toml", &text);
    bench.file("alone.toml", &text.replace("seeds = 1\n", "seeds = 1\ninitial = false\n"));
    let said = bench.metasense(&["run", "alone.toml", "--db", "s.sqlite"]);
    let said = String::from_utf8_lossy(&said.stderr);
    assert!(said.contains("held-out error ") && !said.contains("->") && !said.contains("unknown"), "{said}");
    bench.output(&["run", "both.toml", "--db", "s.sqlite"]);
    let found = rows(
        &bench.path("s.sqlite"),
        "SELECT t.spec->>'$.evaluation.initial', t.error_initial IS NULL, sum(n.body = 'initial'), sum(n.body = 'optimised'),
           (SELECT sum(steps) FROM attempt a WHERE a.trial_id = t.id)
         FROM trial t JOIN network n ON n.trial_id = t.id GROUP BY t.id ORDER BY t.id",
    );
    assert_eq!(found, ["[0,1,0,1,4]", "[null,0,1,1,0]"]);
    let same = rows(
        &bench.path("s.sqlite"),
        "SELECT count(*), count(DISTINCT error_optimised), count(DISTINCT holdout_error_optimised) FROM trial",
    );
    assert_eq!(same, ["[2,1,1]"]);
    let hash = &rows(&bench.path("s.sqlite"), "SELECT hash FROM trial WHERE error_initial IS NULL")[0][2..34];
    let refused = bench
        .metasense(&["export", "s.sqlite", hash, "--design", "initial", "--format", "c", "--out", "initial"]);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(!refused.status.success() && said.contains("trained no network on this body"), "{said}");
    let page = bench.output(&["report", "s.sqlite", hash, "--out", "r.html"]);
    assert!(page.contains("r.html"), "{page}");
}
