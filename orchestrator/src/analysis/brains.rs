//! What the brain decides: error against what a brain remembers, and of bodies trained with one brain and read by another.
//!
//! Every trial is read by its own brain and, whatever that is, by linear ones of several memories (`v_reading`).

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use super::data::{Trial, geometric_mean};
use super::paired::Ratio;
use super::{Body, Cluster, Set};
use metasense_schemas::spec::{Brain, BrainKind, Network, Preset};
use serde_json::Value;

/// What a linear brain of one memory makes of a trial's bodies.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Reading {
    /// How far it looks back and ahead (s).
    pub memory: [f64; 2],
    /// Whether none looks farther.
    pub whole: bool,
    /// Error (%) by body and set.
    pub errors: [[Option<f64>; 2]; 2],
}

/// What one brain makes of bodies that were trained alike, on the holdout.
#[derive(Debug, Clone, PartialEq)]
pub struct Read {
    /// The brain that the optimised bodies were trained with.
    pub trained_with: String,
    /// The brain that reads both.
    pub by: String,
    /// How far it looks back and ahead (s).
    pub memory: [f64; 2],
    /// Whether it is a linear brain that sees the whole sample, or as much of it as any.
    pub whole: bool,
    /// Whether it is the trials' own brain.
    pub own: bool,
    /// Errors (%) of the initial and the optimised body: geometric means over the trials that have both.
    pub errors: [f64; 2],
    /// Initial over optimised error.
    pub ratio: Ratio,
}

/// The trial's own brain, and the one that its body was trained with.
#[must_use]
pub fn brains(trial: &Trial) -> [String; 2] {
    let text = |path: &str| trial.setting.get(path).and_then(Value::as_str);
    let own = match text("brain.kind") {
        Some("stacked") => match network(trial) {
            shape if shape == "cnn" => "stacked".to_owned(),
            shape => format!("stacked, {shape}"),
        },
        Some(kind) => match trial.setting.get("brain.memory") {
            Some(memory) => format!("{kind}, memory {memory} s"),
            None => kind.to_owned(),
        },
        None => network(trial),
    };
    let with = match text("optimise.brain") {
        Some(kind) => kind.to_owned(),
        None => network(trial),
    };
    match text("optimise.protocol") {
        None | Some("joint") => [own, with],
        Some(protocol) => [own, format!("{with} ({protocol})")],
    }
}

/// [`brains`] of each trial; those that share a setting are looked at once.
#[must_use]
pub fn of_each(trials: &[&Trial]) -> Vec<[String; 2]> {
    let mut known: HashMap<*const BTreeMap<String, Value>, [String; 2]> = HashMap::new();
    let mut of = |trial: &&Trial| {
        let own = trial
            .setting
            .own()
            .keys()
            .any(|path| path.starts_with("brain.") || path.starts_with("optimise."));
        match own {
            true => brains(trial),
            false => {
                known.entry(Arc::as_ptr(trial.setting.shared())).or_insert_with(|| brains(trial)).clone()
            }
        }
    };
    trials.iter().map(&mut of).collect()
}

/// The brain as the trial's spec has it.
fn of_spec(trial: &Trial) -> Brain {
    let leaves = trial.setting.leaves();
    let keys = leaves
        .into_iter()
        .filter_map(|(path, value)| Some((path.strip_prefix("brain.")?.to_owned(), value.clone())));
    serde_json::from_value(Value::Object(keys.collect())).unwrap_or_default()
}

/// How far the trial's own brain looks back and ahead (s).
#[must_use]
pub fn memory(trial: &Trial) -> [f64; 2] {
    let number = |path: &str| trial.setting.get(path).and_then(Value::as_f64);
    let duration = number("time.duration").unwrap_or(1.0);
    let instant = duration / number("time.samples").unwrap_or(200.0);
    let brain = of_spec(trial);
    if brain.kind != BrainKind::Cnn {
        let whole = duration - instant;
        return brain.memory.map_or([whole; 2], |memory| memory.map(|s| s.min(whole)));
    }
    let Network { kernels, dilations, causal, .. } = brain.network();
    let reach: usize = kernels.iter().zip(&dilations).map(|(k, d)| (k - 1) * d).sum();
    let reach = reach as f64 * instant;
    if causal { [reach, 0.0] } else { [0.5 * reach; 2] }
}

/// A network's name: `cnn` for the paper's shape.
fn network(trial: &Trial) -> String {
    let own = of_spec(trial).resolved();
    if own.network() == (Brain { preset: Some(Preset::Long), ..Brain::default() }).network() {
        return "long".into();
    }
    let mut name = "cnn".to_owned();
    if let Some(width) = own.width {
        name += &format!(", width {width}");
    }
    for (list, what) in [(own.kernels, "kernels"), (own.dilations, "dilations")] {
        if let Some(list) = list {
            let list: Vec<String> = list.iter().map(ToString::to_string).collect();
            name += &format!(", {what} {}", list.join(" "));
        }
    }
    if own.causal == Some(true) {
        name += ", causal";
    }
    name
}

