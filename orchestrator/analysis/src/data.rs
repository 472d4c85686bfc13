//! Groups of comparable trials, and the errors of a group along an axis.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::hash::Hash;
use std::rc::Rc;
use std::sync::Arc;

use serde_json::Value;

use super::kinds::{brains, format_brains, objective};
use super::numbers::{distinct, distinct_numbers, geometric_mean};
use super::trial::{BodyState, Cluster, Set, Trial};
use metasense_render::cell::brief;

/// An error (%) at one value of an axis, such as the number of sensors or of design parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Value on the axis.
    pub at: f64,
    /// Placement and seed.
    pub cluster: Cluster,
    /// Prediction error (%), above 0.
    pub error: f64,
}

/// Trials that differ only in what a question varies.
#[derive(Debug, Clone)]
pub struct Group<'a> {
    /// Differences from the other groups, for instance `K = 4, 6 × 4 units`.
    pub label: String,
    /// Its trials, in the given order.
    pub trials: Vec<&'a Trial>,
}

impl Group<'_> {
    /// Whether the trials differ in this number.
    pub fn varies(&self, number: fn(&Trial) -> u64) -> bool {
        self.trials.iter().any(|t| number(t) != number(self.trials[0]))
    }
}

/// Settings that differ between placements and seeds, and one that does not change the ordinary comparison. Groups ignore them.
const CLUSTER: &[&str] = &["point.placement", "point.seed", "sensor_units", "sensors.placements", LONG];
const LONG: &str = "evaluation.long_iterations";

/// Settings of further evaluations of finished bodies. They separate only trials that both have such a setting and differ in
/// it: training over casts also appears in the objective.
const FURTHER_EVALUATION: &[&str] =
    &["evaluation.casts", "evaluation.tasks", "evaluation.under", "variation."];

/// Settings that differ between numbers of sensors.
pub const SENSORS: &[&str] = &["point.sensors"];

/// Settings that differ between ways of placing sensors.
pub const SEARCH: &[&str] = &["sensors.search", "sensors.from", "sensors.spacing"];

/// Settings that differ between body complexities. Lengths of a circular body shrink as its number of units grows.
pub const COMPLEXITY: &[&str] = &[
    "body.columns",
    "body.rows",
    "body.spacing",
    "body.ligament_length",
    "body.panel_units",
    "body.panels",
    "panel_units",
    "feasible.min_edge",
    "feasible.clearance",
    "feasible.ligament_clearance",
];

/// Settings of the number of design parameters at constant size.
pub const FREEDOM: &[&str] = &["optimise.tie", "optimise.frozen"];

/// Settings that scale with the spacing in a body of constant size, and the power of the spacing.
pub(super) const WITH_SPACING: [(&str, i32); 4] = [
    ("body.stiffness.bend", 2),
    ("body.contact.stiffness", 2),
    ("body.material.ligament_width", 1),
    ("optimise.learning_rate", 1),
];

/// Settings that differ between random bodies, and those of the training.
pub const DESIGN: &[&str] = &["body.design", "body.design.", "optimise.", "optimise.tie", "optimise.frozen"];

/// Settings that differ between decoders, and those of the training.
pub const BRAINS: &[&str] = &["brain.", "optimise.", "evaluation."];

/// Settings that differ between ways of training. Networks are several and train in batches; a linear decoder is one fit.
pub const TRAINING: &[&str] = &["optimise.", "brain.", "solver.", "evaluation.seeds", "evaluation.batch"];

type Key = Vec<(String, Value)>;

