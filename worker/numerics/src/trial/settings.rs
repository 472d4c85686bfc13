//! How a trial trains its body and brains: data alone.

use crate::brain::linear::Lags;
use crate::brain::{Architecture, Policy};
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
    /// A cheaper integrator for the steps that move the body far; the accurate one finishes. `joint` and `envelope`.
    pub coarse: Option<Solver>,
}

/// How body and brain are trained together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Protocol {
    /// A fresh network each outer step, trained `Training::iterations`; the test loss moves the body.
    Paper(Terms),
    /// The network goes on; the training loss moves the body, from a subset of samples.
    Envelope(Going),
    /// The network goes on; the loss on samples drawn for the step alone moves the body.
    Joint(Going),
    /// No gradient: candidates drawn about the initial body; the network goes on from one to the next.
    Random(Going),
    /// Likewise, drawn by CMA-ES.
    Cmaes(Going),
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
    Implicit(Policy),
    /// Through the test signals alone.
    Direct,
}

/// The comparison of the initial and the best body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evaluation {
    /// Fresh networks a body.
    pub seeds: usize,
    /// Rate schedule of their training.
    pub schedule: Schedule,
    /// Iterations of as many further networks, whose training is to be a long one.
    pub long: Option<usize>,
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
