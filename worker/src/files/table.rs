//! Tables of numbers: CSV files as instruments and spreadsheets write them.
//!
//! [`Form`] can leave separator, decimal mark and header open. The parser then uses the only choice that gives numbers in the
//! columns that it reads. If several choices give different numbers, it rejects the file.

use metasense_schemas::spec::{Decimal, Recorded, Separator, Signal};

use super::{Array, text};

mod lines;
mod numbers;

use lines::{NONE, Rows, bare, byte, divided_by, width};
use numbers::{MISSING, Marks, may_be_number, number};

/// What is known of a file in advance, and which parts of it are read.
#[derive(Debug, Clone, Default)]
pub struct Form<'a> {
    /// Whether the first line names the columns.
    pub header: Option<bool>,
    /// Field separator.
    pub separator: Option<Separator>,
    /// Decimal mark.
    pub decimal: Option<Decimal>,
    /// Columns or arrays to read; `None`: all columns. Other contents are ignored.
    pub read: Option<Vec<&'a Signal>>,
    /// Table of the spec with the three keys above, such as `recorded`; `None` if they cannot be set.
    pub keys: Option<&'static str>,
}

impl<'a> Form<'a> {
    /// Form of files of forces; `keys` is their table.
    pub fn of_forces(recorded: &Recorded, keys: &'static str, read: Option<Vec<&'a Signal>>) -> Self {
        let Recorded { header, separator, decimal, .. } = *recorded;
        Self { header, separator, decimal, read, keys: Some(keys) }
    }

    /// End of an error message: the key that resolves the ambiguity.
    fn settle(&self, choices: &str) -> String {
        match self.keys {
            Some(keys) => format!("set {keys}.{choices}"),
            None => "write column names in the first line, separate fields by commas, and use decimal points"
                .into(),
        }
    }

    /// Whether the first line of a table names its columns.
    fn names(&self, first: &[String], line: usize) -> Result<bool, String> {
        let known = |signal: &&&Signal| match signal {
            Signal::Name(name) => !may_be_number(name) && first.contains(name),
            Signal::Number(_) => false,
        };
        let is_missing = |field: &String| MISSING.contains(&field.to_lowercase().as_str());
        let words = || !first.iter().all(is_missing) && !first.iter().any(|field| may_be_number(field));
        match self.header {
            Some(header) => Ok(header),
            None if self.read.iter().flatten().any(|signal| known(&signal)) || words() => Ok(true),
            None => Err(format!(
                "line {line}: {:?} may be a column name or a value: {}",
                first.iter().find(|field| may_be_number(field)).map_or("", String::as_str),
                self.settle("header = true, or = false to read columns by number")
            )),
        }
    }
}

/// Columns of equal length.
#[derive(Debug, Clone, PartialEq)]
pub struct ColumnTable {
    /// Column names; empty if columns have only numbers.
    names: Vec<String>,
    /// Column values; empty for columns that are not read.
    columns: Vec<Vec<f64>>,
    /// Line number of each row; empty for an array.
    lines: Vec<usize>,
}

