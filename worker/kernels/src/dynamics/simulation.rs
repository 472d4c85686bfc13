//! What a simulation and a reverse sweep give, and what the sweep starts from.

use super::forces::Forces;
use super::model::Model;
use super::scene::{Parameters, Parts, Scene};
use super::solver::Plan;
use crate::simd::Width;

/// How a sample ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Reached the end.
    Ok,
    /// Took more steps than any reasonable scene needs.
    StepLimit,
    /// Steps fell below what the clock resolves.
    StepTooSmall,
    /// A state was not a finite number.
    NonFinite,
    /// Void angles below the least allowed could not be avoided.
    ForbiddenContact,
    /// Steps too long for the highest mode made kinetic energy out of nothing.
    Unstable,
    /// Before the sample the body lost its stability while its held units were moved: from there on it may be in several places.
    Buckled,
    /// While these were moved it came to rest nowhere.
    NoEquilibrium,
}

impl Outcome {
    /// Each of them.
    pub const ALL: [Self; 8] = [
        Self::Ok,
        Self::StepLimit,
        Self::StepTooSmall,
        Self::NonFinite,
        Self::ForbiddenContact,
        Self::Unstable,
        Self::Buckled,
        Self::NoEquilibrium,
    ];

    /// The name by which records know it.
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
        }
    }
}

/// Work done, summed over samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counters {
    /// Evaluations of the forces, plain or with derivatives, per sample.
    pub force_evaluations: u64,
    /// Accepted steps.
    pub steps: u64,
    /// Rejected steps.
    pub rejected: u64,
}

impl std::ops::AddAssign for Counters {
    fn add_assign(&mut self, other: Self) {
        self.force_evaluations += other.force_evaluations;
        self.steps += other.steps;
        self.rejected += other.rejected;
    }
}

/// What a reverse sweep starts from: what was simulated, the state at every instant and the steps in between.
#[derive(Debug, Clone, PartialEq)]
pub struct Tape {
    pub(super) scene: Scene,
    pub(super) design: Vec<f64>,
    pub(super) forces: Forces,
    /// Where units are when a sample begins; empty: as cast.
    pub(super) start: Vec<[f64; 3]>,
    /// Checkpoints an interval.
    pub(super) parts: usize,
    /// One a sample.
    pub(super) samples: Vec<SampleTape>,
}

impl Tape {
    /// Memory that the samples hold: the states at the instants and, of adaptive methods, a byte or two a step.
    pub fn bytes(&self) -> usize {
        let of = |s: &SampleTape| 8 * s.states.capacity() + s.steps.capacity() + 4 * s.counts.capacity();
        self.samples.iter().map(of).sum()
    }

    /// The model that was simulated; where its samples begin is kept.
    pub(super) fn model(&self) -> Model {
        Model { start: Ok(self.start.clone()), ..Model::cast(&self.scene, &self.design) }
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

/// Of one sample.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct SampleTape {
    /// (T, parts, free units, 6): displacement and velocity at each part's end, the last that of instant n = 1…T.
    pub states: Vec<f64>,
    /// Accepted steps, empty where steps are equal: each as the number of such that were left in the interval, coded.
    pub steps: Vec<u8>,
    /// How many of them belong to each interval of the forces.
    pub counts: Vec<u32>,
    /// By how much equal steps were refined, after the plan's had failed.
    pub refined: usize,
}

/// A simulation's result.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulation {
    /// (N, T, 3M): (a_x, a_y, ω) of each sensor at n = 1…T (mm/s², rad/s); zero after a sample has failed.
    pub signals: Vec<f64>,
    /// How each sample ended.
    pub outcomes: Vec<Outcome>,
    /// Work done.
    pub counters: Counters,
    /// How it was integrated, and why so.
    pub plan: Plan,
    /// By which kernels.
    pub width: Width,
    /// For derivatives.
    pub tape: Option<Tape>,
}

/// What a reverse sweep gives.
#[derive(Debug, Clone, PartialEq)]
pub struct Gradient {
    /// Gradient in α of the sum of cotangent · signals.
    pub design: Vec<f64>,
    /// Likewise in the parameters, where asked for.
    pub parameters: Option<Parameters>,
    /// With them, in the factors of all ligaments and units.
    pub parts: Option<Parts>,
    /// Likewise in the histories, (N, K, R+1), where asked for.
    pub forces: Option<Vec<f64>>,
    /// Work done.
    pub counters: Counters,
}

/// With respect to what a reverse sweep differentiates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wrt {
    /// The design alone.
    Design,
    /// The design, the scene's parameters, those on which damping depends through its formula too, and the factors of its parts.
    Parameters,
    /// The design and the forces at their instants. As these would move a sample before its first force, it is swept back to its
    /// beginning: the gradient in the design is the same but for rounding. Steps are held: where nothing moves, Tsit5's are as
    /// long as an interval, and what forces would do there is known no better than by these.
    Forces,
}
