//! Measured records: forces, and the signals of a body's sensors, on the clock of a trial.
//!
//! A TOML file (`keys::Measured`) describes the columns. A trigger shifts a whole record. Signals at the rate of the trial's
//! clock are not interpolated: the record is shifted by less than half a step, so that readings fall on instants. Signals at
//! another rate pass a low-pass, with their first and last value held outside the record.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use metasense_numerics::dynamics::Forces;
use metasense_numerics::identify::{between, margin};
use metasense_numerics::stimuli::{anti_aliased, resample};
use metasense_schemas::spec::{self, Augment, Channel, Resample, TrialSpec};
use metasense_source::{Source, SpecError};
use metasense_worker::files::Form;
use metasense_worker::invalid::{Invalid, invalid, positive};
use metasense_worker::records::{self, Pick, Record, fingerprint};

mod keys;

pub use keys::{AccelerationUnit, AngularVelocityUnit, SignalStart};

/// Returns the JSON schema of a file of measured records.
pub fn measured_schema() -> serde_json::Value {
    schemars::schema_for!(keys::Measured).to_value()
}

/// Measured records of one body.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// Forces (N, K, R + 1) (N), on the clock of the trial's forces.
    pub forces: Forces,
    /// Signals (N, T, channels) (mm/s², rad/s).
    pub signals: Vec<f64>,
    /// Whether targets on a finer clock of the forces pass a low-pass.
    pub low_pass: bool,
    /// Sampling rate (1/s) of the first signals that were resampled; `None`: none were.
    pub resampled: Option<f64>,
    /// `signals.start` of each record (s); empty: the clocks are exact.
    pub starts: Vec<f64>,
    /// Standard deviation of the unknown clock error (s).
    pub start_deviation: f64,
}

impl Measured {
    /// Simulated signals, which share the clock of the forces.
    pub fn of(forces: Forces, signals: Vec<f64>, low_pass: bool) -> Self {
        Self { forces, signals, low_pass, resampled: None, starts: Vec::new(), start_deviation: 0.0 }
    }

    /// Note for users about resampled signals.
    pub fn note(&self, trial: &TrialSpec) -> Option<String> {
        let (rate, spec::Time { duration, samples, .. }) = (self.resampled?, trial.time);
        Some(format!(
            "signals of {rate:.4} readings per second are resampled onto time.samples = {samples} in {duration} s; aliased signals are \
             wrong between readings. Set time.samples = {:.0} to compare the original readings",
            duration * rate
        ))
    }
}

/// Failure to read records.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum MeasuredError {
    /// The file that describes them is unreadable.
    #[error("cannot read {}", path.display())]
    Unreadable { path: PathBuf, source: std::io::Error },
    /// A key is invalid.
    #[error(transparent)]
    Spec(#[from] SpecError),
}

/// A record before resampling.
#[derive(Debug, Clone)]
pub struct Raw {
    /// File name, and the record's number if the file contains several.
    pub place: String,
    /// Force (N) and signals (mm/s², rad/s), with time 0 at the start of the sample.
    pub(crate) force: Record,
    pub(crate) signal: Record,
    /// Values of forces and signals as in the file.
    pub read: [Vec<Vec<f64>>; 2],
    /// The struck panel, for a record with a single history.
    pub panel: Option<usize>,
    /// `signals.start` of the record (s).
    pub start: f64,
}

/// The records of a description.
pub struct Described {
    /// The description.
    pub spec: keys::Measured,
    /// Per record or unreadable file, in file order: its first number, if known, and the data or the fault.
    pub records: Vec<(Option<usize>, Result<Raw, String>)>,
}

/// Parses a description of records.
fn described(file: &Path) -> Result<(Source, keys::Measured), MeasuredError> {
    let text = std::fs::read_to_string(file)
        .map_err(|source| MeasuredError::Unreadable { path: file.to_owned(), source })?;
    let source = Source::new(file, text)?;
    let mut spec: keys::Measured = source.parse()?;
    let folder = file.parent().unwrap_or(Path::new(""));
    let paths = spec.recorded.files.iter_mut().chain(spec.signals.files.iter_mut().flatten());
    paths.for_each(|path| *path = folder.join(&path));
    Ok((source, spec))
}

