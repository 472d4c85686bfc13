//! Stored records. They stay readable for ever: fields are only added, as `#[serde(default)]`.
//!
//! Numbers that may be absent (not computed, not finite) are `Option`, because SQLite has no NaN.

mod checkpoint;

use std::ops::Add;

use serde::{Deserialize, Serialize};

use crate::spec::TrialSpec;

pub use checkpoint::{
    BestDesign, Checkpoint, CheckpointError, ComparisonProgress, Moments, NetworkInTraining, Waypoint,
};

/// A trial of a plan, before it runs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlannedTrial {
    /// Permanent name of the trial.
    pub hash: String,
    /// Hash of the training: [`TrialSpec::training`]. One of the trials that share it trains the body for all.
    #[serde(skip)]
    pub training: String,
    /// All settings.
    pub spec: TrialSpec,
    /// Position in the order of execution, from 0.
    pub order: usize,
    /// Number of units of the body.
    pub units: usize,
    /// Length of α.
    pub design_parameters: usize,
    /// Number of weights of the decoder.
    pub brain_parameters: usize,
    /// Whether this trial trains the body that it shares with later trials of the plan.
    #[serde(skip)]
    pub trains: bool,
    /// Estimated seconds on one core of this machine.
    #[serde(skip)]
    pub cost: Parts<f64>,
    /// Relative work, equal on every machine.
    pub weight: Parts<u64>,
    /// Number of outer steps after which the trial pauses; `None`: never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pause: Option<u32>,
}

impl PlannedTrial {
    /// Estimated seconds on one core of this machine; outer steps count only if the trial trains its body.
    pub fn seconds(&self) -> f64 {
        self.cost.sum(self.trains)
    }
}

/// A quantity of a trial, split into outer steps and final comparison.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Parts<T> {
    /// All outer steps.
    pub steps: T,
    /// The final comparison.
    pub comparison: T,
}

impl<T: Add<Output = T>> Parts<T> {
    /// Returns the sum; the steps count only if the trial trains its body.
    pub fn sum(self, trains: bool) -> T {
        if trains { self.steps + self.comparison } else { self.comparison }
    }
}

/// The code and the machine that compute a trial.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Provenance {
    /// Digest of the sources of the computation.
    pub code: String,
    /// Commit, with `-dirty` if the build had uncommitted changes; `None` for a build without git.
    pub revision: Option<String>,
    /// The compiler.
    pub rustc: String,
    /// Name of the machine.
    pub host: String,
    /// Model of the processor; `None` if unknown.
    pub cpu: Option<String>,
    /// Instruction set of the kernels.
    pub simd: String,
    /// Threads per worker.
    pub threads: u32,
}

/// Exact counts of work.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct WorkCounts {
    /// Evaluations of the ligament forces, one per sample and stage, including those with dual numbers in the reverse sweep.
    pub force_evaluations: u64,
    /// Accepted integrator steps.
    pub steps: u64,
    /// Rejected integrator steps.
    pub rejected: u64,
    /// Adam iterations of the decoder.
    pub brain_iterations: u64,
    /// Hessian-vector products.
    pub hessian_products: u64,
    /// Interior-point iterations of the projection.
    pub projection_iterations: u64,
}

/// CPU time of a step by part (s of the worker process, all threads).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct StepSeconds {
    /// Simulation.
    pub simulate: f64,
    /// Training of the decoder.
    pub train: f64,
    /// Gradient through decoder and body.
    pub differentiate: f64,
    /// Implicit term.
    pub implicit: f64,
    /// Projection.
    pub project: f64,
    /// Sending the previous step to the orchestrator.
    pub store: f64,
}

/// Solution of the linear system of the implicit term.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct ImplicitRecord {
    /// Conjugate-gradient iterations.
    pub iterations: u32,
    /// ‖r‖/‖b‖ at the end.
    pub residual: f64,
    /// Smallest curvature encountered.
    pub smallest_curvature: f64,
    /// `converged`, `iteration_limit`, `negative_curvature`, `non_finite`.
    pub outcome: String,
}

/// One outer step.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct StepRecord {
    /// Outer step, from 0; losses and errors are those of the design before the step.
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
    /// Outcome of the projection: `untouched`, `projected`, `kept`, …
    pub projection: String,
    /// Distance moved by the projection (mm).
    pub projection_distance: Option<f64>,
    /// The implicit term, if computed.
    pub implicit: Option<ImplicitRecord>,
    /// `ok`, or the name of the numerical failure.
    pub outcome: String,
    /// Number of new samples simulated in this step.
    pub fresh_samples: u64,
    /// Counts of work.
    pub counters: WorkCounts,
    /// CPU time by part.
    pub seconds: StepSeconds,
}

