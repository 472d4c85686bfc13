//! A spec file as text: reading it into a `SweepSpec`, and saying where in it something is wrong.
//!
//! Every error names file, line, key and value. Known keys come from the JSON schema of the types themselves.

use std::ops::Range;
use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use serde_json::Value;
use toml::de::{DeTable, DeValue};

use crate::spec::{Measured, SweepSpec, gone_key};

mod keys;

pub use keys::KnownKeys;

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
    /// A number in it that is none: NaN, or too large.
    not_finite: Option<String>,
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
        toml::from_str(&self.text).map_err(|e| self.type_error(&e, &known))
    }

    fn check_key(&self, place: &Place, known: &KnownKeys) -> Result<(), SpecError> {
        let key = place.key.as_str();
        if let Some(remedy) = gone_key(key.strip_prefix("sweep.").map_or(key, |axis| axis.trim_matches('"')))
        {
            return Err(self.wrong(place, remedy));
        }
        if let Some(linked) = key.strip_prefix(POINTS) {
            let linked = linked.trim_matches('"');
            if !known.is_axis(linked) && !COUNTS.contains(&linked) {
                return Err(
                    self.at(place, format!("{key} = {}: {}", self.value(place), no_axis(linked, known)))
                );
            }
        } else if let Some(axis) = key.strip_prefix("sweep.").filter(|_| !known.contains(key)) {
            let axis = axis.trim_matches('"');
            if place.is_table && known.contains(axis) {
                let what = format!(
                    "{key}: no table here; an axis is written in quotes, for instance \"{axis}.…\" = [ … ]"
                );
                return Err(self.at(place, what));
            }
            if !known.is_axis(axis) {
                return Err(
                    self.at(place, format!("{key} = {}: {}", self.value(place), no_axis(axis, known)))
                );
            }
            if !place.is_list {
                return Err(self.error(key, "an axis is a list of values"));
            }
        } else if !known.contains(key) {
            return Err(self.error(key, &unknown(KnownKeys::nearest_of(key, known.paths()))));
        }
        match &place.not_finite {
            Some(number) => Err(self.wrong(place, &format!("{number} is no finite number"))),
            None => Ok(()),
        }
    }

    /// An error at just this place, with its value.
    fn wrong(&self, place: &Place, remedy: &str) -> SpecError {
        match place.is_table {
            true => self.at(place, format!("{}: {remedy}", place.key)),
            false => self.at(place, format!("{} = {}: {remedy}", place.key, self.value(place))),
        }
    }

    fn type_error(&self, e: &toml::de::Error, known: &KnownKeys) -> SpecError {
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
            (None, Some(place)) => self.wrong(place, &known.in_words(&place.key, &message)),
            (None, None) => self.error("", &message),
        }
    }

    /// An error at a key: at the axis or the point that sets it where there is one, else at the key, else at the table that
    /// would hold it.
    #[must_use]
    pub fn error(&self, key: &str, remedy: &str) -> SpecError {
        self.error_with(key, None, remedy)
    }

    /// Like `error`, with the value at fault where it is not what the file says, for instance one of a list; an empty one
    /// is none.
    #[must_use]
    pub fn error_with(&self, key: &str, value: Option<&str>, remedy: &str) -> SpecError {
        let axis = format!("sweep.\"{key}\"");
        let exact = |wanted: &str| self.places.iter().find(|p| p.key == wanted);
        let stated = exact(&axis).or_else(|| self.linked(key, value)).or_else(|| exact(key));
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
            (key, Some(value)) if !value.is_empty() => format!("{key} = {value}: {remedy}"),
            (key, _) => format!("{key}: {remedy}"),
        };
        let line = place.map_or(1, |p| self.line(p.at));
        SpecError { file: self.file.clone(), line, key: key.to_owned(), what }
    }

    /// The entry of `sweep.points` that gives a key this value, else the first that gives it one.
    fn linked(&self, key: &str, value: Option<&str>) -> Option<&Place> {
        let key = key.strip_prefix("sweep.").filter(|key| COUNTS.contains(key)).unwrap_or(key);
        let named = |p: &&Place| p.key.strip_prefix(POINTS).is_some_and(|k| k.trim_matches('"') == key);
        let bare = |text: &str| text.split_whitespace().collect::<String>();
        let same = |p: &&Place| value.is_some_and(|v| bare(&self.text[p.value.clone()]) == bare(v));
        let places = || self.places.iter().filter(named);
        places().find(same).or_else(|| places().next())
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

/// Before the keys of an entry of `sweep.points`, and those of them that are no paths.
const POINTS: &str = "sweep.points.";
const COUNTS: [&str; 2] = ["panels", "sensors"];

/// Keys with their paths; one that holds a dot keeps its quotes. Of lists those of `sweep.points` alone.
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
        if let DeValue::Array(entries) = value.get_ref()
            && key == POINTS.trim_end_matches('.')
        {
            let tables = entries.iter().filter_map(|entry| entry.get_ref().as_table());
            tables.for_each(|table| find_places(table, &key, places));
        }
        let not_finite = if is_table { None } else { not_finite(value.get_ref()) };
        places.push(Place { key, at: name.span().start, value: value.span(), is_table, is_list, not_finite });
    }
}

