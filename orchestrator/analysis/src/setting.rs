//! Everything that a trial is, by path. Trials of a sweep share most of it, and hold it once; what differs from trial to trial is
//! held once, too, by those that differ in the rest alone.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

pub use metasense_schemas::spec::flatten;
use serde_json::Value;

/// Values by path (`body.columns`), as the spec says them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Setting {
    shared: Arc<BTreeMap<String, Value>>,
    own: Arc<BTreeMap<String, Value>>,
}

/// What differs from trial to trial in most sweeps.
const OWN: &[&str] =
    &["point.panels", "point.sensors", "point.placement", "point.seed", "sensor_units", "panel_units"];

impl Setting {
    /// The value at a path.
    pub fn get(&self, path: &str) -> Option<&Value> {
        self.own.get(path).or_else(|| self.shared.get(path))
    }

    /// The text there.
    pub fn text(&self, path: &str) -> Option<&str> {
        self.get(path)?.as_str()
    }

    /// The number there.
    pub fn number(&self, path: &str) -> Option<f64> {
        self.get(path)?.as_f64()
    }

    /// The whole number there.
    pub fn count(&self, path: &str) -> Option<u64> {
        self.get(path)?.as_u64()
    }

    /// Whether there is one.
    pub fn contains_key(&self, path: &str) -> bool {
        self.get(path).is_some()
    }

    /// All of them, by path.
    pub fn leaves(&self) -> BTreeMap<&str, &Value> {
        self.shared.iter().chain(&*self.own).map(|(path, value)| (path.as_str(), value)).collect()
    }

    /// What it may share with others: equal, if the very same.
    pub(super) fn shared(&self) -> &Arc<BTreeMap<String, Value>> {
        &self.shared
    }

    /// What it has for itself: likewise.
    pub(super) fn own(&self) -> &Arc<BTreeMap<String, Value>> {
        &self.own
    }
}

/// Paths at which not all of what these share is alike.
pub fn odd<'a>(settings: impl Iterator<Item = &'a Setting>) -> BTreeSet<&'a str> {
    let all: HashMap<_, _> = settings.map(|s| (Arc::as_ptr(&s.shared), &*s.shared)).collect();
    let Some(first) = all.values().next() else { return BTreeSet::new() };
    let paths: BTreeSet<&str> = all.values().flat_map(|shared| shared.keys()).map(String::as_str).collect();
    let unlike = |path: &&str| all.values().any(|shared| shared.get(*path) != first.get(*path));
    paths.into_iter().filter(unlike).collect()
}

/// All of it its own.
impl FromIterator<(String, Value)> for Setting {
    fn from_iter<I: IntoIterator<Item = (String, Value)>>(leaves: I) -> Self {
        Self { shared: Arc::default(), own: Arc::new(leaves.into_iter().collect()) }
    }
}

/// Values by path, each set of them once.
#[derive(Debug, Default)]
struct Known(HashMap<String, Arc<BTreeMap<String, Value>>>);

impl Known {
    fn of(&mut self, values: BTreeMap<String, Value>) -> Arc<BTreeMap<String, Value>> {
        let name = serde_json::to_string(&values).expect("values are JSON");
        Arc::clone(self.0.entry(name).or_insert_with(|| Arc::new(values)))
    }
}

/// Keeps what settings share.
#[derive(Debug, Default)]
pub struct Settings {
    shared: Known,
    own: Known,
}

impl Settings {
    /// The setting of a trial, from its spec; of recorded forces what they hold, not where they lie.
    pub fn of(&mut self, spec: &Value) -> Setting {
        let mut leaves = flatten(spec);
        leaves.remove("stimuli.recorded.files");
        let (own, shared) = leaves.into_iter().partition(|(path, _)| OWN.contains(&path.as_str()));
        Setting { shared: self.shared.of(shared), own: self.own.of(own) }
    }

    /// What trials share, each once.
    pub fn shared(&self) -> impl Iterator<Item = &BTreeMap<String, Value>> {
        self.shared.0.values().map(Arc::as_ref)
    }
}

#[cfg(test)]
mod tests;
