//! Recorded force histories: from files with a clock of their own to samples on the clock of a simulation.
//!
//! A file is a table (CSV, or NPY of two dimensions: one record, signals along the shorter side), an NPY of
//! (samples, panels, entries), or an NPZ whose arrays hold (entries), (samples, entries) or (samples, panels, entries).

use std::path::Path;
use std::sync::Arc;

use metasense_numerics::dynamics::Forces;
use metasense_numerics::stimuli::{Recorded, anti_aliased, resample};
use metasense_schemas::spec::{self, Resample, Signal, TrialSpec};

use crate::files::{Array, Content, content};
use crate::problem::{Invalid, invalid};

/// A history of each panel, or of the one that was struck, on an even clock.
#[derive(Debug, Clone, PartialEq)]
struct Record {
    start: f64,
    dt: f64,
    forces: Vec<Vec<f64>>,
}

/// A clock may be uneven by so much of its step.
const UNEVEN: f64 = 0.02;
/// Entries of a clock that was uneven, at most.
const LONGEST: usize = 10_000_000;

/// BLAKE3 over the lengths and contents of the files, in their order: 32 hex digits.
///
/// # Errors
/// Names a file that cannot be read.
pub fn digest(recorded: &spec::Recorded) -> Result<String, Invalid> {
    let mut hasher = blake3::Hasher::new();
    for file in &recorded.files {
        let bytes = read(file)?;
        hasher.update(&(bytes.len() as u64).to_le_bytes());
        hasher.update(&bytes);
    }
    Ok(hasher.finalize().to_hex()[..32].to_owned())
}

fn read(file: &Path) -> Result<Vec<u8>, Invalid> {
    std::fs::read(file).map_err(|e| at(file, format!("cannot be read: {e}")))
}

fn at(file: &Path, what: impl Into<String>) -> Invalid {
    invalid("stimuli.recorded.files", format!("{:?}", file.display().to_string()), what)
}

/// The records of a trial as the maths take them, on a clock of `instants` instants.
pub(crate) fn recorded(
    trial: &TrialSpec,
    recorded: &spec::Recorded,
    instants: usize,
) -> Result<Recorded, Invalid> {
    check(recorded)?;
    let now = digest(recorded)?;
    if let Some(known) = recorded.digest.as_ref().filter(|known| **known != now) {
        return Err(invalid("stimuli.recorded.digest", known, format!("the files' contents now give {now}")));
    }
    let panels = trial.panel_units.len();
    let mut records = Vec::new();
    for file in &recorded.files {
        let held = content(file, &read(file)?).map_err(|what| at(file, what))?;
        for record in of_file(recorded, held).map_err(|what| at(file, what))? {
            if ![1, panels].contains(&record.forces.len()) {
                let what = format!(
                    "holds {} forces a record; must be 1 or {panels}, one a panel",
                    record.forces.len()
                );
                return Err(at(file, what));
            }
            records.push(aligned(recorded, record).map_err(|what| at(file, what))?);
        }
    }
    let held = records.first().map_or(1, |record| record.forces.len());
    if records.iter().any(|record| record.forces.len() != held) {
        return Err(invalid(
            "stimuli.recorded.force",
            "mixed",
            "all files must hold as many forces a record",
        ));
    }
    let wanted = trial.stimuli.samples + trial.stimuli.holdout;
    if records.len() < wanted {
        let remedy = format!(
            "with {} of stimuli.holdout more than the {} records that there are",
            trial.stimuli.holdout,
            records.len()
        );
        return Err(invalid("stimuli.samples", trial.stimuli.samples, remedy));
    }
    let struck = match &recorded.panels {
        Some(struck) if held != 1 => {
            let remedy = format!("means nothing where a record holds {held} forces");
            return Err(invalid("stimuli.recorded.panels", format!("{struck:?}"), remedy));
        }
        Some(struck) if struck.len() != records.len() || struck.iter().any(|&k| k >= panels) => {
            let remedy =
                format!("must name one of panels 0 to {} for each of {} records", panels - 1, records.len());
            return Err(invalid("stimuli.recorded.panels", format!("{struck:?}"), remedy));
        }
        struck => struck.clone(),
    };
    let clock = match recorded.resample {
        Resample::Antialias => anti_aliased,
        Resample::Linear => resample,
    };
    let values = records
        .iter()
        .flat_map(|r| r.forces.iter().map(move |f| clock(f, r.start, r.dt, trial.time.duration, instants)))
        .flatten()
        .collect();
    Ok(Recorded {
        histories: Arc::new(Forces { samples: records.len(), panels: held, instants, values }),
        struck,
        scale: recorded.augment.scale,
        shift: recorded.augment.shift,
        low_pass: recorded.resample == Resample::Antialias,
    })
}

