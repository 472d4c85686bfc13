//! Rows as Parquet (format 1.0, parquet-format/README.md): row groups of one page a column, values PLAIN and uncompressed, every
//! column optional. A column of whole numbers is INT64, of numbers DOUBLE, of anything else UTF-8 text. Its
//! metadata are Thrift's compact protocol.

use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, Seek, Write};

use serde_json::Value;

use super::Table;

/// Rows of a group, which is what a writer, and many a reader, holds at once.
const GROUP: usize = 1 << 16;
const MAGIC: &[u8] = b"PAR1";

/// Physical types, each of which can say what those before can.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    Int64 = 2,
    Double = 5,
    Text = 6,
}

impl Kind {
    fn of(value: &Value) -> Option<Self> {
        match value {
            Value::Null => None,
            Value::Number(n) if n.is_i64() => Some(Self::Int64),
            Value::Number(_) => Some(Self::Double),
            _ => Some(Self::Text),
        }
    }
}

/// Makes kinds those that can say a row, too.
fn widen(kinds: &mut [Option<Kind>], row: &[Value]) {
    for (kind, value) in kinds.iter_mut().zip(row) {
        *kind = (*kind).max(Kind::of(value));
    }
}

/// Writes the rows as a Parquet file.
///
/// # Errors
/// Where `out` takes nothing.
pub fn parquet(table: &Table, out: impl Write) -> io::Result<()> {
    let mut kinds = vec![None; table.columns.len()];
    table.rows.iter().for_each(|row| widen(&mut kinds, row));
    let mut groups = Groups::new(out, &table.columns, &kinds)?;
    table.rows.chunks(GROUP).try_for_each(|rows| groups.group(rows))?;
    groups.end()
}

/// The same of rows as they come. What a column holds is known after the last one: until then they wait in a file that nobody
/// else sees.
pub struct Parquet<W> {
    out: W,
    columns: Vec<String>,
    kinds: Vec<Option<Kind>>,
    rows: BufWriter<File>,
}

impl<W: Write> Parquet<W> {
    /// Of these columns.
    ///
    /// # Errors
    /// Where there is no room for files that go when they are closed.
    pub fn new(out: W, columns: &[String]) -> io::Result<Self> {
        let rows = BufWriter::new(tempfile::tempfile()?);
        Ok(Self { out, columns: columns.to_vec(), kinds: vec![None; columns.len()], rows })
    }

    /// Adds a row.
    ///
    /// # Errors
    /// Where no more fits into that file.
    pub fn row(&mut self, row: &[Value]) -> io::Result<()> {
        widen(&mut self.kinds, row);
        serde_json::to_writer(&mut self.rows, row)?;
        self.rows.write_all(b"\n")
    }

    /// After the last row.
    ///
    /// # Errors
    /// Where `out` takes no more.
    pub fn end(self) -> io::Result<()> {
        let mut file = self.rows.into_inner()?;
        file.rewind()?;
        let mut lines = BufReader::new(file).lines();
        let mut groups = Groups::new(self.out, &self.columns, &self.kinds)?;
        loop {
            let read = |line: io::Result<String>| Ok(serde_json::from_str(&line?)?);
            let rows: Vec<Vec<Value>> = lines.by_ref().take(GROUP).map(read).collect::<io::Result<_>>()?;
            if rows.is_empty() {
                return groups.end();
            }
            groups.group(&rows)?;
        }
    }
}

/// A file in the making, group by group.
struct Groups<'a, W: Write> {
    out: BufWriter<W>,
    at: i64,
    columns: Vec<(&'a str, Kind)>,
    groups: Vec<Vec<u8>>,
    rows: i64,
}

impl<'a, W: Write> Groups<'a, W> {
    fn new(out: W, columns: &'a [String], kinds: &[Option<Kind>]) -> io::Result<Self> {
        let mut out = BufWriter::new(out);
        out.write_all(MAGIC)?;
        // of a column without a value any will do
        let kinds = kinds.iter().map(|kind| kind.unwrap_or(Kind::Int64));
        let columns = columns.iter().map(String::as_str).zip(kinds).collect();
        Ok(Self { out, at: MAGIC.len() as i64, columns, groups: Vec::new(), rows: 0 })
    }

    fn group(&mut self, rows: &[Vec<Value>]) -> io::Result<()> {
        let (begin, count) = (self.at, rows.len() as i64);
        let mut chunks = Vec::new();
        for (i, &(name, kind)) in self.columns.iter().enumerate() {
            let data = page(rows, i, kind);
            let mut header = Thrift::default();
            header.int32(1, 0).int32(2, data.len() as i32).int32(3, data.len() as i32);
            // PLAIN values; levels are run-length encoded.
            header.inside(5, |page| {
                page.int32(1, count as i32).int32(2, 0).int32(3, 3).int32(4, 3);
            });
            let header = header.end();
            self.out.write_all(&header)?;
            self.out.write_all(&data)?;
            let size = (header.len() + data.len()) as i64;
            chunks.push(chunk(name, kind, count, self.at, size));
            self.at += size;
        }
        let mut group = Thrift::default();
        group.structs(1, chunks).int64(2, self.at - begin).int64(3, count);
        self.groups.push(group.end());
        self.rows += count;
        Ok(())
    }

