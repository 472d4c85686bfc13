//! Nested optimisation of body and brain: the outer loop.
//!
//! ```text
//! A(α) = signals of the body α          β*(A) = argmin L_train(β, A)
//! g = dL/dα at (α, β*)                  α ← Π(α − Adam(g)),  Π: nearest castable design
//! ```
//! How far β is trained and which loss moves the body is the [`Protocol`]'s matter; the rest is the same for all.
//! Searches without a gradient stand beside them as baselines. Afterwards the initial and the best body meet fresh networks, on the holdout too, which nothing else touches.

mod bounding;
mod chip;
mod evaluation;
mod fitted;
mod implicit;
mod linear;
mod linearity;
mod placing;
mod problem;
mod protocol;
mod replay;
mod report;
mod search;
mod setting;
mod state;
mod tuning;
mod unseen;

pub use bounding::{Bound, bound};
pub use chip::{Disturbance, Size};
pub use evaluation::{BodyEvaluation, Comparison, Fresh, NetworkEvaluation};
pub use fitted::Fitted;
pub use linear::{Decoder, READINGS_MAX, Reading, Ridge, fits};
pub use linearity::Nonlinear;
pub use placing::{Candidates, placed};
pub use problem::{Evaluation, Going, Kind, Optimise, Problem, Protocol, Schedule, Stimuli, Terms, Training};
pub use replay::{LinearReplay, Motion, Replay, motion, replay};
pub use report::{Control, Counters, Failure, Implicit, Observe, Report, Seconds, Trouble};
pub use state::{Best, State, Waypoint};
pub use unseen::{Records, Unseen, folds, sense};

use evaluation::evaluate;
use linearity::nonlinear;
use protocol::Session;
use report::Log;
use search::Search;
use setting::Setting;
use tuning::Tuning;

use crate::place::Placed;

/// What a nested optimisation found.
#[derive(Debug, Clone)]
pub struct Optimised {
    /// The initial body, with its fresh networks.
    pub initial: BodyEvaluation,
    /// The best body, with fresh networks of the same initial weights.
    pub optimised: BodyEvaluation,
    /// The outer step whose design is the best, by the test set.
    pub best_step: u32,
    /// Where a search put the sensors, where there was one.
    pub placed: Option<Placed>,
    /// The part of both bodies' signals that their linearisation at rest does not give.
    pub nonlinear: [Option<Nonlinear>; 2],
    /// What the solvers came to, and why.
    pub solver: String,
    /// Relative error of the signals of the two evaluations' pilots, initial body and best, where measured.
    pub signal_errors: [Option<f64>; 2],
    /// Counts of work of the pilot that tuned them and of the two evaluations.
    pub counters: Counters,
    /// Seconds of the two evaluations.
    pub seconds: Seconds,
}

/// Optimises the body of `problem` together with its brain, from the beginning or from a state that `observer` was
/// given earlier, within the comparison too; goes on from there to the same bits. `None` if the observer said stop.
///
/// # Errors
/// If the initial body cannot be simulated or trained, or no smaller step leads out of trouble.
pub fn optimise(
    problem: &Problem,
    resume: Option<State>,
    pool: &crate::Pool,
    observer: &mut dyn Observe,
) -> Result<Option<Optimised>, Failure> {
    let tuning = Tuning::new(problem, pool)?;
    let Tuning { asked, problem, placed, reason: solver, error, counters: pilot } = &tuning;
    let setting = Setting::new(problem, pool)?;
    let (mut castable, freedom) = (problem.castable(), problem.freedom());
    let mut state = resume.unwrap_or_else(|| State::new(problem, &setting.shape));
    let (mut search, mut session) = (Search::new(problem, &state.found), Session::new(&setting));

    while state.step < problem.optimise.iterations {
        let mut log = Log::new(state.step, observer);
        let before = state.clone();
        match (session.sense(&mut state, &mut log), &mut search) {
            (sensed, Some(search)) => search.step(sensed, &mut state, &mut castable, &mut log)?,
            (Ok(sensed), None) => {
                state.remember(&sensed);
                state.move_body(problem, &freedom, &sensed.gradient, &mut castable, &mut log);
            }
            (Err(trouble), None) => state = before.taken_back(trouble, &mut log)?,
        }
        state.step += 1;
        let report = log.report;
        observer.progress(problem.progress(state.step));
        if observer.step(&report, &state) == Control::Stop {
            return Ok(None);
        }
    }

    let (design, best_step) = match &state.best {
        Some(best) => (best.design.clone(), best.step),
        None => (problem.initial.clone(), 0),
    };
    let mut log = Log::new(state.step, observer);
    (log.report.counters, log.report.seconds) = (state.comparison.counters, state.comparison.seconds);
    let tuned = log.timed(|s| &mut s.simulate, |_| Tuning::of_body(asked, &design, pool));
    let bodies = [(&problem.initial, &problem.solver), (&design, &tuned.solver)];
    for (turn, (design, solver)) in bodies.into_iter().enumerate() {
        if evaluate(&setting, design, solver, turn, &mut state, &mut log).is_none() {
            return Ok(None);
        }
    }
    let nonlinear = bodies.map(|(design, solver)| {
        log.timed(|s| &mut s.simulate, |report| nonlinear(&setting, design, solver, report))
    });
    let Report { mut counters, seconds, .. } = log.report;
    counters.dynamics += *pilot;
    counters.dynamics += tuned.counters;
    let (placed, solver) = (placed.clone(), format!("{solver}. Best body: {}", tuned.plan.reason));
    let [initial, optimised] = <[_; 2]>::try_from(state.comparison.bodies).expect("two turns");
    let signal_errors = [*error, tuned.error];
    Ok(Some(Optimised {
        initial,
        optimised,
        best_step,
        placed,
        nonlinear,
        solver,
        signal_errors,
        counters,
        seconds,
    }))
}

/// The comparison at the end for any designs: fresh networks of the same initial weights on each, as far as the observer
/// lets it come.
///
/// # Errors
/// If the initial body, which fixes the scales, cannot be simulated.
pub fn evaluate_designs(
    problem: &Problem,
    designs: &[Vec<f64>],
    pool: &crate::Pool,
    observer: &mut dyn Observe,
) -> Result<Vec<BodyEvaluation>, Failure> {
    let Tuning { asked, problem, .. } = &Tuning::new(problem, pool)?;
    let setting = Setting::new(problem, pool)?;
    let (mut state, mut log) = (State::new(problem, &setting.shape), Log::new(0, observer));
    for (turn, design) in designs.iter().enumerate() {
        let solver = Tuning::of_body(asked, design, pool).solver;
        if evaluate(&setting, design, &solver, turn, &mut state, &mut log).is_none() {
            break;
        }
    }
    Ok(state.comparison.bodies)
}

#[cfg(test)]
mod tests;
