//! Parses the text of a spec into a `SweepSpec`, and locates errors in it.
//!
//! A spec may have a `base`, and overrides on the command line. These layers are merged into one text. Every error states file,
//! line, key and value of the layer that contains the key. The JSON schema of the types gives the known keys.

use std::iter::successors;
use std::ops::Range;
use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use serde_json::Value;

use metasense_schemas::spec::SweepSpec;

mod keys;
mod layers;
mod removed;

pub use keys::KnownKeys;
pub use layers::each_file;
use layers::{Layer, comments, folder, merged, remove};
use removed::removed;

/// An error in a spec file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}{}: {what}", file.display(), if *line > 0 { format!(":{line}") } else { String::new() })]
pub struct SpecError {
    /// The file, or `command line`.
    pub file: PathBuf,
    /// Line of the key, or of the table that lacks it, from 1; 0 on the command line.
    pub line: usize,
    /// Path of the key, for instance `body.stiffness.bend`; empty if the file is not valid TOML.
    pub key: String,
    /// The message: key, value and what is wrong.
    pub what: String,
}

/// The text of a spec and the positions of its keys.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    /// The file.
    pub file: PathBuf,
    /// Contents of the file, or all layers merged.
    pub text: String,
    /// Overrides, the file and its bases, in order of precedence.
    layers: Vec<Layer>,
    /// Keys that are not overridden, and tables, layer by layer.
    places: Vec<Place>,
    /// Keys of `text`; empty if there is one layer.
    flat: Vec<Place>,
}

/// A key of a layer.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Place {
    key: String,
    layer: usize,
    at: usize,
    value: Range<usize>,
    is_table: bool,
    is_list: bool,
    /// The message if a number in the value cannot be stored.
    no_number: Option<String>,
}

impl Source {
    /// Finds the keys of a text in TOML.
    pub fn new(file: impl AsRef<Path>, text: String) -> Result<Self, SpecError> {
        let file = file.as_ref().to_owned();
        let layer = Layer { file: file.clone(), text: text.clone(), removes: None };
        let places = layer.places(0)?;
        Ok(Self { file, text, layers: vec![layer], places, flat: Vec::new() })
    }

    /// Finds the keys of a spec's text, of its bases, and of overrides, each `KEY=VALUE`, or `KEY=` to remove a key.
    /// Fails if a layer is not valid TOML or cannot be read, bases form a cycle, or an override has no effect or is set twice.
    pub fn spec(file: impl AsRef<Path>, text: String, changes: &[String]) -> Result<Self, SpecError> {
        let own = Self::new(&file, text)?;
        let layers = Layer::all(&own, changes)?;
        if layers.len() == 1 {
            return Ok(own);
        }
        let all = Self::of_layers(layers, &own.file)?;
        let changed =
            all.places.iter().filter(|place| all.layers[place.layer].is_override() && !place.is_table);
        for place in changed {
            if let Some(remedy) = all.set_by_sweep(&place.key) {
                return Err(all.wrong(place, &remedy));
            }
        }
        Ok(all)
    }

    /// The folder to which file names in the spec are relative.
    pub fn folder(&self) -> &Path {
        folder(&self.file)
    }

    /// The file and its bases alone; `None` without overrides.
    pub fn without_overrides(&self) -> Option<Self> {
        let first = self.layers.iter().position(|layer| !layer.is_override())?;
        let layers = self.layers[first..].to_vec();
        (first > 0).then(|| Self::of_layers(layers, &self.file).ok()).flatten()
    }

    /// The spec without a key of the file or its bases, or its axis; `None` if they do not contain it or an override sets it.
    pub fn without_key(&self, key: &str) -> Option<Self> {
        let axis = format!("sweep.\"{key}\"");
        let place = self.places.iter().find(|place| place.key == key || place.key == axis)?;
        if self.layers[place.layer].is_override() {
            return None;
        }
        let mut all: toml::Table = toml::from_str(&self.text).ok()?;
        remove(&mut all, &place.key)?;
        let text = comments(&self.text) + &toml::to_string(&all).ok()?;
        let places = self.places.iter().filter(|other| other.key != place.key).cloned().collect();
        Self::with_text(&self.file, text, self.layers.clone(), places).ok()
    }

    fn of_layers(layers: Vec<Layer>, file: &Path) -> Result<Self, SpecError> {
        let (text, places) = merged(&layers, file)?;
        Self::with_text(file, text, layers, places)
    }

