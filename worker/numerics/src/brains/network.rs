//! The convolutional network at the scales of a trial: fresh for one body, or continued from body to body.

use super::stacked::Stack;
use super::{DecoderState, FitOn, FitResult, FittedDecoder, Implicit, Learner, Loss, Recipe, implicit};
use crate::brain::{self, Adam, Batch, Data, Shape, TrainOutcome, Workspace};
use crate::trial::{
    Counters, DecoderKind, PreparedTrial, Samples, Scales, StepTraining, Training, TrainingProtocol, Trouble,
};

/// Number of the first reader's initial weights; smaller numbers belong to outer steps.
const FIRST_NETWORK: u64 = 1 << 32;
/// Iterations of a network's first training: on the initial body's samples or, in `random`, on the candidate's.
const FIRST_ITERATIONS: usize = 100;
/// Bodies whose batches train a continued network, including the current one.
const BODIES: usize = 4;
/// Each iteration uses every fourth sample in rotation: samples are so similar that all of them would hardly improve a step.
const SLICES: usize = 4;

/// Initial weights, in f32.
fn fresh_weights(shape: Shape, seed: u64, which: u64) -> Vec<f32> {
    brain::initial_weights(shape, seed, which).into_iter().map(|w| w as f32).collect()
}

/// A network in training, with all state to resume to equal bits.
#[derive(Debug, Clone, PartialEq)]
pub struct NetworkTraining {
    /// Weights.
    pub weights: Vec<f32>,
    /// State of Adam.
    pub adam: Adam<f32>,
    /// Training loss (normalised) of every iteration so far.
    pub losses: Vec<f32>,
    /// (iteration, from 1, error (%)) at the milestones.
    pub errors: Vec<(u32, f64)>,
}

impl NetworkTraining {
    fn new(shape: Shape, seed: u64, number: u64) -> Self {
        Self::of(fresh_weights(shape, seed, FIRST_NETWORK + number))
    }

    /// Starts from these weights.
    pub(crate) fn of(weights: Vec<f32>) -> Self {
        Self { adam: Adam::new(weights.len()), weights, losses: Vec::new(), errors: Vec::new() }
    }
}

/// Networks for one body, one after another. Stacked ones have the estimates of a linear decoder as additional inputs.
pub(crate) struct NetworkDecoder<'a> {
    recipe: Recipe,
    known: &'a Samples,
    scales: Scales,
    stack: Option<Stack>,
    data: Data<f32>,
    fresh: Option<NetworkTraining>,
    workspace: Workspace<f32>,
    pool: &'a crate::Pool,
}

impl<'a> NetworkDecoder<'a> {
    pub(super) fn new(
        recipe: Recipe,
        known: &'a Samples,
        [linear, scales]: [Scales; 2],
        pool: &'a crate::Pool,
    ) -> Result<Self, Trouble> {
        let sizes = known.sizes;
        let stacked = recipe.kind == DecoderKind::Stacked;
        let stack =
            stacked.then(|| Stack::new(&recipe.decoder, recipe.seed, known, linear, pool)).transpose()?;
        let shape = Shape {
            instants: sizes.instants,
            inputs: sizes.channels + if stacked { sizes.outputs } else { 0 },
            architecture: recipe.architecture,
            outputs: sizes.outputs,
        };
        let data = match &stack {
            Some(stack) => stack.known(shape, known, &scales),
            None => data(shape, known, &scales),
        };
        let workspace = Workspace::new(shape, pool.width());
        Ok(Self { recipe, known, scales, stack, data, fresh: None, workspace, pool })
    }

    /// Network inputs for signals (N, T, 3M) outside the training set.
    fn inference_data(&self, signals: &[f64]) -> Data<f32> {
        let shape = self.data.shape();
        match &self.stack {
            Some(stack) => stack.unseen(shape, signals, &self.scales),
            None => {
                let targets = vec![0.0; signals.len() / shape.inputs * shape.outputs];
                Data::new(shape, &self.scales.inputs(signals), &targets)
            }
        }
    }
}

/// Batches of one pass over the samples; each takes every n-th sample.
fn turns(samples: usize, batch: Option<usize>) -> Vec<Vec<usize>> {
    let count = samples.div_ceil(batch.unwrap_or(samples).max(1)).max(1);
    (0..count).map(|first| (first..samples).step_by(count).collect()).collect()
}