fn check(recorded: &spec::Recorded) -> Result<(), Invalid> {
    let key = |name: &str| format!("stimuli.recorded.{name}");
    let wrong = |name: &str, value: String, remedy: &str| Err(invalid(&key(name), value, remedy));
    if recorded.files.is_empty() {
        return wrong("files", "[]".into(), "must name a file");
    }
    if recorded.time.is_some() == recorded.rate.is_some() {
        return wrong(
            "rate",
            format!("{:?}", recorded.rate),
            "give the clock by time or by rate, one of them",
        );
    }
    if let Some(rate) = recorded.rate.filter(|rate| !(*rate > 0.0 && rate.is_finite())) {
        return wrong("rate", rate.to_string(), "must be a number above 0");
    }
    if !(recorded.scale.is_finite() && recorded.scale != 0.0) {
        return wrong("scale", recorded.scale.to_string(), "must be a number other than 0");
    }
    if let Some(trigger) = recorded.trigger.filter(|t| !(t.threshold > 0.0 && t.before.is_finite())) {
        return wrong("trigger.threshold", trigger.threshold.to_string(), "must be above 0");
    }
    for (name, [least, most]) in
        [("augment.scale", recorded.augment.scale), ("augment.shift", recorded.augment.shift)]
    {
        if !(least.is_finite() && most.is_finite() && least <= most) {
            return wrong(name, format!("[{least}, {most}]"), "must be [least, most]");
        }
    }
    Ok(())
}

/// The records of a file, as they stand in it.
fn of_file(recorded: &spec::Recorded, held: Content) -> Result<Vec<Record>, String> {
    let columns = match held {
        Content::Table(columns) => columns,
        Content::Array(array) if array.shape.len() == 3 => {
            if recorded.time.is_some() {
                return Err("of three dimensions has no clock: give rate".into());
            }
            return Ok(split(&array, [array.shape[0], array.shape[1]])
                .map(|forces| even(recorded, forces))
                .collect());
        }
        Content::Array(Array { shape, values }) => {
            let [rows, columns] = match shape[..] {
                [entries] => [1, entries],
                [rows, columns] => [rows, columns],
                _ => return Err(format!("is of shape {shape:?}; must have 1 to 3 dimensions")),
            };
            let (signals, length, across) =
                if rows <= columns { (rows, columns, false) } else { (columns, rows, true) };
            let value =
                |s: usize, n: usize| if across { values[n * columns + s] } else { values[s * columns + n] };
            (0..signals).map(|s| (s.to_string(), (0..length).map(|n| value(s, n)).collect())).collect()
        }
        Content::Archive(arrays) => return of_archive(recorded, &arrays),
    };
    let column = |signal: &Signal| -> Result<Vec<f64>, String> {
        let place = match signal {
            Signal::Number(number) => columns.get(*number),
            Signal::Name(name) => columns.iter().find(|(n, _)| n == name),
        };
        let names = || columns.iter().map(|c| c.0.as_str()).collect::<Vec<_>>().join(", ");
        place.map(|c| c.1.clone()).ok_or_else(|| format!("has no signal {signal:?}, but {}", names()))
    };
    let forces = match &recorded.force {
        Some(signals) => signals.iter().map(column).collect::<Result<Vec<_>, _>>()?,
        None if columns.len() == 1 => vec![columns[0].1.clone()],
        None => return Err(format!("has {} signals: name those that are forces by force", columns.len())),
    };
    Ok(vec![match &recorded.time {
        Some(time) => timed(recorded, &column(time)?, forces)?,
        None => even(recorded, forces),
    }])
}

fn of_archive(
    recorded: &spec::Recorded,
    arrays: &std::collections::BTreeMap<String, Result<Array, String>>,
) -> Result<Vec<Record>, String> {
    let named = |signal: &Signal| -> Result<&Array, String> {
        let Signal::Name(name) = signal else {
            return Err("holds arrays by name: force and time must be names".into());
        };
        let names = || arrays.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
        let array = arrays.get(name).ok_or_else(|| format!("has no array {name:?}, but {}", names()))?;
        array.as_ref().map_err(|what| format!("{name} {what}"))
    };
    let Some(signals) = &recorded.force else {
        return Err("has arrays by name: name the forces by force".into());
    };
    let mut records: Vec<Vec<Vec<f64>>> = Vec::new();
    for signal in signals {
        let array = named(signal)?;
        let counts = match array.shape[..] {
            [_] => [1, 1],
            [samples, _] => [samples, 1],
            [samples, panels, _] => [samples, panels],
            _ => {
                return Err(format!("{signal:?} is of shape {:?}; must have 1 to 3 dimensions", array.shape));
            }
        };
        if records.is_empty() {
            records = vec![Vec::new(); counts[0]];
        }
        if records.len() != counts[0] {
            return Err(format!("{signal:?} holds {} samples, another force {}", counts[0], records.len()));
        }
        records.iter_mut().zip(split(array, counts)).for_each(|(record, forces)| record.extend(forces));
    }
    match &recorded.time {
        None => Ok(records.into_iter().map(|forces| even(recorded, forces)).collect()),
        Some(time) => {
            let clock = &named(time)?.values;
            records.into_iter().map(|forces| timed(recorded, clock, forces)).collect()
        }
    }
}

