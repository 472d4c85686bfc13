//! Recorded force histories: from files with a clock of their own to samples on the clock of a simulation.
//!
//! A file is a table (CSV, or NPY of two dimensions: one record, signals along the shorter side), an NPY of
//! (samples, panels, entries), or an NPZ whose arrays hold (entries), (samples, entries) or (samples, panels, entries).

use std::fs::File;
use std::io::{self, Read};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::sync::Arc;

use metasense_numerics::dynamics::Forces;
use metasense_numerics::stimuli::{REACH, Recorded, Source, felt, resample};
use metasense_numerics::trial::{Problem, Protocol};
use metasense_schemas::spec::{self, Resample, Signal, TimeUnit, TrialSpec};

use crate::files::{Array, Content, content};
use crate::invalid::{Invalid, as_written, invalid, positive};

/// Histories on an even clock: one of each panel, or of the one that was struck; or one of each channel.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Record {
    /// When the first entry is (s).
    pub start: f64,
    /// Time between two entries (s).
    pub dt: f64,
    /// The histories, equally long.
    pub values: Vec<Vec<f64>>,
}

/// What is to be read from a file, and its clock.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pick<'a> {
    /// The key that names it.
    pub key: &'static str,
    /// Its columns or arrays.
    pub signals: Option<&'a [Signal]>,
    /// The clock, or `rate`.
    pub time: Option<&'a Signal>,
    /// Entries a second.
    pub rate: Option<f64>,
    /// Unit of the clock.
    pub unit: TimeUnit,
    /// When the clock reads 0 (s).
    pub start: f64,
    /// Histories a record, where known: an array may then have them along its last side, too.
    pub count: Option<usize>,
}

impl<'a> Pick<'a> {
    /// The forces of a record.
    pub fn forces(recorded: &'a spec::Recorded) -> Self {
        Self {
            key: "force",
            signals: recorded.force.as_deref(),
            time: recorded.time.as_ref(),
            rate: recorded.rate,
            unit: recorded.time_unit,
            start: 0.0,
            count: None,
        }
    }
}

/// A clock may be uneven by so much of its step.
const UNEVEN: f64 = 0.02;
/// An entry may lie so far from where an even clock has it, in steps: small errors of one sign add up to instants.
const DRIFT: f64 = 0.1;
/// Entries of a clock that was uneven, at most.
const LONGEST: usize = 10_000_000;
/// A file may be so large (bytes).
const LARGEST: u64 = 4 << 30;

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

/// Reads a file. Whoever made a database has named it: a pipe would be waited for, a device has no end.
fn read(file: &Path) -> Result<Vec<u8>, Invalid> {
    let failed = |e: io::Error| at(file, format!("cannot be read: {e}"));
    let opened = File::options().read(true).custom_flags(libc::O_NONBLOCK).open(file).map_err(failed)?;
    let known = opened.metadata().map_err(failed)?;
    if !known.is_file() || known.len() > LARGEST {
        let largest = LARGEST >> 30;
        return Err(at(file, format!("must be an ordinary file of at most {largest} GiB")));
    }
    let mut bytes = Vec::new();
    opened.take(LARGEST).read_to_end(&mut bytes).map_err(failed)?;
    Ok(bytes)
}

pub(crate) fn at(file: &Path, what: impl Into<String>) -> Invalid {
    invalid("stimuli.recorded.files", format!("{:?}", file.display().to_string()), what)
}

/// A file taken apart.
pub(crate) fn open(file: &Path) -> Result<Content, Invalid> {
    content(file, &read(file)?).map_err(|what| at(file, what))
}

