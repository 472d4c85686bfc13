//! How a trial trains its body and brains: data alone.

use crate::brain::Architecture;
use crate::brain::linear::Lags;
use crate::dynamics::Solver;

/// Which brain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BrainKind {
    /// The convolutional network.
    Network,
    /// The linear brain.
    Linear,
    /// The network on the signals and on a linear brain's estimates of the forces; it only reads.
    Stacked,
    /// The body's own model, inverted; it only reads.
    Inverse,
}

impl BrainKind {
    /// Whether it has weights that are trained by steps.
    pub fn is_network(self) -> bool {
        matches!(self, Self::Network | Self::Stacked)
    }
}

/// A linear brain before it is fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decoder {
    /// Its memory.
    pub lags: Lags,
    /// λ.
    pub ridge: Ridge,
}

/// How λ is found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Ridge {
    /// By folds of the training samples.
    Auto,
    /// Given.
    Given(f64),
}

/// Full-batch training of a fresh brain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Training {
    /// Adam iterations.
    pub iterations: usize,
    /// Adam's rate.
    pub rate: f64,
    /// Its layers.
    pub architecture: Architecture,
    /// How its signals and forces are normalised.
    pub scaling: Scaling,
}

/// Normalisation of a network's signals and forces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scaling {
    /// Signals by the RMS of each body's training signals, forces by mean and standard deviation.
    Rms,
    /// Signals to [−1, 1] and forces to [0, 1] by the extremes of the initial body's training samples, for every body.
    Extremes,
}

/// The outer loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Optimise {
    /// The brain that the body is trained with.
    pub brain: BrainKind,
    /// How body and brain are trained together.
    pub protocol: Protocol,
    /// Outer steps.
    pub iterations: u32,
    /// Adam's rate on α (mm); of a search the standard deviation of its first candidates.
    pub rate: f64,
    /// A cheaper integrator for the outer steps; looks at the test set have the accurate one. `joint` only.
    pub coarse: Option<Solver>,
    /// Casts whose errors move the body; `None`: the body as designed. `joint`.
    pub casting: Option<Casting>,
}

/// Casts, or kinds of forces, that a body is trained for, drawn anew each outer step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Casting {
    /// Which of the two.
    pub over: Over,
    /// How many casts a step, a batch of samples each; or all parts of the mixture.
    pub casts: usize,
    /// The part of them, those read worst, whose mean loss moves the body: 1 all, 0 the worst alone.
    pub tail: f64,
    /// Which brain reads them while the body is trained.
    pub reader: CastReader,
}

/// What an objective is over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Over {
    /// Casts that scatter; the objective is of their losses.
    Casts,
    /// Parts of a mixture of forces; the objective is of the logarithms of their losses, which may differ tenfold from the
    /// beginning.
    Parts,
}

/// Which brain reads casts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CastReader {
    /// One for all.
    One,
    /// One for each, fitted to its own samples.
    Each,
}

impl Casting {
    /// The objective of losses, and its derivative by each. Parts of a mixture are ranked by how far they have come from their
    /// first losses.
    pub fn objective(&self, losses: &[f64], first: &[f64]) -> (f64, Vec<f64>) {
        let sum = |weights: &[f64], of: &dyn Fn(f64) -> f64| {
            let counted = weights.iter().zip(losses).filter(|(by, _)| **by > 0.0);
            counted.map(|(by, loss)| by * of(*loss)).sum::<f64>()
        };
        match self.over {
            Over::Casts => {
                let weights = self.weights(losses);
                (sum(&weights, &|loss| loss), weights)
            }
            Over::Parts => {
                let ratios: Vec<f64> = losses.iter().zip(first).map(|(loss, first)| loss / first).collect();
                let mut weights = self.weights(&ratios);
                let mean = sum(&weights, &f64::ln).exp();
                weights.iter_mut().zip(losses).for_each(|(by, loss)| *by *= mean / loss);
                (mean, weights)
            }
        }
    }

    /// Weight of each cast's loss in the objective; their sum is 1. With a tail of 1 − q the objective is the conditional value at
    /// risk at level q (Rockafellar and Uryasev 2000, doi:10.21314/JOR.2000.038).
    pub fn weights(&self, losses: &[f64]) -> Vec<f64> {
        let one = 1.0 / losses.len() as f64;
        let tail = self.tail.max(one);
        let mut worst: Vec<usize> = (0..losses.len()).collect();
        worst.sort_by(|&a, &b| losses[b].total_cmp(&losses[a]));
        let (mut weights, mut left) = (vec![0.0; losses.len()], tail);
        for i in worst {
            weights[i] = one.min(left) / tail;
            left = (left - one).max(0.0);
        }
        weights
    }
}

/// How body and brain are trained together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Protocol {
    /// A fresh network each outer step, trained `Training::iterations`; the test loss moves the body.
    Paper(Terms),
    /// The network goes on; the loss on samples drawn for the step alone moves the body.
    Joint(Going),
    /// No gradient: candidates drawn about the initial body; a network starts afresh on each.
    Random(Going),
}

impl Protocol {
    /// Whether bodies are candidates, each for itself.
    pub(crate) fn is_search(&self) -> bool {
        matches!(self, Self::Random(_))
    }
}

/// A network that goes on from body to body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Going {
    /// Samples whose gradient moves the body.
    pub batch: usize,
    /// Adam iterations an outer step.
    pub brain_iterations: usize,
    /// Their rate.
    pub brain_rate: f64,
}

/// Terms of the gradient of the test loss.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Terms {
    /// Through the test signals and, by the implicit function theorem, through the trained weights.
    Implicit,
    /// Through the test signals alone.
    Direct,
}

/// The comparison at the end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evaluation {
    /// Fresh networks a body.
    pub seeds: usize,
    /// Rate schedule of their training.
    pub schedule: Schedule,
    /// Samples of an iteration, all where it does not say.
    pub batch: Option<usize>,
    /// Iterations of as many further networks, whose training is to be a long one.
    pub long: Option<usize>,
    /// Casts of each body that are read.
    pub casts: usize,
    /// Whether they are read by brains fitted to samples of theirs, too.
    pub records: bool,
    /// Whether the initial body is compared, too.
    pub initial: bool,
}

/// Adam's rate over a training.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Schedule {
    /// Falls to 0 by a cosine.
    Cosine,
    /// Stays.
    Constant,
}

impl Schedule {
    /// The rate of an iteration, from 0, as a part of the full one.
    pub fn factor(self, iteration: usize, iterations: usize) -> f64 {
        match self {
            Self::Constant => 1.0,
            Self::Cosine => 0.5 * (1.0 + (std::f64::consts::PI * iteration as f64 / iterations as f64).cos()),
        }
    }
}
