//! What is stored: readable for ever, grown by addition only (new fields are `#[serde(default)]`).
//!
//! Numbers that may be absent (not computed, not finite) are `Option`: SQLite knows no NaN.

use serde::{Deserialize, Serialize};

use crate::spec::TrialSpec;

/// A trial as a plan has it, before it has run.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// Names the trial for ever.
    pub hash: String,
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
    /// Estimated seconds on one core.
    pub cost: f64,
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

/// Mean of an error over the networks that have it.
#[must_use]
pub fn mean(
    networks: &[NetworkEvaluation],
    error: impl Fn(&NetworkEvaluation) -> Option<f64>,
) -> Option<f64> {
    let errors: Vec<f64> = networks.iter().filter_map(error).filter(|e| e.is_finite()).collect();
    (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64)
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
    /// Samples without force, or whose simulation failed, which have no error: train, test, holdout.
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
    /// Relative error of the signals that pilots measured, on the initial body and on the best, where they could.
    pub signal_errors: [Option<f64>; 2],
    /// Where a search put the sensors, where there was one.
    pub placed: Option<Placed>,
    /// Where they went from there: the outer step before which they moved, and their units since.
    pub moves: Vec<(u32, Vec<usize>)>,
    /// The part of the initial and of the best body's accelerations and angular velocities that their linearisation at rest
    /// does not give (%).
    pub nonlinear: [Option<[f64; 2]>; 2],
}

/// A network in training.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Training {
    /// Its weights.
    pub weights: Vec<f32>,
    /// First and second moments of Adam on them, and its count of steps.
    pub moments: (Vec<f32>, Vec<f32>, u64),
    /// Training loss (normalised) at every iteration so far.
    pub losses: Vec<f32>,
    /// (Iteration, from 1, prediction error on the holdout before it (%)), thinned.
    pub errors: Vec<(u32, f64)>,
}

/// How far the comparison at the end has come.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Comparison {
    /// The bodies, the initial one first; the last may lack networks.
    pub bodies: Vec<BodyEvaluation>,
    /// The network that is being trained on it.
    pub training: Option<Training>,
    /// Counts of work.
    pub counters: Counters,
    /// Where the time went.
    pub seconds: Seconds,
}

/// What is needed to go on inside a trial. Stored as postcard bytes behind a version byte: these know no field by its name,
/// so that a field more, in what it holds too, is a version more, and [`Checkpoint::from_bytes`] goes on reading the old ones.
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
    /// Where it has begun (since version 2).
    pub comparison: Option<Box<Comparison>>,
    /// Where the sensors have moved: the first outer step there, and their units (since version 2).
    pub moves: Vec<(u32, Vec<usize>)>,
    /// Fitness of the candidates of a search without gradient so far (since version 3).
    pub found: Vec<f64>,
}

/// A stored checkpoint that this program cannot go on from.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CheckpointError {
    /// Of another program.
    #[error("it is of version {0}, this program knows version {known}", known = Checkpoint::VERSION)]
    Version(u8),
    /// Cut short, or of another shape than its version says.
    #[error("it is damaged: {0}")]
    Damaged(String),
}

impl Checkpoint {
    /// Of what [`Checkpoint::to_bytes`] writes.
    pub const VERSION: u8 = 3;