/// The records of a trial as the maths take them, on a clock of `instants` instants.
pub(crate) fn recorded(
    trial: &TrialSpec,
    recorded: &spec::Recorded,
    instants: usize,
) -> Result<Recorded, Invalid> {
    check(recorded)?;
    let panels = trial.panel_units.len();
    let room = REACH * trial.time.duration / trial.time.samples as f64 - recorded.augment.shift[0].min(0.0);
    let mut records = Vec::new();
    for file in &recorded.files {
        for mut record in forces(recorded, file, &open(file)?, panels)? {
            align(recorded, &mut record, room).map_err(|what| at(file, what))?;
            records.push(record);
        }
    }
    let wanted = trial.stimuli.samples + trial.stimuli.holdout;
    if records.len() < wanted {
        let remedy = format!(
            "with stimuli.holdout = {} that is {wanted} records; the files hold {}",
            trial.stimuli.holdout,
            records.len()
        );
        return Err(invalid("stimuli.samples", trial.stimuli.samples, remedy));
    }
    check_panels(recorded, &records, panels)?;
    let clock = clock(recorded.resample);
    let values = records
        .iter()
        .flat_map(|r| r.values.iter().map(move |f| clock(f, r.start, r.dt, trial.time.duration, instants)))
        .flatten()
        .collect();
    let held = records[0].values.len();
    Ok(Recorded {
        histories: Arc::new(Forces {
            samples: records.len(),
            panels: held,
            instants,
            values,
            strikes: Vec::new(),
        }),
        struck: recorded.panels.clone(),
        scale: recorded.augment.scale,
        shift: recorded.augment.shift,
        low_pass: recorded.resample == Resample::Antialias,
    })
}

/// How a history is read onto another clock: (history, start, dt, duration, instants).
pub(crate) type Clock = fn(&[f64], f64, f64, f64, usize) -> Vec<f64>;

/// That of a force.
pub(crate) fn clock(kind: Resample) -> Clock {
    match kind {
        Resample::Antialias => felt,
        Resample::Linear => resample,
    }
}

/// Part of its peak that a force may have where a shift cuts it off: of a half sine's impulse less than 0.1 % is below it, and
/// noise of a force sensor may reach 0.02 in the record of a weak blow.
pub(crate) const CUT: f64 = 0.05;

/// Whether the fresh samples of `joint`, or of a brain for all casts, have the whole force of their records, however these are shifted.
/// The plan asks; trials that were run before it did are still read.
///
/// # Errors
/// Names the record, and how much of its peak is cut.
pub fn check_shifts(problem: &Problem) -> Result<(), Invalid> {
    if !matches!(problem.optimise.protocol, Protocol::Joint(_)) && problem.evaluation.casts == 0 {
        return Ok(());
    }
    let records = problem.stimuli.source.parts().into_iter().find_map(|part| match part {
        Source::Recorded(records) => Some(records),
        _ => None,
    });
    let Some(Recorded { histories, shift, .. }) = records else { return Ok(()) };
    let instants = |time: f64| (time * histories.instants as f64 / problem.scene.duration).round() as usize;
    let [early, late] = [instants(-shift[0]), instants(shift[1])];
    let peak = |values: &[f64]| values.iter().fold(0.0, |peak: f64, f| peak.max(f.abs()));
    let remedies = [
        (early, "the beginning", "let trigger.before put it later"),
        (late, "the end", "lengthen time.duration"),
    ];
    for (end, (cut, place, remedy)) in remedies.into_iter().enumerate() {
        for i in 0..histories.samples {
            let lost = |history: &[f64]| {
                let cut = cut.min(history.len());
                peak(if end == 0 { &history[..cut] } else { &history[history.len() - cut..] })
            };
            let record = histories.sample(i);
            let part =
                record.chunks_exact(histories.instants + 1).map(lost).fold(0.0, f64::max) / peak(record);
            if part > CUT {
                return Err(invalid(
                    "stimuli.recorded.augment.shift",
                    format!("{shift:?}"),
                    format!(
                        "cuts force of {:.0} % of its peak off {place} of record {i}: {remedy}, or shift less",
                        100.0 * part
                    ),
                ));
            }
        }
    }
    Ok(())
}

