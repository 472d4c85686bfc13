//! A body as it is thought to be: its design, or what a calibration has found a cast of it to be.

use crate::dynamics::{Accuracy, Forces, Method, Plan, Scene, Simulation, Solver, Wrt, planned, run};
use crate::trial::{Counters, Problem, Trial};
use crate::variation::{Cast, Chips};

/// A model of a body.
pub(super) struct Model<'a> {
    problem: &'a Problem,
    pool: &'a crate::Pool,
    scene: Scene,
    design: Vec<f64>,
    chips: Chips,
    /// Of what is compared with readings.
    plan: Plan,
    /// Of differences.
    coarse: Plan,
}

/// By how much the error of the steps of differences exceeds that of signals.
const COARSE: f64 = 30.0;
/// And at most.
const COARSEST: Accuracy = Accuracy(0.05);

impl<'a> Model<'a> {
    /// Of a design, simulated with the solver that was tuned on it, or of a cast of it.
    pub(super) fn new(trial: &'a Trial<'a>, design: &[f64], solver: &Solver, cast: Option<&Cast>) -> Self {
        let (problem, pool) = (&trial.problem, trial.pool);
        let (scene, design, chips) = match cast {
            Some(cast) => (cast.scene(&problem.scene), cast.design(design), cast.chips.clone()),
            None => (problem.scene.clone(), design.to_vec(), Chips::default()),
        };
        let [plan, coarse] = {
            let (moving, forces) = problem.in_motion(&scene, &trial.train);
            let accuracy = Accuracy(COARSE * solver.accuracy.0).min(COARSEST);
            let coarse = Solver { method: Method::Auto, accuracy, ..*solver };
            [solver.in_equal_steps(), coarse].map(|solver| planned(&moving, &design, &forces, &solver))
        };
        Self { problem, pool, scene, design, chips, plan: plan.double(), coarse: coarse.double() }
    }

    /// Of the first n instants, on the clock of the forces.
    pub(super) fn instants_of(&self, forces: &Forces, n: usize) -> usize {
        n * forces.kinks(&self.scene)
    }

    /// So many instants, or as many as a sample has.
    pub(super) fn within(&self, n: usize) -> usize {
        n.min(self.scene.instants)
    }

    /// Threads.
    pub(super) fn pool(&self) -> &'a crate::Pool {
        self.pool
    }

    /// Simulates up to instant n, and gives the signals (N, n, channels) without what chips add.
    pub(super) fn simulate(
        &self,
        forces: &Forces,
        n: usize,
        counters: &mut Counters,
    ) -> (Simulation, Vec<f64>) {
        self.run(forces, n, &self.plan, true, counters)
    }

    /// The signals alone, by coarse steps.
    pub(super) fn coarse(&self, forces: &Forces, n: usize, counters: &mut Counters) -> Vec<f64> {
        self.run(forces, n, &self.coarse, false, counters).1
    }

    fn run(
        &self,
        forces: &Forces,
        n: usize,
        plan: &Plan,
        keep_tape: bool,
        counters: &mut Counters,
    ) -> (Simulation, Vec<f64>) {
        let (scene, forces) = forces.beginning(&self.scene, n);
        let (scene, forces) = self.problem.in_motion(&scene, &forces);
        let mut found = run(&scene, &self.design, &forces, plan, keep_tape, self.pool);
        counters.dynamics += found.counters;
        let mut signals = std::mem::take(&mut found.signals);
        self.chips.read(&mut signals);
        (found, self.problem.read(signals, forces.samples))
    }

    /// A cotangent on the signals as one on the forces (N, K, ·), on the clock of the motion.
    pub(super) fn push(
        &self,
        simulation: &Simulation,
        cotangent: Vec<f64>,
        counters: &mut Counters,
    ) -> Vec<f64> {
        let mut cotangent = self.problem.read_vjp(cotangent, simulation.outcomes.len());
        self.chips.read_vjp(&mut cotangent);
        let gradient = simulation.vjp(&cotangent, Wrt::Forces, self.pool);
        counters.dynamics += gradient.counters;
        gradient.forces.expect("asked for")
    }
}
