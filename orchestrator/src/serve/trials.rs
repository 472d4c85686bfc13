//! All trials of a database in memory, for sorting and filtering; a read takes only those that have changed.

use std::cmp::{Ordering, Reverse};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt;
use std::path::Path;
use std::sync::Arc;

use serde_json::Value;

use crate::analysis::setting::{Setting, SharedSettings};
use crate::cell::{brief, of_value, plain};
use crate::reader::Reader;
use crate::store::StoreError;

/// Numbers of a trial: names for sorting and filtering, and headings.
pub const NUMBERS: [(&str, &str); 18] = [
    ("K", "forces K"),
    ("M", "sensors M"),
    ("placement", "placement"),
    ("seed", "seed"),
    ("units", "units"),
    ("holdout_initial", "held-out, initial (%)"),
    ("holdout_optimised", "trained (%)"),
    ("median_initial", "median sample, initial (%)"),
    ("median_optimised", "trained (%)"),
    ("above_initial", "samples above 100 %, initial"),
    ("above_optimised", "trained"),
    ("test_initial", "test, initial (%)"),
    ("test_optimised", "trained (%)"),
    ("best_step", "best step"),
    ("steps", "steps"),
    ("attempts", "attempts"),
    ("cpu_seconds", "CPU time (s)"),
    ("estimate", "estimate (s)"),
];

/// Rows with these numbers, in their order.
const ROWS: &str = "SELECT t.id, t.hash, t.spec, t.state, coalesce(t.reason, '') AS reason, t.panels AS K, t.sensors AS M, t.placement,
  t.seed, t.units, t.holdout_error_initial AS holdout_initial, t.holdout_error_optimised AS holdout_optimised,
  t.holdout_median_initial AS median_initial, t.holdout_median_optimised AS median_optimised,
  t.holdout_above_initial AS above_initial, t.holdout_above_optimised AS above_optimised,
  t.error_initial AS test_initial, t.error_optimised AS test_optimised, t.best_step,
  (SELECT v.steps FROM v_trial v WHERE v.hash = t.hash) AS steps,
  (SELECT count(*) FROM attempt a WHERE a.trial_id = t.id) AS attempts,
  (SELECT sum(s.seconds) FROM spent s WHERE s.trial_id = t.id AND NOT s.redone) AS cpu_seconds, t.cost AS estimate
FROM trial t";

/// Number of trials per statement.
const AT_ONCE: usize = 500;
/// Maximum number of values offered per key.
const MOST_VALUES: usize = 12;
/// States of a trial.
const STATES: [&str; 4] = ["pending", "running", "done", "failed"];

#[derive(Debug, Clone)]
pub struct TrialRow {
    pub hash: String,
    /// `pending`, `running`, `done` or `failed`.
    pub state: String,
    pub reason: String,
    /// Values of [`NUMBERS`]; NaN if there is none.
    pub numbers: [f64; NUMBERS.len()],
    pub setting: Setting,
}

impl TrialRow {
    /// The value of a column, or of a path of the spec.
    pub fn cell(&self, key: &str) -> Value {
        let text = |text: &str| if text.is_empty() { Value::Null } else { text.into() };
        match (key, NUMBERS.iter().position(|(name, _)| *name == key)) {
            ("hash", _) => text(&self.hash),
            ("state", _) => text(&self.state),
            ("reason", _) => text(&self.reason),
            (_, Some(i)) if self.numbers[i].fract() == 0.0 => (self.numbers[i] as i64).into(),
            (_, Some(i)) => self.numbers[i].into(),
            (_, None) => match self.setting.get(key) {
                Some(value) => of_value(value, brief),
                None => {
                    let below = format!("{key}.");
                    let said = || self.setting.leaves().keys().any(|path| path.starts_with(&below));
                    let usual = USUAL.iter().find(|(usual, _)| *usual == key && !said());
                    usual.map(|(_, value)| *value).into()
                }
            },
        }
    }

    /// A number by its name.
    ///
    /// # Panics
    /// If [`NUMBERS`] does not contain the name.
    pub fn number(&self, name: &str) -> Option<f64> {
        let at = NUMBERS.iter().position(|(known, _)| *known == name).expect("a number of a trial");
        Some(self.numbers[at]).filter(|x| !x.is_nan())
    }
}

