//! Brains: what reads forces from a body's signals, and what trains bodies by reading them.
//!
//! A [`Reader`] is fitted to the training samples of one body and reads others of it: in the comparison at the end, of unseen
//! records, in replays. A [`Learner`] goes from body to body and says how the signals should change. A new brain is a file
//! here with either or both, and a line in the tables `reader` and `learner`.

mod bands;
mod fitted;
mod implicit;
mod inverse;
mod linear;
mod network;
mod readings;
mod records;
pub(crate) mod ridge;
mod stacked;

pub use bands::{Band, BandKind, LEVEL, TO_EACH_SIDE};
pub use fitted::Fitted;
pub(crate) use fitted::Pooled;
pub use inverse::{Estimate, Inverse};
pub(crate) use linear::Plain;
#[cfg(test)]
pub(crate) use linear::solve;
pub use network::Fresh;
pub use readings::{READINGS_MAX, Reading, fits};
pub(crate) use readings::{own_reading, readings};
pub use records::{Records, Unseen};
#[cfg(test)]
pub(crate) use stacked::Stack;
pub(crate) use stacked::predict_on;

use crate::brain::{Adam, Architecture, SolveOutcome};
use crate::trial::{BrainKind, Counters, Decoder, Problem, Samples, Scales, Schedule, Trial, Trouble};

/// How a brain that reads is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Recipe {
    /// Which.
    pub kind: BrainKind,
    /// A network's layers.
    pub architecture: Architecture,
    /// Adam's rate in a network's training, and how it falls.
    pub rate: f64,
    /// Likewise.
    pub schedule: Schedule,
    /// Samples of an iteration of that training, all where it does not say.
    pub batch: Option<usize>,
    /// The linear brain, of a stacked network that beneath it.
    pub decoder: Decoder,
    /// Seed of initial weights and folds.
    pub seed: u64,
}

impl Problem {
    /// Of the brain that reads the trial's bodies.
    pub fn recipe(&self) -> Recipe {
        Recipe {
            kind: self.reader,
            architecture: self.brain.architecture,
            rate: self.brain.rate,
            schedule: self.evaluation.schedule,
            batch: self.evaluation.batch,
            decoder: self.decoder,
            seed: self.seed,
        }
    }
}

/// A brain that is fitted to the training samples of one body.
pub(crate) trait Reader {
    /// Fits it. Of a network number `number` is trained for `iterations`, at least one more, and the error on `unseen` is
    /// noted on the way; `None` if `pauses` says so, which is asked with the iterations done: the same call goes on.
    fn fit(
        &mut self,
        number: u64,
        iterations: usize,
        unseen: &Samples,
        pauses: &mut dyn FnMut(usize) -> bool,
    ) -> Option<Result<(), Trouble>>;

    /// Forces (N, T, K) (N) of signals (N, T, 3M) that it was not fitted to.
    fn predict(&mut self, signals: &[f64]) -> Vec<f64>;

    /// Those of the training samples: by brains that have not seen them, where one reads what others predict.
    fn predict_known(&mut self) -> Vec<f64>;

    /// Mean prediction error (%) on the training samples.
    fn error_known(&mut self) -> Option<f64>;

    /// Prediction error (%) of each of some others.
    fn errors(&mut self, samples: &Samples) -> Vec<Option<f64>> {
        samples.errors(&self.predict(&samples.signals))
    }

    /// A network in training or trained; `None` of a brain without weights to keep.
    fn training(&mut self) -> Option<&mut Option<Fresh>> {
        None
    }

    /// Training loss (normalised) at every iteration of a network's training, each over a round of its turns.
    fn losses(&self) -> Vec<f32> {
        Vec::new()
    }

    /// Its weights for signals at other scales; none of a brain without.
    fn weights_at(&self, _: &Scales) -> Vec<f32> {
        Vec::new()
    }
}

