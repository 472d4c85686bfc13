//! Early stopping: which questions of a sweep are answered, and which trials are needed. Decisions depend on stored results
//! only.
//!
//! Units of inference are placements with all their seeds, or seeds with all their placements, whichever are more numerous, in
//! the order of the plan. After the fourth and every further unit, Student's t on contrasts of ln e tests each question.
//! Group-sequential spending corrects for the repeated looks (`looks.rs`): the number of units is known and small, so that a
//! confidence sequence would need more of them.

mod ask;
mod looks;

use std::collections::{BTreeSet, HashMap};
use std::fmt;

use metasense_schemas::record::PlannedTrial as Planned;
use metasense_schemas::spec::{Until, flatten};

use super::data::{COMPLEXITY, SENSORS, groups};
use super::numbers::distinct_numbers;
use super::resample::LEAST_UNITS;
use super::{BodyState, Cluster, Set, Trial};

use ask::Curves;
pub use ask::{UntilAnswer, UntilQuestion};
pub use looks::KnownLooks;
use looks::Looks;

/// State of a question in one setting of the sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct Standing {
    /// The question.
    pub question: UntilQuestion,
    /// The setting: K, body, decoder.
    pub setting: String,
    /// Number of units with a result, and of units of the grid.
    pub units: [usize; 2],
    /// `placements` or `seeds`.
    pub of: &'static str,
    /// The answer, and the number of units that it needed.
    pub answer: Option<(UntilAnswer, usize)>,
}

impl fmt::Display for Standing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { question, setting, units: [known, grid], of, answer } = self;
        write!(f, "{question} ({setting}), ")?;
        match answer {
            Some((answer, units)) => write!(f, "answered after {units} of {grid} {of}: {answer}"),
            None => write!(f, "open after {known} of {grid} {of}"),
        }
    }
}

/// Wanted trials, and the state of the questions.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// State of every question.
    pub standings: Vec<Standing>,
    /// Wanted trials by their index in the plan, including settled ones.
    pub wanted: Vec<usize>,
}

impl Decision {
    /// Whether every question is answered.
    pub fn is_settled(&self) -> bool {
        self.standings.iter().all(|standing| standing.answer.is_some())
    }
}

/// A question in one setting, with the trials of each unit.
struct SettingQuestion {
    question: UntilQuestion,
    setting: String,
    of: &'static str,
    /// Values of M or of the number of design parameters.
    places: Vec<f64>,
    /// Per unit: index of each trial in the plan, and its value on the axis.
    units: Vec<Vec<(usize, f64)>>,
}

/// Returns the questions for every setting in which they can be answered. `trials`: the plan, with or without results.
fn setting_questions(until: &Until, trials: &[Trial]) -> Vec<SettingQuestion> {
    let refs: Vec<&Trial> = trials.iter().collect();
    let numbers: HashMap<*const Trial, usize> =
        trials.iter().enumerate().map(|(i, trial)| (std::ptr::from_ref(trial), i)).collect();
    let mut found = Vec::new();
    for question in UntilQuestion::all(until) {
        let (but, at): (_, fn(&Trial) -> u64) = match question {
            UntilQuestion::Complexity => (COMPLEXITY, |t| t.design_parameters),
            _ => (SENSORS, |t| t.sensors),
        };
        for group in groups(&refs, but) {
            let (units, of) = by_unit(&group.trials);
            let with_place =
                |trial: &&Trial| (numbers[&std::ptr::from_ref::<Trial>(*trial)], at(trial) as f64);
            let units: Vec<Vec<(usize, f64)>> =
                units.iter().map(|unit| unit.iter().map(with_place).collect()).collect();
            let places = distinct_numbers(units.iter().flatten().map(|(_, at)| *at));
            if places.len() >= question.least_places() && units.len() >= LEAST_UNITS {
                found.push(SettingQuestion { question, setting: group.label, of, places, units });
            }
        }
    }
    found
}

/// Groups trials by placement or by seed, whichever are more numerous, in the order of the plan.
fn by_unit<'a>(trials: &[&'a Trial]) -> (Vec<Vec<&'a Trial>>, &'static str) {
    let group_by = |pick: fn(&Cluster) -> u64| {
        let mut found: Vec<(u64, Vec<&Trial>)> = Vec::new();
        for trial in trials {
            let value = pick(&trial.cluster);
            match found.iter_mut().find(|(known, _)| *known == value) {
                Some((_, unit)) => unit.push(trial),
                None => found.push((value, vec![trial])),
            }
        }
        found.into_iter().map(|(_, unit)| unit).collect::<Vec<_>>()
    };
    let (placements, seeds) = (group_by(|c| c.placement), group_by(|c| c.seed));
    if seeds.len() > placements.len() { (seeds, "seeds") } else { (placements, "placements") }
}

/// Returns the first question that no setting of the plan can answer.
pub fn unanswerable(until: &Until, plan: &[Planned]) -> Option<UntilQuestion> {
    let found = setting_questions(until, &plan.iter().map(planned).collect::<Vec<_>>());
    UntilQuestion::all(until).into_iter().find(|question| found.iter().all(|a| a.question != *question))
}

