//! Bodies trained under one kind of forces and evaluated under others.

use crate::common::{Bench, TINY};
use serde_json::Value;

fn json(text: &str) -> Vec<Value> {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

/// Three bodies, trained under pulses, blows and both, each evaluated under either; `analyse` and the report use the same rows.
#[test]
fn bodies_are_read_under_forces_that_did_not_train_them() {
    let bench = Bench::new();
    let kinds = "[sweep]\npoints = [\n{ \"stimuli.kind\" = \"bell\" },\n{ \"stimuli.kind\" = \"irregular\" },\n\
        { \"stimuli.kind\" = \"mix\", \"stimuli.mix\" = [{ weight = 0.5, kind = \"bell\" }, { weight = 0.5, kind = \"irregular\" }] },\n]\n";
    let under = "kind = \"linear\"\n[[evaluation.under]]\nkind = \"bell\"\n[[evaluation.under]]\nkind = \"irregular\"\n";
    let spec = TINY
        .replace("width = [0.05, 0.1]\nonset = [0.0, 0.1]\n", "")
        .replace("iterations = 10\nwidth = 16\n", under)
        .replace("sensors = [1, 2]", "sensors = [1]")
        .replace("[sweep]\n", kinds);
    bench.file("s.toml", &spec);
    bench.output(&["run", "s.toml", "--workers", "1"]);
    let db = "results/tiny.sqlite";
    let rows = json(&bench.output(&[
        "query",
        db,
        "SELECT hash, trained_under, body, stimuli, reader, error, outcome FROM v_under",
        "--format",
        "json",
    ]));
    assert_eq!(rows.len(), 3 * 2 * 2 * 2, "{rows:?}");
    let error = |row: &Value| row["error"].as_f64().unwrap_or_else(|| panic!("{row}"));
    let of = |trained: &str, body: &str, stimuli: &str, reader: &str| -> f64 {
        let asked = [("trained_under", trained), ("body", body), ("stimuli", stimuli), ("reader", reader)];
        let found: Vec<&Value> =
            rows.iter().filter(|row| asked.iter().all(|(key, value)| row[key] == *value)).collect();
        assert!(found.len() == 1 && found[0]["outcome"] == "ok", "{asked:?}: {found:?}");
        error(found[0])
    };
    // equal bodies get the same forces; the carried decoder is that of the comparison
    assert_eq!(of("bell", "initial", "irregular", "own"), of("mix", "initial", "irregular", "own"));
    let holdout = json(&bench.output(&[
        "query",
        db,
        "SELECT t.spec->>'$.stimuli.kind' AS kind, v.holdout_error_optimised AS error FROM trial t JOIN v_trial v USING (hash)",
        "--format",
        "json",
    ]));
    for row in holdout.iter().filter(|row| row["kind"] != "mix") {
        let kind = row["kind"].as_str().unwrap();
        assert!((of(kind, "optimised", kind, "carried") / error(row) - 1.0).abs() < 1e-9, "{kind}");
    }
    let analysed = json(&bench.output(&["analyse", db, "--question", "transfer", "--format", "json"]));
    assert_eq!(analysed.len(), 4 * 2, "{analysed:?}");
    for row in &analysed {
        let (name, under) = (row["body"].as_str().unwrap(), row["under"].as_str().unwrap());
        let (trained, body) = if name == "initial" { ("mix", "initial") } else { (name, "optimised") };
        let found = row["own"].as_f64().unwrap();
        assert!((found / of(trained, body, under, "own") - 1.0).abs() < 1e-9, "{row}");
        assert_eq!(row["carried"].is_null(), name == "initial", "{row}");
        if name == under {
            // null if a few steps gained nothing
            assert!(row["kept"].as_f64().is_none_or(|kept| (kept - 1.0).abs() < 1e-9), "{row}");
        }
    }
    bench.output(&["report", db, "--out", "r.html"]);
    let page = std::fs::read_to_string(bench.path("r.html")).unwrap();
    assert!(page.contains("How well does a body work under forces that it was not trained for?"));
}
