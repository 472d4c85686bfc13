//! Settings for training body and decoders.

use crate::brain::Architecture;
use crate::brain::linear::Lags;
use crate::dynamics::IntegratorSettings;

/// Kind of decoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DecoderKind {
    /// A convolutional network.
    Network,
    /// A linear decoder.
    Linear,
    /// A network on the signals and on estimates of a linear decoder; cannot train the body.
    Stacked,
    /// The inverted model of the body; cannot train the body.
    Inverse,
}

impl DecoderKind {
    /// Whether the decoder is trained by iterations.
    pub fn is_network(self) -> bool {
        matches!(self, Self::Network | Self::Stacked)
    }
}

/// Settings of a linear decoder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decoder {
    /// Memory of the decoder.
    pub lags: Lags,
    /// Regularisation λ.
    pub ridge: RidgeChoice,
}

/// How λ is chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RidgeChoice {
    /// By cross-validation on the training samples.
    Auto,
    /// A given value.
    Given(f64),
}

/// Training of a fresh decoder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Training {
    /// Adam iterations.
    pub iterations: usize,
    /// Adam's learning rate.
    pub rate: f64,
    /// Layers of the network.
    pub architecture: Architecture,
    /// Normalisation of signals and forces.
    pub scaling: Normalisation,
}

/// Normalisation of a network's signals and forces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Normalisation {
    /// Signals by the RMS of each body's training signals, forces by mean and standard deviation.
    Rms,
    /// Signals to [−1, 1] and forces to [0, 1] by the extremes of the initial body's training samples, for every body.
    Extremes,
}

/// The outer loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OuterLoop {
    /// The decoder with which the body is trained.
    pub brain: DecoderKind,
    /// How body and decoder are trained together.
    pub protocol: TrainingProtocol,
    /// Outer steps.
    pub iterations: u32,
    /// Adam's rate on α (mm); in a search, the standard deviation of the candidates.
    pub rate: f64,
    /// A cheaper integrator for the outer steps of `joint`; test evaluations use the accurate one.
    pub coarse: Option<IntegratorSettings>,
    /// Objective over casts or parts of a mixture (`joint`); `None`: over the body as designed.
    pub casting: Option<CastObjective>,
}

/// An objective over casts or over kinds of forces, drawn anew in each outer step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CastObjective {
    /// Casts or kinds of forces.
    pub over: ObjectiveDomain,
    /// Number of casts per step, or of all parts of the mixture; each has a batch of samples.
    pub casts: usize,
    /// Fraction of the worst casts whose mean loss moves the body: 1 for all, 0 for the worst alone.
    pub tail: f64,
}

/// What an objective averages over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ObjectiveDomain {
    /// Casts, by their losses.
    Casts,
    /// Parts of a mixture of forces, by the logarithms of their losses, which can differ tenfold.
    Parts,
}

impl CastObjective {
    /// The objective of the losses, and its derivative by each. Parts of a mixture are ranked by loss relative to `first`.
    pub fn objective(&self, losses: &[f64], first: &[f64]) -> (f64, Vec<f64>) {
        let sum = |weights: &[f64], of: &dyn Fn(f64) -> f64| {
            let counted = weights.iter().zip(losses).filter(|(by, _)| **by > 0.0);
            counted.map(|(by, loss)| by * of(*loss)).sum::<f64>()
        };
        match self.over {
            ObjectiveDomain::Casts => {
                let weights = self.weights(losses);
                (sum(&weights, &|loss| loss), weights)
            }
            ObjectiveDomain::Parts => {
                let ratios: Vec<f64> = losses.iter().zip(first).map(|(loss, first)| loss / first).collect();
                let mut weights = self.weights(&ratios);
                let mean = sum(&weights, &f64::ln).exp();
                weights.iter_mut().zip(losses).for_each(|(by, loss)| *by *= mean / loss);
                (mean, weights)
            }
        }
    }

    /// Weights of the losses in the objective, with sum 1. With tail 1 − q, the objective is the conditional value at risk at level
    /// q (Rockafellar and Uryasev 2000, doi:10.21314/JOR.2000.038).
    pub fn weights(&self, losses: &[f64]) -> Vec<f64> {
        let one = 1.0 / losses.len() as f64;
        let tail = self.tail.max(one);
        let mut worst: Vec<usize> = (0..losses.len()).collect();
        worst.sort_by(|&a, &b| losses[b].total_cmp(&losses[a]));
        let (mut weights, mut remaining_tail) = (vec![0.0; losses.len()], tail);
        for i in worst {
            weights[i] = one.min(remaining_tail) / tail;
            remaining_tail = (remaining_tail - one).max(0.0);
        }
        weights
    }
}

/// How body and decoder are trained together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TrainingProtocol {
    /// A fresh network in each outer step, trained for `Training::iterations`; the test loss moves the body.
    Paper(Terms),
    /// One network continues; the loss on samples drawn for this step moves the body.
    Joint(StepTraining),
    /// No gradient: candidates around the initial body, each with a fresh network.
    Random(StepTraining),
}

impl TrainingProtocol {
    /// Whether bodies are independent candidates.
    pub(crate) fn is_search(&self) -> bool {
        matches!(self, Self::Random(_))
    }
}

/// Settings of protocols other than `paper`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepTraining {
    /// Samples whose gradient moves the body.
    pub batch: usize,
    /// Adam iterations per outer step.
    pub brain_iterations: usize,
    /// Adam's rate in these iterations.
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

/// The final comparison.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FinalComparison {
    /// Fresh networks per body.
    pub seeds: usize,
    /// Schedule of their learning rate.
    pub schedule: RateSchedule,
    /// Samples per iteration; `None`: all.
    pub batch: Option<usize>,
    /// Iterations of as many further networks with long training.
    pub long: Option<usize>,
    /// Number of casts of each body.
    pub casts: usize,
    /// Whether decoders are also calibrated on records of these casts.
    pub records: bool,
    /// Whether the initial body is compared.
    pub initial: bool,
    /// Whether readouts of all tasks are fitted to each body.
    pub tasks: bool,
}

/// Schedule of Adam's learning rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RateSchedule {
    /// Falls to 0 by a cosine.
    Cosine,
    /// Constant.
    Constant,
}

impl RateSchedule {
    /// Factor on the learning rate in an iteration, from 0.
    pub fn factor(self, iteration: usize, iterations: usize) -> f64 {
        match self {
            Self::Constant => 1.0,
            Self::Cosine => 0.5 * (1.0 + (std::f64::consts::PI * iteration as f64 / iterations as f64).cos()),
        }
    }
}
