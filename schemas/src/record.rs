//! What is stored: readable for ever, grown by addition only (new fields are `#[serde(default)]`).
//!
//! Numbers that may be absent (not computed, not finite) are `Option`: SQLite knows no NaN.

mod checkpoint;

use std::ops::Add;

use serde::{Deserialize, Serialize};

use crate::spec::TrialSpec;

pub use checkpoint::{Best, Checkpoint, CheckpointError, Comparison, Moments, Training, Waypoint};

/// A trial as a plan has it, before it has run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// Names the trial for ever.
    pub hash: String,
    /// Names what trains its body: [`TrialSpec::training`]. One of the trials that share it trains the body for all.
    #[serde(skip)]
    pub training: String,
    /// All that it is.
    pub spec: TrialSpec,
    /// Position in the order of running, from 0.
    pub order: usize,
    /// Units of its body.
    pub units: usize,
    /// Length of α.
    pub design_parameters: usize,
    /// Weights of its brain.
    pub brain_parameters: usize,
    /// Whether it is the first of the plan to train its body: the others find it trained.
    #[serde(skip)]
    pub trains: bool,
    /// Estimated seconds on one core of this machine.
    #[serde(skip)]
    pub cost: Parts<f64>,
    /// Work against other trials: the same numbers on every machine.
    pub weight: Parts<u64>,
    /// Outer steps after which it is to pause; `None`: it is run to its end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pause: Option<u32>,
}

impl Trial {
    /// Estimated seconds on one core of this machine, those of its steps where it is the one to make them.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        self.cost.sum(self.trains)
    }
}

/// What of a trial is its outer steps, and what the comparison at its end.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Parts<T> {
    /// All outer steps.
    pub steps: T,
    /// The comparison.
    pub comparison: T,
}

impl<T: Add<Output = T>> Parts<T> {
    /// Of a trial that makes the steps, or finds them made.
    pub fn sum(self, trains: bool) -> T {
        if trains { self.steps + self.comparison } else { self.comparison }
    }
}

/// The result of a settled trial, as far as the questions of `[until]` are about it.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// Which.
    pub hash: String,
    /// Holdout errors (%) of the initial and the optimised body; none of a trial that has failed.
    pub errors: [Option<f64>; 2],
    /// CPU seconds.
    pub seconds: f64,
}

/// By what code, and where, a trial is computed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Provenance {
    /// Digest of the sources that compute.
    pub code: String,
    /// Commit, with `-dirty` where the build had changes that it lacks; `None` of a build without git.
    pub revision: Option<String>,
    /// The compiler.
    pub rustc: String,
    /// Name of the machine.
    pub host: String,
    /// Model of its processor; `None` where the system does not say.
    pub cpu: Option<String>,
    /// Instruction set of the kernels.
    pub simd: String,
    /// Threads of a worker.
    pub threads: u32,
}

/// Exact counts of work.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Counters {
    /// Evaluations of the ligament forces, one a sample and stage (dual ones of the reverse sweep included).
    pub force_evaluations: u64,
    /// Accepted integrator steps.
    pub steps: u64,
    /// Rejected integrator steps.
    pub rejected: u64,
    /// Adam iterations on the brain.
    pub brain_iterations: u64,
    /// Hessian-vector products.
    pub hessian_products: u64,
    /// Interior-point iterations of the projection.
    pub projection_iterations: u64,
}

/// Where the time of a step went (CPU seconds of the worker's process, all threads).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Seconds {
    /// Simulation.
    pub simulate: f64,
    /// Training of the brain.
    pub train: f64,
    /// Gradient through network and body.
    pub differentiate: f64,
    /// Implicit term.
    pub implicit: f64,
    /// Projection.
    pub project: f64,
    /// Handing the step before over to the store.
    pub store: f64,
}

/// The linear system of the implicit term.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct ImplicitRecord {
    /// Conjugate-gradient iterations.
    pub iterations: u32,
    /// ‖r‖/‖b‖ at the end.
    pub residual: f64,
    /// Least curvature met.
    pub smallest_curvature: f64,
    /// `converged`, `iteration_limit`, `negative_curvature`, `non_finite`.
    pub outcome: String,
}

