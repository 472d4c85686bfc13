//! Lower bound on the memory of a trial, and the memory available to a process on this machine.
//!
//! ```text
//! forces N K (R + 1)     signals N (T′ 3M + T (C + K))     states S T′ 6U     linear decoder T² + 3D²/2     (8 bytes each)
//! ```
//! N samples of K panels; R instants of the forces, T of the readings, T′ of the motion; M sensors with C channels in total; S
//! samples and U units of a gradient; D unknowns of a decoder. Counts only arrays that exist at the same time, so a rejected
//! trial cannot run.

use metasense_schemas::spec::{BrainKind, Protocol, Search, TrialSpec};
use rustix::process::{Resource, getrlimit};
use std::path::PathBuf;

use crate::invalid::{Invalid, invalid};
use crate::limits::{field, memory_limit, own_groups};
use crate::problem::{instants, lags, layout};

/// A memory limit and its source.
#[derive(Debug, Clone, PartialEq)]
pub struct MemoryLimit {
    /// Source and verb, such as "ulimit -v allows".
    pub name: &'static str,
    /// Size (bytes).
    pub bytes: f64,
}

/// The smallest limit of this machine, its control group, its ulimits and `[run] memory` (MiB).
pub fn limit(of_run: Option<u64>) -> Option<MemoryLimit> {
    let info = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let machine = field(&info, "MemTotal:")
        .map(|total| 1024.0 * (total + field(&info, "SwapTotal:").unwrap_or(0)) as f64);
    let own = |resource| getrlimit(resource).current.map(|bytes| bytes as f64);
    let all = [
        ("this machine has", machine),
        ("its control group (cgroup) allows", of_groups(&own_groups("memory"))),
        ("ulimit -v allows", own(Resource::As)),
        ("ulimit -d allows", own(Resource::Data)),
        ("run.memory allows", of_run.map(|mebibytes| 1_048_576.0 * mebibytes as f64)),
    ];
    let known = all.into_iter().filter_map(|(name, bytes)| Some(MemoryLimit { name, bytes: bytes? }));
    known.min_by(|a, b| a.bytes.total_cmp(&b.bytes))
}

/// The smallest limit of these control groups.
fn of_groups(groups: &[PathBuf]) -> Option<f64> {
    groups.iter().filter_map(|group| memory_limit(group)).min().map(|bytes| bytes as f64)
}

/// An item of memory: the key that multiplies it, the key's value, the content, the size (bytes).
type Part = (&'static str, usize, &'static str, f64);

/// Normal equations in memory: of five bodies and five folds, their sum, a difference and its factor.
const MATRICES: f64 = 13.0;

