//! The comparison at the end: fresh networks on a body, the same initial weights and budget for every body.

use super::linear::{Plain, Reading, Ridge, Stack, read, readings};
use super::problem::{Kind, Problem, Schedule, Training};
use super::report::{Control, Counters, Log, Seconds, Trouble};
use super::setting::{Scales, Setting, mean_error};
use super::state::State;
use crate::brain::{self, Adam, Data, Shape, TrainOutcome, Workspace};
use crate::dynamics::{Forces, Solver};
use crate::random::Purpose;

/// A fresh network on a body.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NetworkEvaluation {
    /// Mean prediction error on the training set (%).
    pub error_train: Option<f64>,
    /// On the test set (%).
    pub error_test: Option<f64>,
    /// On the holdout (%).
    pub error_holdout: Option<f64>,
    /// Training loss (normalised) at every iteration.
    pub losses: Vec<f32>,
    /// (iteration, from 1, mean prediction error on the holdout before it (%)) at `brain::milestones`.
    pub errors: Vec<(u32, f64)>,
    /// Weights of the first network, by which its predictions can be had again, for inputs at the trial's scales; empty of
    /// the others.
    pub weights: Vec<f32>,
    /// What went wrong.
    pub trouble: Option<Trouble>,
}

/// A body with its fresh brains.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BodyEvaluation {
    /// α (mm).
    pub design: Vec<f64>,
    /// One entry a seed; of a linear brain, which needs none, one.
    pub networks: Vec<NetworkEvaluation>,
    /// The same trained long, where asked for.
    pub long: Vec<NetworkEvaluation>,
    /// What linear brains make of it, whatever the trial's own brain is: the whole sample's first, then other memories.
    pub readings: Vec<Reading>,
    /// Samples without force, or whose simulation failed, which have no error: train, test, holdout.
    pub zero_samples: [u32; 3],
}

/// Initial weights of evaluations are numbered from here, out of the way of the outer steps'.
const FIRST_NETWORK: u64 = 1 << 32;

/// How far a comparison has come.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Comparison {
    /// The bodies, the initial one first; the last may lack networks.
    pub bodies: Vec<BodyEvaluation>,
    /// The network that is being trained on it.
    pub training: Option<Fresh>,
    /// Counts of work.
    pub counters: Counters,
    /// Seconds.
    pub seconds: Seconds,
}

impl Comparison {
    /// The part of the whole trial that is done, with so many iterations of the network in training.
    fn part(&self, iterations: usize, problem: &Problem) -> f64 {
        let (long, all) = (problem.evaluation.long.unwrap_or(0), problem.evaluation_iterations());
        let each = if problem.reader == Kind::Linear { all } else { problem.brain.iterations };
        let of = |body: &BodyEvaluation| body.networks.len() * each + body.long.len() * long;
        let done = self.bodies.iter().map(of).sum::<usize>() + iterations;
        let left = 1.0 - problem.progress(problem.optimise.iterations);
        1.0 - left * (1.0 - done as f64 / (2 * all) as f64)
    }
}

