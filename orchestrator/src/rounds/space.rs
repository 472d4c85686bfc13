//! The space in which the search for [goal] chooses: trials that may meet it, their costs, and their coordinates among the
//! settings.

use std::collections::{BTreeMap, BTreeSet};

use metasense_lab::cost;
use metasense_lab::demands::Demands;
use metasense_schemas::spec::{
    BrainKind, Cost, Design, Goal, GoalReader, GoalReaderName, SweepPoint, TrialSpec, flatten,
};
use metasense_source::SpecError;
pub use metasense_worker::RUNGS;
use metasense_worker::evaluation_step_near;
use metasense_worker::problem;
use serde_json::Value;

use crate::analysis::goal::{Candidate, LEVELS, Setting};
use crate::analysis::trial::CastDecoder;
use crate::look::number;
use crate::plan::{Plan, PlannedTrial, located};

/// A trial that may meet the goal.
#[derive(Debug, Clone)]
pub struct SearchTrial {
    /// Index in the plan.
    pub trial: usize,
    /// The decoder whose errors on casts count; `None`: errors of the body as designed.
    pub reader: Option<CastDecoder>,
    /// What the decoder needs on a device; `None` if it cannot be exported for devices.
    pub demands: Option<Demands>,
    /// Cost and coordinates, without results.
    pub candidate: Candidate,
}

/// A limit that excludes trials before they run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExcludedTrials {
    /// Key of the limit.
    pub key: &'static str,
    /// Number of trials that it excludes.
    pub trials: usize,
    /// The smallest limit that would admit one of them, as text.
    pub least: String,
}

/// The search space.
#[derive(Debug, Clone)]
pub struct Space {
    /// The goal.
    pub goal: Goal,
    /// Admitted trials, in the order of the plan.
    pub places: Vec<SearchTrial>,
    /// Limits that exclude other trials.
    pub left_out: Vec<ExcludedTrials>,
    /// Keys that differ between settings.
    pub axes: Vec<String>,
}

impl Space {
    /// The search space of a plan with a [goal].
    ///
    /// # Errors
    /// If there is no [goal], no trial may meet it, or a decoder does not support `goal.reader`.
    pub fn new(plan: &Plan) -> Result<Self, SpecError> {
        let Some(goal) = plan.spec.goal.clone() else {
            return Err(plan.source.error("goal", "must be set: the requirement of the design"));
        };
        let limits = limits(&goal);
        let (mut places, mut asked) = (Vec::new(), Vec::new());
        for (number, trial) in plan.trials.iter().enumerate() {
            let reader =
                reader(&goal, &trial.spec).map_err(|remedy| plan.source.error("goal.reader", remedy))?;
            tasks_are_estimated(&goal, &trial.spec)
                .map_err(|(key, remedy)| plan.source.error(&key, &remedy))?;
            let wrong = located(&plan.source);
            let demands = Demands::of_trial(&trial.spec).map_err(wrong)?;
            let weighed = goal.mass.is_some() || goal.size.is_some();
            let measures = if weighed { problem::measures(&trial.spec).map_err(wrong)? } else { [0.0; 2] };
            let asks = limits.iter().map(|limit| (limit.asked)(&trial.spec, demands.as_ref(), measures));
            let asks: Vec<f64> = asks.map(|asked| asked.unwrap_or(f64::INFINITY)).collect();
            if asks.iter().zip(&limits).all(|(asked, limit)| *asked <= limit.most) {
                let cost = of_cost(goal.cost, trial, demands.as_ref());
                let candidate = Candidate { cost, ..Candidate::default() };
                places.push(SearchTrial { trial: number, reader, demands, candidate });
            }
            asked.push(asks);
        }
        let mut left_out = Vec::new();
        for (l, limit) in limits.iter().enumerate() {
            let beyond: Vec<f64> =
                asked.iter().map(|asks| asks[l]).filter(|asked| *asked > limit.most).collect();
            let least = match beyond.iter().copied().fold(f64::INFINITY, f64::min) {
                f64::INFINITY => "a decoder that can be exported for devices".into(),
                least => format!("{} {}", number(least), limit.unit),
            };
            if !beyond.is_empty() {
                left_out.push(ExcludedTrials { key: limit.key, trials: beyond.len(), least });
            }
        }
        if places.is_empty() {
            let because = left_out.iter().max_by_key(|out| out.trials).expect("something has left them out");
            let remedy = format!("no trial of the sweep meets it: the smallest value is {}", because.least);
            return Err(plan.source.error(because.key, &remedy));
        }
        let trials: Vec<&PlannedTrial> = places.iter().map(|place| &plan.trials[place.trial]).collect();
        let sweep = &plan.spec.sweep;
        let named: Vec<&String> =
            sweep.axes.keys().chain(sweep.points.iter().flat_map(|point| point.keys())).collect();
        let (axes, coordinates) = coordinates(&trials, &named);
        // `looks` numbers kinds of test errors: those of the decoder in training, on the body as designed or over its training
        // casts
        let loops = trials.iter().map(|trial| &trial.spec.optimise);
        let looks = numbered(loops.map(|o| (o.protocol, o.brain, o.objective)));
        let sensors = numbered(trials.iter().map(|t| (t.units, &t.spec.sensor_units, &t.spec.panel_units)));
        let known = coordinates.into_iter().zip(looks).zip(sensors);
        for (trial, ((place, looks), sensors)) in places.iter_mut().zip(known) {
            trial.candidate.setting = Setting { place, rung_kind: looks, sensors };
        }
        Ok(Self { goal, places, left_out, axes })
    }
}