/// Converts a planned trial, without results.
fn planned(trial: &Planned) -> Trial {
    let point = trial.spec.point;
    Trial {
        hash: trial.hash.clone(),
        setting: flatten(&serde_json::to_value(&trial.spec).expect("a trial is JSON")).into_iter().collect(),
        panels: point.panels as u64,
        sensors: point.sensors as u64,
        cluster: Cluster { placement: point.placement as u64, seed: point.seed },
        units: trial.units as u64,
        design_parameters: trial.design_parameters as u64,
        ..Trial::default()
    }
}

/// The part of a settled trial's result that the questions use.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialErrors {
    /// Name of the trial.
    pub hash: String,
    /// Held-out errors (%) of initial and trained body; `None` if the trial failed.
    pub errors: [Option<f64>; 2],
    /// CPU seconds.
    pub seconds: f64,
}

/// Returns the state of the questions and the wanted trials, in the order of the plan. Once `hours` are spent, only settled
/// trials are wanted. Open questions want enough units ahead to occupy the workers.
pub fn of_plan(
    until: &Until,
    plan: &[Planned],
    found: &[TrialErrors],
    workers: u32,
    looks: &mut KnownLooks,
) -> Decision {
    let mut trials: Vec<Trial> = plan.iter().map(planned).collect();
    let mut settled = vec![false; trials.len()];
    let places: HashMap<&str, &TrialErrors> = found.iter().map(|f| (f.hash.as_str(), f)).collect();
    let mut seconds = 0.0;
    for (trial, settled) in trials.iter_mut().zip(&mut settled) {
        if let Some(found) = places.get(trial.hash.as_str()) {
            trial.errors = found.errors.map(|error| [None, error, None]);
            (*settled, seconds) = (true, seconds + found.seconds);
        }
    }
    let points = trials.iter().filter(|trial| trial.cluster == trials[0].cluster).count();
    let mut decision = decide(until, &trials, &settled, (workers as usize).div_ceil(points.max(1)), looks);
    if until.at_most.hours.is_some_and(|hours| seconds >= 3600.0 * hours) {
        decision.wanted.retain(|&trial| settled[trial]);
    }
    decision
}

/// The same from the `settled` trials (done, or failed permanently). An open question wants all units before the first
/// unsettled one, and `ahead` more.
fn decide(
    until: &Until,
    trials: &[Trial],
    settled: &[bool],
    ahead: usize,
    looks: &mut KnownLooks,
) -> Decision {
    let alpha = 1.0 - until.confidence;
    let (mut standings, mut wanted) = (Vec::new(), BTreeSet::new());
    for asked in setting_questions(until, trials) {
        let passed =
            asked.units.iter().take_while(|unit| unit.iter().all(|(trial, _)| settled[*trial])).count();
        let grid = asked.units.len();
        let curve = |unit: &Vec<(usize, f64)>| curve(unit, &asked.places, trials);
        let curves: Vec<Option<Vec<f64>>> = asked.units[..passed].iter().map(curve).collect();
        let looks = looks.0.entry(grid).or_insert_with(|| Looks::new(grid));
        let answer = settle(asked.question, &curves, &asked.places, alpha, looks);
        let needed = match &answer {
            Some((_, units)) => *units,
            None => (passed + ahead.max(1)).max(LEAST_UNITS).min(grid),
        };
        wanted.extend(asked.units[..needed].iter().flatten().map(|(trial, _)| *trial));
        let units = [curves.iter().flatten().count(), grid];
        let SettingQuestion { question, setting, of, .. } = asked;
        standings.push(Standing { question, setting, units, of, answer });
    }
    Decision { standings, wanted: wanted.into_iter().collect() }
}

/// Returns ln e of a unit by place, first on the trained body, then on the initial one; means over its trials. `None` if an
/// error is missing.
fn curve(unit: &[(usize, f64)], places: &[f64], trials: &[Trial]) -> Option<Vec<f64>> {
    let mean = |body: BodyState, place: f64| -> Option<f64> {
        let here = unit.iter().filter(|(_, at)| *at == place);
        let logs: Option<Vec<f64>> =
            here.map(|(trial, _)| trials[*trial].error(body, Set::Holdout).map(f64::ln)).collect();
        let logs = logs.filter(|logs| !logs.is_empty())?;
        Some(logs.iter().sum::<f64>() / logs.len() as f64)
    };
    let all = |body| places.iter().map(move |place| mean(body, *place));
    all(BodyState::Optimised).chain(all(BodyState::Initial)).collect()
}

/// Returns the first answer, which is wrong with probability `chance` at most, and the number of units that it needed. Units
/// without a curve are skipped.
fn settle(
    question: UntilQuestion,
    curves: &[Option<Vec<f64>>],
    places: &[f64],
    chance: f64,
    looks: &mut Looks,
) -> Option<(UntilAnswer, usize)> {
    let mut known = Vec::new();
    for (passed, curve) in (1..).zip(curves) {
        let Some(curve) = curve else { continue };
        known.push(&curve[..]);
        if known.len() >= LEAST_UNITS {
            let look = Curves { places, units: &known, passed };
            if let Some(answer) = question.answer(&look, chance, looks) {
                return Some((answer, passed));
            }
        }
    }
    None
}

#[cfg(test)]
mod tests;