/// The first number of a value, or of a list in it, that is none.
fn not_finite(value: &DeValue<'_>) -> Option<String> {
    match value {
        DeValue::Float(x) if !x.as_str().parse().is_ok_and(f64::is_finite) => Some(x.as_str().to_owned()),
        DeValue::Array(values) => values.iter().find_map(|v| not_finite(v.get_ref())),
        DeValue::Table(table) => table.values().find_map(|v| not_finite(v.get_ref())),
        _ => None,
    }
}

/// What to say of a key that nothing knows.
fn unknown(nearest: Option<&str>) -> String {
    match nearest {
        Some(nearest) => format!("unknown key; the nearest known one is {nearest:?}"),
        None => "unknown key; `metasense schema` lists those there are".into(),
    }
}

/// Why something in `[sweep]` is no axis.
fn no_axis(name: &str, known: &KnownKeys) -> String {
    match name.strip_prefix("sweep.").filter(|_| known.contains(name)) {
        Some(own) => format!("a key of [sweep] itself, written without quotes and table: {own} = …"),
        None if name.contains('.') && known.contains(name) => {
            "no part of a trial, and cannot be swept".into()
        }
        None if name.contains('.') => unknown(KnownKeys::nearest_of(name, known.axes())),
        None => match KnownKeys::nearest_of(&format!("sweep.{name}"), known.paths()) {
            Some(nearest) => unknown(Some(nearest)),
            None => {
                "unknown key; an axis is a key by its path in quotes, for instance \"body.columns\" = [5, 6]"
                    .into()
            }
        },
    }
}

/// The JSON schema of a spec.
#[must_use]
pub fn spec_schema() -> Value {
    schemars::schema_for!(SweepSpec).to_value()
}

/// The JSON schema of a file of measured records.
#[must_use]
pub fn measured_schema() -> Value {
    schemars::schema_for!(Measured).to_value()
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
        assert_eq!(
            (spec.brain.iterations, spec.optimise.steps(), spec.evaluation.networks()),
            (1000, 350, 3)
        );
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
            ("rows = 6", "rows = \"six\"", "a.toml:4: body.rows = \"six\": must be a whole number from 0 up"),
            ("rows = 6", "rows = -6", "a.toml:4: body.rows = -6: must be a whole number from 0 up"),
            ("columns = 6\n", "", "a.toml:2: body.columns: must be given, it has no default"),
            (", bend = 1.0", "", "a.toml:8: body.stiffness.bend: must be given, it has no default"),
            ("[stimuli]\nkind = \"bell\"\n", "", "a.toml:1: stimuli: must be given, it has no default"),
            (
                "\"bell\"",
                "\"ball\"",
                "a.toml:10: stimuli.kind = \"ball\": must be \"bell\", \"irregular\" or \"recorded\"",
            ),
            (
                "columns = 6",
                "columns = \"six\"",
                "a.toml:3: body.columns = \"six\": must be a whole number from 0 up",
            ),
            ("spacing = 15.0", "spacing = -inf", "a.toml:5: body.spacing = -inf: -inf is no finite number"),
            (
                "\"body.columns\" = [5, 6]",
                "\"body.spacing\" = [15.0, nan]",
                "a.toml:14: sweep.\"body.spacing\" = [15.0, nan]: nan is no finite number",
            ),
            (
                "rows = 6",
                "clamp = \"top\"",
                "a.toml:4: body.clamp = \"top\": must be \"bottom\", \"hub\" or a list of whole numbers from 0 up",
            ),
            (
                "{ stretch = 3.0, shear = 0.5, bend = 1.0 }",
                "3.0",
                "a.toml:8: body.stiffness = 3.0: must be a table { bend, shear, stretch }",
            ),
            (
                "[stimuli]",
                "[sensors]\nnoise = [1.0]\n[stimuli]",
                "a.toml:10: sensors.noise = [1.0]: must be a number or a list of 2 numbers",
            ),
            (
                "[stimuli]",
                "[run]\nniceness = 300\n[stimuli]",
                "a.toml:10: run.niceness = 300: must be a whole number from 0 to 255",
            ),
            (
                "sensors = [1, 2]",
                "sensors = [1.5]",
                "a.toml:13: sweep.sensors = [1.5]: must be a list of whole numbers from 0 up",
            ),
            (
                "rows = 6",
                "design = 7",
                "a.toml:4: body.design = 7: must be a text in quotes, a table { random } or a table { shifts }",
            ),
            (
                "\"body.columns\" = [5, 6]",
                "\"foo\" = [5, 6]",
                "a.toml:14: sweep.foo = [5, 6]: unknown key; an axis is a key by its path in quotes, for instance",
            ),
            (
                "panels = [2]",
                "\"sweep.panels\" = [2]",
                "a.toml:12: sweep.\"sweep.panels\" = [2]: a key of [sweep] itself, written without quotes and table: panels = …",
            ),
            (
                "\"body.columns\" = [5, 6]",
                "\"run.workers\" = [5, 6]",
                "a.toml:14: sweep.\"run.workers\" = [5, 6]: no part of a trial, and cannot be swept",
            ),
            (
                "rows = 6",
                "colour = \"red\"",
                "a.toml:4: body.colour = \"red\": unknown key; `metasense schema` lists",
            ),
            (
                "rows = 6",
                "rows = 99999999999999999999",
                "a.toml:4: body.rows = 99999999999999999999: is too large a",
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
