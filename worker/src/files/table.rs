//! Tables of numbers: CSV files as instruments and spreadsheets write them.
//!
//! Separator, decimal mark and header may be left to the reader. It takes those that alone give numbers in the columns that are
//! read; where several do, and the numbers differ, the file is refused.

use csv::{ReaderBuilder, StringRecord, Trim};
use metasense_schemas::spec::{Decimal, MeasuredSignals, Recorded, Separator, Signal};

use super::{Array, text};

/// What is known of a file before it is read, and what is read of it.
#[derive(Debug, Clone, Default)]
pub struct Form<'a> {
    /// Whether its first line names its columns.
    pub header: Option<bool>,
    /// What separates its fields.
    pub separator: Option<Separator>,
    /// Its decimal mark.
    pub decimal: Option<Decimal>,
    /// The columns or arrays that are read; none: all columns. What else the file holds may be anything.
    pub read: Option<Vec<&'a Signal>>,
    /// The table of keys that has the three above, for instance `recorded`; none where they cannot be given.
    pub keys: Option<&'static str>,
}

impl<'a> Form<'a> {
    /// That of the files of forces, `keys` their table.
    #[must_use]
    pub fn of_forces(recorded: &Recorded, keys: &'static str, read: Option<Vec<&'a Signal>>) -> Self {
        let Recorded { header, separator, decimal, .. } = *recorded;
        Self { header, separator, decimal, read, keys: Some(keys) }
    }

    /// That of files of signals alone.
    #[must_use]
    pub fn of_signals(signals: &MeasuredSignals, read: Option<Vec<&'a Signal>>) -> Self {
        let MeasuredSignals { header, separator, decimal, .. } = *signals;
        Self { header, separator, decimal, read, keys: Some("signals") }
    }

    /// The end of a message: which key settles the doubt.
    fn settle(&self, choices: &str) -> String {
        match self.keys {
            Some(keys) => format!("set {keys}.{choices}"),
            None => "write a line of names, commas between fields and decimal points".into(),
        }
    }

    /// Whether the first line of a table names its columns.
    fn names(&self, first: &[String], line: usize) -> Result<bool, String> {
        let is_number = |field: &String| number(field, self.decimal).is_some();
        let known = |signal: &&&Signal| match signal {
            Signal::Name(name) => !is_number(name) && first.contains(name),
            Signal::Number(_) => false,
        };
        let words = || first.iter().any(|field| !field.is_empty()) && !first.iter().any(is_number);
        match self.header {
            Some(header) => Ok(header),
            None if self.read.iter().flatten().any(|signal| known(&signal)) || words() => Ok(true),
            None => Err(format!(
                "line {line}: {:?} may be names of columns or numbers: {}",
                first.iter().find(|field| is_number(field)).map_or("", String::as_str),
                self.settle("header = true, or to false and name columns by number")
            )),
        }
    }
}

/// Columns of equal length.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Names of the columns; none where they have numbers alone.
    names: Vec<String>,
    /// Their values; nothing of a column that nobody reads.
    columns: Vec<Vec<f64>>,
    /// The line of each row; none of an array.
    lines: Vec<usize>,
}

/// A separator that no text has: a whole line is one field.
const NONE: u8 = 0;

