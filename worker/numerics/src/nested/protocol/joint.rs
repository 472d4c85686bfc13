//! Body and brain stepped together, on fresh samples each step: nothing is seen twice, so nothing is over-fitted.

use super::super::problem::Going;
use super::super::report::{Log, Trouble};
use super::super::state::State;
use super::{Sensed, Session};
use crate::brain::Data;
use crate::dynamics::{Forces, Simulation};

/// The network trains on the batches of so many bodies, the present one among them.
const BATCHES: usize = 4;

/// An iteration takes every so-many-th of these samples, by turns: they are so alike that all of them tell a step hardly more.
const SLICES: usize = 4;

/// Data of the last bodies' batches, one slot a body; a resumed loop simulates them again.
#[derive(Default)]
pub(super) struct Recent {
    data: Option<Data<f32>>,
    steps: [Option<u32>; BATCHES],
}

impl Session<'_> {
    /// A few iterations on this body's batch and those of the last ones; the gradient of the loss on this one's.
    pub(super) fn joint(
        &mut self,
        state: &mut State,
        going: Going,
        log: &mut Log,
    ) -> Result<Sensed, Trouble> {
        let (setting, step) = (self.setting, state.step);
        self.first_training(state, going, log)?;
        let mut known = Vec::new();
        for passed in &state.trail {
            if passed.step as usize + BATCHES > step as usize {
                if self.recent.steps[passed.step as usize % BATCHES] != Some(passed.step) {
                    self.meet(&passed.design, passed.step, going, false, log)?;
                }
                known.push(passed.step);
            }
        }
        known.push(step);
        let (_, simulation) = self.meet(&state.design, step, going, true, log)?;

        let slots = |steps: &[u32]| -> Vec<usize> {
            steps
                .iter()
                .flat_map(|&s| (0..going.batch).map(move |i| s as usize % BATCHES * going.batch + i))
                .collect()
        };
        let data = self.recent.data.take().expect("filled by meet");
        let loss = self.go_on_by_slices(state, &data, &slots(&known), going, log);
        let (_, cotangent) = self.input_gradient(&state.weights, data.batch(&slots(&[step])), log);
        self.recent.data = Some(data);
        let loss_train = loss?;
        state.check_trend(loss_train)?;

        let gradient = setting.vjp(&simulation, &cotangent, log)?;
        let error_test = self.look_at_test(state, log)?;
        Ok(Sensed { gradient, loss_train, error_test })
    }

    /// `brain_iterations` more of the state's network; the loss on all `slots` after them.
    fn go_on_by_slices(
        &mut self,
        state: &mut State,
        data: &Data<f32>,
        slots: &[usize],
        going: Going,
        log: &mut Log,
    ) -> Result<f64, Trouble> {
        let slices = SLICES.min(slots.len());
        let State { step, weights, weight_adam, .. } = state;
        let first = *step as usize * going.brain_iterations;
        for i in first..first + going.brain_iterations {
            let some: Vec<usize> = slots.iter().copied().skip(i % slices).step_by(slices).collect();
            self.iterate(weights, weight_adam, data.batch(&some), 1, &|_| going.brain_rate, log)?;
        }
        Ok(self.loss_after(weights, data.batch(slots), log))
    }

    /// Simulates the fresh samples of `step` on its body and keeps their data in that step's slot.
    fn meet(
        &mut self,
        design: &[f64],
        step: u32,
        going: Going,
        keep_tape: bool,
        log: &mut Log,
    ) -> Result<(Forces, Simulation), Trouble> {
        let setting = self.setting;
        let slot = step as usize % BATCHES;
        let (forces, simulation) = self.fresh(design, step, going, keep_tape, log)?;
        let data = self.recent.data.get_or_insert_with(|| Data::zeros(setting.shape, BATCHES * going.batch));
        setting.fill(data, slot * going.batch, &simulation.signals, &forces);
        self.recent.steps[slot] = Some(step);
        Ok((forces, simulation))
    }
}
