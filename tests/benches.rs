//! Every bench with tiny settings: all its figures are positive numbers.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

/// The output of a bench: one list of rows, or one row per line.
fn rows(folder: &Path, arguments: &str) -> Vec<Value> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_metasense-bench"));
    let output = command.args(arguments.split(' ')).current_dir(folder).output().unwrap();
    assert!(output.status.success(), "{arguments}: {output:?}");
    let text = String::from_utf8(output.stdout).unwrap();
    match serde_json::from_str(&text) {
        Ok(Value::Array(rows)) => rows,
        _ => text.lines().map(|line| serde_json::from_str(line).unwrap()).collect(),
    }
}

/// Numbers in these columns of a row.
fn numbers<'a>(row: &'a Value, names: &'a str) -> impl Iterator<Item = f64> + 'a {
    names.split(' ').map(move |name| row[name].as_f64().unwrap_or_else(|| panic!("{name}: {row}")))
}

fn positive(rows: &[Value], names: &str) {
    for row in rows {
        assert!(numbers(row, names).all(|x| x > 0.0), "{names}: {row}");
    }
}

#[test]
fn kernels_are_measured() {
    let folder = tempfile::tempdir().unwrap();
    let small = "--samples 4 --instants 40 --panels 2 --format json";
    let brain = rows(folder.path(), &format!("brain --sensors 1 --repeat 1 {small}"));
    assert!(brain.len() >= 5 && (brain.len() - 2).is_multiple_of(3), "{brain:?}");
    positive(&brain, "forward_ms iteration_ms hessian_ms gflop peak_gflops share_of_peak");

    let kept = std::fs::read_to_string(folder.path().join("results/bench.jsonl")).unwrap();
    assert_eq!(kept.lines().count(), brain.len());
}

/// The race, and the diagram of a tenth of a second with its picture. Every method occurs; short steps have small errors, and
/// longer steps cost less.
#[test]
fn integrators_are_measured() {
    let folder = tempfile::tempdir().unwrap();
    let race = rows(folder.path(), "dynamics --race --quick --samples 2 --repeat 1 --format json");
    assert!(race.len() >= 6 && race.len().is_multiple_of(2), "{race:?}");
    positive(&race, "forward_s forward_cpu_s gradient_s gradient_cpu_s kernel_cycles dual_kernel_cycles");

    let points = rows(folder.path(), "dynamics --scenes reference --quick --samples 2 --format json");
    positive(&points, "force_evaluations forward_ms gradient_ms");
    for method in ["tsit5", "leapfrog", "nystrom4", "nystrom6"] {
        let of = |p: &&Value| p["method"] == method && p["auto"] == false;
        let of: Vec<Vec<f64>> = (points.iter().filter(of))
            .map(|p| numbers(p, "force_evaluations signals_error gradient_error").collect())
            .collect();
        assert!(of.len() >= 4, "{method}: {of:?}");
        let (first, last) = (&of[0], &of[of.len() - 1]);
        assert!(first[0] < last[0] && first[1] > last[1] && first[2] > last[2], "{method}: {of:?}");
    }
    let last = points.iter().rfind(|p| p["method"] == "tsit5").unwrap();
    assert!(numbers(last, "signals_error").all(|e| e < 1e-5), "the truth against another method: {last}");
    let picture = std::fs::read_to_string(folder.path().join("results/work-precision.svg")).unwrap();
    assert!(picture.contains("reference scene"), "{picture}");
}

#[test]
fn the_engine_is_measured() {
    let folder = tempfile::tempdir().unwrap();
    let engine = rows(folder.path(), "engine --trials 20 --array 1000");
    positive(&engine, "trials_per_second array_bytes_per_second orchestrator_resident_mib");
}