/// Order: numbers by size, then texts, then null.
fn order(a: &Value, b: &Value) -> Ordering {
    let rank = |value: &Value| if value.is_number() { 0 } else { 1 + u8::from(value.is_null()) };
    match (a.as_f64(), b.as_f64()) {
        (Some(a), Some(b)) => a.total_cmp(&b),
        _ => rank(a).cmp(&rank(b)).then_with(|| plain(a).cmp(&plain(b))),
    }
}

/// All trials at one moment.
#[derive(Debug, Clone, Default)]
pub struct Trials {
    /// The trials in planned order.
    pub rows: Vec<Arc<TrialRow>>,
    /// Keys of the spec whose values differ between trials, with some of the values.
    pub keys: Arc<BTreeMap<String, Vec<String>>>,
}

/// Keeps trials between reads.
#[derive(Debug, Default)]
pub struct Keeper {
    settings: SharedSettings,
    places: HashMap<i64, usize>,
    now: Trials,
}

impl Keeper {
    /// Reads what has changed.
    pub async fn look(&mut self, reader: &mut Reader) -> Result<Trials, StoreError> {
        // new trials may reuse the ids of removed ones
        let (mut known, mut others) = (0, false);
        let (places, rows) = (&self.places, &self.now.rows);
        let sql = "SELECT id, hash FROM trial";
        let read_hashes = reader.rows(sql, |row| match places.get(&(row.count("id") as i64)) {
            Some(&place) if rows[place].hash == row.text("hash") => known += 1,
            Some(_) => others = true,
            None => {}
        });
        read_hashes.await?;
        if others || known < self.places.len() {
            *self = Self::default();
        }
        if self.places.is_empty() {
            self.take(reader, &format!("{ROWS} ORDER BY t.id")).await?;
        } else {
            // answered by an index alone
            let (places, rows) = (&self.places, &self.now.rows);
            let asked = reader.rows("SELECT id, state FROM trial", |row| {
                let (id, state) = (row.count("id") as i64, row.text("state"));
                let stale = state == "running" || places.get(&id).is_none_or(|&at| rows[at].state != state);
                stale.then_some(id)
            });
            let mut changed: Vec<i64> = asked.await?.into_iter().flatten().collect();
            changed.sort_unstable();
            for ids in changed.chunks(AT_ONCE) {
                let ids: Vec<String> = ids.iter().map(i64::to_string).collect();
                self.take(reader, &format!("{ROWS} WHERE t.id IN ({}) ORDER BY t.id", ids.join(", ")))
                    .await?;
            }
        }
        Ok(self.now.clone())
    }

    async fn take(&mut self, reader: &mut Reader, sql: &str) -> Result<(), StoreError> {
        let known = self.settings.shared().count();
        reader
            .rows(sql, |row| {
                let id = row.count("id") as i64;
                let place = self.places.get(&id).copied();
                let setting = match place {
                    Some(place) => self.now.rows[place].setting.clone(),
                    // an invalid spec has no keys
                    None => self.settings.of(&serde_json::from_str(row.text("spec")).unwrap_or_default()),
                };
                let [hash, state, reason] = ["hash", "state", "reason"].map(|key| row.text(key).to_owned());
                let numbers = NUMBERS.map(|(name, _)| row.number(name).unwrap_or(f64::NAN));
                let trial = Arc::new(TrialRow { hash, state, reason, numbers, setting });
                match place {
                    Some(place) => self.now.rows[place] = trial,
                    None => {
                        self.places.insert(id, self.now.rows.len());
                        self.now.rows.push(trial);
                    }
                }
            })
            .await?;
        if self.settings.shared().count() != known {
            self.now.keys = Arc::new(self.keys());
        }
        Ok(())
    }

    fn keys(&self) -> BTreeMap<String, Vec<String>> {
        let mut values: BTreeMap<&str, BTreeSet<String>> = BTreeMap::new();
        for shared in self.settings.shared() {
            for (key, value) in shared {
                let of_key = values.entry(key).or_default();
                if of_key.len() < MOST_VALUES {
                    of_key.insert(plain(&of_value(value, brief)));
                }
            }
        }
        let several = values.into_iter().filter(|(_, values)| values.len() > 1);
        several.map(|(key, values)| (key.to_owned(), values.into_iter().collect())).collect()
    }
}

/// Values of keys that a trial's settings omit.
const USUAL: [(&str, &str); 3] =
    [("sensors.search", "random"), ("brain.kind", "cnn"), ("optimise.objective", "nominal")];