/// Distribution of the errors of held-out samples, because a single sample can dominate their mean.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct SpreadRecord {
    /// Median (%).
    pub median: Option<f64>,
    /// 90th percentile (%).
    pub p90: Option<f64>,
    /// Samples above 100 %, the error of a decoder that predicts no force.
    pub above: u32,
}

/// Errors of a fresh network on a body.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct NetworkRecord {
    /// Prediction error on the training set (%).
    pub error_train: Option<f64>,
    /// Prediction error on the test set (%).
    pub error_test: Option<f64>,
    /// Prediction error on the held-out set (%).
    pub error_holdout: Option<f64>,
    /// Training loss (normalised) after every iteration.
    pub losses: Vec<f32>,
    /// (iteration, from 1, held-out error before it (%)), thinned.
    pub errors: Vec<(u32, f64)>,
    /// Weights, flat as b1, b2, b3, w1, w2, w3, each (kernel, in, out); empty for all but the first network.
    pub weights: Vec<f32>,
    /// `ok`, or the name of the numerical failure.
    pub outcome: String,
    /// Distribution of the held-out errors.
    pub spread: Option<SpreadRecord>,
}

/// Errors of a linear decoder on a body.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct ReadingRecord {
    /// Memory before an estimate (instants).
    pub before: u32,
    /// Look-ahead (instants).
    pub after: u32,
    /// λ.
    pub ridge: f64,
    /// Prediction error on the training set (%).
    pub error_train: Option<f64>,
    /// Prediction error on the test set (%).
    pub error_test: Option<f64>,
    /// Prediction error on the held-out set (%).
    pub error_holdout: Option<f64>,
    /// Distribution of the held-out errors.
    pub spread: Option<SpreadRecord>,
}

/// A body with the errors of its decoders.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct BodyRecord {
    /// α (mm), flat.
    pub design: Vec<f64>,
    /// Fresh networks, one per seed.
    pub networks: Vec<NetworkRecord>,
    /// Networks trained for `evaluation.long_iterations`, if set; without weights.
    pub long: Vec<NetworkRecord>,
    /// Linear decoders, in all trials; the first uses the whole sample.
    pub readings: Vec<ReadingRecord>,
    /// Number of samples without force (no error) or with a failed simulation (100 %): training, test, held-out set.
    pub zero_samples: [u32; 3],
}

/// Result of the sensor search.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct PlacedRecord {
    /// Units, the most valuable first.
    pub units: Vec<usize>,
    /// Cross-validated error (%) of a linear decoder with the first m units, m = 1 … M.
    pub errors: Vec<f64>,
    /// The next best set that differs by one unit.
    pub runner_up: Vec<usize>,
    /// Error of that set (%).
    pub runner_up_error: Option<f64>,
    /// λ.
    pub ridge: f64,
    /// Whether the decoder also used the signal |x|², which lowered the error.
    pub energies: bool,
}

/// Error of one decoder on one cast of a body.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct CastRecord {
    /// Number of the cast, from 0; casts of equal number have equal deviations on both bodies.
    pub cast: u32,
    /// `network`: the first network of the comparison; `network_casts`: trained on other casts; linear decoders `nominal`:
    /// fitted to the body as designed, `casts`: to other casts, `records`: to samples of this cast; `inverse`: the inverted
    /// model of the design; `twin`: an inverted twin of this cast; `twin_linear`: a linear decoder fitted to that twin.
    pub reader: String,
    /// Number of samples of this cast to which the decoder or its twin was fitted.
    pub records: u32,
    /// Prediction error on the held-out set (%).
    pub error: Option<f64>,
    /// `ok`, or the name of the numerical failure.
    pub outcome: String,
    /// Distribution of the held-out errors.
    pub spread: Option<SpreadRecord>,
    /// λ of a linear decoder, or of the linear part of a stacked one.
    pub ridge: Option<f64>,
    /// κ of a linear decoder calibrated on this cast: weight of a sample of other casts relative to a record.
    pub share: Option<f64>,
}

