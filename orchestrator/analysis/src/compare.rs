//! Compares two databases trial by trial: one spec under two versions of the program, or two sweeps that differ in some
//! settings.
//!
//! The compared settings are those with one value in all trials of the first database and another value in all trials of the
//! second. A pair of trials agrees in all other settings, including placement and seed. Ratios are first divided by second.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use serde_json::{Value, json};

use super::data::{Group, groups};
use super::paired::{Ratio, ratio_of};
use super::tables::ratio_cells;
use super::trial::{BodyState, Set, Trial};
use metasense_render::Table;

/// Settings that are never compared: pairs agree in them.
const ALWAYS: [&str; 2] = ["point.placement", "point.seed"];

/// The pairs of trials of two databases.
#[derive(Debug, Clone)]
pub struct TrialPairs<'a> {
    /// Paths of the compared settings, with the values in the first and in the second database.
    pub differs: BTreeMap<&'a str, [Option<&'a Value>; 2]>,
    /// Pairs: first, second.
    pub pairs: Vec<[&'a Trial; 2]>,
    /// Number of trials without a partner in each database.
    pub alone: [usize; 2],
}

impl<'a> TrialPairs<'a> {
    /// Finds the pairs.
    pub fn new(first: &'a [Trial], second: &'a [Trial]) -> Self {
        let paths: BTreeSet<&str> =
            first.iter().chain(second).flat_map(|t| t.setting.leaves().into_keys()).collect();
        // the value that all trials have; `Some(None)`: none of them has one
        let sole = |trials: &'a [Trial], path: &str| -> Option<Option<&'a Value>> {
            let value = trials.first()?.setting.get(path);
            trials.iter().all(|t| t.setting.get(path) == value).then_some(value)
        };
        let own = paths.into_iter().filter_map(|at| Some((at, [sole(first, at)?, sole(second, at)?])));
        let differs: BTreeMap<&str, [Option<&Value>; 2]> =
            own.filter(|(path, [a, b])| a != b && !ALWAYS.contains(path)).collect();
        let key = |t: &'a Trial| -> Vec<(&'a str, String)> {
            let rest = t.setting.leaves().into_iter().filter(|(path, _)| !differs.contains_key(path));
            rest.map(|(path, value)| (path, value.to_string())).collect()
        };
        let partners: BTreeMap<Vec<(&str, String)>, &Trial> = second.iter().map(|t| (key(t), t)).collect();
        let pairs: Vec<[&Trial; 2]> =
            first.iter().filter_map(|t| Some([t, *partners.get(&key(t))?])).collect();
        let alone = [first, second].map(|trials| trials.len() - pairs.len());
        Self { differs, pairs, alone }
    }

    /// Returns one row per setting, quantity and body; with several settings also rows over all of them.
    pub fn table(&self) -> Table {
        let firsts: Vec<&Trial> = self.pairs.iter().map(|p| p[0]).collect();
        let mut settings = groups(&firsts, &[]);
        if settings.len() > 1 {
            settings.insert(0, Group { label: "all".into(), trials: firsts });
        }
        let mut rows = Vec::new();
        for group in &settings {
            let mut add = |quantity: &str, body: Value, of: &dyn Fn(&Trial) -> Option<f64>| {
                let row = vec![json!(group.label), json!(quantity), body];
                rows.extend(self.ratio(group, of).map(|r| row.into_iter().chain(ratio_cells(r)).collect()));
            };
            for (set, body) in
                Set::with_errors(&group.trials).flat_map(|set| BodyState::ALL.map(|body| (set, body)))
            {
                add(&format!("{} error", set.name()), json!(body.name()), &|t| t.error(body, set));
            }
            // as if each trial had trained its body: which one did is arbitrary
            let seconds = |t: &Trial| Some(t.seconds_alone()).filter(|s| *s > 0.0);
            add("CPU seconds", Value::Null, &seconds);
        }
        let columns = "setting quantity body pairs second_less ratio low high over";
        Table::new(columns, rows)
    }

    fn ratio(&self, group: &Group, of: &dyn Fn(&Trial) -> Option<f64>) -> Option<Ratio> {
        let partners: HashMap<*const Trial, &Trial> =
            self.pairs.iter().map(|p| (p[0] as *const _, p[1])).collect();
        let partner = |t: &Trial| partners.get(&(t as *const _)).copied();
        ratio_of(&group.trials, |t| Some([of(t)?, of(partner(t)?)?]))
    }
}

#[cfg(test)]
mod tests;
