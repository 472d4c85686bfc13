//! Fresh decoders on a body, with the same initial weights and budget for every body. Training can pause and resume.

use super::evaluation::{BandCoverage, BodyEvaluation, NetworkEvaluation};
use super::inversion::evaluate_inverse;
use super::observe::{Log, LoopControl};
use super::report::Report;
use super::state::State;
use crate::brains::{
    Band, FittedDecoder, TaskEstimate, TaskReadouts, new_decoder, own_reading, readings, task_errors,
    task_estimates, task_readouts,
};
use crate::random::Purpose;
use crate::trial::{
    Counters, DecoderKind, DesignWithSolver, PreparedTrial, Problem, Result, RidgeChoice, Samples,
    as_ref_result, mean_error,
};
use crate::variation::Casts;

/// A decoder that is still to be fitted to a body: number, iterations, whether the training is a long one.
type MissingDecoder = (usize, usize, bool);

impl BodyEvaluation {
    /// The next decoder to fit. A body needs one linear or inverse decoder, without long training.
    fn next_missing_decoder(&self, problem: &Problem) -> Option<MissingDecoder> {
        let linear = !problem.decoder_kind.is_network();
        let seeds = if linear { 1 } else { problem.evaluation.seeds };
        let long = problem.evaluation.long.filter(|_| !linear);
        let (done, done_long) = (self.networks.len(), self.long.len());
        let short = (done < seeds).then_some((done, problem.brain.iterations, false));
        short.or(long.filter(|_| done_long < seeds).map(|iterations| (done_long, iterations, true)))
    }
}

/// Fits all decoders that the comparison still lacks on body number `turn`. `None` if the observer stopped it; the observer then
/// has the state.
pub(super) fn evaluate(
    mould: &DesignWithSolver,
    turn: usize,
    state: &mut State,
    log: &mut Log,
) -> Option<()> {
    let &DesignWithSolver { trial, design, .. } = mould;
    let problem = &trial.problem;
    let begun = state.comparison.bodies.get(turn);
    let is_complete = begun.is_some_and(|body| body.next_missing_decoder(problem).is_none());
    let estimates_tasks = problem.evaluation.tasks && state.comparison.tasks.len() <= turn;
    if is_complete && !estimates_tasks {
        return Some(());
    }
    let (begun, counted, mut recipe) = (begun.is_some(), log.report.counters, problem.recipe());
    let sets = log.timed(|s| &mut s.simulate, |report| sets(mould, &mut report.counters));
    let first = state.comparison.bodies.get(turn).is_none_or(|body| body.networks.is_empty());
    let inverts = problem.decoder_kind == DecoderKind::Inverse;
    let has_bands = !inverts && problem.tasks.trained.is_empty();
    let calibration = sets.as_ref().ok().filter(|_| first && has_bands).and_then(|sets| {
        let of = |report: &mut Report| band_calibration_samples(mould, &sets[2], &mut report.counters);
        log.timed(|s| &mut s.simulate, of).ok()
    });
    if begun {
        log.report.counters = counted;
    } else {
        let mut body = BodyEvaluation { design: design.to_vec(), ..BodyEvaluation::default() };
        if let Ok(sets) = &sets {
            body.zero_samples = sets.each_ref().map(Samples::without_force);
            log.timed(
                |s| &mut s.train,
                |_| {
                    body.readings = readings(trial, sets).unwrap_or_default();
                    if matches!(problem.decoder_kind, DecoderKind::Linear | DecoderKind::Stacked)
                        && let Ok(own) = own_reading(trial, sets, &mut body.readings)
                    {
                        recipe.decoder.ridge = RidgeChoice::Given(own.ridge);
                    }
                },
            );
        }
        state.comparison.bodies.push(body);
    }
    if estimates_tasks {
        let of = |_: &mut Report| as_ref_result(&sets).and_then(|sets| estimates(mould, sets));
        let found = log.timed(|s| &mut s.train, of);
        state.comparison.tasks.push(found.unwrap_or_default());
    }
    if is_complete {
        return Some(());
    }
    if inverts {
        return evaluate_inverse(mould, &sets, state, log);
    }
    if !problem.tasks.trained.is_empty() {
        let found = log.timed(|s| &mut s.train, |_| task_errors(trial, as_ref_result(&sets)?));
        let evaluation = found.map_or_else(NetworkEvaluation::failed, |[train, test, holdout]| {
            NetworkEvaluation::of(mean_error(&train), &test, &holdout)
        });
        state.comparison.bodies[turn].networks.push(evaluation);
        return log.report_progress(problem, state);
    }
    let mut reader = match &sets {
        Ok(sets) => {
            let scales = trial.scales_of(&sets[0].signals);
            log.timed(|s| &mut s.train, |_| new_decoder(recipe, &sets[0], scales, trial.pool))
        }
        Err(trouble) => Err(*trouble),
    };

    while let Some(lacking) = state.comparison.bodies[turn].next_missing_decoder(problem) {
        let found = match (&sets, &mut reader) {
            (Ok(sets), Ok(reader)) => {
                fit_and_evaluate(trial, &mut **reader, sets, calibration.as_ref(), lacking, state, log)?
            }
            (Err(trouble), _) => NetworkEvaluation::failed(*trouble),
            (_, Err(trouble)) => NetworkEvaluation::failed(*trouble),
        };
        let body = &mut state.comparison.bodies[turn];
        if lacking.2 { &mut body.long } else { &mut body.networks }.push(found);
        log.report_progress(problem, state)?;
    }
    Some(())
}

