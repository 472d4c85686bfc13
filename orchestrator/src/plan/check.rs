//! Checks of `[sweep]`, `[run]` and the name of the sweep.

use std::collections::HashSet;

use metasense_schemas::spec::{Run, SweepSpec};
use metasense_source::{Source, SpecError};
use metasense_worker::problem::as_written;
use serde_json::Value;

use crate::control::WORKERS_MAX;

/// Specs with more trials are rejected as mistakes.
const MOST_TRIALS: usize = 1_000_000;
/// Largest seed: f64 represents it and the seeds that [until] and [goal] add to it exactly.
const MOST_SEED: u64 = 1 << 52;

/// Longest name (bytes): file names of 255 bytes contain it.
const LONGEST_NAME: usize = 100;

/// Checks the lists of `[sweep]`, and the name, which becomes a file name.
pub(super) fn check_sweep(spec: &SweepSpec, source: &Source) -> Result<(), SpecError> {
    let sweep = &spec.sweep;
    let harmless = |c: char| c.is_alphanumeric() || "-_.".contains(c);
    let is_file_name =
        !spec.name.is_empty() && !spec.name.starts_with('.') && spec.name.chars().all(harmless);
    let remedy = "must consist of letters, digits, '-', '_' and '.', because it names the database";
    let is_short = spec.name.len() <= LONGEST_NAME;
    let shorten = "must have at most 100 bytes, because it names files";
    source.require(&[("name", is_file_name, remedy), ("name", is_short, shorten)])?;
    for (list, key) in [(&sweep.panels, "sweep.panels"), (&sweep.sensors, "sweep.sensors")] {
        if !list.is_empty() || sweep.points.is_empty() {
            distinct(list, key, source)?;
        }
    }
    if !sweep.points.is_empty() {
        distinct(&sweep.points, "sweep.points", source)?;
    }
    if let Some(seed) = sweep.seeds.iter().find(|seed| **seed > MOST_SEED) {
        let remedy = format!("must be at most {MOST_SEED}");
        return Err(source.error_with("sweep.seeds", Some(&seed.to_string()), &remedy));
    }
    distinct(&sweep.seeds, "sweep.seeds", source)?;
    for (path, values) in &sweep.axes {
        distinct(values, path, source)?;
    }
    for (key, least) in [
        ("sweep.panels", sweep.panels.iter().min()),
        ("sweep.sensors", sweep.sensors.iter().min()),
        ("sweep.placements", Some(&sweep.placements)),
    ] {
        if least == Some(&0) {
            return Err(source.error_with(key, Some("0"), "must be at least 1"));
        }
    }
    check_run(&spec.run, source)?;
    let own = |asked: bool| !(asked && sweep.own_placements);
    let listed = spec.sensors.placements.is_some();
    source.require(&[
        (
            "sweep.own_placements",
            own(spec.until.is_some()),
            "cannot be set together with [until], which adds seeds and placements itself",
        ),
        (
            "sweep.own_placements",
            own(spec.goal.is_some()),
            "cannot be set together with [goal], which adds seeds and placements itself",
        ),
        (
            "sweep.placements",
            !listed || sweep.placements == 1,
            "cannot be set together with sensors.placements",
        ),
        (
            "sensors.search",
            !listed || spec.sensors.search.is_none(),
            "cannot be set together with sensors.placements, which fixes the units",
        ),
    ])?;
    let others = sweep.axes.values().map(Vec::len);
    let own = [sweep.panels.len(), sweep.sensors.len(), sweep.points.len()].map(|n| n.max(1));
    let mut lists = others.chain(own).chain([sweep.seeds.len(), sweep.placements]);
    match lists.try_fold(1usize, usize::checked_mul) {
        Some(n) if n <= MOST_TRIALS => Ok(()),
        n => {
            let n = n.map_or("too many".to_owned(), |n| n.to_string());
            let remedy = format!("its lists span {n} trials; at most {MOST_TRIALS} are allowed");
            Err(source.error("sweep", &remedy))
        }
    }
}

/// Largest `run.grace` (s).
pub(crate) const GRACE_MAX: f64 = 3600.0;

fn check_run(run: &Run, source: &Source) -> Result<(), SpecError> {
    let thousand = |n: Option<usize>| n.is_none_or(|n| (1..=WORKERS_MAX as usize).contains(&n));
    let seconds = |s: Option<f64>, least: f64| s.is_none_or(|s| s >= least && s <= 1e9);
    source.require(&[
        ("run.workers", thousand(run.workers), "must be at least 1, at most 1024"),
        ("run.threads", thousand(run.threads), "must be at least 1, at most 1024"),
        ("run.niceness", run.niceness.is_none_or(|n| n <= 19), "must be at most 19"),
        ("run.memory", run.memory.is_none_or(|mib| mib >= 64), "must be at least 64 MiB"),
        ("run.backoff", seconds(run.backoff, 0.0), "must be at least 0, at most 1e9 s"),
        (
            "run.no_progress",
            seconds(run.no_progress, 2.0),
            "must be at least 2, at most 1e9 s: workers report every second",
        ),
        (
            "run.grace",
            run.grace.is_none_or(|s| (0.0..=GRACE_MAX).contains(&s)),
            "must be at least 0, at most 3600 s",
        ),
        ("run.lock_wait", seconds(run.lock_wait, 0.0), "must be at least 0, at most 1e9 s"),
        ("run.time_limit", seconds(run.time_limit, 0.1), "must be at least 0.1, at most 1e9 s"),
    ])
}

/// Rejects lists that contain a unit twice, and lists with the same units as another, in any order.
pub(crate) fn check_placements(lists: &[Vec<usize>], source: &Source) -> Result<(), SpecError> {
    let key = "sensors.placements";
    let mut lists = lists.to_vec();
    lists.iter_mut().for_each(|list| list.sort_unstable());
    match lists.iter().flat_map(|list| list.windows(2)).find(|pair| pair[0] == pair[1]) {
        Some(pair) => Err(source.error_with(
            key,
            Some(&pair[0].to_string()),
            "is listed twice: a unit has at most one sensor",
        )),
        None => distinct(&lists, key, source),
    }
}

pub(super) fn distinct<T: serde::Serialize>(
    values: &[T],
    key: &str,
    source: &Source,
) -> Result<(), SpecError> {
    if values.is_empty() {
        return Err(source.error(key, "needs at least one value"));
    }
    let mut seen = HashSet::new();
    let as_set = |value: &T| whole(serde_json::to_value(value).expect("it is JSON")).to_string();
    match values.iter().find(|value| !seen.insert(as_set(value))) {
        Some(value) => Err(source.error_with(key, Some(&as_written(value)), "is listed twice")),
        None => Ok(()),
    }
}

/// Makes whole numbers integers: 15.0 sets a key to the same value as 15.
fn whole(value: Value) -> Value {
    match value {
        Value::Number(n) => match n.as_f64().filter(|x| n.is_f64() && x.fract() == 0.0 && x.abs() < 9e15) {
            Some(x) => Value::from(x as i64),
            None => Value::Number(n),
        },
        Value::Array(values) => values.into_iter().map(whole).collect(),
        Value::Object(keys) => keys.into_iter().map(|(key, value)| (key, whole(value))).collect(),
        value => value,
    }
}