/// One outer step.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct StepRecord {
    /// Outer step, from 0; the design it speaks of is the one before the step.
    pub step: u32,
    /// Test loss (N²).
    pub loss_test: Option<f64>,
    /// Training loss (normalised).
    pub loss_train: Option<f64>,
    /// Prediction error on the test set (%).
    pub error_test: Option<f64>,
    /// Prediction error on the training set (%).
    pub error_train: Option<f64>,
    /// λ of the linear decoder that the body is trained with.
    pub ridge: Option<f64>,
    /// Euclidean norm of the gradient in α.
    pub gradient_norm: Option<f64>,
    /// Euclidean norm of the accepted change of α (mm).
    pub step_length: Option<f64>,
    /// What the projection did: `untouched`, `projected`, `kept`, …
    pub projection: String,
    /// Distance moved by the projection (mm).
    pub projection_distance: Option<f64>,
    /// The implicit term, where taken.
    pub implicit: Option<ImplicitRecord>,
    /// `ok`, or the named numerical outcome.
    pub outcome: String,
    /// Samples simulated anew in this step.
    pub fresh_samples: u64,
    /// Counts of work.
    pub counters: Counters,
    /// Where the time went.
    pub seconds: Seconds,
}

/// How the errors of held-out samples spread, beside their mean, which a single sample can dominate.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Spread {
    /// Median (%).
    pub median: Option<f64>,
    /// 90th percentile (%).
    pub p90: Option<f64>,
    /// Samples above 100 %, the error of a decoder that predicts no force.
    pub above: u32,
}

/// A fresh network on a body.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct NetworkEvaluation {
    /// Prediction error on the training set (%).
    pub error_train: Option<f64>,
    /// Prediction error on the test set (%).
    pub error_test: Option<f64>,
    /// Prediction error on the holdout (%).
    pub error_holdout: Option<f64>,
    /// Training loss (normalised) after every iteration.
    pub losses: Vec<f32>,
    /// (iteration, from 1, prediction error on the holdout before it (%)), thinned.
    pub errors: Vec<(u32, f64)>,
    /// Its weights, flat as b1, b2, b3, w1, w2, w3, each (kernel, in, out); of the first network, empty of others.
    pub weights: Vec<f32>,
    /// `ok`, or the named numerical outcome.
    pub outcome: String,
    /// Of the errors on the holdout.
    pub spread: Option<Spread>,
}

/// Mean of an error over the networks that have it.
#[must_use]
pub fn mean(
    networks: &[NetworkEvaluation],
    error: impl Fn(&NetworkEvaluation) -> Option<f64>,
) -> Option<f64> {
    let errors: Vec<f64> = networks.iter().filter_map(error).filter(|e| e.is_finite()).collect();
    (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64)
}

/// Samples above 100 %, of the network with the most; `None` where none says.
#[must_use]
pub fn most_above(networks: &[NetworkEvaluation]) -> Option<u32> {
    networks.iter().filter_map(|network| Some(network.spread?.above)).max()
}

/// A linear brain on a body.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Reading {
    /// How far it looks back (instants).
    pub before: u32,
    /// How far it looks ahead (instants).
    pub after: u32,
    /// λ.
    pub ridge: f64,
    /// Prediction error on the training set (%).
    pub error_train: Option<f64>,
    /// Prediction error on the test set (%).
    pub error_test: Option<f64>,
    /// Prediction error on the holdout (%).
    pub error_holdout: Option<f64>,
    /// Of the errors on the holdout.
    pub spread: Option<Spread>,
}

/// A body with its fresh networks, one a seed.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct BodyEvaluation {
    /// α (mm), flat.
    pub design: Vec<f64>,
    /// One entry a seed.
    pub networks: Vec<NetworkEvaluation>,
    /// The same trained `evaluation.long_iterations`, where asked for; without weights.
    pub long: Vec<NetworkEvaluation>,
    /// By linear brains, whatever the trial's own is: the whole sample's first.
    pub readings: Vec<Reading>,
    /// Samples without force, which have no error, or whose simulation failed, which have 100 %: train, test, holdout.
    pub zero_samples: [u32; 3],
}

/// What a search for the sensors' places found.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Placed {
    /// The units, those worth most first.
    pub units: Vec<usize>,
    /// Error (%) of a linear brain on training samples that it has not seen, with the first m of them, m = 1 … M.
    pub errors: Vec<f64>,
    /// The next best set that differs by one unit.
    pub runner_up: Vec<usize>,
    /// Its error (%).
    pub runner_up_error: Option<f64>,
    /// λ.
    pub ridge: f64,
    /// Whether the linear brain saw the energies of the signals, too, which it then read better.
    pub energies: bool,
}

