//! From a requirement to the design that meets it: most of the sweep is never run, and kills change no decision.

use std::time::Duration;

use crate::common::processes::{eventually, kill};
use crate::common::{Bench, TINY};

/// The sweep with two placements and a requirement.
fn spec(goal: &str) -> String {
    TINY.replace("[optimise]\niterations = 4", "[optimise]\niterations = 24")
        + "placements = 2\n[goal]\n"
        + goal
}

/// The same with a linear decoder.
fn linear(goal: &str) -> String {
    spec(goal).replace("[brain]\niterations = 10\nwidth = 16", "[brain]\nkind = \"linear\"")
}

fn design(bench: &Bench, args: &[&str]) -> (Option<i32>, String, String) {
    let out = bench.metasense(&[&["design", "s.toml", "--format", "csv"], args].concat());
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (out.status.code(), text(out.stdout), text(out.stderr))
}

fn trials(bench: &Bench) -> String {
    let sql = "SELECT hash, state, reason, (SELECT count(*) FROM v_step s WHERE s.hash = t.hash) AS steps,
        holdout_error_optimised FROM v_trial t ORDER BY hash";
    bench.output(&["query", "results/tiny.sqlite", sql, "--format", "csv"])
}

/// Any error meets the requirement. After a first look at both numbers of sensors, a cheaper candidate is trained to its end and
/// judged on fresh seeds with the same noise; the others stop. A second call runs nothing; a search stopped by its time limit
/// resumes to the same end.
#[test]
fn the_cheapest_design_is_found_and_judged_on_fresh_seeds() {
    let bench = Bench::new();
    let noisy = |goal: &str| spec(goal) + "[sensors]\nnoise = 0.03\n";
    bench.file("s.toml", &noisy("error = 1e6\n"));
    let (code, table, said) = design(&bench, &["--workers", "2"]);
    assert_eq!(code, Some(0), "{said}");
    assert!(table.starts_with("M,operations,units,error,keeps_to,meets"), "{table}");
    let chosen: Vec<&str> = table.lines().filter(|line| line.contains(",true,")).collect();
    assert!(
        matches!(chosen[..], [row] if row.starts_with("1,") && row.contains("confirmed on 8 seeds")),
        "{table}"
    );
    assert!(said.contains("the cheapest design that meets 1e6 %"), "{said}");
    let found = trials(&bench);
    let count = |what: &str| found.lines().filter(|line| line.contains(what)).count();
    assert_eq!((count(",done,"), count(",paused,"), count(",done,,0,")), (13, 1, 12), "{found}");
    assert!(found.lines().any(|line| line.contains(",pending,paused,11,")), "{found}");

    let says_early = || {
        let analysed = bench.metasense(&["analyse", "results/tiny.sqlite", "--question", "seconds"]);
        String::from_utf8_lossy(&analysed.stderr).contains("may have stopped because")
    };
    assert!(says_early(), "one trial is not done");

    let sql = "SELECT json_array_length(spec, '$.sensors.relative_to.shifts') AS sizes,
        json_array_length(spec, '$.body.design.shifts') AS designs, count(*) AS trials,
        sum(spec->>'$.sensors.relative_to' = spec->>'$.body.design') AS same FROM v_trial GROUP BY 1, 2 ORDER BY 1";
    let told = bench.output(&["query", "results/tiny.sqlite", sql, "--format", "csv"]);
    let [_, own, fresh] = told.lines().collect::<Vec<_>>()[..] else { panic!("{told}") };
    assert!(own.starts_with(",,2") && fresh.ends_with(",12,0"), "{told}");

    let (code, again, said) = design(&bench, &[]);
    assert_eq!((code, &again), (Some(0), &table), "{said}");
    assert_eq!(trials(&bench), found);

    // the report contains the search, and does not count a judgement on a fresh seed as a trained body
    bench.output(&["report", "results/tiny.sqlite", "--out", "r.html", "--out-dir", "r"]);
    let text = |name: &str| std::fs::read_to_string(bench.path(name)).unwrap();
    let hashes = |table: &str| -> Vec<String> {
        table.lines().filter_map(|row| row.rsplit(',').next().map(str::to_owned)).collect()
    };
    assert_eq!(hashes(&text("r/search.csv")), hashes(&table));
    assert!(text("r.html").contains("tiny: the cheapest design that meets"));
    assert_eq!(text("r/pairs.csv").lines().count(), 2, "one trial has trained a body to its end");

    bench.output(&["run", "s.toml"]);
    assert!(!says_early(), "the whole grid is done");

    let halting = Bench::new();
    halting.file("s.toml", &noisy("error = 1e6\nhours = 1e-9\n"));
    let (code, _, said) = design(&halting, &["--workers", "1"]);
    assert!(code == Some(1) && said.contains("goal.hours is used up"), "{said}");
    assert_ne!(trials(&halting), found);
    halting.file("s.toml", &noisy("error = 1e6\n"));
    assert_eq!(design(&halting, &["--workers", "1"]).1, table);
    assert_eq!(trials(&halting), found);
}

