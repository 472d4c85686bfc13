//! Rows as Parquet (format 1.0, parquet-format/README.md): one row group, one page a column, values PLAIN and uncompressed,
//! every column optional. A column of whole numbers is INT64, of numbers DOUBLE, of anything else UTF-8 text. Its
//! metadata are Thrift's compact protocol.

use serde_json::Value;

use super::Table;

/// Physical types.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Int64 = 2,
    Double = 5,
    Text = 6,
}

/// A Parquet file of the rows.
#[must_use]
pub fn parquet(table: &Table) -> Vec<u8> {
    const MAGIC: &[u8] = b"PAR1";
    let rows = table.rows.len() as i64;
    let mut bytes = MAGIC.to_vec();
    let mut schema = vec![root(table.columns.len())];
    let mut chunks = Vec::new();
    for (i, name) in table.columns.iter().enumerate() {
        let kind = kind(table, i);
        let data = page(table, i, kind);
        let at = bytes.len() as i64;
        let mut header = Thrift::default();
        header.int32(1, 0).int32(2, data.len() as i32).int32(3, data.len() as i32);
        // PLAIN values; levels are run-length encoded.
        header.inside(5, |page| {
            page.int32(1, rows as i32).int32(2, 0).int32(3, 3).int32(4, 3);
        });
        bytes.extend(header.end());
        bytes.extend(&data);
        let size = bytes.len() as i64 - at;
        schema.push(column(name, kind));
        chunks.push(chunk(name, kind, rows, at, size));
    }
    let total = bytes.len() as i64 - MAGIC.len() as i64;
    let mut group = Thrift::default();
    group.structs(1, chunks).int64(2, total).int64(3, rows);
    let mut file = Thrift::default();
    file.int32(1, 1).structs(2, schema).int64(3, rows).structs(4, vec![group.end()]).text(6, "metasense");
    let footer = file.end();
    bytes.extend(&footer);
    bytes.extend((footer.len() as u32).to_le_bytes());
    bytes.extend(MAGIC);
    bytes
}

fn kind(table: &Table, column: usize) -> Kind {
    let values = || table.rows.iter().map(|r| &r[column]).filter(|v| !v.is_null());
    if values().all(Value::is_i64) {
        Kind::Int64
    } else if values().all(Value::is_number) {
        Kind::Double
    } else {
        Kind::Text
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
fn page(table: &Table, column: usize, kind: Kind) -> Vec<u8> {
    let mut levels = Thrift::default();
    let there: Vec<bool> = table.rows.iter().map(|r| !r[column].is_null()).collect();
    for run in there.chunk_by(|a, b| a == b) {
        levels.varint((run.len() as u64) << 1);
        levels.bytes.push(u8::from(run[0]));
    }
    let mut bytes = (levels.bytes.len() as u32).to_le_bytes().to_vec();
    bytes.extend(levels.bytes);
    for value in table.rows.iter().map(|r| &r[column]).filter(|v| !v.is_null()) {
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
