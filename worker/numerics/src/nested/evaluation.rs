//! What a comparison finds: fresh brains on the initial and on the best body.

use super::report::Seconds;
use crate::brains::{Band, Fresh, Reading};
use crate::questions::{Nonlinear, UnderReading};
use crate::trial::{Counters, FAILED, Problem, Spread, Trouble, mean_error};

/// A fresh network on a body.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NetworkEvaluation {
    /// Mean prediction error on the training set (%).
    pub error_train: Option<f64>,
    /// On the test set (%).
    pub error_test: Option<f64>,
    /// On the holdout (%).
    pub error_holdout: Option<f64>,
    /// How its errors on the holdout spread.
    pub spread: Option<Spread>,
    /// Training loss (normalised) at every iteration.
    pub losses: Vec<f32>,
    /// (iteration, from 1, mean prediction error on the holdout before it (%)) at `brain::milestones`.
    pub errors: Vec<(u32, f64)>,
    /// Weights of the first network, by which its predictions can be had again, for inputs at the trial's scales; empty of
    /// the others.
    pub weights: Vec<f32>,
    /// What went wrong.
    pub trouble: Option<Trouble>,
}

impl NetworkEvaluation {
    /// Of a brain that could not be fitted.
    pub(super) fn nothing(trouble: Trouble) -> Self {
        Self { trouble: Some(trouble), ..Self::default() }
    }
}

/// A body with its fresh brains.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BodyEvaluation {
    /// α (mm).
    pub design: Vec<f64>,
    /// One entry a seed; of a linear brain, which needs none, one.
    pub networks: Vec<NetworkEvaluation>,
    /// The same trained long, where asked for.
    pub long: Vec<NetworkEvaluation>,
    /// Errors of linear brains on it, whatever the trial's own brain is: the whole sample's first, then other memories.
    pub readings: Vec<Reading>,
    /// Samples without force, which have no error, or whose simulation failed, which have 100 %: train, test, holdout.
    pub zero_samples: [u32; 3],
}

/// How one brain reads one cast.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CastReading {
    /// Which cast, from 0.
    pub cast: u32,
    /// By what it is read.
    pub by: CastBrain,
    /// Mean error on the holdout (%); `None` where no sample has a force.
    pub error: Option<f64>,
    /// How the errors on the holdout spread.
    pub spread: Option<Spread>,
    /// λ and κ; `None` of a brain without.
    pub regularisation: Regularisation,
    /// What went wrong; the error is then that of a brain that says nothing.
    pub trouble: Option<Trouble>,
}

/// What a brain that reads a cast was fitted with.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Regularisation {
    /// λ of a linear brain.
    pub ridge: Option<f64>,
    /// κ of a linear brain that is calibrated beside the samples of other casts.
    pub share: Option<f64>,
}

impl CastReading {
    /// Of the errors of the holdout's samples, or of why there are none.
    pub(super) fn new(
        cast: u32,
        by: CastBrain,
        found: Result<(Vec<Option<f64>>, Regularisation), Trouble>,
    ) -> Self {
        match found {
            Ok((errors, regularisation)) => {
                let (error, spread) = (mean_error(&errors), Spread::of(&errors));
                Self { cast, by, error, spread, regularisation, trouble: None }
            }
            Err(trouble) => Self {
                cast,
                by,
                error: Some(FAILED),
                spread: Some(Spread::FAILED),
                regularisation: Regularisation::default(),
                trouble: Some(trouble),
            },
        }
    }
}

/// A brain that reads a cast. In the order of tables, in which what is calibrated for a cast comes after what is not, of a kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum CastBrain {
    /// The first network of the comparison, trained on the body as designed.
    Network,
    /// A network trained on samples of many other casts, as many as the training set has.
    NetworkCasts,
    /// A linear brain fitted to the body as designed.
    Nominal,
    /// A linear brain fitted to samples of many other casts.
    Casts,
    /// A linear brain fitted to so many samples of this cast, beside those of other casts.
    Records(u32),
    /// An inverse brain by the model of the design.
    Inverse,
    /// A linear brain fitted to a twin, calibrated on so many samples of this cast.
    TwinLinear(u32),
    /// An inverse brain by that twin.
    Twin(u32),
}

impl CastBrain {
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

