//! Gain from placing sensors with a search, and further gain from training the body.
//!
//! Four curves of error against M: sensors placed at random and by a search, on the initial and on the trained body.

use super::data::{SEARCH, SENSORS, groups};
use super::numbers::{distinct, geometric_mean};
use super::paired::Ratio;
use super::resample::Resampling;
use super::trial::{BodyState, Cluster, Set, Trial};

/// Random and searched placements of one setting.
#[derive(Debug, Clone)]
pub struct PlacementComparison<'a> {
    /// The setting.
    pub label: String,
    /// The values of M that both have, ascending.
    pub levels: Vec<SensorLevel<'a>>,
}

/// Trials with one M.
#[derive(Debug, Clone)]
pub struct SensorLevel<'a> {
    /// M.
    pub sensors: u64,
    /// Trials with sensors placed at random, and by a search (first placement).
    pub trials: [Vec<&'a Trial>; 2],
}

/// Returns the kind of search that placed the sensors, if any.
fn search(trial: &Trial) -> Option<&str> {
    trial.setting.text("sensors.search")
}

/// Returns the settings with random and searched placements, one entry per kind of search.
pub fn placed<'a>(trials: &[&'a Trial]) -> Vec<PlacementComparison<'a>> {
    let mut found = Vec::new();
    let but = [SENSORS, SEARCH].concat();
    for group in groups(trials, &but) {
        let searches = distinct(group.trials.iter().filter_map(|t| search(t)));
        let kinds = searches.len();
        for kind in searches {
            let trials_with = |m: u64, by: Option<&str>| -> Vec<&'a Trial> {
                let first = |t: &Trial| by.is_none() || t.cluster.placement == 0;
                let own = |t: &&&Trial| t.sensors == m && search(t) == by && first(t);
                group.trials.iter().filter(own).copied().collect()
            };
            let all = distinct(group.trials.iter().map(|t| t.sensors));
            let level = |sensors| SensorLevel {
                sensors,
                trials: [trials_with(sensors, None), trials_with(sensors, Some(kind))],
            };
            let levels: Vec<SensorLevel> =
                all.into_iter().map(level).filter(|l| l.trials.iter().all(|t| !t.is_empty())).collect();
            let label = if kinds > 1 { format!("{}, {kind}", group.label) } else { group.label.clone() };
            if !levels.is_empty() {
                found.push(PlacementComparison { label, levels });
            }
        }
    }
    found
}

impl SensorLevel<'_> {
    /// Error (%, geometric mean) with sensors placed at random or (`searched`) by a search.
    pub fn error(&self, searched: bool, body: BodyState, set: Set) -> Option<f64> {
        let trials = &self.trials[usize::from(searched)];
        let errors: Vec<f64> = trials.iter().filter_map(|t| t.error(body, set)).collect();
        (!errors.is_empty()).then(|| geometric_mean(&errors))
    }

    /// Error on the initial body with random sensors divided by that with searched sensors, per seed.
    pub fn gain_from_placing(&self, set: Set) -> Option<Ratio> {
        let body = BodyState::Initial;
        let [random, searched] = &self.trials;
        let ratio = |t: &&Trial| {
            let own = |r: &&&Trial| r.cluster.seed == t.cluster.seed;
            let errors: Vec<f64> = random.iter().filter(own).filter_map(|r| r.error(body, set)).collect();
            (!errors.is_empty()).then_some(())?;
            Some((t.cluster, geometric_mean(&errors) / t.error(body, set)?))
        };
        Ratio::of(searched.iter().filter_map(ratio))
    }

    /// Error of the initial body divided by that of the trained body, both with searched sensors.
    pub fn gain_from_training(&self, set: Set) -> Option<Ratio> {
        super::paired::error_ratio(&self.trials[1], set)
    }
}

impl PlacementComparison<'_> {
    /// Returns the smallest M with at most this error (%) there and at every larger M.
    pub fn needed(&self, searched: bool, body: BodyState, set: Set, error: f64) -> NeededSensors {
        let of = |(level, l): (usize, &SensorLevel<'_>)| -> Vec<(usize, Cluster, f64)> {
            let trials = l.trials[usize::from(searched)].iter();
            trials.filter_map(|t| Some((level, t.cluster, t.error(body, set)?.ln()))).collect()
        };
        let logs: Vec<_> = self.levels.iter().enumerate().flat_map(of).collect();
        let smallest_level = |weights: &[f64]| {
            let mut sums = vec![(0.0, 0.0); self.levels.len()];
            for ((level, _, log), w) in logs.iter().zip(weights) {
                let (sum, all) = &mut sums[*level];
                (*sum, *all) = (*sum + w * log, *all + w);
            }
            let reached = |(sum, all): &&(f64, f64)| *all > 0.0 && sum / all <= error.ln();
            let from = self.levels.len() - sums.iter().rev().take_while(reached).count();
            self.levels.get(from).map(|level| level.sensors)
        };
        let clusters: Vec<Cluster> = logs.iter().map(|(_, cluster, _)| *cluster).collect();
        let mut drawn = Resampling::new(&clusters).replicates(|weights| Some(smallest_level(&weights)));
        drawn.sort_by_key(|m| m.unwrap_or(u64::MAX));
        let at =
            |part: f64| drawn.get((part * drawn.len().saturating_sub(1) as f64).round() as usize).copied();
        NeededSensors { sensors: smallest_level(&vec![1.0; logs.len()]), range: at(0.025).zip(at(0.975)) }
    }
}

/// Number of sensors that an error needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NeededSensors {
    /// M; `None` if no M of the sweep suffices.
    pub sensors: Option<u64>,
    /// 2.5th and 97.5th percentile of M over replicates of placements and seeds; `None` with too few units.
    pub range: Option<(Option<u64>, Option<u64>)>,
}

impl std::fmt::Display for NeededSensors {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let m = |m: Option<u64>| m.map_or("–".into(), |m| m.to_string());
        f.write_str(&m(self.sensors))?;
        match self.range {
            Some((low, high)) if low != high => write!(f, " ({} … {})", m(low), m(high)),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests;