/// Loss at each iteration, averaged over the last pass.
fn by_rounds(losses: &[f32], turns: usize) -> Vec<f32> {
    let mean = |i: usize| {
        let round = &losses[(i + 1).saturating_sub(turns)..=i];
        round.iter().sum::<f32>() / round.len() as f32
    };
    (0..losses.len()).map(mean).collect()
}

/// Scaled samples as network data.
fn data<F: brain::Real>(shape: Shape, samples: &Samples, scales: &Scales) -> Data<F> {
    Data::new(shape, &scales.inputs(&samples.signals), &scales.targets(&samples.targets))
}

/// Forces (N, T, K) (N) estimated by a network.
pub(super) fn predict(
    weights: &[f32],
    data: &Data<f32>,
    scales: &Scales,
    workspace: &mut Workspace<f32>,
    pool: &crate::Pool,
) -> Vec<f64> {
    scales.physical(&brain::predict(weights, data.all(), workspace, pool))
}

impl FittedDecoder for NetworkDecoder<'_> {
    fn fit(
        &mut self,
        number: u64,
        iterations: usize,
        unseen: &Samples,
        pauses: &mut dyn FnMut(usize) -> bool,
    ) -> Option<Result<(), Trouble>> {
        let (shape, pool, scales) = (self.data.shape(), self.pool, &self.scales);
        let judged = self.inference_data(&unseen.signals);
        let (seed, recipe, mut aside) = (self.recipe.seed, self.recipe, Workspace::new(shape, pool.width()));
        let fresh = self.fresh.get_or_insert_with(|| NetworkTraining::new(shape, seed, number));
        let NetworkTraining { weights, adam, losses, errors } = fresh;
        let (first, milestones) = (losses.len(), brain::milestones(iterations));
        let mut watch = |i: usize, weights: &[f32]| {
            if i > first && pauses(i) {
                return false;
            }
            if milestones.binary_search(&(i + 1)).is_ok() {
                let predicted = predict(weights, &judged, scales, &mut aside, pool);
                errors.extend(unseen.error(&predicted).map(|error| (i as u32 + 1, error)));
            }
            true
        };
        let rate = |i| recipe.rate * recipe.schedule.factor(i, iterations);
        let (turns, data, workspace) =
            (turns(self.known.count(), recipe.batch), &self.data, &mut self.workspace);
        let batch =
            |i: usize| if turns.len() == 1 { data.all() } else { data.batch(&turns[i % turns.len()]) };
        let outcome =
            brain::train_on(weights, adam, &batch, &rate, iterations, losses, workspace, pool, &mut watch)?;
        Some(check_training(outcome))
    }

    fn predict(&mut self, signals: &[f64]) -> Vec<f64> {
        let data = self.inference_data(signals);
        let weights = &self.fresh.as_ref().expect("it has been fitted").weights;
        predict(weights, &data, &self.scales, &mut self.workspace, self.pool)
    }

    fn predict_known(&mut self) -> Vec<f64> {
        let weights = &self.fresh.as_ref().expect("it has been fitted").weights;
        predict(weights, &self.data, &self.scales, &mut self.workspace, self.pool)
    }

    fn error_known(&mut self) -> Option<f64> {
        let predicted = self.predict_known();
        self.known.error(&predicted)
    }

    fn training(&mut self) -> Option<&mut Option<NetworkTraining>> {
        Some(&mut self.fresh)
    }

    fn ridge(&self) -> Option<f64> {
        self.stack.as_ref().map(|stack| stack.ridge)
    }

    fn losses(&self) -> Vec<f32> {
        let turns = turns(self.known.count(), self.recipe.batch).len();
        self.fresh.as_ref().map_or(Vec::new(), |fresh| by_rounds(&fresh.losses, turns))
    }

    fn weights_at(&self, scales: &Scales) -> Vec<f32> {
        let mut weights = self.fresh.as_ref().map_or(Vec::new(), |fresh| fresh.weights.clone());
        brain::scale_inputs(self.data.shape(), &mut weights, &scales.over(&self.scales));
        weights
    }
}

