//! Shards on one machine: run by hand, into a results folder, interrupted and killed; merged, they equal the whole sweep.

use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::common::roll::{self, Roll};
use crate::common::{Bench, TINY, results, without_cost};

/// Four quick trials.
fn four() -> String {
    TINY.to_owned() + "seeds = [1, 2]\n"
}

/// A number from a database; 0 if there is none.
fn number(bench: &Bench, db: &str, sql: &str) -> u32 {
    let output = bench.metasense(&["query", db, sql, "--format", "csv"]);
    String::from_utf8_lossy(&output.stdout).lines().nth(1).and_then(|n| n.parse().ok()).unwrap_or(0)
}

/// Shards divide the trials of a sweep. Merged, they equal the results of one machine for every analysis, and `run` computes trials
/// that a merge lacks.
#[test]
fn shards_merged_are_the_sweep() {
    let bench = Bench::new();
    bench.file("tiny.toml", &four());
    bench.output(&["run", "tiny.toml", "--db", "whole.sqlite"]);
    let lines = |args: &[&str]| {
        let mut lines: Vec<String> = bench.output(args).lines().skip(1).map(without_cost).collect();
        lines.sort();
        lines
    };
    let all = lines(&["expand", "tiny.toml", "--format", "csv"]);
    let mut parts = Vec::new();
    for shard in ["1/3", "2/3", "3/3"] {
        parts.extend(lines(&["expand", "tiny.toml", "--format", "csv", "--shard", shard]));
        bench.output(&["run", "tiny.toml", "--shard", shard, "--db", &format!("s{}.sqlite", &shard[..1])]);
    }
    parts.sort();
    assert_eq!(parts, all);

    bench.output(&["cluster", "merge", "s3.sqlite", "s1.sqlite", "--out", "merged.sqlite"]);
    // From the assignment beside the databases, a merge finds trials that never started.
    let listed = bench.output(&["expand", "tiny.toml", "--format", "csv", "--shard", "2/3"]);
    let second: Vec<&str> = listed.lines().skip(1).map(|line| &line[..16]).collect();
    let hashes: String = all.iter().map(|line| format!("{},1\n", line.split(',').next().unwrap())).collect();
    bench.file("assignment-of-3.csv", &format!("hash,shard\n{hashes}"));
    let said = bench.metasense(&["cluster", "merge", "s1.sqlite", "--out", "merged.sqlite"]);
    let said = String::from_utf8_lossy(&said.stderr).into_owned();
    assert!(said.contains(&format!("never started: {} trial", second.len())), "{said}");
    assert!(second.iter().all(|hash| said.contains(&hash[..8])), "{said}");
    bench.output(&["run", "tiny.toml", "--db", "merged.sqlite"]);
    assert_eq!(results(&bench, "merged.sqlite"), results(&bench, "whole.sqlite"));
    // The trials of the missing shard now exist twice, with the same bits.
    let said = bench.metasense(&["cluster", "merge", "merged.sqlite", "s2.sqlite", "--out", "merged.sqlite"]);
    let said = String::from_utf8_lossy(&said.stderr).into_owned();
    assert!(said.contains("4 trials from 1 database"), "{said}");
    assert_eq!(results(&bench, "merged.sqlite"), results(&bench, "whole.sqlite"));
    let again = bench.metasense(&["run", "tiny.toml", "--db", "merged.sqlite"]);
    assert!(String::from_utf8_lossy(&again.stderr).contains("nothing left to do"));
    for question in ["paired", "sensors"] {
        let answer = |db: &str| bench.output(&["analyse", db, "--question", question, "--format", "csv"]);
        assert_eq!(answer("merged.sqlite"), answer("whole.sqlite"), "{question}");
    }
    let runs = "SELECT count(DISTINCT shard) FROM v_run WHERE shards = 3 AND outcome = 'complete' AND estimated_seconds >= 0";
    assert_eq!(number(&bench, "merged.sqlite", runs), 3);
}

