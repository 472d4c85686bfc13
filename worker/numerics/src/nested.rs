//! Nested optimisation of body and brain: the outer loop.
//!
//! ```text
//! A(α) = signals of the body α          β*(A) = argmin L_train(β, A)
//! g = dL/dα at (α, β*)                  α ← Π(α − Adam(g)),  Π: nearest castable design
//! ```
//! How far β is trained and which loss moves the body is the [`Protocol`]'s matter; the rest is the same for all.
//! Searches without a gradient stand beside them as baselines. Afterwards the initial and the best body meet fresh networks, on the holdout too, which nothing else touches.

mod casts;
mod comparison;
mod evaluation;
mod fresh;
mod inversion;
mod observe;
mod protocol;
mod report;
mod schedule;
mod search;
mod state;

pub use casts::{ForCasts, RECORDS, brain_for_casts, casts_of};
pub use evaluation::{BandReading, BodyEvaluation, CastBrain, CastReading, Comparison, NetworkEvaluation};
pub use inversion::INVERTED_OF_A_CAST;
pub use observe::{Control, Nobody, Observe};
pub use report::{Report, Seconds};
pub use schedule::between_looks;
pub use state::{Best, State, Waypoint};

use casts::read_casts;
use comparison::evaluate;
use observe::Log;
use protocol::{Sensed, Session};
use search::GradientFree;

use crate::questions::{Nonlinear, UnderReading, nonlinear, under};
use crate::trial::{Counters, Failure, Problem, Trial};

/// What a nested optimisation found.
#[derive(Debug, Clone)]
pub struct Optimised {
    /// The initial body, with its fresh networks where they were asked for.
    pub initial: BodyEvaluation,
    /// The best body, with fresh networks of the same initial weights.
    pub optimised: BodyEvaluation,
    /// The outer step whose design is the best, by the test set.
    pub best_step: u32,
    /// How casts of both bodies are read, where the trial asks about them.
    pub casts: [Vec<CastReading>; 2],
    /// Bands about what is read of both bodies, and of their casts.
    pub bands: [Vec<BandReading>; 2],
    /// The part of both bodies' signals that their linearisation at rest does not give.
    pub nonlinear: [Option<Nonlinear>; 2],
    /// How both bodies are read under forces of the kinds that the trial asks about.
    pub under: [Vec<UnderReading>; 2],
    /// What the solvers came to, and why.
    pub solver: String,
    /// Relative error of the signals of both pilots, initial body and best, where measured.
    pub signal_errors: [Option<f64>; 2],
    /// Counts of work of the pilot that tuned them and of the evaluations: of one, where nothing has moved the body.
    pub counters: Counters,
    /// Seconds of the evaluations.
    pub seconds: Seconds,
}

/// Optimises the body of `trial` together with its brain, from the beginning or from a state that `observer` was given
/// earlier, within the comparison too; goes on from there to the same bits. `None` if the observer said stop.
///
/// # Errors
/// If the initial body cannot be simulated or trained, or no smaller step leads out of trouble.
pub fn optimise(
    trial: &Trial,
    resume: Option<State>,
    observer: &mut dyn Observe,
) -> Result<Option<Optimised>, Failure> {
    let problem = &trial.problem;
    let (mut castable, freedom) = (problem.castable(), problem.freedom());
    let mut state = resume.unwrap_or_else(|| State::new(problem));
    let (mut search, mut session) = (GradientFree::new(problem, &state.found), Session::new(trial));

    while state.step < problem.optimise.iterations {
        let (before, mut log) = (state.clone(), Log::new(state.step, observer));
        match (session.sense(&mut state, &mut log), &mut search) {
            (sensed, Some(search)) => search.step(sensed, &mut state, &mut castable, &mut log)?,
            (Ok(Sensed { gradient, loss_train, error_test }), None) => {
                state.remember(loss_train, error_test);
                let bodies = session.bodies();
                log.timed(
                    |s| &mut s.project,
                    |report| state.move_body(problem, &freedom, &gradient, &mut castable, bodies, report),
                );
            }
            (Err(trouble), None) => state = before.taken_back(trouble, &mut log.report)?,
        }
        state.step += 1;
        let report = log.report;
        observer.progress(problem.progress(state.step));
        if observer.step(&report, &state) == Control::Stop {
            return Ok(None);
        }
    }
    Ok(compared(trial, state, observer))
}

/// The comparison of the best body, and of the initial one where asked for; `None` if the observer said stop.
fn compared(trial: &Trial, mut state: State, observer: &mut dyn Observe) -> Option<Optimised> {
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
    let bodies = problem.compared(&both);
    // earlier versions compared a body that nothing has moved twice
    if state.comparison.bodies.len() > bodies.len() {
        let Comparison { bodies: compared, casts, bands, training, .. } = &mut state.comparison;
        compared.truncate(bodies.len());
        casts.truncate(bodies.len());
        bands.truncate(bodies.len());
        *training = None;
    }
    for (turn, (design, solver)) in bodies.iter().enumerate() {
        evaluate(trial, design, solver, turn, &mut state, &mut log)?;
    }
    for (turn, (design, solver)) in bodies.iter().enumerate() {
        read_casts(trial, design, solver, turn, &mut state, &mut log)?;
    }
    let nonlinear = bodies.iter().map(|(design, solver)| {
        log.timed(|s| &mut s.simulate, |report| nonlinear(trial, design, solver, &mut report.counters))
    });
    let nonlinear = of_both(problem, nonlinear.collect());
    let under = bodies.iter().map(|(design, solver)| {
        log.timed(|s| &mut s.simulate, |report| under(trial, design, solver, &mut report.counters))
    });
    let under = of_both(problem, under.collect());
    let Report { mut counters, seconds, .. } = log.report;
    counters.dynamics += trial.pilots;
    counters.dynamics += tuned.counters;
    let solver = format!("{}. Best body: {}", trial.reason, tuned.plan.reason);
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
        let solver = trial.tuned(design).solver;
        if evaluate(trial, design, &solver, turn, &mut state, &mut log).is_none() {
            break;
        }
    }
    state.comparison.bodies
}

#[cfg(test)]
pub(crate) mod tests;