/// A limit of the goal on a value that is known before a trial runs.
struct Limit {
    key: &'static str,
    most: f64,
    unit: &'static str,
    /// A trial's value, from demands of its decoder, and mass and size of its body; `None`: no decoder for devices.
    asked: fn(&TrialSpec, Option<&Demands>, [f64; 2]) -> Option<f64>,
}

fn limits(goal: &Goal) -> Vec<Limit> {
    let limit = |key, most: Option<f64>, unit, asked| Some(Limit { key, most: most?, unit, asked });
    // rounding errors must not exceed a limit
    let nearly = |most: Option<f64>| most.map(|most| most * (1.0 + 1e-9));
    let operations = goal.operations.map(|most| most as f64);
    let all = [
        limit("goal.delay", nearly(goal.delay), "s", |trial, demands, _| {
            Some(demands?.delay as f64 * trial.time.duration / trial.time.samples as f64)
        }),
        limit("goal.memory", goal.memory, "kB", |_, demands, _| {
            demands.map(|d| (d.constants + d.memory) as f64 / 1e3)
        }),
        limit("goal.operations", operations, "multiply-adds", |_, demands, _| {
            Some(demands?.operations as f64)
        }),
        limit("goal.mass", nearly(goal.mass), "g", |_, _, [mass, _]| Some(mass)),
        limit("goal.size", nearly(goal.size), "mm", |_, _, [_, size]| Some(size)),
    ];
    all.into_iter().flatten().collect()
}

fn of_cost(cost: Option<Cost>, trial: &PlannedTrial, demands: Option<&Demands>) -> [f64; 3] {
    let operations = demands.map_or(f64::INFINITY, |demands| demands.operations as f64);
    let all = [trial.spec.point.sensors as f64, operations, trial.units as f64];
    match cost {
        None => all,
        Some(Cost { sensor, operation, unit }) => {
            // an infinite quantity without a price adds nothing
            let priced = [sensor, operation, unit].into_iter().zip(all).filter(|(price, _)| *price > 0.0);
            [priced.map(|(price, n)| price * n).sum(), 0.0, 0.0]
        }
    }
}

