//! Recorded force histories: from files with their own clock to samples on the clock of a simulation.
//!
//! A file is a table (CSV, or two-dimensional NPY: one record, signals along the shorter side), an NPY of (samples, panels,
//! entries), or an NPZ with arrays of (entries), (samples, entries) or (samples, panels, entries).

use std::collections::HashMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use metasense_numerics::dynamics::Forces;
use metasense_numerics::stimuli::{HistorySource, REACH, RecordedForces, anti_aliased_force, resample};
use metasense_numerics::student::median;
use metasense_numerics::trial::{Problem, TrainingProtocol};
use metasense_schemas::spec::{self, Decimal, Resample, Separator, TrialSpec};

use crate::files::{self, Content, Form};
use crate::invalid::{Invalid, absent, as_written, invalid, positive, require};

mod clock;
mod pick;

pub use pick::{Pick, of_file};

/// Histories on an even clock: one per panel, a single one for the struck panel, or one per channel.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// Time of the first entry (s).
    pub start: f64,
    /// Interval between entries (s).
    pub dt: f64,
    /// Histories of equal length.
    pub values: Vec<Vec<f64>>,
    /// Largest deviation of a time step from the mean step, relative to it.
    pub jitter: f64,
}

/// BLAKE3 hash of the lengths and contents of the files, in order: 32 hex digits.
///
/// # Errors
/// Names a file that cannot be read.
pub fn digest(recorded: &spec::Recorded) -> Result<String, Invalid> {
    let mut hasher = blake3::Hasher::new();
    for file in &recorded.files {
        let failed = |e: io::Error| file_error(file, format!("cannot be read: {e}"));
        let opened = files::open(file).map_err(failed)?;
        hasher.update(&opened.metadata().map_err(failed)?.len().to_le_bytes());
        hasher.update_reader(opened).map_err(failed)?;
    }
    Ok(hasher.finalize().to_hex()[..32].to_owned())
}

/// The error of a file of records.
pub fn file_error(file: &Path, what: impl Into<String>) -> Invalid {
    invalid("stimuli.recorded.files", format!("{:?}", file.display().to_string()), what)
}

/// Reads and parses a file.
pub fn open(file: &Path, form: &Form) -> Result<Content, String> {
    let bytes = files::read(file).map_err(|e| format!("cannot be read: {e}"))?;
    files::content(file, &bytes, form)
}