fn refused(source: &Source, Invalid { key, value, remedy }: Invalid) -> MeasuredError {
    let key = key.strip_prefix("stimuli.").unwrap_or(&key);
    source.error_with(key, Some(&value), &remedy).into()
}

/// Reads the records that `file` (TOML) describes, for a trial's panels, sensors and clock.
///
/// # Errors
/// Names file, key and value of what is invalid or does not fit the trial.
pub fn read(file: &Path, trial: &TrialSpec) -> Result<Measured, MeasuredError> {
    let (source, spec) = described(file)?;
    measured(&spec, trial).map_err(|invalid| refused(&source, invalid))
}

/// Reads the same records without resampling. A record that [`read`] rejects becomes an error text.
///
/// # Errors
/// Names file, key and value of faults that concern all records.
pub fn read_raw(file: &Path, trial: &TrialSpec) -> Result<Described, MeasuredError> {
    let (source, spec) = described(file)?;
    let refuse = |invalid: Invalid| refused(&source, invalid);
    let mut records = Vec::new();
    let count = raw(&spec, trial, false, &mut |number, record| {
        records.push((number, record.map_err(|invalid| refuse(invalid).to_string())));
        Ok(())
    });
    let count = count.map_err(refuse)?;
    let forces: Vec<&Record> = records.iter().flat_map(|(_, raw)| raw).map(|raw: &Raw| &raw.force).collect();
    check_counts(&spec, &forces, count, trial).map_err(refuse)?;
    Ok(Described { spec, records })
}

/// Passes each record or its fault, with its number if known, to `each`, which may reject it. `whole`: signals must cover the
/// sample. Returns the number of records, if known: that of an unreadable file is one if keys have no other number of entries.
fn raw(
    spec: &keys::Measured,
    trial: &TrialSpec,
    whole: bool,
    each: &mut dyn FnMut(Option<usize>, Result<Raw, Invalid>) -> Result<(), Invalid>,
) -> Result<Option<usize>, Invalid> {
    let keys::Measured { recorded, signals } = spec;
    check(recorded, signals, trial)?;
    let (panels, channels, duration) = (trial.panel_units.len(), trial.signals(), trial.time.duration);
    let picks = [Pick::forces(recorded, "recorded"), pick(recorded, signals, channels)];
    let [of_forces, of_signals] = picks.each_ref().map(Pick::read);
    let keys::MeasuredSignals { header, separator, decimal, .. } = *signals;
    let own = Form { header, separator, decimal, read: of_signals.clone(), keys: Some("signals") };
    let read = match &signals.files {
        Some(_) => of_forces,
        None => of_forces.zip(of_signals).map(|(forces, signals)| [forces, signals].concat()),
    };
    let form = Form::of_forces(recorded, "recorded", read);
    let starts = match &signals.start {
        Some(SignalStart::Each(starts)) => Some(starts.len()),
        _ => None,
    };
    let entries = [starts, recorded.panels.as_ref().map(Vec::len)];
    let unread = entries.into_iter().flatten().all(|entries| entries == recorded.files.len()).then_some(1);
    let (mut seen, mut number) = (Seen::new(), Some(0));
    for (n, file) in recorded.files.iter().enumerate() {
        let wrong = |what: String| records::file_error(file, what);
        let beside = signals.files.as_ref().map(|files| &files[n]);
        let wrong_beside =
            |what: String| beside.map_or_else(|| wrong(what.clone()), |file| faulty(file, &*what));
        let of_file = || {
            let held = records::open(file, &form).map_err(wrong)?;
            let of_file = records::forces(&picks[0], &held, panels).map_err(wrong)?;
            let read = match beside {
                Some(file) => records::open(file, &own).and_then(|held| records::of_file(&picks[1], &held)),
                None => records::of_file(&picks[1], &held),
            };
            let read = read.map_err(wrong_beside)?;
            if read.len() != of_file.len() {
                let what =
                    format!("contains signals of {} records, but forces of {}", read.len(), of_file.len());
                return Err(wrong_beside(what));
            }
            Ok((of_file, read))
        };
        let unknown = || {
            wrong("is not checked: a file before it is unreadable, which hides its panels and starts".into())
        };
        let held = of_file().and_then(|(of_file, read)| Ok((of_file, read, number.ok_or_else(unknown)?)));
        let (of_file, read, first) = match held {
            Ok(held) => held,
            Err(invalid) => {
                each(number, Err(invalid))?;
                number = number.zip(unread).map(|(number, unread)| number + unread);
                continue;
            }
        };
        let count = read.len();
        number = Some(first + count);
        for (i, (mut force, mut signal)) in of_file.into_iter().zip(read).enumerate() {
            let wrong = |what| wrong(records::numbered(i, count, what));
            let wrong_beside = |what| wrong_beside(records::numbered(i, count, what));
            let start = signals.start.as_ref().map_or(0.0, |start| start.time_of(first + i));
            let place = format!("{:?}, record {i}", beside.unwrap_or(file).display().to_string());
            let one = || {
                fit(signals, &force, &signal, trial).map_err(wrong_beside)?;
                records::check_step(&picks[0], &force, trial.time).map_err(wrong)?;
                records::check_step(&picks[1], &signal, trial.time).map_err(wrong_beside)?;
                signal.start += start;
                check_copies(&mut seen, &force, &signal, place).map_err(wrong_beside)?;
                let read = [force.values.clone(), signal.values.clone()];
                let later = records::align(recorded, &mut force, 0.0).map_err(wrong)?;
                signal.start += later;
                records::in_units(
                    "signal",
                    &mut signal.values,
                    &factors(signals, trial),
                    recorded.remove_offset,
                )
                .map_err(wrong_beside)?;
                records::check_place(&picks[0], &force, duration).map_err(wrong)?;
                if whole {
                    check_span(&force, &signal, duration, trial.time.samples).map_err(wrong_beside)?;
                }
                let panel = recorded.panels.as_ref().and_then(|struck| struck.get(first + i).copied());
                let name = beside.unwrap_or(file).file_name().unwrap_or_default().display();
                let place = if count == 1 { name.to_string() } else { format!("{name}, record {i}") };
                Ok(Raw { place, force, signal, read, panel, start })
            };
            each(Some(first + i), one())?;
        }
    }
    Ok(number)
}