/// Groups trials that agree in all settings except placement, seed and the paths in `but` (a path that ends in a dot: all below
/// it). Groups are in the order of their first trials.
pub fn groups<'a>(trials: &[&'a Trial], but: &[&str]) -> Vec<Group<'a>> {
    let disputed = disputed(trials);
    // `FREEDOM` paths are ignored only by name, not as part of `optimise.`
    let ignored = |path: &str| {
        CLUSTER.iter().chain(but).any(|b| is_at_or_below(path, b) && (*b == path || !FREEDOM.contains(&path)))
            || FURTHER_EVALUATION.iter().any(|b| is_at_or_below(path, b)) && !disputed.contains(path)
    };
    let spacing = |trial: &Trial| trial.setting.number("body.spacing");
    let first = trials.first().and_then(|trial| spacing(trial));
    // the value scaled to the spacing of the first trial, if groups ignore the spacing
    let value = |trial: &Trial, path: &str, value: &Value| -> Value {
        let power = WITH_SPACING.iter().find(|(p, _)| ignored("body.spacing") && path == *p);
        let (Some((_, power)), Some(own), Some(first), Some(number)) =
            (power, spacing(trial), first, value.as_f64())
        else {
            return value.clone();
        };
        let scaled = number * (first / own).powi(*power);
        // the first trial's value is rounded too, or it would equal no other
        Value::from((scaled * 1e9).round() / 1e9)
    };
    let label_text = |trial: &Trial, leaves: &BTreeMap<String, Value>| -> String {
        let label_text = leaves.iter().filter(|(path, _)| !ignored(path));
        label_text.map(|(path, v)| format!("{path} = {}\n", value(trial, path, v))).collect()
    };
    let key = |trial: &Trial| -> Key {
        let leaves = trial.setting.leaves().into_iter().filter(|(path, _)| !ignored(path));
        leaves.map(|(path, v)| (path.to_owned(), value(trial, path, v))).collect()
    };
    // Shared settings are converted to text once.
    let mut shared: HashMap<*const BTreeMap<String, Value>, usize> = HashMap::new();
    let mut texts: HashMap<String, usize> = HashMap::new();
    let mut places: HashMap<(usize, String), usize> = HashMap::new();
    let mut found: Vec<(Key, Vec<&'a Trial>)> = Vec::new();
    for trial in trials {
        let common = *shared.entry(Arc::as_ptr(trial.setting.shared())).or_insert_with(|| {
            let count = texts.len();
            *texts.entry(label_text(trial, trial.setting.shared())).or_insert(count)
        });
        let place = *places.entry((common, label_text(trial, trial.setting.own()))).or_insert_with(|| {
            found.push((key(trial), Vec::new()));
            found.len() - 1
        });
        found[place].1.push(trial);
    }
    let kinds = found.iter().map(|(key, trials)| kind(key, trials[0])).collect();
    let labels = labels(&found.iter().map(|(k, _)| k).collect::<Vec<_>>(), kinds);
    labels.into_iter().zip(found).map(|(label, (_, trials))| Group { label, trials }).collect()
}

/// Whether a path is a setting of the training; `FREEDOM` is not.
fn trains(path: &str) -> bool {
    path.starts_with("optimise.") && !FREEDOM.contains(&path)
}

/// Like [`groups`], also separated by objective: the test error over casts is not comparable with that as designed.
pub fn groups_by_objective<'a>(trials: &[&'a Trial], but: &[&str]) -> Vec<Group<'a>> {
    let part = |group: &Group<'a>, over: &Option<String>| {
        let trials: Vec<_> =
            group.trials.iter().copied().filter(|trial| objective(&trial.setting) == *over).collect();
        let label_text = over.as_ref().map_or(String::new(), |over| format!(", {over}"));
        (!trials.is_empty()).then(|| Group { label: format!("{}{label_text}", group.label), trials })
    };
    let over = distinct(trials.iter().map(|trial| objective(&trial.setting)));
    let found = groups(trials, but);
    found.iter().flat_map(|group| over.iter().filter_map(|over| part(group, over))).collect()
}

/// Whether a path equals `name`, or lies below it if `name` ends in a dot.
fn is_at_or_below(path: &str, name: &str) -> bool {
    path == name || (name.ends_with('.') && path.starts_with(name))
}

/// Paths of [`FURTHER_EVALUATION`] at which two trials differ, both of which have settings of this kind.
fn disputed(trials: &[&Trial]) -> HashSet<String> {
    let (mut shared, mut first, mut disputed) = (HashMap::new(), HashMap::new(), HashSet::new());
    for trial in trials {
        let common = trial.setting.shared();
        let common = shared.entry(Arc::as_ptr(common)).or_insert_with(|| judging(common));
        let evaluation_values: Vec<_> = common.iter().copied().chain(judging(trial.setting.own())).collect();
        for name in FURTHER_EVALUATION {
            let own: BTreeMap<_, _> =
                evaluation_values.iter().copied().filter(|(path, _)| is_at_or_below(path, name)).collect();
            if own.is_empty() {
                continue;
            }
            let first = first.entry(name).or_insert_with(|| own.clone());
            let differs = |path: &&&String| first.get(**path) != own.get(**path);
            disputed.extend(own.keys().chain(first.keys()).filter(differs).map(|path| (*path).clone()));
        }
    }
    disputed
}

/// Returns the leaves below [`FURTHER_EVALUATION`].
fn judging(leaves: &BTreeMap<String, Value>) -> Vec<(&String, &Value)> {
    let further = |path: &str| FURTHER_EVALUATION.iter().any(|name| is_at_or_below(path, name));
    leaves.iter().filter(|(path, _)| further(path)).collect()
}

