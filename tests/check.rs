//! `check`: correct records give no finding; each mistake is found, with the key that corrects it.

use serde_json::Value;

use crate::common::Bench;
use crate::identify;

/// Exit code, and place, finding and remedy of each finding that is not ok.
fn look(bench: &Bench, records: &str, more: &[&str]) -> (Option<i32>, Vec<[String; 3]>) {
    let call = ["lab", "check", "s.toml", "--records", records, "--format", "json"];
    let done = bench.metasense(&[&call[..], more].concat());
    let rows: Vec<Value> = serde_json::from_slice(&done.stdout)
        .unwrap_or_else(|e| panic!("{e}: {}", String::from_utf8_lossy(&done.stderr)));
    let text = |row: &Value, key: &str| row[key].as_str().unwrap_or_default().to_owned();
    let wrong = rows.iter().filter(|row| row["outcome"] != "ok");
    (done.status.code(), wrong.map(|row| ["place", "found", "remedy"].map(|key| text(row, key))).collect())
}

/// Accelerations that a chip samples too slowly are not compared; the rotation rate, which has fewer high frequencies, is.
#[test]
fn aliased_channels_are_not_compared() {
    let bench = identify::bench();
    let (code, rows) = look(&bench, "r.toml", &[]);
    let [[place, ..], [_, unknown, _]] = &rows[..] else { panic!("{rows:?}") };
    assert!(unknown.contains("too few entries before the blows: the signals"), "{rows:?}");
    assert!(
        code == Some(0) && place.contains("a_x") && place.contains("a_y") && !place.contains('ω'),
        "{rows:?}"
    );
}

#[test]
fn what_is_wrong_is_named_with_its_remedy() {
    let bench = identify::bench();
    // records of another material; orchestrator/python/tests/test_check.py has records of a virtual laboratory
    let finer = "[stimuli]\nforce_samples = 400";
    bench.file("s.toml", &identify::SPEC.replace("samples = 40", "samples = 80").replace("[stimuli]", finer));
    std::fs::copy(bench.path("c/signals.npy"), bench.path("y.npy")).unwrap();
    bench.file(
        "r.toml",
        "[recorded]\nfiles = [\"h.npy\"]\nrate = 2000.0\n[signals]\nfiles = [\"y.npy\"]\nrate = 400.0\nstart = 0.0025\n",
    );
    assert_eq!(look(&bench, "r.toml", &["--out-dir", "look"]), (Some(0), Vec::new()));
    for (file, start) in [
        ("index.html", "<!DOCTYPE html>"),
        ("followed.csv", "record,channel"),
        ("response-1.svg", "<svg"),
        ("findings.csv", "check,outcome"),
        ("records.csv", "record,file"),
    ] {
        let text = std::fs::read_to_string(bench.path(&format!("look/{file}"))).unwrap();
        assert!(text.starts_with(start), "{file}: {}", &text[..40]);
    }
    let table = bench.output(&["lab", "check", "s.toml", "--records", "r.toml"]);
    assert!(table.contains("| design_frequency") && table.contains("mean correlation"), "{table}");

    let text = std::fs::read_to_string(bench.path("r.toml")).unwrap();
    let (shape, values) = bench.array("y.npy");
    let written = |change: &dyn Fn(&mut [f64])| {
        let mut changed = values.clone();
        changed.chunks_mut(3).for_each(change);
        bench.write_array("z.npy", &shape, &changed);
    };
    let other = text.replace("y.npy", "z.npy");
    let wrong = |says: &[&str], text: &str| {
        bench.file("wrong.toml", text);
        let (code, rows) = look(&bench, "wrong.toml", &[]);
        assert!(
            code == Some(1) && rows.iter().any(|row| says.iter().all(|s| row.concat().contains(s))),
            "{says:?}: {rows:?}"
        );
    };
    written(&|of| of[1] = 7.0);
    wrong(&["a_y of sensor 0", "constant value", "sensors.channels"], &other);
    wrong(&["signals.acceleration_unit = \"mm/s2\""], &format!("{text}acceleration_unit = \"g\"\n"));
    wrong(&["recorded.force_unit = \"N\""], &text.replace("[recorded]", "[recorded]\nforce_unit = \"mN\""));
    let (shape, mut forces) = bench.array("h.npy");
    bench.write_array("offset.npy", &shape, &forces.iter().map(|f| f + 0.1).collect::<Vec<f64>>());
    wrong(&["force 0", "N before the blows", "remove_offset = true"], &text.replace("h.npy", "offset.npy"));
    // the message names an unreadable record, and the others are checked
    forces[7] = f64::NAN;
    bench.write_array("h.npy", &shape, &forces);
    wrong(&["record 0", "must be a finite number"], &text);
}
