//! How far the decoder is trained on a body, and which loss moves the body.
//!
//! ```text
//! paper     fresh β*(A_train)         dL_test/dα, direct and through β*
//! joint     β continues, fresh f      dL_train/dα at fixed β, on samples drawn for this step; with a linear
//!                                     decoder that of its cross-validated error, through β
//! random                              no gradient: the test error of a candidate
//! ```
//! `joint` never uses a sample of a step again, which prevents over-fitting.

use std::cell::RefCell;

use super::observe::Log;
use super::state::{PastDesign, State};
use crate::brain::TrainOutcome;
use crate::brains::{FitOn, Learner, Loss, learner};
use crate::dynamics::Forces;
use crate::random::Purpose;
use crate::trial::{
    CastObjective, Counters, DecoderKind, FAILED, ObjectiveDomain, PreparedTrial, Response, Result, Samples,
    Terms, TrainingProtocol, Trouble,
};
use crate::variation::{Cast, Casts};

/// Number of casts that share the test set in an evaluation.
const TEST_CASTS: usize = 8;

/// Result of training and differentiating on the state's design.
pub(super) struct StepResult {
    /// dL/dα; empty in searches and in steps that do not move the body.
    pub(super) gradient: Vec<f64>,
    /// Training loss after training (normalised).
    pub(super) loss_train: f64,
    /// Prediction error on the test set (%), in steps that evaluate it.
    pub(super) error_test: Option<f64>,
}

/// The protocol of a trial, with data that a resumed loop computes again.
pub(super) struct Session<'a> {
    trial: &'a PreparedTrial<'a>,
    learner: Box<dyn Learner + 'a>,
    /// Outer step and fresh samples of the recent bodies, newest last.
    recent: Vec<(u32, Samples)>,
    /// Error (%) and differentiated loss of each part of a mixture at the first step; empty until needed.
    first: [Vec<f64>; 2],
}

impl<'a> Session<'a> {
    pub(super) fn new(trial: &'a PreparedTrial<'a>) -> Self {
        Self { trial, learner: learner(trial), recent: Vec::new(), first: [Vec::new(), Vec::new()] }
    }

    /// Greatest number of bodies that the decoder is trained on at once.
    pub(super) fn bodies(&self) -> usize {
        self.learner.bodies()
    }

    /// Simulates the state's design, trains the decoder on it, and differentiates the loss.
    pub(super) fn train_and_differentiate(&mut self, state: &mut State, log: &mut Log) -> Result<StepResult> {
        match self.trial.problem.optimise.protocol {
            TrainingProtocol::Paper(terms) => self.paper(state, terms, log),
            TrainingProtocol::Joint(going) => self.joint(state, going.batch, log),
            TrainingProtocol::Random(_) => self.candidate(state, log),
        }
    }

    fn paper(&mut self, state: &mut State, terms: Terms, log: &mut Log) -> Result<StepResult> {
        let moves = self.moves(state.step);
        let through_brain = terms == Terms::Implicit && moves;
        // A(α), with a tape only where a gradient is needed
        let [train, test] = self.simulate(state, [through_brain, moves], log)?;

        // β*(A)
        let loss_train = self.fit(FitOn::Optimum(&train.samples), state, log)?;

        // dL_test/dα, directly
        let (loss_test, cotangent) =
            log.timed(|s| &mut s.differentiate, |_| self.learner.loss_vjp(&test.samples, Loss::Test));
        log.report.loss_test = loss_test;
        let mut gradient = self.vjp(&test, cotangent, log)?;

        // and through β*
        if through_brain {
            let (cotangent, solved) = log.timed(
                |s| &mut s.implicit,
                |report| self.learner.implicit(&train.samples, &test.samples, &mut report.counters),
            );
            log.report.implicit = solved;
            let implicit = self.vjp(&train, cotangent, log)?;
            gradient.iter_mut().zip(implicit).for_each(|(g, i)| *g += i);
        }
        let error_test = self.test_error(&test.samples, log);
        Ok(StepResult { gradient, loss_train, error_test })
    }

