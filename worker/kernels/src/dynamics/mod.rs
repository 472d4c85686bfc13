//! The body's motion under forces, its sensors' signals, and the gradient of a function of the signals in the design.
//!
//! ```text
//! M s̈ = −∂U/∂s − C ṡ + f(t),   s = (u, v, θ) of every unit, clamped ones held, at rest at t = 0
//! ```
//! Samples are integrated eight at a time or more, one a lane; a sample's result does not depend on the others, on the number
//! of threads or on which samples are asked for. Gradients are those of the discrete method.

mod balance;
mod choose;
mod dispatch;
mod energy;
mod jvp;
mod ligaments;
mod model;
mod rest;
mod solver;
mod splitting;
mod system;
mod trigonometry;
mod tsit5;
mod tune;

use crate::body::Layout;
use crate::simd::Width;
pub use choose::{choose, highest_frequency};
pub use energy::{Energy, energy, energy_design_gradient, energy_gradient};
pub use jvp::Tangent;
pub use model::damping;
pub use rest::Rest;
pub use solver::{Accuracy, Method, Plan, Precision, Solver, Steps, Tolerance};
pub use tune::{Tuned, signal_error, tune};

/// Stiffnesses of a ligament.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stiffness {
    /// k_l (N/mm).
    pub stretch: f64,
    /// k_s (N/mm).
    pub shear: f64,
    /// k_θ (N·mm/rad).
    pub bend: f64,
}

/// Contact between the edges that face each other across a ligament.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// k_c (N·mm/rad²).
    pub stiffness: f64,
    /// ψ_min (rad): no state has a smaller void angle.
    pub min_angle: f64,
    /// ψ_c (rad): no contact from here on.
    pub cutoff_angle: f64,
}

/// The material's parameters, what is done to them, or a gradient in them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Parameters {
    /// k_l.
    pub stretch: f64,
    /// k_s.
    pub shear: f64,
    /// k_θ.
    pub bend: f64,
    /// ζ.
    pub damping_ratio: f64,
    /// Plane density.
    pub density: f64,
    /// k_c.
    pub contact: f64,
}

impl Parameters {
    /// Those of a scene; `contact` is zero in one without.
    pub fn of(scene: &Scene) -> Self {
        let Stiffness { stretch, shear, bend } = scene.stiffness;
        let contact = scene.contact.map_or(0.0, |c| c.stiffness);
        Self { stretch, shear, bend, damping_ratio: scene.damping_ratio, density: scene.density, contact }
    }

    /// The scene with these.
    pub fn set(self, scene: &Scene) -> Scene {
        let Self { stretch, shear, bend, damping_ratio, density, contact: stiffness } = self;
        let contact = scene.contact.map(|c| Contact { stiffness, ..c });
        Scene {
            stiffness: Stiffness { stretch, shear, bend },
            damping_ratio,
            density,
            contact,
            ..scene.clone()
        }
    }

    /// In the order of the fields.
    pub fn array(self) -> [f64; 6] {
        let Self { stretch, shear, bend, damping_ratio, density, contact } = self;
        [stretch, shear, bend, damping_ratio, density, contact]
    }

    /// Likewise.
    pub fn from_array([stretch, shear, bend, damping_ratio, density, contact]: [f64; 6]) -> Self {
        Self { stretch, shear, bend, damping_ratio, density, contact }
    }
}

/// The frame in which accelerations are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Frame {
    /// Fixed axes.
    World,
    /// Turning with the unit: the acceleration rotated by −θ.
    Body,
}

/// Where a force acts: at the centroid of a unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Panel {
    /// The unit.
    pub unit: usize,
    /// Unit vector along which a positive force pushes.
    pub direction: [f64; 2],
}

/// Everything of a simulation but design and forces.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Units and ligaments.
    pub layout: Layout,
    /// Plane density (Mg/mm²).
    pub density: f64,
    /// Ligaments.
    pub stiffness: Stiffness,
    /// ζ.
    pub damping_ratio: f64,
    /// Contact; a scene without does not pay for it.
    pub contact: Option<Contact>,
    /// Linear strain measures.
    pub linearised: bool,
    /// Held units.
    pub clamped: Vec<usize>,
    /// K input panels.
    pub panels: Vec<Panel>,
    /// Units of the M sensors.
    pub sensors: Vec<usize>,
    /// How sensors read.
    pub frame: Frame,
    /// Length of a sample (s).
    pub duration: f64,
    /// T.
    pub instants: usize,
}

/// Force histories (N, K, R+1), f_k at t_n = n·duration/R, n = 0…R, linear in between.
///
/// R is `instants`: that of the scene, T, or a whole multiple of it, for histories with more detail than T instants hold
/// (recorded ones). Every method ends a step at each of the R kinks; signals are those of the T instants all the same,
/// every (R/T)-th.
#[derive(Debug, Clone, PartialEq)]
pub struct Forces {
    /// N.
    pub samples: usize,
    /// K.
    pub panels: usize,
    /// R, a multiple of T.
    pub instants: usize,
    /// (N, K, R+1) (N).
    pub values: Vec<f64>,
}

impl Forces {
    /// R/T: kinks an interval of the scene.
    pub fn kinks(&self, scene: &Scene) -> usize {
        self.instants / scene.instants
    }