/// A condition on a key.
#[derive(Debug, Clone, PartialEq)]
pub struct Term {
    key: String,
    relation: &'static str,
    value: String,
    /// The value is in quotes. `remove` accepts an empty value only in quotes.
    quoted: bool,
}

/// Relations, the longer ones first.
const RELATIONS: [&str; 7] = ["!=", "<=", ">=", "=", "<", ">", "~"];

/// Parses conditions such as `K=4 M<=3 optimise.brain=linear state!=done hash~3fa reason="took too long"`, separated by blanks.
///
/// # Errors
/// The invalid condition.
pub fn terms(text: &str) -> Result<Vec<Term>, String> {
    let mut in_quotes = false;
    let parts = text.split(|c: char| {
        in_quotes ^= c == '"';
        c.is_whitespace() && !in_quotes
    });
    let words: Vec<&str> = parts.filter(|word| !word.is_empty()).collect();
    words.into_iter().map(Term::new).collect()
}

/// The condition that a key has a value; `None` if [`terms`] cannot read it.
pub fn condition(key: &str, value: &str) -> Option<String> {
    let quote = if value.contains(char::is_whitespace) { "\"" } else { "" };
    let text = format!("{key}={quote}{value}{quote}");
    let read = terms(&text).ok()?;
    let same = |term: &Term| term.key == key && term.relation == "=" && term.value == value;
    matches!(&read[..], [term] if same(term)).then_some(text)
}

impl Term {
    /// Parses one condition. Blanks within the value belong to it.
    fn new(text: &str) -> Result<Self, String> {
        let none = || format!("`{text}` is not a condition; a condition is, for instance, `M<=3`");
        let relations = RELATIONS.iter().filter_map(|r| Some((text.find(r)?, *r)));
        let (at, relation) = relations.min_by_key(|(at, r)| (*at, Reverse(r.len()))).ok_or_else(none)?;
        let (key, value) = (text[..at].trim(), text[at + relation.len()..].trim());
        let bare = value.strip_prefix('"').and_then(|rest| rest.strip_suffix('"'));
        match key.is_empty() || bare.unwrap_or(value).contains('"') {
            true => Err(none()),
            false => {
                let (key, value) = (key.to_owned(), bare.unwrap_or(value).to_owned());
                Ok(Self { key, relation, value, quoted: bare.is_some() })
            }
        }
    }

    /// The value, if it is a number.
    fn number(&self) -> Option<f64> {
        self.value.parse().ok().filter(|x: &f64| x.is_finite() && !self.quoted)
    }

    fn is_equality(&self) -> bool {
        ["=", "!="].contains(&self.relation)
    }

    /// Compares a cell with the value; `None` if they are not comparable.
    fn order(&self, cell: &Value) -> Option<Ordering> {
        let whole = cell.as_i64().zip(self.value.parse::<i64>().ok());
        if let Some((cell, value)) = whole {
            // exact, because seeds may have more digits than a floating-point number
            return Some(cell.cmp(&value));
        }
        match (cell.as_f64(), self.number()) {
            (Some(x), Some(value)) => x.partial_cmp(&value),
            _ if cell.is_null() && !self.is_equality() => None,
            _ => Some(plain(cell).as_str().cmp(&self.value)),
        }
    }

    fn holds(&self, row: &TrialRow) -> bool {
        let cell = row.cell(&self.key);
        if self.relation == "~" {
            return plain(&cell).contains(&self.value);
        }
        let Some(order) = self.order(&cell) else { return false };
        match self.relation {
            "=" => order.is_eq(),
            "!=" => order.is_ne(),
            "<" => order.is_lt(),
            ">" => order.is_gt(),
            "<=" => order.is_le(),
            _ => order.is_ge(),
        }
    }
}

impl fmt::Display for Term {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let quote = if self.quoted { "\"" } else { "" };
        write!(f, "{}{}{quote}{}{quote}", self.key, self.relation, self.value)
    }
}

impl Trials {
    /// All trials of a database.
    pub async fn of(db: &Path) -> Result<Self, StoreError> {
        Reader::with_reader(db, async |reader| Keeper::default().look(reader).await).await
    }

