//! The protocols with a linear brain: its inner problem is solved exactly, so that no step takes up where another ended.

use super::super::linear::{Plain, RIDGES, fit};
use super::super::problem::{Going, Terms};
use super::super::report::{Log, Trouble};
use super::super::state::State;
use super::{Sensed, Session};
use crate::brain::linear::{Linear, Moments, downhill_ridge};
use crate::dynamics::Simulation;
use std::collections::VecDeque;

/// `joint` fits on the batches of so many bodies, the present one among them …
pub(in super::super) const BODIES: usize = 8;
/// … each older one counting less by this factor: the body has moved since.
const FADING: f64 = 0.8;
/// Outer steps from one look at the ridge to the next.
const RIDGE_EVERY: u32 = 10;

/// Samples of the last bodies by outer step, newest last; a resumed loop simulates them again.
#[derive(Default)]
pub(super) struct Known(VecDeque<(u32, Plain)>);

impl Session<'_> {
    /// Solved on the training set; dL_test/dα = direct (+ implicit) term, exactly.
    pub(super) fn linear_paper(
        &mut self,
        state: &mut State,
        terms: Terms,
        log: &mut Log,
    ) -> Result<Sensed, Trouble> {
        let (setting, design) = (self.setting, &state.design.clone());
        let solver = &setting.problem.solver;
        let implicit = matches!(terms, Terms::Implicit(_));
        let sets = [(&setting.train, implicit), (&setting.test, true)];
        let [train, test] = setting.simulate_both(design, sets, solver, log)?;
        let samples = setting.plain(&train.signals, &setting.train);
        let unseen = setting.plain(&test.signals, &setting.test);
        let lags = setting.problem.decoder.lags;
        let fit =
            log.timed(|s| &mut s.train, |_| fit(&samples.moments(), lags, self.ridge_of(state, &samples)?))?;
        let linear = fit.linear();
        let (said, answers) = (linear.predict(&samples.x), linear.predict(&unseen.x));
        let error_test = unseen.error(&answers);
        let residual = unseen.residual(&answers);
        let mut gradient = setting.vjp(&test, &linear.predict_vjp(&residual), log)?;
        if implicit {
            let inputs = log.timed(
                |s| &mut s.implicit,
                |_| {
                    let z = fit.sensitivity(&linear.weights_vjp(&unseen.x, &residual));
                    through_weights(&samples, &linear, &said, &z)
                },
            );
            let through_brain = setting.vjp(&train, &inputs, log)?;
            gradient.iter_mut().zip(&through_brain).for_each(|(g, more)| *g += more);
        }
        let error_train = samples.error(&said);
        let loss_train = part(error_train);
        log.report.error_train = error_train;
        log.report.error_test = error_test;
        log.report.loss_train = Some(loss_train);
        state.check_trend(loss_train)?;
        Ok(Sensed { gradient, loss_train, error_test })
    }

    /// Solved on the training set; the training loss, which moves with α as at fixed weights, from a subset of samples.
    pub(super) fn linear_envelope(
        &mut self,
        state: &mut State,
        going: Going,
        log: &mut Log,
    ) -> Result<Sensed, Trouble> {
        let setting = self.setting;
        let solver = &setting.problem.optimise.solver_of(state.step, setting.problem.solver);
        let some = self.subset(state.step, going);
        let sets = [(&setting.train, false), (&some, true)];
        let [train, subset] = setting.simulate_both(&state.design, sets, solver, log)?;
        let linear = self.solved(state, &setting.plain(&train.signals, &setting.train), log)?;
        let moving = setting.plain(&subset.signals, &some);
        let residual = moving.residual(&linear.predict(&moving.x));
        self.linear_step(state, &linear, &subset, &residual, log)
    }

    /// Solved on this body's fresh samples and those of the last ones; the gradient of the loss on this one's.
    pub(super) fn linear_joint(
        &mut self,
        state: &mut State,
        going: Going,
        log: &mut Log,
    ) -> Result<Sensed, Trouble> {
        let step = state.step;
        let steps: Vec<u32> = state.trail.iter().map(|passed| passed.step).collect();
        self.known.0.retain(|(known, _)| steps.contains(known));
        let mut known = VecDeque::new();
        for passed in &state.trail {
            let at = self.known.0.iter().position(|(known, _)| *known == passed.step);
            known.push_back(match at.and_then(|at| self.known.0.remove(at)) {
                Some(known) => known,
                None => {
                    let (forces, simulation) = self.fresh(&passed.design, passed.step, going, false, log)?;
                    (passed.step, self.setting.plain(&simulation.signals, &forces))
                }
            });
        }
        let (forces, simulation) = self.fresh(&state.design, step, going, true, log)?;
        known.push_back((step, self.setting.plain(&simulation.signals, &forces)));
        self.known.0 = known;

        let linear = log.timed(|s| &mut s.train, |_| self.solve_known(state))?;
        let newest = &self.known.0[self.known.0.len() - 1].1;
        let said = linear.predict(&newest.x);
        log.report.error_train = newest.error(&said);
        self.linear_step(state, &linear, &simulation, &newest.residual(&said), log)
    }

    /// Solved on these training samples, whose error the report gets.
    pub(super) fn solved(
        &self,
        state: &mut State,
        samples: &Plain,
        log: &mut Log,
    ) -> Result<Linear, Trouble> {
        let lags = self.setting.problem.decoder.lags;
        let linear = log.timed(
            |s| &mut s.train,
            |_| Ok(fit(&samples.moments(), lags, self.ridge_of(state, samples)?)?.linear()),
        )?;
        log.report.error_train = samples.error(&linear.predict(&samples.x));
        Ok(linear)
    }

    /// λ of these training samples: the state's, looked for anew every `RIDGE_EVERY` steps.
    fn ridge_of(&self, state: &mut State, samples: &Plain) -> Result<f64, Trouble> {
        match state.ridge {
            Some(ridge) if !state.step.is_multiple_of(RIDGE_EVERY) => Ok(ridge),
            last => Ok(*state.ridge.insert(self.setting.ridge(samples, last)?)),
        }
    }

    /// The weights for all known samples, older ones counting less; now and then the ridge by which the older ones read
    /// the newest best.
    fn solve_known(&self, state: &mut State) -> Result<Linear, Trouble> {
        let (setting, known) = (self.setting, &self.known.0);
        let lags = setting.problem.decoder.lags;
        let (_, newest) = &known[known.len() - 1];
        let mut moments = Moments::new(newest.sizes, setting.pool.heartbeat());
        for (age, (_, samples)) in known.iter().rev().enumerate().skip(1) {
            let fading = FADING.powi(age as i32);
            let w: Vec<f64> = samples.w.iter().map(|w| w * fading).collect();
            moments.add(&samples.x, &samples.y, &w);
        }
        match state.ridge {
            None => {
                let first = setting.plain(&setting.initial_signals, &setting.train);
                state.ridge = Some(setting.ridge(&first, None)?);
            }
            Some(last) if state.step.is_multiple_of(RIDGE_EVERY) && known.len() > 1 => {
                let error = |ridge| {
                    let linear = fit(&moments, lags, ridge).ok()?.linear();
                    newest.error(&linear.predict(&newest.x))
                };
                if setting.problem.decoder.ridge == super::super::Ridge::Auto {
                    state.ridge = downhill_ridge(last, RIDGES, error).or(state.ridge);
                }
            }
            Some(_) => {}
        }
        moments.add(&newest.x, &newest.y, &newest.w);
        Ok(fit(&moments, lags, state.ridge.unwrap_or_default())?.linear())
    }

    /// Looks at the test set where it is due, and takes the gradient of the mean error of these samples at fixed weights;
    /// `residual` is its derivative in the answers.
    fn linear_step(
        &self,
        state: &State,
        linear: &Linear,
        simulation: &Simulation,
        residual: &[f64],
        log: &mut Log,
    ) -> Result<Sensed, Trouble> {
        let error_test = self.linear_test(state, linear, log)?;
        let loss_train = part(log.report.error_train);
        log.report.loss_train = Some(loss_train);
        state.check_trend(loss_train)?;
        let inputs = linear.predict_vjp(residual);
        let gradient = self.setting.vjp(simulation, &inputs, log)?;
        Ok(Sensed { gradient, loss_train, error_test })
    }

    /// The test error of these weights, with the accurate integrator, at the steps where it is due.
    fn linear_test(&self, state: &State, linear: &Linear, log: &mut Log) -> Result<Option<f64>, Trouble> {
        let Some((signals, test)) = self.test_signals(state, log)? else { return Ok(None) };
        let samples = self.setting.plain(&signals, &test);
        log.report.error_test = samples.error(&linear.predict(&samples.x));
        Ok(log.report.error_test)
    }
}

/// Cotangent on the training inputs through the weights, which answer a force on them by −`z`.
///
/// ∂L_train/∂W = 2 Σ ŵ φ (ŷ − y) + 2λW stays zero as x moves: dL = −⟨z, d(∂L_train/∂W)⟩.
fn through_weights(samples: &Plain, linear: &Linear, said: &[f64], z: &Linear) -> Vec<f64> {
    let residual = samples.residual(said);
    // 2ŵ of z's own answers
    let answers = z.predict(&samples.x);
    let zero = Plain { y: vec![0.0; samples.y.len()], ..samples.clone() };
    let mut inputs = z.predict_vjp(&residual);
    let more = linear.predict_vjp(&zero.residual(&answers));
    inputs.iter_mut().zip(more).for_each(|(a, b)| *a = -(*a + b));
    inputs
}

/// An error (%) as a part of 1; what is no number stays none.
pub(super) fn part(error: Option<f64>) -> f64 {
    error.map_or(f64::NAN, |error| 0.01 * error)
}