/// Goes on with the comparison of `state` on its body number `turn`: simulates `design` with `solver`, tuned to it, and
/// trains what is left of its fresh networks. `None` if the observer said stop: it has the state by then.
pub(super) fn evaluate(
    setting: &Setting,
    design: &[f64],
    solver: &Solver,
    turn: usize,
    state: &mut State,
    log: &mut Log,
) -> Option<()> {
    let problem = setting.problem;
    let linear = problem.reader == Kind::Linear;
    let seeds = if linear { 1 } else { problem.evaluation.seeds };
    let long = problem.evaluation.long.filter(|_| !linear);
    let lacks = |body: &BodyEvaluation| {
        [(false, Some(problem.brain.iterations)), (true, long)].into_iter().find_map(
            |(is_long, iterations)| {
                let trained = if is_long { &body.long } else { &body.networks };
                iterations
                    .filter(|_| trained.len() < seeds)
                    .map(|iterations| (is_long, trained.len(), iterations))
            },
        )
    };
    let begun = state.comparison.bodies.get(turn);
    if begun.is_some_and(|body| lacks(body).is_none()) {
        return Some(());
    }

    let holdout = problem.forces(Purpose::Holdout, 0, problem.stimuli.holdout);
    let counted = log.report.counters;
    let mut sets = [setting.train.clone(), setting.test.clone(), holdout];
    let signals = log.timed(
        |s| &mut s.simulate,
        |report| -> Result<_, Trouble> {
            let mut found = [Vec::new(), Vec::new(), Vec::new()];
            for (set, (found, forces)) in found.iter_mut().zip(&mut sets).enumerate() {
                *found = if set == 0 && design == problem.initial {
                    setting.initial_signals.clone()
                } else {
                    setting.simulate_most(design, forces, solver, false, report)?.0.signals
                };
            }
            Ok(found)
        },
    );
    if begun.is_some() {
        log.report.counters = counted;
    }
    let sets = [&sets[0], &sets[1], &sets[2]];
    let mut body = begun.is_none().then(|| BodyEvaluation { design: design.to_vec(), ..Default::default() });
    let seen = signals.and_then(|signals| {
        log.timed(
            |s| &mut s.train,
            |_| {
                let plain = [0, 1, 2].map(|set| setting.plain(&signals[set], sets[set]));
                if let Some(body) = &mut body {
                    body.zero_samples = [0, 1, 2].map(|set| plain[set].zero_samples());
                    body.readings = readings(setting, &plain).unwrap_or_default();
                }
                let own = setting.scales.with_rms_of(&signals[0]);
                Ok(match problem.reader {
                    Kind::Linear => {
                        let readings = body.as_mut().map(|body| &mut body.readings);
                        Seen::Linear(self::linear(setting, &plain, readings.unwrap_or(&mut Vec::new())))
                    }
                    Kind::Network => {
                        let data =
                            |set: usize| own.data(setting.shape, &signals[set], &problem.targets(sets[set]));
                        Seen::Network(Box::new(([0, 1, 2].map(data), own)))
                    }
                    Kind::Stacked => {
                        Seen::Network(Box::new((stacked(setting, &plain, &signals, &own)?, own)))
                    }
                })
            },
        )
    });
    state.comparison.bodies.extend(body);

    while let Some((is_long, seed, iterations)) = lacks(&state.comparison.bodies[turn]) {
        let mut found = match &seen {
            Ok(Seen::Network(seen)) => network(setting, seed, iterations, seen, sets, state, log)?,
            Ok(Seen::Linear(linear)) => linear.clone(),
            Err(trouble) => nothing(*trouble),
        };
        let body = &mut state.comparison.bodies[turn];
        if is_long {
            found.weights.clear();
        }
        if is_long { &mut body.long } else { &mut body.networks }.push(found);
        let wanted = log.progress(state.comparison.part(0, problem));
        if wanted == Control::Stop || log.save_is_due() {
            save(state, log);
        }
        if wanted == Control::Stop {
            return None;
        }
    }
    Some(())
}

/// Hands the observer the state, with what the report says of the comparison.
fn save(state: &mut State, log: &mut Log) {
    (state.comparison.counters, state.comparison.seconds) = (log.report.counters, log.report.seconds);
    log.save(state);
}

/// A body as the trial's own brain has it before it.
enum Seen {
    /// Training, test and holdout set of a network that is to be trained, at the body's own scales: on the initial body's
    /// the louder body's network would learn faster.
    Network(Box<([Data<f32>; 3], Scales)>),
    /// Solved.
    Linear(NetworkEvaluation),
}

/// The sets of a stacked network, whose signals (N, T, 3M) are at its body's own scales.
fn stacked(
    setting: &Setting,
    sets: &[Plain; 3],
    signals: &[Vec<f64>; 3],
    own: &Scales,
) -> Result<[Data<f32>; 3], Trouble> {
    let problem = setting.problem;
    let stack = Stack::new(&problem.decoder, problem.seed, &sets[0])?;
    let data = |set: usize| {
        let x = &sets[set].x;
        let answers = if set == 0 { stack.cross_fitted(x) } else { stack.answers(x) };
        own.stacked(problem.reader_shape(), &signals[set], &sets[set], &answers)
    };
    Ok([data(0), data(1), data(2)])
}

/// A brain that came to nothing.
fn nothing(trouble: Trouble) -> NetworkEvaluation {
    NetworkEvaluation { trouble: Some(trouble), ..NetworkEvaluation::default() }
}

/// The trial's own linear brain on a body; one of another memory than those of the readings joins them.
fn linear(setting: &Setting, sets: &[Plain; 3], readings: &mut Vec<Reading>) -> NetworkEvaluation {
    let lags = setting.problem.decoder.lags;
    let found = match readings.first() {
        Some(whole) if whole.lags == lags && setting.problem.decoder.ridge == Ridge::Auto => Ok(*whole),
        _ => setting.ridge(&sets[0], None).and_then(|ridge| read(sets, lags, ridge)),
    };
    if let Ok(own) = found
        && readings.iter().all(|reading| reading.lags != own.lags)
    {
        readings.push(own);
    }
    match found {
        Ok(Reading { error_train, error_test, error_holdout, .. }) => {
            NetworkEvaluation { error_train, error_test, error_holdout, ..NetworkEvaluation::default() }
        }
        Err(trouble) => nothing(trouble),
    }
}

