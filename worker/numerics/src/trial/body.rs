//! The body as the nested optimisation uses it: signals of a design under forces, their gradient, and feasible designs.
//!
//! ```text
//! A = signals of α under f        dL/dα = Aᵀ_α dL/dA        α ← Π(α)
//! ```
//! A [`Scene`] has panels, sensors, clock, and the body itself if it consists of polygons. Only polygons support casts, moulds,
//! modes, bounds, identification, fast sensor search, and drawings of motion.

use super::Problem;
use crate::Pool;
use crate::body::Freedom;
use crate::dynamics::{
    self, Forces, IntegratorSettings, Outcome, Scene, Simulation, SimulationCounts, Tuned, Wrt, planned, tune,
};
use crate::feasible::Castable;

/// A differentiable body.
pub trait BodyModel: std::fmt::Debug + Send + Sync {
    /// Channels of each sensor, at most 3.
    fn channels(&self) -> usize;

    /// Tunes the integrator to the tolerance on a design, with a few samples.
    fn pilot(
        &self,
        scene: &Scene,
        design: &[f64],
        forces: &Forces,
        solver: &IntegratorSettings,
        pool: &Pool,
    ) -> Pilot;

    /// Simulates a design.
    fn simulate(&self, scene: &Scene, run: &SimulationInput, pool: &Pool) -> SimulationOutput;

    /// Which numbers of a design are free, fixed or tied.
    fn freedom(&self, problem: &Problem) -> Freedom;

    /// The feasible designs.
    fn castable(&self, problem: &Problem) -> Box<dyn Castable>;

    /// The body's own drawing (SVG) of a design, if it has one.
    fn svg(&self, _design: &[f64]) -> Option<String> {
        None
    }

    /// The failure of the body's process, if any; results are then invalid.
    fn failure(&self) -> Option<BodyFailure> {
        None
    }
}

/// Input of a simulation.
#[derive(Debug, Clone, Copy)]
pub struct SimulationInput<'a> {
    /// α, the design.
    pub design: &'a [f64],
    /// Forces; their clock is an integer multiple of the scene's.
    pub forces: &'a Forces,
    /// Solver tuned by a pilot.
    pub solver: &'a IntegratorSettings,
    /// Whether a gradient follows.
    pub keep_tape: bool,
    /// Whether to compute in f64, because f32 rounding would disturb the result.
    pub double: bool,
}

/// Result of a simulation.
pub struct SimulationOutput {
    /// (N, T, M·channels); mm/s² and rad/s for polygons; zero for failed samples.
    pub signals: Vec<f64>,
    /// How each sample ended.
    pub outcomes: Vec<Outcome>,
    /// Work of the simulation.
    pub counters: SimulationCounts,
    /// Tape for gradients, if requested.
    pub tape: Box<dyn BodyTape>,
}

/// Record of a simulation, for its gradient.
pub trait BodyTape: Send + Sync {
    /// dL/dα from a cotangent on the signals (N, T, M·channels), and the work. Failed samples contribute nothing.
    fn vjp(&self, cotangent: &[f64], pool: &Pool) -> (Vec<f64>, SimulationCounts);
}

/// Result of a pilot.
#[derive(Debug, Clone)]
pub struct Pilot {
    /// The tuned solver.
    pub solver: IntegratorSettings,
    /// Why the solver was chosen, as text.
    pub reason: String,
    /// Relative error of the pilot's signals, if measured.
    pub error: Option<f64>,
    /// Work of the pilot.
    pub counters: SimulationCounts,
}

/// Failure of a body's process.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BodyFailure {
    /// Name in records.
    pub name: &'static str,
    /// Command, cause, and what the process printed.
    pub detail: String,
}

/// The polygons and ligaments of a scene.
#[derive(Debug)]
pub struct ScenePolygons;

impl BodyModel for ScenePolygons {
    fn channels(&self) -> usize {
        3
    }

    fn pilot(
        &self,
        scene: &Scene,
        design: &[f64],
        forces: &Forces,
        solver: &IntegratorSettings,
        pool: &Pool,
    ) -> Pilot {
        let Tuned { solver, plan, error, counters } = tune(scene, design, forces, solver, pool);
        Pilot { solver, reason: plan.reason, error, counters }
    }

    fn simulate(&self, scene: &Scene, run: &SimulationInput, pool: &Pool) -> SimulationOutput {
        let SimulationInput { design, forces, solver, keep_tape, double } = *run;
        let plan = planned(scene, design, forces, solver);
        let plan = if double { plan.double() } else { plan };
        let mut simulation = dynamics::run(scene, design, forces, &plan, keep_tape, pool);
        SimulationOutput {
            signals: std::mem::take(&mut simulation.signals),
            outcomes: simulation.outcomes.clone(),
            counters: simulation.counters,
            tape: Box::new(simulation),
        }
    }

    fn freedom(&self, problem: &Problem) -> Freedom {
        Freedom::new(&problem.scene.layout, problem.tie, &problem.frozen)
    }

    fn castable(&self, problem: &Problem) -> Box<dyn Castable> {
        Box::new(problem.castable())
    }
}

impl BodyTape for Simulation {
    fn vjp(&self, cotangent: &[f64], pool: &Pool) -> (Vec<f64>, SimulationCounts) {
        let gradient = Simulation::vjp(self, cotangent, Wrt::Design, pool);
        (gradient.design, gradient.counters)
    }
}
