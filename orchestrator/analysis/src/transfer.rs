//! What a body that was trained under one kind of forces is worth under another.
//!
//! The gain that is kept compares it with the specialist, the body that was trained under that kind, over the same clusters:
//! ```text
//! kept = Σ ln(initial/trained) / Σ ln(initial/specialist)
//! ```

use super::bodies::{Kept, Trained, bodies};
use super::data::{Group, groups};
use super::numbers::distinct;
use super::paired::Ratio;
use super::trial::{Body, Trial};

/// Trials of one setting whose bodies are read under several kinds of forces.
#[derive(Debug, Clone)]
pub struct Setting<'a> {
    /// What sets it apart.
    pub label: String,
    /// The initial body, then those trained, by the forces that they were trained under.
    pub bodies: Vec<Trained<'a>>,
    /// The kinds under which they are read.
    pub kinds: Vec<String>,
}

/// How a body is read under a kind of forces.
#[derive(Debug, Clone, PartialEq)]
pub struct Read {
    /// Error (%) of a brain fitted under these forces: geometric mean over trials.
    pub own: Ratio,
    /// Of one fitted under those that trained the body; none of the initial body, which has none of its own.
    pub carried: Option<Ratio>,
    /// The part of the specialist's gain that the body has, by brains fitted under these forces; `None` of the initial body
    /// and without a specialist.
    pub kept: Option<Kept>,
}

/// Trials that differ in forces, training, placement and seed alone.
pub fn settings<'a>(trials: &[&'a Trial]) -> Vec<Setting<'a>> {
    let read: Vec<&Trial> = trials.iter().filter(|t| !t.under.is_empty()).copied().collect();
    let setting = |group: Group<'a>| {
        let kinds = distinct(group.trials.iter().flat_map(|t| &t.under).map(|read| read.stimuli.clone()));
        let bodies = bodies(&group.trials, |trial| kind(trial).to_owned(), String::clone);
        Setting { label: group.label, bodies, kinds }
    };
    groups(&read, &["optimise.", "stimuli."]).into_iter().map(setting).collect()
}

/// The forces that a trial's body was trained under.
fn kind(trial: &Trial) -> &str {
    trial.setting.text("stimuli.kind").unwrap_or("unknown")
}

impl Setting<'_> {
    /// How one of its bodies is read under a kind; `None` if it is not.
    pub fn read(&self, body: &Trained, under: &str) -> Option<Read> {
        let mean = |own: bool| {
            let of = |trial: &&Trial| Some((trial.cluster, error(trial, body.body, under, own)?));
            Ratio::of(&body.trials.iter().filter_map(of).collect::<Vec<_>>())
        };
        Some(Read {
            own: mean(true)?,
            carried: (body.body == Body::Optimised).then(|| mean(false)).flatten(),
            kept: (body.body == Body::Optimised).then(|| self.kept(body, under)).flatten(),
        })
    }

    /// The kind under which a trained body keeps least of the specialist's gain, and how much.
    pub fn worst(&self, body: &Trained) -> Option<(&str, f64)> {
        let all = self.kinds.iter().filter_map(|kind| Some((&kind[..], self.read(body, kind)?.kept?.part)));
        all.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The first body that was trained under a kind.
    fn specialist(&self, under: &str) -> Option<&Trained<'_>> {
        self.bodies.iter().find(|body| body.body == Body::Optimised && kind(body.trials[0]) == under)
    }

    fn kept(&self, body: &Trained, under: &str) -> Option<Kept> {
        let specialist = self.specialist(under)?;
        // of each cluster ln(initial/trained) of the body and of the specialist
        let gain = |trial: &Trial| {
            let [initial, trained] = Body::ALL.map(|body| error(trial, body, under, true));
            Some((initial? / trained?).ln())
        };
        let both = |trial: &&Trial| {
            let other = specialist.trials.iter().find(|other| other.cluster == trial.cluster)?;
            Some((trial.cluster, [gain(trial)?, gain(other)?]))
        };
        Kept::of(body.trials.iter().filter_map(both))
    }
}

fn error(trial: &Trial, body: Body, under: &str, own: bool) -> Option<f64> {
    let found = trial.under.iter().find(|read| (read.body, read.own) == (body, own) && read.stimuli == under);
    found.map(|read| read.error)
}

#[cfg(test)]
mod tests;
