//! The bodies of trials that differ only in training: the initial body, and the trained ones by their training.

use std::collections::BTreeMap;

use super::data::{apart, groups};
use super::paired::differing;
use super::resample::{Interval, Resampling};
use super::trial::{BodyState, Cluster, Trial};

/// One kind of body in several trials.
#[derive(Debug, Clone)]
pub struct BodyTrials<'a> {
    /// `initial`, or the training.
    pub name: String,
    /// Which body of each trial.
    pub body: BodyState,
    /// The trials; for the initial body, one per cluster.
    pub trials: Vec<&'a Trial>,
}

/// The fraction of a reference gain that is kept.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KeptGain {
    /// 1: the whole gain.
    pub part: f64,
    /// The 95 % interval; `None` with too few placements and seeds.
    pub interval: Option<Interval>,
}

impl KeptGain {
    /// Returns the sum of the first gains divided by the sum of the second ones. `gains`: cluster and two gains (logarithms)
    /// per trial. `None` if the second sum is not positive.
    pub fn of(gains: impl Iterator<Item = (Cluster, [f64; 2])>) -> Option<Self> {
        let (clusters, gains): (Vec<Cluster>, Vec<[f64; 2]>) = gains.unzip();
        let part = |weights: &[f64]| {
            let sum = |which: usize| gains.iter().zip(weights).map(|(g, w)| w * g[which]).sum::<f64>();
            Some(sum(0) / sum(1)).filter(|part| sum(1) > 0.0 && part.is_finite())
        };
        let whole = part(&vec![1.0; gains.len()])?;
        Some(Self { part: whole, interval: Resampling::new(&clusters).interval(part) })
    }

    /// Returns the verdicts by means and by medians over held-out samples, if they differ.
    pub fn disagreement(means: Option<Self>, medians: Option<Self>) -> Option<String> {
        let verdict = |kept: Self| match kept.interval {
            Some(interval) if interval.low > 0.0 => "kept",
            Some(interval) if interval.high < 0.0 => "lost",
            _ => "undecided",
        };
        differing([verdict(means?), verdict(medians?)])
    }
}

/// Returns the initial body, then the trained ones, sorted by `way`. Other differences in training are appended to the name.
pub fn bodies<'a, K: Ord>(
    trials: &[&'a Trial],
    way: impl Fn(&Trial) -> K,
    name: impl Fn(&K) -> String,
) -> Vec<BodyTrials<'a>> {
    let initial: BTreeMap<Cluster, &Trial> = trials.iter().rev().map(|t| (t.cluster, *t)).collect();
    let trials_of = initial.into_values().collect();
    let mut found =
        vec![BodyTrials { name: "initial".to_owned(), body: BodyState::Initial, trials: trials_of }];
    let mut trained: BTreeMap<K, Vec<&Trial>> = BTreeMap::new();
    for trial in trials.iter().filter(|trial| trial.has_steps()) {
        trained.entry(way(trial)).or_default().push(trial);
    }
    for (way, trials) in trained {
        // settings that follow from `way` do not differ within its trials, so the labels contain only the others
        let mut ways = groups(&trials, &[]);
        ways.sort_by(|a, b| a.label.cmp(&b.label));
        found.extend(ways.into_iter().map(|group| {
            let rest = apart(&group.label).into_iter();
            let rest = rest.map(|part| part.trim_start_matches("optimise.").trim_start_matches("stimuli."));
            let name = std::iter::once(&name(&way)[..]).chain(rest).collect::<Vec<_>>().join(", ");
            BodyTrials { name, body: BodyState::Optimised, trials: group.trials }
        }));
    }
    found
}