impl Table {
    /// Reads a CSV.
    ///
    /// # Errors
    /// Names the line, the column, and what is wrong; or the key that must be given.
    pub fn parse(bytes: &[u8], form: &Form) -> Result<Self, String> {
        let text = text(bytes)?;
        let all = [Separator::Comma, Separator::Semicolon, Separator::Tab];
        let occurs = |separator: &Separator| match form.separator {
            Some(given) => *separator == given,
            None if *separator == Separator::Comma && form.decimal == Some(Decimal::Comma) => false,
            None => text.as_bytes().contains(&byte(*separator)),
        };
        let mut candidates: Vec<u8> = all.into_iter().filter(occurs).map(byte).collect();
        if candidates.is_empty() {
            candidates.push(NONE);
        }
        let widths: Vec<_> =
            candidates.iter().map(|separator| (*separator, width(text, *separator))).collect();
        let alone = widths.len() == 1;
        let even: Vec<(u8, usize)> = (widths.iter())
            .filter_map(|(separator, width)| Some((*separator, *width.as_ref().ok()?)))
            .filter(|(_, width)| alone || *width > 1)
            .collect();
        let read = |&(separator, width): &(u8, usize)| Self::divided(text, separator, width, form);
        match &even[..] {
            [] => {
                let uneven = widths.into_iter().filter_map(|(s, width)| Some((s, width.err()?)));
                match uneven.max_by_key(|(_, uneven)| uneven.wanted) {
                    None => read(&(NONE, 1)),
                    // one column; its name may have a semicolon
                    Some((separator, uneven)) if separator != b',' && form.separator.is_none() => {
                        read(&(NONE, 1)).map_err(|_| uneven.said(separator, form))
                    }
                    Some((separator, uneven)) => Err(uneven.said(separator, form)),
                }
            }
            [one] => {
                let table = read(one)?;
                table.no_decimal_commas(text, one, form)?;
                Ok(table)
            }
            several => {
                let mut read: Vec<_> = several.iter().map(read).collect();
                let good = read.iter().flatten().next();
                if read.iter().flatten().any(|table| Some(&table.columns) != good.map(|good| &good.columns)) {
                    let settle = form.settle("separator");
                    return Err(format!("may be divided in more than one way: {settle}"));
                }
                let at = read.iter().position(Result::is_ok).unwrap_or(0);
                read.swap_remove(at)
            }
        }
    }

    /// The signals of an array of two dimensions, which lie along its shorter side, or of one.
    ///
    /// # Errors
    /// If it has other dimensions, or no shorter side.
    pub fn of_array(Array { shape, values }: &Array) -> Result<Self, String> {
        let [rows, columns] = match shape[..] {
            [entries] => [1, entries],
            [rows, columns] if rows != columns || rows == 1 => [rows, columns],
            [_, _] => {
                return Err(format!(
                    "is of shape {shape:?}: signals lie along the shorter side, and there is none"
                ));
            }
            _ => return Err(format!("is of shape {shape:?}; must have 1 to 3 dimensions")),
        };
        let columns = match rows < columns {
            true => values.chunks_exact(columns).map(<[f64]>::to_vec).collect(),
            false => (0..columns).map(|c| values[c..].iter().step_by(columns).copied().collect()).collect(),
        };
        Ok(Self { names: Vec::new(), columns, lines: Vec::new() })
    }

    /// How many columns there are.
    #[must_use]
    pub fn width(&self) -> usize {
        self.columns.len()
    }

    /// The number of a column.
    ///
    /// # Errors
    /// If there is none, or several are called so.
    pub fn column(&self, signal: &Signal) -> Result<usize, String> {
        let name = match signal {
            Signal::Number(number) if *number < self.width() => return Ok(*number),
            Signal::Number(number) => {
                return Err(format!("has no column {number}, but 0 to {}", self.width() - 1));
            }
            Signal::Name(name) => name,
        };
        let mut of_name = (0..self.names.len()).filter(|c| self.names[*c] == *name);
        match (of_name.next(), of_name.next()) {
            (Some(column), None) => Ok(column),
            (Some(_), Some(_)) => {
                Err(format!("has two columns that are called {name:?}: read one by its number"))
            }
            _ if self.names.is_empty() => {
                Err(format!("has no signal {name:?}: its columns have no names, but numbers from 0"))
            }
            _ => {
                let divided = if self.width() == 1 { divided_by(NONE) } else { "" };
                Err(format!("has no signal {name:?}, but {}{divided}", self.names.join(", ")))
            }
        }
    }

    /// The values of a column that is read.
    #[must_use]
    pub fn values(&self, column: usize) -> &[f64] {
        &self.columns[column]
    }

    /// Where a row stands.
    #[must_use]
    pub fn place(&self, row: usize) -> String {
        self.lines.get(row).map_or(format!("entry {row}"), |line| format!("line {line}"))
    }

    /// What a column is called in messages.
    #[must_use]
    pub fn label(&self, column: usize) -> String {
        self.names.get(column).cloned().unwrap_or(format!("column {column}"))
    }

