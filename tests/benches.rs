//! Every bench with tiny settings: all its figures are positive numbers.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

const SPEC: &str = r#"name = "s"
[body]
columns = 4
rows = 3
spacing = 15.0
ligament_length = 2.25
density = 1e-8
stiffness = { stretch = 3.0, shear = 0.5, bend = 1.0 }
[time]
duration = 0.1
samples = 20
[stimuli]
kind = "bell"
samples = 6
test = 2
holdout = 2
onset = [0.0, 0.02]
[brain]
iterations = 3
[optimise]
protocol = "joint"
iterations = 3
batch = 4
[sweep]
panels = [2]
sensors = [1]
"#;

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
fn protocols_are_measured() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("s.toml"), SPEC).unwrap();
    let found = rows(folder.path(), "protocols s.toml --protocols joint --seconds 0,1000 --format json");
    let steps: Vec<f64> = found.iter().flat_map(|row| numbers(row, "step fresh_samples")).collect();
    assert_eq!(steps, [0.0, 0.0, 1.0, 4.0, 3.0, 12.0], "{found:?}");
    positive(&found, "holdout_error_percent");
    let picture = std::fs::read_to_string(folder.path().join("results/protocols.svg")).unwrap();
    assert!(picture.contains("joint"), "{picture}");
}

/// The engine's rows, without arrays in the database.
#[test]
fn the_engine_is_measured() {
    let folder = tempfile::tempdir().unwrap();
    let engine = rows(folder.path(), "engine --trials 20 --array 1000 --drop-arrays");
    positive(&engine, "trials_per_second array_bytes_per_second orchestrator_resident_mib");
}