/// The decoder whose errors on casts of a trial count; `None`: errors of the body as designed.
///
/// # Errors
/// If the trial has no such decoder.
fn reader(goal: &Goal, trial: &TrialSpec) -> Result<Option<CastDecoder>, &'static str> {
    if goal.quantile.is_none() {
        return Ok(None);
    }
    let reader = goal.reader.unwrap_or(GoalReader::Named(GoalReaderName::Casts));
    Ok(Some(match (reader, trial.brain.kind) {
        (GoalReader::Named(GoalReaderName::Design), BrainKind::Linear) => CastDecoder::Nominal,
        (GoalReader::Named(GoalReaderName::Design), BrainKind::Inverse) => CastDecoder::Inverse,
        (GoalReader::Named(GoalReaderName::Design), _) => CastDecoder::Network,
        (GoalReader::Named(GoalReaderName::Casts), BrainKind::Linear) => CastDecoder::Casts,
        (GoalReader::Named(GoalReaderName::Casts), BrainKind::Inverse) => {
            return Err(
                "an inverse decoder is not fitted to other casts: must be \"design\" or { records = 10 }",
            );
        }
        (GoalReader::Named(GoalReaderName::Casts), _) => CastDecoder::NetworkCasts,
        (GoalReader::Calibrated(of), BrainKind::Linear) => CastDecoder::Records(of.records),
        (GoalReader::Calibrated(of), BrainKind::Inverse) => CastDecoder::Twin(of.records),
        (GoalReader::Calibrated(_), _) => {
            return Err("a network is not fitted to records of a cast: must be \"design\" or \"casts\"");
        }
    }))
}

/// Checks that a trial estimates the tasks of the goal.
///
/// # Errors
/// The key that must change, and the remedy.
fn tasks_are_estimated(goal: &Goal, trial: &TrialSpec) -> Result<(), (String, String)> {
    let Some(tasks) = &goal.tasks else { return Ok(()) };
    let wrong = |key: &str, remedy: &str| (key.to_owned(), remedy.to_owned());
    if trial.evaluation.tasks != Some(true) {
        let remedy = "applies to trials that estimate tasks: set evaluation.tasks = true";
        return Err(wrong("goal.tasks", remedy));
    }
    let varied = problem::varied_tasks(trial).map_err(|e| wrong(&e.key, &e.remedy))?;
    match tasks.keys().find(|task| !varied.contains(&task.name())) {
        None => Ok(()),
        Some(task) => Err(wrong(
            &format!("goal.tasks.{}", task.name()),
            "its label is the same in all training samples: vary [stimuli], or remove this requirement",
        )),
    }
}

/// Keys in which the trials' settings differ, one per pattern of values, keys of the sweep first; and the settings as
/// coordinates from 0 to 1: scaled logarithms of numbers, one coordinate per value of anything else.
fn coordinates(trials: &[&PlannedTrial], named: &[&String]) -> (Vec<String>, Vec<Vec<f64>>) {
    const NOT: [&str; 2] = ["point.placement", "point.seed"];
    let leaves = |trial: &&PlannedTrial| {
        let spec = TrialSpec { sensor_units: Vec::new(), panel_units: Vec::new(), ..trial.spec.clone() };
        flatten(&serde_json::to_value(&spec).expect("a trial is JSON"))
    };
    let all: Vec<BTreeMap<String, Value>> = trials.iter().map(leaves).collect();
    let mut paths: Vec<&String> =
        all.iter().flat_map(BTreeMap::keys).collect::<BTreeSet<_>>().into_iter().collect();
    // keys of the sweep precede keys that follow from them
    paths.sort_by_key(|path| !named.contains(path));
    let (mut axes, mut columns, mut patterns) = (Vec::new(), Vec::new(), BTreeSet::new());
    for path in paths.into_iter().filter(|path| !NOT.contains(&path.as_str())) {
        let values: Vec<Option<&Value>> = all.iter().map(|leaves| leaves.get(path)).collect();
        let pattern = numbered(values.iter());
        let count = 1 + pattern.iter().max().copied().unwrap_or(0);
        if count < 2 || !patterns.insert(pattern.clone()) {
            continue;
        }
        axes.push(path.clone());
        let numbers: Option<Vec<f64>> = values.iter().map(|value| value.and_then(Value::as_f64)).collect();
        match numbers {
            Some(numbers) => columns.push(scaled(&numbers)),
            // one coordinate per value makes all values equally distant
            None => columns.extend(
                (0..count).map(|k| pattern.iter().map(|value| if *value == k { 0.7 } else { 0.0 }).collect()),
            ),
        }
    }
    (axes, (0..trials.len()).map(|i| columns.iter().map(|column: &Vec<f64>| column[i]).collect()).collect())
}

