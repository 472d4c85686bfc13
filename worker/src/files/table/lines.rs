//! Lines of a CSV, and their fields.

use csv::{Reader, ReaderBuilder, StringRecord, Trim};
use metasense_schemas::spec::Separator;

use super::Form;

/// A separator that occurs in no text: the whole line is one field.
pub(super) const NONE: u8 = 0;

pub(super) fn byte(separator: Separator) -> u8 {
    match separator {
        Separator::Comma => b',',
        Separator::Semicolon => b';',
        Separator::Tab => b'\t',
    }
}

/// Hint after a field that is not a number: the separator in use.
pub(super) fn divided_by(separator: u8) -> &'static str {
    match separator {
        b',' => "; commas separate the fields",
        b';' => "; semicolons separate the fields",
        b'\t' => "; tabs separate the fields",
        _ => "; fields must be separated by commas, semicolons or tabs",
    }
}

/// Strips quotes after a blank, which `csv` keeps in the field.
pub(super) fn bare(field: &str) -> &str {
    field.trim_matches('"')
}

/// Iterates over the lines that are not blank.
pub(super) struct Rows<'a> {
    reader: Reader<&'a [u8]>,
    bytes: &'a [u8],
    /// Fields of the current line.
    fields: StringRecord,
}

impl<'a> Rows<'a> {
    pub fn new(text: &'a str, separator: u8) -> Self {
        let mut builder = ReaderBuilder::new();
        builder.has_headers(false).flexible(true).trim(Trim::All).delimiter(separator);
        let (bytes, fields) = (text.as_bytes(), StringRecord::new());
        Self { reader: builder.from_reader(bytes), bytes, fields }
    }

    /// Number, from 1, and fields of the next line.
    pub fn next(&mut self) -> Option<(usize, &StringRecord)> {
        while self.reader.read_record(&mut self.fields).expect("memory holds UTF-8") {
            if self.fields.len() > 1 || !self.fields[0].is_empty() {
                let at = self.fields.position().expect("it has been read");
                // `csv` counts lines before it skips blank lines and the second half of "\r\n".
                let skipped =
                    self.bytes[at.byte() as usize..].iter().take_while(|byte| b"\r\n".contains(byte));
                let line = at.line() as usize + skipped.filter(|byte| **byte == b'\n').count();
                return Some((line, &self.fields));
            }
        }
        None
    }
}

/// A line with a different number of fields than the first.
pub(super) struct Uneven {
    line: usize,
    found: usize,
    first: usize,
    pub wanted: usize,
    ends_empty: bool,
}

impl Uneven {
    pub fn message(&self, separator: u8, form: &Form) -> String {
        let Self { line, found, first, wanted, .. } = self;
        let hint = match separator {
            _ if *wanted == 1 => {
                "; a table must start with its column names: remove the lines before them".into()
            }
            _ if self.ends_empty && *found == wanted + 1 => "; the line ends in a separator".into(),
            _ => String::new(),
        };
        let settle = match form.separator.is_none() && (separator != b',' || found > wanted) {
            true => {
                format!("; if the separator is another one, {}", form.settle("separator, or decimal = \",\""))
            }
            false => String::new(),
        };
        format!(
            "line {line}: {found} fields where line {first} has {wanted}{}{hint}{settle}",
            divided_by(separator)
        )
    }
}

/// Number of fields, if equal in all lines.
pub(super) fn width(text: &str, separator: u8) -> Result<usize, Uneven> {
    let mut rows = Rows::new(text, separator);
    let Some((first, fields)) = rows.next() else { return Ok(0) };
    let wanted = fields.len();
    while let Some((line, fields)) = rows.next() {
        if fields.len() != wanted {
            let ends_empty = fields.iter().next_back().is_some_and(str::is_empty);
            return Err(Uneven { line, found: fields.len(), first, wanted, ends_empty });
        }
    }
    Ok(wanted)
}
