//! A trial made ready on its initial body: its sensors in place, its integrators tuned by a pilot on the first samples.

use super::placing::placed;
use super::problem::Problem;
use super::report::Failure;
use crate::dynamics::{Counters, Tuned, tune};
use crate::place::Placed;
use crate::random::Purpose;

/// A problem with sensors whose solvers keep their tolerances by measurement.
pub(super) struct Tuning {
    /// The same, its sensors in place.
    pub(super) asked: Problem,
    /// That with its solvers tuned.
    pub(super) problem: Problem,
    /// What the search found.
    pub(super) placed: Option<Placed>,
    /// What they became, and why.
    pub(super) reason: String,
    /// Relative error of the accurate one's signals, where measured.
    pub(super) error: Option<f64>,
    /// Work of the pilots.
    pub(super) counters: Counters,
}

/// Samples of the pilots: as many as the lanes take at once.
const SAMPLES: usize = 8;

impl Tuning {
    /// The same for every process that goes on with a trial or looks at its result.
    ///
    /// # Errors
    /// If sensors are to be searched for, and the initial body cannot be simulated or has no place for them.
    pub(super) fn new(problem: &Problem, pool: &crate::Pool) -> Result<Self, Failure> {
        let (asked, placed) = placed(problem, pool)?;
        let mut problem = asked.clone();
        let forces = problem.forces(Purpose::Stimulus, 0, problem.stimuli.samples.min(SAMPLES));
        let pilot = |solver: &_| tune(&problem.scene, &problem.initial, &forces, solver, pool);
        let usual = pilot(&problem.solver);
        let coarse: Option<Tuned> = problem.optimise.coarse.as_ref().map(pilot);
        let (mut reason, mut counters, error) = (usual.plan.reason, usual.counters, usual.error);
        problem.solver = usual.solver;
        if let Some(coarse) = coarse {
            reason = format!("{reason}. Coarse steps: {}", coarse.plan.reason);
            counters += coarse.counters;
            problem.optimise.coarse = Some(coarse.solver);
        }
        Ok(Self { asked, problem, placed, reason, error, counters })
    }

    /// What the accurate solver of the spec comes to on another body, by a pilot of its own.
    pub(super) fn of_body(asked: &Problem, design: &[f64], pool: &crate::Pool) -> Tuned {
        let forces = asked.forces(Purpose::Stimulus, 0, asked.stimuli.samples.min(SAMPLES));
        tune(&asked.scene, design, &forces, &asked.solver, pool)
    }
}
