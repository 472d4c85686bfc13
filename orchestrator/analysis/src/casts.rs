//! Errors over virtual casts, by body and decoder.
//!
//! A trial is summarised by the median and the 90th percentile over its casts; trials by geometric means with intervals over
//! placements and seeds. The kept gain compares a trained body with the initial body of the same trials:
//! ```text
//! kept = Σ ln(initial/trained, over casts) / Σ ln(initial/trained, as designed)
//! ```
//! A mean of the quotients per trial would diverge where a trial gains little.

use super::bodies::{BodyTrials, KeptGain, bodies};
use super::data::{Group, groups};
use super::kinds::{is_linear, objective};
use super::numbers::distinct;
use super::paired::Ratio;
use super::trial::{BodyState, CastDecoder, ReadingOnCasts, Set, Trial};

/// Trials with casts in one setting, by body.
#[derive(Debug, Clone)]
pub struct Setting<'a> {
    /// Differences from other settings.
    pub label: String,
    /// The initial body, then bodies trained as designed, then bodies trained over casts.
    pub bodies: Vec<BodyTrials<'a>>,
}

/// Errors of one decoder on the casts of a body.
#[derive(Debug, Clone, PartialEq)]
pub struct CastErrors {
    /// Number of casts of all trials, and of those that failed in simulation.
    pub casts: [u64; 2],
    /// Error (%) of a decoder of this kind on the body as designed: geometric mean over trials.
    pub designed: Option<Ratio>,
    /// Median and 90th percentile over the casts of a trial (%): geometric means over trials.
    pub errors: [Ratio; 2],
    /// Kept fractions of the gain as designed, at the median and at the 90th percentile. `None` for the initial body, and if
    /// the gain as designed is not positive.
    pub kept: [Option<KeptGain>; 2],
    /// Verdicts on the fraction kept at the median by means and by medians over samples, if they differ.
    pub note: Option<String>,
}

/// Groups the trials with casts; trials of a group differ only in training, placement and seed.
pub fn settings<'a>(trials: &[&'a Trial]) -> Vec<Setting<'a>> {
    let cast: Vec<&Trial> = trials.iter().filter(|t| !t.casts.is_empty()).copied().collect();
    let way = |trial: &Trial| {
        let objective = objective(&trial.setting);
        (objective.is_some(), objective.unwrap_or("nominal".into()))
    };
    let setting = |group: Group<'a>| Setting {
        label: group.label,
        bodies: bodies(&group.trials, way, |(_, objective)| objective.clone()),
    };
    groups(&cast, &["optimise."]).into_iter().map(setting).collect()
}

impl BodyTrials<'_> {
    /// Returns the decoders of its casts.
    pub fn brains(&self) -> Vec<CastDecoder> {
        distinct(self.trials.iter().flat_map(|t| &t.casts).map(|reading| reading.decoder))
    }

    /// Returns the errors of a decoder on the casts; `None` if there are none.
    pub fn errors_of(&self, by: CastDecoder) -> Option<CastErrors> {
        let read: Vec<(&Trial, &ReadingOnCasts)> =
            self.trials.iter().filter_map(|t| Some((*t, reading(t, self.body, by)?))).collect();
        let mean = |of: &dyn Fn(&(&Trial, &ReadingOnCasts)) -> Option<f64>| {
            Ratio::of(read.iter().filter_map(|r| Some((r.0.cluster, of(r)?))))
        };
        let errors = [0, 1].map(|quantile| mean(&|r| Some(r.1.errors[quantile])));
        let kept = [0, 1].map(|quantile| self.kept(by, Set::Holdout, |read| Some(read.errors[quantile])));
        let sum = |of: fn(&ReadingOnCasts) -> u64| read.iter().map(|r| of(r.1)).sum();
        Some(CastErrors {
            casts: [sum(|r| r.casts), sum(|r| r.failed)],
            designed: mean(&|r| designed(r.0, self.body, by, Set::Holdout)),
            note: KeptGain::disagreement(kept[0], self.kept(by, Set::Median, |read| read.median)),
            kept,
            errors: match errors {
                [Some(median), Some(most)] => [median, most],
                _ => return None,
            },
        })
    }

    fn kept(
        &self,
        by: CastDecoder,
        set: Set,
        of: impl Fn(&ReadingOnCasts) -> Option<f64>,
    ) -> Option<KeptGain> {
        if self.body == BodyState::Initial {
            return None;
        }
        // ln(initial/trained) over casts and as designed, per trial
        let gains = |trial: &&Trial| {
            let cast = BodyState::ALL.map(|body| of(reading(trial, body, by)?));
            let gain = |[initial, trained]: [Option<f64>; 2]| Some((initial? / trained?).ln());
            let found = [gain(cast)?, gain(BodyState::ALL.map(|body| designed(trial, body, by, set)))?];
            Some((trial.cluster, found))
        };
        KeptGain::of(self.trials.iter().filter_map(gains))
    }
}

fn reading(trial: &Trial, body: BodyState, by: CastDecoder) -> Option<&ReadingOnCasts> {
    trial.casts.iter().find(|reading| (reading.body, reading.decoder) == (body, by))
}

/// Held-out error (%) of the body as designed: of the trial's own decoder for networks, inverse decoders and linear trials,
/// else of the linear decoder with the longest memory.
fn designed(trial: &Trial, body: BodyState, by: CastDecoder, set: Set) -> Option<f64> {
    let inverts = matches!(by, CastDecoder::Inverse | CastDecoder::Twin(_));
    if by <= CastDecoder::NetworkCasts || inverts || is_linear(trial) {
        return trial.error(body, set);
    }
    trial.longest_reading()?.errors[body as usize][set as usize].filter(|error| *error > 0.0)
}

#[cfg(test)]
mod tests;