fn measured(spec: &keys::Measured, trial: &TrialSpec) -> Result<Measured, Invalid> {
    let keys::Measured { recorded, signals } = spec;
    let panels = trial.panel_units.len();
    let (duration, instants) = (trial.time.duration, trial.time.samples);
    let (mut forces, mut readings, mut starts) = (Vec::new(), Vec::new(), Vec::new());
    raw(spec, trial, true, &mut |_, record| {
        let Raw { mut force, mut signal, start, .. } = record?;
        let first = on_instants(&mut force, &mut signal, duration / instants as f64);
        starts.push(start);
        forces.push(force);
        readings.push((signal, first));
        Ok(())
    })?;
    check_counts(spec, &forces.iter().collect::<Vec<_>>(), Some(forces.len()), trial)?;
    let own = trial.stimuli.force_samples.unwrap_or(instants);
    // the force of a hammer is smooth between its entries
    let is_smooth =
        |record: &Record| recorded.resample == Resample::Antialias && record.dt >= duration / own as f64;
    let mut values = Vec::with_capacity(forces.len() * panels * (own + 1));
    for (n, record) in forces.iter().enumerate() {
        let struck = recorded.panels.as_ref().map(|struck| struck[n]);
        let clock: records::Resampler =
            if is_smooth(record) { smoothly } else { records::clock(recorded.resample) };
        for panel in 0..panels {
            let history = match struck {
                Some(struck) => record.values.first().filter(|_| panel == struck),
                None => record.values.get(panel),
            };
            match history {
                Some(force) => values.extend(clock(force, record.start, record.dt, duration, own)),
                None => values.resize(values.len() + own + 1, 0.0),
            }
        }
    }
    let forces_on_clock =
        Forces { samples: forces.len(), panels, instants: own, values, strikes: Vec::new() };
    check_margin(signals.start_deviation.unwrap_or(0.0), &forces_on_clock, trial.time)?;
    let low_pass = recorded.resample == Resample::Antialias;
    let clock = if low_pass { anti_aliased } else { resample };
    let read = |(record, first): &(Record, Option<i64>)| -> Vec<f64> {
        let delta = duration / instants as f64;
        let on_clock = |history: &Vec<f64>| {
            if let Some(first) = first {
                let last = history.len() as i64 - 1;
                return (0..=instants as i64).map(|n| history[(n - first).clamp(0, last) as usize]).collect();
            }
            let (start, held) = held(record, history, duration, delta);
            clock(&held, start, record.dt, duration, instants)
        };
        let histories: Vec<Vec<f64>> = record.values.iter().map(on_clock).collect();
        (1..=instants).flat_map(|n| histories.iter().map(move |h| h[n])).collect()
    };
    let resampled = readings.iter().find(|(_, first)| first.is_none()).map(|(signal, _)| 1.0 / signal.dt);
    Ok(Measured {
        resampled,
        starts,
        start_deviation: signals.start_deviation.unwrap_or(0.0),
        signals: readings.iter().flat_map(read).collect(),
        forces: forces_on_clock,
        low_pass,
    })
}

