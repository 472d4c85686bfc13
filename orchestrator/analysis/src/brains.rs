//! Error by decoder: against its memory, and for bodies trained with one decoder and evaluated with another.
//!
//! Every trial has errors of its own decoder and of linear decoders with several memories (`v_reading`).

use std::collections::HashMap;

use super::kinds::{brains_by_trial, memory};
use super::numbers::{distinct, geometric_mean, in_order};
use super::paired::{Ratio, disagreement};
use super::trial::{BodyState, Cluster, Set, Trial};

/// Held-out errors of one decoder on bodies with equal training.
#[derive(Debug, Clone, PartialEq)]
pub struct DecoderErrors {
    /// Decoder with which the bodies were trained.
    pub trained_with: String,
    /// Decoder in evaluation.
    pub decoder: String,
    /// Its memory before and after an instant (s).
    pub memory: [f64; 2],
    /// Whether it is the linear decoder with the longest memory of the trial.
    pub whole: bool,
    /// Whether it is the trials' own decoder.
    pub own: bool,
    /// Errors (%) of the initial and the trained body: geometric means over the trials that have both.
    pub errors: [f64; 2],
    /// Error of the initial body divided by that of the trained body.
    pub ratio: Ratio,
    /// Verdicts on the ratio by means and by medians over samples, if they differ.
    pub note: Option<String>,
}

/// Returns the errors by decoder of trials that differ only in decoder, placement and seed: own decoders first, then linear
/// ones.
pub fn errors_by_decoder(trials: &[&Trial]) -> Vec<DecoderErrors> {
    let of_trials = brains_by_trial(trials);
    let kinds = in_order(&of_trials);
    let having = |of: &dyn Fn(&[String; 2]) -> bool| -> Vec<&&Trial> {
        trials.iter().zip(&of_trials).filter(|(_, kind)| of(kind)).map(|(trial, _)| trial).collect()
    };
    let mut found = Vec::new();
    for [by, trained_with] in kinds.iter().copied() {
        let alike = having(&|kind| kind[0] == *by && kind[1] == *trained_with);
        // errors of other tasks are not errors of forces
        let errors = |t: &&&Trial, set: Set| {
            let of_forces = !t.setting.contains_key("brain.task");
            of_forces.then(|| (t.cluster, BodyState::ALL.map(|body| t.error(body, set))))
        };
        let memory = alike.first().map_or([0.0; 2], |t| memory(t));
        found.extend(read(trained_with, by, (memory, false, true), |set| {
            alike.iter().filter_map(|t| errors(t, set)).collect()
        }));
    }
    for trained_with in distinct(kinds.iter().map(|kind| &kind[1])) {
        // trials that differ only in their own decoder share a body and its linear decoders: count them once
        let mut alike: Vec<&&Trial> = Vec::new();
        let mut read_so: HashMap<(Cluster, u64), Vec<&&Trial>> = HashMap::new();
        for trial in having(&|kind| kind[1] == *trained_with) {
            let known = read_so.entry((trial.cluster, trial.sensors)).or_default();
            if !known.iter().any(|t| t.longest_reading() == trial.longest_reading()) {
                known.push(trial);
                alike.push(trial);
            }
        }
        let readings = alike.iter().flat_map(|t| &t.readings);
        let mut memories = in_order(readings.map(|reading| (reading.memory, reading.is_longest)));
        memories.sort_by(|a, b| (b.1, a.0[0], a.0[1]).partial_cmp(&(a.1, b.0[0], b.0[1])).expect("finite"));
        for (memory, whole) in memories {
            let errors = |t: &&&Trial, set: Set| {
                let reading = t.readings.iter().find(|r| r.memory == memory)?;
                Some((t.cluster, reading.errors.map(|body| body[set as usize].filter(|e| *e > 0.0))))
            };
            found.extend(read(trained_with, "linear", (memory, whole, false), |set| {
                alike.iter().filter_map(|t| errors(t, set)).collect()
            }));
        }
    }
    found
}

fn read(
    trained_with: &str,
    by: &str,
    (memory, whole, own): ([f64; 2], bool, bool),
    errors: impl Fn(Set) -> Vec<(Cluster, [Option<f64>; 2])>,
) -> Option<DecoderErrors> {
    let pairs = |set| -> Vec<(Cluster, [f64; 2])> {
        errors(set).into_iter().filter_map(|(cluster, [a, b])| Some((cluster, [a?, b?]))).collect()
    };
    let ratio = |set| Ratio::of(pairs(set).into_iter().map(|(cluster, [a, b])| (cluster, a / b)));
    let note = disagreement(ratio).map(|(_, verdicts)| verdicts);
    let (pairs, ratio) = (pairs(Set::Holdout), ratio(Set::Holdout)?);
    let of = |body: usize| geometric_mean(&pairs.iter().map(|(_, pair)| pair[body]).collect::<Vec<_>>());
    let (trained_with, by) = (trained_with.to_owned(), by.to_owned());
    Some(DecoderErrors { trained_with, decoder: by, memory, whole, own, errors: [of(0), of(1)], ratio, note })
}

#[cfg(test)]
mod tests;
