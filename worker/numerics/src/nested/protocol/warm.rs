//! The network goes on from body to body: `warm` follows the test loss, `envelope` the training loss.

use super::super::problem::Going;
use super::super::report::{Log, Trouble};
use super::super::state::State;
use super::{Sensed, Session};
use crate::brain::Batch;

/// `warm` trains until the loss is within this factor of its trend …
const NEED: f64 = 1.05;
/// … but at most so many times `brain_iterations`.
const ROUNDS_MAX: usize = 8;

impl Session<'_> {
    /// Iterations by need; the direct gradient of the test loss.
    pub(super) fn warm(&mut self, state: &mut State, going: Going, log: &mut Log) -> Result<Sensed, Trouble> {
        let (setting, solver) = (self.setting, &self.setting.problem.solver);
        self.first_training(state, going, log)?;
        let sets = [(&setting.train, false), (&setting.test, true)];
        let [train, test] = setting.simulate_both(&state.design, sets, solver, log)?;
        let data = setting.data(&train.signals, &setting.train);
        let loss_train = self.go_on_by_need(state, data.all(), going, log)?;
        state.check_trend(loss_train)?;

        let data = setting.physical_data(&test.signals, &setting.test);
        let (loss_test, cotangent) = self.input_gradient(&state.weights, data.all(), log);
        let gradient = setting.vjp(&test, &cotangent, log)?;
        let error_test = setting.error(&state.weights, &data, &setting.test, &mut self.workspace);
        log.report.error_test = error_test;
        log.report.loss_test = Some(loss_test);
        Ok(Sensed { gradient, loss_train, error_test })
    }

    /// Rounds of iterations until the loss is in line with its trend; the loss after them.
    pub(super) fn go_on_by_need(
        &mut self,
        state: &mut State,
        batch: Batch<f32>,
        going: Going,
        log: &mut Log,
    ) -> Result<f64, Trouble> {
        let mut loss = f64::INFINITY;
        for _ in 0..ROUNDS_MAX {
            loss = self.go_on(state, batch, going, log)?;
            if state.trend.is_none_or(|trend| loss < NEED * trend) {
                break;
            }
        }
        Ok(loss)
    }

    /// The training loss at its minimum over β moves with α as at fixed β: no implicit term. From a subset of samples.
    pub(super) fn envelope(
        &mut self,
        state: &mut State,
        going: Going,
        log: &mut Log,
    ) -> Result<Sensed, Trouble> {
        let setting = self.setting;
        let solver = &setting.problem.optimise.solver_of(state.step, setting.problem.solver);
        self.first_training(state, going, log)?;
        let some = self.subset(state.step, going);
        let sets = [(&setting.train, false), (&some, true)];
        let [train, subset] = setting.simulate_both(&state.design, sets, solver, log)?;
        let data = setting.data(&train.signals, &setting.train);
        let loss_train = self.go_on(state, data.all(), going, log)?;
        state.check_trend(loss_train)?;

        let (_, cotangent) =
            self.input_gradient(&state.weights, setting.data(&subset.signals, &some).all(), log);
        let gradient = setting.vjp(&subset, &cotangent, log)?;
        let error_test = self.look_at_test(state, log)?;
        Ok(Sensed { gradient, loss_train, error_test })
    }
}
