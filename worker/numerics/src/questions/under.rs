//! How a body is read under forces that it need not have been trained for.
//!
//! By a linear brain that is fitted anew under these forces, and by the one that was fitted under the trial's: the first is
//! what the body still tells, the second what a reader makes of it that has not met them.

use crate::brains::Fitted;
use crate::dynamics::Solver;
use crate::random::Purpose;
use crate::trial::{Counters, Samples, Trial, Trouble};

/// How one linear brain reads a body under forces of one kind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UnderReading {
    /// Which of `Problem::under`.
    pub kind: usize,
    /// Whether it was fitted under these forces, and not under the trial's.
    pub own: bool,
    /// Mean error on the holdout (%), or why there is none; `None` where no sample has a force.
    pub error: Result<Option<f64>, Trouble>,
}

/// Of a body whose integrator under the trial's own forces is `solver`; of each kind first the brain fitted under it.
pub(crate) fn under(
    trial: &Trial,
    design: &[f64],
    solver: &Solver,
    counters: &mut Counters,
) -> Vec<UnderReading> {
    let problem = &trial.problem;
    if problem.under.is_empty() {
        return Vec::new();
    }
    let [train, _] = problem.known();
    let known = trial.simulate_most(design, train, solver, false, counters);
    let carried = known.and_then(|known| Fitted::of(trial, &known.samples));
    let mut found = Vec::with_capacity(2 * problem.under.len());
    for (kind, source) in problem.under.iter().enumerate() {
        let there = trial.under(source, design).map_err(|failure| failure.trouble()).and_then(|there| {
            counters.dynamics += there.pilots;
            let (forces, solver) =
                (there.problem.forces(Purpose::Holdout, 0, problem.stimuli.holdout), there.problem.solver);
            let read = there.simulate_most(design, forces, &solver, false, counters)?;
            Ok((there, read.samples))
        });
        let there = there.as_ref().map_err(|trouble| *trouble);
        let error = |brain: &Fitted, holdout: &Samples| brain.error_on(holdout);
        let own = there.and_then(|(there, holdout)| Ok(error(&Fitted::of(there, &there.initial)?, holdout)));
        let carried = there.and_then(|(_, holdout)| {
            carried.as_ref().map(|carried| error(carried, holdout)).map_err(|trouble| *trouble)
        });
        let reading = |own, error| UnderReading { kind, own, error };
        found.extend([reading(true, own), reading(false, carried)]);
    }
    found
}