/// Shards with rounds find the same design with the same trials, also after a stop.
#[test]
fn shards_find_the_design_of_one_run() {
    let bench = Bench::new();
    bench.file("s.toml", &spec("error = 1e6\n").replace("iterations = 24", "iterations = 120"));
    let (code, table, said) = design(&bench, &["--workers", "2"]);
    assert_eq!(code, Some(0), "{said}");
    let found = trials(&bench);
    std::fs::remove_file(bench.path("results/tiny.sqlite")).unwrap();
    let args = ["cluster", "submit", "local", "s.toml", "--goal", "--cpus", "1", "--at-most", "2"];
    let mut first = bench.start(&args);
    let begun = || {
        let log = std::fs::read_to_string(bench.path("results/tiny.shards/shard-1-of-2.log"));
        log.is_ok_and(|text| text.contains("worker started")).then_some(())
    };
    eventually(Duration::from_secs(60), begun).expect("a shard begins");
    kill(first.id(), libc::SIGTERM);
    let code = first.wait().unwrap().code();
    assert!(code == Some(4) || code == Some(0), "{code:?}");
    let out = bench.metasense(&args);
    let said = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success() && said.contains("the cheapest design that meets 1e6 %"), "{said}");
    assert_eq!(trials(&bench), found);
    assert_eq!(design(&bench, &[]).1, table);
}

/// No error meets the requirement: exit code 1, and the nearest requirement that can be met. Limits on the decoder exclude trials
/// before they run.
#[test]
fn what_cannot_be_met_is_said() {
    let bench = Bench::new();
    bench.file("s.toml", &spec("error = 1e-6\n"));
    let (code, table, said) = design(&bench, &[]);
    assert!(code == Some(1) && !table.contains(",true,"), "{said}");
    assert!(said.contains("no design was confirmed") && said.contains("goal.error = "), "{said}");
    // one sensor: 39 lags of 3 signals for 2 forces
    bench.file("s.toml", &linear("error = 1e6\noperations = 300\n"));
    let (code, table, said) = design(&bench, &["--db", "few.sqlite"]);
    assert!(code == Some(0) && table.lines().count() == 2, "{table}{said}");
    assert!(
        said.contains("goal.operations excludes 2 trials; the smallest value is 468 multiply-adds"),
        "{said}"
    );
    let row: Vec<&str> = table.lines().nth(1).unwrap().split(',').collect();
    let brain = bench.path("brain.c");
    let args =
        ["export", "few.sqlite", row.last().unwrap(), "--format", "c", "--out", brain.to_str().unwrap()];
    bench.output(&args);
    let text = std::fs::read_to_string(&brain).unwrap();
    let head = text.lines().find(|line| line.contains("multiply-adds per reading")).unwrap();
    let told: Vec<f64> =
        head.split(|c: char| !c.is_ascii_digit()).filter_map(|word| word.parse().ok()).collect();
    assert_eq!(told[told.len() - 1], row[1].parse::<f64>().unwrap(), "{head}");
    bench.file("s.toml", &linear("error = 1e6\nmemory = 0.001\n"));
    let (code, _, said) = design(&bench, &[]);
    let least = said.split("the smallest value is ").nth(1).and_then(|rest| rest.split(" kB").next());
    let bytes = told[told.len() - 3] + told[told.len() - 2];
    assert!(
        code == Some(2) && (least.unwrap().parse::<f64>().unwrap() - bytes / 1e3).abs() < 5e-3,
        "{said}{head}"
    );
    // 4 × 4 squares with half diagonal h/cos 25°, h = (15 − 2.25)/2, whose corners are h from their centre lines
    let (h, turn) = (6.375, 25f64.to_radians());
    let grams = 16.0 * 4e-8 * 2.0 * (h / turn.cos()).powi(2) * 1e6;
    for (key, least, unit) in [("mass", grams, "g"), ("size", 45.0 + 2.0 * h, "mm")] {
        bench.file("s.toml", &linear(&format!("error = 1e6\n{key} = 0.001\n")));
        let (code, _, said) = design(&bench, &[]);
        let told = said.split("the smallest value is ").nth(1).and_then(|rest| rest.split(unit).next());
        let told: f64 = told.unwrap_or_else(|| panic!("{said}")).trim().parse().unwrap();
        assert!(code == Some(2) && (told / least - 1.0).abs() < 5e-3, "{told} {least}: {said}");
    }
    bench.file("s.toml", &linear("error = 1e6\ndelay = 0.01\n"));
    let (code, _, said) = design(&bench, &[]);
    assert!(code == Some(2) && said.contains("goal.delay = 0.01") && said.contains("0.19"), "{said}");
}
