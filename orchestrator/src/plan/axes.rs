//! Axes beyond K, M, placement and seed: any key by its path; and the points that are left out.

use metasense_schemas::source::{KnownKeys, Source, SpecError};
use metasense_schemas::spec::SweepSpec;
use serde_json::{Map, Value};

/// The spec at one value of every axis.
pub(super) struct Combination {
    pub spec: SweepSpec,
    /// Entries of `exclude` that agree with the axes, without those.
    excludes: Vec<Map<String, Value>>,
}

/// What remains of an entry of `exclude` once axes, K and M agree.
#[derive(Debug, Clone)]
pub(super) struct Exclusion {
    placement: Option<Value>,
    seed: Option<Value>,
}

impl Exclusion {
    /// Whether it leaves out all placements and seeds.
    pub fn is_total(&self) -> bool {
        self.placement.is_none() && self.seed.is_none()
    }

    pub fn holds(&self, placement: usize, seed: u64) -> bool {
        self.placement.as_ref().is_none_or(|v| v.as_u64() == Some(placement as u64))
            && self.seed.as_ref().is_none_or(|v| v.as_u64() == Some(seed))
    }
}

impl Combination {
    pub fn exclusions(&self, panels: usize, sensors: usize) -> Vec<Exclusion> {
        let agrees = |entry: &Map<String, Value>, key: &str, n: usize| {
            entry.get(key).is_none_or(|v| v.as_u64() == Some(n as u64))
        };
        self.excludes
            .iter()
            .filter(|entry| agrees(entry, "panels", panels) && agrees(entry, "sensors", sensors))
            .map(|entry| Exclusion {
                placement: entry.get("placement").cloned(),
                seed: entry.get("seed").cloned(),
            })
            .collect()
    }
}

/// The product of all axes, the last one (in the order of names) varying fastest.
pub(super) fn combinations(spec: &SweepSpec, source: &Source) -> Result<Vec<Combination>, SpecError> {
    let axes: Vec<(&String, &Vec<Value>)> = spec.sweep.axes.iter().collect();
    check_excludes(spec, source)?;
    if axes.is_empty() {
        return Ok(vec![Combination { spec: spec.clone(), excludes: spec.sweep.exclude.clone() }]);
    }
    let mut base = spec.clone();
    base.sweep.exclude.clear();
    base.sweep.axes.clear();
    let base = serde_json::to_value(&base).expect("a spec is JSON");
    for (path, values) in &axes {
        for value in *values {
            let mut one = base.clone();
            set(&mut one, path, value);
            serde_json::from_value::<SweepSpec>(one).map_err(|e| refused(path, value, &e, source))?;
        }
    }
    let count = axes.iter().map(|(_, values)| values.len()).product();
    let mut combinations = Vec::with_capacity(count);
    for index in 0..count {
        let mut point = base.clone();
        let mut rest = index;
        let mut chosen: Vec<(&str, &Value)> = Vec::with_capacity(axes.len());
        for (path, values) in axes.iter().rev() {
            let value = &values[rest % values.len()];
            rest /= values.len();
            set(&mut point, path, value);
            chosen.push((path, value));
        }
        let excludes = spec.sweep.exclude.iter().filter_map(|entry| without_axes(entry, &chosen)).collect();
        let spec = serde_json::from_value(point).map_err(|e| source.error("sweep", &e.to_string()))?;
        combinations.push(Combination { spec, excludes });
    }
    Ok(combinations)
}

/// A value that its key cannot have; within a table, only serde knows where.
fn refused(path: &str, value: &Value, e: &serde_json::Error, source: &Source) -> SpecError {
    let message = match value {
        Value::Object(_) => e.to_string(),
        _ => KnownKeys::of_spec().in_words(path, &e.to_string()),
    };
    source.error_with(path, Some(&value.to_string()), &message)
}

/// The entry without its axes, or `None` where one of them disagrees.
fn without_axes(entry: &Map<String, Value>, chosen: &[(&str, &Value)]) -> Option<Map<String, Value>> {
    let mut rest = entry.clone();
    for (path, value) in chosen {
        if let Some(wanted) = rest.remove(*path)
            && !same(&wanted, value)
        {
            return None;
        }
    }
    Some(rest)
}

/// Equal, numbers by their value.
fn same(a: &Value, b: &Value) -> bool {
    match (a.as_f64(), b.as_f64()) {
        (Some(a), Some(b)) => a == b,
        _ => a == b,
    }
}

fn check_excludes(spec: &SweepSpec, source: &Source) -> Result<(), SpecError> {
    let mut known = vec!["panels", "sensors", "placement", "seed"];
    known.extend(spec.sweep.axes.keys().map(String::as_str));
    for entry in &spec.sweep.exclude {
        if entry.is_empty() {
            return Err(source.error_with(
                "sweep.exclude",
                Some("{}"),
                "an empty entry leaves out everything",
            ));
        }
        for (key, value) in entry {
            if !known.contains(&key.as_str()) {
                let remedy = match KnownKeys::nearest_of(key, known.iter().copied()) {
                    Some(nearest) => {
                        format!("unknown key {key:?}; the nearest known one here is {nearest:?}")
                    }
                    None => format!("unknown key {key:?}; those known here are {}", known.join(", ")),
                };
                return Err(source.error_with("sweep.exclude", Some(&value.to_string()), &remedy));
            }
            if !key.contains('.') && value.as_u64().is_none() {
                let remedy = format!("{key:?} must be a number from 0 up");
                return Err(source.error_with("sweep.exclude", Some(&value.to_string()), &remedy));
            }
        }
    }
    Ok(())
}

/// Sets a key by its path; tables on the way that are left out come into being.
fn set(spec: &mut Value, path: &str, value: &Value) {
    let mut here = spec;
    for part in path.split('.') {
        if !here.is_object() {
            *here = Value::Object(Map::new());
        }
        here = here.as_object_mut().expect("made one above").entry(part).or_insert(Value::Null);
    }
    *here = value.clone();
}