/// The forces of a file: of all panels a record, or of one.
pub(crate) fn forces(
    recorded: &spec::Recorded,
    file: &Path,
    held: &Content,
    panels: usize,
) -> Result<Vec<Record>, Invalid> {
    let records = of_file(&Pick::forces(recorded), held).map_err(|what| at(file, what))?;
    match records.iter().map(|record| record.values.len()).find(|held| ![1, panels].contains(held)) {
        Some(held) => {
            let most = if panels == 1 { String::new() } else { format!(" or {panels}, one a panel") };
            Err(at(file, format!("holds {held} forces a record; must be 1{most}")))
        }
        None => Ok(records),
    }
}

/// Whether all records hold as many forces, and `panels` says which is struck where it may.
pub(crate) fn check_panels(
    recorded: &spec::Recorded,
    records: &[Record],
    panels: usize,
) -> Result<(), Invalid> {
    let held = records.first().map_or(1, |record| record.values.len());
    if records.iter().any(|record| record.values.len() != held) {
        return Err(invalid(
            "stimuli.recorded.force",
            "mixed",
            "all files must hold as many forces a record",
        ));
    }
    let Some(struck) = &recorded.panels else { return Ok(()) };
    let remedy = match held {
        1 if struck.len() == records.len() && struck.iter().all(|&k| k < panels) => return Ok(()),
        1 => format!("must name one of panels 0 to {} for each of {} records", panels - 1, records.len()),
        _ => format!("means nothing where a record holds {held} forces"),
    };
    Err(invalid("stimuli.recorded.panels", format!("{struck:?}"), remedy))
}

/// Refuses keys that cannot be meant, and files that are not those of the digest.
pub(crate) fn check(recorded: &spec::Recorded) -> Result<(), Invalid> {
    let key = |name: &str| format!("stimuli.recorded.{name}");
    let wrong = |name: &str, value: String, remedy: &str| Err(invalid(&key(name), value, remedy));
    if recorded.files.is_empty() {
        return wrong("files", "[]".into(), "must name a file");
    }
    if recorded.time.is_some() == recorded.rate.is_some() {
        let given = recorded.rate.map_or(String::new(), |rate| rate.to_string());
        return wrong("rate", given, "give either time or rate");
    }
    recorded.rate.map_or(Ok(()), |rate| positive(&key("rate"), rate))?;
    if !(recorded.scale.is_finite() && recorded.scale != 0.0) {
        return wrong("scale", recorded.scale.to_string(), "must be a number other than 0");
    }
    if let Some(trigger) = recorded.trigger.filter(|t| t.threshold.is_nan() || t.threshold <= 0.0) {
        return wrong("trigger.threshold", trigger.threshold.to_string(), "must be above 0");
    }
    for (name, [least, most]) in
        [("augment.scale", recorded.augment.scale), ("augment.shift", recorded.augment.shift)]
    {
        if !(least.is_finite() && most.is_finite() && least <= most) {
            return wrong(name, format!("[{least}, {most}]"), "must be [least, most]");
        }
    }
    let Some(known) = &recorded.digest else { return Ok(()) };
    let now = digest(recorded)?;
    let remedy = format!("the files' contents now give {now}");
    if *known == now { Ok(()) } else { Err(invalid("stimuli.recorded.digest", known, remedy)) }
}

/// The records of a file, as they stand in it.
pub(crate) fn of_file(pick: &Pick, held: &Content) -> Result<Vec<Record>, String> {
    let turned: Vec<(String, Vec<f64>)>;
    let columns = match held {
        Content::Table(columns) => columns,
        Content::Array(array) if array.shape.len() == 3 => {
            if pick.time.is_some() {
                return Err("has three dimensions, so no clock: give rate".into());
            }
            if pick.signals.is_some() {
                return Err(format!(
                    "has three dimensions, so no names and numbers of signals: leave out {}",
                    pick.key
                ));
            }
            return Ok(histories(pick, array)?.into_iter().map(|values| even(pick, values)).collect());
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
            turned =
                (0..signals).map(|s| (s.to_string(), (0..length).map(|n| value(s, n)).collect())).collect();
            &turned
        }
        Content::Archive(arrays) => return of_archive(pick, arrays),
    };
    let column = |signal: &Signal| -> Result<Vec<f64>, String> {
        let place = match signal {
            Signal::Number(number) => columns.get(*number),
            Signal::Name(name) => columns.iter().find(|(n, _)| n == name),
        };
        let names = || columns.iter().map(|c| c.0.as_str()).collect::<Vec<_>>().join(", ");
        place.map(|c| c.1.clone()).ok_or_else(|| {
            let headless = columns.iter().all(|c| c.0.trim().parse::<f64>().is_ok());
            let head = if headless { ": a file without a line of names?" } else { "" };
            format!("has no signal {}, but {}{head}", as_written(signal), names())
        })
    };
    let values = match pick.signals {
        Some(signals) => signals.iter().map(column).collect::<Result<Vec<_>, _>>()?,
        None if columns.len() == pick.count.unwrap_or(1) => columns.iter().map(|c| c.1.clone()).collect(),
        None => {
            return Err(format!("has {} signals: name the ones to read in {}", columns.len(), pick.key));
        }
    };
    Ok(vec![match pick.time {
        Some(time) => timed(pick, &column(time)?, values)?,
        None => even(pick, values),
    }])
}

