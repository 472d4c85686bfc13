//! Known keys of a file and their allowed values, from the JSON schema of its type. Error messages use these instead of serde's
//! wording.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde_json::Value;
use strsim::damerau_levenshtein;

use super::TABLES;

/// All keys that a file may have, by path.
#[derive(Debug)]
pub struct KnownKeys {
    /// Allowed values of each key, in words.
    allowed: BTreeMap<String, String>,
    /// Tables of numbers by name, such as `goal.tasks`.
    numbers: Vec<String>,
    schema: Value,
}

impl KnownKeys {
    /// Returns the keys of a type.
    pub fn of_type<T: JsonSchema>() -> Self {
        let schema = schemars::schema_for!(T).to_value();
        let (mut allowed, mut numbers) = (BTreeMap::new(), Vec::new());
        add_keys(&schema, &schema, "", &mut allowed, &mut numbers);
        Self { allowed, numbers, schema }
    }

    pub(super) fn paths(&self) -> impl Iterator<Item = &str> {
        self.allowed.keys().map(String::as_str)
    }

    /// Returns the first key with a list that is too long: TOML's deserializer would ignore the rest.
    pub(super) fn first_overlong_list(&self, value: &Value) -> Option<String> {
        longer(&self.schema, &self.schema, value, "")
    }

    pub(super) fn contains(&self, path: &str) -> bool {
        let entry = path.rsplit_once('.').is_some_and(|(table, _)| self.numbers.iter().any(|t| t == table));
        entry || self.allowed.contains_key(path)
    }

    /// Returns the keys that may be an axis: those of a trial.
    pub(super) fn axes(&self) -> impl Iterator<Item = &str> {
        let of_no_trial = |p: &str| {
            ["sweep.", "run.", "until.", "goal."].iter().chain(&TABLES).any(|table| p.starts_with(table))
        };
        self.paths().filter(move |p| p.contains('.') && !of_no_trial(p) && *p != "sensors.placements")
    }

    /// Whether a key may be an axis.
    pub fn is_axis(&self, path: &str) -> bool {
        self.axes().any(|p| p == path)
    }

    /// Returns the key nearest to `path`, if it is near. A name in another table counts as one letter farther.
    pub fn nearest_of<'a>(path: &str, among: impl Iterator<Item = &'a str>) -> Option<&'a str> {
        let (table, name) = path.rsplit_once('.').unwrap_or(("", path));
        let distances = |candidate: &'a str| {
            let (its_table, its_name) = candidate.rsplit_once('.').unwrap_or(("", candidate));
            let whole = damerau_levenshtein(candidate, path);
            let of_name = damerau_levenshtein(its_name, name) + usize::from(its_table != table);
            (whole.min(of_name), whole, candidate)
        };
        // At most one wrong letter, and one more per four letters.
        let most = 1 + name.chars().count() / 4;
        let near = among.map(distances).filter(|(distance, ..)| *distance <= most);
        near.min().map(|(.., candidate)| candidate)
    }

    /// Returns serde's message about a key; if it concerns the value, `must be` and the allowed values instead.
    pub fn in_words(&self, key: &str, message: &str) -> String {
        const OF_THE_VALUE: [&str; 5] =
            ["invalid type", "invalid value", "invalid length", "data did not match", "unknown variant"];
        match self.allowed.get(key).filter(|_| OF_THE_VALUE.iter().any(|start| message.starts_with(start))) {
            // TOML parses larger integers than serde's types hold.
            Some(_) if message.contains(" as i128") => "is too large".into(),
            Some(allowed) => format!("must be {allowed}"),
            None => message.to_owned(),
        }
    }
}

/// Returns the path of the first list with more entries than its schema allows.
fn longer(schema: &Value, root: &Value, value: &Value, path: &str) -> Option<String> {
    let schema = resolved(schema, root);
    let own = match value {
        Value::Array(entries) => {
            let most = schema["maxItems"].as_u64().unwrap_or(u64::MAX);
            let below = || entries.iter().find_map(|entry| longer(&schema["items"], root, entry, path));
            (entries.len() as u64 > most).then(|| path.to_owned()).or_else(below)
        }
        Value::Object(table) => table.iter().find_map(|(name, inner)| {
            let path = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
            longer(&schema["properties"][name], root, inner, &path)
        }),
        _ => None,
    };
    // only the alternatives that allow such a value
    let kind = if value.is_array() { "array" } else { "object" };
    let fits = |form: &&Value| {
        let kinds = &resolved(form, root)["type"];
        kinds == kind || kinds.as_array().is_some_and(|kinds| kinds.iter().any(|k| k == kind))
    };
    let forms =
        ["anyOf", "oneOf"].into_iter().flat_map(|choice| schema[choice].as_array().into_iter().flatten());
    let found: Option<Vec<String>> = forms.filter(fits).map(|form| longer(form, root, value, path)).collect();
    own.or_else(|| found?.into_iter().next())
}

