//! How far the brain is trained on a body, and which loss moves that body: one file a protocol.

mod envelope;
mod joint;
mod linear;
mod paper;
mod search;

use super::evaluation::fresh_weights;
use super::problem::{Going, Kind, Protocol};
use super::report::{Log, Trouble};
use super::setting::Setting;
use super::state::State;
use crate::brain::{self, Adam, Batch, TrainOutcome, Workspace};
use crate::dynamics::{Forces, Simulation};
use crate::random::{Purpose, Stream};
use crate::stimuli::select;

/// What a protocol finds out about the state's design.
pub(super) struct Sensed {
    /// dL/dα; empty of a search without gradient.
    pub(super) gradient: Vec<f64>,
    /// Training loss after training (normalised).
    pub(super) loss_train: f64,
    /// Prediction error on the test set (%), where looked at.
    pub(super) error_test: Option<f64>,
}

/// A trial's protocol at work, with what it keeps from step to step and could make again.
pub(super) struct Session<'a> {
    setting: &'a Setting<'a>,
    workspace: Workspace<f32>,
    recent: joint::Recent,
    known: linear::Known,
}

pub(super) use linear::BODIES;

/// Iterations of a going network's first training, on the initial body's training signals.
const FIRST_ITERATIONS: usize = 100;

impl<'a> Session<'a> {
    pub(super) fn new(setting: &'a Setting<'a>) -> Self {
        Self {
            setting,
            workspace: Workspace::new(setting.shape, setting.pool.width()),
            recent: joint::Recent::default(),
            known: linear::Known::default(),
        }
    }

    /// Simulates the state's design, trains the brain on it, and differentiates.
    pub(super) fn sense(&mut self, state: &mut State, log: &mut Log) -> Result<Sensed, Trouble> {
        let optimise = &self.setting.problem.optimise;
        if let Protocol::Random(going) | Protocol::Cmaes(going) = optimise.protocol {
            return self.read(state, going, log);
        }
        if optimise.brain == Kind::Linear {
            return match optimise.protocol {
                Protocol::Paper(terms) => self.linear_paper(state, terms, log),
                Protocol::Envelope(going) => self.linear_envelope(state, going, log),
                Protocol::Joint(going) => self.linear_joint(state, going, log),
                Protocol::Random(_) | Protocol::Cmaes(_) => unreachable!("read above"),
            };
        }
        match optimise.protocol {
            Protocol::Paper(terms) => self.paper(state, terms, log),
            Protocol::Envelope(going) => self.envelope(state, going, log),
            Protocol::Joint(going) => self.joint(state, going, log),
            Protocol::Random(_) | Protocol::Cmaes(_) => unreachable!("read above"),
        }
    }

    /// Gives a network that is to go on from body to body its first training, if it has had none.
    fn first_training(&mut self, state: &mut State, going: Going, log: &mut Log) -> Result<(), Trouble> {
        if !state.weights.is_empty() {
            return Ok(());
        }
        let (setting, problem) = (self.setting, self.setting.problem);
        let mut weights = fresh_weights(setting.shape, problem.seed, 0);
        let data = setting.data(&setting.initial_signals, &setting.train);
        let fall = brain::cosine(problem.brain.rate - going.brain_rate, FIRST_ITERATIONS);
        let rate = |i| going.brain_rate + fall(i);
        self.train(&mut weights, &mut state.weight_adam, data.all(), FIRST_ITERATIONS, &rate, log)?;
        state.weights = weights;
        Ok(())
    }

    /// `brain_iterations` more of the state's network; the loss after them.
    fn go_on(
        &mut self,
        state: &mut State,
        batch: Batch<f32>,
        going: Going,
        log: &mut Log,
    ) -> Result<f64, Trouble> {
        let State { weights, weight_adam, .. } = state;
        self.train(weights, weight_adam, batch, going.brain_iterations, &|_| going.brain_rate, log)
    }

    /// The test error of the state's network, with the accurate integrator, at the steps where it is due.
    fn look_at_test(&mut self, state: &State, log: &mut Log) -> Result<Option<f64>, Trouble> {
        let Some((signals, test)) = self.test_signals(state, log)? else { return Ok(None) };
        let setting = self.setting;
        let data = setting.data(&signals, &test);
        log.report.error_test = setting.error(&state.weights, &data, &test, &mut self.workspace);
        Ok(log.report.error_test)
    }

