//! Axes over other keys than K, M, placement and seed: lists per key, or points that set several keys; and exclusions.

use crate::analysis::numbers;
use metasense_schemas::spec::SweepSpec;
use metasense_source::{KnownKeys, Source, SpecError};
use serde_json::{Map, Value};

/// The spec at one value per axis.
pub(crate) struct Combination {
    pub spec: SweepSpec,
    /// Entries of `exclude` that match the axes, without the keys of the axes.
    excludes: Vec<Map<String, Value>>,
}

/// Placement and seed that an entry of `exclude` removes; `None`: all.
pub(super) type Exclusion = [Option<u64>; 2];

impl Combination {
    /// The entries of `exclude` that match K and M.
    pub(super) fn exclusions(&self, panels: usize, sensors: usize) -> Vec<Exclusion> {
        let number = |entry: &Map<String, Value>, key| entry.get(key).and_then(Value::as_u64);
        let agrees = |entry: &&Map<String, Value>| {
            number(entry, "panels").is_none_or(|n| n == panels as u64)
                && number(entry, "sensors").is_none_or(|n| n == sensors as u64)
        };
        let entries = self.excludes.iter().filter(agrees);
        entries.map(|entry| ["placement", "seed"].map(|key| number(entry, key))).collect()
    }
}

/// All combinations of points and axis values. The last axis by name varies fastest, points slowest.
pub(crate) fn combinations(spec: &SweepSpec, source: &Source) -> Result<Vec<Combination>, SpecError> {
    check_points(spec, source)?;
    check_excludes(spec, source)?;
    let axes = &spec.sweep.axes;
    if axes.is_empty() && spec.sweep.points.is_empty() {
        return Ok(vec![Combination { spec: spec.clone(), excludes: spec.sweep.exclude.clone() }]);
    }
    let none = [Map::new()];
    let points = if spec.sweep.points.is_empty() { &none[..] } else { &spec.sweep.points };
    points.iter().try_for_each(|point| refuse_overlaps(spec, point, source))?;
    let mut base = spec.clone();
    base.sweep.exclude.clear();
    base.sweep.axes.clear();
    base.sweep.points.clear();
    let base = serde_json::to_value(&base).expect("a spec is JSON");
    let spec_with_keys = |keys: &[(&str, &Value)]| {
        let mut spec = base.clone();
        keys.iter().for_each(|(key, value)| set(&mut spec, key, value));
        serde_json::from_value::<SweepSpec>(spec)
    };
    for (key, value) in axes.iter().flat_map(|(path, values)| values.iter().map(move |v| (path.as_str(), v)))
    {
        spec_with_keys(&[(key, value)]).map_err(|e| refused(key, value, &e, source))?;
    }
    for point in points {
        let keys: Vec<_> = point.iter().map(|(key, value)| (key.as_str(), value)).collect();
        if spec_with_keys(&keys).is_err() {
            // a key may need other keys of its point: report a key that is wrong by itself first
            let alone = keys.iter().filter_map(|key| Some((*key, spec_with_keys(&[*key]).err()?)));
            let wrong = alone.min_by_key(|(_, e)| e.to_string().starts_with("missing field"));
            if let Some(((key, value), e)) = wrong {
                return Err(refused(key, value, &e, source));
            }
        }
    }
    let count: usize = axes.values().map(Vec::len).product();
    let mut combinations = Vec::with_capacity(points.len() * count);
    for (linked, index) in points.iter().flat_map(|linked| (0..count).map(move |index| (linked, index))) {
        let mut point = base.clone();
        let mut rest = index;
        let mut chosen: Vec<(&str, &Value)> =
            linked.iter().map(|(key, value)| (key.as_str(), value)).collect();
        for (path, values) in axes.iter().rev() {
            chosen.push((path, &values[rest % values.len()]));
            rest /= values.len();
        }
        chosen.iter().for_each(|(key, value)| set(&mut point, key, value));
        let excludes = spec.sweep.exclude.iter().filter_map(|entry| without_axes(entry, &chosen)).collect();
        let spec = serde_json::from_value(point).map_err(|e| source.error("sweep", &e.to_string()))?;
        combinations.push(Combination { spec, excludes });
    }
    Ok(combinations)
}