    /// Layers with their merged text.
    fn with_text(
        file: &Path,
        text: String,
        layers: Vec<Layer>,
        places: Vec<Place>,
    ) -> Result<Self, SpecError> {
        let flat = Layer { file: file.to_owned(), text: text.clone(), removes: None }.places(0)?;
        Ok(Self { file: file.to_owned(), text, layers, places, flat })
    }

    /// Returns a message if a key has no effect, because an axis or all points set it, a table that contains it, or a part of
    /// it.
    fn set_by_sweep(&self, key: &str) -> Option<String> {
        let within =
            |inner: &str, outer: &str| inner.strip_prefix(outer).is_some_and(|rest| rest.starts_with('.'));
        let sets = |name: &str| name == key || within(key, name) || within(name, key);
        let axis_of = |key: &str| Some(key.strip_prefix("sweep.\"")?.strip_suffix('"')?.to_owned());
        if let Some(axis) = self.places.iter().find(|p| axis_of(&p.key).is_some_and(|axis| sets(&axis))) {
            return Some(format!("has no effect, because an axis sets the values: {} = [ … ]", axis.key));
        }
        let sweep = toml::from_str::<Value>(&self.text).ok()?;
        let points = sweep["sweep"]["points"].as_array()?;
        let given =
            |point: &Value| point.as_object().is_some_and(|point| point.keys().any(|name| sets(name)));
        let all = !points.is_empty() && key.contains('.') && points.iter().all(given);
        all.then(|| "has no effect, because all entries of sweep.points set it: change them".to_owned())
    }

    /// Parses a spec, or another kind of file, and checks keys and types. The plan validates the values.
    /// The error is the first unknown key, missing key, or value of a wrong type.
    pub fn parse<T: DeserializeOwned + JsonSchema>(&self) -> Result<T, SpecError> {
        let known = KnownKeys::of_type::<T>();
        for place in &self.places {
            self.check_key(place, &known)?;
        }
        let parsed = toml::from_str(&self.text).map_err(|e| self.type_error(&e, &known))?;
        let value = toml::from_str(&self.text).expect("it has been read");
        match known.first_overlong_list(&value) {
            Some(key) => Err(self.error(&key, &known.in_words(&key, "invalid length"))),
            None => Ok(parsed),
        }
    }

    fn check_key(&self, place: &Place, known: &KnownKeys) -> Result<(), SpecError> {
        let key = place.key.as_str();
        let axis =
            key.strip_prefix(POINTS).or_else(|| key.strip_prefix("sweep.")).unwrap_or(key).replace('"', "");
        if let Some(why) = removed(&axis, if place.is_table { "" } else { self.written(place) }) {
            return Err(self.wrong(place, why));
        }
        let no_axis = |name: &str| {
            let what = format!("{key} = {}: {}", self.value(place), no_axis(name, known));
            Err(self.located(Some(place), key.to_owned(), what))
        };
        if let Some(linked) = key.strip_prefix(POINTS) {
            let linked = &linked.replace('"', "");
            if place.is_table && !linked.contains('.') && known.contains(linked) {
                return Err(self.wrong(place, &self.unquoted(place)));
            }
            if !known.is_axis(linked) && !COUNTS.contains(&linked.as_str()) {
                return no_axis(linked);
            }
        } else if let Some(axis) = key.strip_prefix("sweep.").filter(|_| !known.contains(key)) {
            let (quoted, axis) = (axis.starts_with('"'), axis.trim_matches('"'));
            if place.is_table && known.contains(axis) && !quoted {
                let remedy =
                    format!("must not be a table; write an axis in quotes, such as \"{axis}.…\" = [ … ]");
                return Err(self.wrong(place, &remedy));
            }
            if !known.is_axis(axis) {
                return no_axis(axis);
            }
            if !place.is_list {
                return Err(self.wrong(place, "must be a list of values, because it is an axis"));
            }
        } else if !known.contains(key) {
            let remedy = match KnownKeys::nearest_of(key, known.paths()) {
                None if !known.contains("sweep") => {
                    format!("unknown key; known keys here: {}", known.paths().collect::<Vec<_>>().join(", "))
                }
                nearest => unknown(nearest),
            };
            return Err(self.error(key, &remedy));
        }
        match &place.no_number {
            Some(why) => Err(self.wrong(place, why)),
            None => Ok(()),
        }
    }

