//! Warnings about settings of a sweep that are possible, but that a user may not intend.

use std::collections::{BTreeMap, BTreeSet};
use std::thread::available_parallelism;

use metasense_worker::problem::{NO_FORCE, has_force, problem};

use crate::plan::{Plan, PlannedTrial, counted};

/// Threads of a worker per core above which a warning is printed.
const THREADS_PER_CORE: usize = 4;

/// Prints the warnings about a plan.
pub(super) fn warn_of(plan: &Plan) {
    let trials = || plan.trials.iter();
    let relative = |trial: &PlannedTrial| trial.spec.sensors.is_relative();
    if plan.spec.sensors.relative_to.is_some() && !trials().any(relative) {
        let why = "has no effect: no trial has a relative sensors.noise or sensors.bias";
        say!("warning: sensors.relative_to: {why}");
    }
    if trials().any(|trial| trial.spec.optimise.steps() == 1) {
        let why = "the body is not trained, because the last step only evaluates it";
        say!("warning: optimise.iterations = 1: {why}");
    }
    let late = |trial: &PlannedTrial| {
        let [_, last] = trial.spec.stimuli.onset.filter(|onset| onset[1] >= trial.spec.time.duration)?;
        Some([last, trial.spec.time.duration])
    };
    if let Some([last, duration]) = trials().find_map(late) {
        say!(
            "warning: stimuli.onset: pulses may start at {last} s, after the end of the sample (time.duration = {duration} s); the \
             error of a sample that ends before its force starts is meaningless"
        );
    }
    let cores = available_parallelism().map_or(usize::MAX, usize::from);
    if let Some(threads) = plan.spec.run.threads.filter(|n| *n > cores.saturating_mul(THREADS_PER_CORE)) {
        say!("warning: run.threads = {threads}: this machine has {}", counted(cores, "core"));
    }
    let first = trials().next().and_then(|trial| problem(&trial.spec).ok());
    if first.is_some_and(|problem| !has_force(problem, &plan.spec.sweep.seeds)) {
        say!("warning: stimuli: {NO_FORCE}");
    }
    if let Some(why) = repeated(plan) {
        say!("warning: {why}");
    }
}

/// Placements and distinct sets of units.
type Sets = (BTreeSet<usize>, BTreeSet<Vec<usize>>);

/// A warning if some random placements have the same units.
fn repeated(plan: &Plan) -> Option<String> {
    let mut sets: BTreeMap<[usize; 3], Sets> = BTreeMap::new();
    if plan.spec.sensors.placements.is_some() {
        return None;
    }
    for trial in plan.trials.iter().filter(|trial| trial.spec.sensors.search.is_none()) {
        let point = &trial.spec.point;
        let (placements, units) = sets.entry([point.panels, point.sensors, trial.units]).or_default();
        let mut set = trial.spec.sensor_units.clone();
        set.sort_unstable();
        placements.insert(point.placement);
        units.insert(set);
    }
    let ([_, sensors, _], (placements, units)) =
        sets.into_iter().find(|(_, (placements, units))| units.len() < placements.len())?;
    Some(format!(
        "sweep.placements: {} of {} are only {} of units; equal sets are not independent replicates",
        counted(placements.len(), "placement"),
        counted(sensors, "sensor"),
        counted(units.len(), "distinct set")
    ))
}