/// Checks that no key of a point is also an axis, and that all points or none set K, and likewise M.
fn check_points(spec: &SweepSpec, source: &Source) -> Result<(), SpecError> {
    let sweep = &spec.sweep;
    for (key, value) in sweep.points.iter().flatten() {
        let listed = match key.as_str() {
            "panels" => !sweep.panels.is_empty(),
            "sensors" => !sweep.sensors.is_empty(),
            path => sweep.axes.contains_key(path),
        };
        let shown = if key.contains('.') { format!("\"{key}\"") } else { key.clone() };
        let wrong = |remedy| {
            Err(source.error_with(&format!("sweep.points.{shown}"), Some(&value.to_string()), remedy))
        };
        if listed {
            return wrong("is also in a list of [sweep]");
        }
        if !key.contains('.') && value.as_u64().is_none_or(|n| n == 0) {
            return wrong("must be a whole number of at least 1");
        }
    }
    for (key, list) in [("panels", &sweep.panels), ("sensors", &sweep.sensors)] {
        let linked = sweep.points.iter().filter(|point| point.contains_key(key)).count();
        if list.is_empty() && linked < sweep.points.len().max(1) {
            return Err(match linked {
                0 => source.error(&format!("sweep.{key}"), "needs at least one value"),
                _ => source.error("sweep.points", &format!("either all points must set {key}, or none")),
            });
        }
    }
    Ok(())
}

/// Rejects a swept key that is part of another one: the value of one of them would be lost.
fn refuse_overlaps(spec: &SweepSpec, point: &Map<String, Value>, source: &Source) -> Result<(), SpecError> {
    // `sensors` and `panels` are numbers, not the tables of these names
    let keys = || spec.sweep.axes.keys().chain(point.keys()).filter(|key| key.contains('.'));
    for outer in keys() {
        let is_part = |key: &&String| key.strip_prefix(outer).is_some_and(|rest| rest.starts_with('.'));
        if let Some(inner) = keys().find(is_part) {
            let remedy = format!("is part of {outer:?}, which [sweep] sets, too: sweep only one of them");
            return Err(source.error(inner, &remedy));
        }
    }
    Ok(())
}

/// The error for an impossible value of a key; for tables, only serde's message locates it.
fn refused(path: &str, value: &Value, e: &serde_json::Error, source: &Source) -> SpecError {
    let message = match value {
        Value::Object(_) => e.to_string(),
        _ => KnownKeys::of_type::<SweepSpec>().in_words(path, &e.to_string()),
    };
    source.error_with(path, Some(&value.to_string()), &message)
}

/// The entry without its axis keys; `None` if one of them differs from `chosen` or is a key of other points only.
fn without_axes(entry: &Map<String, Value>, chosen: &[(&str, &Value)]) -> Option<Map<String, Value>> {
    let mut rest = entry.clone();
    for (path, value) in chosen {
        if path.contains('.')
            && let Some(wanted) = rest.remove(*path)
            && wanted != **value
            // numbers are equal by value: 1 and 1.0
            && (wanted.as_f64().is_none() || wanted.as_f64() != value.as_f64())
        {
            return None;
        }
    }
    rest.keys().all(|key| !key.contains('.')).then_some(rest)
}

fn check_excludes(spec: &SweepSpec, source: &Source) -> Result<(), SpecError> {
    let mut known = vec!["panels", "sensors", "placement", "seed"];
    known.extend(
        spec.sweep.axes.keys().chain(spec.sweep.points.iter().flat_map(Map::keys)).map(String::as_str),
    );
    let known = numbers::distinct(known);
    for entry in &spec.sweep.exclude {
        if entry.is_empty() {
            return Err(source.error_with("sweep.exclude", Some("{}"), "an empty entry excludes all trials"));
        }
        for (key, value) in entry {
            let wrong =
                |remedy: String| Err(source.error_with("sweep.exclude", Some(&value.to_string()), &remedy));
            if let Value::Object(inner) = value {
                let written = inner.iter().map(|(name, value)| format!("\"{key}.{name}\" = {value}"));
                let written = written.collect::<Vec<_>>().join(", ");
                return wrong(format!("write the path of each key in quotes: {written}"));
            }
            if !known.contains(&key.as_str()) {
                return wrong(match KnownKeys::nearest_of(key, known.iter().copied()) {
                    Some(nearest) => {
                        format!("unknown key {key:?}; the nearest known one here is {nearest:?}")
                    }
                    None => format!("unknown key {key:?}; known keys here: {}", known.join(", ")),
                });
            }
            if !key.contains('.') && value.as_u64().is_none() {
                return wrong(format!("{key:?} must be a whole number of at least 0"));
            }
        }
    }
    Ok(())
}

/// Sets a key, K or M; creates missing tables on its path.
fn set(spec: &mut Value, path: &str, value: &Value) {
    if !path.contains('.') {
        spec["sweep"][path] = Value::Array(vec![value.clone()]);
        return;
    }
    let mut cursor = spec;
    for part in path.split('.') {
        if !cursor.is_object() {
            *cursor = Value::Object(Map::new());
        }
        cursor = cursor.as_object_mut().expect("made one above").entry(part).or_insert(Value::Null);
    }
    *cursor = value.clone();
}
