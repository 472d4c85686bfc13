//! Measured records looked at before any fit: what instruments, units, axes, clocks and panels may have wrong, each with its remedy.

use metasense_numerics::check::{
    Found, History, Instruments, Model, Record, Spectra, clipped, compare, spectra,
};
use metasense_schemas::spec::TrialSpec;

pub use crate::measured::read_raw as read;
use crate::measured::{Described, Raw};
use crate::modes::{Mode, slowest};
use crate::run::{Failure, check_design, placed, pool};

mod findings;

pub use findings::{Finding, Level};

/// What a look at records has found.
#[derive(Debug, Clone)]
pub struct Checked {
    /// In the order of the checks.
    pub findings: Vec<Finding>,
    /// Names of the channels.
    pub channels: Vec<String>,
    /// Those that can be read.
    pub records: Vec<Looked>,
    /// Compared with the model, if a record can be read and the model simulated.
    pub found: Option<Found>,
    /// Responses and ringing, if a record can be read.
    pub spectra: Option<Spectra>,
    /// The design's slowest modes; empty if it has none.
    pub modes: Vec<Mode>,
}

/// One record.
#[derive(Debug, Clone)]
pub struct Looked {
    /// Its number, from 0.
    pub number: usize,
    /// File, and number in the file.
    pub place: String,
    /// In N, mm/s² and rad/s.
    pub record: Record,
    /// Without a model.
    pub instruments: Instruments,
    /// Deviation of the least even step of its clocks from the mean step, relative to that.
    pub jitter: f64,
    /// Entries of the forces, and of each channel, at an end of the range.
    pub clipped: [Vec<usize>; 2],
}

/// Modes of the design that are listed.
const MODES: usize = 12;

/// Compares them with the body's model.
///
/// # Errors
/// If the spec stands for no trial, or the design is of another body.
pub fn check(
    trial: &TrialSpec,
    design: &[f64],
    described: &Described,
    threads: usize,
) -> Result<Checked, Failure> {
    let pool = pool(threads)?;
    let problem = placed(trial, &pool)?;
    check_design(&problem, design)?;
    let records = looked(described);
    let all: Vec<Record> = records.iter().map(|looked| looked.record.clone()).collect();
    let read: Vec<usize> = trial.sensors.read().iter().map(|channel| *channel as usize).collect();
    let model = Model {
        scene: &problem.scene,
        design,
        solver: problem.solver,
        channels: &read,
        delay: problem.disturbance.map_or(0.0, |chip| chip.delay),
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

/// Names of channels: as signals of sensors, with their columns if the file names one for each.
fn names(described: &Described, trial: &TrialSpec, sensors: &[usize]) -> Vec<String> {
    let columns =
        described.spec.signals.channels.as_deref().filter(|columns| columns.len() == trial.signals());
    let read = trial.sensors.read();
    let name = |c: usize| {
        let (m, kind) = (c / read.len(), read[c % read.len()]);
        let column = columns
            .map_or(String::new(), |columns| format!(", column {}", crate::invalid::as_written(&columns[c])));
        format!("{} of sensor {m} (unit {}{column})", kind.symbol(), sensors[m])
    };
    (0..trial.signals()).map(name).collect()
}

fn looked(described: &Described) -> Vec<Looked> {
    let raw: Vec<(usize, &Raw)> = described
        .records
        .iter()
        .enumerate()
        .filter_map(|(n, record)| Some((n, record.as_ref().ok()?)))
        .collect();
    let history =
        |of: &crate::records::Record| History { start: of.start, dt: of.dt, values: of.values.clone() };
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
        let record = Record { force: history(&raw.force), panel: raw.panel, signals: history(&raw.signal) };
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