/// (samples, panels, entries) as a list of histories a sample.
fn split(array: &Array, [samples, panels]: [usize; 2]) -> impl Iterator<Item = Vec<Vec<f64>>> {
    let entries = array.values.len() / (samples * panels).max(1);
    (0..samples).map(move |i| {
        (0..panels).map(|k| array.values[(i * panels + k) * entries..][..entries].to_vec()).collect()
    })
}

fn even(recorded: &spec::Recorded, forces: Vec<Vec<f64>>) -> Record {
    Record { start: 0.0, dt: 1.0 / recorded.rate.unwrap_or(1.0), forces }
}

/// A record with its clock; one that is uneven is read linearly onto an even one, as fine as its finest step.
fn timed(recorded: &spec::Recorded, clock: &[f64], forces: Vec<Vec<f64>>) -> Result<Record, String> {
    if let Some(force) = forces.iter().find(|force| force.len() != clock.len()) {
        return Err(format!("has {} entries of force, {} of time", force.len(), clock.len()));
    }
    if clock.len() < 2 {
        return Err("must hold at least two entries".into());
    }
    let unit = recorded.time_unit.seconds();
    let steps = || clock.windows(2).map(|w| w[1] - w[0]);
    if let Some(n) = steps().position(|step| !(step > 0.0 && step.is_finite())) {
        return Err(format!("time does not ascend: entry {} is {}, the next {}", n, clock[n], clock[n + 1]));
    }
    let span = clock[clock.len() - 1] - clock[0];
    let mean = span / (clock.len() - 1) as f64;
    let start = clock[0] * unit;
    if steps().all(|step| (step - mean).abs() <= UNEVEN * mean) {
        return Ok(Record { start, dt: mean * unit, forces });
    }
    let finest = steps().fold(f64::INFINITY, f64::min);
    let count = (span / finest).ceil();
    if count > LONGEST as f64 {
        return Err(format!("time is uneven, with steps from {finest} to much more: resample it first"));
    }
    let dt = span / count;
    let read = |force: &Vec<f64>| {
        let mut i = 0;
        let value = |n: usize| {
            let t = clock[0] + n as f64 * dt;
            while i + 2 < clock.len() && clock[i + 1] < t {
                i += 1;
            }
            let w = ((t - clock[i]) / (clock[i + 1] - clock[i])).clamp(0.0, 1.0);
            (1.0 - w) * force[i] + w * force[i + 1]
        };
        (0..=count as usize).map(value).collect()
    };
    Ok(Record { start, dt: dt * unit, forces: forces.iter().map(read).collect() })
}

/// In newtons, without offset, the blow where the trigger wants it.
fn aligned(recorded: &spec::Recorded, mut record: Record) -> Result<Record, String> {
    for force in &mut record.forces {
        if let Some(n) = force.iter().position(|f| !f.is_finite()) {
            return Err(format!("entry {n} of a force is {}; must be a finite number", force[n]));
        }
        if force.is_empty() {
            return Err("holds a record without entries".into());
        }
        let offset = if recorded.remove_offset { median(force) } else { 0.0 };
        let factor = recorded.force_unit.newtons() * recorded.scale;
        force.iter_mut().for_each(|f| *f = (*f - offset) * factor);
    }
    if let Some(trigger) = recorded.trigger {
        let reached = |force: &Vec<f64>| force.iter().position(|f| f.abs() >= trigger.threshold);
        let Some(first) = record.forces.iter().filter_map(reached).min() else {
            return Err(format!("holds a record that never reaches the trigger's {} N", trigger.threshold));
        };
        record.start = trigger.before - first as f64 * record.dt;
    }
    Ok(record)
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    *sorted.select_nth_unstable_by(values.len() / 2, f64::total_cmp).1
}

#[cfg(test)]
mod tests;