    /// The test signals of the state's design and their forces, with the accurate integrator, at the steps where they are
    /// looked at.
    fn test_signals(&self, state: &State, log: &mut Log) -> Result<Option<(Vec<f64>, Forces)>, Trouble> {
        let (setting, problem) = (self.setting, self.setting.problem);
        if !problem.optimise.looks_at_test(state.step) {
            return Ok(None);
        }
        let mut test = setting.test.clone();
        let (simulation, _) = log.timed(
            |s| &mut s.simulate,
            |report| setting.simulate_most(&state.design, &mut test, &problem.solver, false, report),
        )?;
        Ok(Some((simulation.signals, test)))
    }

    /// Training samples drawn for a step of `envelope`.
    fn subset(&self, step: u32, going: Going) -> Forces {
        let setting = self.setting;
        let mut order = Stream::new(Purpose::Batch, setting.problem.seed, [u64::from(step), 0])
            .permutation(setting.train.samples);
        order.truncate(going.batch);
        select(&setting.train, &order)
    }

    /// The samples that are drawn for a step of `joint` alone, simulated on a body; those of the report's step are counted.
    fn fresh(
        &self,
        design: &[f64],
        step: u32,
        going: Going,
        keep_tape: bool,
        log: &mut Log,
    ) -> Result<(Forces, Simulation), Trouble> {
        let (setting, problem) = (self.setting, self.setting.problem);
        let mut forces = problem.forces(Purpose::Fresh, u64::from(step) * going.batch as u64, going.batch);
        let solver = problem.optimise.solver_of(step, problem.solver);
        let (simulation, failed) = log.timed(
            |s| &mut s.simulate,
            |report| setting.simulate_most(design, &mut forces, &solver, keep_tape, report),
        )?;
        if step == log.report.step {
            log.report.fresh_samples = going.batch as u64 - u64::from(failed);
        }
        Ok((forces, simulation))
    }

    /// Adam on the whole batch; the loss after it.
    fn train(
        &mut self,
        weights: &mut [f32],
        adam: &mut Adam<f32>,
        batch: Batch<f32>,
        iterations: usize,
        rate: &dyn Fn(usize) -> f64,
        log: &mut Log,
    ) -> Result<f64, Trouble> {
        let done = self.iterate(weights, adam, batch, iterations, rate, log);
        let loss = self.loss_after(weights, batch, log);
        done.map(|()| loss)
    }

    /// Adam on a batch.
    fn iterate(
        &mut self,
        weights: &mut [f32],
        adam: &mut Adam<f32>,
        batch: Batch<f32>,
        iterations: usize,
        rate: &dyn Fn(usize) -> f64,
        log: &mut Log,
    ) -> Result<(), Trouble> {
        let (workspace, pool) = (&mut self.workspace, self.setting.pool);
        let outcome = log.timed(
            |s| &mut s.train,
            |report| {
                let mut losses = Vec::new();
                let outcome =
                    brain::train(weights, adam, batch, rate, iterations, &mut losses, workspace, pool);
                report.counters.brain_iterations += losses.len() as u64;
                outcome
            },
        );
        if outcome == TrainOutcome::Ok { Ok(()) } else { Err(Trouble::Training(outcome)) }
    }

    /// The training loss after a step's training.
    fn loss_after(&mut self, weights: &[f32], batch: Batch<f32>, log: &mut Log) -> f64 {
        let (workspace, pool) = (&mut self.workspace, self.setting.pool);
        let loss = log.timed(|s| &mut s.train, |_| brain::loss(weights, batch, workspace, pool));
        log.report.loss_train = Some(loss);
        loss
    }

    /// Loss and its gradient in the inputs (N, T, 3M).
    fn input_gradient(&mut self, weights: &[f32], batch: Batch<f32>, log: &mut Log) -> (f64, Vec<f64>) {
        let (loss, gradient) = log.timed(
            |s| &mut s.differentiate,
            |_| brain::input_gradient(weights, batch, &mut self.workspace, self.setting.pool),
        );
        (loss, gradient.into_iter().map(f64::from).collect())
    }
}