/// A band around the estimated forces: its coverage on the held-out set and its width.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct BandRecord {
    /// `own`: the first decoder of the body; on casts as in [`CastReading`].
    pub reader: String,
    /// Number of samples of the cast to which it was fitted, as in [`CastReading`].
    pub records: u32,
    /// Number of the cast, as in [`CastReading`]; its widths are those of the body as designed. `None`: the body as designed.
    pub cast: Option<u32>,
    /// `conformal`: calibrated on samples to which neither decoder nor body was fitted; `posterior`: from an inverse decoder.
    pub method: String,
    /// What the level applies to: `instant`, single instants and panels; `sample`, whole samples.
    pub kind: String,
    /// Nominal coverage, as a fraction.
    pub level: f64,
    /// Number of calibration samples; of a posterior, number of decoded samples that the model explains.
    pub samples: u32,
    /// Fraction of the held-out instants and panels, or samples, within the band.
    pub coverage: Option<f64>,
    /// Mean width (N).
    pub width: Option<f64>,
    /// Half width (N), shape (T, K), if equal for all samples; else empty.
    pub half_width: Vec<f64>,
    /// `ok`; `too_few`: too few samples to calibrate at this level.
    pub outcome: String,
}

/// Error of a linear decoder on a body under another kind of forces (`evaluation.under`).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct UnderRecord {
    /// `initial` or `optimised`.
    pub body: String,
    /// Kind of forces.
    pub stimuli: String,
    /// `own`: fitted under these forces; `carried`: under those of the trial.
    pub reader: String,
    /// Prediction error on the held-out set (%).
    pub error: Option<f64>,
    /// `ok`, or the name of the numerical failure.
    pub outcome: String,
    /// Distribution of the held-out errors.
    pub spread: Option<SpreadRecord>,
}

/// Error of a readout of a sensing task on a body (`evaluation.tasks`).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct TaskReading {
    /// `initial` or `optimised`.
    pub body: String,
    /// Name of the task; `forces`: the force histories.
    pub task: String,
    /// `direct`: fitted to the signals; `decoded`: from the forces that a linear decoder estimates.
    pub readout: String,
    /// Unit of the error.
    pub unit: String,
    /// Error on the held-out set.
    pub error: Option<f64>,
    /// Its 95 % confidence interval over samples.
    pub interval: [Option<f64>; 2],
    /// Resolution of the error: half the contribution of one wrong class, or of one instant; 0 without such steps.
    pub least: f64,
    /// Error of the best estimate without signals.
    pub trivial: Option<f64>,
    /// Number of held-out samples.
    pub samples: u32,
    /// Balanced accuracy (%) of classes; R² of values.
    pub score: Option<f64>,
    /// Of a class, true class, estimated class, number of samples; of a position, panel with the greatest force, mean error (mm),
    /// number of samples; else empty.
    pub detail: Vec<[f64; 3]>,
    /// Mean error over casts (`evaluation.casts`), with the readout fitted to the body as designed.
    pub casts: Option<f64>,
    /// Mean of −ln p of the true class; `None` for values and decoded forces.
    pub log_loss: Option<f64>,
    /// Expected calibration error of these probabilities (%).
    pub calibration_error: Option<f64>,
    /// Per tenth of the probability of the estimated class: mean probability, frequency as the true class, number of samples.
    pub reliability: Vec<[f64; 3]>,
}

impl TaskReading {
    /// Whether both are of the same task and readout.
    pub fn is_like(&self, other: &Self) -> bool {
        (&self.task, &self.readout) == (&other.task, &other.readout)
    }
}

/// Result of a finished trial.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct TrialResult {
    /// The initial body.
    pub initial: BodyRecord,
    /// The trained body.
    pub optimised: BodyRecord,
    /// Outer step whose design has the least test error.
    pub best_step: u32,
    /// CPU seconds of the evaluations, including simulation; of one evaluation if training left the body unchanged.
    pub seconds_evaluation: f64,
    /// Counts of work of the evaluations.
    pub counters: WorkCounts,
    /// Instruction set of the hot kernels: `avx512`, `avx2`, `baseline`.
    pub simd: String,
    /// The chosen integrator, and why.
    pub solver: String,
    /// Relative error of the signals of initial and trained body, if their pilots could measure it.
    pub signal_errors: [Option<f64>; 2],
    /// Units chosen by the sensor search; `None` if placements are random.
    pub placed: Option<PlacedRecord>,
    /// Moves of sensors, only in older records: outer step before a move, and the new units.
    pub moves: Vec<(u32, Vec<usize>)>,
    /// Nonlinear share (%) of the accelerations and of the angular velocities, initial and trained body.
    pub nonlinear: [Option<[f64; 2]>; 2],
    /// Errors on casts of the initial and of the trained body.
    pub casts: [Vec<CastRecord>; 2],
    /// Bands of both bodies and of their casts.
    pub bands: [Vec<BandRecord>; 2],
    /// Errors of both bodies under other kinds of forces, if requested.
    pub under: Vec<UnderRecord>,
    /// Errors of readouts of all tasks on both bodies, if requested.
    pub tasks: Vec<TaskReading>,
    /// Drawings (SVG) of the initial and of the trained body by an external body's program; empty: none.
    pub drawings: Vec<String>,
}