    /// Returns the message for a table of an entry of `sweep.points` whose keys are not paths in quotes.
    fn unquoted(&self, table: &Place) -> String {
        let own = format!("{}.", table.key);
        let after = |p: &&Place| p.layer == table.layer && p.at > table.at;
        let inner = self.places.iter().filter(after).find(|p| !p.is_table && p.key.starts_with(&own));
        let path = |p: &Place| p.key[POINTS.len()..].replace('"', "");
        let quoted = match inner {
            Some(inner) => format!("\"{}\" = {}", path(inner), self.value(inner)),
            None => format!("\"{}.…\" = …", path(table)),
        };
        format!("must not be a table; write the path of each key in quotes: {quoted}")
    }

    /// Returns an error at this place, with its value.
    fn wrong(&self, place: &Place, remedy: &str) -> SpecError {
        let what = match place.is_table {
            true => format!("{}: {remedy}", place.key),
            false => format!("{} = {}: {remedy}", place.key, self.value(place)),
        };
        self.located(Some(place), place.key.clone(), what)
    }

    fn type_error(&self, e: &toml::de::Error, known: &KnownKeys) -> SpecError {
        let span = e.span().unwrap_or(0..0);
        // The innermost key around the value that serde rejected.
        let around = |p: &&Place| p.value.start <= span.start && span.end <= p.value.end;
        let place = match &self.flat[..] {
            [] => self.places.iter().rfind(around),
            flat => flat.iter().rfind(around).and_then(|place| self.origin(place)),
        };
        let message = e.message().trim().replace('\n', " ");
        let missing = message.strip_prefix("missing field `").and_then(|m| m.strip_suffix('`'));
        match (missing, place) {
            (Some(field), place) => {
                // serde reports only the name of the key. Its span may lie deeper than the table that lacks the key or, in a
                // list of tables, after the first one.
                let before = || self.places.iter().rfind(|p| self.flat.is_empty() && p.at <= span.start);
                let place = place.or_else(before);
                let key = place.map_or(field.to_owned(), |p| missing_key_path(&p.key, field, known));
                let table = key.rsplit_once('.').map_or("", |(table, _)| table);
                let own = |p: &&Place| p.key == table;
                let place = place.filter(own).or_else(|| self.places.iter().find(own));
                let what = format!("{key}: must be set; it has no default");
                self.located(place, key, what)
            }
            (None, Some(place)) => {
                let mut remedy = known.in_words(&place.key, &message);
                if place.is_list && known.is_axis(&place.key) && !remedy.contains("list") {
                    remedy += &format!("; write an axis in [sweep]: sweep.\"{}\" = [ … ]", place.key);
                }
                self.wrong(place, &remedy)
            }
            (None, None) => self.error("", &message),
        }
    }

    /// Returns an error about a key: at the axis or point that sets it, else at the key, else at the table that would contain
    /// it, else at an axis that sets a part of it.
    pub fn error(&self, key: &str, remedy: &str) -> SpecError {
        self.error_with(key, None, remedy)
    }

    /// Like `error`, with the value at fault if it differs from that in the file, such as one element of a list. An empty value
    /// is not printed.
    pub fn error_with(&self, key: &str, value: Option<&str>, remedy: &str) -> SpecError {
        let axis = format!("sweep.\"{key}\"");
        let exact = |wanted: &str| self.places.iter().find(|p| p.key == wanted);
        let stated = exact(&axis).or_else(|| self.linked(key, value)).or_else(|| exact(key));
        let mut tables = successors(key.rsplit_once('.'), |(table, _)| table.rsplit_once('.'));
        let place = stated.or_else(|| tables.find_map(|(table, _)| exact(table)));
        let within = format!("sweep.\"{key}.");
        let place = place.or_else(|| self.places.iter().find(|p| p.key.starts_with(&within)));
        let value = value.map(shortened).or_else(|| stated.filter(|p| !p.is_table).map(|p| self.value(p)));
        let remedy = remedy.split(' ').map(shortened).collect::<Vec<_>>().join(" ");
        let what = match (key, value) {
            ("", _) => remedy,
            (key, Some(value)) if !value.is_empty() => format!("{key} = {value}: {remedy}"),
            (key, _) => format!("{key}: {remedy}"),
        };
        self.located(place, key.to_owned(), what)
    }

