//! `envelope`: the network goes on from body to body; the training loss moves the body, from a subset of the samples.

use super::super::problem::Going;
use super::super::report::{Log, Trouble};
use super::super::state::State;
use super::{Sensed, Session};

impl Session<'_> {
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
