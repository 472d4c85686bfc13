//! The comparison at the end: fresh networks on a body, the same initial weights and budget for every body.

use super::evaluation::{BodyEvaluation, NetworkEvaluation};
use super::fresh::{Lacking, first_judge, paused, read};
use super::inversion::invert;
use super::observe::Log;
use super::report::Report;
use super::state::State;
use crate::brains::{own_reading, reader, readings};
use crate::dynamics::Solver;
use crate::random::Purpose;
use crate::trial::{BrainKind, Counters, Problem, Ridge, Samples, Trial, Trouble};

impl BodyEvaluation {
    /// The first brain that it lacks; a linear one is one, and not trained long.
    fn lacks(&self, problem: &Problem) -> Option<Lacking> {
        let linear = !problem.reader.is_network();
        let seeds = if linear { 1 } else { problem.evaluation.seeds };
        let long = problem.evaluation.long.filter(|_| !linear);
        let short =
            (self.networks.len() < seeds).then_some((self.networks.len(), problem.brain.iterations, false));
        short.or(long
            .filter(|_| self.long.len() < seeds)
            .map(|iterations| (self.long.len(), iterations, true)))
    }
}

/// Goes on with the comparison of `state` on its body number `turn`: simulates `design` with `solver`, tuned to it, and
/// trains what is left of its fresh networks. `None` if the observer said stop: it has the state by then.
pub(super) fn evaluate(
    trial: &Trial,
    design: &[f64],
    solver: &Solver,
    turn: usize,
    state: &mut State,
    log: &mut Log,
) -> Option<()> {
    let problem = &trial.problem;
    let begun = state.comparison.bodies.get(turn);
    if begun.is_some_and(|body| body.lacks(problem).is_none()) {
        return Some(());
    }
    let (begun, counted, mut recipe) = (begun.is_some(), log.report.counters, problem.recipe());
    let sets = log.timed(|s| &mut s.simulate, |report| sets(trial, design, solver, &mut report.counters));
    let first = state.comparison.bodies.get(turn).is_none_or(|body| body.networks.is_empty());
    let inverts = problem.reader == BrainKind::Inverse;
    let calibration = sets.as_ref().ok().filter(|_| first && !inverts).and_then(|sets| {
        let of = |report: &mut Report| calibrating(trial, design, solver, &sets[2], &mut report.counters);
        log.timed(|s| &mut s.simulate, of).ok()
    });
    if begun {
        log.report.counters = counted;
    } else {
        let mut body = BodyEvaluation { design: design.to_vec(), ..BodyEvaluation::default() };
        if let Ok(sets) = &sets {
            body.zero_samples = sets.each_ref().map(Samples::without_force);
            log.timed(
                |s| &mut s.train,
                |_| {
                    body.readings = readings(trial, sets).unwrap_or_default();
                    if problem.reader == BrainKind::Linear
                        && let Ok(own) = own_reading(trial, sets, &mut body.readings)
                    {
                        recipe.decoder.ridge = Ridge::Given(own.ridge);
                    }
                },
            );
        }
        state.comparison.bodies.push(body);
    }
    if inverts {
        return invert(trial, design, solver, sets, state, log);
    }
    let mut reader = match &sets {
        Ok(sets) => {
            // a network learns on its body's own scale: on the initial body's the louder body's would learn faster
            let scales = [trial.scales.clone(), trial.scales.with_rms_of(&sets[0].signals)];
            log.timed(|s| &mut s.train, |_| reader(recipe, &sets[0], scales, trial.pool))
        }
        Err(trouble) => Err(*trouble),
    };

    while let Some(lacking) = state.comparison.bodies[turn].lacks(problem) {
        let found = match (&sets, &mut reader) {
            (Ok(sets), Ok(reader)) => {
                read(trial, &mut **reader, sets, calibration.as_ref(), lacking, state, log)?
            }
            (Err(trouble), _) => NetworkEvaluation::nothing(*trouble),
            (_, Err(trouble)) => NetworkEvaluation::nothing(*trouble),
        };
        let body = &mut state.comparison.bodies[turn];
        if lacking.2 { &mut body.long } else { &mut body.networks }.push(found);
        paused(trial, state, log)?;
    }
    Some(())
}

/// Training set, test set and holdout of a body.
fn sets(
    trial: &Trial,
    design: &[f64],
    solver: &Solver,
    counters: &mut Counters,
) -> Result<[Samples; 3], Trouble> {
    let problem = &trial.problem;
    let mut of = |forces| Ok(trial.simulate_most(design, forces, solver, false, counters)?.samples);
    // every training sample, those too on which the initial body failed
    let [train, test] = problem.known();
    let train = if design == problem.initial { trial.initial.clone() } else { of(train)? };
    Ok([train, of(test)?, of(problem.forces(Purpose::Holdout, 0, problem.stimuli.holdout))?])
}

/// Samples that calibrate bands are numbered from here, out of the way of the outer steps' and of the casts'; of so many the 95th
/// largest score covers the next with 95 %.
const BANDING_FIRST: u64 = 1 << 41;
const BANDING: usize = 99;

/// Samples that calibrate bands: fresh ones, which neither body nor brain was fitted to. Of records, which have none, half of
/// the holdout, which was dealt to it by a shuffle.
fn calibrating(
    trial: &Trial,
    design: &[f64],
    solver: &Solver,
    holdout: &Samples,
    counters: &mut Counters,
) -> Result<Samples, Trouble> {
    match first_judge(trial, holdout) {
        0 => {
            let forces = trial.problem.forces(Purpose::Fresh, BANDING_FIRST, BANDING);
            Ok(trial.simulate_most(design, forces, solver, false, counters)?.samples)
        }
        first => Ok(holdout.select(&(0..first).collect::<Vec<_>>())),
    }
}
