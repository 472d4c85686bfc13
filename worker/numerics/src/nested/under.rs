//! Errors under forces for which a body was not trained, with a linear decoder fitted under these forces and with the one fitted
//! under the trial's. The former shows what information remains, the latter how a decoder transfers.

use crate::brains::Fitted;
use crate::trial::{Counters, DesignWithSolver, Spread, Trouble, as_ref_result, mean_error};

/// Error of one linear decoder under one kind of forces.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UnderReading {
    /// Index in `Problem::under`.
    pub kind: usize,
    /// Whether the decoder was fitted under these forces, not under the trial's.
    pub own: bool,
    /// Mean error on the held-out set (%), or the failure; `None` if no sample has a force.
    pub error: Result<Option<f64>, Trouble>,
    /// Quantiles of the errors on the held-out set.
    pub spread: Option<Spread>,
}

/// Errors of a body under all further kinds, per kind first the decoder fitted under it. `mould` has the solver tuned under the
/// trial's forces.
pub(super) fn under(mould: &DesignWithSolver, counters: &mut Counters) -> Vec<UnderReading> {
    let &DesignWithSolver { trial, design, .. } = mould;
    let problem = &trial.problem;
    if problem.under.is_empty() {
        return Vec::new();
    }
    let [train, _] = problem.training_and_test();
    let known = mould.samples(None, train, counters);
    let carried = known.and_then(|known| Fitted::of(trial, &known));
    let mut found = Vec::with_capacity(2 * problem.under.len());
    for (kind, source) in problem.under.iter().enumerate() {
        let there =
            trial.with_source(source, design).map_err(|failure| failure.trouble()).and_then(|there| {
                counters.dynamics += there.integrators.pilots;
                let body = DesignWithSolver { trial: &there, design, solver: &there.problem.solver };
                let read = body.samples(None, there.problem.holdout(), counters)?;
                Ok((there, read))
            });
        let there = as_ref_result(&there);
        let own =
            there.and_then(|(there, holdout)| Ok(Fitted::of(there, &there.initial)?.errors_on(holdout)));
        let carried = there.and_then(|(_, holdout)| Ok(as_ref_result(&carried)?.errors_on(holdout)));
        let reading = |own, errors: Result<Vec<Option<f64>>, Trouble>| {
            let spread = errors.as_ref().map_or(Some(Spread::FAILED), |errors| Spread::of(errors));
            UnderReading { kind, own, error: errors.map(|errors| mean_error(&errors)), spread }
        };
        found.extend([reading(true, own), reading(false, carried)]);
    }
    found
}