/// Least number of readings between the start of a force and the uncertain end of a sample.
const JUDGED: f64 = 4.0;
/// Least number of simulated instants per reading if clocks are uncertain.
const FINER: usize = 4;

/// Rejects a clock uncertainty that leaves too few usable readings after some force.
fn check_margin(deviation: f64, forces: &Forces, time: spec::Time) -> Result<(), Invalid> {
    let delta = time.duration / time.samples as f64;
    let margin = if deviation > 0.0 { margin(deviation, delta, FINER) as f64 * delta } else { return Ok(()) };
    for i in 0..forces.samples {
        let all = forces.sample(i);
        let peak = all.iter().fold(0.0f64, |peak, f| peak.max(f.abs()));
        let begun = |history: &[f64]| history.iter().position(|f| f.abs() > records::CUT * peak);
        let Some(first) = all.chunks(forces.instants + 1).filter_map(begun).min() else { continue };
        let struck = first as f64 * time.duration / forces.instants as f64;
        if struck + JUDGED * delta > time.duration - margin {
            let remedy = format!(
                "leaves too few readings of record {i}: its force begins at {struck:.4} s, and the last {margin:.4} s of a sample may be \
                 late; reduce start_deviation, increase time.duration, or use a trigger that moves the blow earlier"
            );
            return Err(invalid("signals.start_deviation", deviation, remedy));
        }
    }
    Ok(())
}

/// Checks the lengths of keys with one entry per record; `count`: number of records, if known.
fn check_counts(
    keys::Measured { recorded, signals }: &keys::Measured,
    forces: &[&Record],
    count: Option<usize>,
    trial: &TrialSpec,
) -> Result<(), Invalid> {
    let panels = trial.panel_units.len();
    let Some(first) = forces.first() else {
        return if count == Some(0) {
            Err(records::file_error(&recorded.files[0], "contains no records"))
        } else {
            Ok(())
        };
    };
    if let (Some(SignalStart::Each(given)), Some(count)) = (&signals.start, count)
        && given.len() != count
    {
        let remedy = format!("must be one number, or one for each of the {count} records");
        return Err(invalid("signals.start", format!("{} numbers", given.len()), remedy));
    }
    let count = count.unwrap_or(recorded.panels.as_ref().map_or(0, Vec::len));
    records::check_panels(recorded, forces, count, panels)?;
    if first.values.len() < panels && recorded.panels.is_none() {
        let remedy = format!("must name the panel, from 0 to {}, that each record strikes", panels - 1);
        return Err(invalid("stimuli.recorded.panels", "", remedy));
    }
    Ok(())
}

fn faulty(file: &Path, what: impl Into<String>) -> Invalid {
    invalid("signals.files", format!("{:?}", file.display().to_string()), what)
}

/// Per hash of signals: the hash of their forces, and their location.
type Seen = HashMap<blake3::Hash, (blake3::Hash, String)>;