/// A folder of shards can be queried like a database, from facts that are updated. Arrays are read from the trial's shard; messages
/// state what facts do not contain.
#[test]
fn a_folder_of_shards_answers_questions_without_a_merge() {
    let bench = Bench::new();
    bench.file("tiny.toml", &four());
    bench.output(&["run", "tiny.toml", "--db", "whole.sqlite"]);
    let run = |shard: &str| {
        bench.output(&["run", "tiny.toml", "--shard", shard, "--folder", "s.shards"]);
    };
    let refused = bench.metasense(&["query", "s.shards", "SELECT 1"]);
    assert_eq!(refused.status.code(), Some(2), "{refused:?}");
    let count = |state: &str| {
        number(&bench, "s.shards", &format!("SELECT count(*) FROM v_trial WHERE state = '{state}'"))
    };
    run("1/2");
    assert_eq!(count("done"), 2);
    run("2/2");
    assert_eq!(count("done"), 4);
    let facts = || bench.path("s.shards/facts.db").metadata().unwrap().modified().unwrap();
    let made = facts();
    let trials = "SELECT hash, state, steps, attempts, error_initial, holdout_error_optimised, linear_holdout_error_initial, code
        FROM v_trial ORDER BY hash";
    for args in [
        &["query", "DB", trials, "--format", "csv"][..],
        &["query", "DB", "SELECT * FROM v_network ORDER BY 1, 8, 9", "--format", "csv"],
        &["query", "DB", "SELECT * FROM v_reading ORDER BY 1, 10, 11, 12", "--format", "csv"],
        &["analyse", "DB", "--question", "paired", "--format", "csv"],
        &["analyse", "DB", "--question", "sensors", "--format", "csv"],
    ] {
        let of = |db: &str| {
            bench.output(&args.iter().map(|a| if *a == "DB" { db } else { *a }).collect::<Vec<_>>())
        };
        assert_eq!(of("s.shards"), of("whole.sqlite"), "{args:?}");
    }
    let status = bench.metasense(&["status", "s.shards"]);
    let said = String::from_utf8_lossy(&status.stderr).into_owned();
    assert!(
        said.contains("facts of 2 databases merged; steps, curves and arrays are in these files"),
        "{said}"
    );
    let hash = bench.output(&["query", "s.shards", "SELECT hash FROM v_trial LIMIT 1", "--format", "csv"]);
    let hash = hash.lines().nth(1).unwrap();
    for db in ["s.shards", "whole.sqlite"] {
        bench.output(&["export", db, hash, "--format", "npy", "--out", &format!("{db}.npy")]);
        bench.output(&["report", db, hash, "--out", &format!("{db}.html")]);
    }
    assert_eq!(bench.array("s.shards.npy"), bench.array("whole.sqlite.npy"));
    let wave = |db: &str| {
        std::fs::read_to_string(bench.path(&format!("{db}.html"))).unwrap().matches("<canvas").count()
    };
    assert_eq!(wave("s.shards"), wave("whole.sqlite"));
    assert!(bench.output(&["status", "s.shards", hash]).lines().count() < 1000);
    assert_eq!(facts(), made, "written again with nothing new");

    // A whole merge of a folder ignores its facts; without the files the rest of a trial is lost.
    bench.output(&["cluster", "merge", "s.shards", "--out", "merged.sqlite"]);
    assert_eq!(results(&bench, "merged.sqlite"), results(&bench, "whole.sqlite"));
    bench.output(&["cluster", "merge", "s.shards", "--facts", "--out", "facts.sqlite"]);
    std::fs::remove_dir_all(bench.path("s.shards")).unwrap();
    let gone = bench.metasense(&["export", "facts.sqlite", hash, "--format", "npy", "--out", "gone.npy"]);
    let said = String::from_utf8_lossy(&gone.stderr).into_owned();
    assert!(
        said.contains("which cannot be read: merge the facts again") && said.contains("shard-"),
        "{said}"
    );
    assert_eq!(gone.status.code(), Some(2));
}

/// Instruction sets of nodes differ, and with them estimates: whichever node assigns, every trial is assigned once.
#[test]
fn every_trial_has_a_shard_whatever_machine_deals() {
    let bench = Bench::new();
    let axes = "panels = [1, 2]\nsensors = [1, 2, 3, 4]\nseeds = [".to_owned();
    let seeds: Vec<String> = (0..60).map(|seed| seed.to_string()).collect();
    let text = TINY.split("panels = [2]").next().unwrap().to_owned() + &axes + &seeds.join(", ") + "]\n";
    bench.file("many.toml", &text);
    let mut dealt = std::collections::BTreeSet::new();
    for (i, simd) in (1..=11).zip(["baseline", "avx2"].into_iter().cycle()) {
        let shard = format!("{i}/11");
        let args = ["expand", "many.toml", "--format", "csv", "--shard", &shard, "--simd", simd];
        dealt.extend(bench.output(&args).lines().skip(1).map(|line| line[..16].to_owned()));
    }
    assert_eq!(dealt.len(), 480);
}

