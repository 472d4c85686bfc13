//! Names of decoders: that of a trial, and that with which its body was trained.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use metasense_schemas::spec::{Brain, BrainKind, Network, Preset};
use serde_json::Value;

use super::setting::{Setting, flatten};
use super::trial::Trial;

/// Returns the names of the trial's own decoder and of the decoder in the training of its body.
pub fn brains(setting: &Setting) -> [String; 2] {
    brains_for(setting, setting.text("brain.task"))
}

/// The name of the decoder in the training of the body, without the task.
pub fn trained_with(setting: &Setting) -> String {
    let [_, with] = brains_for(setting, None);
    with
}

fn brains_for(setting: &Setting, task: Option<&str>) -> [String; 2] {
    let mut own = match setting.text("brain.kind") {
        Some("stacked") => match network(setting) {
            shape if shape == "cnn" => "stacked".to_owned(),
            shape => format!("stacked, {shape}"),
        },
        Some(kind) => match setting.get("brain.memory") {
            Some(memory) => format!("{kind}, memory {memory} s"),
            None => kind.to_owned(),
        },
        None => network(setting),
    };
    let mut with = setting.text("optimise.brain").map_or_else(|| network(setting), str::to_owned);
    if let Some(task) = task {
        [&mut own, &mut with].into_iter().for_each(|kind| *kind += &format!(" for {task}"));
    }
    with.extend(objective(setting).map(|over| format!(", {over}")));
    match setting.text("optimise.protocol") {
        None | Some("joint") => [own, with],
        Some(protocol) => [own, format!("{with} ({protocol})")],
    }
}

/// Formats [`brains`].
pub fn format_brains([by, with]: &[String; 2]) -> String {
    match with.strip_prefix(&by[..]) {
        // the same decoder, perhaps with an objective or protocol
        Some(rest) if rest.is_empty() || rest.starts_with([',', ' ']) => with.clone(),
        _ => format!("trained with {with}, evaluated with {by}"),
    }
}

/// [`brains`] of a trial's spec, or of a part that contains the decoder.
pub fn brains_of(spec: &Value) -> [String; 2] {
    brains(&flatten(spec).into_iter().collect())
}

/// Returns the objective over casts or over the parts of a mixture; `None`: training as designed.
pub fn objective(setting: &Setting) -> Option<String> {
    let tail = setting.get("optimise.objective.cvar").map(|q| format!("cvar {q}"));
    let objective = tail.or_else(|| setting.text("optimise.objective").map(str::to_owned))?;
    let varies = || setting.leaves().keys().any(|path| path.starts_with("variation."));
    let of = if setting.text("stimuli.kind") == Some("mix") && !varies() { "parts" } else { "casts" };
    Some(format!("{objective} of {of}"))
}

/// Whether the trial's own decoder is linear and estimates forces.
pub fn is_linear(trial: &Trial) -> bool {
    trial.setting.text("brain.kind") == Some("linear") && !trial.setting.contains_key("brain.task")
}

/// [`brains`] of each trial, computed once per shared setting.
pub fn brains_by_trial(trials: &[&Trial]) -> Vec<[String; 2]> {
    let mut known: HashMap<*const BTreeMap<String, Value>, [String; 2]> = HashMap::new();
    let mut of = |trial: &&Trial| {
        let names_brain = |path: &String| path.starts_with("brain.") || path.starts_with("optimise.");
        let shared = known.entry(Arc::as_ptr(trial.setting.shared()));
        match trial.setting.own().keys().any(names_brain) {
            true => brains(&trial.setting),
            false => shared.or_insert_with(|| brains(&trial.setting)).clone(),
        }
    };
    trials.iter().map(&mut of).collect()
}

/// Returns `[brain]` of the trial's spec.
fn parse_brain(setting: &Setting) -> Brain {
    let key = |(path, value): (&str, &Value)| Some((path.strip_prefix("brain.")?.to_owned(), value.clone()));
    serde_json::from_value(setting.leaves().into_iter().filter_map(key).collect()).unwrap_or_default()
}

/// Returns the memory of the trial's own decoder before and after an instant (s).
pub fn memory(trial: &Trial) -> [f64; 2] {
    let duration = trial.setting.number("time.duration").unwrap_or(1.0);
    let instant = duration / trial.setting.number("time.samples").unwrap_or(200.0);
    let brain = parse_brain(&trial.setting);
    if brain.kind != BrainKind::Cnn {
        let whole = duration - instant;
        return brain.memory.map_or([whole; 2], |memory| memory.map(|s| s.min(whole)));
    }
    let Network { kernels, dilations, causal, .. } = brain.network();
    let reach: usize = kernels.iter().zip(&dilations).map(|(k, d)| (k - 1) * d).sum();
    let reach = reach as f64 * instant;
    if causal { [reach, 0.0] } else { [0.5 * reach; 2] }
}

/// Returns the name of the network: `cnn` for the paper's shape.
fn network(setting: &Setting) -> String {
    let own = parse_brain(setting).resolved();
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
