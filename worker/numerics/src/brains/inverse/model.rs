//! Model of a body: its design, or a calibrated cast of it.

use crate::dynamics::{
    Accuracy, Forces, IntegrationPlan, Integrator, IntegratorSettings, Scene, Simulation, Wrt, planned, run,
};
use crate::trial::{Counters, PreparedTrial, Problem};
use crate::variation::{Cast, Chips};

/// A model of a body.
pub(super) struct Model<'a> {
    problem: &'a Problem,
    pub(super) pool: &'a crate::Pool,
    pub(super) scene: Scene,
    design: Vec<f64>,
    chips: Chips,
    /// Steps of simulations that are compared with readings.
    plan: IntegrationPlan,
    /// Steps of differences.
    coarse: IntegrationPlan,
}

/// Tolerance of the steps of differences, relative to that of signals.
const COARSE: f64 = 30.0;
/// Largest tolerance of these steps.
const COARSEST: f64 = 0.05;

impl<'a> Model<'a> {
    /// Model of a design, simulated with the solver tuned on it, or of a cast of it.
    pub(super) fn new(
        trial: &'a PreparedTrial<'a>,
        design: &[f64],
        solver: &IntegratorSettings,
        cast: Option<&Cast>,
    ) -> Self {
        let (problem, pool) = (&trial.problem, trial.pool);
        let (scene, design, chips) = match cast {
            Some(cast) => (cast.scene(&problem.scene), cast.design(design), cast.chips.clone()),
            None => (problem.scene.clone(), design.to_vec(), Chips::default()),
        };
        let [plan, coarse] = {
            let (moving, forces) = problem.in_motion(&scene, &trial.train);
            let accuracy = Accuracy((COARSE * solver.accuracy.0).min(COARSEST));
            let coarse = IntegratorSettings { method: Integrator::Auto, accuracy, ..*solver };
            [solver.in_equal_steps(), coarse].map(|solver| planned(&moving, &design, &forces, &solver))
        };
        Self { problem, pool, scene, design, chips, plan: plan.double(), coarse: coarse.double() }
    }

    /// Simulates up to instant n; returns signals (N, n, channels) without noise. Without a tape, with coarse steps.
    pub(super) fn simulate(
        &self,
        forces: &Forces,
        n: usize,
        keep_tape: bool,
        counters: &mut Counters,
    ) -> (Simulation, Vec<f64>) {
        let plan = if keep_tape { &self.plan } else { &self.coarse };
        let (scene, forces) = forces.beginning(&self.scene, n);
        let (scene, forces) = self.problem.in_motion(&scene, &forces);
        let mut found = run(&scene, &self.design, &forces, plan, keep_tape, self.pool);
        counters.dynamics += found.counters;
        let mut signals = std::mem::take(&mut found.signals);
        self.chips.read(&mut signals);
        (found, self.problem.read(signals, forces.samples))
    }

    /// Maps a cotangent on the signals to the forces (N, K, ·), on the clock of the motion.
    pub(super) fn signals_vjp(
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
