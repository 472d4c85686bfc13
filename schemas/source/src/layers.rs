//! The layers of a spec: overrides on the command line, the file, and its bases (`base`).
//!
//! Tables are merged key by key; any other value, also a list, replaces that of lower layers.

use std::path::{Path, PathBuf};

use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

use super::{POINTS, Place, Source, SpecError, TABLES};

/// Key of the base.
const BASE: &str = "base";
/// Keys that name files, relative to the folder of the spec that contains them.
const FILES: [&str; 4] = ["body.design", "body.file", "sensors.relative_to", "stimuli.recorded.files"];
/// File name of an override in errors.
const COMMAND_LINE: &str = "command line";

/// The text of one layer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Layer {
    pub file: PathBuf,
    pub text: String,
    /// The key of an override without a value, `KEY=`, which removes the key of the spec.
    pub removes: Option<String>,
}

impl Layer {
    /// Returns overrides, spec and bases, in order of precedence.
    pub fn all(own: &Source, changes: &[String]) -> Result<Vec<Self>, SpecError> {
        let mut layers =
            changes.iter().rev().map(|text| Self::change(text)).collect::<Result<Vec<_>, _>>()?;
        layers.extend_from_slice(&own.layers);
        let mut below = own.clone();
        let mut files = vec![canonical(&own.file)];
        while below.places.iter().any(|place| place.key == BASE) {
            let Some(Value::String(base)) = below.layers[0].table()?.remove(BASE) else {
                return Err(below.error(BASE, "must be a file name in quotes"));
            };
            let file = below.folder().join(base);
            if files.contains(&canonical(&file)) {
                return Err(below.error(BASE, "refers back to a spec that is based on this one"));
            }
            let unread =
                |e| format!("cannot be read: {e}; file names are relative to the folder of the spec");
            let text = std::fs::read_to_string(&file).map_err(|e| below.error(BASE, &unread(e)))?;
            files.push(canonical(&file));
            below = Source::new(&file, text)?;
            layers.extend_from_slice(&below.layers);
        }
        Ok(layers)
    }

    /// Converts an override `KEY=VALUE`, or `KEY=`. If the value is not valid TOML, its words are quoted.
    fn change(text: &str) -> Result<Self, SpecError> {
        let layer = |text: String| Self { file: COMMAND_LINE.into(), text, removes: None };
        let (key, value) = text.split_once('=').unwrap_or((text, ""));
        let is_removal = text.contains('=') && value.trim().is_empty();
        let key = match key.trim().strip_prefix("sweep.") {
            // an axis without quotes
            Some(axis) if axis.contains('.') && !axis.contains('"') => format!("sweep.\"{axis}\""),
            _ => key.trim().to_owned(),
        };
        let as_written = layer(format!("{key} = {value}"));
        let quoted = if is_removal { "\"\"".to_owned() } else { quoted_words(value) };
        let with_quotes = layer(format!("{key} = {quoted}"));
        let found = [as_written, with_quotes].into_iter().find(|layer| layer.places(0).is_ok());
        let wrong = |what: &str| {
            let (key, what) = (key.clone(), format!("{text}: {what}"));
            SpecError { file: COMMAND_LINE.into(), line: 0, key, what }
        };
        match found {
            Some(_) if key == BASE => Err(wrong("can be set only in the spec")),
            Some(layer) => Ok(Self { removes: is_removal.then_some(key), ..layer }),
            None => Err(wrong(
                "must be KEY=VALUE with a value as in a spec, such as optimise.iterations=20 or sensors.search=greedy; KEY= \
                 removes a key",
            )),
        }
    }

    /// Whether it is an override of the command line.
    pub fn is_override(&self) -> bool {
        self.file == Path::new(COMMAND_LINE)
    }

    /// Returns the keys with their paths, in the order of the text.
    pub fn places(&self, layer: usize) -> Result<Vec<Place>, SpecError> {
        let table = DeTable::parse(&self.text).map_err(|e| self.no_toml(&e))?;
        let mut places = Vec::new();
        find_places(table.get_ref(), "", layer, &mut places);
        places.sort_by_key(|place| place.at);
        Ok(places)
    }

