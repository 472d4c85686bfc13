//! A spec file as text: reading it into a `SweepSpec`, and saying where in it something is wrong.
//!
//! Every error names file, line, key and value. Known keys come from the JSON schema of the types themselves.

use std::ops::Range;
use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use serde_json::Value;
use toml::de::{DeTable, DeValue};

use crate::spec::SweepSpec;

/// Something wrong in a spec file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}:{line}: {what}", file.display())]
pub struct SpecError {
    /// The file.
    pub file: PathBuf,
    /// The line of the key, or of the table that lacks it; from 1.
    pub line: usize,
    /// The key by its path, for instance `body.stiffness.bend`; empty where the file is no TOML.
    pub key: String,
    /// Key, value, and what is wrong.
    pub what: String,
}

/// A spec file's text and where its keys stand in it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    /// The file.
    pub file: PathBuf,
    /// What it holds.
    pub text: String,
    places: Vec<Place>,
}

/// A key of the file.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Place {
    key: String,
    at: usize,
    value: Range<usize>,
    is_table: bool,
    is_list: bool,
}

impl Source {
    /// Finds the keys of a text.
    ///
    /// # Errors
    /// Where it is no TOML.
    pub fn new(file: impl AsRef<Path>, text: String) -> Result<Self, SpecError> {
        let mut source = Self { file: file.as_ref().to_owned(), text, places: Vec::new() };
        let mut places = Vec::new();
        match DeTable::parse(&source.text) {
            Ok(table) => find_places(table.get_ref(), "", &mut places),
            Err(e) => {
                let line = source.line(e.span().map_or(0, |span| span.start));
                let what = format!("not valid TOML: {}", e.message().trim());
                return Err(SpecError { file: source.file, line, key: String::new(), what });
            }
        }
        places.sort_by_key(|place| place.at);
        source.places = places;
        Ok(source)
    }

    /// Reads the spec. Types and names are right afterwards; whether the values make sense is the plan's to say.
    ///
    /// # Errors
    /// The first unknown key, missing key, or value of a wrong type.
    pub fn parse(&self) -> Result<SweepSpec, SpecError> {
        self.parse_as()
    }

    /// Reads another kind of file in the same way.
    ///
    /// # Errors
    /// As [`Source::parse`].
    pub fn parse_as<T: DeserializeOwned + JsonSchema>(&self) -> Result<T, SpecError> {
        let known = KnownKeys::of::<T>();
        for place in &self.places {
            self.check_key(place, &known)?;
        }
        toml::from_str(&self.text).map_err(|e| self.type_error(&e))
    }

    fn check_key(&self, place: &Place, known: &KnownKeys) -> Result<(), SpecError> {
        let key = place.key.as_str();
        if let Some(axis) = key.strip_prefix("sweep.").filter(|_| !known.contains(key)) {
            let axis = axis.trim_matches('"');
            if place.is_table && known.contains(axis) {
                let what = format!(
                    "{key}: no table here; an axis is written in quotes, for instance \"{axis}.…\" = [ … ]"
                );
                return Err(self.at(place, what));
            }
            if !known.is_axis(axis) {
                let nearest = match axis.contains('.') {
                    true => KnownKeys::nearest_of(axis, known.axes()),
                    false => KnownKeys::nearest_of(key, known.paths.iter().map(String::as_str)),
                };
                return Err(self.error(key, &format!("unknown key; the nearest known one is {nearest:?}")));
            }
            if !place.is_list {
                return Err(self.error(key, "an axis is a list of values"));
            }
        } else if !known.contains(key) {
            let nearest = KnownKeys::nearest_of(key, known.paths.iter().map(String::as_str));
            return Err(self.error(key, &format!("unknown key; the nearest known one is {nearest:?}")));
        }
        Ok(())
    }

    fn type_error(&self, e: &toml::de::Error) -> SpecError {
        let span = e.span().unwrap_or(0..0);
        // The innermost key around the value that serde refused.
        let place = self.places.iter().rfind(|p| p.value.start <= span.start && span.end <= p.value.end);
        let message = e.message().trim().replace('\n', " ");
        let missing = message.strip_prefix("missing field `").and_then(|m| m.strip_suffix('`'));
        match (missing, place) {
            (Some(field), place) => {
                let table = place.map_or(String::new(), |p| format!("{}.", p.key));
                let line = place.map_or(1, |p| self.line(p.at));
                let what = format!("{table}{field}: must be given, it has no default");
                SpecError { file: self.file.clone(), line, key: format!("{table}{field}"), what }
            }
            (None, Some(place)) => self.error(&place.key.clone(), &message),
            (None, None) => self.error("", &message),
        }
    }

    /// An error at a key: at the axis that sets it where there is one, else at the key, else at the table that would
    /// hold it.
    #[must_use]
    pub fn error(&self, key: &str, remedy: &str) -> SpecError {
        self.error_with(key, None, remedy)
    }