/// The records of a trial in numerical form, on a clock of `instants` instants.
pub(crate) fn load_records(
    trial: &TrialSpec,
    recorded: &spec::Recorded,
    instants: usize,
) -> Result<RecordedForces, Invalid> {
    check(recorded)?;
    let panels = trial.panel_units.len();
    let room = REACH * trial.time.duration / trial.time.samples as f64 - recorded.augment.shift[0].min(0.0);
    let pick = Pick::forces(recorded, "stimuli.recorded");
    let form = Form::of_forces(recorded, pick.clock, pick.read());
    let mut records = Vec::new();
    for file in &recorded.files {
        let wrong = |what| file_error(file, what);
        let of_file = open(file, &form).and_then(|held| forces(&pick, &held, panels)).map_err(wrong)?;
        let count = of_file.len();
        for (i, mut record) in of_file.into_iter().enumerate() {
            let wrong = |what| wrong(numbered(i, count, what));
            check_step(&pick, &record, trial.time).map_err(wrong)?;
            align(recorded, &mut record, room).map_err(wrong)?;
            check_place(&pick, &record, trial.time.duration).map_err(wrong)?;
            records.push(record);
        }
    }
    let wanted = trial.stimuli.samples + trial.stimuli.holdout;
    if records.len() < wanted {
        let remedy = format!(
            "with stimuli.holdout = {}, {wanted} records are needed; the files contain {}",
            trial.stimuli.holdout,
            records.len()
        );
        return Err(invalid("stimuli.samples", trial.stimuli.samples, remedy));
    }
    check_panels(recorded, &records.iter().collect::<Vec<_>>(), records.len(), panels)?;
    let clock = clock(recorded.resample);
    let values = records
        .iter()
        .flat_map(|r| r.values.iter().map(move |f| clock(f, r.start, r.dt, trial.time.duration, instants)))
        .flatten()
        .collect();
    let held = records[0].values.len();
    Ok(RecordedForces {
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

/// Resamples a history: (history, start, dt, duration, instants).
pub type Resampler = fn(&[f64], f64, f64, f64, usize) -> Vec<f64>;

/// The resampling function for forces.
pub fn clock(kind: Resample) -> Resampler {
    match kind {
        Resample::Antialias => anti_aliased_force,
        Resample::Linear => resample,
    }
}

/// Largest force, relative to its peak, at which a shift may cut it off. A half sine cut there loses less than 0.1 % of its
/// impulse; sensor noise may reach 0.02 in the record of a weak blow.
pub const CUT: f64 = 0.05;

/// Checks that records contain forces, that no two are copies and that shifts do not cut forces off. Called when trials are planned;
/// replays of older trials skip it.
///
/// # Errors
/// Names the record.
pub fn check_records(trial: &TrialSpec, problem: &Problem) -> Result<(), Invalid> {
    check_copies(trial, problem)?;
    let triggered = trial.stimuli.recorded.as_ref().is_some_and(|recorded| recorded.trigger.is_some());
    check_shifts(problem, triggered)
}

/// Rejects records without any force, and two of the same force on the same panel: a copy would train and test the same decoder.
fn check_copies(trial: &TrialSpec, problem: &Problem) -> Result<(), Invalid> {
    let sources = std::iter::once(&problem.stimuli.source).chain(&problem.under);
    let records = sources.flat_map(HistorySource::parts).find_map(|part| match part {
        HistorySource::Recorded(records) => Some(records),
        _ => None,
    });
    let Some(RecordedForces { histories, struck, .. }) = records else { return Ok(()) };
    let remedy = "is 0 in all records: list the columns or arrays that contain the forces";
    let read = trial.stimuli.recorded.as_ref().and_then(|recorded| recorded.force.as_ref());
    let shown = read.map_or(String::new(), as_written);
    require(histories.values.iter().any(|f| *f != 0.0), "stimuli.recorded.force", shown, remedy)?;
    let files = trial.stimuli.recorded.as_ref().map_or(&[][..], |recorded| &recorded.files);
    let name = |i: usize| match files.len() == histories.samples {
        true => format!("{:?}", files[i].display().to_string()),
        false => format!("record {i}"),
    };
    let mut seen = HashMap::new();
    for i in 0..histories.samples {
        let force = histories.sample(i);
        let panel = struck.as_ref().map(|struck| struck[i]);
        if let Some(first) =
            seen.insert((fingerprint(force), panel), i).filter(|_| force.iter().any(|f| *f != 0.0))
        {
            let what = format!(
                "repeats the forces of {}: a copy would train and test the same decoder",
                name(first)
            );
            return Err(invalid("stimuli.recorded.files", name(i), what));
        }
    }
    Ok(())
}

/// Hash of an array.
pub fn fingerprint(values: &[f64]) -> blake3::Hash {
    blake3::hash(bytemuck::cast_slice(values))
}

/// Checks that shifted fresh samples, of `joint` or of a decoder for all casts, contain the whole force of their records.
fn check_shifts(problem: &Problem, triggered: bool) -> Result<(), Invalid> {
    if !matches!(problem.optimise.protocol, TrainingProtocol::Joint(_)) && problem.evaluation.casts == 0 {
        return Ok(());
    }
    let records = problem.stimuli.source.parts().into_iter().find_map(|part| match part {
        HistorySource::Recorded(records) => Some(records),
        _ => None,
    });
    let Some(RecordedForces { histories, shift, .. }) = records else { return Ok(()) };
    let instants = |time: f64| (time * histories.instants as f64 / problem.scene.duration).round() as usize;
    let [early, late] = [instants(-shift[0]), instants(shift[1])];
    let peak = |values: &[f64]| values.iter().fold(0.0, |peak: f64, f| peak.max(f.abs()));
    let begin = if triggered { "raise trigger.before" } else { "use records that begin earlier" };
    let remedies = [(early, "the beginning", begin), (late, "the end", "lengthen time.duration")];
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
                let remedy = format!(
                    "would cut off forces of {:.0} % of the peak at {place} of record {i}: {remedy}, or shift less",
                    100.0 * part
                );
                return Err(invalid("stimuli.recorded.augment.shift", format!("{shift:?}"), remedy));
            }
        }
    }
    Ok(())
}