    /// The table of a text whose lines all have `width` fields.
    fn divided(text: &str, separator: u8, width: usize, form: &Form) -> Result<Self, String> {
        let mut rows = rows(text, separator).peekable();
        let Some((first_line, first)) = rows.peek() else { return Err("is empty".into()) };
        let (first_line, first) =
            (*first_line, first.iter().map(bare).map(str::to_owned).collect::<Vec<_>>());
        let mut table = Self { names: Vec::new(), columns: vec![Vec::new(); width], lines: Vec::new() };
        if form.names(&first, first_line)? {
            table.names = first;
            rows.next();
        }
        let mut read: Vec<usize> = match &form.read {
            None => (0..width).collect(),
            Some(signals) => signals.iter().map(|signal| table.column(signal)).collect::<Result<_, _>>()?,
        };
        read.sort_unstable();
        read.dedup();
        let mut marks = Marks::default();
        for (line, fields) in rows {
            for &column in &read {
                let field = bare(&fields[column]);
                let at = || format!("line {line}: {}", table.label(column));
                let Some((value, mark)) = number(field, form.decimal) else {
                    return Err(match field {
                        _ if fields.iter().map(bare).eq(&table.names) => {
                            format!(
                                "line {line}: repeats the names of line {first_line}: a file holds one table"
                            )
                        }
                        "" => format!("{} is empty", at()),
                        _ => format!("{} = {field:?} is no number{}", at(), divided_by(separator)),
                    });
                };
                if !value.is_finite() {
                    return Err(format!("{} = {field:?}: must be a finite number", at()));
                }
                marks.see(mark, field, line);
                table.columns[column].push(value);
            }
            table.lines.push(line);
        }
        if table.lines.is_empty() {
            return Err(format!("holds no line of numbers after line {first_line}"));
        }
        marks.check(separator, form).map(|()| table)
    }

    /// Refuses two columns of whole numbers of which one is read: they may be one column with decimal commas.
    fn no_decimal_commas(
        &self,
        text: &str,
        &(separator, width): &(u8, usize),
        form: &Form,
    ) -> Result<(), String> {
        let read = self.columns.iter().filter(|values| !values.is_empty()).count();
        if separator != b','
            || width != 2
            || read == 2
            || form.decimal.or(form.separator.map(|_| Decimal::Point)).is_some()
        {
            return Ok(());
        }
        let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
        let one = |line: &&str| {
            line.split_once(',')
                .is_some_and(|(whole, part)| digits(whole.trim_start_matches(['+', '-'])) && digits(part))
        };
        let lines = || {
            let all = text.split(['\r', '\n']).map(str::trim).filter(|line| !line.is_empty());
            all.skip(usize::from(!self.names.is_empty()))
        };
        match lines().find(one).filter(|_| lines().all(|line| one(&line))) {
            None => Ok(()),
            Some(line) => Err(format!(
                "{}: {line:?} may be one number with a decimal comma or two numbers: {}",
                self.place(0),
                form.settle("decimal = \",\" or separator = \",\"")
            )),
        }
    }
}

fn byte(separator: Separator) -> u8 {
    match separator {
        Separator::Comma => b',',
        Separator::Semicolon => b';',
        Separator::Tab => b'\t',
    }
}

/// What follows a field that is no number: how the line was divided.
fn divided_by(separator: u8) -> &'static str {
    match separator {
        b',' => "; commas separate the fields",
        b';' => "; semicolons separate the fields",
        b'\t' => "; tabs separate the fields",
        _ => "; fields must be separated by commas, semicolons or tabs",
    }
}

/// The lines that are not blank: their numbers, from 1, and their fields.
fn rows(text: &str, separator: u8) -> impl Iterator<Item = (usize, StringRecord)> {
    let bytes = text.as_bytes();
    let (mut line, mut seen) = (1, 0);
    let blank = |row: &StringRecord| row.len() == 1 && row[0].is_empty();
    let mut reader = ReaderBuilder::new();
    reader.has_headers(false).flexible(true).trim(Trim::All).delimiter(separator);
    let rows = reader.from_reader(bytes).into_records().map(|row| row.expect("memory holds UTF-8"));
    rows.map(move |row| {
        // `csv` says where it was before it skipped blank lines and the second half of "\r\n"
        let from = row.position().map_or(0, |position| position.byte() as usize);
        let begins = from + bytes[from..].iter().take_while(|byte| b"\r\n".contains(byte)).count();
        let ends =
            |at: &usize| bytes[*at] == b'\n' || bytes[*at] == b'\r' && bytes.get(at + 1) != Some(&b'\n');
        line += (seen..begins).filter(ends).count();
        seen = begins;
        (line, row)
    })
    .filter(move |(_, row)| !blank(row))
}