    /// Trains on fresh samples of this and recent bodies; differentiates the loss on this body's samples.
    /// `batch`: number of samples per cast.
    fn joint(&mut self, state: &mut State, batch: usize, log: &mut Log) -> Result<StepResult> {
        let (learner, step) = (&self.learner, state.step);
        let past: Vec<&PastDesign> =
            state.recent_designs.iter().filter(|passed| learner.includes_age(step - passed.step)).collect();
        self.recent.retain(|(known, _)| past.iter().any(|passed| passed.step == *known));
        let counted = log.report.counters;
        for passed in past {
            if self.recent.iter().all(|(known, _)| *known != passed.step) {
                let casts = self.simulate_fresh(&passed.design, passed.step, batch, false, log)?;
                self.recent.push((passed.step, joined(&casts)));
            }
        }
        // a resumed loop simulates them again: work counts once
        log.report.counters = counted;
        self.recent.sort_by_key(|(known, _)| *known);
        let newest = self.simulate_fresh(&state.design, step, batch, self.moves(step), log)?;
        self.recent.push((step, joined(&newest)));

        let recent = std::mem::take(&mut self.recent);
        let bodies: Vec<&Samples> = recent.iter().map(|(_, samples)| samples).collect();
        let fitted = self.fit(FitOn::Recent(&bodies, newest.len()), state, log);
        self.recent = recent;
        let loss_train = fitted?;
        let gradient = if self.moves(step) { self.gradient(&newest, batch, log)? } else { Vec::new() };
        let error_test = self.evaluate_test_set(state, batch, log)?;
        Ok(StepResult { gradient, loss_train, error_test })
    }

    /// Gradient of the objective over the casts of a body, to which the decoder has just been fitted.
    fn gradient(&mut self, newest: &[Response], batch: usize, log: &mut Log) -> Result<Vec<f64>> {
        let casting = self.trial.problem.optimise.casting;
        let first = match casting {
            Some(casting) => self.initial_losses(casting, batch, log)?[1].clone(),
            None => Vec::new(),
        };
        let weigh = |losses: &[Option<f64>]| match casting {
            Some(casting) => {
                // a cast without a loss counts as the worst
                let losses: Vec<f64> = losses.iter().map(|loss| loss.unwrap_or(f64::INFINITY)).collect();
                casting.objective(&losses, &first).1
            }
            None => vec![1.0],
        };
        let casts: Vec<&Samples> = newest.iter().map(|cast| &cast.samples).collect();
        let cotangents = log.timed(|s| &mut s.differentiate, |_| self.learner.casts_vjp(&casts, &weigh));
        sum(&self.vjps(newest, &cotangents, log)?)
    }

    /// Error (%) and differentiated loss of each part of a mixture on the initial body, with one decoder fitted to the first step's
    /// samples; reproducible after a resumption. 1 for a mean of logarithms, whose derivative does not depend on them.
    fn initial_losses(
        &mut self,
        casting: CastObjective,
        batch: usize,
        log: &mut Log,
    ) -> Result<&[Vec<f64>; 2]> {
        if casting.over == ObjectiveDomain::Parts && self.first[0].is_empty() {
            self.first = [(); 2].map(|()| vec![1.0; casting.casts]);
            if casting.tail < 1.0 {
                let (trial, counted) = (self.trial, (log.report.counters, log.report.fresh_samples));
                let mut learner = learner(trial);
                let parts = self.simulate_fresh(&trial.problem.initial, 0, batch, false, log)?;
                let samples: Vec<&Samples> = parts.iter().map(|part| &part.samples).collect();
                let mut learnt = State::new(&trial.problem).decoder_state;
                let on = FitOn::Recent(&[&joined(&parts)], parts.len());
                learner.fit(on, 0, &mut learnt, &mut log.report.counters)?;
                let losses = RefCell::new(Vec::new());
                learner.casts_vjp(&samples, &|found| {
                    losses.replace(found.to_vec());
                    vec![0.0; found.len()]
                });
                for (number, (part, loss)) in samples.iter().zip(losses.into_inner()).enumerate() {
                    // a linear decoder's loss is its cross-validated error
                    let linear = loss.filter(|_| trial.problem.optimise.brain == DecoderKind::Linear);
                    let error = linear.or_else(|| learner.error(part)).unwrap_or(1.0);
                    (self.first[0][number], self.first[1][number]) = (error, loss.unwrap_or(error));
                }
                (log.report.counters, log.report.fresh_samples) = counted;
            }
        }
        Ok(&self.first)
    }