    /// Like `error`, with the value at fault where it is not what the file says, for instance one of a list.
    #[must_use]
    pub fn error_with(&self, key: &str, value: Option<&str>, remedy: &str) -> SpecError {
        let axis = format!("sweep.\"{key}\"");
        let exact = |wanted: &str| self.places.iter().find(|p| p.key == wanted);
        let stated = exact(&axis).or_else(|| exact(key));
        let mut holder = key;
        let place = stated.or_else(|| {
            while let Some((table, _)) = holder.rsplit_once('.') {
                holder = table;
                if let Some(place) = exact(holder) {
                    return Some(place);
                }
            }
            None
        });
        let value =
            value.map(str::to_owned).or_else(|| stated.filter(|p| !p.is_table).map(|p| self.value(p)));
        let what = match (key, value) {
            ("", _) => remedy.to_owned(),
            (key, Some(value)) => format!("{key} = {value}: {remedy}"),
            (key, None) => format!("{key}: {remedy}"),
        };
        let line = place.map_or(1, |p| self.line(p.at));
        SpecError { file: self.file.clone(), line, key: key.to_owned(), what }
    }

    fn at(&self, place: &Place, what: String) -> SpecError {
        SpecError { file: self.file.clone(), line: self.line(place.at), key: place.key.clone(), what }
    }

    /// A value as it is written, cut where it is long.
    fn value(&self, place: &Place) -> String {
        const LONGEST: usize = 60;
        let text = self.text[place.value.clone()].split_whitespace().collect::<Vec<_>>().join(" ");
        match text.char_indices().nth(LONGEST) {
            Some((end, _)) => format!("{}…", &text[..end]),
            None => text,
        }
    }

    fn line(&self, at: usize) -> usize {
        1 + self.text.as_bytes()[..at.min(self.text.len())].iter().filter(|&&b| b == b'\n').count()
    }
}

/// Keys with their paths; one that holds a dot keeps its quotes.
fn find_places(table: &DeTable<'_>, prefix: &str, places: &mut Vec<Place>) {
    for (name, value) in table {
        let name_text = name.get_ref();
        let shown = if name_text.contains('.') { format!("\"{name_text}\"") } else { name_text.to_string() };
        let key = if prefix.is_empty() { shown } else { format!("{prefix}.{shown}") };
        let is_table = matches!(value.get_ref(), DeValue::Table(_));
        if let DeValue::Table(inner) = value.get_ref() {
            find_places(inner, &key, places);
        }
        let is_list = matches!(value.get_ref(), DeValue::Array(_));
        places.push(Place { key, at: name.span().start, value: value.span(), is_table, is_list });
    }
}

/// All keys that a file may have, by path.
#[derive(Debug)]
pub struct KnownKeys {
    paths: Vec<String>,
}

impl KnownKeys {
    /// Those of `SweepSpec`.
    #[must_use]
    pub fn of_spec() -> Self {
        Self::of::<SweepSpec>()
    }

    fn of<T: JsonSchema>() -> Self {
        let schema = schemars::schema_for!(T).to_value();
        let mut paths = Vec::new();
        add_paths(&schema, &schema, "", &mut paths);
        Self { paths }
    }

    fn contains(&self, path: &str) -> bool {
        self.paths.iter().any(|p| p == path)
    }

    /// Keys that may be an axis: all that a trial is made of.
    fn axes(&self) -> impl Iterator<Item = &str> {
        self.paths.iter().map(String::as_str).filter(|p| {
            p.contains('.')
                && !p.starts_with("sweep.")
                && !p.starts_with("run.")
                && *p != "sensors.placements"
        })
    }

    /// Whether a key may be an axis.
    #[must_use]
    pub fn is_axis(&self, path: &str) -> bool {
        self.axes().any(|p| p == path)
    }

    /// The known key most like `path`: one of the same table unless another table has a closer one.
    #[must_use]
    pub fn nearest_of<'a>(path: &str, among: impl Iterator<Item = &'a str>) -> &'a str {
        let split = |p: &'a str| p.rsplit_once('.').unwrap_or(("", p));
        let (table, name) = path.rsplit_once('.').unwrap_or(("", path));
        let distance = |candidate: &'a str| {
            let (its_table, its_name) = split(candidate);
            let whole = strsim::damerau_levenshtein(candidate, path);
            let elsewhere = if its_table == table { 0 } else { 1 };
            whole.min(strsim::damerau_levenshtein(its_name, name) + elsewhere)
        };
        among
            .min_by_key(|candidate| (distance(candidate), strsim::damerau_levenshtein(candidate, path)))
            .unwrap_or("")
    }
}

/// The JSON schema of a spec.
#[must_use]
pub fn spec_schema() -> Value {
    schemars::schema_for!(SweepSpec).to_value()
}

