//! Which columns of a file are read, and the records that they form.

use std::collections::BTreeMap;

use metasense_schemas::spec::{self, Signal, TimeUnit};

use super::Record;
use super::clock::with_clock;
use crate::files::{Array, ColumnTable, Content};
use crate::invalid::as_written;

/// The columns or arrays to read, and their clock.
#[derive(Debug, Clone, Copy)]
pub struct Pick<'a> {
    /// The key that names them.
    pub key: &'static str,
    /// Columns or arrays.
    pub signals: Option<&'a [Signal]>,
    /// Column or array of times; alternative to `rate`.
    pub time: Option<&'a Signal>,
    /// Entries per second.
    pub rate: Option<f64>,
    /// Unit of the times.
    pub unit: TimeUnit,
    /// Table of the spec that contains `time_unit` and `rate`.
    pub clock: &'static str,
    /// Number of histories per record, if known; arrays may then have them along the last axis as well.
    pub count: Option<usize>,
}

impl<'a> Pick<'a> {
    /// Forces of records; `keys` is their table of the spec.
    pub fn forces(recorded: &'a spec::Recorded, keys: &'static str) -> Self {
        Self {
            key: "force",
            signals: recorded.force.as_deref(),
            time: recorded.time.as_ref(),
            rate: recorded.rate,
            unit: recorded.time_unit,
            clock: keys,
            count: None,
        }
    }

    /// Columns or arrays to read; `None`: all.
    pub fn read(&self) -> Option<Vec<&'a Signal>> {
        Some(self.signals?.iter().chain(self.time).collect())
    }

    /// The key that sets the time step.
    pub fn clock_key(&self) -> String {
        format!("{}.{}", self.clock, if self.time.is_some() { "time_unit" } else { "rate" })
    }
}

/// The records of a file, unconverted.
pub fn of_file(pick: &Pick, held: &Content) -> Result<Vec<Record>, String> {
    let of_array: ColumnTable;
    let table = match held {
        Content::Table(table) => table,
        Content::Array(array) if array.shape.len() == 3 => {
            if pick.time.is_some() {
                return Err("has three dimensions, so no clock: set rate".into());
            }
            if pick.signals.is_some() {
                return Err(format!(
                    "has three dimensions, so its signals have no names or numbers: leave out {}",
                    pick.key
                ));
            }
            return histories(pick, array)?.into_iter().map(|values| even(pick, values)).collect();
        }
        Content::Array(array) => {
            of_array = ColumnTable::of_array(array)?;
            &of_array
        }
        Content::Archive(arrays) => return of_archive(pick, arrays),
    };
    let columns: Vec<usize> = match pick.signals {
        Some(signals) => signals.iter().map(|signal| table.column(signal)).collect::<Result<_, _>>()?,
        None if table.width() == pick.count.unwrap_or(1) => (0..table.width()).collect(),
        None => {
            return Err(format!("has {} signals: list the signals to read in {}", table.width(), pick.key));
        }
    };
    let time = pick.time.map(|time| table.column(time)).transpose()?;
    let all: Vec<usize> = columns.iter().copied().chain(time).collect();
    if let Some(n) = (1..all.len()).find(|n| all[..*n].contains(&all[*n])) {
        return Err(twice(pick, &table.label(all[n])));
    }
    let values = columns.iter().map(|column| table.values(*column).to_vec()).collect();
    Ok(vec![match time {
        Some(time) => with_clock(
            pick,
            table.values(time),
            &|row| format!("{}: {}", table.place(row), table.label(time)),
            values,
        )?,
        None => even(pick, values)?,
    }])
}

fn twice(pick: &Pick, what: &str) -> String {
    format!("{what} is read twice, by {} or as the clock", pick.key)
}

