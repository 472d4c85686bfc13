//! The integrators of a trial, made ready by a pilot on its initial body and its first samples.

use super::problem::Problem;
use crate::dynamics::{Counters, Tuned, tune};
use crate::random::Purpose;

/// A problem whose solvers keep their tolerances by measurement.
pub(super) struct Tuning {
    /// The same but for solvers.
    pub(super) problem: Problem,
    /// What they became, and why.
    pub(super) reason: String,
    /// Work of the pilots.
    pub(super) counters: Counters,
}

/// Samples of the pilots: as many as the lanes take at once.
const SAMPLES: usize = 8;

impl Tuning {
    /// The same for every process that goes on with a trial or looks at its result.
    pub(super) fn new(problem: &Problem, pool: &rayon::ThreadPool) -> Self {
        let mut problem = problem.clone();
        let forces = problem.forces(Purpose::Stimulus, 0, problem.stimuli.samples.min(SAMPLES));
        let pilot = |solver: &_| tune(&problem.scene, &problem.initial, &forces, solver, pool);
        let usual = pilot(&problem.solver);
        let coarse: Option<Tuned> = problem.optimise.coarse.as_ref().map(pilot);
        let (mut reason, mut counters) = (usual.plan.reason, usual.counters);
        problem.solver = usual.solver;
        if let Some(coarse) = coarse {
            reason = format!("{reason}. Coarse steps: {}", coarse.plan.reason);
            counters += coarse.counters;
            problem.optimise.coarse = Some(coarse.solver);
        }
        Self { problem, reason, counters }
    }
}
