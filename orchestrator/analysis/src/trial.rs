//! A finished trial as the analysis sees it.

pub use metasense_numerics::nested::CastBrain;

use super::setting::Setting;

/// Initial or optimised body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Body {
    /// The body before the outer loop.
    Initial,
    /// The best body of the outer loop.
    Optimised,
}

impl Body {
    /// Both, in order.
    pub const ALL: [Self; 2] = [Self::Initial, Self::Optimised];

    /// Its name in the database.
    pub fn name(self) -> &'static str {
        match self {
            Self::Initial => "initial",
            Self::Optimised => "optimised",
        }
    }

    /// Its name in texts: the "initial" or the "trained" body.
    pub fn word(self) -> &'static str {
        match self {
            Self::Initial => "initial",
            Self::Optimised => "trained",
        }
    }
}

/// Which samples an error is of, and by what statistic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Set {
    /// The test set, by which the outer loop chooses the body.
    Test,
    /// Samples that neither loop has seen.
    Holdout,
    /// The same, by the median over samples instead of the mean: a few samples of large error do not move it.
    Median,
}

impl Set {
    /// All, in order.
    pub const ALL: [Self; 3] = [Self::Test, Self::Holdout, Self::Median];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Test => "test",
            Self::Holdout => "holdout",
            Self::Median => "holdout median",
        }
    }

    /// The column of a body's error in tables of trials.
    pub fn column(self, body: Body) -> String {
        let kind = match self {
            Self::Test => "test_error",
            Self::Holdout => "holdout_error",
            Self::Median => "holdout_median",
        };
        format!("{kind}_{}", body.name())
    }

    /// Those of which trials have errors: trials of versions before 15 have no medians.
    pub fn of(trials: &[&Trial]) -> impl Iterator<Item = Self> + use<> {
        let median = trials.iter().any(|t| [t.medians, t.long_medians].concat().iter().any(Option::is_some));
        Self::ALL.into_iter().filter(move |set| median || *set != Self::Median)
    }
}

/// What trials share that are compared with one another, and what is independent of what: sensors and stimuli.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Cluster {
    /// Sensor placement.
    pub placement: u64,
    /// Seed of stimuli, split and networks.
    pub seed: u64,
}

/// A point of a loss curve that was kept.
pub type CurvePoint = (u32, f64);

/// Errors of a trial's bodies by a linear brain of one memory.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Reading {
    /// How far it looks back and ahead (s).
    pub memory: [f64; 2],
    /// Whether none looks farther.
    pub whole: bool,
    /// Error (%) by body and set.
    pub errors: [[Option<f64>; 2]; 2],
}

/// How a brain reads the casts of a trial's body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CastReading {
    /// The body.
    pub body: Body,
    /// The brain.
    pub by: CastBrain,
    /// How many casts.
    pub casts: u64,
    /// How many of them could not be simulated or read, and count as 100 %.
    pub failed: u64,
    /// Median and 90th percentile of the holdout errors (%).
    pub errors: [f64; 2],
}

/// How a linear brain reads a trial's body under forces of a kind that need not be the trial's.
#[derive(Debug, Clone, PartialEq)]
pub struct UnderReading {
    /// The body.
    pub body: Body,
    /// Kind of forces.
    pub stimuli: String,
    /// Whether it was fitted under these, and not under the trial's.
    pub own: bool,
    /// Holdout error (%), above 0.
    pub error: f64,
}

/// The seed of a random initial body.
pub const RANDOM: &str = "body.design.random";

/// How far its nodes are moved.
pub const SPREAD: &str = "body.design.spread";