    /// As it is stored.
    ///
    /// # Panics
    /// Never: it is plain data.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        postcard::to_extend(self, vec![Self::VERSION]).expect("a checkpoint is plain data")
    }

    /// From what is stored.
    ///
    /// # Errors
    /// If it is of another version, or not whole.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CheckpointError> {
        let damaged = |why: &dyn std::fmt::Display| CheckpointError::Damaged(why.to_string());
        let read = |bytes: &[u8]| match postcard::take_from_bytes(bytes) {
            Ok((checkpoint, [])) => Ok(checkpoint),
            Ok((_, more)) => Err(damaged(&format!("{} bytes too many", more.len()))),
            Err(error) => Err(damaged(&error)),
        };
        match bytes.split_first() {
            Some((&Self::VERSION, rest)) => read(rest),
            // They end before what came later, of which there is nothing.
            Some((2, rest)) => read(&[rest, &[0]].concat()),
            Some((1, rest)) => read(&[rest, &[0, 0, 0]].concat()),
            Some((version, _)) => Err(CheckpointError::Version(*version)),
            None => Err(damaged(&"it is empty")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const VERSION_1: &str = "01 ac02 02 000000000000e03f 00000000000000c0 01 000000000000f03f 01 0000000000000040 07 \
        01 0000803e 01 0000003f 00 c801 01 01 000000000000f83f 0000000000002940 ab02 01 0000000000000840";
    const VERSION_2: &str = "02 ac02 02 000000000000e03f 00000000000000c0 01 000000000000f03f 01 0000000000000040 07 \
        01 0000803e 01 0000003f 00 c801 01 01 000000000000f83f 0000000000002940 ab02 01 0000000000000840 01 \
        0101000000000000e03f0101000000000000f03f00010000000000000040010000003f01010000000000001040010000803e \
        026f6b01000000000000000103c801000000000000e03f01000000000000f03f000100000000000000400102ac0201010000 \
        003f010000803e01000080beac02010000004001c80100000000000020400102030405d804000000000000f03f0000000000 \
        0000400000000000000840000000000000104000000000000014400000000000001840 01 c801 02 03 05";

    fn bytes(digits: &str) -> Vec<u8> {
        let digits: Vec<u8> = digits.bytes().filter(u8::is_ascii_hexdigit).collect();
        let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap();
        digits.chunks(2).map(byte).collect()
    }

    /// What any version has written is read for ever: whoever changes `Checkpoint`, or what it holds, sees these bytes fail,
    /// and adds a version.
    #[test]
    fn checkpoints_of_all_versions_go_on() {
        let first = Checkpoint {
            step: 300,
            design: vec![0.5, -2.0],
            design_moments: (vec![1.0], vec![2.0], 7),
            weights: vec![0.25],
            weight_moments: (vec![0.5], Vec::new(), 200),
            best: Some((vec![1.5], 12.5, 299)),
            protocol: vec![3.0],
            comparison: None,
            moves: Vec::new(),
            found: Vec::new(),
        };
        let network = NetworkEvaluation {
            error_train: Some(1.0),
            error_test: None,
            error_holdout: Some(2.0),
            losses: vec![0.5],
            errors: vec![(1, 4.0)],
            weights: vec![0.25],
            outcome: "ok".into(),
        };
        let reading = Reading {
            before: 3,
            after: 200,
            ridge: 0.5,
            error_train: Some(1.0),
            error_test: None,
            error_holdout: Some(2.0),
        };
        let body = BodyEvaluation {
            design: vec![0.5],
            long: vec![NetworkEvaluation::default()],
            networks: vec![network],
            readings: vec![reading],
            zero_samples: [1, 2, 300],
        };
        let training = Training {
            weights: vec![0.5],
            moments: (vec![0.25], vec![-0.25], 300),
            losses: vec![2.0],
            errors: vec![(200, 8.0)],
        };
        let counters = Counters {
            force_evaluations: 1,
            steps: 2,
            rejected: 3,
            brain_iterations: 4,
            hessian_products: 5,
            projection_iterations: 600,
        };
        let seconds = Seconds {
            simulate: 1.0,
            train: 2.0,
            differentiate: 3.0,
            implicit: 4.0,
            project: 5.0,
            store: 6.0,
        };
        let comparison = Comparison { bodies: vec![body], training: Some(training), counters, seconds };
        let (comparison, moves) = (Some(Box::new(comparison)), vec![(200, vec![3, 5])]);
        let second = Checkpoint { comparison, moves, ..first.clone() };
        assert_eq!(Checkpoint::from_bytes(&bytes(VERSION_1)), Ok(first));
        assert_eq!(Checkpoint::from_bytes(&bytes(VERSION_2)), Ok(second.clone()));
        let third = Checkpoint { found: vec![12.5, f64::INFINITY], ..second };
        let version_3 = VERSION_2.replacen("02", "03", 1) + "02 0000000000002940 000000000000f07f";
        assert_eq!(Checkpoint::from_bytes(&bytes(&version_3)), Ok(third.clone()));
        assert_eq!(third.to_bytes(), bytes(&version_3));
        assert_eq!(Checkpoint::from_bytes(&[99, 1, 2]), Err(CheckpointError::Version(99)));
        for stored in [VERSION_1, VERSION_2].map(bytes) {
            for broken in [&stored[..stored.len() - 1], &[&stored[..], &[0]].concat(), &[]] {
                assert!(
                    matches!(Checkpoint::from_bytes(broken), Err(CheckpointError::Damaged(_))),
                    "{broken:?}"
                );
            }
        }
    }

    /// Ten thousand checkpoints with some bytes changed, cut off or added: an answer each, and no panic.
    #[test]
    fn no_stored_bytes_make_a_reader_panic() {
        let whole = Checkpoint {
            step: 3,
            design: vec![0.5; 6],
            weights: vec![0.25; 4],
            best: Some((vec![1.5; 6], 12.5, 2)),
            protocol: vec![3.0; 4],
            comparison: Some(Box::new(Comparison {
                bodies: vec![BodyEvaluation::default()],
                ..Default::default()
            })),
            ..Default::default()
        };
        let mut runner = proptest::test_runner::TestRunner::new(proptest::test_runner::Config {
            cases: 10_000,
            failure_persistence: None,
            ..Default::default()
        });
        let edits = (proptest::collection::vec((0usize..120, 0u8..=255), 0..6), 0usize..120);
        let read = |(edits, length): (Vec<(usize, u8)>, usize)| {
            let mut bytes = whole.to_bytes();
            bytes.resize(length.max(1), 0xff);
            for (at, value) in edits {
                let end = bytes.len() - 1;
                bytes[at.min(end)] = value;
            }
            let _ = Checkpoint::from_bytes(&bytes);
            Ok(())
        };
        runner.run(&edits, read).unwrap();
    }
}