fn add_keys(
    schema: &Value,
    root: &Value,
    prefix: &str,
    allowed: &mut BTreeMap<String, String>,
    numbers: &mut Vec<String>,
) {
    let schema = resolved(schema, root);
    if schema["additionalProperties"]["type"] == "number" {
        numbers.push(prefix.to_owned());
    }
    for choice in ["anyOf", "allOf"] {
        for part in schema[choice].as_array().into_iter().flatten() {
            add_keys(part, root, prefix, allowed, numbers);
        }
    }
    if let Some(entry) = schema.get("items") {
        add_keys(entry, root, prefix, allowed, numbers);
    }
    for (name, inner) in schema["properties"].as_object().into_iter().flatten() {
        let path = if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") };
        add_keys(inner, root, &path, allowed, numbers);
        allowed.insert(path, either(&values(inner, root)));
    }
}

fn resolved<'a>(schema: &'a Value, root: &'a Value) -> &'a Value {
    let reference = schema["$ref"].as_str().and_then(|r| r.strip_prefix('#'));
    reference.and_then(|path| root.pointer(path)).unwrap_or(schema)
}

fn either(values: &[String]) -> String {
    match values {
        [] => "something else".into(),
        [value] => value.clone(),
        [before @ .., last] => format!("{} or {last}", before.join(", ")),
    }
}

/// Describes each kind of value that a schema allows.
fn values(schema: &Value, root: &Value) -> Vec<String> {
    let schema = resolved(schema, root);
    let parts = |key: &str| schema[key].as_array().into_iter().flatten();
    let choices: Vec<String> =
        parts("anyOf").chain(parts("oneOf")).chain(parts("allOf")).flat_map(|s| values(s, root)).collect();
    if !choices.is_empty() {
        return choices;
    }
    if !schema["const"].is_null() {
        return vec![schema["const"].to_string()];
    }
    let names: Vec<String> = parts("enum").filter(|v| !v.is_null()).map(Value::to_string).collect();
    if !names.is_empty() {
        return names;
    }
    let types: Vec<&str> = match &schema["type"] {
        Value::Array(types) => types.iter().filter_map(Value::as_str).collect(),
        one => one.as_str().into_iter().collect(),
    };
    types.into_iter().filter_map(|kind| value(kind, schema, root)).collect()
}

/// Describes a value of a JSON type.
fn value(kind: &str, schema: &Value, root: &Value) -> Option<String> {
    let text = match kind {
        "integer" => match (schema["minimum"].as_f64(), schema["maximum"].as_f64()) {
            (Some(least), Some(most)) => format!("a whole number from {least} to {most}"),
            (Some(least), None) => format!("a whole number of at least {least}"),
            _ => "a whole number".into(),
        },
        "number" => "a number".into(),
        "string" => "a string in quotes".into(),
        "boolean" => "true or false".into(),
        "array" => {
            let count = schema["minItems"].as_u64().filter(|n| schema["maxItems"].as_u64() == Some(*n));
            let count = count.map_or(String::new(), |n| format!("{n} "));
            let items = values(&schema["items"], root);
            // "a whole number from 0 up" → "whole numbers from 0 up"; quoted words stay
            let pluralise = |one: &String| {
                if one.starts_with('"') {
                    return Some(one.clone());
                }
                let one = one.strip_prefix("a ")?;
                // the first noun: "list" in "a list of numbers"
                let found = ["number", "string", "list", "table"].map(|noun| Some((one.find(noun)?, noun)));
                let (_, noun) = found.into_iter().flatten().min()?;
                Some(one.replacen(noun, &format!("{noun}s"), 1))
            };
            match items.iter().map(pluralise).collect::<Option<Vec<_>>>() {
                Some(items) if !items.is_empty() => format!("a list of {count}{}", either(&items)),
                _ => "a list".into(),
            }
        }
        "object" => {
            let keys: Vec<&str> = schema["properties"]
                .as_object()
                .into_iter()
                .flat_map(|all| all.keys())
                .map(String::as_str)
                .collect();
            match keys.len() {
                1..=6 => format!("a table {{ {} }}", keys.join(", ")),
                _ => "a table".into(),
            }
        }
        _ => return None,
    };
    Some(text)
}
