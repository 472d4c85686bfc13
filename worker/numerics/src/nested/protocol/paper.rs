//! The paper's protocol: every outer step trains a fresh network to its optimum.

use super::super::evaluation::fresh_weights;
use super::super::implicit::implicit_term;
use super::super::problem::{Terms, Training};
use super::super::report::{Log, Trouble};
use super::super::state::State;
use super::{Sensed, Session};
use crate::brain::Adam;

impl Session<'_> {
    /// A fresh network, trained to β*; dL_test/dα = direct (+ implicit) term.
    pub(super) fn paper(&mut self, state: &State, terms: Terms, log: &mut Log) -> Result<Sensed, Trouble> {
        let setting = self.setting;
        let (design, problem) = (&state.design, setting.problem);
        let implicit = matches!(terms, Terms::Implicit(_));
        let solver = &problem.solver;

        // A(α), of the training samples with a tape only where their gradient is asked for
        let sets = [(&setting.train, implicit), (&setting.test, true)];
        let [train, test] = setting.simulate_both(design, sets, solver, log)?;
        let train_data = setting.data(&train.signals, &setting.train);
        let test_data = setting.physical_data(&test.signals, &setting.test);

        // β*(A)
        let mut weights = fresh_weights(setting.shape, problem.seed, u64::from(state.step));
        let mut adam = Adam::new(weights.len());
        let Training { iterations, rate, .. } = problem.brain;
        let loss_train = self.train(&mut weights, &mut adam, train_data.all(), iterations, &|_| rate, log)?;
        state.check_trend(loss_train)?;

        // dL_test/dα, directly
        let (loss_test, direct) = self.input_gradient(&weights, test_data.all(), log);
        let mut gradient = setting.vjp(&test, &direct, log)?;

        // and through β*
        if let Terms::Implicit(policy) = terms {
            let inputs = implicit_term(setting, &weights, &train.signals, &test.signals, policy, log);
            let through_brain = setting.vjp(&train, &inputs, log)?;
            gradient.iter_mut().zip(&through_brain).for_each(|(g, more)| *g += more);
        }

        let error_test = setting.error(&weights, &test_data, &setting.test, &mut self.workspace);
        log.report.error_train = setting.error(&weights, &train_data, &setting.train, &mut self.workspace);
        log.report.error_test = error_test;
        log.report.loss_test = Some(loss_test);
        Ok(Sensed { gradient, loss_train, error_test })
    }
}
