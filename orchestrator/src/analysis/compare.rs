//! Two databases trial by trial: one spec under two programs, or two sweeps that differ in some settings.
//!
//! What has one value in all of the first database and another in all of the second is what is compared; trials that agree
//! in everything else are a pair, with equal placement and seed. A pair's ratio is of the first's value to the second's.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use serde_json::{Value, json};

use super::data::{Group, groups};
use super::paired::{Ratio, ratio_of};
use super::tables::ratio_cells;
use super::trial::{Body, Set, Trial};
use crate::look::Table;

/// What pairs always agree in.
const ALWAYS: [&str; 2] = ["point.placement", "point.seed"];

/// Trials of two databases that belong together.
#[derive(Debug, Clone)]
pub struct Comparison<'a> {
    /// Paths of the settings that are compared, with the first's and the second's value.
    pub differs: BTreeMap<&'a str, [Option<&'a Value>; 2]>,
    /// First and second.
    pub pairs: Vec<[&'a Trial; 2]>,
    /// Trials of either without a partner.
    pub alone: [usize; 2],
}

impl<'a> Comparison<'a> {
    /// Finds the pairs.
    #[must_use]
    pub fn new(first: &'a [Trial], second: &'a [Trial]) -> Self {
        let paths: BTreeSet<&str> =
            first.iter().chain(second).flat_map(|t| t.setting.leaves().into_keys()).collect();
        // the one value that all have, or lack
        let sole = |trials: &'a [Trial], path: &str| -> Option<Option<&'a Value>> {
            let value = trials.first()?.setting.get(path);
            trials.iter().all(|t| t.setting.get(path) == value).then_some(value)
        };
        let differs: BTreeMap<&str, [Option<&Value>; 2]> = paths
            .into_iter()
            .filter_map(|path| Some((path, [sole(first, path)?, sole(second, path)?])))
            .filter(|(path, [a, b])| a != b && !ALWAYS.contains(path))
            .collect();
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

    /// A row a setting, quantity and body, and where there are several settings one over all of them.
    #[must_use]
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
            for (set, body) in Set::ALL.into_iter().flat_map(|set| Body::ALL.map(|body| (set, body))) {
                add(&format!("{} error", set.name()), json!(body.name()), &|t| t.error(body, set));
            }
            let seconds = |t: &Trial| Some(t.seconds.iter().map(|s| s.1).sum::<f64>()).filter(|s| *s > 0.0);
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
mod tests {
    use super::*;
    use crate::analysis::Cluster;

    /// Errors of placements 0 … 4 with one and two sensors, times `factor`, of a brain.
    fn database(brain: &str, factor: f64, sensors: &[u64]) -> Vec<Trial> {
        let each = |(placement, m): (u64, u64)| {
            let setting = [
                ("brain.kind", json!(brain)),
                ("point.placement", json!(placement)),
                ("point.sensors", json!(m)),
                ("time.duration", json!(1.0)),
            ];
            let error = Some(factor * (10.0 + 3.0 * placement as f64) / m as f64);
            Trial {
                setting: setting.into_iter().map(|(path, value)| (path.to_owned(), value)).collect(),
                sensors: m,
                cluster: Cluster { placement, seed: 1 },
                errors: [[None, error], [None, error.map(|e| 0.5 * e)]],
                ..Trial::default()
            }
        };
        (0..5).flat_map(|p| sensors.iter().map(move |m| (p, *m))).map(each).collect()
    }

    /// Placements differ by a factor of two, pairs do not: the ratio is 4/3 to rounding. Half of the second have no partner.
    #[test]
    fn trials_are_paired_by_all_but_what_is_compared() {
        let (first, second) = (database("cnn", 2.0, &[1, 2]), database("linear", 1.5, &[1, 2, 3, 4]));
        let found = Comparison::new(&first, &second);
        assert_eq!((found.pairs.len(), found.alone), (10, [0, 10]));
        let differs: Vec<&str> = found.differs.keys().copied().collect();
        assert_eq!(differs, ["brain.kind"]);
        let table = found.table();
        // over all, M = 1, M = 2; two bodies
        assert_eq!(table.rows.len(), 6, "{table:?}");
        for row in &table.rows {
            let [ratio, low, high] = [5, 6, 7].map(|i| row[i].as_f64().unwrap());
            assert!((ratio - 4.0 / 3.0).abs() < 1e-12 && high - low < 1e-9, "{row:?}");
            assert_eq!((&row[4], &row[8]), (&row[3], &json!("5 placements")), "{row:?}");
        }
        assert_eq!((&table.rows[0][0], &table.rows[0][3]), (&json!("all"), &json!(10)));
    }

    #[test]
    fn sweeps_of_other_places_or_seeds_have_no_pairs() {
        let (mut first, mut second) = (database("cnn", 2.0, &[1, 2]), database("cnn", 1.5, &[3, 4]));
        assert_eq!(Comparison::new(&first, &second).pairs.len(), 0);
        second = database("cnn", 1.5, &[1, 2]);
        for (seed, trials) in [(1, &mut first), (2, &mut second)] {
            for trial in &mut *trials {
                let leaves =
                    trial.setting.leaves().into_iter().map(|(path, value)| (path.to_owned(), value.clone()));
                trial.setting = leaves.chain([("point.seed".to_owned(), json!(seed))]).collect();
            }
        }
        assert_eq!(Comparison::new(&first, &second).pairs.len(), 0);
        second.clear();
        assert_eq!(Comparison::new(&first, &second).alone, [10, 0]);
    }
}
