//! How a body is read under forces that it need not have been trained for.
//!
//! By a linear brain that is fitted anew under these forces, and by the one that was fitted under the trial's: the first is
//! what the body still tells, the second what a reader makes of it that has not met them.

use crate::brains::Fitted;
use crate::trial::{Counters, Mould, Spread, Trouble, held, mean_error};

/// How one linear brain reads a body under forces of one kind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UnderReading {
    /// Which of `Problem::under`.
    pub kind: usize,
    /// Whether it was fitted under these forces, and not under the trial's.
    pub own: bool,
    /// Mean error on the holdout (%), or why there is none; `None` where no sample has a force.
    pub error: Result<Option<f64>, Trouble>,
    /// How the errors on the holdout spread.
    pub spread: Option<Spread>,
}

/// Of a body whose integrator is tuned under the trial's own forces; of each kind first the brain fitted under it.
pub(crate) fn under(mould: &Mould, counters: &mut Counters) -> Vec<UnderReading> {
    let &Mould { trial, design, .. } = mould;
    let problem = &trial.problem;
    if problem.under.is_empty() {
        return Vec::new();
    }
    let [train, _] = problem.known();
    let known = mould.samples(None, train, counters);
    let carried = known.and_then(|known| Fitted::of(trial, &known));
    let mut found = Vec::with_capacity(2 * problem.under.len());
    for (kind, source) in problem.under.iter().enumerate() {
        let there = trial.under(source, design).map_err(|failure| failure.trouble()).and_then(|there| {
            counters.dynamics += there.pilots;
            let body = Mould { trial: &there, design, solver: &there.problem.solver };
            let read = body.samples(None, there.problem.holdout(), counters)?;
            Ok((there, read))
        });
        let there = held(&there);
        let own =
            there.and_then(|(there, holdout)| Ok(Fitted::of(there, &there.initial)?.errors_on(holdout)));
        let carried = there.and_then(|(_, holdout)| Ok(held(&carried)?.errors_on(holdout)));
        let reading = |own, errors: Result<Vec<Option<f64>>, Trouble>| {
            let spread = errors.as_ref().map_or(Some(Spread::FAILED), |errors| Spread::of(errors));
            UnderReading { kind, own, error: errors.map(|errors| mean_error(&errors)), spread }
        };
        found.extend([reading(true, own), reading(false, carried)]);
    }
    found
}