/// Rejects signals that equal a force or repeat an earlier record: a copy would train and test the same decoder.
fn check_copies(seen: &mut Seen, force: &Record, signal: &Record, place: String) -> Result<(), String> {
    let is_some = |values: &[f64]| values.iter().any(|x| *x != 0.0);
    if let Some(c) = signal.values.iter().position(|signal| is_some(signal) && force.values.contains(signal))
    {
        return Err(format!(
            "signal {c} equals the force, so a decoder would copy it: check signals.channels"
        ));
    }
    let [own_force, own_signal] = [force, signal].map(|record| fingerprint(&record.values.concat()));
    let some = [force, signal].map(|record| record.values.iter().any(|values| is_some(values)));
    if let Some((other, first)) = seen.get(&own_signal) {
        if *other == own_force && (some[0] || some[1]) {
            return Err(format!(
                "is the same record as {first}: a copy would train and test the same decoder"
            ));
        }
        if some[1] {
            return Err(format!("contains the signals of {first} under another force"));
        }
    }
    seen.entry(own_signal).or_insert((own_force, place));
    Ok(())
}

fn check(
    recorded: &spec::Recorded,
    signals: &keys::MeasuredSignals,
    trial: &TrialSpec,
) -> Result<(), Invalid> {
    records::check(recorded)?;
    let wrong =
        |key: &str, value: String, remedy: String| Err(invalid(&format!("signals.{key}"), value, remedy));
    if recorded.augment != Augment::default() {
        let remedy = "must be left out: measured records are used unchanged";
        return Err(invalid("stimuli.recorded.augment", "{ … }", remedy));
    }
    if let Some(files) = signals.files.as_ref().filter(|files| files.len() != recorded.files.len()) {
        let remedy =
            format!("must contain one file for each of the {} in recorded.files", recorded.files.len());
        return wrong("files", format!("{} files", files.len()), remedy);
    }
    if signals.time.is_some() && signals.rate.is_some() {
        let remedy = "set either time or rate".into();
        return wrong("rate", signals.rate.map_or(String::new(), |rate| rate.to_string()), remedy);
    }
    signals.rate.map_or(Ok(()), |rate| positive("signals.rate", rate))?;
    if signals.time_unit.is_some() && signals.time.is_none() {
        return wrong(
            "time_unit",
            String::new(),
            "has no effect without signals.time: set recorded.time_unit".into(),
        );
    }
    let files = signals.files.as_deref().unwrap_or_default();
    records::check_form("signals", files, signals.header, signals.separator, signals.decimal)?;
    let starts = match &signals.start {
        Some(SignalStart::Each(starts)) => starts,
        start => &start.iter().map(|start| start.time_of(0)).collect(),
    };
    if let Some(start) = starts.iter().find(|start| !start.is_finite()) {
        return wrong("start", start.to_string(), "must be a finite number (s)".into());
    }
    let most = trial.time.duration / 10.0;
    if let Some(deviation) = signals.start_deviation.filter(|s| !(0.0..=most).contains(s)) {
        let remedy = format!("must lie between 0 and {most} s, a tenth of time.duration");
        return wrong("start_deviation", deviation.to_string(), remedy);
    }
    let channels = trial.signals();
    match &signals.factors {
        Some(factors) if factors.len() != channels || factors.iter().any(|f| !f.is_finite() || *f == 0.0) => {
            let remedy = format!("must be {channels} numbers other than 0, one per channel");
            wrong("factors", format!("{factors:?}"), remedy)
        }
        _ => Ok(()),
    }
}

/// Signals of a file; without a clock of their own they use that of the forces.
fn pick<'a>(recorded: &'a spec::Recorded, signals: &'a keys::MeasuredSignals, channels: usize) -> Pick<'a> {
    let (time, rate) = match (&signals.time, signals.rate) {
        (None, None) => (recorded.time.as_ref(), recorded.rate),
        (time, rate) => (time.as_ref(), rate),
    };
    Pick {
        key: "signals.channels",
        signals: signals.channels.as_deref(),
        time,
        rate,
        unit: signals.time_unit.unwrap_or(recorded.time_unit),
        clock: if signals.time.is_some() || signals.rate.is_some() { "signals" } else { "recorded" },
        count: Some(channels),
    }
}

