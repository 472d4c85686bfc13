//! Memory and nonlinearity of finished trials' bodies.

use crate::common::{Bench, light};
use serde_json::Value;

/// Seven measures of both bodies of each trial; the table has their means. Repetition gives the same rows.
#[test]
fn finished_bodies_have_memory_and_nonlinearity() {
    let bench = Bench::new();
    bench.file("s.toml", &light());
    let refused = bench.metasense(&["body", "capacity", "s.sqlite"]);
    assert!(!refused.status.success());
    bench.output(&["run", "s.toml", "--db", "s.sqlite"]);
    let json = |args: &[&str]| -> Vec<Value> { serde_json::from_str(&bench.output(args)).unwrap() };
    let rows = json(&["body", "capacity", "s.sqlite", "--format", "json"]);
    let trials = bench.number("s.sqlite", "SELECT count(*) FROM trial") as usize;
    assert_eq!(rows.len(), trials * 2 * 7, "{rows:?}");
    let number = |row: &Value, name: &str| row[name].as_f64().unwrap_or_else(|| panic!("{row}"));
    for row in &rows {
        let value = number(row, "value");
        assert!(value >= 0.0 && number(row, "hold") > 0.0, "{row}");
        let is_error = row["measure"].as_str().unwrap().starts_with("narma");
        assert!(is_error || value <= number(row, "bound") && number(row, "bound") % 3.0 == 0.0, "{row}");
    }
    // more sensors have more state variables, and the same drive is read better
    let of = |sensors: u64, measure: &str| {
        let own = |row: &&Value| row["sensors"] == sensors && row["measure"] == measure;
        rows.iter().find(own).map(|row| number(row, "value")).unwrap()
    };
    assert!(of(2, "memory") > of(1, "memory") && of(2, "narma-10") < of(1, "narma-10"), "{rows:?}");
    let hash = rows[0]["hash"].as_str().unwrap();
    let one = json(&["body", "capacity", "s.sqlite", &hash[..8], "--format", "json"]);
    assert_eq!(one[..], rows[..14]);
    let table = bench.output(&["body", "capacity", "s.sqlite"]);
    assert!(table.contains("change_low") && table.contains("narma-10"), "{table}");
}
