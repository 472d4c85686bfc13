//! Warnings about settings of a sweep that are possible, but that a user may not intend.

use std::collections::HashSet;
use std::thread::available_parallelism;

use metasense_schemas::spec::SweepSpec;
use metasense_worker::problem::as_written;

use super::axes::Combination;
use super::{PlannedTrial, counted};

/// Threads of a worker per core above which a warning is printed.
const THREADS_PER_CORE: usize = 4;

/// Warnings about a whole plan.
pub(super) fn warnings(
    spec: &SweepSpec,
    combinations: &[Combination],
    trials: &[PlannedTrial],
) -> Vec<String> {
    let mut warnings = Vec::new();
    let used: HashSet<usize> = combinations.iter().flat_map(Combination::used_exclusions).collect();
    let entries = spec.sweep.exclude.iter().enumerate().filter(|(n, _)| !used.contains(n));
    warnings
        .extend(entries.map(|(_, entry)| format!("sweep.exclude: {} matches no trial", as_written(entry))));
    let any = |what: fn(&SweepSpec) -> bool| combinations.iter().any(|one| what(&one.spec));
    if any(|spec| spec.sensors.relative_to.is_some()) && !any(|spec| spec.sensors.is_relative()) {
        warnings.push(
            "sensors.relative_to: has no effect: no trial has a relative sensors.noise or sensors.bias"
                .into(),
        );
    }
    if trials.iter().any(|trial| trial.spec.optimise.steps() == 1) {
        warnings.push(
            "optimise.iterations = 1: the body is not trained, because the last step only evaluates it"
                .into(),
        );
    }
    let late = |trial: &PlannedTrial| {
        let [_, last] = trial.spec.stimuli.onset.filter(|onset| onset[1] >= trial.spec.time.duration)?;
        Some([last, trial.spec.time.duration])
    };
    if let Some([last, duration]) = trials.iter().find_map(late) {
        warnings.push(format!(
            "stimuli.onset: pulses may start at {last} s, after the end of the sample (time.duration = {duration} s); the \
             error of a sample that ends before its force starts is meaningless"
        ));
    }
    let cores = available_parallelism().map_or(usize::MAX, usize::from);
    if let Some(threads) = spec.run.threads.filter(|n| *n > cores.saturating_mul(THREADS_PER_CORE)) {
        warnings.push(format!("run.threads = {threads}: this machine has {}", counted(cores, "core")));
    }
    warnings
}

/// A warning if some random placements of a point have the same units; `carriers`: number of units that may carry a sensor.
pub(super) fn repeated(placements: &[Vec<usize>], carriers: usize) -> Option<String> {
    let sorted = |units: &Vec<usize>| {
        let mut units = units.clone();
        units.sort_unstable();
        units
    };
    let distinct = placements.iter().map(sorted).collect::<HashSet<_>>().len();
    let sensors = placements.first()?.len();
    let existing: f64 = (0..sensors).map(|k| (carriers - k) as f64 / (k + 1) as f64).product();
    (distinct < placements.len()).then(|| {
        format!(
            "sweep.placements: {} of {} are only {} of units, of {existing:.0} that the body has; equal sets are not \
             independent replicates",
            counted(placements.len(), "placement"),
            counted(sensors, "sensor"),
            counted(distinct, "distinct set")
        )
    })
}
