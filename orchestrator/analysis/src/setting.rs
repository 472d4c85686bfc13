//! Settings of a trial by path. Trials of a sweep share one copy of their common settings, and one copy of equal own settings.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

pub use metasense_schemas::spec::flatten;
use serde_json::Value;

/// Values of the spec by path, such as `body.columns`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Setting {
    shared: Arc<BTreeMap<String, Value>>,
    own: Arc<BTreeMap<String, Value>>,
}

/// Paths that differ between trials in most sweeps.
const OWN_PATHS: &[&str] =
    &["point.panels", "point.sensors", "point.placement", "point.seed", "sensor_units", "panel_units"];

impl Setting {
    /// The value at a path.
    pub fn get(&self, path: &str) -> Option<&Value> {
        self.own.get(path).or_else(|| self.shared.get(path))
    }

    /// The text at a path.
    pub fn text(&self, path: &str) -> Option<&str> {
        self.get(path)?.as_str()
    }

    /// The number at a path.
    pub fn number(&self, path: &str) -> Option<f64> {
        self.get(path)?.as_f64()
    }

    /// The whole number at a path.
    pub fn count(&self, path: &str) -> Option<u64> {
        self.get(path)?.as_u64()
    }

    /// Whether there is a value at a path.
    pub fn contains_key(&self, path: &str) -> bool {
        self.get(path).is_some()
    }

    /// Returns all values by path.
    pub fn leaves(&self) -> BTreeMap<&str, &Value> {
        self.shared.iter().chain(&*self.own).map(|(path, value)| (path.as_str(), value)).collect()
    }

    /// Values shared with other trials; equal values have the same address.
    pub(super) fn shared(&self) -> &Arc<BTreeMap<String, Value>> {
        &self.shared
    }

    /// The trial's own values; equal values have the same address.
    pub(super) fn own(&self) -> &Arc<BTreeMap<String, Value>> {
        &self.own
    }
}

/// Returns the paths at which the shared values of the settings differ.
pub fn differing_paths<'a>(settings: impl Iterator<Item = &'a Setting>) -> BTreeSet<&'a str> {
    let all: HashMap<_, _> = settings.map(|s| (Arc::as_ptr(&s.shared), &*s.shared)).collect();
    let Some(first) = all.values().next() else { return BTreeSet::new() };
    let paths: BTreeSet<&str> = all.values().flat_map(|shared| shared.keys()).map(String::as_str).collect();
    let unlike = |path: &&str| all.values().any(|shared| shared.get(*path) != first.get(*path));
    paths.into_iter().filter(unlike).collect()
}

/// Creates a setting with own values only.
impl FromIterator<(String, Value)> for Setting {
    fn from_iter<I: IntoIterator<Item = (String, Value)>>(leaves: I) -> Self {
        Self { shared: Arc::default(), own: Arc::new(leaves.into_iter().collect()) }
    }
}

/// Sets of values, each stored once.
#[derive(Debug, Default)]
struct InternedValues(HashMap<String, Arc<BTreeMap<String, Value>>>);

impl InternedValues {
    fn of(&mut self, values: BTreeMap<String, Value>) -> Arc<BTreeMap<String, Value>> {
        let name = serde_json::to_string(&values).expect("values are JSON");
        Arc::clone(self.0.entry(name).or_insert_with(|| Arc::new(values)))
    }
}

/// Stores values that settings share.
#[derive(Debug, Default)]
pub struct SharedSettings {
    shared: InternedValues,
    own: InternedValues,
}

impl SharedSettings {
    /// Returns the setting of a trial's spec. Recorded forces are identified by content, so their file names are dropped.
    pub fn of(&mut self, spec: &Value) -> Setting {
        let mut leaves = flatten(spec);
        leaves.remove("stimuli.recorded.files");
        let (own, shared) = leaves.into_iter().partition(|(path, _)| OWN_PATHS.contains(&path.as_str()));
        Setting { shared: self.shared.of(shared), own: self.own.of(own) }
    }

    /// Returns the distinct sets of shared values.
    pub fn shared(&self) -> impl Iterator<Item = &BTreeMap<String, Value>> {
        self.shared.0.values().map(Arc::as_ref)
    }
}

#[cfg(test)]
mod tests;
