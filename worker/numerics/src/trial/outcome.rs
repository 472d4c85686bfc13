//! Named failures of a trial, and exact counts of its work.

use crate::brain::TrainOutcome;
use crate::dynamics;

/// Why an outer step gave no gradient.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Trouble {
    /// A sample's simulation or reverse sweep failed.
    Simulation(dynamics::Outcome),
    /// The decoder's training failed.
    Training(TrainOutcome),
    /// The training loss is this multiple of its trend.
    LossJump(f64),
    /// The gradient in α is not finite.
    GradientNonFinite,
    /// The linear decoder's normal matrix is singular at its λ.
    Singular,
    /// The body has no room for all sensors at the given spacing.
    Nowhere,
    /// More than half of all readings are at the limit of the sensors' range.
    Saturated,
    /// No training sample has a force.
    NoForce,
    /// At least two training samples with different forces are needed.
    FewForces,
}

impl Trouble {
    /// Name in records.
    pub fn name(self) -> &'static str {
        match self {
            Self::Simulation(outcome) => outcome.name(),
            Self::Training(outcome) => outcome.name(),
            Self::LossJump(_) => "loss_jump",
            Self::GradientNonFinite => "gradient_non_finite",
            Self::Singular => "singular",
            Self::Nowhere => "nowhere_to_sense",
            Self::Saturated => "saturated",
            Self::NoForce => "no_force",
            Self::FewForces => "few_forces",
        }
    }

    /// The failure with this name; values that the name lacks are 0.
    pub fn named(name: &str) -> Option<Self> {
        use TrainOutcome::{DeadLayer, Diverged, NonFinite};
        let simulations = dynamics::Outcome::ALL.into_iter().map(Self::Simulation);
        let trainings = [NonFinite, Diverged, DeadLayer(0)].into_iter().map(Self::Training);
        let others = [
            Self::LossJump(0.0),
            Self::GradientNonFinite,
            Self::Singular,
            Self::Nowhere,
            Self::Saturated,
            Self::NoForce,
            Self::FewForces,
        ];
        simulations.chain(trainings).chain(others).find(|trouble| trouble.name() == name)
    }
}

/// A result whose error is a [`Trouble`] unless another is given.
pub type Result<T, E = Trouble> = std::result::Result<T, E>;

/// Borrows a result and copies its error.
pub(crate) fn as_ref_result<T>(found: &Result<T>) -> Result<&T> {
    found.as_ref().map_err(|trouble| *trouble)
}

/// Why a trial failed.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Failure {
    /// The initial body failed.
    Initial(Trouble),
    /// The body that scales relative noise failed.
    Reference(Trouble),
    /// This many consecutive steps were undone, the last for this reason.
    Stuck(u32, Trouble),
}

impl Failure {
    /// The underlying trouble.
    pub fn trouble(self) -> Trouble {
        match self {
            Self::Initial(trouble) | Self::Reference(trouble) | Self::Stuck(_, trouble) => trouble,
        }
    }
}

impl std::fmt::Display for Failure {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Self::Reference(trouble) => {
                write!(f, "the reference body (sensors.relative_to) failed: {}", trouble.name())
            }
            Self::Initial(trouble) => write!(f, "the initial body failed: {}", trouble.name()),
            Self::Stuck(steps, trouble) => {
                write!(f, "{steps} consecutive steps were undone: {}", trouble.name())
            }
        }
    }
}

/// Exact counts of work.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counters {
    /// Force evaluations, integrator steps and rejected steps.
    pub dynamics: dynamics::SimulationCounts,
    /// Adam iterations of decoders.
    pub brain_iterations: u64,
    /// Hessian-vector products.
    pub hessian_products: u64,
    /// Interior-point iterations of the projection.
    pub projection_iterations: u64,
}

impl std::ops::AddAssign for Counters {
    fn add_assign(&mut self, more: Self) {
        self.dynamics += more.dynamics;
        self.brain_iterations += more.brain_iterations;
        self.hessian_products += more.hessian_products;
        self.projection_iterations += more.projection_iterations;
    }
}