/// Returns the trials with a value of `found`. Of trials that differ only in further evaluations of their bodies, only the
/// first counts. For bodies trained over casts, the variation belongs to the training.
pub fn without_repeats<'a, V>(
    trials: &[&'a Trial],
    found: impl Fn(&Trial) -> Option<V>,
) -> impl Iterator<Item = (&'a Trial, V)> {
    let judges = |path: &str, over_casts: bool| {
        path == LONG
            || FURTHER_EVALUATION.iter().any(|name| is_at_or_below(path, name))
                && !(over_casts && path.starts_with("variation."))
    };
    let (mut kinds, mut known, mut seen) = (HashMap::new(), Vec::new(), HashSet::new());
    trials.iter().filter_map(move |&trial| {
        let found = found(trial)?;
        let [shared, own] = [trial.setting.shared(), trial.setting.own()];
        let kind = *kinds.entry(Arc::as_ptr(shared)).or_insert_with(|| {
            let over_casts = shared.keys().any(|path| path.starts_with("optimise.objective"));
            let left: Vec<_> = shared.iter().filter(|(path, _)| !judges(path, over_casts)).collect();
            known.iter().position(|known| *known == left).unwrap_or_else(|| {
                known.push(left);
                known.len() - 1
            })
        });
        seen.insert((kind, Arc::as_ptr(own))).then_some((trial, found))
    })
}

/// Returns the value at a path; keys are sorted.
fn value_at<'k>(key: &'k Key, path: &str) -> Option<&'k Value> {
    key.binary_search_by(|(p, _)| p.as_str().cmp(path)).ok().map(|i| &key[i].1)
}

/// Paths at which the keys differ.
fn differing<'k>(keys: &[&'k Key]) -> HashSet<&'k str> {
    let Some(first) = keys.first() else { return HashSet::new() };
    let mut differing = HashSet::new();
    for key in keys {
        let odd = key.iter().filter(|(path, value)| value_at(first, path) != Some(value));
        differing.extend(odd.map(|(path, _)| path.as_str()));
        let missing = first.iter().filter(|(path, _)| value_at(key, path).is_none());
        differing.extend(missing.map(|(path, _)| path.as_str()));
    }
    differing
}

/// For each key, the paths at which the keys of its kind differ.
fn differing_within<'k, K: Hash + Eq>(keys: &[&'k Key], kinds: &[K]) -> Vec<Rc<HashSet<&'k str>>> {
    let mut of_kind: HashMap<&K, Vec<&'k Key>> = HashMap::new();
    keys.iter().zip(kinds).for_each(|(key, kind)| of_kind.entry(kind).or_default().push(key));
    let differing: HashMap<&K, Rc<HashSet<&str>>> =
        of_kind.into_iter().map(|(kind, keys)| (kind, Rc::new(differing(&keys)))).collect();
    kinds.iter().map(|kind| Rc::clone(&differing[kind])).collect()
}

/// Decoders of a group: in evaluation and in training. Taken from its first trial if settings of the training are in the key.
fn kind(key: &Key, first: &Trial) -> [String; 2] {
    // settings that follow from the decoder need not be listed beside it
    if key.iter().any(|(path, _)| trains(path)) && key.iter().any(|(path, _)| path.starts_with("brain.")) {
        return brains(&first.setting);
    }
    brains(&key.iter().cloned().collect())
}

/// Labels contain K, M if it is fixed, and settings that differ among the groups, but no panel units, which follow from K and
/// layout.
fn labels(all: &[&Key], kinds: Vec<[String; 2]>) -> Vec<String> {
    // defaults of a kind of forces differ with the kind
    let stimuli: Vec<Option<String>> =
        all.iter().map(|key| value_at(key, "stimuli.kind").map(Value::to_string)).collect();
    let differs = differing(all);
    let (alike, struck) = (differing_within(all, &kinds), differing_within(all, &stimuli));
    let one_kind = kinds.iter().all(|kind| *kind == kinds[0]);
    let label_text = all.iter().zip(&kinds).zip(alike.iter().zip(&struck));
    label_text
        .map(|((key, own), (alike, struck))| label(key, own, one_kind, [&differs, alike, struck]))
        .collect()
}