/// Checks the number of signals, and their length if they share the clock of the forces.
fn fit(
    signals: &keys::MeasuredSignals,
    force: &Record,
    signal: &Record,
    trial: &TrialSpec,
) -> Result<(), String> {
    if signal.values.len() != trial.signals() {
        let (held, channels) = (signal.values.len(), trial.signals());
        let read: Vec<&str> = trial.sensors.read().iter().map(|channel| channel.name()).collect();
        let read = read.join(", ");
        return Err(format!("contains {held} signals per record; must be {channels}: {read} of each sensor"));
    }
    let shared = signals.time.is_none() && signals.rate.is_none() && signals.start.is_none();
    let (found, expected) = (signal.values[0].len(), force.values[0].len());
    if shared && found != expected {
        return Err(format!(
            "contains {found} entries of signals and {expected} of force: set the clock of the signals with signals.start, .rate or .time"
        ));
    }
    Ok(())
}

/// Factor per channel to mm/s² and rad/s.
fn factors(signals: &keys::MeasuredSignals, trial: &TrialSpec) -> Vec<f64> {
    let units = [signals.acceleration_unit.factor(), signals.angular_velocity_unit.factor()];
    let own = |c: usize| signals.factors.as_ref().map_or(1.0, |factors| factors[c]);
    let read = trial.sensors.read().iter().cycle().take(trial.signals()).enumerate();
    read.map(|(c, channel)| units[usize::from(*channel == Channel::Omega)] * own(c)).collect()
}

/// Rejects signals that begin after the force or end before the sample, with a tolerance of one instant: the missing readings
/// would be invented.
fn check_span(force: &Record, signal: &Record, duration: f64, instants: usize) -> Result<(), String> {
    let end = signal.start + (signal.values[0].len() - 1) as f64 * signal.dt;
    let instant = 1.000_001 * duration / instants as f64;
    let peak = force.values.iter().flatten().fold(0.0f64, |peak, f| peak.max(f.abs()));
    let begins = force
        .values
        .iter()
        .filter_map(|history| history.iter().position(|f| f.abs() > records::CUT * peak))
        .min();
    let struck = begins.map_or(f64::INFINITY, |n| force.start + n as f64 * force.dt);
    if signal.start > duration.min(struck.max(0.0)) + instant.max(signal.dt) {
        let force = if begins.is_some() { format!(", the force at {struck:.4} s") } else { String::new() };
        return Err(format!(
            "contains signals that begin at {:.4} s of a sample{force}: check signals.start",
            signal.start
        ));
    }
    if end >= duration - instant {
        return Ok(());
    }
    Err(format!(
        "contains signals that end at {end:.4} s, but a sample lasts {duration} s: reduce time.duration, \
         or use a trigger that moves the blow later"
    ))
}

/// Largest drift between readings and instants over a record, in steps.
const DRIFT: f64 = 0.05;

/// Shifts force and signals by less than half a step, so that readings fall on the instants 0, Δ, 2Δ, …: readings with aliased
/// content cannot be interpolated, forces can. Returns the instant of the first reading; `None` if the time steps differ.
fn on_instants(force: &mut Record, signal: &mut Record, delta: f64) -> Option<i64> {
    let drift = (signal.dt - delta).abs() * (signal.values[0].len() - 1) as f64;
    if drift > DRIFT * delta {
        return None;
    }
    let first = (signal.start / delta).round();
    force.start += first * delta - signal.start;
    signal.start = first * delta;
    Some(first as i64)
}

/// Interpolates a force smoothly at t_n; alternative to `resample`.
fn smoothly(record: &[f64], start: f64, dt: f64, duration: f64, instants: usize) -> Vec<f64> {
    (0..=instants).map(|n| between(record, (n as f64 * duration / instants as f64 - start) / dt)).collect()
}

/// Extends a history by its first and last value over the reach of the low-pass. Returns the new start and the values.
fn held(record: &Record, history: &[f64], duration: f64, delta: f64) -> (f64, Vec<f64>) {
    const REACH: f64 = 13.0;
    let end = record.start + (history.len() - 1) as f64 * record.dt;
    let missing = |time: f64| (time / record.dt).ceil().max(0.0) as usize;
    let (before, after) = (missing(record.start + REACH * delta), missing(duration + REACH * delta - end));
    let mut held = vec![history[0]; before];
    held.extend(history);
    held.resize(held.len() + after, history[history.len() - 1]);
    (record.start - before as f64 * record.dt, held)
}

#[cfg(test)]
mod tests;
