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

/// Of three groups; a column becomes one of texts in the last of them.
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

#[test]
fn a_table_rounds_to_four_digits() {
    assert!(printed(Format::Table).contains("12.35"), "{}", printed(Format::Table));
}