/// `differ`: paths at which all groups differ, groups of the same decoders, and groups of the same forces.
fn label(key: &Key, own: &[String; 2], one_kind: bool, differ: [&HashSet<&str>; 3]) -> String {
    let value = |path: &str| value_at(key, path);
    let [differs, alike, struck] = differ;
    let of_brains =
        |path: &str| BRAINS.iter().any(|table| path.starts_with(table)) && !FREEDOM.contains(&path);
    let mut parts = Vec::new();
    for (name, path) in [("K", "point.panels"), ("M", "point.sensors")] {
        parts.extend(value(path).map(|v| format!("{name} = {v}")));
    }
    const SIZES: [&str; 2] = ["body.columns", "body.rows"];
    match SIZES.map(value) {
        [Some(columns), Some(rows)] if SIZES.iter().any(|p| differs.contains(p)) => {
            parts.push(format!("{columns} × {rows} units"));
        }
        [Some(columns), None] if differs.contains(SIZES[0]) => parts.push(format!("{columns} units across")),
        _ => {}
    }
    if !one_kind {
        let training_told = key.iter().any(|(path, _)| trains(path));
        parts.push(if training_told { format_brains(own) } else { own[0].clone() });
    }
    for (path, value) in key {
        // these follow from the material
        let given = path == "body.density" || path.starts_with("body.stiffness.");
        let is_implied = path.starts_with("point.")
            || path.ends_with("panel_units")
            || SIZES.contains(&path.as_str())
            || given && value_at(key, "body.material.thickness").is_some();
        let is_distinguishing = match path.as_str() {
            path if of_brains(path) => alike.contains(path),
            path if path.starts_with("stimuli.") && path != "stimuli.kind" => struck.contains(path),
            path => differs.contains(path),
        };
        if !is_implied && is_distinguishing {
            parts.push(format!("{path} = {}", brief(value)));
        }
    }
    parts.join(", ")
}

/// Returns the errors of trials along an axis.
pub fn observations(trials: &[&Trial], body: BodyState, set: Set, at: fn(&Trial) -> u64) -> Vec<Observation> {
    without_repeats(trials, |t| t.error(body, set))
        .map(|(t, error)| Observation { at: at(t) as f64, cluster: t.cluster, error })
        .collect()
}

/// Returns the distinct values of the axis, ascending.
pub fn places(observations: &[Observation]) -> Vec<f64> {
    distinct_numbers(observations.iter().map(|o| o.at))
}

/// Errors along an axis, indexed for repeated weighting of clusters.
#[derive(Debug, Clone)]
pub struct Grid {
    /// Values of the axis, ascending.
    pub places: Vec<f64>,
    /// Index of the cluster, index of the place, and ln e of every observation.
    pub points: Vec<(usize, usize, f64)>,
}

impl Grid {
    /// Indexes observations. `clusters` must be sorted.
    ///
    /// # Panics
    /// If an observation has another cluster.
    pub fn new(observations: &[Observation], clusters: &[Cluster]) -> Self {
        let places = places(observations);
        let point = |o: &Observation| {
            let cluster = clusters.binary_search(&o.cluster).expect("a cluster of the observations");
            let place = places.binary_search_by(|p| p.total_cmp(&o.at)).expect("a place of the observations");
            (cluster, place, o.error.ln())
        };
        Self { points: observations.iter().map(point).collect(), places }
    }

    /// Geometric mean of the error at every place with weighted clusters; `None` where all weights are 0.
    pub fn means(&self, weights: &[f64]) -> Vec<Option<f64>> {
        let mut sums = vec![[0.0; 2]; self.places.len()];
        for &(cluster, place, log) in &self.points {
            sums[place][0] += weights[cluster] * log;
            sums[place][1] += weights[cluster];
        }
        sums.into_iter().map(|[sum, n]| (n > 0.0).then(|| (sum / n).exp())).collect()
    }
}

/// Returns the distinct clusters of observations, sorted.
pub fn clusters<'a>(observations: impl IntoIterator<Item = &'a Observation>) -> Vec<Cluster> {
    distinct(observations.into_iter().map(|o| o.cluster))
}

/// Errors at one value of an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Level {
    /// Value on the axis.
    pub at: f64,
    /// Number of trials.
    pub trials: usize,
    /// Geometric mean of the error (%).
    pub mean: f64,
    /// Smallest error (%).
    pub least: f64,
    /// Largest error (%).
    pub most: f64,
}

/// Returns mean and range of the error at every value of the axis.
pub fn levels(observations: &[Observation]) -> Vec<Level> {
    let level = |at: f64| {
        let errors: Vec<f64> = observations.iter().filter(|o| o.at == at).map(|o| o.error).collect();
        let of = |start, pick: fn(f64, f64) -> f64| errors.iter().copied().fold(start, pick);
        let (least, most) = (of(f64::INFINITY, f64::min), of(0.0, f64::max));
        Level { at, trials: errors.len(), mean: geometric_mean(&errors), least, most }
    };
    places(observations).into_iter().map(level).collect()
}

/// Returns the parts of a label except K and M.
pub(super) fn apart(label: &str) -> Vec<&str> {
    label.split(", ").filter(|part| !part.starts_with("K = ") && !part.starts_with("M = ")).collect()
}

#[cfg(test)]
mod tests;
