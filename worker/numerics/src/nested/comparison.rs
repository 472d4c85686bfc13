//! The final comparison: fresh decoders on the initial and on the best body, then both bodies' casts and other forces.

use super::casts::evaluate_casts;
use super::evaluation::{BodyEvaluation, Comparison, Optimised};
use super::fresh::evaluate;
use super::nonlinear::nonlinear;
use super::observe::{Log, Observe};
use super::report::Report;
use super::state::State;
use super::under::under;
use crate::dynamics;
use crate::trial::{COARSE, DesignWithSolver, PreparedTrial, Problem};

/// Separates the initial body's reason from the best body's.
const BEST: &str = ". Best body: ";

/// Whether the integrators that [`Optimised::solver`] describes meet the tolerance on the initial and on the best body. Coarse
/// steps do not count: they only move the body.
pub fn keeps_error(solver: &str) -> [bool; 2] {
    let (initial, best) = solver.split_once(BEST).unwrap_or((solver, solver));
    let initial = initial.split_once(COARSE).map_or(initial, |(usual, _)| usual);
    [initial, best].map(dynamics::keeps_error)
}

/// Compares the best body with the initial one, if requested; `None` if the observer stopped it.
pub(super) fn compare(
    trial: &PreparedTrial,
    mut state: State,
    observer: &mut dyn Observe,
) -> Option<Optimised> {
    let problem = &trial.problem;
    let initial = &problem.initial;
    // without test evaluations, the last body is the best
    let (design, best_step) = match &state.best {
        Some(best) => (best.design.clone(), best.step),
        None if problem.optimise.protocol.is_search() => (initial.clone(), 0),
        None => (state.design.clone(), state.step.saturating_sub(1)),
    };
    let mut log = Log::new(state.step, observer);
    (log.report.counters, log.report.seconds) = (state.comparison.counters, state.comparison.seconds);
    let tuned = log.timed(|s| &mut s.simulate, |_| trial.tuned(&design));
    let both = [(initial, &problem.solver), (&design, &tuned.solver)];
    let both = both.map(|(design, solver)| DesignWithSolver { trial, design, solver });
    let moulds = problem.compared(&both);
    for (turn, mould) in moulds.iter().enumerate() {
        evaluate(mould, turn, &mut state, &mut log)?;
    }
    for (turn, mould) in moulds.iter().enumerate() {
        evaluate_casts(mould, turn, &mut state, &mut log)?;
    }
    let nonlinear = moulds
        .iter()
        .map(|mould| log.timed(|s| &mut s.simulate, |report| nonlinear(mould, &mut report.counters)));
    let nonlinear = initial_and_best(problem, nonlinear.collect());
    let under = moulds
        .iter()
        .map(|mould| log.timed(|s| &mut s.simulate, |report| under(mould, &mut report.counters)));
    let under = initial_and_best(problem, under.collect());
    let Report { mut counters, seconds, .. } = log.report;
    counters.dynamics += trial.integrators.pilots;
    counters.dynamics += tuned.counters;
    let solver = format!("{}{BEST}{}", trial.integrators.reason, tuned.reason);
    let Comparison { bodies: compared, mut casts, mut bands, mut tasks, .. } = state.comparison;
    casts.resize_with(compared.len(), Vec::new);
    bands.resize_with(compared.len(), Vec::new);
    tasks.resize_with(compared.len(), Vec::new);
    let (casts, bands) = (initial_and_best(problem, casts), initial_and_best(problem, bands));
    let [mut initial, optimised] = initial_and_best(problem, compared);
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
        tasks: initial_and_best(problem, tasks),
        solver,
        signal_errors,
        counters,
        seconds,
    })
}

/// Results of the initial and the best body. Without outer steps both are the same; an initial body that was not compared has the
/// default.
fn initial_and_best<T: Clone + Default>(problem: &Problem, mut found: Vec<T>) -> [T; 2] {
    let last = found.pop().expect("a body was compared");
    let unmoved = problem.optimise.iterations == 0;
    let first = if unmoved { last.clone() } else { found.pop().unwrap_or_default() };
    [first, last]
}

/// Trains fresh networks of the same initial weights on each design, until the observer stops it.
pub fn evaluate_designs(
    trial: &PreparedTrial,
    designs: &[Vec<f64>],
    observer: &mut dyn Observe,
) -> Vec<BodyEvaluation> {
    let (mut state, mut log) = (State::new(&trial.problem), Log::new(0, observer));
    for (turn, design) in designs.iter().enumerate() {
        let mould = DesignWithSolver { trial, design, solver: &trial.tuned(design).solver };
        if evaluate(&mould, turn, &mut state, &mut log).is_none() {
            break;
        }
    }
    state.comparison.bodies
}
