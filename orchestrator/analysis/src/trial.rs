//! A finished trial: settings and results that the analysis uses.

pub use metasense_numerics::nested::CastDecoder;
use metasense_schemas::record::TaskReading;

use super::setting::Setting;

/// Initial or trained body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum BodyState {
    /// The body before training.
    Initial,
    /// The trained body: that of least test error.
    Optimised,
}

impl BodyState {
    /// Both, in order.
    pub const ALL: [Self; 2] = [Self::Initial, Self::Optimised];

    /// Name in the database.
    pub fn name(self) -> &'static str {
        ["initial", "optimised"][self as usize]
    }

    /// Name in texts.
    pub fn word(self) -> &'static str {
        ["initial", "trained"][self as usize]
    }
}

/// The samples of an error, and the statistic over them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Set {
    /// Test set, which selects the trained body; mean.
    Test,
    /// Held-out set, which is used in no training; mean.
    Holdout,
    /// Held-out set; median, which is robust to a few large errors.
    Median,
}

impl Set {
    /// All, in order.
    pub const ALL: [Self; 3] = [Self::Test, Self::Holdout, Self::Median];

    /// Name in tables.
    pub fn name(self) -> &'static str {
        ["test", "holdout", "holdout median"][self as usize]
    }

    /// Column of a body's error in tables of trials.
    pub fn column(self, body: BodyState) -> String {
        let kind = ["test_error", "holdout_error", "holdout_median"][self as usize];
        format!("{kind}_{}", body.name())
    }

    /// Returns the sets for which trials have errors. Trials of versions before 15 have no medians.
    pub fn with_errors(trials: &[&Trial]) -> impl Iterator<Item = Self> + use<> {
        let errors = |t: &&Trial| [t.errors, t.long_errors].concat();
        let median = trials.iter().flat_map(errors).any(|of| of[Self::Median as usize].is_some());
        Self::ALL.into_iter().filter(move |set| median || *set != Self::Median)
    }
}

/// Sensors and forces that compared trials share; the units of inference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Cluster {
    /// Sensor placement.
    pub placement: u64,
    /// Seed of forces, split and networks.
    pub seed: u64,
}

/// A point of a thinned curve: iteration, value.
pub type CurvePoint = (u32, f64);

/// Errors of a linear decoder of one memory on the bodies of a trial.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LinearErrors {
    /// Memory before and after an instant (s).
    pub memory: [f64; 2],
    /// Whether no other linear decoder of the trial has a longer memory.
    pub is_longest: bool,
    /// Error (%) by body and set.
    pub errors: [[Option<f64>; 3]; 2],
}

/// Errors of a decoder on the casts of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadingOnCasts {
    /// The body.
    pub body: BodyState,
    /// The decoder.
    pub decoder: CastDecoder,
    /// Number of casts.
    pub casts: u64,
    /// Number of casts that failed in simulation or decoding, and count as 100 %.
    pub failed: u64,
    /// Median and 90th percentile over casts of the held-out errors (%).
    pub errors: [f64; 2],
    /// Median over casts of the median over held-out samples (%).
    pub median: Option<f64>,
}

/// Error of a linear decoder on a body under one kind of forces.
#[derive(Debug, Clone, PartialEq)]
pub struct UnderErrors {
    /// The body.
    pub body: BodyState,
    /// Kind of forces.
    pub stimuli: String,
    /// Whether the decoder was fitted under these forces rather than those of the trial.
    pub own: bool,
    /// Held-out error (%), above 0.
    pub error: f64,
    /// Median over held-out samples (%), above 0.
    pub median: Option<f64>,
}

/// Path of the seed of a random initial body.
pub const RANDOM: &str = "body.design.random";

/// Path of the spread of a random initial body.
pub const SPREAD: &str = "body.design.spread";