    fn table(&self) -> Result<Table, SpecError> {
        toml::from_str(&self.text).map_err(|e| self.no_toml(&e))
    }

    fn no_toml(&self, e: &toml::de::Error) -> SpecError {
        let at = e.span().map_or(0, |span| span.start);
        self.error(at, String::new(), format!("not valid TOML: {}", e.message().trim()))
    }

    /// Returns an error at a byte of the text.
    pub fn error(&self, at: usize, key: String, what: String) -> SpecError {
        let before = &self.text.as_bytes()[..at.min(self.text.len())];
        let line = 1 + before.iter().filter(|&&b| b == b'\n').count();
        let line = if self.is_override() { 0 } else { line };
        SpecError { file: self.file.clone(), line, key, what }
    }
}

/// The folder of a file; empty for a bare file name.
pub(super) fn folder(file: &Path) -> &Path {
    file.parent().unwrap_or(Path::new(""))
}

fn canonical(file: &Path) -> PathBuf {
    file.canonicalize().unwrap_or_else(|_| file.to_owned())
}

/// Puts quotes around each word that has none.
fn quoted_words(text: &str) -> String {
    let is_word = |c: char| c.is_alphanumeric() || "_-./".contains(c);
    let mut quoted = String::new();
    let (mut in_word, mut in_quotes) = (false, false);
    for c in text.trim().chars() {
        in_quotes ^= c == '"';
        let goes_on = is_word(c) && !in_quotes;
        if goes_on != in_word {
            quoted.push('"');
        }
        in_word = goes_on;
        quoted.push(c);
    }
    if in_word {
        quoted.push('"');
    }
    quoted
}

/// Merges layers. Returns the text, and the places of the keys that are not overridden.
pub(super) fn merged(layers: &[Layer], file: &Path) -> Result<(String, Vec<Place>), SpecError> {
    let mut all = Table::new();
    let mut places: Vec<Place> = Vec::new();
    let mut given: Vec<String> = Vec::new();
    for (number, layer) in layers.iter().enumerate() {
        let own = layer.places(number)?;
        if let Some((place, why)) = own.iter().find_map(|place| Some((place, place.no_number.as_ref()?))) {
            let what = format!("{} = {}: {why}", place.key, &layer.text[place.value.clone()]);
            return Err(layer.error(place.at, place.key.clone(), what));
        }
        let mut table = layer.table()?;
        table.remove(BASE);
        if !layer.is_override() && folder(&layer.file) != folder(file) {
            let folder = canonical(folder(&layer.file));
            each_file(&mut table, &mut |file| {
                if let Some(path) = folder.join(&*file).to_str() {
                    *file = path.to_owned();
                }
            });
        }
        add_below(&mut all, table);
        let above = places.clone();
        let covers = |above: &Place, place: &Place| {
            let within = place.key.strip_prefix(&above.key).is_some_and(|rest| rest.starts_with('.'));
            !(above.is_table && place.is_table) && above.key == place.key || within && !above.is_table
        };
        let counts = |place: &Place| place.key != BASE && !above.iter().any(|above| covers(above, place));
        // the KEY of KEY=VALUE; later overrides may set keys of its table
        if layer.is_override()
            && let Some(place) = own.iter().rfind(|place| Some(place.at) < layer.text.find('='))
        {
            if given.contains(&place.key) || !counts(place) {
                let value = &layer.text[place.value.clone()];
                let what = format!("{} = {value}: is set twice; leave one out", place.key);
                return Err(layer.error(place.at, place.key.clone(), what));
            }
            given.push(place.key.clone());
        }
        places.extend(own.into_iter().filter(counts));
    }
    for layer in layers {
        let Some(key) = &layer.removes else { continue };
        let in_spec =
            |layer: &Layer| layer.places(0).is_ok_and(|all| all.iter().any(|place| place.key == *key));
        if !layers.iter().any(|layer| !layer.is_override() && in_spec(layer)) {
            return Err(layer.error(0, key.clone(), format!("{key}=: the spec does not contain this key")));
        }
        remove(&mut all, key);
        places.retain(|place| place.key != *key);
    }
    let head = layers.iter().find(|layer| layer.file == file).map_or("", |own| &own.text);
    Ok((comments(head) + &toml::to_string(&all).expect("tables of TOML are TOML"), places))
}

