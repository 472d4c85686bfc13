//! Tasks other than forces, estimated from the signals of finished trials' bodies.

use crate::common::{Bench, light};
use serde_json::Value;

/// Every task on both bodies of each trial with both readouts; the table pairs them.
#[test]
fn finished_bodies_are_read_for_other_tasks() {
    let bench = Bench::new();
    let spec = light().replace(
        "samples = 8\ntest = 2\nholdout = 2\n",
        "samples = 60\ntest = 12\nholdout = 40\nsilent = 0.3\n",
    );
    bench.file("s.toml", &spec);
    bench.output(&["run", "s.toml", "--db", "s.sqlite"]);
    let json = |args: &[&str]| -> Vec<Value> { serde_json::from_str(&bench.output(args)).unwrap() };
    let rows = json(&["body", "tasks", "s.sqlite", "--format", "json"]);
    let trials = bench.number("s.sqlite", "SELECT count(*) FROM trial") as usize;
    // six tasks with two readouts each, and the forces
    assert_eq!(rows.len(), trials * 2 * 13, "{rows:?}");
    let number = |row: &Value, name: &str| row[name].as_f64().unwrap_or_else(|| panic!("{row}"));
    for row in &rows {
        let (low, error, high) = (number(row, "low"), number(row, "error"), number(row, "high"));
        assert!(0.0 <= low && low <= error && error <= high && number(row, "samples") > 20.0, "{row}");
    }
    // well decoded forces are better than the trivial predictor
    let of = |task: &str| -> Vec<&Value> { rows.iter().filter(|row| row["task"] == task).collect() };
    assert!(of("forces").iter().all(|row| row["trained_for"] == "forces" && row["trivial"] == 100.0));
    for task in ["peak", "impulse"] {
        let decoded: Vec<&Value> = of(task).into_iter().filter(|row| row["readout"] == "decoded").collect();
        let told = decoded.iter().filter(|row| number(row, "error") < number(row, "trivial")).count();
        assert!(2 * told > decoded.len(), "{task}: {decoded:?}");
    }
    let table = bench.output(&["body", "tasks", "s.sqlite"]);
    assert!(table.contains("ratio_low") && table.lines().count() > 10, "{table}");
    let hash = rows[0]["hash"].as_str().unwrap();
    let one = json(&["body", "tasks", "s.sqlite", &hash[..8], "--format", "json"]);
    assert!(one.len() == 26 && one[..] == rows[..26], "{one:?}");

    // both panels are struck in every sample, so the count is constant
    bench.file("all.toml", &spec.replace("silent = 0.3\n", ""));
    bench.output(&["run", "all.toml", "--db", "all.sqlite"]);
    let output = bench.metasense(&["body", "tasks", "all.sqlite", "--format", "json"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("the same in all samples: count"), "{said}");
}

/// A sweep trains one body per task. The body trained for a task is a body of its own; the table has a transfer matrix. Keys without
/// effect do not change a trial's hash.
#[test]
fn a_sweep_trains_a_body_per_task() {
    let bench = Bench::new();
    let spec = light()
        .replace("samples = 8\ntest = 2\nholdout = 2\n", "samples = 60\ntest = 12\nholdout = 40\n")
        .replace("[brain]\niterations = 10\nwidth = 16\n", "[brain]\nkind = \"linear\"\n")
        .replace("iterations = 4\nbatch = 4", "iterations = 6\nbatch = 24")
        .replace("sensors = [1, 2]", "sensors = [1]\n\"brain.task\" = [\"forces\", \"impulse\", \"all\"]");
    bench.file("s.toml", &spec);
    bench.output(&["run", "s.toml", "--db", "s.sqlite"]);
    let tasks = "SELECT count(DISTINCT holdout_error_optimised) FROM v_trial WHERE state = 'done'";
    assert_eq!(bench.number("s.sqlite", tasks), 3);
    let improved = "SELECT count(*) FROM v_trial WHERE holdout_error_optimised < holdout_error_initial";
    assert!(bench.number("s.sqlite", improved) >= 2);
    let rows: Vec<Value> =
        serde_json::from_str(&bench.output(&["body", "tasks", "s.sqlite", "--format", "json"])).unwrap();
    let error = |trained_for: &str, body: &str| -> Vec<f64> {
        let own = rows.iter().filter(|row| row["trained_for"] == trained_for && row["body"] == body);
        own.map(|row| row["error"].as_f64().unwrap()).collect()
    };
    assert_eq!(error("forces", "initial"), error("impulse", "initial"), "one initial body");
    assert_ne!(error("forces", "optimised"), error("impulse", "optimised"));
    let table = bench.output(&["body", "tasks", "s.sqlite"]);
    let (_, matrix) = table.split_once("by the task of the training:\n").unwrap_or_else(|| panic!("{table}"));
    let head = matrix.lines().next().unwrap();
    assert!(["all", "forces", "impulse"].iter().all(|name| head.contains(name)), "{table}");

    let hashes = |name: &str, spec: &str| {
        bench.file(name, spec);
        let listed = bench.output(&["expand", name, "--format", "json"]);
        let listed: Vec<Value> = serde_json::from_str(&listed).unwrap();
        listed.iter().map(|row| row["hash"].to_string()).collect::<Vec<_>>()
    };
    let with_memory = spec.replace("kind = \"linear\"\n", "kind = \"linear\"\nmemory = [0.1, 0.0]\n");
    let (own, short) = (hashes("s.toml", &spec), hashes("t.toml", &with_memory));
    assert_eq!([0, 1, 2].map(|i| own[i] == short[i]), [false, true, true], "only forces use the memory");
}