    /// Checks conditions, each given as key, whether it holds, and remedy. The first that does not hold is an error.
    pub fn require(&self, conditions: &[(&str, bool, &str)]) -> Result<(), SpecError> {
        match conditions.iter().find(|(_, holds, _)| !holds) {
            Some((key, _, remedy)) => Err(self.error(key, remedy)),
            None => Ok(()),
        }
    }

    /// Returns the original place of a key of the merged text. Repeated keys, in lists of tables, are matched by index.
    fn origin(&self, place: &Place) -> Option<&Place> {
        let same = |p: &&Place| p.key == place.key;
        let number = self.flat.iter().filter(same).take_while(|p| p.at < place.at).count();
        self.places.iter().filter(same).nth(number)
    }

    /// Returns the entry of `sweep.points` that sets a key to this value, else the first that sets it.
    fn linked(&self, key: &str, value: Option<&str>) -> Option<&Place> {
        let key = key.strip_prefix("sweep.").filter(|key| COUNTS.contains(key)).unwrap_or(key);
        let named = |p: &&Place| p.key.strip_prefix(POINTS).is_some_and(|k| k.trim_matches('"') == key);
        let bare = |text: &str| text.split_whitespace().collect::<String>();
        let same = |p: &&Place| value.is_some_and(|v| bare(self.written(p)) == bare(v));
        let places = || self.places.iter().filter(named);
        places().find(same).or_else(|| places().next())
    }

    fn located(&self, place: Option<&Place>, key: String, what: String) -> SpecError {
        match place {
            Some(place) => self.layers[place.layer].error(place.at, key, what),
            None => SpecError { file: self.file.clone(), line: 1, key, what },
        }
    }

    fn written(&self, place: &Place) -> &str {
        &self.layers[place.layer].text[place.value.clone()]
    }

    /// Returns a value as written, truncated if long.
    fn value(&self, place: &Place) -> String {
        const LONGEST: usize = 60;
        let text = self.written(place).split_whitespace().collect::<Vec<_>>().join(" ");
        match text.char_indices().nth(LONGEST) {
            Some((end, _)) => format!("{}…", &text[..end]),
            None => text,
        }
    }
}

/// Prefix of the keys of an entry of `sweep.points`.
const POINTS: &str = "sweep.points.";
/// Prefixes of the keys of other lists of tables, and keys of `sweep.points` that are not paths.
const TABLES: [&str; 4] = ["body.guides.", "body.panels.", "stimuli.mix.", "evaluation.under."];
const COUNTS: [&str; 2] = ["panels", "sensors"];

/// Returns the path of a key that is missing in a table or in one that contains it.
fn missing_key_path(table: &str, field: &str, known: &KnownKeys) -> String {
    let outer = successors(Some(table), |table| Some(table.rsplit_once('.')?.0));
    let mut paths = outer.map(|table| format!("{table}.{field}")).chain([field.to_owned()]);
    paths.find(|path| known.contains(path)).unwrap_or_else(|| format!("{table}.{field}"))
}

/// Returns the message for an unknown key.
fn unknown(nearest: Option<&str>) -> String {
    match nearest {
        Some(nearest) => format!("unknown key; the nearest known one is {nearest:?}"),
        None => "unknown key; `metasense setup schema` lists all keys".into(),
    }
}

/// Returns the message for a key of `[sweep]` that is not an axis.
fn no_axis(name: &str, known: &KnownKeys) -> String {
    match name.strip_prefix("sweep.").filter(|_| known.contains(name)) {
        Some(own) => format!("belongs to [sweep] itself; write it there without quotes: {own} = …"),
        None if name.contains('.') && known.contains(name) => {
            "is not a setting of a trial and cannot be swept".into()
        }
        None if name.contains('.') => unknown(KnownKeys::nearest_of(name, known.axes())),
        None => match KnownKeys::nearest_of(&format!("sweep.{name}"), known.paths()) {
            Some(nearest) => unknown(Some(nearest)),
            None => "unknown key; an axis is the path of a key in quotes, such as \"body.columns\" = [5, 6]"
                .into(),
        },
    }
}

/// Returns the JSON schema of a spec.
pub fn spec_schema() -> Value {
    schemars::schema_for!(SweepSpec).to_value()
}

/// Formats a long number with an exponent.
fn shortened(value: &str) -> String {
    const LONGEST: usize = 24;
    match value.parse::<f64>() {
        Ok(x) if value.len() > LONGEST => format!("{x:e}"),
        _ => value.to_owned(),
    }
}

#[cfg(test)]
mod tests;