fn of_archive(
    pick: &Pick,
    arrays: &BTreeMap<String, Option<Result<Array, String>>>,
) -> Result<Vec<Record>, String> {
    let key = pick.key;
    let named = |signal: &Signal| -> Result<(&str, &Array), String> {
        let Signal::Name(name) = signal else {
            return Err(format!("contains named arrays: {key} and time must be names"));
        };
        let names = || arrays.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
        let (name, array) = arrays
            .get_key_value(name)
            .ok_or_else(|| format!("has no array {name:?}; arrays are {}", names()))?;
        let array = array.as_ref().expect("what is named is read").as_ref();
        Ok((name, array.map_err(|what| format!("{name} {what}"))?))
    };
    let Some(signals) = pick.signals else {
        return Err(format!("contains named arrays: list the arrays to read in {key}"));
    };
    let all: Vec<&Signal> = signals.iter().chain(pick.time).collect();
    if let Some(n) = (1..all.len()).find(|n| all[..*n].contains(&all[*n])) {
        return Err(twice(pick, &as_written(all[n])));
    }
    let alone = Pick { count: pick.count.filter(|_| signals.len() == 1), ..*pick };
    let mut records: Vec<Vec<Vec<f64>>> = Vec::new();
    for signal in signals {
        let (name, array) = named(signal)?;
        let held = histories(&alone, array).map_err(|what| format!("{name} {what}"))?;
        if records.is_empty() {
            records = vec![Vec::new(); held.len()];
        }
        if records.len() != held.len() {
            let (these, others) = (held.len(), records.len());
            return Err(format!("{name} contains {these} samples, another array of {key} {others}"));
        }
        records.iter_mut().zip(held).for_each(|(record, values)| record.extend(values));
    }
    match pick.time {
        None => records.into_iter().map(|values| even(pick, values)).collect(),
        Some(time) => {
            let (name, clock) = named(time)?;
            let place = |entry| format!("entry {entry} of {name}");
            records.into_iter().map(|values| with_clock(pick, &clock.values, &place, values)).collect()
        }
    }
}

/// Converts (entries), (samples, entries) or (samples, histories, entries) to a list of histories per sample. If their number is
/// known, also (entries, histories) and (samples, entries, histories).
fn histories(pick: &Pick, Array { shape, values }: &Array) -> Result<Vec<Vec<Vec<f64>>>, String> {
    let ([samples, rows, columns], axes) = match (&shape[..], pick.count) {
        ([entries], _) => ([1, 1, *entries], "entries"),
        ([rows, columns], Some(_)) => ([1, *rows, *columns], "signals, entries"),
        ([samples, entries], None) => ([*samples, 1, *entries], "samples, entries"),
        ([samples, rows, columns], _) => ([*samples, *rows, *columns], "samples, signals, entries"),
        _ => return Err(format!("has shape {shape:?}; must have 1 to 3 dimensions")),
    };
    let last = pick.count == Some(columns);
    if !last && columns < 2 {
        let remedy = if shape.len() > 1 { "transpose it" } else { "a record needs two entries or more" };
        return Err(format!("has shape {shape:?}: read as ({axes}); {remedy}"));
    }
    if last && rows == columns && rows > 1 {
        let remedy = "one axis must be entries and the other signals: add entries";
        return Err(format!("has shape {shape:?}, with as many entries as signals: {remedy}"));
    }
    let value = |i: usize, row: usize, column: usize| values[(i * rows + row) * columns + column];
    let sample = |i: usize| -> Vec<Vec<f64>> {
        if last {
            (0..columns).map(|c| (0..rows).map(|n| value(i, n, c)).collect()).collect()
        } else {
            (0..rows).map(|r| (0..columns).map(|n| value(i, r, n)).collect()).collect()
        }
    };
    Ok((0..samples).map(sample).collect())
}

fn even(pick: &Pick, values: Vec<Vec<f64>>) -> Result<Record, String> {
    match values.iter().any(|history| history.len() < 2) {
        true => Err("must contain at least two entries".into()),
        false => Ok(Record { start: 0.0, dt: 1.0 / pick.rate.unwrap_or(1.0), values, jitter: 0.0 }),
    }
}
