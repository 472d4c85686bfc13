//! Results of the comparison: fresh decoders on the initial and on the best body.

use super::report::Seconds;
use super::{Nonlinear, UnderReading};
use crate::brains::{Band, NetworkTraining, Reading, TaskEstimate};
use crate::trial::{Counters, FAILED, Problem, Result, Spread, Trouble, mean_error};

/// A fresh decoder on a body.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NetworkEvaluation {
    /// Mean prediction error on the training set (%).
    pub error_train: Option<f64>,
    /// Mean prediction error on the test set (%).
    pub error_test: Option<f64>,
    /// Mean prediction error on the held-out set (%).
    pub error_holdout: Option<f64>,
    /// Distribution of the held-out errors.
    pub spread: Option<Spread>,
    /// Training loss (normalised) at every iteration.
    pub losses: Vec<f32>,
    /// At `brain::milestones`: iteration, from 1, and mean prediction error on the held-out set before it (%).
    pub errors: Vec<(u32, f64)>,
    /// Weights of the first network, for inputs at the trial's scales; empty for other networks.
    pub weights: Vec<f32>,
    /// Why fitting failed.
    pub trouble: Option<Trouble>,
}

impl NetworkEvaluation {
    /// From the mean error on the training set and the errors of the test and held-out samples.
    pub(super) fn of(error_train: Option<f64>, test: &[Option<f64>], holdout: &[Option<f64>]) -> Self {
        let (error_test, error_holdout) = (mean_error(test), mean_error(holdout));
        Self { error_train, error_test, error_holdout, spread: Spread::of(holdout), ..Self::default() }
    }

    /// Result of a decoder that could not be fitted.
    pub(super) fn failed(trouble: Trouble) -> Self {
        Self { trouble: Some(trouble), ..Self::default() }
    }
}

/// A body with its fresh decoders.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BodyEvaluation {
    /// α (mm).
    pub design: Vec<f64>,
    /// One entry per seed; a single entry for linear and inverse decoders.
    pub networks: Vec<NetworkEvaluation>,
    /// The same networks after long training, if requested.
    pub long: Vec<NetworkEvaluation>,
    /// Errors of linear decoders, for any `brain.kind`: whole-sample memory first, then other memories.
    pub readings: Vec<Reading>,
    /// Number of training, test and held-out samples without force, including failed ones (error 100 %).
    pub zero_samples: [u32; 3],
}

/// Evaluation of one decoder on one cast.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CastEvaluation {
    /// Number of the cast, from 0.
    pub cast: u32,
    /// Which decoder.
    pub decoder: CastDecoder,
    /// Mean error on the held-out set (%); `None` if no sample has a force.
    pub error: Option<f64>,
    /// Distribution of the held-out errors.
    pub spread: Option<Spread>,
    /// λ and κ.
    pub regularisation: Regularisation,
    /// Why evaluation failed; the error is then 100 %.
    pub trouble: Option<Trouble>,
}

/// Regularisation of a decoder that is applied to casts.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Regularisation {
    /// λ of a linear decoder, or of the linear part of a stacked one.
    pub ridge: Option<f64>,
    /// κ of a linear decoder that is calibrated on records of the cast.
    pub kappa: Option<f64>,
}

impl CastEvaluation {
    /// From the errors of the held-out samples, or from the failure.
    pub(super) fn new(
        cast: u32,
        decoder: CastDecoder,
        found: Result<(Vec<Option<f64>>, Regularisation)>,
    ) -> Self {
        let (error, spread, regularisation, trouble) = match found {
            Ok((errors, regularisation)) => (mean_error(&errors), Spread::of(&errors), regularisation, None),
            Err(trouble) => (Some(FAILED), Some(Spread::FAILED), Regularisation::default(), Some(trouble)),
        };
        Self { cast, decoder, error, spread, regularisation, trouble }
    }
}

/// Decoders that are applied to casts, in the order of tables: within each kind, calibrated decoders come last.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum CastDecoder {
    /// The first network of the comparison, trained on the body as designed.
    Network,
    /// A network trained on samples of many other casts, as many in total as the training set has.
    NetworkCasts,
    /// A linear decoder fitted to the body as designed.
    Nominal,
    /// A linear decoder fitted to samples of many other casts.
    Casts,
    /// A linear decoder fitted to this many records of the cast and to samples of other casts.
    Records(u32),
    /// An inverse decoder with the model of the design.
    Inverse,
    /// A linear decoder fitted to a twin that was calibrated on this many records of the cast.
    TwinLinear(u32),
    /// An inverse decoder with this twin as its model.
    Twin(u32),
}