fn add_paths(schema: &Value, root: &Value, prefix: &str, paths: &mut Vec<String>) {
    if let Some(reference) = schema["$ref"].as_str().and_then(|r| r.strip_prefix('#')) {
        return add_paths(root.pointer(reference).unwrap_or(&Value::Null), root, prefix, paths);
    }
    for choice in ["anyOf", "allOf"] {
        for part in schema[choice].as_array().into_iter().flatten() {
            add_paths(part, root, prefix, paths);
        }
    }
    for (name, inner) in schema["properties"].as_object().into_iter().flatten() {
        let path = if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") };
        add_paths(inner, root, &path, paths);
        paths.push(path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = r#"name = "example"
[body]
columns = 6
rows = 6
spacing = 15.0
ligament_length = 2.25
density = 1e-8
stiffness = { stretch = 3.0, shear = 0.5, bend = 1.0 }
[stimuli]
kind = "bell"
[sweep]
panels = [2]
sensors = [1, 2]
"body.columns" = [5, 6]
exclude = [{ sensors = 2, "body.columns" = 5 }]
"#;

    fn parse(text: &str) -> Result<SweepSpec, SpecError> {
        Source::new("a.toml", text.to_owned())?.parse()
    }

    fn complaint(from: &str, to: &str) -> String {
        assert!(GOOD.contains(from), "{from}");
        parse(&GOOD.replacen(from, to, 1)).unwrap_err().to_string()
    }

    #[test]
    fn keys_left_out_have_the_defaults_of_the_documentation() {
        let spec = parse(GOOD).unwrap();
        assert_eq!((spec.time.duration, spec.time.samples), (1.0, 200));
        assert_eq!((spec.stimuli.samples, spec.stimuli.test, spec.stimuli.holdout), (300, 30, 60));
        assert_eq!((spec.brain.iterations, spec.optimise.steps(), spec.evaluation.seeds), (1000, 350, 1));
        assert_eq!((spec.sweep.placements, &spec.sweep.seeds[..]), (1, &[1][..]));
        assert_eq!(spec.sweep.axes["body.columns"], [5, 6]);
    }

    #[test]
    fn errors_name_file_line_key_value_and_the_nearest_key() {
        for (from, to, expected) in [
            (
                "columns = 6",
                "colums = 6",
                "a.toml:3: body.colums = 6: unknown key; the nearest known one is \"body.columns\"",
            ),
            (
                "[stimuli]",
                "[stimulus]",
                "a.toml:9: stimulus: unknown key; the nearest known one is \"stimuli\"",
            ),
            (
                "name = \"example\"",
                "name = \"e\"\nspacing = 3.0",
                "a.toml:2: spacing = 3.0: unknown key; the nearest known one is \"body.spacing\"",
            ),
            (
                "bend = 1.0",
                "bent = 1.0",
                "a.toml:8: body.stiffness.bent = 1.0: unknown key; the nearest known one is \"body.stiffness.bend\"",
            ),
            (
                "\"body.columns\" = [5, 6]",
                "\"body.column\" = [5, 6]",
                "a.toml:14: sweep.\"body.column\" = [5, 6]: unknown key; the nearest known one is \"body.columns\"",
            ),
            (
                "\"body.columns\" = [5, 6]",
                "body.columns = [5, 6]",
                "a.toml:14: sweep.body: no table here; an axis is written in quotes, for instance \"body.…\" = [ … ]",
            ),
            (
                "panels = [2]",
                "panel = [2]",
                "a.toml:12: sweep.panel = [2]: unknown key; the nearest known one is \"sweep.panels\"",
            ),
            (
                "rows = 6",
                "rows = \"six\"",
                "a.toml:4: body.rows = \"six\": invalid type: string \"six\", expected usize",
            ),
            (
                "rows = 6",
                "rows = -6",
                "a.toml:4: body.rows = -6: invalid value: integer `-6`, expected usize",
            ),
            ("columns = 6\n", "", "a.toml:2: body.columns: must be given, it has no default"),
            (", bend = 1.0", "", "a.toml:8: body.stiffness.bend: must be given, it has no default"),
            ("[stimuli]\nkind = \"bell\"\n", "", "a.toml:1: stimuli: must be given, it has no default"),
            (
                "\"bell\"",
                "\"ball\"",
                "a.toml:10: stimuli.kind = \"ball\": unknown variant `ball`, expected one of `bell`, `irregular`, `recorded`",
            ),
            ("rows = 6", "rows = ", "a.toml:4: not valid TOML: "),
            (
                "\"body.columns\" = [5, 6]",
                "\"body.columns\" = 5",
                "a.toml:14: sweep.\"body.columns\" = 5: an axis is a list of values",
            ),
        ] {
            let complaint = complaint(from, to);
            assert!(complaint.starts_with(expected), "{to}:\n{complaint}\n{expected}");
        }
    }
}
