//! Rows as a table to read, as CSV, JSON or Parquet.

use std::io::{self, IsTerminal, Write};

use clap::ValueEnum;
use comfy_table::{CellAlignment, ContentArrangement, Table as Grid, presets};
use serde_json::{Map, Value};

use crate::export::table::parquet;
use crate::store::Table;

/// The form in which rows are printed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Format {
    /// Columns to read; numbers are rounded to four digits.
    #[default]
    Table,
    /// A header line, then one line a row; numbers in full.
    Csv,
    /// A list of objects; numbers in full.
    Json,
    /// A Parquet file; numbers in full.
    Parquet,
}

/// Prints rows to standard output.
///
/// # Errors
/// Where standard output is closed or full, or a terminal that Parquet's bytes would upset.
pub fn print_rows(table: &Table, format: Format) -> io::Result<()> {
    let out = io::stdout().lock();
    if format == Format::Parquet && out.is_terminal() {
        return Err(io::Error::other("Parquet is not for a terminal: send it to a file"));
    }
    write_rows(table, format, out)
}

/// Writes rows.
///
/// # Errors
/// Where `out` takes no more.
pub fn write_rows(table: &Table, format: Format, mut out: impl Write) -> io::Result<()> {
    match format {
        Format::Table => writeln!(out, "{}", grid(table)),
        Format::Csv => {
            let mut csv = csv::Writer::from_writer(out);
            csv.write_record(&table.columns).map_err(io_error)?;
            for row in &table.rows {
                csv.write_record(row.iter().map(plain)).map_err(io_error)?;
            }
            csv.flush()
        }
        Format::Json => {
            writeln!(out, "[")?;
            for (i, row) in table.rows.iter().enumerate() {
                let object: Map<String, Value> =
                    table.columns.iter().cloned().zip(row.iter().cloned()).collect();
                let comma = if i + 1 < table.rows.len() { "," } else { "" };
                writeln!(out, "  {}{comma}", Value::Object(object))?;
            }
            writeln!(out, "]")
        }
        Format::Parquet => out.write_all(&parquet(table)),
    }
}

fn io_error(e: csv::Error) -> io::Error {
    match e.into_kind() {
        csv::ErrorKind::Io(e) => e,
        other => io::Error::other(format!("{other:?}")),
    }
}

fn grid(table: &Table) -> Grid {
    let mut grid = Grid::new();
    grid.load_style(presets::ASCII_MARKDOWN).set_content_arrangement(ContentArrangement::Dynamic);
    grid.set_header(&table.columns);
    for row in &table.rows {
        grid.add_row(row.iter().map(rounded));
    }
    for (i, column) in grid.column_iter_mut().enumerate() {
        if table.rows.iter().all(|row| row[i].is_number() || row[i].is_null()) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    grid
}

fn plain(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

/// Floats to four significant digits, the rest as it is.
fn rounded(value: &Value) -> String {
    match value.as_f64().filter(|_| value.is_f64()) {
        None => plain(value),
        Some(0.0) => "0".into(),
        Some(x) if (1e-3..1e6).contains(&x.abs()) => {
            let decimals = (3 - x.abs().log10().floor() as i32).max(0) as usize;
            format!("{x:.decimals$}")
        }
        Some(x) => format!("{x:.3e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn printed(format: Format) -> String {
        let table = Table {
            columns: vec!["hash".into(), "error".into()],
            rows: vec![vec![json!("a,b"), json!(12.345678)], vec![json!("c"), Value::Null]],
        };
        let mut out = Vec::new();
        write_rows(&table, format, &mut out).unwrap();
        String::from_utf8(out).unwrap()
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

    #[test]
    fn a_table_rounds_to_four_digits() {
        assert!(printed(Format::Table).contains("12.35"), "{}", printed(Format::Table));
        assert_eq!(rounded(&json!(0.012345)), "0.01235");
        assert_eq!(rounded(&json!(1e-8)), "1.000e-8");
    }
}