/// A finished trial.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trial {
    /// Permanent name of the trial.
    pub hash: String,
    /// All settings.
    pub setting: Setting,
    /// K: number of forces.
    pub panels: u64,
    /// M: number of sensors.
    pub sensors: u64,
    /// Placement and seed.
    pub cluster: Cluster,
    /// Number of units of the body.
    pub units: u64,
    /// Length of α.
    pub design_parameters: u64,
    /// Error (%) by body and set, mean over the networks of the comparison. Medians are `None` before version 15.
    pub errors: [[Option<f64>; 3]; 2],
    /// The same after long training.
    pub long_errors: [[Option<f64>; 3]; 2],
    /// Errors of linear decoders, for any decoder of the trial. Empty before version 4.
    pub readings: Vec<LinearErrors>,
    /// Errors on casts of both bodies; empty without casts.
    pub casts: Vec<ReadingOnCasts>,
    /// Errors of both bodies under other kinds of forces; empty without `evaluation.under`.
    pub under: Vec<UnderErrors>,
    /// Errors of readouts of all tasks on both bodies; empty without `evaluation.tasks`.
    pub tasks: Vec<TaskReading>,
    /// Part of the accelerations and of the angular velocities (%) that a linear model of the body at rest does not explain,
    /// `[initial, trained][acceleration, rotation]`. `None` before version 6.
    pub nonlinear: [[Option<f64>; 2]; 2],
    /// Training loss against iteration (from 1), by body, then network.
    pub curves: [Vec<Vec<CurvePoint>>; 2],
    /// Held-out error (%) against iteration, in the same form. Empty before version 3.
    pub error_curves: [Vec<Vec<CurvePoint>>; 2],
    /// Training loss of long training, in the same form.
    pub long_curves: [Vec<Vec<CurvePoint>>; 2],
    /// Iterations on the initial body divided by those on the trained body, to equal training loss and to equal held-out error,
    /// one per network, from unthinned curves.
    pub iterations: [Vec<f64>; 2],
    /// CPU seconds and smallest test error so far (%), at the steps that reduce it and at the last step. Steps that another
    /// trial computed count as if this trial had trained its body itself.
    pub history: Vec<(f64, f64)>,
    /// CPU seconds of the trial, as in `v_trial`.
    pub spent: f64,
    /// The same by part: outer steps, comparison, and other (set-up, repeated and interrupted work).
    pub seconds: Vec<(&'static str, f64)>,
}

impl Trial {
    /// Returns an error (%); `None` unless it is positive and finite.
    pub fn error(&self, body: BodyState, set: Set) -> Option<f64> {
        positive(self.errors[body as usize][set as usize])
    }

    /// Returns an error after long training (%); `None` unless it is positive and finite.
    pub fn long_error(&self, body: BodyState, set: Set) -> Option<f64> {
        positive(self.long_errors[body as usize][set as usize])
    }

    /// Returns the errors of the linear decoder with the longest memory.
    pub fn longest_reading(&self) -> Option<&LinearErrors> {
        self.readings.iter().find(|reading| reading.is_longest)
    }

    /// CPU seconds of training and comparison, as if this trial had trained its body itself. Comparable between trials.
    pub fn seconds_alone(&self) -> f64 {
        let evaluation = self.seconds.iter().find(|part| part.0 == "evaluate").map_or(0.0, |part| part.1);
        self.history.last().map_or(0.0, |last| last.0) + evaluation
    }

    /// Whether the trial has outer steps; without them, stored results of the trained body are those of the initial one.
    pub fn has_steps(&self) -> bool {
        self.setting.count("optimise.iterations") != Some(0)
    }

    /// Removes the results of the trained body from a trial without outer steps.
    pub fn remove_trained_results(&mut self) {
        if self.has_steps() {
            return;
        }
        (self.errors[1], self.long_errors[1], self.nonlinear[1]) = ([None; 3], [None; 3], [None; 2]);
        self.readings.iter_mut().for_each(|reading| reading.errors[1] = [None; 3]);
        for curves in [&mut self.curves, &mut self.error_curves, &mut self.long_curves] {
            curves[1].clear();
        }
        self.iterations = Default::default();
    }

    /// Iterations of long training, if any.
    pub fn long_iterations(&self) -> Option<u64> {
        self.setting.count("evaluation.long_iterations")
    }

    /// Whether the initial body is a design from the spec, random or given.
    pub fn starts_from_design(&self) -> bool {
        self.starts_random() || self.setting.contains_key("body.design.shifts")
    }

    /// Whether the initial body is random.
    pub fn starts_random(&self) -> bool {
        self.setting.contains_key(RANDOM)
    }

    /// Name of the training protocol.
    pub fn protocol(&self) -> &str {
        self.setting.text("optimise.protocol").unwrap_or("unknown")
    }
}

/// Returns an error (%), if it is positive and finite.
fn positive(error: Option<f64>) -> Option<f64> {
    error.filter(|e| e.is_finite() && *e > 0.0)
}
