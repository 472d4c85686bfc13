//! What an outer loop tells its observer: reports, counts, seconds, and trouble by its name.

use crate::brain::TrainOutcome;
use crate::dynamics;

/// Who watches an outer loop. The maths has no clock of its own.
pub trait Observe {
    /// Seconds since any fixed moment.
    fn seconds(&mut self) -> f64;
    /// The part of the whole trial that is done. An outer step is finished all the same, a training in the comparison at the
    /// end is not.
    fn progress(&mut self, fraction: f64) -> Control;
    /// A finished outer step, and the state to go on from after it.
    fn step(&mut self, report: &Report, state: &super::State) -> Control;
    /// The state to go on from within the comparison at the end, every few seconds, and where it stops.
    fn save(&mut self, state: &super::State);
}

/// What an observer wants next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Control {
    /// More.
    Continue,
    /// No more.
    Stop,
}

/// Exact counts of work.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counters {
    /// Force evaluations, integrator steps, rejected ones.
    pub dynamics: dynamics::Counters,
    /// Adam iterations on the brain.
    pub brain_iterations: u64,
    /// Hessian-vector products.
    pub hessian_products: u64,
    /// Interior-point iterations of the projection.
    pub projection_iterations: u64,
}

/// Where time went (s).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Seconds {
    /// Simulation.
    pub simulate: f64,
    /// Training of the brain.
    pub train: f64,
    /// Gradient through network and body.
    pub differentiate: f64,
    /// Implicit term: its linear system and mixed product.
    pub implicit: f64,
    /// Projection.
    pub project: f64,
}

/// The linear system of the implicit term.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Implicit {
    /// What stood for the inverse.
    pub policy: crate::brain::Policy,
    /// Conjugate-gradient iterations.
    pub iterations: usize,
    /// ‖r‖/‖b‖ at the end.
    pub residual: f64,
    /// Least curvature met, vᵀHv/vᵀv.
    pub smallest_curvature: f64,
    /// How it ended.
    pub outcome: crate::brain::SolveOutcome,
}

/// One outer step. The design it speaks of is the one before the step.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Report {
    /// Outer step, from 0.
    pub step: u32,
    /// Test loss (N²).
    pub loss_test: Option<f64>,
    /// Training loss (normalised).
    pub loss_train: Option<f64>,
    /// Prediction error on the test set (%).
    pub error_test: Option<f64>,
    /// Prediction error on the training set, or on the step's fresh samples (%).
    pub error_train: Option<f64>,
    /// ‖dL/dα‖.
    pub gradient_norm: Option<f64>,
    /// ‖Δα‖ accepted (mm).
    pub step_length: Option<f64>,
    /// The projection's status.
    pub projection: Option<crate::feasible::Status>,
    /// Distance moved by the projection (mm).
    pub projection_distance: Option<f64>,
    /// The implicit term, where taken.
    pub implicit: Option<Implicit>,
    /// What went wrong; the step was then taken back.
    pub trouble: Option<Trouble>,
    /// Samples drawn for this step alone.
    pub fresh_samples: u64,
    /// Counts of work.
    pub counters: Counters,
    /// Where the time went.
    pub seconds: Seconds,
}

/// Why an outer step gave no gradient.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Trouble {
    /// A sample's simulation or reverse sweep ended early.
    Simulation(dynamics::Outcome),
    /// The brain's training ended early.
    Training(TrainOutcome),
    /// The training loss is this many times its trend, although trained as before.
    LossJump(f64),
    /// The gradient in α is not finite.
    GradientNonFinite,
    /// The linear brain's normal matrix has no factor at its ridge.
    Singular,
    /// No units are as many and as far apart as the sensors are to be.
    Nowhere,
}

impl Trouble {
    /// Its name in records.
    pub fn name(self) -> &'static str {
        match self {
            Self::Simulation(outcome) => outcome.name(),
            Self::Training(outcome) => outcome.name(),
            Self::LossJump(_) => "loss_jump",
            Self::GradientNonFinite => "gradient_non_finite",
            Self::Singular => "singular",
            Self::Nowhere => "nowhere_to_sense",
        }
    }

    /// One of this name; what a name does not say of it is 0.
    pub fn named(name: &str) -> Option<Self> {
        use TrainOutcome::{DeadLayer, Diverged, NonFinite};
        let simulations = dynamics::Outcome::ALL.into_iter().map(Self::Simulation);
        let trainings = [NonFinite, Diverged, DeadLayer(0)].into_iter().map(Self::Training);
        let others = [Self::LossJump(0.0), Self::GradientNonFinite, Self::Singular, Self::Nowhere];
        simulations.chain(trainings).chain(others).find(|trouble| trouble.name() == name)
    }
}

/// Why a trial has no result.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Failure {
    /// The initial body.
    Initial(Trouble),
    /// So many steps in a row were taken back, the last for this.
    Stuck(u32, Trouble),
}

impl std::fmt::Display for Failure {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Self::Initial(trouble) => write!(f, "the initial body: {}", trouble.name()),
            Self::Stuck(steps, trouble) => write!(f, "{steps} steps in a row taken back: {}", trouble.name()),
        }
    }
}

/// The report under way, and the clock.
pub(super) struct Log<'a> {
    pub(super) report: Report,
    observer: &'a mut dyn Observe,
    /// When the state was last saved, or this was made.
    saved: f64,
}

/// Seconds of a comparison between two savings of it: what a kill may cost.
const SAVE_EVERY: f64 = 2.0;

impl<'a> Log<'a> {
    pub(super) fn new(step: u32, observer: &'a mut dyn Observe) -> Self {
        let saved = observer.seconds();
        Self { report: Report { step, ..Report::default() }, observer, saved }
    }

    /// Does `work` and adds its time to the part of [`Seconds`] that `part` picks.
    pub(super) fn timed<T>(
        &mut self,
        part: fn(&mut Seconds) -> &mut f64,
        work: impl FnOnce(&mut Report) -> T,
    ) -> T {
        let start = self.observer.seconds();
        let result = work(&mut self.report);
        *part(&mut self.report.seconds) += self.observer.seconds() - start;
        result
    }

    pub(super) fn seconds(&mut self) -> f64 {
        self.observer.seconds()
    }

    pub(super) fn progress(&mut self, fraction: f64) -> Control {
        self.observer.progress(fraction)
    }

    pub(super) fn save_is_due(&mut self) -> bool {
        self.observer.seconds() - self.saved >= SAVE_EVERY
    }

    pub(super) fn save(&mut self, state: &super::State) {
        self.observer.save(state);
        self.saved = self.observer.seconds();
    }
}

impl std::ops::AddAssign for Counters {
    fn add_assign(&mut self, more: Self) {
        self.dynamics += more.dynamics;
        self.brain_iterations += more.brain_iterations;
        self.hessian_products += more.hessian_products;
        self.projection_iterations += more.projection_iterations;
    }
}
