//! Nested optimisation of body and decoder: the outer loop.
//!
//! ```text
//! A(α) = signals of the body α          β*(A) = argmin L_train(β, A)
//! g = dL/dα at (α, β*)                  α ← Π(α − Adam(g)),  Π: nearest feasible design
//! ```
//! The [protocol](crate::trial::TrainingProtocol) sets how far β is trained and which loss moves the body. Searches without
//! gradients serve as baselines. Afterwards, fresh networks are trained on the initial and the best body and tested on the
//! held-out set, which nothing else uses.

mod casts;
mod comparison;
mod evaluation;
mod fresh;
mod inversion;
mod nonlinear;
mod observe;
mod protocol;
mod report;
mod schedule;
mod search;
mod state;
mod under;

pub use casts::{DecoderForCasts, RECORDS, brain_for_casts, evaluate_linear_on_casts};
pub use comparison::{evaluate_designs, keeps_error};
pub use evaluation::{
    BandCoverage, BodyEvaluation, CastDecoder, CastEvaluation, Comparison, NetworkEvaluation, Optimised,
    Regularisation,
};
pub use fresh::{estimate_tasks, fit_readouts};
pub use inversion::INVERTED_PER_CAST;
pub use nonlinear::{EXACT, Nonlinear};
pub use observe::{LoopControl, NoObserver, Observe};
pub use report::{Report, Seconds};
pub use schedule::{RUNGS, evaluated_fraction, evaluation_step_near};
pub use state::{Best, PastDesign, State};
pub use under::UnderReading;

use comparison::compare;
use observe::Log;
use protocol::{Session, StepResult};
use search::GradientFree;

use crate::trial::{Failure, PreparedTrial};

/// Optimises the body of `trial` together with its decoder, from the beginning or from a state that `observer` received earlier. A
/// resumed run gives the same bits. `None` if the observer stopped it.
///
/// # Errors
/// If the initial body cannot be simulated or trained, or steps fail repeatedly and no earlier body is left.
pub fn optimise(
    trial: &PreparedTrial,
    resume: Option<State>,
    observer: &mut dyn Observe,
) -> Result<Option<Optimised>, Failure> {
    let problem = &trial.problem;
    let (mut castable, freedom) = (problem.body.castable(problem), problem.body.freedom(problem));
    let mut state = resume.unwrap_or_else(|| State::new(problem));
    let (search, mut session) = (GradientFree::new(problem), Session::new(trial));

    while state.step < problem.optimise.iterations {
        let (before, mut log) = (state.clone(), Log::new(state.step, observer));
        match (session.train_and_differentiate(&mut state, &mut log), &search) {
            (sensed, Some(search)) => search.step(sensed, &mut state, &mut *castable, &mut log)?,
            (Ok(StepResult { gradient, loss_train, error_test }), None) => {
                state.remember(loss_train, error_test);
                let bodies = session.bodies();
                if problem.optimise.moves_body(state.step) {
                    log.timed(
                        |s| &mut s.project,
                        |report| {
                            state.move_body(problem, &freedom, &gradient, &mut *castable, bodies, report)
                        },
                    );
                }
            }
            (Err(trouble), None) => state = before.undo_step(trouble, &mut log.report)?,
        }
        state.step += 1;
        let report = log.report;
        observer.progress(problem.progress(state.step));
        if observer.step(&report, &state) == LoopControl::Stop {
            return Ok(None);
        }
    }
    drop(session); // frees the decoder's memory
    Ok(compare(trial, state, observer))
}

#[cfg(test)]
pub(crate) mod tests;
