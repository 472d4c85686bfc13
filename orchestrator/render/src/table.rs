//! Tables: named columns and rows of values.

use serde_json::Value;

use super::number::digits;
use crate::cell::plain;

/// A table.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Table {
    /// Names of the columns.
    pub columns: Vec<String>,
    /// Rows with one value per column; a blob appears as the text `blob of N bytes`.
    pub rows: Vec<Vec<Value>>,
}

/// A row from JSON-compatible values; after a semicolon, an iterable of more values.
#[macro_export]
macro_rules! row {
    ($($cell:expr),* $(,)?) => { vec![$(serde_json::json!($cell)),*] };
    ($($cell:expr),*; $rest:expr) => {
        [$(serde_json::json!($cell)),*].into_iter().chain($rest.into_iter().map(|cell| serde_json::json!(cell))).collect::<Vec<_>>()
    };
}

/// From column names and rows, as the database returns them.
impl From<(Vec<String>, Vec<Vec<Value>>)> for Table {
    fn from((columns, rows): (Vec<String>, Vec<Vec<Value>>)) -> Self {
        Self { columns, rows }
    }
}

impl Table {
    /// Rows with columns of these names, separated by blanks.
    pub fn new(columns: &str, rows: impl IntoIterator<Item = Vec<Value>>) -> Self {
        let columns = columns.split_whitespace().map(str::to_owned).collect();
        Self { columns, rows: rows.into_iter().collect() }
    }

    /// The value of `verdict`, if all rows have the same and NULL in all later columns.
    pub fn sole_verdict(&self) -> Option<&str> {
        let at = self.columns.iter().position(|column| column == "verdict")?;
        let verdict = self.rows.first()?[at].as_str()?;
        let alone = |row: &Vec<Value>| row[at] == verdict && row[at + 1..].iter().all(Value::is_null);
        self.rows.iter().all(alone).then_some(verdict)
    }

    /// Position of a column.
    ///
    /// # Panics
    /// If the column does not exist.
    pub fn column(&self, name: &str) -> usize {
        self.columns.iter().position(|column| column == name).expect("a column of the table")
    }

    /// Removes these columns.
    pub fn drop_columns(&mut self, names: &[&str]) {
        self.retain(|table, at| !names.contains(&table.columns[at].as_str()));
    }

    /// Removes those of the [`SPREAD`] columns in which every value is NULL or zero.
    pub fn leave_out_spread(&mut self) {
        self.retain(|table, at| {
            let says = |row: &Vec<Value>| !row[at].is_null() && row[at] != 0;
            !SPREAD.contains(&table.columns[at].as_str()) || table.rows.iter().any(says)
        });
    }

    /// A copy without the columns in which every value is NULL.
    pub fn without_empty_columns(&self) -> Self {
        let mut table = self.clone();
        table.retain(|table, at| table.rows.iter().any(|row| !row[at].is_null()));
        table
    }

    /// Removes the columns that `keeps` rejects, by position.
    fn retain(&mut self, keeps: impl Fn(&Self, usize) -> bool) {
        let kept: Vec<bool> = (0..self.columns.len()).map(|at| keeps(self, at)).collect();
        let mut flags = kept.iter().cycle();
        self.columns.retain(|_| flags.next() == Some(&true));
        self.rows.iter_mut().for_each(|row| row.retain(|_| flags.next() == Some(&true)));
    }
}

/// Columns beside the mean held-out errors: medians (%), and numbers of samples above 100 %.
pub const SPREAD: [&str; 4] = [
    "holdout_median_initial",
    "holdout_median_optimised",
    "holdout_above_initial",
    "holdout_above_optimised",
];

/// The first eight characters of a hash, which name a trial.
pub fn short_hash(hash: &str) -> &str {
    hash.char_indices().nth(8).map_or(hash, |(end, _)| &hash[..end])
}

/// A value as text: floating-point numbers with `shown`, the rest in full.
pub fn readable(value: &Value, shown: impl Fn(f64) -> String) -> String {
    value.as_f64().filter(|_| value.is_f64()).map_or_else(|| plain(value), shown)
}

/// A value with four significant digits.
pub(super) fn rounded(value: &Value) -> String {
    readable(value, |x| digits(x, 4))
}

#[cfg(test)]
mod tests;
