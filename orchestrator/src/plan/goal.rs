//! Checks of [goal].

use metasense_schemas::spec::{GoalReader, SweepSpec, Task};
use metasense_source::{Source, SpecError};
use metasense_worker::RECORDS;

/// Checks the values of [goal].
pub(super) fn check(spec: &SweepSpec, source: &Source) -> Result<(), SpecError> {
    let Some(goal) = &spec.goal else { return Ok(()) };
    let above = |x: Option<f64>| x.is_none_or(|x| x > 0.0 && x.is_finite());
    let price = |x: f64| x >= 0.0 && x.is_finite();
    let prices = goal.cost.is_none_or(|c| [c.sensor, c.operation, c.unit].into_iter().all(price));
    let records = match goal.reader {
        Some(GoalReader::Calibrated(of)) => RECORDS.contains(&(of.records as usize)),
        _ => true,
    };
    let casts = spec.variation.is_some() && spec.evaluation.casts != Some(0);
    for (task, most) in goal.tasks.iter().flatten() {
        if matches!(task, Task::Forces | Task::All) || !above(Some(*most)) {
            let remedy =
                "must be above 0, and the task one of panel, count, position, peak, impulse, onset and kind";
            return Err(source.error(&format!("goal.tasks.{}", task.name()), remedy));
        }
    }
    source.require(&[
        ("goal.error", above(Some(goal.error)), "must be a number above 0"),
        ("goal.quantile", goal.quantile.is_none_or(|q| q > 0.0 && q <= 1.0), "must be above 0 and at most 1"),
        (
            "goal.quantile",
            goal.quantile.is_none() || casts,
            "applies to casts: set [variation], and keep evaluation.casts above 0",
        ),
        (
            "goal.reader",
            goal.reader.is_none() || goal.quantile.is_some(),
            "applies to casts: set goal.quantile as well",
        ),
        ("goal.reader.records", records, "must be 10, 30 or 100"),
        (
            "evaluation.records",
            spec.evaluation.records != Some(false) || !matches!(goal.reader, Some(GoalReader::Calibrated(_))),
            "must be true: goal.reader is fitted to records of a cast",
        ),
        (
            "goal.delay",
            goal.delay.is_none_or(|s| s >= 0.0 && s.is_finite()),
            "must be 0 or a number of seconds",
        ),
        ("goal.memory", above(goal.memory), "must be a number of kB above 0"),
        ("goal.operations", goal.operations != Some(0), "must be at least 1"),
        ("goal.mass", above(goal.mass), "must be a number of g above 0"),
        ("goal.size", above(goal.size), "must be a number of mm above 0"),
        ("goal.cost", prices, "must contain numbers of at least 0"),
        ("goal.confidence", (0.5..1.0).contains(&goal.confidence), "must lie in [0.5, 1)"),
        ("goal.fresh", (3..=100).contains(&goal.fresh), "must be at least 3, at most 100"),
        ("goal.at_a_time", (1..=10_000).contains(&goal.at_a_time), "must be at least 1, at most 10000"),
        ("goal.hours", above(goal.hours), "must be a number above 0"),
        ("until", spec.until.is_none(), "cannot be set together with [goal]"),
    ])
}
