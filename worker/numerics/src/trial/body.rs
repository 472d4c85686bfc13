//! A body as the nested optimisation uses it: signals of a design under forces, their gradient, and the designs that it can have.
//!
//! ```text
//! A = signals of α under f        dL/dα = Aᵀ_α dL/dA        α ← Π(α)
//! ```
//! A [`Scene`] gives panels, sensors and clock, and of polygons the body itself. Only polygons have casts, moulds, modes, bounds,
//! identification, placement by their own fields, and drawings of motion.

use super::Problem;
use crate::Pool;
use crate::body::Freedom;
use crate::dynamics::{
    self, Counters, Forces, Outcome, Scene, Simulation, Solver, Tuned, Wrt, planned, tune,
};
use crate::feasible::Castable;

/// A differentiable body.
pub trait Body: std::fmt::Debug + Send + Sync {
    /// Channels of each sensor, at most 3.
    fn channels(&self) -> usize;

    /// The integrator that keeps the error asked on a design, by a few samples.
    fn pilot(&self, scene: &Scene, design: &[f64], forces: &Forces, solver: &Solver, pool: &Pool) -> Pilot;

    /// Simulates a design.
    fn simulate(&self, scene: &Scene, run: &Run, pool: &Pool) -> Motion;

    /// Which numbers of a design move, and which together.
    fn freedom(&self, problem: &Problem) -> Freedom;

    /// The designs that the body can have.
    fn castable(&self, problem: &Problem) -> Box<dyn Castable>;

    /// Why nothing that the body returned is to be used: its process failed.
    fn failure(&self) -> Option<Fault> {
        None
    }
}

/// What a simulation starts from.
#[derive(Debug, Clone, Copy)]
pub struct Run<'a> {
    /// α.
    pub design: &'a [f64],
    /// On the scene's clock, or one that divides it.
    pub forces: &'a Forces,
    /// Tuned by a pilot.
    pub solver: &'a Solver,
    /// Whether a gradient is to follow.
    pub keep_tape: bool,
    /// Whether rounding to f32 would be noise.
    pub double: bool,
}

/// What a simulation gives.
pub struct Motion {
    /// (N, T, M·channels), mm/s² and rad/s of polygons; zero after a sample has failed.
    pub signals: Vec<f64>,
    /// How each sample ended.
    pub outcomes: Vec<Outcome>,
    /// Work done.
    pub counters: Counters,
    /// For gradients, where asked for.
    pub tape: Box<dyn Tape>,
}

/// What a gradient starts from.
pub trait Tape: Send + Sync {
    /// dL/dα of a cotangent on the signals (N, T, M·channels), and the work. Samples that failed add nothing.
    fn vjp(&self, cotangent: &[f64], pool: &Pool) -> (Vec<f64>, Counters);
}

/// What a pilot made of a solver.
#[derive(Debug, Clone)]
pub struct Pilot {
    /// With what the pilot found.
    pub solver: Solver,
    /// Why, in words.
    pub reason: String,
    /// Relative error of the pilot's signals; none where it was not measured.
    pub error: Option<f64>,
    /// The pilot's work.
    pub counters: Counters,
}

/// How a body's process failed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// Its name in records.
    pub name: &'static str,
    /// Command, cause, and what the process printed.
    pub detail: String,
}

/// The body of polygons and ligaments that a scene contains.
#[derive(Debug)]
pub struct Polygons;

impl Body for Polygons {
    fn channels(&self) -> usize {
        3
    }

    fn pilot(&self, scene: &Scene, design: &[f64], forces: &Forces, solver: &Solver, pool: &Pool) -> Pilot {
        let Tuned { solver, plan, error, counters } = tune(scene, design, forces, solver, pool);
        Pilot { solver, reason: plan.reason, error, counters }
    }

    fn simulate(&self, scene: &Scene, run: &Run, pool: &Pool) -> Motion {
        let Run { design, forces, solver, keep_tape, double } = *run;
        let plan = planned(scene, design, forces, solver);
        let plan = if double { plan.double() } else { plan };
        let mut simulation = dynamics::run(scene, design, forces, &plan, keep_tape, pool);
        Motion {
            signals: std::mem::take(&mut simulation.signals),
            outcomes: simulation.outcomes.clone(),
            counters: simulation.counters,
            tape: Box::new(simulation),
        }
    }

    fn freedom(&self, problem: &Problem) -> Freedom {
        Freedom::of(&problem.scene.layout, problem.tie, &problem.frozen, &problem.kept)
    }

    fn castable(&self, problem: &Problem) -> Box<dyn Castable> {
        Box::new(problem.castable())
    }
}

impl Tape for Simulation {
    fn vjp(&self, cotangent: &[f64], pool: &Pool) -> (Vec<f64>, Counters) {
        let gradient = Simulation::vjp(self, cotangent, Wrt::Design, pool);
        (gradient.design, gradient.counters)
    }
}