fn check_training(outcome: TrainOutcome) -> Result<(), Trouble> {
    if outcome == TrainOutcome::Ok { Ok(()) } else { Err(Trouble::Training(outcome)) }
}

/// A network that trains a body.
pub(super) struct NetworkLearner<'a> {
    trial: &'a PreparedTrial<'a>,
    shape: Shape,
    /// Weights at this step.
    weights: Vec<f32>,
    workspace: Workspace<f32>,
}

impl<'a> NetworkLearner<'a> {
    pub(super) fn new(trial: &'a PreparedTrial<'a>) -> Self {
        let shape = trial.problem.shape();
        Self { trial, shape, weights: Vec::new(), workspace: Workspace::new(shape, trial.pool.width()) }
    }

    fn continued_settings(&self) -> StepTraining {
        match self.trial.problem.optimise.protocol {
            TrainingProtocol::Joint(going) | TrainingProtocol::Random(going) => going,
            TrainingProtocol::Paper(_) => panic!("the paper's networks are fresh"),
        }
    }

    fn data<F: brain::Real>(&self, samples: &Samples) -> Data<F> {
        data(self.shape, samples, &self.trial.network_scales)
    }

    /// As `data`, with the loss in N².
    fn physical_data<F: brain::Real>(&self, samples: &Samples) -> Data<F> {
        let variances: Vec<f64> = self.trial.network_scales.deviation.iter().map(|d| d * d).collect();
        self.data(samples).with_output_weights(&variances)
    }

    /// Runs Adam on a batch.
    fn iterate(
        &mut self,
        weights: &mut [f32],
        adam: &mut Adam<f32>,
        batch: Batch<f32>,
        iterations: usize,
        rate: &dyn Fn(usize) -> f64,
        counters: &mut Counters,
    ) -> Result<(), Trouble> {
        let (mut losses, pool) = (Vec::new(), self.trial.pool);
        let outcome =
            brain::train(weights, adam, batch, rate, iterations, &mut losses, &mut self.workspace, pool);
        counters.brain_iterations += losses.len() as u64;
        check_training(outcome)
    }

    fn loss(&mut self, weights: &[f32], batch: Batch<f32>) -> f64 {
        brain::loss(weights, batch, &mut self.workspace, self.trial.pool)
    }

    /// Runs the first training of a network, unless it is done.
    fn first_training(
        &mut self,
        samples: &Samples,
        learnt: &mut DecoderState,
        counters: &mut Counters,
    ) -> Result<(), Trouble> {
        if !learnt.weights.is_empty() {
            return Ok(());
        }
        let (trial, going) = (self.trial, self.continued_settings());
        let mut weights = fresh_weights(self.shape, trial.problem.seed, 0);
        let data = self.data(samples);
        let fall = brain::cosine(trial.problem.brain.rate - going.brain_rate, FIRST_ITERATIONS);
        let rate = |i| going.brain_rate + fall(i);
        self.iterate(&mut weights, &mut learnt.adam, data.all(), FIRST_ITERATIONS, &rate, counters)?;
        learnt.weights = weights;
        Ok(())
    }

    /// Continues the network for its iterations on a whole batch; returns the loss.
    fn continue_training(
        &mut self,
        batch: Batch<f32>,
        learnt: &mut DecoderState,
        counters: &mut Counters,
    ) -> Result<f64, Trouble> {
        let going = self.continued_settings();
        let DecoderState { weights, adam, .. } = learnt;
        self.iterate(weights, adam, batch, going.brain_iterations, &|_| going.brain_rate, counters)?;
        Ok(self.loss(weights, batch))
    }

    /// As `continue_training`, on slices in rotation.
    fn go_on_by_slices(
        &mut self,
        data: &Data<f32>,
        samples: usize,
        step: u32,
        learnt: &mut DecoderState,
        counters: &mut Counters,
    ) -> Result<f64, Trouble> {
        let (going, slices) = (self.continued_settings(), SLICES.min(samples));
        let DecoderState { weights, adam, .. } = learnt;
        let first = step as usize * going.brain_iterations;
        for i in first..first + going.brain_iterations {
            let some: Vec<usize> = (0..samples).skip(i % slices).step_by(slices).collect();
            self.iterate(weights, adam, data.batch(&some), 1, &|_| going.brain_rate, counters)?;
        }
        Ok(self.loss(weights, data.all()))
    }
}