    /// The trials that meet all conditions, in planned order. Conditions that would hold of all trials by mistake are refused: an empty value
    /// without quotes, and `!=` with a value that no trial has.
    ///
    /// # Errors
    /// The condition that is refused, and why.
    pub fn chosen(&self, conditions: &[String]) -> Result<Vec<&Arc<TrialRow>>, String> {
        let terms = conditions.iter().map(|text| Term::new(text)).collect::<Result<Vec<_>, _>>()?;
        self.check(&terms)?;
        for term in &terms {
            if term.value.is_empty() && !term.quoted {
                let (key, relation) = (&term.key, term.relation);
                return Err(format!(
                    "`{term}`: the value is missing; {key}{relation}\"\" matches an empty value"
                ));
            }
            let named =
                || self.rows.iter().any(|row| term.order(&row.cell(&term.key)) == Some(Ordering::Equal));
            if term.relation == "!=" && !self.rows.is_empty() && !named() {
                let key = &term.key;
                return Err(format!("`{term}`: no trial has this {key}, so all trials would match"));
            }
        }
        Ok(self.found(&terms, ""))
    }

    /// Refuses unknown keys and comparisons of different types: a misspelt key differs from every value, and as texts all numbers
    /// are less than `two`.
    fn check(&self, terms: &[Term]) -> Result<(), String> {
        let has = |key: &str| key == "reason" || self.rows.iter().any(|row| !row.cell(key).is_null());
        if let Some(term) = terms.iter().find(|term| !self.rows.is_empty() && !has(&term.key)) {
            let columns = NUMBERS.map(|(name, _)| name).join(", ");
            let key = &term.key;
            return Err(format!(
                "no trial has `{key}`: it is neither a path of a spec here nor a column (hash, state, reason, {columns})"
            ));
        }
        terms.iter().try_for_each(|term| self.is_comparable(term))
    }

    fn is_comparable(&self, term: &Term) -> Result<(), String> {
        let (key, value) = (&term.key, &term.value);
        if key == "state" && term.is_equality() && !STATES.contains(&value.as_str()) {
            return Err(format!("no trial can be `{value}`: the states are {}", STATES.join(", ")));
        }
        let cells: Vec<Value> = self.rows.iter().map(|row| row.cell(key)).filter(|c| !c.is_null()).collect();
        let numbers = !cells.is_empty() && cells.iter().all(Value::is_number);
        let why: String = match term.relation {
            "~" if value.is_empty() => "every text contains an empty text; pass a part of the text".into(),
            "~" if numbers => format!("{key} is a number; use a comparison instead of ~"),
            "~" => return Ok(()),
            "=" | "!=" if value.is_empty() => return Ok(()),
            _ if numbers && term.number().is_none() => format!("{key} is a number, but `{value}` is not"),
            "<" | ">" | "<=" | ">=" if !numbers && !cells.is_empty() => {
                format!("{key} is not a number in all trials; =, != and ~ compare texts")
            }
            _ => return Ok(()),
        };
        Err(format!("`{term}`: {why}"))
    }

    /// Trials that meet the conditions in a text, sorted by a key; for an invalid condition, no trials and the reason.
    pub fn asked(&self, text: &str, sort: &str) -> (Vec<&Arc<TrialRow>>, Option<String>) {
        match terms(text).and_then(|terms| self.check(&terms).map(|()| terms)) {
            Ok(terms) => (self.found(&terms, sort), None),
            Err(wrong) => (Vec::new(), Some(wrong)),
        }
    }

    /// Trials that meet all conditions, sorted by a key (`-KEY`: descending; trials without a value always last), then in planned
    /// order.
    pub fn found(&self, terms: &[Term], sort: &str) -> Vec<&Arc<TrialRow>> {
        let mut found: Vec<&Arc<TrialRow>> =
            self.rows.iter().filter(|row| terms.iter().all(|term| term.holds(row))).collect();
        let (key, down) = sort.strip_prefix('-').map_or((sort, false), |key| (key, true));
        if !key.is_empty() {
            let mut keyed: Vec<(Value, _)> = found.into_iter().map(|row| (row.cell(key), row)).collect();
            let forward = |a: &Value, b: &Value| !down || a.is_null() || b.is_null();
            keyed.sort_by(|(a, _), (b, _)| if forward(a, b) { order(a, b) } else { order(b, a) });
            found = keyed.into_iter().map(|pair| pair.1).collect();
        }
        found
    }
}

#[cfg(test)]
mod tests;