    fn end(mut self) -> io::Result<()> {
        let mut schema = vec![root(self.columns.len())];
        schema.extend(self.columns.iter().map(|&(name, kind)| column(name, kind)));
        let mut file = Thrift::default();
        file.int32(1, 1).structs(2, schema).int64(3, self.rows).structs(4, self.groups).text(6, "metasense");
        let footer = file.end();
        self.out.write_all(&footer)?;
        self.out.write_all(&(footer.len() as u32).to_le_bytes())?;
        self.out.write_all(MAGIC)?;
        self.out.flush()
    }
}

fn root(columns: usize) -> Vec<u8> {
    let mut element = Thrift::default();
    element.text(4, "rows").int32(5, columns as i32);
    element.end()
}

fn column(name: &str, kind: Kind) -> Vec<u8> {
    let mut element = Thrift::default();
    element.int32(1, kind as i32).int32(3, 1).text(4, name);
    if kind == Kind::Text {
        element.int32(6, 0);
    }
    element.end()
}

fn chunk(name: &str, kind: Kind, rows: i64, at: i64, size: i64) -> Vec<u8> {
    let mut chunk = Thrift::default();
    chunk.int64(2, at).inside(3, |meta| {
        meta.int32(1, kind as i32);
        meta.header(2, 9).bytes.extend([0x25, 0, 6]);
        meta.header(3, 9).bytes.push(0x18);
        meta.raw_text(name);
        meta.int32(4, 0).int64(5, rows).int64(6, size).int64(7, size).int64(9, at);
    });
    chunk.end()
}

/// Which values are there, in runs; then those that are.
fn page(rows: &[Vec<Value>], column: usize, kind: Kind) -> Vec<u8> {
    let mut levels = Thrift::default();
    let there: Vec<bool> = rows.iter().map(|r| !r[column].is_null()).collect();
    for run in there.chunk_by(|a, b| a == b) {
        levels.varint((run.len() as u64) << 1);
        levels.bytes.push(u8::from(run[0]));
    }
    let mut bytes = (levels.bytes.len() as u32).to_le_bytes().to_vec();
    bytes.extend(levels.bytes);
    for value in rows.iter().map(|r| &r[column]).filter(|v| !v.is_null()) {
        match kind {
            Kind::Int64 => bytes.extend(value.as_i64().unwrap_or_default().to_le_bytes()),
            Kind::Double => bytes.extend(value.as_f64().unwrap_or(f64::NAN).to_le_bytes()),
            Kind::Text => {
                let text = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
                bytes.extend((text.len() as u32).to_le_bytes());
                bytes.extend(text.bytes());
            }
        }
    }
    bytes
}

/// A struct of Thrift's compact protocol in the making.
#[derive(Default)]
struct Thrift {
    bytes: Vec<u8>,
    last: u8,
}

impl Thrift {
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.bytes.push(value as u8);
    }

    fn header(&mut self, field: u8, kind: u8) -> &mut Self {
        self.bytes.push((field - self.last) << 4 | kind);
        self.last = field;
        self
    }

    fn zigzag(&mut self, value: i64) -> &mut Self {
        self.varint((value << 1 ^ value >> 63) as u64);
        self
    }

    fn int32(&mut self, field: u8, value: i32) -> &mut Self {
        self.header(field, 5).zigzag(value.into())
    }

    fn int64(&mut self, field: u8, value: i64) -> &mut Self {
        self.header(field, 6).zigzag(value)
    }

    fn raw_text(&mut self, text: &str) -> &mut Self {
        self.varint(text.len() as u64);
        self.bytes.extend(text.bytes());
        self
    }

    fn text(&mut self, field: u8, text: &str) -> &mut Self {
        self.header(field, 8).raw_text(text)
    }

    fn structs(&mut self, field: u8, structs: Vec<Vec<u8>>) -> &mut Self {
        self.header(field, 9);
        match structs.len() {
            n if n < 15 => self.bytes.push((n as u8) << 4 | 12),
            n => {
                self.bytes.push(0xfc);
                self.varint(n as u64);
            }
        }
        self.bytes.extend(structs.into_iter().flatten());
        self
    }

    fn inside(&mut self, field: u8, fill: impl FnOnce(&mut Self)) -> &mut Self {
        let mut inner = Self::default();
        fill(&mut inner);
        self.header(field, 12).bytes.extend(inner.end());
        self
    }

    fn end(mut self) -> Vec<u8> {
        self.bytes.push(0);
        self.bytes
    }
}