fn of_archive(
    pick: &Pick,
    arrays: &std::collections::BTreeMap<String, Result<Array, String>>,
) -> Result<Vec<Record>, String> {
    let key = pick.key;
    let named = |signal: &Signal| -> Result<&Array, String> {
        let Signal::Name(name) = signal else {
            return Err(format!("holds arrays by name: {key} and time must be names"));
        };
        let names = || arrays.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
        let array = arrays.get(name).ok_or_else(|| format!("has no array {name:?}, but {}", names()))?;
        array.as_ref().map_err(|what| format!("{name} {what}"))
    };
    let Some(signals) = pick.signals else {
        return Err(format!("has arrays by name: name the ones to read in {key}"));
    };
    let alone = Pick { count: pick.count.filter(|_| signals.len() == 1), ..*pick };
    let mut records: Vec<Vec<Vec<f64>>> = Vec::new();
    for signal in signals {
        let held =
            histories(&alone, named(signal)?).map_err(|what| format!("{} {what}", as_written(signal)))?;
        if records.is_empty() {
            records = vec![Vec::new(); held.len()];
        }
        if records.len() != held.len() {
            let (these, others) = (held.len(), records.len());
            return Err(format!("{} holds {these} samples, another of {key} {others}", as_written(signal)));
        }
        records.iter_mut().zip(held).for_each(|(record, values)| record.extend(values));
    }
    match pick.time {
        None => Ok(records.into_iter().map(|values| even(pick, values)).collect()),
        Some(time) => {
            let clock = &named(time)?.values;
            records.into_iter().map(|values| timed(pick, clock, values)).collect()
        }
    }
}

/// (entries), (samples, entries) or (samples, histories, entries) as a list of histories a sample. Where their number
/// is known, (entries, histories) and (samples, entries, histories), too.
fn histories(pick: &Pick, array: &Array) -> Result<Vec<Vec<Vec<f64>>>, String> {
    let [samples, rows, columns] = match (array.shape[..].as_ref(), pick.count) {
        ([entries], _) => [1, 1, *entries],
        ([rows, columns], Some(_)) => [1, *rows, *columns],
        ([samples, entries], None) => [*samples, 1, *entries],
        ([samples, rows, columns], _) => [*samples, *rows, *columns],
        _ => return Err(format!("is of shape {:?}; must have 1 to 3 dimensions", array.shape)),
    };
    let last = pick.count == Some(columns);
    let value = |i: usize, row: usize, column: usize| array.values[(i * rows + row) * columns + column];
    let sample = |i: usize| -> Vec<Vec<f64>> {
        if last {
            (0..columns).map(|c| (0..rows).map(|n| value(i, n, c)).collect()).collect()
        } else {
            (0..rows).map(|r| (0..columns).map(|n| value(i, r, n)).collect()).collect()
        }
    };
    Ok((0..samples).map(sample).collect())
}

fn even(pick: &Pick, values: Vec<Vec<f64>>) -> Record {
    Record { start: pick.start, dt: 1.0 / pick.rate.unwrap_or(1.0), values }
}