/// The larger of two lists for a trial on a body of `units` units: arrays of its outer steps, or of the final comparison.
fn parts(trial: &TrialSpec, units: usize) -> Vec<Part> {
    let (stimuli, evaluation) = (&trial.stimuli, &trial.evaluation);
    let optimise = trial.optimise.clone().resolved();
    let f = |n: usize| n as f64;
    let (samples, panels, readings) = (stimuli.samples, f(trial.point.panels), f(trial.time.samples));
    let clock = f(stimuli.force_samples.unwrap_or(trial.time.samples)) + 1.0;
    let searched =
        trial.sensor_units.is_empty() && trial.sensors.search.is_some_and(|search| search != Search::Random);
    // The search simulates one sensor per candidate. Candidates lie inside the body, at least a quarter of the units.
    let sensors = if searched { trial.point.sensors.max(units / 4) } else { trial.point.sensors };
    let signals_read = trial.sensors.read().len() * sensors;
    let channels = f(signals_read);
    let moving = f(instants(trial));
    let forces = |count: f64| 8.0 * count * panels * clock;
    let signals = |count: f64| 8.0 * count * (moving * f(3 * sensors) + readings * (channels + panels));
    let states = |count: f64| 48.0 * count * moving * f(units);
    let mut always: Vec<Part> =
        vec![("stimuli.samples", samples, "histories of the forces", forces(f(samples)))];
    if trial.brain.kind != BrainKind::Cnn || optimise.linear() {
        let unknowns = f(lags(&trial.time, trial.brain.memory).unknowns(signals_read));
        // products of two channels; the normal matrix, and its lower triangle by pairs of channels
        let bytes = 8.0 * (readings * readings + 1.5 * unknowns * unknowns);
        always.push(("sweep.sensors", trial.point.sensors, "the linear decoder", bytes));
    }

    let trained = f(samples.saturating_sub(stimuli.test));
    let mut steps = always.clone();
    steps.push(("stimuli.samples", samples, "signals", signals(trained)));
    if optimise.steps() > 0 {
        let batch = optimise.batch.unwrap_or(1);
        match optimise.protocol {
            Protocol::Paper => {
                steps.push(("stimuli.samples", samples, "states of a gradient", states(f(samples))));
            }
            Protocol::Joint => {
                let drawn = f(optimise.casts.unwrap_or(1)) * f(batch);
                let bytes = forces(drawn) + signals(drawn) + states(drawn);
                steps.push(("optimise.batch", batch, "samples of a step", bytes));
                if optimise.linear() {
                    let groups = lags(&trial.time, trial.brain.memory).training_groups(signals_read);
                    let bytes = MATRICES * 8.0 * f(groups.len() * signals_read).powi(2);
                    steps.push(("sweep.sensors", trial.point.sensors, "normal equations", bytes));
                }
            }
            Protocol::Random => {}
        }
    }

    let mut comparison = always;
    comparison.push(("stimuli.samples", samples, "signals", signals(f(samples))));
    let holdout = f(stimuli.holdout);
    let bytes = forces(holdout) + signals(holdout);
    comparison.push(("stimuli.holdout", stimuli.holdout, "forces and signals", bytes));
    if matches!(trial.brain.kind, BrainKind::Cnn | BrainKind::Stacked) {
        let losses = |iterations: usize| 4.0 * f(evaluation.networks()) * f(iterations);
        let (iterations, long) = (trial.brain.iterations, evaluation.long_iterations.unwrap_or(0));
        comparison.push(("brain.iterations", iterations, "losses", losses(iterations)));
        comparison.push(("evaluation.long_iterations", long, "losses", losses(long)));
    }
    if sum(&steps) > sum(&comparison) { steps } else { comparison }
}

fn sum(parts: &[Part]) -> f64 {
    parts.iter().map(|part| part.3).sum()
}

/// Rejects a trial on a body of `units` units that needs more memory than the limit.
///
/// # Errors
/// Names the key that multiplies the largest item.
pub fn check(trial: &TrialSpec, units: usize, limit: Option<&MemoryLimit>) -> Result<(), Invalid> {
    refuse(parts(trial, units), limit)
}

/// Rejects a simulation whose states exceed this machine's memory, counted twice: on the tape and as returned.
///
/// # Errors
/// Names the number of samples.
pub fn check_states(samples: usize, instants: usize, units: usize) -> Result<(), Invalid> {
    let bytes = 96.0 * samples as f64 * instants as f64 * units as f64;
    refuse(vec![("forces: samples", samples, "displacements and velocities", bytes)], limit(None).as_ref())
}

fn refuse(parts: Vec<Part>, limit: Option<&MemoryLimit>) -> Result<(), Invalid> {
    let Some(MemoryLimit { name, bytes }) = limit else { return Ok(()) };
    let all = sum(&parts);
    let most = parts.into_iter().max_by(|a, b| a.3.total_cmp(&b.3));
    match most.filter(|_| all > *bytes) {
        None => Ok(()),
        Some((key, value, what, part)) => {
            let [all, part, bytes] = [all, part, *bytes].map(readable);
            let remedy = format!(
                "a worker needs at least {all} of memory, {part} of it for {what}; {name} only {bytes}"
            );
            Err(invalid(key, value, remedy))
        }
    }
}

/// As [`check`], on this machine, for a trial whose body is not yet built.
///
/// # Errors
/// As [`check`].
pub fn check_here(trial: &TrialSpec) -> Result<(), Invalid> {
    check(trial, layout(&trial.body)?.units(), limit(None).as_ref())
}

/// Size with one decimal and a unit.
fn readable(bytes: f64) -> String {
    let units = [(1e15, "PB"), (1e12, "TB"), (1e9, "GB"), (1e6, "MB")];
    let (size, unit) = units.into_iter().find(|(size, _)| bytes >= *size).unwrap_or((1e3, "kB"));
    format!("{:.1} {unit}", bytes / size)
}

#[cfg(test)]
mod tests;
