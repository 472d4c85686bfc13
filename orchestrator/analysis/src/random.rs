//! Compares random bodies with the initial and the trained body.
//!
//! Trials that start from `{ random = SEED }` give the errors of random bodies as their `initial` errors. They are compared
//! with trials of the regular body with the same sensors and forces. Units of inference are bodies, placements and seeds.

use std::collections::HashMap;

use metasense_schemas::spec::Design;

use super::data::{DESIGN, Group, groups, without_repeats};
use super::numbers::{distinct_numbers, geometric_mean, log_squares};
use super::paired::Ratio;
use super::resample::{PLACEMENTS, Resampling, SEEDS};
use super::trial::{BodyState, RANDOM, SPREAD, Set, Trial};

/// Errors of random bodies, of the initial and of the trained body.
#[derive(Debug, Clone, PartialEq)]
pub struct Random {
    /// Errors (%) of random bodies, one per trial.
    pub errors: Vec<f64>,
    /// Errors (%) of the initial and the trained body in the trials for comparison.
    pub others: [Vec<f64>; 2],
    /// Error of a random body divided by that of the initial and of the trained body, at equal sensors and forces. Above 1: the
    /// random body is worse.
    pub ratios: [Option<Ratio>; 2],
    /// Errors (%) of bodies that were trained from random ones.
    pub trained: Vec<f64>,
}

impl Random {
    /// Standard deviation of ln e over random bodies; `None` with a single body.
    pub fn deviation(&self) -> Option<f64> {
        let freedom = self.errors.len() - 1;
        (freedom > 0).then(|| (log_squares(&self.errors) / freedom as f64).sqrt())
    }
}

/// Groups trials that differ only in the design, with one group per spread of the random bodies. Each group contains all trials
/// of bodies that are not random.
pub fn random_groups<'a>(trials: &[&'a Trial]) -> Vec<Group<'a>> {
    let spread = |t: &Trial| t.setting.number(SPREAD).unwrap_or(Design::SPREAD);
    let split = |group: Group<'a>| {
        let random = group.trials.iter().filter(|t| t.starts_random());
        let spreads = distinct_numbers(random.map(|t| spread(t)));
        if spreads.len() < 2 {
            return vec![group];
        }
        let of = |own: f64| {
            let is_of = |t: &&&Trial| !t.starts_random() || spread(t) == own;
            let said = format!("spread = {own}");
            let label = if group.label.is_empty() { said } else { format!("{}, {said}", group.label) };
            Group { label, trials: group.trials.iter().filter(is_of).copied().collect() }
        };
        spreads.into_iter().map(of).collect()
    };
    groups(trials, DESIGN).into_iter().flat_map(split).collect()
}

/// Compares the random bodies of a group with the others, except those that start from a given design. `None` if either is
/// missing.
pub fn random(trials: &[&Trial], set: Set) -> Option<Random> {
    let (random, mut others): (Vec<&Trial>, Vec<&Trial>) = trials.iter().partition(|t| t.starts_random());
    others.retain(|t| !t.starts_from_design());
    let errors_of = |trials: &[&Trial], body| -> Vec<f64> {
        without_repeats(trials, |t| t.error(body, set)).map(|(_, error)| error).collect()
    };
    // geometric mean over ways of training with equal sensors and forces
    let mut sharing: HashMap<_, Vec<&Trial>> = HashMap::new();
    others.iter().for_each(|o| sharing.entry((o.cluster, o.sensors)).or_default().push(o));
    let alike = |trial: &Trial, body: BodyState| {
        let sharing = sharing.get(&(trial.cluster, trial.sensors));
        let same: Vec<f64> = sharing.into_iter().flatten().filter_map(|o| o.error(body, set)).collect();
        (!same.is_empty()).then(|| geometric_mean(&same))
    };
    let ratios = BodyState::ALL.map(|body| {
        let ratio = |t: &Trial| Some(t.error(BodyState::Initial, set)? / alike(t, body)?);
        let (trials, ratios): (Vec<&Trial>, Vec<f64>) = without_repeats(&random, ratio).unzip();
        let ids_by = |unit: fn(&Trial) -> u64| trials.iter().map(|t| unit(t)).collect();
        let units = Resampling::over_units([
            (["body", "bodies"], ids_by(|t| t.setting.count(RANDOM).unwrap_or_default())),
            (PLACEMENTS, ids_by(|t| t.cluster.placement)),
            (SEEDS, ids_by(|t| t.cluster.seed)),
        ]);
        Ratio::over(&units, &ratios)
    });
    let [errors, trained] = BodyState::ALL.map(|body| errors_of(&random, body));
    let others = BodyState::ALL.map(|body| errors_of(&others, body));
    (ratios[0].is_some() && !errors.is_empty()).then_some(Random { errors, others, ratios, trained })
}

#[cfg(test)]
mod tests;
