//! What a candidate of a search without gradient is worth: its test error, read by the trial's brain on its training set.

use super::super::problem::{Going, Kind};
use super::super::report::{Log, Trouble};
use super::super::state::State;
use super::linear::part;
use super::{Sensed, Session};
use crate::brain::{Batch, TrainOutcome};

/// The network trains until its loss is within this factor of its trend …
const NEED: f64 = 1.05;
/// … but at most so many times `brain_iterations`.
const ROUNDS_MAX: usize = 8;

impl Session<'_> {
    /// A linear brain is solved for; the network goes on from candidate to candidate, by as many iterations as its loss
    /// needs.
    pub(super) fn read(&mut self, state: &mut State, going: Going, log: &mut Log) -> Result<Sensed, Trouble> {
        let (setting, design) = (self.setting, &state.design.clone());
        let linear = setting.problem.optimise.brain == Kind::Linear;
        if !linear {
            self.first_training(state, going, log)?;
        }
        let sets = [(&setting.train, false), (&setting.test, false)];
        let [train, test] = setting.simulate_both(design, sets, &setting.problem.solver, log)?;
        let (loss_train, error_test) = if linear {
            let linear = self.solved(state, &setting.plain(&train.signals, &setting.train), log)?;
            let unseen = setting.plain(&test.signals, &setting.test);
            let loss = part(log.report.error_train);
            log.report.loss_train = Some(loss);
            (loss, unseen.error(&linear.predict(&unseen.x)))
        } else {
            let data = setting.data(&train.signals, &setting.train);
            let loss = self.go_on_by_need(state, data.all(), going, log)?;
            let data = setting.data(&test.signals, &setting.test);
            (loss, setting.error(&state.weights, &data, &setting.test, &mut self.workspace))
        };
        log.report.error_test = error_test;
        match loss_train.is_finite() {
            true => Ok(Sensed { gradient: Vec::new(), loss_train, error_test }),
            false => Err(Trouble::Training(TrainOutcome::NonFinite)),
        }
    }

    /// Rounds of iterations until the loss is in line with its trend; the loss after them.
    fn go_on_by_need(
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
}