/// The brain of a recipe for training samples `known`, by the scales of a linear brain and those of a network.
///
/// # Errors
/// If a linear brain beneath a network has no solution.
pub(crate) fn reader<'a>(
    recipe: Recipe,
    known: &'a Samples,
    scales: [Scales; 2],
    pool: &'a crate::Pool,
) -> Result<Box<dyn Reader + 'a>, Trouble> {
    Ok(match recipe.kind {
        BrainKind::Network | BrainKind::Stacked => {
            Box::new(network::NetworkReader::new(recipe, known, scales, pool)?)
        }
        BrainKind::Linear => Box::new(fitted::LinearReader::new(recipe, known, scales, pool)),
        BrainKind::Inverse => unreachable!("it reads a body, by the body's model: `Inverse`"),
    })
}

/// What a learner takes from body to body.
#[derive(Debug, Clone, PartialEq)]
pub struct Learnt {
    /// Weights of a network; empty before its first training.
    pub weights: Vec<f32>,
    /// Adam on them.
    pub adam: Adam<f32>,
    /// λ of a linear brain, once found.
    pub ridge: Option<f64>,
}

impl Learnt {
    /// Nothing, of a network of so many weights.
    pub(crate) fn nothing(weights: usize) -> Self {
        Self { weights: Vec::new(), adam: Adam::new(weights), ridge: None }
    }
}

/// On what a learner is fitted.
#[derive(Clone, Copy)]
pub(crate) enum FitOn<'a> {
    /// Afresh, to its optimum: β*(A).
    Optimum(&'a Samples),
    /// Afresh, of the same initial weights and iterations for every body.
    Alike(&'a Samples),
    /// On from the last body, on a few samples of one cast of this one.
    Cast(&'a Samples),
    /// On from the last body, on the last bodies, the newest last.
    Recent(&'a [&'a Samples]),
}

/// What a fit has come to.
pub(crate) struct Learned {
    /// Training loss (normalised).
    pub(crate) loss: f64,
    /// Prediction error on the training samples, of `Recent` on the newest (%), where known.
    pub(crate) error: Option<f64>,
}

/// Which loss.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Loss {
    /// That which training lowers.
    Training,
    /// That on the test set; of a network in N².
    Test,
}

/// The linear system of the implicit term.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Implicit {
    /// Conjugate-gradient iterations.
    pub iterations: usize,
    /// ‖r‖/‖b‖ at the end.
    pub residual: f64,
    /// Least curvature met, vᵀHv/vᵀv.
    pub smallest_curvature: f64,
    /// How it ended.
    pub outcome: SolveOutcome,
}

/// A brain that trains a body.
pub(crate) trait Learner {
    /// Bodies whose samples it is fitted to at a time by [`FitOn::Recent`], at most.
    fn bodies(&self) -> usize;

    /// Whether those of a body so many steps ago are among them.
    fn recalls(&self, age: u32) -> bool;

    /// Fits it at an outer step.
    ///
    /// # Errors
    /// If its training ends early.
    fn fit(
        &mut self,
        on: FitOn,
        step: u32,
        learnt: &mut Learnt,
        counters: &mut Counters,
    ) -> Result<Learned, Trouble>;

    /// A loss at fixed weights, where it is one, and its cotangent on the signals (N, T, 3M).
    fn loss_vjp(&mut self, samples: &Samples, loss: Loss) -> (Option<f64>, Vec<f64>);

    /// Cotangent on the training signals (N, T, 3M) of the test loss through the fitted weights; of a network also how its
    /// linear system ended.
    fn implicit(
        &mut self,
        train: &Samples,
        test: &Samples,
        counters: &mut Counters,
    ) -> (Vec<f64>, Option<Implicit>);

    /// Mean prediction error (%).
    fn error(&mut self, samples: &Samples) -> Option<f64>;
}

/// The brain that the trial's bodies are trained with.
pub(crate) fn learner<'a>(trial: &'a Trial<'a>) -> Box<dyn Learner + 'a> {
    match trial.problem.optimise.brain {
        BrainKind::Linear => Box::new(linear::LinearLearner::new(trial)),
        BrainKind::Network => Box::new(network::NetworkLearner::new(trial)),
        BrainKind::Stacked | BrainKind::Inverse => unreachable!("it only reads"),
    }
}