/// Numbers values from 0; equal values get the same number.
fn numbered<T: PartialEq>(values: impl Iterator<Item = T>) -> Vec<usize> {
    let mut known: Vec<T> = Vec::new();
    let number = |value| {
        known.iter().position(|k| *k == value).unwrap_or_else(|| {
            known.push(value);
            known.len() - 1
        })
    };
    values.map(number).collect()
}

fn scaled(numbers: &[f64]) -> Vec<f64> {
    let positive = numbers.iter().all(|x| *x > 0.0);
    let values: Vec<f64> = numbers.iter().map(|x| if positive { x.ln() } else { *x }).collect();
    let (low, high) =
        values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(*x), high.max(*x)));
    // nearly equal numbers may have equal logarithms: avoid 0/0
    values.iter().map(|x| (x - low) / (high - low).max(f64::MIN_POSITIVE)).collect()
}

/// Outer steps at which the partial trainings (rungs) of a trial end, just after an evaluation of the test set; `None` for
/// rungs that short trainings lack.
pub fn rungs(trial: &TrialSpec) -> [Option<u32>; LEVELS - 1] {
    let steps = trial.optimise.steps() as u32;
    let [first, second] = RUNGS.map(|part| evaluation_step_near(steps, part) + 1);
    let rung = |step: u32, behind: u32| (step > behind && step < steps).then_some(step);
    [rung(first, 0), rung(second, first)]
}

/// Trials that evaluate a trial's trained body on the first `seeds` fresh seeds: only decoders are trained. Sensors have the
/// disturbances of the trial.
///
/// # Panics
/// If `body` is not a body of a trial.
pub fn on_fresh_seeds<'a>(
    plan: &'a Plan,
    trial: &'a PlannedTrial,
    (body, design): &(TrialSpec, Vec<f64>),
    seeds: usize,
) -> impl Iterator<Item = PlannedTrial> + use<'a> {
    let last = plan.spec.sweep.seeds.iter().max().copied().unwrap_or(0);
    let mut spec = body.clone();
    if spec.sensors.is_relative() && spec.sensors.relative_to.is_none() {
        let start = || {
            let limits = problem::limits(&body.feasible)?;
            problem::initial_design(&body.body, &problem::layout(&body.body)?, limits)
        };
        let shifts = start().expect("a trial's body");
        spec.sensors.relative_to = Some(Design::Shifts { shifts });
    }
    spec.body.design = Some(Design::Shifts { shifts: design.clone() });
    if spec.body.lattice.turns() {
        spec.body.initial_angle = 0.0; // not used
    }
    spec.optimise.iterations = Some(0);
    spec.sensors.search = None;
    (0..seeds).map(move |n| {
        let seed = last.saturating_add(1 + n as u64);
        let spec = TrialSpec { point: SweepPoint { seed, ..spec.point }, ..spec.clone() };
        let ((cost, weight), hash) = (cost::of(&spec, trial.units), spec.hash());
        PlannedTrial {
            training: hash.clone(), // unique, because no body is trained
            hash,
            trains: true,
            cost,
            weight,
            order: plan.trials.len() + n,
            pause: None,
            spec,
            ..trial.clone()
        }
    })
}