/// Forces of a file: one history per panel, or a single one per record.
pub fn forces(pick: &Pick, held: &Content, panels: usize) -> Result<Vec<Record>, String> {
    let records = of_file(pick, held)?;
    match records.iter().map(|record| record.values.len()).find(|held| ![1, panels].contains(held)) {
        Some(held) => {
            let most = if panels == 1 { String::new() } else { format!(" or {panels}, one per panel") };
            Err(format!("contains {held} forces per record; must be 1{most}"))
        }
        None => Ok(records),
    }
}

/// Rejects keys of the CSV format if no file is a CSV.
pub fn check_form(
    table: &str,
    files: &[PathBuf],
    header: Option<bool>,
    separator: Option<Separator>,
    decimal: Option<Decimal>,
) -> Result<(), Invalid> {
    let keys = [
        ("header", header.map(|header| header.to_string())),
        ("separator", separator.map(|separator| as_written(&separator))),
        ("decimal", decimal.map(|decimal| as_written(&decimal))),
    ];
    if files.iter().any(|file| files::ending(file) == "csv") {
        return Ok(());
    }
    let remedy = format!("has no effect: none of {table}.files is a CSV");
    keys.into_iter().try_for_each(|(key, given)| absent(&format!("{table}.{key}"), given, &remedy))
}

/// Adds the record's number to an error message if the file contains several.
pub fn numbered(record: usize, count: usize, what: String) -> String {
    if count == 1 { what } else { format!("record {record}: {what}") }
}

/// Least step of a record, relative to the sample.
const FINEST: f64 = 1e-7;

/// Rejects a time step longer than a sample, a far shorter one, and a record shorter than an instant: probably a wrong unit.
pub fn check_step(pick: &Pick, record: &Record, time: spec::Time) -> Result<(), String> {
    let (dt, duration, key) = (record.dt, time.duration, pick.clock_key());
    let (lasts, instant) = (dt * (record.values[0].len() - 1) as f64, duration / time.samples as f64);
    let what = if dt > duration {
        "longer than a sample".to_owned()
    } else if dt < FINEST * duration {
        format!("less than {FINEST:e} of a sample")
    } else if lasts < 0.999 * instant {
        format!("in all {lasts:?} s, less than an instant of {instant} s")
    } else {
        return Ok(());
    };
    Err(format!("has a step of {dt:?} s, {what} (time.duration = {duration} s): check {key}"))
}

/// Rejects a record whose force lies outside the sample.
pub fn check_place(pick: &Pick, record: &Record, duration: f64) -> Result<(), String> {
    let Record { start, dt, values, .. } = record;
    let peak = |is_in_range: &dyn Fn(f64) -> bool| {
        let forces = values.iter().flat_map(|history| history.iter().enumerate());
        let forces = forces.filter(|(n, _)| is_in_range(start + *n as f64 * dt));
        forces.fold(0.0f64, |peak, (_, force)| peak.max(force.abs()))
    };
    // Forces are interpolated, so an entry acts within one step of it.
    let inside = peak(&|time| (-dt..=duration + dt).contains(&time));
    if inside >= CUT * peak(&|_| true) {
        return Ok(());
    }
    let (end, key) = (start + (values[0].len() - 1) as f64 * dt, pick.clock_key());
    Err(format!(
        "has its blow outside of the sample (0 to {duration} s; the record: {start:.4} to {end:.4} s): check {key}, \
         or set a trigger"
    ))
}

