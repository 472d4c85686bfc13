//! Errors of bodies trained under one kind of forces and evaluated under another.
//!
//! The kept gain compares a body with the specialist, which was trained under the kind in evaluation, over the same clusters:
//! ```text
//! kept = Σ ln(initial/trained) / Σ ln(initial/specialist)
//! ```

use super::bodies::{BodyTrials, KeptGain, bodies};
use super::data::{Group, groups};
use super::numbers::distinct;
use super::paired::Ratio;
use super::trial::{BodyState, Trial, UnderErrors};

/// Trials of one setting with evaluations under several kinds of forces.
#[derive(Debug, Clone)]
pub struct Setting<'a> {
    /// Differences from other settings.
    pub label: String,
    /// The initial body, then the trained ones by forces in training.
    pub bodies: Vec<BodyTrials<'a>>,
    /// Kinds of forces in evaluation.
    pub kinds: Vec<String>,
}

/// Errors of a body under one kind of forces.
#[derive(Debug, Clone, PartialEq)]
pub struct TransferErrors {
    /// Error (%) of a decoder fitted under these forces: geometric mean over trials.
    pub own: Ratio,
    /// Error (%) of a decoder fitted under the forces of the body's training; `None` for the initial body.
    pub carried: Option<Ratio>,
    /// Kept fraction of the specialist's gain, with decoders fitted under these forces; `None` for the initial body and without
    /// a specialist.
    pub kept: Option<KeptGain>,
    /// Verdicts on the kept fraction by means and by medians over samples, if they differ.
    pub note: Option<String>,
}

/// Groups trials that differ only in forces, training, placement and seed.
pub fn settings<'a>(trials: &[&'a Trial]) -> Vec<Setting<'a>> {
    let evaluated_trials: Vec<&Trial> = trials.iter().filter(|t| !t.under.is_empty()).copied().collect();
    let setting = |group: Group<'a>| {
        let kinds = distinct(group.trials.iter().flat_map(|t| &t.under).map(|read| read.stimuli.clone()));
        let bodies = bodies(&group.trials, |trial| kind(trial).to_owned(), String::clone);
        Setting { label: group.label, bodies, kinds }
    };
    groups(&evaluated_trials, &["optimise.", "stimuli."]).into_iter().map(setting).collect()
}

/// Returns the kind of forces in the training of the body.
fn kind(trial: &Trial) -> &str {
    trial.setting.text("stimuli.kind").unwrap_or("unknown")
}

impl Setting<'_> {
    /// Returns the errors of a body under one kind of forces; `None` if there are none.
    pub fn read(&self, body: &BodyTrials, under: &str) -> Option<TransferErrors> {
        let mean = |own: bool| {
            let of = |trial: &&Trial| Some((trial.cluster, reading(trial, body.body, under, own)?.error));
            Ratio::of(body.trials.iter().filter_map(of))
        };
        let trained = body.body == BodyState::Optimised;
        let kept =
            |of: fn(&UnderErrors) -> Option<f64>| trained.then(|| self.kept(body, under, of)).flatten();
        let [means, medians] = [kept(|read| Some(read.error)), kept(|read| read.median)];
        let carried = trained.then(|| mean(false)).flatten();
        let note = KeptGain::disagreement(means, medians);
        Some(TransferErrors { own: mean(true)?, carried, kept: means, note })
    }

    /// Returns the kind of forces with the smallest kept fraction, and this fraction.
    pub fn worst(&self, body: &BodyTrials) -> Option<(&str, f64)> {
        let all = self.kinds.iter().filter_map(|kind| Some((&kind[..], self.read(body, kind)?.kept?.part)));
        all.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Returns the first body that was trained under a kind of forces.
    fn specialist(&self, under: &str) -> Option<&BodyTrials<'_>> {
        self.bodies.iter().find(|body| body.body == BodyState::Optimised && kind(body.trials[0]) == under)
    }

    fn kept(
        &self,
        body: &BodyTrials,
        under: &str,
        of: impl Fn(&UnderErrors) -> Option<f64>,
    ) -> Option<KeptGain> {
        let specialist = self.specialist(under)?;
        // ln(initial/trained) of the body and of the specialist, per cluster
        let gain = |trial: &Trial| {
            let [initial, trained] = BodyState::ALL.map(|body| of(reading(trial, body, under, true)?));
            Some((initial? / trained?).ln())
        };
        let both = |trial: &&Trial| {
            let other = specialist.trials.iter().find(|other| other.cluster == trial.cluster)?;
            Some((trial.cluster, [gain(trial)?, gain(other)?]))
        };
        KeptGain::of(body.trials.iter().filter_map(both))
    }
}

fn reading<'a>(trial: &'a Trial, body: BodyState, under: &str, own: bool) -> Option<&'a UnderErrors> {
    trial.under.iter().find(|read| (read.body, read.own) == (body, own) && read.stimuli == under)
}

#[cfg(test)]
mod tests;