/// What trials that differ in brains, placement and seed alone say: their own brains first, then the linear ones.
#[must_use]
pub fn reads(trials: &[&Trial]) -> Vec<Read> {
    let of_trials = of_each(trials);
    let mut kinds: Vec<[String; 2]> = Vec::new();
    for kind in &of_trials {
        if !kinds.contains(kind) {
            kinds.push(kind.clone());
        }
    }
    let having = |of: &dyn Fn(&[String; 2]) -> bool| -> Vec<&&Trial> {
        trials.iter().zip(&of_trials).filter(|(_, kind)| of(kind)).map(|(trial, _)| trial).collect()
    };
    let mut found = Vec::new();
    for [by, trained_with] in &kinds {
        let alike = having(&|kind| kind[0] == *by && kind[1] == *trained_with);
        let errors = |t: &&&Trial| (t.cluster, Body::ALL.map(|body| t.error(body, Set::Holdout)));
        let memory = alike.first().map_or([0.0; 2], |t| memory(t));
        found.extend(read(trained_with, by, (memory, false, true), alike.iter().map(errors)));
    }
    let mut with: Vec<&String> = kinds.iter().map(|kind| &kind[1]).collect();
    with.sort();
    with.dedup();
    for trained_with in with {
        // trials that differ in their reader alone have one body, and one reading of it
        let mut alike: Vec<&&Trial> = Vec::new();
        let mut read_so: HashMap<(Cluster, u64), Vec<&&Trial>> = HashMap::new();
        for trial in having(&|kind| kind[1] == *trained_with) {
            let known = read_so.entry((trial.cluster, trial.sensors)).or_default();
            if !known.iter().any(|t| t.readings == trial.readings) {
                known.push(trial);
                alike.push(trial);
            }
        }
        let mut memories: Vec<([f64; 2], bool)> = Vec::new();
        for reading in alike.iter().flat_map(|t| &t.readings) {
            if !memories.contains(&(reading.memory, reading.whole)) {
                memories.push((reading.memory, reading.whole));
            }
        }
        memories.sort_by(|a, b| (b.1, a.0[0], a.0[1]).partial_cmp(&(a.1, b.0[0], b.0[1])).expect("finite"));
        for (memory, whole) in memories {
            let errors = alike.iter().filter_map(|t| {
                let reading = t.readings.iter().find(|r| r.memory == memory)?;
                let errors = reading.errors.map(|body| body[Set::Holdout as usize].filter(|e| *e > 0.0));
                Some((t.cluster, errors))
            });
            found.extend(read(trained_with, "linear", (memory, whole, false), errors));
        }
    }
    found
}

fn read(
    trained_with: &str,
    by: &str,
    (memory, whole, own): ([f64; 2], bool, bool),
    errors: impl Iterator<Item = (Cluster, [Option<f64>; 2])>,
) -> Option<Read> {
    let pairs: Vec<(Cluster, [f64; 2])> =
        errors.filter_map(|(cluster, [a, b])| Some((cluster, [a?, b?]))).collect();
    let ratio = Ratio::of(&pairs.iter().map(|(cluster, [a, b])| (*cluster, a / b)).collect::<Vec<_>>())?;
    let of = |body: usize| geometric_mean(&pairs.iter().map(|(_, pair)| pair[body]).collect::<Vec<_>>());
    let (trained_with, by) = (trained_with.to_owned(), by.to_owned());
    Some(Read { trained_with, by, memory, whole, own, errors: [of(0), of(1)], ratio })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn trial(brain: Option<&str>, with: Option<&str>, seed: u64, own: [f64; 2], whole: [f64; 2]) -> Trial {
        let keys = [("brain.kind", brain), ("optimise.brain", with)];
        let pair = |e: [f64; 2]| e.map(|e| [Some(2.0 * e), Some(e)]);
        Trial {
            setting: keys.into_iter().filter_map(|(k, v)| Some((k.to_owned(), json!(v?)))).collect(),
            cluster: Cluster { placement: 0, seed },
            errors: pair(own),
            readings: vec![
                Reading { memory: [1.0, 1.0], whole: true, errors: pair(whole) },
                Reading { memory: [1.0, 0.0], whole: false, errors: pair(whole.map(|e| 3.0 * e)) },
            ],
            ..Trial::default()
        }
    }

    /// Own brains apart by what trained and what reads, linear readings by what trained, both bodies of equal trials.
    #[test]
    fn bodies_stand_by_what_trained_and_what_read_them() {
        let trials = [
            trial(None, None, 1, [20.0, 10.0], [8.0, 4.0]),
            trial(None, None, 2, [20.0, 10.0], [2.0, 1.0]),
            trial(None, Some("linear"), 1, [20.0, 5.0], [8.0, 0.5]),
            trial(Some("linear"), Some("linear"), 1, [8.0, 0.5], [8.0, 0.5]),
        ];
        let found = reads(&trials.iter().collect::<Vec<_>>());
        let rows: Vec<(&str, &str, bool, [f64; 2], usize)> = found
            .iter()
            .map(|r| {
                let errors = r.errors.map(|e| (1e6 * e).round() / 1e6);
                (&r.trained_with[..], &r.by[..], r.whole, errors, r.ratio.trials)
            })
            .collect();
        assert_eq!(
            rows,
            [
                ("cnn", "cnn", false, [20.0, 10.0], 2),
                ("linear", "cnn", false, [20.0, 5.0], 1),
                ("linear", "linear", false, [8.0, 0.5], 1),
                ("cnn", "linear", true, [4.0, 2.0], 2),
                ("cnn", "linear", false, [12.0, 6.0], 2),
                ("linear", "linear", true, [8.0, 0.5], 1),
                ("linear", "linear", false, [24.0, 1.5], 1),
            ]
        );
    }
}
