//! The comparison at the end: fresh brains on the initial and on the best body, then what is left of both in casts and under
//! other forces.

use super::casts::read_casts;
use super::evaluation::{BodyEvaluation, Comparison, Optimised};
use super::fresh::evaluate;
use super::observe::{Log, Observe};
use super::report::Report;
use super::state::State;
use crate::dynamics;
use crate::questions::{nonlinear, under};
use crate::trial::{COARSE, Mould, Problem, Trial};

/// What stands in a trial's reason before that of its best body.
const BEST: &str = ". Best body: ";

/// Whether the integrators of a trial, by [`Optimised::solver`], keep the error asked on the initial and on the best body; coarse steps
/// move a body, and no error is by them.
pub fn keeps_error(solver: &str) -> [bool; 2] {
    let (initial, best) = solver.split_once(BEST).unwrap_or((solver, solver));
    let initial = initial.split_once(COARSE).map_or(initial, |(usual, _)| usual);
    [initial, best].map(dynamics::keeps_error)
}

/// The comparison of the best body, and of the initial one where asked for; `None` if the observer said stop.
pub(super) fn compared(trial: &Trial, mut state: State, observer: &mut dyn Observe) -> Option<Optimised> {
    let problem = &trial.problem;
    let initial = &problem.initial;
    // a body that was trained and never looked at is not the initial one
    let (design, best_step) = match &state.best {
        Some(best) => (best.design.clone(), best.step),
        None if problem.optimise.protocol.is_search() => (initial.clone(), 0),
        None => (state.design.clone(), state.step.saturating_sub(1)),
    };
    let mut log = Log::new(state.step, observer);
    (log.report.counters, log.report.seconds) = (state.comparison.counters, state.comparison.seconds);
    let tuned = log.timed(|s| &mut s.simulate, |_| trial.tuned(&design));
    let both = [(initial, &problem.solver), (&design, &tuned.solver)];
    let both = both.map(|(design, solver)| Mould { trial, design, solver });
    let moulds = problem.compared(&both);
    for (turn, mould) in moulds.iter().enumerate() {
        evaluate(mould, turn, &mut state, &mut log)?;
    }
    for (turn, mould) in moulds.iter().enumerate() {
        read_casts(mould, turn, &mut state, &mut log)?;
    }
    let nonlinear = moulds
        .iter()
        .map(|mould| log.timed(|s| &mut s.simulate, |report| nonlinear(mould, &mut report.counters)));
    let nonlinear = of_both(problem, nonlinear.collect());
    let under = moulds
        .iter()
        .map(|mould| log.timed(|s| &mut s.simulate, |report| under(mould, &mut report.counters)));
    let under = of_both(problem, under.collect());
    let Report { mut counters, seconds, .. } = log.report;
    counters.dynamics += trial.pilots;
    counters.dynamics += tuned.counters;
    let solver = format!("{}{BEST}{}", trial.reason, tuned.reason);
    let Comparison { bodies: compared, mut casts, mut bands, .. } = state.comparison;
    casts.resize_with(compared.len(), Vec::new);
    bands.resize_with(compared.len(), Vec::new);
    let (casts, bands) = (of_both(problem, casts), of_both(problem, bands));
    let [mut initial, optimised] = of_both(problem, compared);
    initial.design.clone_from(&problem.initial);
    let signal_errors = [trial.tuned(&problem.initial).error, tuned.error];
    Some(Optimised {
        initial,
        optimised,
        best_step,
        casts,
        bands,
        nonlinear,
        under,
        solver,
        signal_errors,
        counters,
        seconds,
    })
}

/// What was found of the initial and of the best body: of one that nothing has moved it is both, and nothing of an initial one
/// that was not compared.
fn of_both<T: Clone + Default>(problem: &Problem, mut found: Vec<T>) -> [T; 2] {
    let last = found.pop().expect("a body was compared");
    let unmoved = problem.optimise.iterations == 0;
    let first = if unmoved { last.clone() } else { found.pop().unwrap_or_default() };
    [first, last]
}

/// The comparison at the end for any designs: fresh networks of the same initial weights on each, until the observer says
/// stop.
pub fn evaluate_designs(
    trial: &Trial,
    designs: &[Vec<f64>],
    observer: &mut dyn Observe,
) -> Vec<BodyEvaluation> {
    let (mut state, mut log) = (State::new(&trial.problem), Log::new(0, observer));
    for (turn, design) in designs.iter().enumerate() {
        let mould = Mould { trial, design, solver: &trial.tuned(design).solver };
        if evaluate(&mould, turn, &mut state, &mut log).is_none() {
            break;
        }
    }
    state.comparison.bodies
}
