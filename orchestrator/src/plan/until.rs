//! A plan with questions: the grid that they may grow to, and whether it can answer them.

use metasense_schemas::source::{Source, SpecError};
use metasense_schemas::spec::{SweepSpec, Until};

use super::{Plan, Trial};
use crate::analysis::setting::flatten;
use crate::analysis::trial;
use crate::scheduler::until::{Decision, decide, unanswerable};

/// The spec with the placements and seeds of `until.at_most`.
///
/// # Errors
/// Where a value of `[until]` makes no sense, or does not go with `run.prune`.
pub(super) fn grid(mut spec: SweepSpec, source: &Source) -> Result<SweepSpec, SpecError> {
    let Some(until) = &spec.until else { return Ok(spec) };
    let part = |x: Option<f64>| x.is_none_or(|x| x > 0.0 && x.is_finite());
    let count = |n: Option<usize>| n.is_none_or(|n| (1..=100_000).contains(&n));
    for (key, holds, remedy) in [
        ("until.paired", part(until.paired), "must be a number above 0"),
        ("until.within", part(until.within), "must be a number above 0"),
        ("until.confidence", (0.5..1.0).contains(&until.confidence), "must lie in [0.5, 1)"),
        ("until.at_most.placements", count(until.at_most.placements), "must be at least 1, at most 100000"),
        ("until.at_most.seeds", count(until.at_most.seeds), "must be at least 1, at most 100000"),
        ("until.at_most.hours", part(until.at_most.hours), "must be a number above 0"),
    ] {
        if !holds {
            return Err(source.error(key, remedy));
        }
    }
    if spec.run.prune.is_some() {
        return Err(source.error("run.prune", "gives up trials that [until] would count"));
    }
    spec.sweep.placements = until.at_most.placements.unwrap_or(spec.sweep.placements);
    if let Some(most) = until.at_most.seeds {
        spec.sweep.seeds.truncate(most);
        while spec.sweep.seeds.len() < most {
            let next = spec.sweep.seeds.iter().max().map_or(1, |last| last.saturating_add(1));
            spec.sweep.seeds.push(next);
        }
    }
    Ok(spec)
}

/// Refuses a question that no setting of the plan can answer.
pub(super) fn check(until: Option<&Until>, trials: &[Trial], source: &Source) -> Result<(), SpecError> {
    let Some(until) = until else { return Ok(()) };
    if *until == (Until { confidence: until.confidence, at_most: until.at_most.clone(), ..Until::default() })
    {
        return Err(source.error("until", "needs a question: paired, within, elbow, fewer or complexity"));
    }
    match unanswerable(until, &trials.iter().map(planned).collect::<Vec<_>>()) {
        Some(question) => {
            let what = match question.key() {
                "until.complexity" => "two sizes of a body",
                "until.elbow" => "four numbers of sensors",
                "until.paired" => "one point",
                _ => "two numbers of sensors",
            };
            let remedy = format!(
                "needs {what}, and four placements or seeds of each: no setting of the sweep has them"
            );
            Err(source.error(question.key(), &remedy))
        }
        None => Ok(()),
    }
}

/// A trial as the analysis sees it, without results.
fn planned(trial: &Trial) -> trial::Trial {
    let point = trial.spec.point;
    trial::Trial {
        hash: trial.hash.clone(),
        setting: flatten(&serde_json::to_value(&trial.spec).expect("a trial is JSON")).into_iter().collect(),
        panels: point.panels as u64,
        sensors: point.sensors as u64,
        cluster: trial::Cluster { placement: point.placement as u64, seed: point.seed },
        units: trial.units as u64,
        design_parameters: trial.design_parameters as u64,
        ..trial::Trial::default()
    }
}

/// What a trial has come to.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// Which.
    pub hash: String,
    /// Holdout errors (%) of the initial and the optimised body; none of a trial that has failed.
    pub errors: [Option<f64>; 2],
    /// CPU seconds.
    pub seconds: f64,
}

impl Plan {
    /// Where the questions stand by what is in the database, and the trials that are wanted, in the order of the plan; none
    /// that is not settled once the hours are spent.
    #[must_use]
    pub fn decide(&self, found: &[Found], workers: u32) -> Option<(Decision, Vec<Trial>)> {
        let until = self.spec.until.as_ref()?;
        let mut trials: Vec<trial::Trial> = self.trials.iter().map(planned).collect();
        let mut settled = vec![false; trials.len()];
        let places: std::collections::HashMap<&str, &Found> =
            found.iter().map(|f| (f.hash.as_str(), f)).collect();
        let mut seconds = 0.0;
        for (trial, settled) in trials.iter_mut().zip(&mut settled) {
            if let Some(found) = places.get(trial.hash.as_str()) {
                trial.errors = found.errors.map(|error| [None, error]);
                (*settled, seconds) = (true, seconds + found.seconds);
            }
        }
        let points = self.trials.iter().filter(|t| {
            let (first, own) = (self.trials[0].spec.point, t.spec.point);
            (own.placement, own.seed) == (first.placement, first.seed)
        });
        let ahead = (workers as usize).div_ceil(points.count().max(1));
        let decision = decide(until, &trials, &settled, ahead);
        let spent = until.at_most.hours.is_some_and(|hours| seconds >= 3600.0 * hours);
        let wanted = decision.wanted.iter().filter(|&&i| settled[i] || !spent);
        let wanted = wanted.map(|&i| self.trials[i].clone()).collect();
        Some((decision, wanted))
    }
}