    /// The histories of sample i, (K, R+1).
    pub fn sample(&self, i: usize) -> &[f64] {
        let len = self.panels * (self.instants + 1);
        &self.values[i * len..][..len]
    }

    /// The interval of the scene in which a history, (K, R+1), begins to act; T where it never does.
    pub(crate) fn onset(&self, scene: &Scene, history: &[f64]) -> usize {
        let acts = |panel: &[f64]| panel.iter().position(|f| *f != 0.0);
        let first = history.chunks(self.instants + 1).filter_map(acts).min();
        first.map_or(scene.instants, |n| n.saturating_sub(1) / self.kinks(scene))
    }
}

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
}

impl Outcome {
    /// Each of them.
    pub const ALL: [Self; 6] = [
        Self::Ok,
        Self::StepLimit,
        Self::StepTooSmall,
        Self::NonFinite,
        Self::ForbiddenContact,
        Self::Unstable,
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
    scene: Scene,
    design: Vec<f64>,
    forces: Forces,
    /// Checkpoints an interval.
    parts: usize,
    /// One a sample.
    samples: Vec<SampleTape>,
}

impl Tape {
    /// Memory that the samples hold: the states at the instants and, of adaptive methods, a byte or two a step.
    pub fn bytes(&self) -> usize {
        let of = |s: &SampleTape| 8 * s.states.capacity() + s.steps.capacity() + 4 * s.counts.capacity();
        self.samples.iter().map(of).sum()
    }

    /// Displacement (u, v, θ) and velocity of every unit of a sample at instant n = 1…T.
    pub fn state(&self, sample: usize, n: usize) -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
        let units = self.scene.layout.units();
        let (mut x, mut v) = (vec![[0.0; 3]; units], vec![[0.0; 3]; units]);
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
struct SampleTape {
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
    /// The design and the scene's parameters, those on which damping depends through its formula too.
    Parameters,
    /// The design and the forces at their instants. As these would move a sample before its first force, it is swept back to its
    /// beginning: the gradient in the design is the same but for rounding. Steps are held: where nothing moves, Tsit5's are as
    /// long as an interval, and what forces would do there is known no better than by these.
    Forces,
}

impl Simulation {
    /// Gradient of Σ cotangent·signals, cotangent (N, T, 3M), by the method and instruction set of the simulation. Samples
    /// that failed add nothing.
    ///
    /// # Panics
    /// If the simulation kept no tape, or the length is another.
    pub fn vjp(&self, cotangent: &[f64], wrt: Wrt, pool: &crate::Pool) -> Gradient {
        let tape = self.tape.as_ref().expect("the simulation kept its tape");
        let scene = &tape.scene;
        let len = self.outcomes.len() * scene.instants * 3 * scene.sensors.len();
        assert_eq!(cotangent.len(), len, "length of the cotangent");
        dispatch::vjp(self, tape, cotangent, wrt, pool)
    }
}

/// Integrates all samples and reads the sensors.
///
/// # Panics
/// If lengths or indices of scene, design and forces do not fit together.
pub fn simulate(
    scene: &Scene,
    design: &[f64],
    forces: &Forces,
    solver: &Solver,
    keep_tape: bool,
    pool: &crate::Pool,
) -> Simulation {
    run(scene, design, forces, &planned(scene, design, forces, solver), keep_tape, pool)
}

/// What [`simulate`] carries out.
pub fn planned(scene: &Scene, design: &[f64], forces: &Forces, solver: &Solver) -> Plan {
    choose::choose_under(scene, design, forces.kinks(scene), solver)
}

/// Integrates as `plan` says; its steps are rounded up to a multiple of the forces' kinks in an interval.
///
/// # Panics
/// As `simulate`.
pub fn run(
    scene: &Scene,
    design: &[f64],
    forces: &Forces,
    plan: &Plan,
    keep_tape: bool,
    pool: &crate::Pool,
) -> Simulation {
    check(scene, design, forces);
    dispatch::simulate(scene, design, forces, plan, keep_tape, pool)
}

/// Evaluates the forces, or with `second` their derivatives along a direction, so many times on all lanes of one state, to be timed; returns ligaments times lanes times `times`, without ligaments between held units, which none evaluates.
///
/// # Panics
/// If the machine lacks `width`.
pub fn repeat_kernel(
    (width, precision): (Width, Precision),
    scene: &Scene,
    design: &[f64],
    times: usize,
    second: bool,
) -> u64 {
    dispatch::repeat_kernel((width, precision), scene, design, times, second)
}

fn check(scene: &Scene, design: &[f64], forces: &Forces) {
    let units = scene.layout.units();
    assert_eq!(design.len(), scene.layout.design_len(), "length of the design");
    assert_eq!(forces.panels, scene.panels.len(), "panels of the forces");
    assert!(
        forces.instants > 0 && forces.instants.is_multiple_of(scene.instants),
        "forces at {} instants, which is no multiple of the scene's {}",
        forces.instants,
        scene.instants
    );
    assert_eq!(
        forces.values.len(),
        forces.samples * forces.panels * (forces.instants + 1),
        "length of the forces"
    );
    let named =
        scene.clamped.iter().chain(&scene.sensors).copied().chain(scene.panels.iter().map(|p| p.unit));
    assert!(named.into_iter().all(|u| u < units), "a unit beyond the body's {units}");
}