/// A trial that is done.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trial {
    /// Its name.
    pub hash: String,
    /// Everything that it is.
    pub setting: Setting,
    /// K.
    pub panels: u64,
    /// M.
    pub sensors: u64,
    /// Placement and seed.
    pub cluster: Cluster,
    /// Units of the body.
    pub units: u64,
    /// Length of α.
    pub design_parameters: u64,
    /// Error (%) by body and set, `[initial, optimised][test, holdout]`, mean over the evaluation's networks.
    pub errors: [[Option<f64>; 2]; 2],
    /// The same after long training, of trials that have it.
    pub long_errors: [[Option<f64>; 2]; 2],
    /// Median error over the samples of the holdout (%) by body, mean over the evaluation's networks; none in trials of versions
    /// before 15.
    pub medians: [Option<f64>; 2],
    /// The same after long training.
    pub long_medians: [Option<f64>; 2],
    /// By linear brains, whatever the trial's own is; none in trials of versions before 4.
    pub readings: Vec<Reading>,
    /// How casts of both bodies are read; none in trials without casts.
    pub casts: Vec<CastReading>,
    /// How both bodies are read under other kinds of forces; none in trials that do not ask.
    pub under: Vec<UnderReading>,
    /// The part of the accelerations and of the angular velocities (%) that a linear model of the body at rest does not explain,
    /// `[initial, optimised][acceleration, rotation]`; none in trials of versions before 6.
    pub nonlinear: [[Option<f64>; 2]; 2],
    /// Training loss against iteration (from 1), by body, then network; thinned, as all curves.
    pub curves: [Vec<Vec<CurvePoint>>; 2],
    /// Holdout error (%) against iteration likewise; none in trials of versions before 3.
    pub error_curves: [Vec<Vec<CurvePoint>>; 2],
    /// Training loss of long training.
    pub long_curves: [Vec<Vec<CurvePoint>>; 2],
    /// Iterations on the initial over those on the optimised body to equal training loss and to equal holdout error, by
    /// network, from the whole curves.
    pub iterations: [Vec<f64>; 2],
    /// CPU seconds and best test error so far (%), at the steps that improve it and at the last step. Steps that another trial computed
    /// count, as if this trial had trained its body itself.
    pub history: Vec<(f64, f64)>,
    /// CPU seconds that the trial has cost, as in `v_trial`.
    pub spent: f64,
    /// The same by part: of the outer loop, of the evaluation, and other (set-up, repeated and interrupted work).
    pub seconds: Vec<(&'static str, f64)>,
}

impl Trial {
    /// An error (%), where there is a positive one.
    pub fn error(&self, body: Body, set: Set) -> Option<f64> {
        of_set(&self.errors, &self.medians, body, set)
    }

    /// An error after long training (%), where there is a positive one.
    pub fn long_error(&self, body: Body, set: Set) -> Option<f64> {
        of_set(&self.long_errors, &self.long_medians, body, set)
    }

    /// CPU seconds of the training and the evaluation, as if this trial had trained its body itself. Comparable between trials.
    pub fn seconds_alone(&self) -> f64 {
        let evaluation = self.seconds.iter().find(|part| part.0 == "evaluate").map_or(0.0, |part| part.1);
        self.history.last().map_or(0.0, |last| last.0) + evaluation
    }

    /// Whether it has outer steps: without them what is stored of a trained body is the initial one.
    pub fn has_steps(&self) -> bool {
        self.setting.count("optimise.iterations") != Some(0)
    }

    /// Takes away what is no trained body's.
    pub fn without_steps(&mut self) {
        if self.has_steps() {
            return;
        }
        (self.errors[1], self.long_errors[1], self.nonlinear[1]) = ([None; 2], [None; 2], [None; 2]);
        (self.medians[1], self.long_medians[1]) = (None, None);
        self.readings.iter_mut().for_each(|reading| reading.errors[1] = [None; 2]);
        for curves in [&mut self.curves, &mut self.error_curves, &mut self.long_curves] {
            curves[1].clear();
        }
        self.iterations = Default::default();
    }

    /// Iterations of long training, where it has some.
    pub fn long_iterations(&self) -> Option<u64> {
        self.setting.count("evaluation.long_iterations")
    }

    /// Whether its initial body is a design that the spec names, random or given.
    pub fn starts_from_design(&self) -> bool {
        self.starts_random() || self.setting.contains_key("body.design.shifts")
    }

    /// Whether its initial body is a random one.
    pub fn starts_random(&self) -> bool {
        self.setting.contains_key(RANDOM)
    }

    /// A training protocol's name.
    pub fn protocol(&self) -> &str {
        self.setting.text("optimise.protocol").unwrap_or("unknown")
    }
}

/// A positive error of a body (%).
fn of_set(errors: &[[Option<f64>; 2]; 2], medians: &[Option<f64>; 2], body: Body, set: Set) -> Option<f64> {
    let error = match set {
        Set::Test | Set::Holdout => errors[body as usize][set as usize],
        Set::Median => medians[body as usize],
    };
    error.filter(|e| e.is_finite() && *e > 0.0)
}