/// A field without the quotes behind a blank, which are none to `csv`.
fn bare(field: &str) -> &str {
    field.trim_matches('"')
}

/// A line with other than as many fields as the first.
struct Uneven {
    line: usize,
    found: usize,
    first: usize,
    wanted: usize,
    ends_empty: bool,
}

impl Uneven {
    fn said(&self, separator: u8, form: &Form) -> String {
        let Self { line, found, first, wanted, .. } = self;
        let hint = match separator {
            _ if *wanted == 1 => "; a table begins with its names: leave out what stands before them".into(),
            _ if self.ends_empty && *found == wanted + 1 => "; the line ends in a separator".into(),
            _ => String::new(),
        };
        let settle = match separator == b',' && form.separator.is_none() {
            true => {
                format!("; where a comma is no separator, {}", form.settle("separator, or decimal = \",\""))
            }
            false => String::new(),
        };
        format!(
            "line {line}: {found} fields where line {first} has {wanted}{}{hint}{settle}",
            divided_by(separator)
        )
    }
}

/// How many fields all lines have.
fn width(text: &str, separator: u8) -> Result<usize, Uneven> {
    let mut rows = rows(text, separator);
    let Some((first, fields)) = rows.next() else { return Ok(0) };
    let wanted = fields.len();
    match rows.find(|(_, fields)| fields.len() != wanted) {
        None => Ok(wanted),
        Some((line, fields)) => {
            let ends_empty = fields.iter().next_back().is_some_and(str::is_empty);
            Err(Uneven { line, found: fields.len(), first, wanted, ends_empty })
        }
    }
}

/// A number and the mark that it was written with, if any.
fn number(field: &str, decimal: Option<Decimal>) -> Option<(f64, Option<Decimal>)> {
    let comma = match (field.contains('.'), field.contains(',')) {
        (true, true) => return None,
        (point, comma) => {
            let mark = if point { Some(Decimal::Point) } else { comma.then_some(Decimal::Comma) };
            if mark.is_some() && decimal.is_some() && mark != decimal {
                return None;
            }
            mark
        }
    };
    let value = match comma {
        Some(Decimal::Comma) => field.replacen(',', ".", 1).parse(),
        _ => field.parse(),
    };
    Some((value.ok()?, comma))
}

/// The decimal marks that a table has.
#[derive(Debug, Default)]
struct Marks {
    /// For each mark a number that has it, with its line.
    seen: [Option<(usize, String)>; 2],
    /// Whether one of them cannot be a whole number with a mark between thousands.
    certain: [bool; 2],
}

impl Marks {
    fn see(&mut self, mark: Option<Decimal>, field: &str, line: usize) {
        let Some(mark) = mark.map(|mark| mark as usize) else { return };
        if self.seen[mark].is_none() {
            self.seen[mark] = Some((line, field.to_owned()));
        }
        self.certain[mark] = self.certain[mark] || !may_be_thousands(field);
    }

    /// Refuses two marks in one table, and one that may stand between thousands.
    fn check(&self, separator: u8, form: &Form) -> Result<(), String> {
        if form.decimal.is_some() {
            return Ok(());
        }
        if let [Some((line, number)), Some((other, comma))] = &self.seen {
            let settle = form.settle("decimal");
            return Err(format!(
                "line {line}: {number:?} has a decimal point, line {other}: {comma:?} a comma: {settle}"
            ));
        }
        // beside commas that separate fields a point has always been a decimal mark
        let known = separator == b',' && self.seen[1].is_none();
        let doubtful =
            self.seen.iter().zip(self.certain).find_map(|(seen, certain)| seen.as_ref().filter(|_| !certain));
        if let Some((line, number)) = doubtful.filter(|_| !known) {
            return Err(format!(
                "line {line}: {number:?} may have a decimal mark or a mark between thousands, as all its like: {}",
                form.settle("decimal = \".\" or \",\"")
            ));
        }
        Ok(())
    }
}

/// Whether a number with one mark reads as a whole number with a mark between thousands, too.
fn may_be_thousands(field: &str) -> bool {
    let field = field.trim_start_matches(['+', '-']);
    let digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    field.split_once(['.', ',']).is_some_and(|(whole, part)| {
        (1..=3).contains(&whole.len())
            && !whole.starts_with('0')
            && part.len() == 3
            && digits(whole)
            && digits(part)
    })
}
