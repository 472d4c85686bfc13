//! The bodies of trials that differ in training alone: the initial one, and those trained, by how they were.

use std::collections::BTreeMap;

use super::data::{apart, groups};
use super::resample::{Interval, Resampling};
use super::trial::{Body, Cluster, Trial};

/// A body of several trials.
#[derive(Debug, Clone)]
pub struct Trained<'a> {
    /// `initial`, or how it was trained.
    pub name: String,
    /// Which body of its trials.
    pub body: Body,
    /// Of the initial body one a cluster, whatever trains it.
    pub trials: Vec<&'a Trial>,
}

/// A part of a gain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Kept {
    /// 1 is all of it.
    pub part: f64,
    /// 95 %, where there are enough placements or seeds.
    pub interval: Option<Interval>,
}

impl Kept {
    /// Σ of the first gains, logarithms, over Σ of the second, with their clusters; `None` without second gain.
    pub fn of(gains: impl Iterator<Item = (Cluster, [f64; 2])>) -> Option<Self> {
        let (clusters, gains): (Vec<Cluster>, Vec<[f64; 2]>) = gains.unzip();
        let part = |weights: &[f64]| {
            let sum = |which: usize| gains.iter().zip(weights).map(|(g, w)| w * g[which]).sum::<f64>();
            Some(sum(0) / sum(1)).filter(|part| sum(1) > 0.0 && part.is_finite())
        };
        let whole = part(&vec![1.0; gains.len()])?;
        Some(Self { part: whole, interval: Resampling::new(&clusters).interval(part) })
    }
}

/// The initial body, then those trained, by `way` in its order; what else of the training differs within one is told beside
/// its name.
pub fn bodies<'a, K: Ord>(
    trials: &[&'a Trial],
    way: impl Fn(&Trial) -> K,
    name: impl Fn(&K) -> String,
) -> Vec<Trained<'a>> {
    let initial: BTreeMap<Cluster, &Trial> = trials.iter().rev().map(|t| (t.cluster, *t)).collect();
    let trials_of = initial.into_values().collect();
    let mut found = vec![Trained { name: "initial".to_owned(), body: Body::Initial, trials: trials_of }];
    let mut trained: BTreeMap<K, Vec<&Trial>> = BTreeMap::new();
    for trial in trials.iter().filter(|trial| trial.has_steps()) {
        trained.entry(way(trial)).or_default().push(trial);
    }
    for (way, trials) in trained {
        // what a way brings along differs with it: told is what else does
        let mut ways = groups(&trials, &[]);
        ways.sort_by(|a, b| a.label.cmp(&b.label));
        found.extend(ways.into_iter().map(|group| {
            let rest = apart(&group.label).into_iter();
            let rest = rest.map(|part| part.trim_start_matches("optimise.").trim_start_matches("stimuli."));
            let name = std::iter::once(&name(&way)[..]).chain(rest).collect::<Vec<_>>().join(", ");
            Trained { name, body: Body::Optimised, trials: group.trials }
        }));
    }
    found
}
