//! Keys of specs and of files of records, from the JSON schema of their types; and the specs in the repository.
//!
//! A key's doc comment is its description. If the schema has no default, the last line may be `Unit: …. Default: ….`.

use std::collections::BTreeMap;

use metasense::analysis::goal::{BEGIN, LEAST_RESULTS, WORTH, WORTH_LAST};
use metasense::rounds::space::RUNGS;
use metasense_lab::measured::measured_schema;
use metasense_source::spec_schema;
use serde_json::Value;

use super::table;

pub fn keys() -> String {
    tables(&spec_schema())
}

pub fn records() -> String {
    let mut schema = measured_schema();
    // The forces have the keys of `stimuli.recorded`.
    schema["properties"].as_object_mut().unwrap().remove("recorded");
    tables(&schema)
}

/// Constants of a search for a design.
pub fn search_limits() -> String {
    let percent = |part: f64| format!("{:.0} %", 100.0 * part);
    let rows = [
        ("settings that are started before the first prediction, with one candidate each", BEGIN.to_string()),
        (
            "fractions of the outer steps after which a candidate may pause, each rounded to the next evaluation of the test set",
            RUNGS.map(|part| format!("1/{:.0}", 1.0 / part)).join(", "),
        ),
        (
            "smallest probability of confirmation (`meets`) with which a candidate is trained or screened",
            percent(WORTH),
        ),
        (
            "the same, while no design is confirmed and no candidate reaches the limit above",
            percent(WORTH_LAST),
        ),
        (
            "final errors that must be known before this second limit rejects a candidate without screening",
            format!(
                "{LEAST_RESULTS} + coordinates of the settings (1 per axis of numbers, else 1 per value)"
            ),
        ),
    ];
    table(&["limit", "value"], rows.map(|(what, value)| vec![what.to_owned(), value]))
}

/// One Markdown table per table of the file; keys of the file itself come first.
fn tables(schema: &Value) -> String {
    let mut own = Vec::new();
    let mut text = String::new();
    for (name, inner) in properties(schema) {
        let body = choice(inner, schema);
        if body["properties"].is_null() {
            own.push((name.as_str(), inner, required(schema, name)));
            continue;
        }
        let mut rows = Vec::new();
        add_rows(body, schema, "", &mut rows);
        text += &format!("### [{name}]\n\n{}\n\n", first_of(&doc(inner), &doc(body)));
        text += &table(&["key", "default", "unit", "meaning"], rows);
        text += "\n";
    }
    let rows: Vec<_> = own.into_iter().map(|(name, key, must)| row(name, key, schema, must)).collect();
    if rows.is_empty() { text } else { table(&["key", "default", "unit", "meaning"], rows) + "\n" + &text }
}

fn first_of(a: &str, b: &str) -> String {
    if a.is_empty() { b.to_owned() } else { a.to_owned() }
}

/// Required keys first, then by name; the keys of a table after the table.
fn add_rows(body: &Value, root: &Value, prefix: &str, rows: &mut Vec<Vec<String>>) {
    let mut keys: Vec<_> = properties(body).collect();
    keys.sort_by_key(|(name, _)| !required(body, name));
    for (name, key) in keys {
        let path = format!("{prefix}{name}");
        rows.push(row(&path, key, root, required(body, name)));
        let inner = choice(key, root);
        if !inner["properties"].is_null() {
            add_rows(inner, root, &format!("{path}."), rows);
        }
    }
}

fn row(path: &str, key: &Value, root: &Value, must: bool) -> Vec<String> {
    let text = doc(key);
    let (text, said) = cut(&text, "Default: ");
    let (meaning, unit) = cut(&text, "Unit: ");
    let default = match (&key["default"], said) {
        (_, _) if must => "must be given".to_owned(),
        (_, Some(said)) => said,
        (Value::Null, None) => panic!("{path}: its doc comment says no `Default: …`"),
        (given, None) => toml_value(given),
    };
    let default = if is_value(&default) { format!("`{default}`") } else { default };
    let unit = unit.unwrap_or_default();
    let number = key["format"] == "double" || key["items"]["format"] == "double";
    assert!(!number || !unit.is_empty(), "{path}: its doc comment says no `Unit: …`");
    let unit = if unit == "1" { String::new() } else { unit };
    vec![format!("`{path}`"), default, unit, format!("{meaning}{}", choices(key, root))]
}