    /// Evaluates a search's candidate: its test error with a decoder trained on its training set alone. A continued decoder would
    /// favour later candidates.
    fn candidate(&mut self, state: &mut State, log: &mut Log) -> Result<StepResult> {
        let [train, test] = self.simulate(state, [false; 2], log)?;
        let loss_train = self.learn(FitOn::Alike(&train.samples), state, log)?;
        let error_test = self.test_error(&test.samples, log);
        match loss_train.is_finite() {
            true => Ok(StepResult { gradient: Vec::new(), loss_train, error_test }),
            false => Err(Trouble::Training(TrainOutcome::NonFinite)),
        }
    }

    /// Simulates the state's design under the forces of the training and the test set; `tapes`: whether gradients follow.
    fn simulate(&self, state: &State, tapes: [bool; 2], log: &mut Log) -> Result<[Response; 2]> {
        let (trial, design, solver) = (self.trial, &state.design, &self.trial.problem.solver);
        log.timed(
            |s| &mut s.simulate,
            |report| {
                let counters = &mut report.counters;
                let mut train = trial.simulate(design, &trial.train, solver, tapes[0], counters)?;
                let test =
                    trial.simulate_cast(None, design, trial.test.clone(), solver, tapes[1], counters)?;
                // samples on which the initial body failed train no body, and count as failed for every body
                train.samples.failed.clone_from(&trial.initial.failed);
                Ok([train, test])
            },
        )
    }

    /// Trains the decoder; checks its training loss (normalised) against the trend.
    fn fit(&mut self, on: FitOn, state: &mut State, log: &mut Log) -> Result<f64> {
        let loss = self.learn(on, state, log)?;
        state.check_trend(loss)?;
        Ok(loss)
    }

    fn learn(&mut self, on: FitOn, state: &mut State, log: &mut Log) -> Result<f64> {
        let State { step, decoder_state: learnt, trend, .. } = state;
        let ridge = learnt.ridge;
        let learned =
            log.timed(|s| &mut s.train, |report| self.learner.fit(on, *step, learnt, &mut report.counters))?;
        (log.report.loss_train, log.report.error_train) = (Some(learned.loss), learned.error);
        log.report.ridge = learned.ridge;
        // losses at different λ are not comparable
        if learned.ridge != ridge {
            *trend = None;
        }
        Ok(learned.loss)
    }

    /// dL/dα from the cotangent on a body's signals; empty if the step does not move the body.
    fn vjp(&self, response: &Response, cotangent: Vec<f64>, log: &mut Log) -> Result<Vec<f64>> {
        if !self.moves(log.report.step) {
            return Ok(Vec::new());
        }
        Ok(self.vjps(std::slice::from_ref(response), &[cotangent], log)?.remove(0))
    }

    fn moves(&self, step: u32) -> bool {
        self.trial.problem.optimise.moves_body(step)
    }

    /// dL/dα of each cast from the cotangents on its signals, in parallel.
    fn vjps(&self, casts: &[Response], cotangents: &[Vec<f64>], log: &mut Log) -> Result<Vec<Vec<f64>>> {
        let one =
            |at: usize, counters: &mut Counters| self.trial.vjp(&casts[at], cotangents[at].clone(), counters);
        log.timed(
            |s| &mut s.differentiate,
            |report| self.trial.map_parallel(casts.len(), &mut report.counters, one).into_iter().collect(),
        )
    }

    fn test_error(&mut self, test: &Samples, log: &mut Log) -> Option<f64> {
        log.report.error_test = self.learner.error(test);
        log.report.error_test
    }

