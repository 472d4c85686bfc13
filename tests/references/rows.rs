//! The committed rows, and their numbers as text. Each number is rounded once, here.

use std::collections::{BTreeMap, BTreeSet};

use metasense::analysis::numbers::{deviation, geometric_mean, mean};
use metasense_worker::student;
use serde_json::Value;

use super::root;

pub(super) type Row = BTreeMap<String, String>;

pub(super) fn rows(file: &str) -> Vec<Row> {
    let path = root().join("results/committed").join(file);
    let mut reader = csv::Reader::from_path(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let names = reader.headers().unwrap().clone();
    let pair = |row: csv::StringRecord| {
        names.iter().zip(row.iter()).map(|(name, cell)| (name.to_owned(), cell.to_owned())).collect()
    };
    reader.records().map(|row| pair(row.unwrap())).collect()
}

/// Rows with these cells.
pub(super) fn of<'a>(rows: &'a [Row], wanted: &'a [(&str, &str)]) -> impl Iterator<Item = &'a Row> {
    rows.iter().filter(|row| wanted.iter().all(|(name, cell)| row[*name] == *cell))
}

/// Distinct seeds in the order of their digits.
pub(super) fn seeds(rows: &[Row]) -> BTreeSet<&str> {
    rows.iter().map(|row| row["seed"].as_str()).collect()
}

/// The only row with these cells.
pub(super) fn only_row<'a>(rows: &'a [Row], wanted: &[(&str, &str)]) -> &'a Row {
    let mut found = rows.iter().filter(|row| wanted.iter().all(|(name, cell)| row[*name] == *cell));
    let row = found.next().unwrap_or_else(|| panic!("no row has {wanted:?}"));
    // Two equal rows are possible: a trial's own decoder may be among those of every body.
    assert!(found.all(|other| other == row), "rows that have {wanted:?} differ");
    row
}

/// Two significant digits, three after a leading 1.
pub(super) fn short(text: &str) -> String {
    let x: f64 = text.parse().unwrap_or_else(|_| panic!("{text:?} is no number"));
    let digits = |count: i32| {
        let magnitude = x.abs().log10().floor() as i32;
        format!("{x:.*}", (count - 1 - magnitude).max(0) as usize)
    };
    let two = digits(2);
    if two.trim_start_matches(['0', '.', '-']).starts_with('1') { digits(3) } else { two }
}

pub(super) fn percent(row: &Row, name: &str) -> String {
    format!("{} %", short(&row[name]))
}

/// Initial → trained.
pub(super) fn change(row: &Row) -> String {
    format!("{} → {} %", short(&row["initial"]), short(&row["optimised"]))
}

/// A ratio, with its interval if there is one.
pub(super) fn ratio(row: &Row, value: &str, low: &str, high: &str) -> String {
    match row[value].as_str() {
        "" => "–".into(),
        value if row[low].is_empty() => short(value),
        value => format!("{} ({} … {})", short(value), short(&row[low]), short(&row[high])),
    }
}

pub(super) fn brain(name: &str) -> &'static str {
    match name {
        "cnn" => "the paper's network",
        "long" => "long network",
        "linear" => "linear decoder",
        "stacked" => "stacked network",
        "stacked, long" => "stacked long network",
        other => panic!("no words for the brain {other:?}"),
    }
}

/// Median and 90th percentile over casts.
pub(super) fn spread(row: &Row) -> String {
    format!("{} [{}] %", short(&row["median"]), short(&row["percentile_90"]))
}

pub(super) fn number(row: &Row, name: &str) -> f64 {
    row[name].parse().unwrap_or_else(|_| panic!("{:?} is no number", row[name]))
}

/// The mean, and the limits of Student's 95 % interval.
pub(super) fn interval(values: &[f64]) -> [f64; 3] {
    let half = student(values.len() - 1) * deviation(values).unwrap() / (values.len() as f64).sqrt();
    [0.0, -half, half].map(|by| mean(values).unwrap() + by)
}

/// The same as text.
pub(super) fn with_interval(values: &[f64], shown: fn(f64) -> f64) -> String {
    in_words(interval(values), shown)
}

/// A value and its limits as text.
pub(super) fn in_words(values: [f64; 3], shown: fn(f64) -> f64) -> String {
    let [at, low, high] = values.map(|x| short(&shown(x).to_string()));
    format!("{at} ({low} … {high})")
}

/// The mean as text.
pub(super) fn rounded_mean(values: &[f64]) -> String {
    short(&mean(values).expect("there are rows").to_string())
}

/// The geometric mean.
pub(super) fn geometric(values: impl Iterator<Item = f64>) -> String {
    short(&geometric_mean(&values.collect::<Vec<_>>()).to_string())
}

/// Rows written by a bench, one JSON object per line.
pub(super) fn lines(file: &str) -> Vec<Value> {
    let text = super::read(&format!("results/committed/{file}"));
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}
