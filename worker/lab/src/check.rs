//! Checks measured records before any fit for faults of instruments, units, axes, clocks and panels. Each fault has a remedy.

use metasense_schemas::spec::TrialSpec;
use metasense_worker::run::{NoResult, pool};

pub use crate::measured::read_raw as read;
use crate::measured::{Described, Raw};
use crate::modes::{Mode, slowest};
use crate::prepare::{check_design, placed};
use crate::questions::check::{
    CheckedRecord, ComparisonModel, Explanation, History, Instruments, Spectra, clipped, compare, spectra,
};

mod findings;

pub use findings::{Finding, Severity};

/// Result of a check of measured records.
#[derive(Debug, Clone)]
pub struct Checked {
    /// Findings, in the order of the checks.
    pub findings: Vec<Finding>,
    /// Channel names.
    pub channels: Vec<String>,
    /// The readable records.
    pub records: Vec<Looked>,
    /// Comparison with the model; `None` without a readable record or if the simulation fails.
    pub found: Option<Explanation>,
    /// Responses and natural frequencies; `None` without a readable record.
    pub spectra: Option<Spectra>,
    /// Slowest modes of the design; empty if it has none.
    pub modes: Vec<Mode>,
}

/// A readable record.
#[derive(Debug, Clone)]
pub struct Looked {
    /// Number of the record, from 0.
    pub number: usize,
    /// File, and number within the file.
    pub place: String,
    /// Forces (N) and signals (mm/s², rad/s).
    pub record: CheckedRecord,
    /// Properties measured from the record alone, without the model.
    pub instruments: Instruments,
    /// Largest deviation of a time step from the mean step of its clock, relative to the mean step.
    pub jitter: f64,
    /// Number of entries at an end of the range: per force, then per channel.
    pub clipped: [Vec<usize>; 2],
}

/// Largest rate of compared readings, relative to the trial's instants: faster ones are thinned.
const FASTEST: f64 = 2.0;
/// Number of modes listed.
const MODES: usize = 12;

/// Compares records with the model of a design.
///
/// # Errors
/// If the spec is invalid, or the design belongs to another body.
pub fn check(
    trial: &TrialSpec,
    design: &[f64],
    described: &Described,
    threads: usize,
) -> Result<Checked, NoResult> {
    let pool = pool(threads)?;
    let problem = placed(trial, &pool)?;
    check_design(&problem, design)?;
    let records = looked(described);
    let interval = trial.time.duration / (FASTEST * trial.time.samples as f64);
    let thinned = |Looked { record, .. }: &Looked| CheckedRecord {
        signals: record.signals.thinned(interval),
        ..record.clone()
    };
    let all: Vec<CheckedRecord> = records.iter().map(thinned).collect();
    let read: Vec<usize> = trial.sensors.read().iter().map(|channel| *channel as usize).collect();
    let model = ComparisonModel {
        scene: &problem.scene,
        design,
        solver: problem.solver,
        channels: &read,
        chip: problem.disturbance,
        pool: &pool,
    };
    let found = if all.is_empty() { None } else { compare(&model, &all) };
    let panels = problem.scene.panels.len();
    let spectra = (!all.is_empty()).then(|| spectra(&all, panels, problem.scene.duration));
    let channels = names(described, trial, &problem.scene.sensors);
    let findings = findings::findings(described, &channels, &records, found.as_ref(), &read);
    let modes = slowest(trial, design, MODES).unwrap_or_default();
    Ok(Checked { findings, channels, records, found, spectra, modes })
}

/// Name of each channel: its signal and sensor, and its column if the file names one per channel.
fn names(described: &Described, trial: &TrialSpec, sensors: &[usize]) -> Vec<String> {
    let columns =
        described.spec.signals.channels.as_deref().filter(|columns| columns.len() == trial.signals());
    let read = trial.sensors.read();
    let name = |c: usize| {
        let (m, kind) = (c / read.len(), read[c % read.len()]);
        let column = columns.map_or(String::new(), |columns| {
            format!(", column {}", metasense_worker::invalid::as_written(&columns[c]))
        });
        format!("{} of sensor {m} (unit {}{column})", kind.symbol(), sensors[m])
    };
    (0..trial.signals()).map(name).collect()
}

fn looked(described: &Described) -> Vec<Looked> {
    let raw: Vec<(usize, &Raw)> = described
        .records
        .iter()
        .filter_map(|(number, record)| Some(((*number)?, record.as_ref().ok()?)))
        .collect();
    let history = |of: &metasense_worker::records::Record| History {
        start: of.start,
        dt: of.dt,
        values: of.values.clone(),
    };
    let ends = |kind: usize| -> Vec<Vec<usize>> {
        let columns = raw.iter().map(|(_, raw)| raw.read[kind].len()).max().unwrap_or(0);
        let of = |c: usize| {
            let histories: Vec<&[f64]> =
                raw.iter().map(|(_, raw)| raw.read[kind].get(c).map_or(&[][..], |h| h)).collect();
            clipped(&histories)
        };
        (0..columns).map(of).collect()
    };
    let ends = [ends(0), ends(1)];
    let look = |(i, (number, raw)): (usize, &(usize, &Raw))| {
        let record =
            CheckedRecord { force: history(&raw.force), panel: raw.panel, signals: history(&raw.signal) };
        Looked {
            number: *number,
            place: raw.place.clone(),
            instruments: Instruments::of(&record),
            record,
            jitter: raw.force.jitter.max(raw.signal.jitter),
            clipped: ends.each_ref().map(|kind| kind.iter().map(|of| of[i]).collect()),
        }
    };
    raw.iter().enumerate().map(look).collect()
}

#[cfg(test)]
mod tests;