    /// Test error of the state's design with the accurate integrator, in steps that evaluate it. Training over casts: the objective
    /// over constant casts, among which the test set is divided.
    fn evaluate_test_set(&mut self, state: &State, batch: usize, log: &mut Log) -> Result<Option<f64>> {
        let (trial, problem) = (self.trial, &self.trial.problem);
        if !problem.optimise.looks_at_test(state.step) {
            return Ok(None);
        }
        let simulate_set = |cast: Option<&Cast>, forces: Forces, counters: &mut Counters| {
            let (design, solver) = (&state.design, &problem.solver);
            trial.simulate_cast(cast, design, forces, solver, false, counters).map(|found| found.samples)
        };
        let Some(casting) = problem.optimise.casting else {
            let test = log.timed(
                |s| &mut s.simulate,
                |report| simulate_set(None, trial.test.clone(), &mut report.counters),
            )?;
            return Ok(self.test_error(&test, log));
        };
        let parts = (casting.over == ObjectiveDomain::Parts).then(|| problem.parts());
        let casts = if parts.is_some() { casting.casts } else { TEST_CASTS.min(trial.test.samples) };
        // the samples of one part of a mixture, or every `casts`-th sample
        let dealt = |number: usize| {
            let is_own = |i: &usize| match &parts {
                Some([_, parts, _]) => parts[*i] == number,
                None => i % casts == number,
            };
            trial.test.select(&(0..trial.test.samples).filter(is_own).collect::<Vec<_>>())
        };
        let one = |number: usize, counters: &mut Counters| {
            simulate_set(trial.cast(Casts::Look, number as u64).as_ref(), dealt(number), counters)
        };
        let all =
            log.timed(|s| &mut s.simulate, |report| trial.map_parallel(casts, &mut report.counters, one));
        // a failed cast has an error of 100 %
        let error = |test: Result<Samples>| test.map_or(Some(FAILED), |test| self.learner.error(&test));
        let errors: Vec<f64> = all.into_iter().filter_map(error).collect();
        if errors.is_empty() || parts.is_some() && errors.len() < casts {
            return Ok(None);
        }
        let [first, _] = self.initial_losses(casting, batch, log)?;
        log.report.error_test = Some(casting.objective(&errors, first).0);
        Ok(log.report.error_test)
    }

    /// Simulates a body under the samples of one step of `joint`; each cast has its own samples. Counts the samples of the report's
    /// step.
    fn simulate_fresh(
        &self,
        design: &[f64],
        step: u32,
        batch: usize,
        keep_tape: bool,
        log: &mut Log,
    ) -> Result<Vec<Response>> {
        let (trial, casting) = (self.trial, self.trial.problem.optimise.casting);
        let solver = trial.problem.optimise.coarse.unwrap_or(trial.problem.solver);
        let casts = casting.map_or(1, |casting| casting.casts);
        let over_parts = casting.is_some_and(|casting| casting.over == ObjectiveDomain::Parts);
        let one = |cast: usize, counters: &mut Counters| {
            let number = u64::from(step) * casts as u64 + cast as u64;
            let forces = match over_parts {
                true => trial.problem.part(cast, Purpose::Fresh, u64::from(step) * batch as u64, batch),
                false => trial.problem.forces(Purpose::Fresh, number * batch as u64, batch),
            };
            let cast = casting.and_then(|_| trial.cast(Casts::Step, number));
            trial.simulate_cast(cast.as_ref(), design, forces, &solver, keep_tape, counters)
        };
        let responses: Result<Vec<Response>> = log.timed(
            |s| &mut s.simulate,
            |report| trial.map_parallel(casts, &mut report.counters, one).into_iter().collect(),
        );
        let responses = responses?;
        if step == log.report.step {
            let heard = |cast: &Response| batch as u64 - cast.samples.failures();
            log.report.fresh_samples += responses.iter().map(heard).sum::<u64>();
        }
        Ok(responses)
    }
}

/// The sum of gradients.
///
/// # Errors
/// If it is not finite: samples without force have no error.
fn sum(gradients: &[Vec<f64>]) -> Result<Vec<f64>> {
    let mut sum = vec![0.0; gradients[0].len()];
    for gradient in gradients {
        sum.iter_mut().zip(gradient).for_each(|(sum, g)| *sum += g);
    }
    if sum.iter().all(|g| g.is_finite()) { Ok(sum) } else { Err(Trouble::GradientNonFinite) }
}

/// The samples of all casts, joined.
fn joined(casts: &[Response]) -> Samples {
    Samples::joined(&casts.iter().map(|cast| &cast.samples).collect::<Vec<_>>())
}
