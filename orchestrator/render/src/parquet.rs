//! Writes rows as Parquet, plain and uncompressed, with optional columns. Integers become INT64, other numbers DOUBLE, everything
//! else UTF-8 text. A column without values has its declared type, or Arrow's null type if none is declared: files of one query on
//! several databases can be read together.

use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, Seek, Write};
use std::sync::Arc;

use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int32Type, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;
use serde_json::Value;

use super::table::Table;
use crate::cell::{self, plain};

/// Rows per group, which writers and many readers hold in memory.
const GROUP: usize = 1 << 16;

/// Column types; each can represent all values of the previous ones.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    Null,
    Int64,
    Double,
    Text,
}

impl Kind {
    fn of(value: &Value) -> Self {
        match value {
            Value::Null => Self::Null,
            Value::Number(n) if n.is_i64() => Self::Int64,
            value if cell::number(value).is_some() => Self::Double,
            _ => Self::Text,
        }
    }

    /// The type of a column with declared SQL type `sql` and widest value `self`.
    fn declared(self, sql: &str) -> Self {
        match sql {
            "INT" | "INTEGER" => self.max(Self::Int64),
            "REAL" => self.max(Self::Double),
            // an expression, whose values may be integers
            "NUM" if self == Self::Null => Self::Double,
            "TEXT" | "BLOB" => Self::Text,
            _ => self,
        }
    }

    fn column(self, name: &str) -> Result<Arc<Type>, ParquetError> {
        let (physical, logical) = match self {
            Self::Null => (Physical::INT32, Some(LogicalType::Unknown)),
            Self::Int64 => (Physical::INT64, None),
            Self::Double => (Physical::DOUBLE, None),
            Self::Text => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
        };
        let column = Type::primitive_type_builder(name, physical).with_repetition(Repetition::OPTIONAL);
        Ok(Arc::new(column.with_logical_type(logical).build()?))
    }
}

/// Widens the types to those of a row.
fn widen(kinds: &mut [Kind], row: &[Value]) {
    for (kind, value) in kinds.iter_mut().zip(row) {
        *kind = (*kind).max(Kind::of(value));
    }
}

/// Writes the table as a Parquet file; for `types` see [`super::RowWriter::typed`].
pub fn parquet(table: &Table, types: &[String], out: impl Write + Send) -> io::Result<()> {
    let mut kinds = vec![Kind::Null; table.columns.len()];
    table.rows.iter().for_each(|row| widen(&mut kinds, row));
    write(out, &table.columns, kinds, types, table.rows.chunks(GROUP).map(Ok)).map_err(output_error)
}

/// Writes rows one by one. Column types are known only after the last row, so rows first go to an unnamed temporary file.
pub struct Parquet<W> {
    out: W,
    columns: Vec<String>,
    /// Declared types, see [`super::RowWriter::typed`].
    pub types: Vec<String>,
    kinds: Vec<Kind>,
    rows: BufWriter<File>,
}

impl<W: Write + Send> Parquet<W> {
    /// A writer of these columns.
    pub fn new(out: W, columns: &[String]) -> io::Result<Self> {
        let rows = BufWriter::new(tempfile::tempfile()?);
        let kinds = vec![Kind::Null; columns.len()];
        Ok(Self { out, columns: columns.to_vec(), types: Vec::new(), kinds, rows })
    }

    /// Adds a row.
    pub fn row(&mut self, row: &[Value]) -> io::Result<()> {
        widen(&mut self.kinds, row);
        serde_json::to_writer(&mut self.rows, row)?;
        self.rows.write_all(b"\n")
    }

    /// Writes the Parquet file.
    pub fn end(self) -> io::Result<()> {
        let mut file = self.rows.into_inner()?;
        file.rewind()?;
        let mut lines = BufReader::new(file).lines();
        let groups = std::iter::from_fn(|| {
            let read = |line: io::Result<String>| Ok(serde_json::from_str(&line?)?);
            let rows: io::Result<Vec<Vec<Value>>> = lines.by_ref().take(GROUP).map(read).collect();
            rows.map(|rows| (!rows.is_empty()).then_some(rows)).transpose()
        });
        write(self.out, &self.columns, self.kinds, &self.types, groups).map_err(output_error)
    }
}

/// Widens the types to the declared ones, and writes the groups of rows of an iterator.
fn write<R: AsRef<[Vec<Value>]>>(
    out: impl Write + Send,
    columns: &[String],
    mut kinds: Vec<Kind>,
    types: &[String],
    groups: impl Iterator<Item = io::Result<R>>,
) -> Result<(), ParquetError> {
    for (kind, sql) in kinds.iter_mut().zip(types) {
        *kind = kind.declared(sql);
    }
    let fields = columns.iter().zip(&kinds).map(|(name, kind)| kind.column(name));
    let schema = Type::group_type_builder("rows").with_fields(fields.collect::<Result<_, _>>()?).build()?;
    let properties = WriterProperties::builder().set_created_by("metasense".into());
    let properties = properties.set_dictionary_enabled(false).set_statistics_enabled(EnabledStatistics::None);
    let mut file = SerializedFileWriter::new(out, Arc::new(schema), Arc::new(properties.build()))?;
    for rows in groups {
        let rows = rows?;
        let rows = rows.as_ref();
        let mut group = file.next_row_group()?;
        for (i, kind) in kinds.iter().enumerate() {
            let mut column = group.next_column()?.expect("a column a kind");
            let levels: Vec<i16> = rows.iter().map(|row| i16::from(!row[i].is_null())).collect();
            let there = rows.iter().map(|row| &row[i]).filter(|value| !value.is_null());
            let levels = Some(levels.as_slice());
            match kind {
                Kind::Null => column.typed::<Int32Type>().write_batch(&[], levels, None)?,
                Kind::Int64 => {
                    let values: Vec<i64> = there.filter_map(Value::as_i64).collect();
                    column.typed::<Int64Type>().write_batch(&values, levels, None)?
                }
                Kind::Double => {
                    let values: Vec<f64> = there.filter_map(cell::number).collect();
                    column.typed::<DoubleType>().write_batch(&values, levels, None)?
                }
                Kind::Text => {
                    let values: Vec<ByteArray> = there.map(|v| plain(v).into_bytes().into()).collect();
                    column.typed::<ByteArrayType>().write_batch(&values, levels, None)?
                }
            };
            column.close()?;
        }
        group.close()?;
    }
    file.close()?;
    Ok(())
}

/// Unwraps the I/O error in a Parquet error, so that callers recognise a closed pipe.
fn output_error(error: ParquetError) -> io::Error {
    match error {
        ParquetError::External(source) => source.downcast().map_or_else(io::Error::other, |e| *e),
        error => io::Error::other(error),
    }
}