/// Estimates of all tasks on a body with these training, test and held-out samples, and on its casts.
fn estimates(mould: &DesignWithSolver, sets: &[Samples; 3]) -> Result<Vec<TaskEstimate>> {
    let (trial, problem) = (mould.trial, &mould.trial.problem);
    let holdout = |number: usize| {
        let cast = trial.cast(Casts::Unseen, number as u64);
        mould.samples(cast.as_ref(), problem.holdout(), &mut Counters::default())
    };
    task_estimates(trial, sets, (0..problem.evaluation.casts).map(holdout))
}

/// Estimates of all tasks on a design, as in the trial's comparison.
///
/// # Errors
/// If the design cannot be simulated, or gives too few samples with force.
pub fn estimate_tasks(trial: &PreparedTrial, design: &[f64]) -> Result<Vec<TaskEstimate>> {
    let solver = &trial.tuned(design).solver;
    let mould = DesignWithSolver { trial, design, solver };
    estimates(&mould, &sets(&mould, &mut Counters::default())?)
}

/// Readouts of the trial's tasks on a design, for a device.
///
/// # Errors
/// As [`estimate_tasks`].
pub fn fit_readouts(trial: &PreparedTrial, design: &[f64]) -> Result<TaskReadouts> {
    let solver = &trial.tuned(design).solver;
    let sets = sets(&DesignWithSolver { trial, design, solver }, &mut Counters::default())?;
    task_readouts(trial, &sets)
}

/// Training, test and held-out samples of a body.
fn sets(mould: &DesignWithSolver, counters: &mut Counters) -> Result<[Samples; 3]> {
    let problem = &mould.trial.problem;
    let mut of = |forces| mould.samples(None, forces, counters);
    // all training samples, including those on which the initial body failed
    let [train, test] = problem.training_and_test();
    let train = if mould.design == problem.initial { mould.trial.initial.clone() } else { of(train)? };
    Ok([train, of(test)?, of(problem.holdout())?])
}

/// Number of the first fresh sample that calibrates bands, above those of outer steps and casts. The 95th smallest of 99 scores
/// bounds a new score with probability 95 %.
const CALIBRATION_FIRST: u64 = 1 << 41;
const CALIBRATION_SAMPLES: usize = 99;

/// Samples that calibrate bands: fresh ones, to which neither body nor decoder was fitted. Records have no fresh samples; half of
/// their shuffled held-out set serves instead.
fn band_calibration_samples(
    mould: &DesignWithSolver,
    holdout: &Samples,
    counters: &mut Counters,
) -> Result<Samples> {
    let problem = &mould.trial.problem;
    match problem.first_band_sample(holdout.count()) {
        0 => {
            let forces = problem.forces(Purpose::Fresh, CALIBRATION_FIRST, CALIBRATION_SAMPLES);
            mould.samples(None, forces, counters)
        }
        first => Ok(holdout.select(&(0..first).collect::<Vec<_>>())),
    }
}

/// Fits the given decoder, or resumes the one in training; `None` if the observer stopped it. With `calibration`, the first decoder
/// of the last body gets prediction bands.
pub(super) fn fit_and_evaluate(
    trial: &PreparedTrial,
    reader: &mut dyn FittedDecoder,
    sets: &[Samples; 3],
    calibration: Option<&Samples>,
    (number, iterations, is_long): MissingDecoder,
    state: &mut State,
    log: &mut Log,
) -> Option<NetworkEvaluation> {
    let outcome = loop {
        if let Some(training) = reader.training() {
            *training = state.comparison.training.take();
        }
        let (start_seconds, mut control) = (log.observer.seconds(), LoopControl::Continue);
        let mut pauses = |iterations: usize| {
            control = log.observer.progress(state.comparison.completed_fraction(iterations, &trial.problem));
            control == LoopControl::Stop || log.save_is_due()
        };
        let outcome = reader.fit(number as u64, iterations, &sets[2], &mut pauses);
        log.report.seconds.train += log.observer.seconds() - start_seconds;
        if let Some(outcome) = outcome {
            break outcome;
        }
        state.comparison.training = reader.training().and_then(Option::take);
        log.save(state);
        if control == LoopControl::Stop {
            return None;
        }
    };
    if let (Err(trouble), None) = (outcome, reader.training()) {
        return Some(NetworkEvaluation::failed(trouble));
    }
    let error_train = reader.error_known();
    let [test, holdout] = [1, 2].map(|set| reader.errors(&sets[set]));
    let evaluation = NetworkEvaluation::of(error_train, &test, &holdout);
    let stores_weights = number == 0 && !is_long;
    let weights = if stores_weights { reader.weights_at(&trial.network_scales) } else { Vec::new() };
    if stores_weights && let Some(calibration) = calibration {
        let (known, said) = (reader.predict_known(), reader.predict(&calibration.signals));
        let bands = Band::conformal((&sets[0], &known), (calibration, &said));
        let (said, first) =
            (reader.predict(&sets[2].signals), trial.problem.first_band_sample(sets[2].count()));
        let reading = |band: Band| BandCoverage {
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
    Some(NetworkEvaluation { losses, errors, weights, trouble, ..evaluation })
}
