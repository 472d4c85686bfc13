//! Plans with [until]: the grid to which the sweep may grow, and whether it can answer the questions.

use metasense_schemas::spec::{SweepSpec, Until};
use metasense_source::{Source, SpecError};

use super::PlannedTrial;
use crate::analysis::until::unanswerable;

/// The spec with the placements and seeds of `until.at_most`; checks the values of `[until]`.
pub(super) fn grid(mut spec: SweepSpec, source: &Source) -> Result<SweepSpec, SpecError> {
    let Some(until) = &spec.until else { return Ok(spec) };
    let part = |x: Option<f64>| x.is_none_or(|x| x > 0.0 && x.is_finite());
    let count = |n: Option<usize>| n.is_none_or(|n| (1..=1000).contains(&n));
    source.require(&[
        ("until.paired", part(until.paired), "must be a number above 0"),
        ("until.within", part(until.within), "must be a number above 0"),
        ("until.confidence", (0.5..1.0).contains(&until.confidence), "must lie in [0.5, 1)"),
        ("until.at_most.placements", count(until.at_most.placements), "must be at least 1, at most 1000"),
        ("until.at_most.seeds", count(until.at_most.seeds), "must be at least 1, at most 1000"),
        ("until.at_most.hours", part(until.at_most.hours), "must be a number above 0"),
    ])?;
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

/// Rejects questions that no setting of the plan can answer.
pub(super) fn check(
    until: Option<&Until>,
    trials: &[PlannedTrial],
    source: &Source,
) -> Result<(), SpecError> {
    let Some(until) = until else { return Ok(()) };
    if *until == (Until { confidence: until.confidence, at_most: until.at_most.clone(), ..Until::default() })
    {
        return Err(source.error("until", "needs a question: paired, within, elbow, fewer or complexity"));
    }
    let left_out = trials.iter().any(|trial| trial.spec.evaluation.initial == Some(false));
    if left_out && (until.paired.is_some() || until.fewer) {
        let remedy = "must be true: until.paired and until.fewer use the initial body";
        return Err(source.error_with("evaluation.initial", Some("false"), remedy));
    }
    match unanswerable(until, trials) {
        Some(question) => {
            let what = match question.key() {
                "until.complexity" => "two sizes of a body",
                "until.elbow" => "four numbers of sensors",
                "until.paired" => "one point",
                _ => "two numbers of sensors",
            };
            let remedy = format!(
                "needs {what} with four placements or seeds of each; no setting of the sweep has them"
            );
            Err(source.error(question.key(), &remedy))
        }
        None => Ok(()),
    }
}
