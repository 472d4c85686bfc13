//! A fresh brain on a body: fitted, or gone on with, and kept on the way.

use super::evaluation::{BandReading, NetworkEvaluation};
use super::observe::{Control, Log};
use super::state::State;
use crate::brains::{Band, Reader};
use crate::trial::{Samples, Trial};

/// A brain that is still to be fitted to a body: number, iterations, and whether they are those of a long training.
pub(super) type Lacking = (usize, usize, bool);

/// Tells the observer how far the comparison has come; `None` if it says stop: it has the state by then.
pub(super) fn paused(trial: &Trial, state: &mut State, log: &mut Log) -> Option<()> {
    let wanted = log.progress(state.comparison.part(0, &trial.problem));
    if wanted == Control::Stop || log.save_is_due() {
        save(state, log);
    }
    (wanted != Control::Stop).then_some(())
}

/// The samples of a holdout from this one on judge bands.
pub(super) fn first_judge(trial: &Trial, holdout: &Samples) -> usize {
    if trial.problem.stimuli.source.is_recorded() { holdout.count().div_ceil(2) } else { 0 }
}

/// Hands the observer the state, with what the report says of the comparison.
pub(super) fn save(state: &mut State, log: &mut Log) {
    (state.comparison.counters, state.comparison.seconds) = (log.report.counters, log.report.seconds);
    log.save(state);
}

/// Fits the brain that is lacking, or goes on with the one in training; `None` if the observer said stop. With samples that
/// calibrate them the first brain of the last body has bands.
pub(super) fn read(
    trial: &Trial,
    reader: &mut dyn Reader,
    sets: &[Samples; 3],
    calibration: Option<&Samples>,
    (number, iterations, is_long): Lacking,
    state: &mut State,
    log: &mut Log,
) -> Option<NetworkEvaluation> {
    let outcome = loop {
        if let Some(training) = reader.training() {
            *training = state.comparison.training.take();
        }
        let (begun, mut wanted) = (log.seconds(), Control::Continue);
        let mut pauses = |iterations: usize| {
            wanted = log.progress(state.comparison.part(iterations, &trial.problem));
            wanted == Control::Stop || log.save_is_due()
        };
        let outcome = reader.fit(number as u64, iterations, &sets[2], &mut pauses);
        log.report.seconds.train += log.seconds() - begun;
        if let Some(outcome) = outcome {
            break outcome;
        }
        state.comparison.training = reader.training().and_then(Option::take);
        save(state, log);
        if wanted == Control::Stop {
            return None;
        }
    };
    if let (Err(trouble), None) = (outcome, reader.training()) {
        return Some(NetworkEvaluation::nothing(trouble));
    }
    let [error_train, error_test, error_holdout] =
        [reader.error_known(), reader.error(&sets[1]), reader.error(&sets[2])];
    let keeps = number == 0 && !is_long;
    let weights = if keeps { reader.weights_at(&trial.scales) } else { Vec::new() };
    if keeps && let Some(calibration) = calibration {
        let (known, said) = (reader.predict_known(), reader.predict(&calibration.signals));
        let bands = Band::conformal((&sets[0], &known), (calibration, &said));
        let (said, first) = (reader.predict(&sets[2].signals), first_judge(trial, &sets[2]));
        let reading = |band: Band| BandReading {
            cast: None,
            width: band.width(),
            coverage: band.coverage(&sets[2], &said, first),
            band,
        };
        state.comparison.bands.resize_with(state.comparison.bodies.len() - 1, Vec::new);
        state.comparison.bands.push(bands.map(reading).into());
    }
    let losses = reader.losses();
    let errors = reader.training().and_then(Option::take).map(|fresh| fresh.errors).unwrap_or_default();
    log.report.counters.brain_iterations += losses.len() as u64;
    let trouble = outcome.err();
    Some(NetworkEvaluation { error_train, error_test, error_holdout, losses, errors, weights, trouble })
}