/// Whether a default is a value or a key, not words.
fn is_value(default: &str) -> bool {
    let value =
        default.starts_with(['"', '[', '{', '-']) || default.starts_with(|c: char| c.is_ascii_digit());
    let key = default.contains('.') || default.contains('_');
    let word = matches!(default, "true" | "false");
    (value && toml::from_str::<toml::Table>(&format!("key = {default}")).is_ok())
        || (key && !default.contains([' ', '`']))
        || word
}

/// Splits `label … .` from the end of a text.
fn cut(text: &str, label: &str) -> (String, Option<String>) {
    match text.split_once(label) {
        Some((before, after)) => {
            (before.trim().to_owned(), Some(after.trim().trim_end_matches('.').to_owned()))
        }
        None => (text.to_owned(), None),
    }
}

/// Values of an enumeration with their meanings.
fn choices(key: &Value, root: &Value) -> String {
    let inner = choice(key, root);
    let each = |key: &str| inner[key].as_array().into_iter().flatten();
    let named = each("oneOf").filter_map(|c| Some((c["const"].as_str()?, doc(c))));
    let named: Vec<String> =
        named.map(|(name, doc)| format!("`\"{name}\"`: {}", doc.trim_end_matches('.'))).collect();
    let kinds: Vec<String> = each("anyOf").map(|c| doc(c).trim_end_matches('.').to_owned()).collect();
    match (named.is_empty(), kinds.iter().all(String::is_empty)) {
        (false, _) => format!(" {}.", named.join("; ")),
        (true, false) => format!(" Either {}.", kinds.join("; or ")),
        (true, true) => String::new(),
    }
}

/// Schema of a key without `null`.
fn choice<'a>(key: &'a Value, root: &'a Value) -> &'a Value {
    let some = key["anyOf"].as_array().and_then(|parts| match &parts[..] {
        [some, null] if null["type"] == "null" => Some(some),
        _ => None,
    });
    resolved(some.unwrap_or(key), root)
}

fn resolved<'a>(schema: &'a Value, root: &'a Value) -> &'a Value {
    let reference = schema["$ref"].as_str().and_then(|r| r.strip_prefix('#'));
    reference.and_then(|path| root.pointer(path)).unwrap_or(schema)
}

fn properties(schema: &Value) -> impl Iterator<Item = (&String, &Value)> {
    schema["properties"].as_object().into_iter().flatten()
}

fn required(schema: &Value, name: &str) -> bool {
    schema["required"].as_array().is_some_and(|names| names.iter().any(|n| n == name))
}

/// A doc comment on one line.
fn doc(schema: &Value) -> String {
    schema["description"].as_str().unwrap_or_default().split_whitespace().collect::<Vec<_>>().join(" ")
}

/// A default in TOML syntax.
fn toml_value(value: &Value) -> String {
    match value {
        Value::Object(table) if table.is_empty() => "none".into(),
        Value::Object(table) => {
            let entries: Vec<String> =
                table.iter().map(|(key, value)| format!("{key} = {}", toml_value(value))).collect();
            format!("{{ {} }}", entries.join(", "))
        }
        Value::Array(values) => {
            format!("[{}]", values.iter().map(toml_value).collect::<Vec<_>>().join(", "))
        }
        Value::Number(x) if x.as_f64().is_some_and(|x| x != 0.0 && x.abs() < 1e-2) => {
            format!("{:e}", x.as_f64().unwrap())
        }
        other => other.to_string(),
    }
}

/// Specs of a folder with the first paragraph of their first comment.
pub fn files() -> String {
    let mut rows = BTreeMap::new();
    for folder in ["sweeps", "claims"] {
        for entry in std::fs::read_dir(super::root().join("schemas").join(folder)).unwrap() {
            let file = entry.unwrap().file_name().into_string().unwrap();
            let Some(name) = file.strip_suffix(".toml") else { continue };
            let text = super::read(&format!("schemas/{folder}/{file}"));
            let head = text.lines().map_while(|line| line.strip_prefix('#')).map(str::trim);
            let head = head.take_while(|line| !line.is_empty());
            let head = head.collect::<Vec<_>>().join(" ");
            rows.insert(
                (folder != "sweeps", name.to_owned()),
                vec![format!("[`{folder}/{name}`](../../schemas/{folder}/{file})"), head],
            );
        }
    }
    table(&["spec", "what it shows"], rows.into_values())
}
