//! Tests of `write`.

use super::super::row;
use super::*;
use serde_json::json;

fn printed(format: Format) -> String {
    let table = Table::new("hash error", [row!["a,b", 12.345678], row!["c", Value::Null]]);
    String::from_utf8(table.written(format)).unwrap()
}

#[test]
fn csv_quotes_and_leaves_null_empty() {
    assert_eq!(printed(Format::Csv), "hash,error\n\"a,b\",12.345678\nc,\n");
}

#[test]
fn json_is_a_list_of_objects() {
    let value: Value = serde_json::from_str(&printed(Format::Json)).unwrap();
    assert_eq!(value, json!([{"hash": "a,b", "error": 12.345678}, {"hash": "c", "error": null}]));
}

/// Three row groups; a column becomes text in the last one.
#[test]
fn rows_as_they_come_give_the_bytes_of_a_table() {
    let row =
        |i: usize| row![i, 0.5 * i as f64, if i < 150_000 { json!(i) } else { json!("much") }, Value::Null];
    let table = Table::new("i half either none", (0..150_001).map(row));
    let mut rows = Vec::new();
    let mut writer = RowWriter::new(&mut rows, Format::Parquet, &table.columns, None).unwrap();
    table.rows.iter().for_each(|row| writer.row(row.clone()).unwrap());
    writer.end().unwrap();
    assert!(rows == table.written(Format::Parquet) && rows.len() > 150_000 * 24);
}

/// ±∞, numbers of extreme size, and the order of columns.
#[test]
fn what_is_printed_reads_back() {
    let numbers = [f64::INFINITY, f64::NEG_INFINITY, 1e300, -5e-324, 0.1 + 0.2, -0.0];
    let table = Table::new("z a", numbers.map(|x| vec![cell::real(x), cell::real(f64::NAN)]));
    let text = |format| String::from_utf8(table.written(format)).unwrap();
    let csv = text(Format::Csv);
    let read =
        csv.lines().skip(1).map(|line| line.strip_suffix(',').unwrap().parse::<f64>().unwrap().to_bits());
    assert_eq!(read.collect::<Vec<_>>(), numbers.map(f64::to_bits), "{csv}");
    assert!(csv.starts_with("z,a\ninf,\n-inf,\n1e+300,\n"), "{csv}");
    let json = text(Format::Json);
    assert!(json.starts_with("[\n  {\"z\":9e999,\"a\":null},\n  {\"z\":-9e999,\"a\":null},"), "{json}");
    assert!(text(Format::Table).contains("-inf |"), "{}", text(Format::Table));
}

#[test]
fn a_table_rounds_to_four_digits() {
    assert!(printed(Format::Table).contains("12.35"), "{}", printed(Format::Table));
}