    /// How many samples of a cast it is fitted to, or its twin.
    pub fn records(self) -> Option<u32> {
        match self {
            Self::Records(records) | Self::TwinLinear(records) | Self::Twin(records) => Some(records),
            _ => None,
        }
    }

    /// By its name in the database and the samples that it is fitted to.
    pub fn named(name: &str, records: u32) -> Option<Self> {
        Some(match name {
            "network" => Self::Network,
            "network_casts" => Self::NetworkCasts,
            "nominal" => Self::Nominal,
            "casts" => Self::Casts,
            "records" => Self::Records(records),
            "inverse" => Self::Inverse,
            "twin_linear" => Self::TwinLinear(records),
            "twin" => Self::Twin(records),
            _ => return None,
        })
    }
}

/// A band about what a brain says, and how much of the holdout lies in it.
#[derive(Debug, Clone, PartialEq)]
pub struct BandReading {
    /// Of which cast, and by which brain; none: the body as designed, by its first brain.
    pub cast: Option<(u32, CastBrain)>,
    /// It; of a cast that of the body as designed, without its half-widths.
    pub band: Band,
    /// Mean width (N); `None` where it has none.
    pub width: Option<f64>,
    /// The part of the holdout's instants and panels, or samples, within; `None` where there is no band.
    pub coverage: Option<f64>,
}

/// How far a comparison has come.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Comparison {
    /// The bodies, the initial one first; the last may lack networks.
    pub bodies: Vec<BodyEvaluation>,
    /// How casts of each body are read.
    pub casts: Vec<Vec<CastReading>>,
    /// Bands about what is read of each body, and of its casts.
    pub bands: Vec<Vec<BandReading>>,
    /// The network that is being trained on it.
    pub training: Option<Fresh>,
    /// Counts of work.
    pub counters: Counters,
    /// Seconds.
    pub seconds: Seconds,
}

impl Comparison {
    /// The part of the whole trial that is done, with so many iterations of the network in training.
    pub(super) fn part(&self, iterations: usize, problem: &Problem) -> f64 {
        let (long, all) = (problem.evaluation.long.unwrap_or(0), problem.evaluation_iterations());
        let linear = !problem.reader.is_network();
        let each = if linear { problem.linear_iterations() } else { problem.brain.iterations };
        let of = |body: &BodyEvaluation| body.networks.len() * each + body.long.len() * long;
        let casts = (0..self.casts.len()).map(|turn| self.casts_read(turn) * problem.linear_iterations());
        let over_casts = self.casts.len() * problem.network_of_casts();
        let done = self.bodies.iter().map(of).chain(casts).sum::<usize>() + over_casts + iterations;
        let left = 1.0 - problem.progress(problem.optimise.iterations);
        1.0 - left * (1.0 - done as f64 / (problem.bodies_compared() * all) as f64)
    }

    /// Casts of the body number `turn` that are read.
    pub(super) fn casts_read(&self, turn: usize) -> usize {
        self.casts.get(turn).and_then(|read| read.last()).map_or(0, |last| last.cast as usize + 1)
    }
}

/// What a nested optimisation found.
#[derive(Debug, Clone)]
pub struct Optimised {
    /// The initial body, with its fresh networks where they were asked for.
    pub initial: BodyEvaluation,
    /// The best body, with fresh networks of the same initial weights.
    pub optimised: BodyEvaluation,
    /// The outer step whose design is the best, by the test set.
    pub best_step: u32,
    /// How casts of both bodies are read, where the trial asks about them.
    pub casts: [Vec<CastReading>; 2],
    /// Bands about what is read of both bodies, and of their casts.
    pub bands: [Vec<BandReading>; 2],
    /// The part of both bodies' signals that their linearisation at rest does not give.
    pub nonlinear: [Option<Nonlinear>; 2],
    /// How both bodies are read under forces of the kinds that the trial asks about.
    pub under: [Vec<UnderReading>; 2],
    /// What the solvers came to, and why.
    pub solver: String,
    /// Relative error of the signals of both pilots, initial body and best, where measured.
    pub signal_errors: [Option<f64>; 2],
    /// Counts of work of the pilot that tuned them and of the evaluations: of one, where nothing has moved the body.
    pub counters: Counters,
    /// Seconds of the evaluations.
    pub seconds: Seconds,
}