/// How one brain reads one cast of a body.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct CastReading {
    /// Which cast, from 0; those of equal number are cast alike, whatever the body.
    pub cast: u32,
    /// `network`: the first network of the comparison; of linear brains `nominal`: fitted to the body as designed, `casts`: to
    /// other casts, `records`: to samples of this one; `inverse`: the model of the design, `twin`: a twin of this cast, inverted,
    /// `twin_linear`: a linear brain fitted to that twin.
    pub reader: String,
    /// How many samples of this cast it, or its twin, was fitted to.
    pub records: u32,
    /// Prediction error on the holdout (%).
    pub error: Option<f64>,
    /// `ok`, or the named numerical outcome.
    pub outcome: String,
    /// Of the errors on the holdout.
    pub spread: Option<Spread>,
    /// λ of a linear brain.
    pub ridge: Option<f64>,
    /// κ of a linear brain that is calibrated beside the samples of other casts.
    pub share: Option<f64>,
}

/// A band about what a brain says of the forces: how much of the holdout lies in it, and how wide it is.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Band {
    /// `own`: the body's first brain; of casts as in [`CastReading`].
    pub reader: String,
    /// Fitted to how many samples of that cast, as in [`CastReading`].
    pub records: u32,
    /// Of which cast, as in [`CastReading`], with the widths of the body as designed; `None`: the body as designed.
    pub cast: Option<u32>,
    /// `conformal`: calibrated on samples that neither brain nor body was fitted to; `posterior`: an inverse brain's own.
    pub method: String,
    /// What lies in it at its level: `instant`, each instant and panel by itself; `sample`, a whole sample.
    pub kind: String,
    /// How often, as a part of 1.
    pub level: f64,
    /// How many samples calibrated it; of a posterior's, how many of those read the model explains.
    pub samples: u32,
    /// The part of the holdout's instants and panels, or samples, that lies in it.
    pub coverage: Option<f64>,
    /// Mean width (N).
    pub width: Option<f64>,
    /// What lies to each side of a prediction (N), (T, K), where that is the same for all samples; else empty.
    pub half_width: Vec<f64>,
    /// `ok`; `too_few`: too few samples to calibrate at this level.
    pub outcome: String,
}

/// How a linear brain reads a body under forces of a kind that its trial need not have.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct UnderReading {
    /// `initial` or `optimised`.
    pub body: String,
    /// Kind of forces.
    pub stimuli: String,
    /// `own`: fitted to samples under these forces; `carried`: to the trial's.
    pub reader: String,
    /// Prediction error on the holdout (%).
    pub error: Option<f64>,
    /// `ok`, or the named numerical outcome.
    pub outcome: String,
    /// Of the errors on the holdout.
    pub spread: Option<Spread>,
}

/// A finished trial.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct TrialResult {
    /// The initial body.
    pub initial: BodyEvaluation,
    /// The best body.
    pub optimised: BodyEvaluation,
    /// The outer step whose design is the best, by the test set.
    pub best_step: u32,
    /// CPU seconds of the evaluations, simulation included: of one, where nothing has moved the body.
    pub seconds_evaluation: f64,
    /// Counts of work of the evaluations.
    pub counters: Counters,
    /// Instruction set of the hot kernels: `avx512`, `avx2`, `baseline`.
    pub simd: String,
    /// What `solver.method` came to, and why.
    pub solver: String,
    /// Relative error of the signals that pilots measured, on the initial body and on the best, where they could.
    pub signal_errors: [Option<f64>; 2],
    /// Units chosen by the sensor search; `None` if placements are random.
    pub placed: Option<Placed>,
    /// Where they went from there: the outer step before which they moved, and their units since.
    pub moves: Vec<(u32, Vec<usize>)>,
    /// The part of the initial and of the best body's accelerations and angular velocities that their linearisation at rest
    /// does not give (%).
    pub nonlinear: [Option<[f64; 2]>; 2],
    /// How casts of the initial and of the best body are read.
    pub casts: [Vec<CastReading>; 2],
    /// Bands about what is read of both bodies, and of their casts.
    pub bands: [Vec<Band>; 2],
    /// How both bodies are read under forces of other kinds, where asked for.
    pub under: Vec<UnderReading>,
}
