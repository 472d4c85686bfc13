//! Writes rows as a readable table, CSV, JSON or Parquet.

use std::io::{self, BufWriter, IsTerminal, Write};

use clap::ValueEnum;
use serde_json::Value;

use super::fit::{screen, text};
use super::parquet::{Parquet, parquet};
use super::table::Table;
use crate::cell::{self, plain};

/// Output format of rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Format {
    /// Readable table; numbers are rounded to four digits.
    #[default]
    Table,
    /// A header line, then one line per row; full precision; `inf` and `-inf`; NULL is empty.
    Csv,
    /// A list of objects with keys in column order; full precision; ±∞ as `9e999` and `-9e999`.
    Json,
    /// A Parquet file; full precision.
    Parquet,
}

impl Format {
    /// Refuses columns of one name in the formats that allow only one.
    ///
    /// # Errors
    /// A message with the name.
    pub fn check(self, columns: &[String]) -> Result<(), String> {
        let what = match self {
            Self::Table | Self::Csv => return Ok(()),
            Self::Json => "a JSON object",
            Self::Parquet => "a Parquet file",
        };
        match columns.iter().enumerate().find(|(i, name)| columns[..*i].contains(name)) {
            None => Ok(()),
            Some((_, name)) => Err(format!(
                "two columns are named {name}, but {what} can contain only one: rename them with AS"
            )),
        }
    }
}

/// Prints rows to standard output.
///
/// # Errors
/// If standard output is closed, full, or, for Parquet, a terminal.
pub fn print_rows(table: &Table, format: Format) -> io::Result<()> {
    table.write(format, standard_output(format)?, screen())
}

/// Standard output for rows.
///
/// # Errors
/// If it is a terminal and the format is Parquet.
pub fn standard_output(format: Format) -> io::Result<io::Stdout> {
    let out = io::stdout();
    if format == Format::Parquet && out.is_terminal() {
        return Err(io::Error::other("Parquet cannot be written to a terminal: redirect it to a file"));
    }
    Ok(out)
}

impl Table {
    fn write(&self, format: Format, out: impl Write + Send, screen: Option<usize>) -> io::Result<()> {
        if format == Format::Parquet {
            return parquet(self, &[], out);
        }
        let mut rows = RowWriter::new(out, format, &self.columns, screen)?;
        self.rows.iter().try_for_each(|row| rows.row(row.clone()))?;
        rows.end()
    }

    /// The rows as bytes of a file.
    pub fn written(&self, format: Format) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.write(format, &mut bytes, None).expect("memory takes all");
        bytes
    }

    /// The rows as a Parquet file; for `types` see [`RowWriter::typed`].
    pub fn parquet(&self, types: &[String]) -> Vec<u8> {
        let mut bytes = Vec::new();
        parquet(self, types, &mut bytes).expect("memory takes all");
        bytes
    }

    /// The rows as CSV, see [`PictureData`].
    pub fn csv(&self) -> String {
        let mut data = PictureData::new(&self.columns);
        self.rows.iter().for_each(|row| data.row(row));
        data.text()
    }
}

/// Rows as CSV with seven significant digits, as data of pictures: a tenth of a table's memory.
pub struct PictureData(csv::Writer<Vec<u8>>);

impl PictureData {
    /// A header with these columns.
    pub fn new(columns: &[String]) -> Self {
        let mut csv = csv::Writer::from_writer(Vec::new());
        csv.write_record(columns).expect("memory takes all");
        Self(csv)
    }

    /// Adds a row.
    pub fn row(&mut self, row: &[Value]) {
        let shortened = |value: &Value| match value.as_f64().filter(|_| value.is_f64()) {
            Some(x) => plain(&format!("{x:.6e}").parse::<f64>().map_or(Value::Null, Value::from)),
            None => plain(value),
        };
        self.0.write_record(row.iter().map(shortened)).expect("memory takes all");
    }

    /// The CSV text.
    pub fn text(self) -> String {
        let bytes = self.0.into_inner().expect("memory takes all");
        String::from_utf8(bytes).expect("texts are UTF-8")
    }
}

/// Writes rows one by one. Readable tables stay in memory until the end, because column widths depend on all rows; Parquet rows go
/// to disk, because column types do.
pub struct RowWriter<W: Write + Send>(Form<W>);

enum Form<W: Write + Send> {
    Kept(W, Table, Option<usize>),
    Parquet(Box<Parquet<W>>),
    Csv(Box<csv::Writer<W>>),
    Json(BufWriter<W>, Vec<String>, bool),
}

impl<W: Write + Send> RowWriter<W> {
    /// A writer of these columns. `screen`: greatest line width of a readable table, in characters.
    pub fn new(out: W, format: Format, columns: &[String], screen: Option<usize>) -> io::Result<Self> {
        Ok(Self(match format {
            Format::Table => Form::Kept(out, Table { columns: columns.to_vec(), ..Table::default() }, screen),
            Format::Parquet => Form::Parquet(Box::new(Parquet::new(out, columns)?)),
            Format::Csv => {
                let mut csv = csv::Writer::from_writer(out);
                csv.write_record(columns).map_err(io_error)?;
                Form::Csv(Box::new(csv))
            }
            Format::Json => {
                let mut out = BufWriter::new(out);
                write!(out, "[")?;
                Form::Json(out, columns.to_vec(), true)
            }
        }))
    }

    /// Sets the declared SQL types of the columns (empty: not declared). Parquet uses them for columns without values.
    pub fn typed(mut self, types: Vec<String>) -> Self {
        if let Form::Parquet(rows) = &mut self.0 {
            rows.types = types;
        }
        self
    }

    /// Adds a row.
    pub fn row(&mut self, row: Vec<Value>) -> io::Result<()> {
        match &mut self.0 {
            Form::Kept(_, table, _) => {
                table.rows.push(row);
                Ok(())
            }
            Form::Parquet(rows) => rows.row(&row),
            Form::Csv(csv) => csv.write_record(row.iter().map(plain)).map_err(io_error),
            Form::Json(out, columns, first) => {
                let comma = if std::mem::take(first) { "" } else { "," };
                let pair = |(name, value): (&String, &Value)| {
                    format!("{}:{}", Value::from(name.as_str()), cell::json(value))
                };
                let pairs: Vec<String> = columns.iter().zip(&row).map(pair).collect();
                write!(out, "{comma}\n  {{{}}}", pairs.join(","))
            }
        }
    }

    /// Finishes the output.
    pub fn end(self) -> io::Result<()> {
        match self.0 {
            Form::Kept(mut out, table, screen) => writeln!(out, "{}", text(&table, screen)),
            Form::Parquet(rows) => rows.end(),
            Form::Csv(mut csv) => csv.flush(),
            Form::Json(mut out, ..) => {
                writeln!(out, "\n]")?;
                out.flush()
            }
        }
    }
}

fn io_error(e: csv::Error) -> io::Error {
    match e.into_kind() {
        csv::ErrorKind::Io(e) => e,
        other => io::Error::other(format!("{other:?}")),
    }
}

#[cfg(test)]
mod tests;