/// Checks that all records contain the same number of forces, and that `panels` is valid.
pub fn check_panels(
    recorded: &spec::Recorded,
    records: &[&Record],
    count: usize,
    panels: usize,
) -> Result<(), Invalid> {
    let held = records.first().map_or(1, |record| record.values.len());
    let alike = records.iter().all(|record| record.values.len() == held);
    let remedy = "all files must contain the same number of forces per record";
    require(alike, "stimuli.recorded.force", "mixed", remedy)?;
    let Some(struck) = &recorded.panels else { return Ok(()) };
    let remedy = match held {
        1 if struck.len() == count && struck.iter().all(|&k| k < panels) => return Ok(()),
        1 => format!("must name one of panels 0 to {} for each of {count} records", panels - 1),
        _ => format!("has no effect if a record contains {held} forces"),
    };
    Err(invalid("stimuli.recorded.panels", format!("{struck:?}"), remedy))
}

/// Rejects invalid keys, and files whose contents differ from the digest.
pub fn check(recorded: &spec::Recorded) -> Result<(), Invalid> {
    let key = |name: &str| format!("stimuli.recorded.{name}");
    let wrong = |name: &str, value: String, remedy: &str| Err(invalid(&key(name), value, remedy));
    if recorded.files.is_empty() {
        return wrong("files", "[]".into(), "must contain a file");
    }
    if recorded.time.is_some() == recorded.rate.is_some() {
        let given = recorded.rate.map_or(String::new(), |rate| rate.to_string());
        return wrong("rate", given, "set either time or rate");
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
            return wrong(name, format!("[{least}, {most}]"), "must be [min, max] with min ≤ max");
        }
    }
    if recorded.augment.scale == [0.0; 2] {
        return wrong("augment.scale", "[0, 0]".into(), "would leave no force: must not be 0");
    }
    check_form("stimuli.recorded", &recorded.files, recorded.header, recorded.separator, recorded.decimal)?;
    let Some(known) = &recorded.digest else { return Ok(()) };
    let now = digest(recorded)?;
    let remedy = format!("the contents of the files have changed (now {now})");
    if *known == now { Ok(()) } else { Err(invalid("stimuli.recorded.digest", known, remedy)) }
}

/// A unit of force in newtons.
pub fn newtons(unit: spec::ForceUnit) -> f64 {
    match unit {
        spec::ForceUnit::Newton => 1.0,
        spec::ForceUnit::Millinewton => 1e-3,
        spec::ForceUnit::Kilonewton => 1e3,
    }
}

/// Converts forces to newtons, removes the offset, and shifts the blow to the time of the trigger, `room` (s) by default. Returns
/// the shift (s).
pub fn align(recorded: &spec::Recorded, record: &mut Record, room: f64) -> Result<f64, String> {
    let factor = newtons(recorded.force_unit) * recorded.scale;
    let factors = vec![factor; record.values.len()];
    in_units("force", &mut record.values, &factors, recorded.remove_offset)?;
    let Some(trigger) = recorded.trigger else { return Ok(0.0) };
    let reached = |force: &Vec<f64>| force.iter().position(|f| f.abs() >= trigger.threshold);
    let Some(first) = record.values.iter().filter_map(reached).min() else {
        return Err(format!("never reaches the trigger threshold of {} N", trigger.threshold));
    };
    if first == 0 {
        let remedy = "set remove_offset = true, raise trigger.threshold, or leave trigger out";
        let reached = trigger.threshold;
        return Err(format!("has reached the trigger threshold of {reached} N at its first entry: {remedy}"));
    }
    let before = record.start;
    record.start = trigger.before.unwrap_or(room) - first as f64 * record.dt;
    Ok(record.start - before)
}

/// Multiplies each history by its factor; optionally subtracts its median first.
pub fn in_units(
    what: &str,
    values: &mut [Vec<f64>],
    factors: &[f64],
    remove_offset: bool,
) -> Result<(), String> {
    for (h, (history, factor)) in values.iter_mut().zip(factors).enumerate() {
        if let Some(n) = history.iter().position(|x| !x.is_finite()) {
            return Err(format!("entry {n} of {what} {h} is {}; must be a finite number", history[n]));
        }
        if history.is_empty() {
            return Err("contains a record without entries".into());
        }
        let offset = if remove_offset { median(history) } else { 0.0 };
        history.iter_mut().for_each(|x| *x = (*x - offset) * factor);
    }
    Ok(())
}

#[cfg(test)]
mod tests;