/// The comments at the head of a text.
pub(super) fn comments(text: &str) -> String {
    text.split_inclusive('\n').take_while(|line| line.starts_with('#')).collect()
}

/// Removes a key; an axis is a key of `[sweep]` in quotes.
pub(super) fn remove(spec: &mut Table, key: &str) -> Option<Value> {
    let axis = key.strip_prefix("sweep.\"").and_then(|axis| axis.strip_suffix('"'));
    let (tables, last) =
        axis.map_or_else(|| key.rsplit_once('.').unwrap_or(("", key)), |axis| ("sweep", axis));
    let mut names = tables.split('.').filter(|name| !name.is_empty());
    names.try_fold(spec, |table, name| table.get_mut(name)?.as_table_mut())?.remove(last)
}

/// Adds the keys that a table lacks.
fn add_below(table: &mut Table, below: Table) {
    for (key, value) in below {
        match (table.get_mut(&key), value) {
            (Some(Value::Table(table)), Value::Table(below)) => add_below(table, below),
            (Some(_), _) => {}
            (None, value) => drop(table.insert(key, value)),
        }
    }
}

/// Visits the names of files in a spec.
pub fn each_file(spec: &mut Table, visit: &mut dyn FnMut(&mut String)) {
    files_in("", spec, visit);
}

fn files_in(path: &str, table: &mut Table, visit: &mut dyn FnMut(&mut String)) {
    for (key, value) in table {
        let path = match (path, key.as_str()) {
            ("", key) => key.to_owned(),
            ("sweep", "points" | "exclude") => path.to_owned(),
            ("sweep", axis) => axis.to_owned(),
            (path, key) => format!("{path}.{key}"),
        };
        files_at(&path, value, visit);
    }
}

fn files_at(path: &str, value: &mut Value, visit: &mut dyn FnMut(&mut String)) {
    match value {
        Value::Table(table) => files_in(path, table, visit),
        Value::Array(values) => values.iter_mut().for_each(|value| files_at(path, value, visit)),
        Value::String(file) if FILES.contains(&path) => visit(file),
        _ => {}
    }
}

/// Collects keys with their paths. A key with a dot keeps its quotes. Only known lists of tables are searched.
fn find_places(table: &DeTable<'_>, prefix: &str, layer: usize, places: &mut Vec<Place>) {
    for (name, value) in table {
        let name_text = name.get_ref();
        let shown = if name_text.contains('.') { format!("\"{name_text}\"") } else { name_text.to_string() };
        let key = if prefix.is_empty() { shown } else { format!("{prefix}.{shown}") };
        let (is_table, is_list) = (value.get_ref().is_table(), value.get_ref().is_array());
        if let DeValue::Table(inner) = value.get_ref() {
            find_places(inner, &key, layer, places);
        }
        if let DeValue::Array(entries) = value.get_ref()
            && TABLES.iter().chain([&POINTS]).any(|list| key == list.trim_end_matches('.'))
        {
            let tables = entries.iter().filter_map(|entry| entry.get_ref().as_table());
            tables.for_each(|table| find_places(table, &key, layer, places));
        }
        let no_number = if is_table { None } else { no_number(value.get_ref()) };
        let (at, value) = (name.span().start, value.span());
        places.push(Place { key, layer, at, value, is_table, is_list, no_number });
    }
}

/// Returns the message for the first number in a value that cannot be stored.
fn no_number(value: &DeValue<'_>) -> Option<String> {
    match value {
        DeValue::Float(x) if !x.as_str().parse().is_ok_and(f64::is_finite) => {
            Some(format!("{x} is not a finite number"))
        }
        DeValue::Integer(n) if i64::from_str_radix(n.as_str(), n.radix()).is_err() => {
            Some("is too large: whole numbers must lie between -2^63 and 2^63 - 1".into())
        }
        DeValue::Array(values) => values.iter().find_map(|v| no_number(v.get_ref())),
        DeValue::Table(table) => table.values().find_map(|v| no_number(v.get_ref())),
        _ => None,
    }
}
