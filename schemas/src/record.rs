//! What is stored: readable for ever, grown by addition only (new fields are `#[serde(default)]`).
//!
//! Numbers that may be absent (not computed, not finite) are `Option`: SQLite knows no NaN.

use serde::{Deserialize, Serialize};

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
    /// What stood for H⁻¹: `truncate`, `damped`, `gauss_newton`, as the trial's spec says.
    pub policy: String,
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
}

/// What a linear brain makes of a body.
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
    /// Samples without force, which have no error: train, test, holdout.
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
    /// CPU seconds of the two evaluations, simulation included.
    pub seconds_evaluation: f64,
    /// Counts of work of the two evaluations.
    pub counters: Counters,
    /// Instruction set of the hot kernels: `avx512`, `avx2`, `baseline`.
    pub simd: String,
    /// What `solver.method` came to, and why.
    pub solver: String,
    /// Where a search put the sensors, where there was one.
    pub placed: Option<Placed>,
}

/// What is needed to go on inside a trial. Stored as postcard bytes behind a version byte.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Checkpoint {
    /// The next outer step.
    pub step: u32,
    /// α (mm).
    pub design: Vec<f64>,
    /// First and second moments of Adam on α, and its count of steps.
    pub design_moments: (Vec<f64>, Vec<f64>, u64),
    /// Brain weights, where the protocol keeps them.
    pub weights: Vec<f32>,
    /// Moments of Adam on the brain, and its count of steps.
    pub weight_moments: (Vec<f32>, Vec<f32>, u64),
    /// The best design so far, its test error (%) and its step.
    pub best: Option<(Vec<f64>, f64, u32)>,
    /// What else the protocol carries from step to step (rate factors, running trends), by position.
    pub protocol: Vec<f64>,
}
