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
    assert_eq!(rows.len(), trials * 2 * 5 * 2, "{rows:?}");
    let number = |row: &Value, name: &str| row[name].as_f64().unwrap_or_else(|| panic!("{row}"));
    for row in &rows {
        let (low, error, high) = (number(row, "low"), number(row, "error"), number(row, "high"));
        assert!(0.0 <= low && low <= error && error <= high && number(row, "samples") > 20.0, "{row}");
    }
    // well decoded forces are better than the trivial predictor
    let of = |task: &str| -> Vec<&Value> { rows.iter().filter(|row| row["task"] == task).collect() };
    for task in ["peak", "impulse"] {
        let decoded: Vec<&Value> = of(task).into_iter().filter(|row| row["readout"] == "decoded").collect();
        let told = decoded.iter().filter(|row| number(row, "error") < number(row, "trivial")).count();
        assert!(2 * told > decoded.len(), "{task}: {decoded:?}");
    }
    let table = bench.output(&["body", "tasks", "s.sqlite"]);
    assert!(table.contains("ratio_low") && table.lines().count() > 10, "{table}");
    let hash = rows[0]["hash"].as_str().unwrap();
    let one = json(&["body", "tasks", "s.sqlite", &hash[..8], "--format", "json"]);
    assert!(one.len() == 20 && one[..] == rows[..20], "{one:?}");

    // both panels are struck in every sample, so the count is constant
    bench.file("all.toml", &spec.replace("silent = 0.3\n", ""));
    bench.output(&["run", "all.toml", "--db", "all.sqlite"]);
    let output = bench.metasense(&["body", "tasks", "all.sqlite", "--format", "json"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("the same in all samples: count"), "{said}");
}