/// Trains the network that is in training, or else a new one; `None` if the observer said stop.
fn network(
    setting: &Setting,
    seed: usize,
    iterations: usize,
    ([data, test, unseen], own): &([Data<f32>; 3], Scales),
    sets: [&Forces; 3],
    state: &mut State,
    log: &mut Log,
) -> Option<NetworkEvaluation> {
    let Setting { problem, pool, .. } = setting;
    let mut workspace = Workspace::new(data.shape(), pool.width());
    let (truth, mut aside) = (problem.targets(sets[2]), Workspace::new(data.shape(), pool.width()));
    let mut error =
        |weights: &[f32]| mean_error(&setting.scales.predict(weights, unseen, &truth, &mut aside, pool).1);
    let training = Training { iterations, ..problem.brain };
    let start = [problem.seed, seed as u64];
    state.comparison.training.get_or_insert_with(|| Fresh::new(data.shape(), start));
    let (fresh, outcome) = loop {
        let begun = log.seconds();
        let mut fresh = state.comparison.training.take().expect("set above, and before each round");
        let mut wanted = Control::Continue;
        let mut pauses = |iterations: usize| {
            wanted = log.progress(state.comparison.part(iterations, problem));
            wanted == Control::Stop || log.save_is_due()
        };
        let schedule = problem.evaluation.schedule;
        let outcome = fresh.train(data, training, schedule, &mut error, &mut pauses, &mut workspace, pool);
        log.report.seconds.train += log.seconds() - begun;
        if let Some(outcome) = outcome {
            break (fresh, outcome);
        }
        state.comparison.training = Some(fresh);
        save(state, log);
        if wanted == Control::Stop {
            return None;
        }
    };
    let Fresh { mut weights, losses, errors, .. } = fresh;
    log.report.counters.brain_iterations += losses.len() as u64;
    let mut error = |set: usize, data: &Data<f32>| setting.error(&weights, data, sets[set], &mut workspace);
    let [error_train, error_test, error_holdout] = [error(0, data), error(1, test), error(2, unseen)];
    brain::scale_inputs(data.shape(), &mut weights, &setting.scales.over(own));
    Some(NetworkEvaluation {
        error_train,
        error_test,
        error_holdout,
        losses,
        errors,
        weights: if seed == 0 { weights } else { Vec::new() },
        trouble: (outcome != TrainOutcome::Ok).then_some(Trouble::Training(outcome)),
    })
}

/// A fresh network in training, with all that it takes to go on to the same bits.
#[derive(Debug, Clone, PartialEq)]
pub struct Fresh {
    /// Its weights.
    pub weights: Vec<f32>,
    /// Adam on them.
    pub adam: Adam<f32>,
    /// Training loss (normalised) at every iteration so far.
    pub losses: Vec<f32>,
    /// (Iteration, from 1, error there) at its milestones.
    pub errors: Vec<(u32, f64)>,
}

impl Fresh {
    /// Evaluation's initial weights of [seed, number].
    pub(super) fn new(shape: Shape, [seed, number]: [u64; 2]) -> Self {
        let weights = fresh_weights(shape, seed, FIRST_NETWORK + number);
        Self { adam: Adam::new(weights.len()), weights, losses: Vec::new(), errors: Vec::new() }
    }

    /// Trains it on, at least an iteration, noting `error` at milestones. `None` if `pauses` says so, which is asked with the number of iterations done.
    pub(super) fn train(
        &mut self,
        data: &Data<f32>,
        training: Training,
        schedule: Schedule,
        error: &mut dyn FnMut(&[f32]) -> Option<f64>,
        pauses: &mut dyn FnMut(usize) -> bool,
        workspace: &mut Workspace<f32>,
        pool: &crate::Pool,
    ) -> Option<TrainOutcome> {
        let Self { weights, adam, losses, errors } = self;
        let Training { iterations, rate, .. } = training;
        let (first, milestones) = (losses.len(), brain::milestones(iterations));
        let mut watch = |i: usize, weights: &[f32]| {
            if i > first && pauses(i) {
                return false;
            }
            if milestones.binary_search(&(i + 1)).is_ok() {
                errors.extend(error(weights).map(|error| (i as u32 + 1, error)));
            }
            true
        };
        let rate = |i| rate * schedule.factor(i, iterations);
        let all = data.all();
        brain::train_on(weights, adam, all, &rate, iterations, losses, workspace, pool, &mut watch)
    }
}

/// Initial weights in the precision of training.
pub(super) fn fresh_weights(shape: Shape, seed: u64, which: u64) -> Vec<f32> {
    brain::initial_weights(shape, seed, which).into_iter().map(|w| w as f32).collect()
}