/// The whole sweep as one shard that hands in to `out`, with its local disk in `node`.
fn start(bench: &Bench, node: &str) -> Child {
    std::fs::create_dir_all(bench.path(node)).unwrap();
    Command::new(env!("CARGO_BIN_EXE_metasense"))
        .args([
            "run",
            "tiny.toml",
            "--shard",
            "1/1",
            "--folder",
            "out",
            "--copy-every",
            "1",
            "--workers",
            "1",
        ])
        .current_dir(bench.path(""))
        .env("TMPDIR", bench.path(node))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

fn signal(child: &Child, signal: i32) {
    // SAFETY: sends a signal to a process that this test has started.
    unsafe { libc::kill(child.id() as i32, signal) };
}

fn wait(child: &mut Child) -> Option<i32> {
    let began = Instant::now();
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return status.code();
        }
        assert!(began.elapsed() < Duration::from_secs(60), "the shard does not end within a minute");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Killed on one node, where only periodic copies remain; ended by SIGTERM on a second; completed on a third. Except for the lost
/// node, nothing is left on a node.
#[test]
fn a_shard_goes_on_on_another_node() {
    let bench = Bench::new();
    // Long enough that most of the work remains after losing one node and ending another
    let tiny = four().replace("iterations = 4\n", "iterations = 240\n");
    bench.file("tiny.toml", &tiny);
    bench.output(&["run", "tiny.toml", "--db", "whole.sqlite"]);
    // One file per attempt, with the start time in its name.
    let attempts = || {
        let files = bench.path("out").read_dir().into_iter().flatten().flatten();
        let mut attempts: Vec<String> = files.map(|f| f.file_name().into_string().unwrap()).collect();
        attempts.retain(|name| name.starts_with("shard-1-of-1.") && name.ends_with(".sqlite"));
        attempts.sort();
        attempts
    };
    let handed_in = || format!("out/{}", attempts().pop().unwrap_or_default());
    let steps = || number(&bench, &handed_in(), "SELECT count(*) FROM v_step");
    let left = |node: &str| bench.path(node).read_dir().unwrap().count();

    let mut lost = start(&bench, "node1");
    let began = Instant::now();
    while steps() == 0 {
        assert!(began.elapsed() < Duration::from_secs(60), "nothing is handed in within a minute");
    }
    signal(&lost, libc::SIGKILL);
    lost.wait().unwrap();
    let before = steps();
    assert!(before > 0 && left("node1") == 1, "{before} steps");

    let mut ended = start(&bench, "node2");
    let log = bench.path("out/shard-1-of-1.log");
    let runs = || std::fs::read_to_string(&log).unwrap_or_default().matches("worker started").count();
    let workers = runs();
    while runs() == workers && ended.try_wait().unwrap().is_none() {
        std::thread::sleep(Duration::from_millis(2));
    }
    // The results folder is missing at the end of the shard, and returns in time.
    let (out, away) = (bench.path("out"), bench.path("away"));
    std::fs::rename(&out, &away).unwrap();
    signal(&ended, libc::SIGTERM);
    let log = || std::fs::read_to_string(away.join("shard-1-of-1.log")).unwrap_or_default();
    while !log().contains("could not be copied to the folder") && ended.try_wait().unwrap().is_none() {
        std::thread::sleep(Duration::from_millis(20));
    }
    std::fs::rename(&away, &out).unwrap();
    assert_eq!(wait(&mut ended), Some(4));
    assert!(steps() >= before && left("node2") == 0, "{} steps after {before}", steps());

    let mut last = start(&bench, "node3");
    assert_eq!(wait(&mut last), Some(0));
    assert_eq!(left("node3"), 0);
    // The last file contains everything that the first two handed in.
    assert_eq!(attempts().len(), 1, "{:?}", attempts());
    assert_eq!(results(&bench, &handed_in()), results(&bench, "whole.sqlite"));
    bench.output(&["cluster", "merge", "out", "--out", "merged.sqlite"]);
    assert_eq!(results(&bench, "merged.sqlite"), results(&bench, "whole.sqlite"));
    let outcomes = "SELECT count(*) FROM v_run WHERE outcome IN ('interrupted', 'complete')";
    assert_eq!(number(&bench, &handed_in(), outcomes), 2);

    // A spec that has changed since its submission is refused.
    bench.file("out/spec.toml", &tiny.replace("[1, 2]", "[1]"));
    let refused = bench.metasense(&["run", "tiny.toml", "--shard", "1/1", "--folder", "out"]);
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(refused.status.code() == Some(2) && said.contains("has changed since"), "{said}");
}

/// A scheduler that has lost its process on a node starts the shard again while the first attempt is ending. A signal ends the
/// wait.
#[test]
fn an_attempt_waits_for_one_that_ends_on_its_node() {
    let bench = Bench::new();
    bench.file("tiny.toml", &four().replace("iterations = 4\n", "iterations = 20\n"));
    bench.output(&["run", "tiny.toml", "--db", "whole.sqlite"]);
    let log = || std::fs::read_to_string(bench.path("out/shard-1-of-1.log")).unwrap_or_default();
    let mut first = start(&bench, "node");
    while !log().contains("worker started") && first.try_wait().unwrap().is_none() {
        std::thread::sleep(Duration::from_millis(2));
    }
    signal(&first, libc::SIGSTOP); // with remaining trials, however quick they are
    let (mut second, mut third) = (start(&bench, "node"), start(&bench, "node"));
    std::thread::sleep(Duration::from_secs(1)); // longer than the attempts to lock
    assert_eq!(second.try_wait().unwrap(), None, "{}", log());
    signal(&third, libc::SIGTERM);
    assert_eq!(wait(&mut third), Some(4));
    signal(&first, libc::SIGTERM);
    signal(&first, libc::SIGCONT);
    assert_eq!((wait(&mut first), wait(&mut second)), (Some(4), Some(0)), "{}", log());
    bench.output(&["cluster", "merge", "out", "--out", "merged.sqlite"]);
    assert_eq!(results(&bench, "merged.sqlite"), results(&bench, "whole.sqlite"));
}

/// A shard is killed at random moments, alternately on two nodes, one of which is lost each time; merges and `gc` are killed as
/// well (`KILLS=N` for more, `KILL_SEED=N` to repeat). Merged results never shrink, and the final results are those of an
/// undisturbed run.
#[test]
fn kills_at_random_moments_lose_nothing_that_was_handed_in() {
    let kills = roll::number("KILLS").unwrap_or(10);
    let (mut roll, mut killed) = (Roll::new(), 0);
    while killed < kills {
        let bench = Bench::new();
        bench.file("tiny.toml", &four().replace("iterations = 4\n", "iterations = 20\n"));
        bench.output(&["run", "tiny.toml", "--db", "whole.sqlite"]);
        let mut before = 0;
        let mut tidied = |words: &[&str], kill_after: Option<u64>| {
            let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
            command.args(words).current_dir(bench.path("")).stdout(Stdio::null()).stderr(Stdio::null());
            let mut child = command.spawn().unwrap();
            if let Some(time) = kill_after {
                std::thread::sleep(Duration::from_millis(time));
                signal(&child, libc::SIGKILL);
            }
            let killed = child.wait().unwrap().code().is_none();
            let now = number(&bench, "merged.sqlite", "SELECT count(*) FROM v_step");
            assert!(now >= before, "{now} steps after {before}");
            before = now;
            u64::from(killed)
        };
        // steps in the latest attempt's file
        let handed_in = || {
            let files = bench.path("out").read_dir().into_iter().flatten().flatten();
            let names = files.map(|file| file.file_name().into_string().unwrap());
            let last = names.filter(|name| name.starts_with("shard-1") && name.ends_with(".sqlite")).max();
            last.map_or(0, |name| number(&bench, &format!("out/{name}"), "SELECT count(*) FROM v_step"))
        };
        let (merge, gc) =
            (["cluster", "merge", "out", "--out", "merged.sqlite"], ["cluster", "gc", ".", "--yes"]);
        for round in 0.. {
            let node = format!("node{}", round % 2);
            let before = handed_in();
            let mut shard = start(&bench, &node);
            std::thread::sleep(Duration::from_millis(200 + roll.below(1000)));
            // every other shard lives until it has handed in more, so that the sweep ends on a loaded machine
            while round % 2 == 1 && handed_in() <= before && shard.try_wait().unwrap().is_none() {
                std::thread::sleep(Duration::from_millis(100));
            }
            let ended = shard.try_wait().unwrap().is_some_and(|status| status.success());
            signal(&shard, libc::SIGKILL);
            shard.wait().unwrap();
            if ended {
                break;
            }
            killed += 1 + tidied(&merge, Some(roll.below(150))) + tidied(&gc, Some(roll.below(60)));
            if roll.below(2) == 0 {
                std::fs::remove_dir_all(bench.path(&node)).unwrap();
            }
        }
        tidied(&merge, None);
        // leftovers of killed processes are removed, and no row is lost
        tidied(&gc, None);
        let left = std::fs::read_dir(bench.path("")).unwrap().flatten();
        let left: Vec<_> = left.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
        assert!(!left.iter().any(|name| name.contains(".merge-") || name.ends_with(".tmp")), "{left:?}");
        bench.output(&["cluster", "merge", "out", "--out", "again.sqlite"]);
        assert_eq!(results(&bench, "again.sqlite"), results(&bench, "whole.sqlite"));
        assert_eq!(results(&bench, "merged.sqlite"), results(&bench, "whole.sqlite"));
    }
    println!("{killed} kills, no difference");
}
