//! Results of a simulation and of a reverse sweep, and the tape between them.

use super::forces::Forces;
use super::model::Model;
use super::scene::{Parameters, PartFactors, Scene};
use super::solver::IntegrationPlan;
use crate::simd::Width;

/// Outcome of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Success.
    Ok,
    /// More steps than any reasonable scene needs.
    StepLimit,
    /// Steps below the resolution of the clock.
    StepTooSmall,
    /// A state was not a finite number.
    NonFinite,
    /// Void angles below ψ_min were unavoidable.
    ForbiddenContact,
    /// Steps too long for the highest mode created energy.
    Unstable,
    /// The body lost stability during compression; its further state is undetermined.
    Buckled,
    /// No equilibrium exists under compression.
    NoEquilibrium,
    /// A unit is inverted, or has nearly vanished.
    NoMass,
}

impl Outcome {
    /// All outcomes.
    pub const ALL: [Self; 9] = [
        Self::Ok,
        Self::StepLimit,
        Self::StepTooSmall,
        Self::NonFinite,
        Self::ForbiddenContact,
        Self::Unstable,
        Self::Buckled,
        Self::NoEquilibrium,
        Self::NoMass,
    ];

    /// Name in records.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::StepLimit => "step_limit",
            Self::StepTooSmall => "step_too_small",
            Self::NonFinite => "non_finite",
            Self::ForbiddenContact => "forbidden_contact",
            Self::Unstable => "unstable",
            Self::Buckled => "buckled",
            Self::NoEquilibrium => "no_equilibrium",
            Self::NoMass => "no_mass",
        }
    }
}

/// Work done, summed over samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SimulationCounts {
    /// Evaluations of the forces, with or without derivatives.
    pub force_evaluations: u64,
    /// Accepted steps.
    pub steps: u64,
    /// Rejected steps; with equal steps, samples repeated with finer steps.
    pub rejected: u64,
}

impl std::ops::AddAssign for SimulationCounts {
    fn add_assign(&mut self, other: Self) {
        self.force_evaluations += other.force_evaluations;
        self.steps += other.steps;
        self.rejected += other.rejected;
    }
}

/// Input of a reverse sweep: what was simulated, the state at every instant and the steps in between.
#[derive(Debug, Clone, PartialEq)]
pub struct Tape {
    pub(super) scene: Scene,
    pub(super) design: Vec<f64>,
    pub(super) forces: Forces,
    /// State of each unit at the start of samples; empty if zero.
    pub(super) start: Vec<[f64; 3]>,
    /// Checkpoints per interval.
    pub(super) parts: usize,
    /// One tape per sample.
    pub(super) samples: Vec<SampleTape>,
}

impl Tape {
    /// Memory of the samples in bytes: states at the checkpoints and, for adaptive steps, one or two bytes per step.
    pub fn bytes(&self) -> usize {
        let of = |s: &SampleTape| 8 * s.states.capacity() + s.steps.capacity() + 4 * s.counts.capacity();
        self.samples.iter().map(of).sum()
    }

    /// The simulated model, with the starting state of its samples.
    pub(super) fn model(&self) -> Model {
        Model { start: Ok(self.start.clone()), ..Model::uncompressed(&self.scene, &self.design) }
    }

    /// Displacement (u, v, θ) and velocity of every unit of a sample at instant n = 1…T.
    pub fn state(&self, sample: usize, n: usize) -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
        let units = self.scene.layout.units();
        let (mut x, mut v) = (self.start.clone(), vec![[0.0; 3]; units]);
        x.resize(units, [0.0; 3]);
        let free: Vec<usize> = (0..units).filter(|u| !self.scene.clamped.contains(u)).collect();
        let state = &self.samples[sample].states[(n * self.parts - 1) * 6 * free.len()..][..6 * free.len()];
        for (i, &u) in free.iter().enumerate() {
            x[u].copy_from_slice(&state[6 * i..][..3]);
            v[u].copy_from_slice(&state[6 * i + 3..][..3]);
        }
        (x, v)
    }
}

/// Tape of one sample.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct SampleTape {
    /// Displacement and velocity at each checkpoint, (T, parts, free units, 6); the last of each interval is that of instant n =
    /// 1…T.
    pub states: Vec<f64>,
    /// Accepted adaptive steps: the code of the number of such steps that would fill the rest of the interval. Empty for equal
    /// steps.
    pub steps: Vec<u8>,
    /// Number of accepted steps per interval of the forces.
    pub counts: Vec<u32>,
    /// Factor by which equal steps were refined after the plan's steps failed; 1 if not.
    pub refined: usize,
}

/// Result of a simulation.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulation {
    /// Signals (N, T, 3M): (a_x, a_y, ω) of each sensor at n = 1…T (mm/s², rad/s); zero for failed samples.
    pub signals: Vec<f64>,
    /// Outcome of each sample.
    pub outcomes: Vec<Outcome>,
    /// Work done.
    pub counters: SimulationCounts,
    /// Integration method and steps, with the reason.
    pub plan: IntegrationPlan,
    /// Instruction set of the kernels.
    pub width: Width,
    /// Input of derivatives, if kept.
    pub tape: Option<Tape>,
}

/// Result of a reverse sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct Gradient {
    /// Gradient in α of Σ cotangent·signals.
    pub design: Vec<f64>,
    /// Gradient in the parameters, if requested.
    pub parameters: Option<Parameters>,
    /// Gradient in the factors of all ligaments and units, if the parameters were requested.
    pub parts: Option<PartFactors>,
    /// Gradient in the histories (N, K, R+1), if requested.
    pub forces: Option<Vec<f64>>,
    /// Work done.
    pub counters: SimulationCounts,
}

/// Variables of a gradient.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wrt {
    /// The design.
    Design,
    /// The design, the scene's parameters (damping follows them by its formula), and the factors of single ligaments and units.
    Parameters,
    /// The design and the forces at their instants. Because early forces would move a sample earlier, the sweep extends to its
    /// start; this changes the gradient in the design only by rounding. Step sizes are constant: where nothing moves, Tsit5's
    /// steps are whole intervals, which limits the accuracy of the gradient there.
    Forces,
}