impl Learner for NetworkLearner<'_> {
    fn bodies(&self) -> usize {
        BODIES
    }

    fn includes_age(&self, age: u32) -> bool {
        (age as usize) < BODIES
    }

    fn fit(
        &mut self,
        on: FitOn,
        step: u32,
        learnt: &mut DecoderState,
        counters: &mut Counters,
    ) -> Result<FitResult, Trouble> {
        if let FitOn::Optimum(train) = on {
            let Training { iterations, rate, .. } = self.trial.problem.brain;
            let data = self.data(train);
            let mut weights = fresh_weights(self.shape, self.trial.problem.seed, u64::from(step));
            let mut adam = Adam::new(weights.len());
            self.iterate(&mut weights, &mut adam, data.all(), iterations, &|_| rate, counters)?;
            let loss = self.loss(&weights, data.all());
            self.weights = weights;
            return Ok(FitResult { loss, error: self.error(train), ridge: None });
        }
        let mut fresh = DecoderState::untrained(self.shape.weights());
        let (first, learnt) = match on {
            FitOn::Alike(train) => (train, &mut fresh),
            _ => (&self.trial.initial, learnt),
        };
        self.first_training(first, learnt, counters)?;
        let loss = match on {
            FitOn::Optimum(_) => unreachable!("returned above"),
            FitOn::Alike(train) => {
                let data = self.data(train);
                self.continue_training(data.all(), learnt, counters)?
            }
            FitOn::Recent(bodies, _) => {
                let all = Samples::joined(bodies);
                let data = self.data(&all);
                self.go_on_by_slices(&data, all.count(), step, learnt, counters)?
            }
        };
        self.weights.clone_from(&learnt.weights);
        Ok(FitResult { loss, error: None, ridge: None })
    }

    fn loss_vjp(&mut self, samples: &Samples, loss: Loss) -> (Option<f64>, Vec<f64>) {
        let data = if loss == Loss::Test { self.physical_data(samples) } else { self.data(samples) };
        let (loss, gradient) =
            brain::input_gradient(&self.weights, data.all(), &mut self.workspace, self.trial.pool);
        let inputs: Vec<f64> = gradient.into_iter().map(f64::from).collect();
        (Some(loss), self.trial.network_scales.inputs_vjp(&inputs))
    }

    fn implicit(
        &mut self,
        train: &Samples,
        test: &Samples,
        counters: &mut Counters,
    ) -> (Vec<f64>, Option<Implicit>) {
        let data = [self.data::<f64>(train), self.physical_data::<f64>(test)];
        let (inputs, found) = implicit::implicit_term(&data, &self.weights, self.trial.pool);
        counters.hessian_products += found.iterations as u64;
        (self.trial.network_scales.inputs_vjp(&inputs), Some(found))
    }

    fn error(&mut self, samples: &Samples) -> Option<f64> {
        let data = self.data(samples);
        let predicted =
            predict(&self.weights, &data, &self.trial.network_scales, &mut self.workspace, self.trial.pool);
        samples.error(&predicted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The batches of a pass contain every sample once, with at most the requested size and as equal as possible; without a batch
    /// size there is one. Losses are averaged over a pass.
    #[test]
    fn every_sample_has_its_turn() {
        for (samples, batch) in [(12, Some(5)), (120, Some(30)), (7, Some(1)), (7, Some(9)), (7, None)] {
            let turns = turns(samples, batch);
            assert_eq!(turns.len(), batch.map_or(1, |batch| samples.div_ceil(batch)));
            let mut met: Vec<usize> = turns.concat();
            met.sort_unstable();
            assert_eq!(met, (0..samples).collect::<Vec<_>>());
            let sizes = turns.iter().map(Vec::len);
            assert!(sizes.clone().max().unwrap() - sizes.clone().min().unwrap() <= 1);
            assert!(sizes.max().unwrap() <= batch.unwrap_or(samples));
        }
        assert_eq!(by_rounds(&[3.0, 1.0, 2.0, 6.0], 3), [3.0, 2.0, 2.0, 3.0]);
        assert_eq!(by_rounds(&[3.0, 1.0], 1), [3.0, 1.0]);
    }
}