impl CastDecoder {
    /// Its name in records and the database.
    pub fn name(self) -> &'static str {
        match self {
            Self::Network => "network",
            Self::NetworkCasts => "network_casts",
            Self::Nominal => "nominal",
            Self::Casts => "casts",
            Self::Records(_) => "records",
            Self::Inverse => "inverse",
            Self::TwinLinear(_) => "twin_linear",
            Self::Twin(_) => "twin",
        }
    }

    /// Number of records of the cast to which the decoder or its twin is fitted.
    pub fn records(self) -> Option<u32> {
        match self {
            Self::Records(records) | Self::TwinLinear(records) | Self::Twin(records) => Some(records),
            _ => None,
        }
    }

    /// The decoder with this database name and number of records.
    pub fn named(name: &str, records: u32) -> Option<Self> {
        let alone = [Self::Network, Self::NetworkCasts, Self::Nominal, Self::Casts, Self::Inverse];
        let of_records = [Self::Records(records), Self::TwinLinear(records), Self::Twin(records)];
        alone.into_iter().chain(of_records).find(|by| by.name() == name)
    }
}

/// A prediction band and its coverage of the held-out set.
#[derive(Debug, Clone, PartialEq)]
pub struct BandCoverage {
    /// Cast and decoder; `None`: the first decoder, on the body as designed.
    pub cast: Option<(u32, CastDecoder)>,
    /// The band. On casts it has no half-widths; conformal bands are those of the body as designed.
    pub band: Band,
    /// Mean width (N).
    pub width: Option<f64>,
    /// Fraction of held-out instants and panels, or of samples, inside the band.
    pub coverage: Option<f64>,
}

/// The final comparison so far.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Comparison {
    /// The bodies, the initial one first; the last may still lack networks.
    pub bodies: Vec<BodyEvaluation>,
    /// Evaluations on casts, per body.
    pub casts: Vec<Vec<CastEvaluation>>,
    /// Prediction bands per body, including those on its casts.
    pub bands: Vec<Vec<BandCoverage>>,
    /// Estimates of all tasks per body, if requested. Not in checkpoints: a resumed trial computes them again.
    pub tasks: Vec<Vec<TaskEstimate>>,
    /// The network in training.
    pub training: Option<NetworkTraining>,
    /// Counts of work.
    pub counters: Counters,
    /// Seconds.
    pub seconds: Seconds,
}

impl Comparison {
    /// Completed fraction of the whole trial; `iterations`: those of the network in training.
    pub(super) fn completed_fraction(&self, iterations: usize, problem: &Problem) -> f64 {
        let (long, all) = (problem.evaluation.long.unwrap_or(0), problem.evaluation_iterations());
        let linear = !problem.decoder_kind.is_network();
        let each = if linear { problem.linear_iterations() } else { problem.brain.iterations };
        let of = |body: &BodyEvaluation| body.networks.len() * each + body.long.len() * long;
        let casts = (0..self.casts.len()).map(|turn| self.casts_read(turn) * problem.linear_iterations());
        let over_casts = self.casts.len() * problem.network_of_casts();
        let done = self.bodies.iter().map(of).chain(casts).sum::<usize>() + over_casts + iterations;
        let left = 1.0 - problem.progress(problem.optimise.iterations);
        1.0 - left * (1.0 - done as f64 / (problem.bodies_compared() * all) as f64)
    }

    /// Number of casts of body `turn` that are evaluated.
    pub(super) fn casts_read(&self, turn: usize) -> usize {
        self.casts.get(turn).and_then(|read| read.last()).map_or(0, |last| last.cast as usize + 1)
    }
}

/// Result of a nested optimisation.
#[derive(Debug, Clone)]
pub struct Optimised {
    /// The initial body, with its fresh networks if requested.
    pub initial: BodyEvaluation,
    /// The best body, with fresh networks of the same initial weights.
    pub optimised: BodyEvaluation,
    /// The outer step that started from the best design.
    pub best_step: u32,
    /// Evaluations on casts of both bodies.
    pub casts: [Vec<CastEvaluation>; 2],
    /// Prediction bands of both bodies, including those on casts.
    pub bands: [Vec<BandCoverage>; 2],
    /// Nonlinear share of the signals of both bodies.
    pub nonlinear: [Option<Nonlinear>; 2],
    /// Evaluations of both bodies under further kinds of forces.
    pub under: [Vec<UnderReading>; 2],
    /// Estimates of all tasks on both bodies, if requested; empty for a body that gives too few samples.
    pub tasks: [Vec<TaskEstimate>; 2],
    /// The chosen integrators, with reasons.
    pub solver: String,
    /// Relative signal error that the pilots of the initial and best body measured.
    pub signal_errors: [Option<f64>; 2],
    /// Work of pilots and evaluations. Without outer steps, only one body is evaluated.
    pub counters: Counters,
    /// Time of the evaluations.
    pub seconds: Seconds,
}