/// A record with its clock; one that is uneven is read linearly onto an even one, as fine as its finest step.
fn timed(pick: &Pick, clock: &[f64], values: Vec<Vec<f64>>) -> Result<Record, String> {
    if let Some(history) = values.iter().find(|history| history.len() != clock.len()) {
        return Err(format!("has {} entries of {}, {} of time", history.len(), pick.key, clock.len()));
    }
    if clock.len() < 2 {
        return Err("must hold at least two entries".into());
    }
    let unit = pick.unit.seconds();
    let steps = || clock.windows(2).map(|w| w[1] - w[0]);
    if let Some(n) = steps().position(|step| !(step > 0.0 && step.is_finite())) {
        return Err(format!("time does not ascend: entry {} is {}, the next {}", n, clock[n], clock[n + 1]));
    }
    let span = clock[clock.len() - 1] - clock[0];
    let mean = span / (clock.len() - 1) as f64;
    let start = pick.start + clock[0] * unit;
    let drift = |(n, t): (usize, &f64)| (t - clock[0] - n as f64 * mean).abs();
    if steps().all(|step| (step - mean).abs() <= UNEVEN * mean)
        && clock.iter().enumerate().map(drift).all(|off| off <= DRIFT * mean)
    {
        return Ok(Record { start, dt: mean * unit, values });
    }
    let finest = steps().fold(f64::INFINITY, f64::min);
    let count = (span / finest).ceil();
    if count > LONGEST as f64 {
        return Err(format!(
            "time is uneven, and its finest step, {finest}, is too small to resample at: resample it first"
        ));
    }
    let dt = span / count;
    let read = |history: &Vec<f64>| {
        let mut i = 0;
        let value = |n: usize| {
            let t = clock[0] + n as f64 * dt;
            while i + 2 < clock.len() && clock[i + 1] < t {
                i += 1;
            }
            let w = ((t - clock[i]) / (clock[i + 1] - clock[i])).clamp(0.0, 1.0);
            (1.0 - w) * history[i] + w * history[i + 1]
        };
        (0..=count as usize).map(value).collect()
    };
    Ok(Record { start, dt: dt * unit, values: values.iter().map(read).collect() })
}

/// Puts forces into newtons, without offset, and the blow where the trigger wants it, where it does not say at `room` (s).
/// Returns by how much that is later than it was (s).
pub(crate) fn align(recorded: &spec::Recorded, record: &mut Record, room: f64) -> Result<f64, String> {
    let factor = recorded.force_unit.newtons() * recorded.scale;
    let factors = vec![factor; record.values.len()];
    in_units("force", &mut record.values, &factors, recorded.remove_offset)?;
    let Some(trigger) = recorded.trigger else { return Ok(0.0) };
    let reached = |force: &Vec<f64>| force.iter().position(|f| f.abs() >= trigger.threshold);
    let Some(first) = record.values.iter().filter_map(reached).min() else {
        return Err(format!("holds a record that never reaches the trigger's {} N", trigger.threshold));
    };
    let before = record.start;
    record.start = trigger.before.unwrap_or(room) - first as f64 * record.dt;
    Ok(record.start - before)
}

/// Multiplies each history by its factor, its median taken off first where asked.
pub(crate) fn in_units(
    what: &str,
    values: &mut [Vec<f64>],
    factors: &[f64],
    remove_offset: bool,
) -> Result<(), String> {
    for (history, factor) in values.iter_mut().zip(factors) {
        if let Some(n) = history.iter().position(|x| !x.is_finite()) {
            return Err(format!("entry {n} of a {what} is {}; must be a finite number", history[n]));
        }
        if history.is_empty() {
            return Err("holds a record without entries".into());
        }
        let offset = if remove_offset { median(history) } else { 0.0 };
        history.iter_mut().for_each(|x| *x = (*x - offset) * factor);
    }
    Ok(())
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    *sorted.select_nth_unstable_by(values.len() / 2, f64::total_cmp).1
}

#[cfg(test)]
pub(crate) mod tests;
