//! Names of trials, specs with changes, and specs with a base, in all commands.

use crate::common::{Bench, TINY};

/// Hashes of a spec's trials.
fn hashes(bench: &Bench, spec: &[&str]) -> Vec<String> {
    let csv = bench.output(&[&["expand"], spec, &["--format", "csv"]].concat());
    csv.lines().skip(1).map(|line| line[..32].to_owned()).collect()
}

/// Commands that take a trial, with their required options.
const COMMANDS: &[&[&str]] = &[
    &["trial"],
    &["body", "simulate", "--forces", "f.npy", "--out-dir", "o"],
    &["lab", "identify", "--records", "r.toml"],
    &["status"],
    &["body", "bound"],
    &["body", "casts", "--casts", "1"],
    &["body", "modes"],
    &["body", "place"],
    &["body", "project", "--design", "d.npy", "--out", "o.npy"],
    &["body", "draw", "--out", "o.svg"],
    &["export", "--format", "npz", "--out", "o"],
    &["lab", "evaluate", "--records", "initial=r.toml"],
];

#[test]
fn a_trial_is_named_in_one_way_by_all_commands() {
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    bench.output(&["run", "tiny.toml"]);
    let db = "results/tiny.sqlite";
    let hashes = hashes(&bench, &["tiny.toml"]);
    // Unknown and empty names.
    for name in ["zz", ""] {
        for command in COMMANDS.iter().chain([&["report"][..]].iter()) {
            let calls = [(db, vec![db, name]), ("tiny.toml", vec!["tiny.toml", name])];
            for (source, call) in calls.into_iter().filter(|call| call.0 == db || command[0] != "report") {
                let output = bench.metasense(&[command, &call[..]].concat());
                let said = String::from_utf8_lossy(&output.stderr);
                let expected = match name {
                    "" => "is empty".to_owned(),
                    _ => format!("{source}: trial {name}: no hash begins with this text"),
                };
                assert!(output.status.code() == Some(2) && said.contains(&expected), "{command:?}: {said}");
            }
        }
    }
    // A typing error.
    let [a, b] = [&hashes[0][..8], &hashes[0][..12]];
    let typed = format!("{}{}", &a[..7], if a.ends_with('0') { '1' } else { '0' });
    let output = bench.metasense(&["status", db, &typed]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        said.contains(&format!("trial {typed}: no hash begins with this text; the nearest is {b}")),
        "{said}"
    );
    // The same trial by spec and by database.
    let of_spec = ["tiny.toml", a];
    for command in [&["body", "modes", "--format", "csv"][..], &["body", "draw", "--out", "o.svg"]] {
        let answers = [&of_spec[..], &[db, a]].map(|name| {
            let out = bench.output(&[command, name].concat());
            (out, std::fs::read(bench.path("o.svg")).ok())
        });
        assert_eq!(answers[0], answers[1], "{command:?}");
    }
    let errors = |name: &[&str]| {
        let row = bench.output(&[&["trial", "--format", "csv"], name].concat());
        row.lines().nth(1).unwrap().split(',').take(5).map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(errors(&of_spec), errors(&[db, a]));
    let export = |name: &[&str]| {
        bench.output(&[&["export", "--format", "npy", "--out", "o.npy"], name].concat());
        bench.array("o.npy")
    };
    let optimised = export(&of_spec);
    assert_eq!(optimised, export(&[db, a]));
    // The trained body of a finished trial differs from the initial body.
    let modes = |body: &str| bench.output(&["body", "modes", db, a, "--design", body, "--format", "csv"]);
    assert!(modes("optimised") != modes("initial"));
    let refused = bench.metasense(&["body", "modes", "tiny.toml", "--design", "optimised"]);
    assert_eq!(refused.status.code(), Some(2));
}

/// Changes on the command line give the trials of the edited file; the same command resumes them, and scripts of shards contain
/// them.
#[test]
fn changes_are_in_the_hash_as_if_written() {
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    bench.file("edited.toml", &TINY.replace("iterations = 4", "iterations = 3").replace("[1, 2]", "[1]"));
    let changed = ["tiny.toml", "optimise.iterations=3", "sweep.sensors=[1]"];
    let hash = hashes(&bench, &changed);
    assert_eq!(hash, hashes(&bench, &["edited.toml"]));
    let scripts = bench.output(&[&["cluster", "submit", "slurm", "--dry-run"], &changed[..]].concat());
    assert!(scripts.contains("tiny.shards/spec.toml --shard"), "{scripts}");
    bench.output(&[&["run"], &changed[..]].concat());
    let again = bench.metasense(&[&["run"], &changed[..]].concat());
    assert!(String::from_utf8_lossy(&again.stderr).contains("nothing left to do"), "{again:?}");
    let status = bench.metasense(&[&["status"], &changed[..], &[&hash[0][..6]]].concat());
    assert!(String::from_utf8_lossy(&status.stderr).contains(&format!("trial {}: done", hash[0])));
    let text = bench.output(&["query", "results/tiny.sqlite", "SELECT text FROM sweep", "--format", "json"]);
    assert!(text.contains("iterations = 3"), "{text}");
    let refused = bench.metasense(&["run", "tiny.toml", "optimise.iteratons=3"]);
    let said = String::from_utf8_lossy(&refused.stderr);
    let expected =
        "command line: optimise.iteratons = 3: unknown key; the nearest known one is \"optimise.iterations\"";
    assert!(refused.status.code() == Some(2) && said.contains(expected), "{said}");
}

/// A spec with a base has the trials of the complete spec, and is stored complete.
#[test]
fn a_spec_on_a_base_is_stored_whole() {
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    let (head, sweep) = TINY.split_once("[sweep]").unwrap();
    std::fs::create_dir(bench.path("bases")).unwrap();
    bench.file("bases/body.toml", head);
    bench.file("on.toml", &format!("base = \"bases/body.toml\"\nname = \"on\"\n[sweep]{sweep}"));
    assert_eq!(hashes(&bench, &["on.toml"]), hashes(&bench, &["tiny.toml"]));
    bench.output(&["run", "on.toml"]);
    let text = bench.output(&["query", "results/on.sqlite", "SELECT text FROM sweep", "--format", "json"]);
    let rows: serde_json::Value = serde_json::from_str(&text).unwrap();
    bench.file("stored.toml", rows[0]["text"].as_str().unwrap());
    std::fs::remove_dir_all(bench.path("bases")).unwrap();
    assert_eq!(hashes(&bench, &["stored.toml"]), hashes(&bench, &["tiny.toml"]));
    let refused = bench.metasense(&["run", "on.toml"]);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(
        refused.status.code() == Some(2)
            && said.contains("on.toml:1: base = \"bases/body.toml\": cannot be read")
    );
}