impl ColumnTable {
    /// Parses a CSV.
    ///
    /// # Errors
    /// Names the line, the column and the fault, or the key to set.
    pub fn parse(bytes: &[u8], form: &Form) -> Result<Self, String> {
        let text = text(bytes)?;
        let first = text.split(['\r', '\n']).next().unwrap_or_default();
        if first.to_lowercase().starts_with("sep=") {
            let remedy = "remove it, or use python -m metasense.records";
            return Err(format!("line 1: {first:?} is for Excel: {remedy}"));
        }
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
                    // One column; its name may contain a semicolon.
                    Some((separator, uneven)) if !candidates.contains(&b',') && form.separator.is_none() => {
                        read(&(NONE, 1)).map_err(|_| uneven.message(separator, form))
                    }
                    Some((separator, uneven)) => Err(uneven.message(separator, form)),
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
                    return Err(format!("more than one separator gives numbers: {settle}"));
                }
                let at = read.iter().position(Result::is_ok).unwrap_or(0);
                read.swap_remove(at)
            }
        }
    }

    /// The signals of an array with one or two dimensions. In two dimensions, the shorter side numbers the signals.
    ///
    /// # Errors
    /// If the array has more dimensions, or two equal sides.
    pub fn of_array(Array { shape, values }: &Array) -> Result<Self, String> {
        let [rows, columns] = match shape[..] {
            [entries] => [1, entries],
            [rows, columns] if rows != columns || rows == 1 => [rows, columns],
            [_, _] => {
                return Err(format!(
                    "has shape {shape:?}: signals must lie along the shorter side, but both are equal; add or remove entries"
                ));
            }
            _ => return Err(format!("has shape {shape:?}; must have 1 to 3 dimensions")),
        };
        let columns = match rows < columns {
            true => values.chunks_exact(columns).map(<[f64]>::to_vec).collect(),
            false => (0..columns).map(|c| values[c..].iter().step_by(columns).copied().collect()).collect(),
        };
        Ok(Self { names: Vec::new(), columns, lines: Vec::new() })
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.columns.len()
    }

    /// Index of a column.
    ///
    /// # Errors
    /// If no column has this name or number, or several have this name.
    pub fn column(&self, signal: &Signal) -> Result<usize, String> {
        let name = match signal {
            Signal::Number(number) if *number < self.width() => return Ok(*number),
            Signal::Number(number) => {
                return Err(format!("has no column {number}; columns are 0 to {}", self.width() - 1));
            }
            Signal::Name(name) => name,
        };
        let mut of_name = (0..self.names.len()).filter(|c| self.names[*c] == *name);
        match (of_name.next(), of_name.next()) {
            (Some(column), None) => Ok(column),
            (Some(_), Some(_)) => Err(format!("has two columns named {name:?}: select one by its number")),
            _ if self.names.is_empty() => {
                Err(format!("has no signal {name:?}: its columns have no names; use numbers from 0"))
            }
            _ => {
                let divided = if self.width() == 1 { divided_by(NONE) } else { "" };
                Err(format!("has no signal {name:?}; signals are {}{divided}", self.names.join(", ")))
            }
        }
    }

    /// Values of a column that was read.
    pub fn values(&self, column: usize) -> &[f64] {
        &self.columns[column]
    }

    /// Location of a row, for messages.
    pub fn place(&self, row: usize) -> String {
        self.lines.get(row).map_or(format!("entry {row}"), |line| format!("line {line}"))
    }

    /// Name of a column, for messages.
    pub fn label(&self, column: usize) -> String {
        self.names.get(column).cloned().unwrap_or(format!("column {column}"))
    }

    /// Parses a text whose lines all have `width` fields.
    fn divided(text: &str, separator: u8, width: usize, form: &Form) -> Result<Self, String> {
        let mut rows = Rows::new(text, separator);
        let Some((first_line, first)) = rows.next() else { return Err("is empty".into()) };
        let first: Vec<String> = first.iter().map(bare).map(str::to_owned).collect();
        let mut table = Self { names: Vec::new(), columns: vec![Vec::new(); width], lines: Vec::new() };
        if form.names(&first, first_line)? {
            table.names = first;
        } else {
            rows = Rows::new(text, separator);
        }
        let mut read: Vec<usize> = match &form.read {
            None => (0..width).collect(),
            Some(signals) => signals.iter().map(|signal| table.column(signal)).collect::<Result<_, _>>()?,
        };
        read.sort_unstable();
        read.dedup();
        let mut marks = Marks::default();
        while let Some((line, fields)) = rows.next() {
            for &column in &read {
                let field = bare(&fields[column]);
                let at = || format!("line {line}: {}", table.label(column));
                let Some((value, mark)) = number(field, form.decimal) else {
                    return Err(match field {
                        _ if fields.iter().map(bare).eq(&table.names) => {
                            format!(
                                "line {line}: repeats the names of line {first_line}: a file must contain one table"
                            )
                        }
                        "" => format!("{} is empty", at()),
                        _ if table.lines.is_empty()
                            && !table.names.is_empty()
                            && !fields.iter().any(may_be_number) =>
                        {
                            let remedy =
                                "if the line states units, remove it, or use python -m metasense.records";
                            format!("{} = {field:?} is not a number: {remedy}", at())
                        }
                        _ => format!("{} = {field:?} is not a number{}", at(), divided_by(separator)),
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
            return Err(format!("contains no line of numbers after line {first_line}"));
        }
        marks.check(separator, form).map(|()| table)
    }

    /// Rejects two columns of integers if only one is read: they may be one column with decimal commas.
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
