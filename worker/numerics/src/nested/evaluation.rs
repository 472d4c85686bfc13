//! The comparison at the end: fresh networks on a body, the same initial weights and budget for every body.

use super::linear::{Plain, Reading, Ridge, Stack, read, readings};
use super::problem::{Kind, Schedule, Training};
use super::report::{Log, Trouble};
use super::setting::{Setting, mean_error};
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
    /// Weights of the first network, by which its predictions can be had again; empty of the others.
    pub weights: Vec<f32>,
    /// What went wrong.
    pub trouble: Option<Trouble>,
}

/// A body with its fresh brains.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyEvaluation {
    /// α (mm).
    pub design: Vec<f64>,
    /// One entry a seed; of a linear brain, which needs none, one.
    pub networks: Vec<NetworkEvaluation>,
    /// The same trained long, where asked for.
    pub long: Vec<NetworkEvaluation>,
    /// What linear brains make of it, whatever the trial's own brain is: the whole sample's first, then other memories.
    pub readings: Vec<Reading>,
    /// Samples without force, which have no error: train, test, holdout.
    pub zero_samples: [u32; 3],
}

/// Initial weights of evaluations are numbered from here, out of the way of the outer steps'.
pub(super) const FIRST_NETWORK: u64 = 1 << 32;

/// Simulates `design` with `solver`, tuned to it, and trains fresh networks on it. `turn` (0, 1) is for the progress.
pub(super) fn evaluate(
    setting: &Setting,
    design: &[f64],
    solver: &Solver,
    turn: usize,
    log: &mut Log,
) -> BodyEvaluation {
    let problem = setting.problem;
    let holdout = problem.forces(Purpose::Holdout, 0, problem.stimuli.holdout);
    let signals = log.timed(
        |s| &mut s.simulate,
        |report| -> Result<_, Trouble> {
            let mut signals =
                |forces: &Forces| Ok(setting.simulate(design, forces, solver, false, report)?.signals);
            let train = if design == problem.initial {
                setting.initial_signals.clone()
            } else {
                signals(&setting.train)?
            };
            Ok([train, signals(&setting.test)?, signals(&holdout)?])
        },
    );
    let mut zero_samples = [0; 3];
    let sets = [&setting.train, &setting.test, &holdout];
    let mut found = Vec::new();
    let seen = signals.and_then(|signals| {
        log.timed(
            |s| &mut s.train,
            |_| {
                let plain = [0, 1, 2].map(|set| setting.plain(&signals[set], sets[set]));
                zero_samples = [0, 1, 2].map(|set| plain[set].zero_samples());
                found = readings(setting, &plain).unwrap_or_default();
                let data = |set: usize| setting.data(&signals[set], sets[set]);
                Ok(match problem.reader {
                    Kind::Linear => Seen::Linear(linear(setting, &plain, &mut found)),
                    Kind::Network => Seen::Network(Box::new([data(0), data(1), data(2)])),
                    Kind::Stacked => Seen::Network(Box::new(stacked(setting, &plain)?)),
                })
            },
        )
    });
    let readings = found;
    let all = problem.evaluation_iterations();
    let mut done = turn * all;
    let mut passed = |iterations: usize, log: &mut Log| {
        done += iterations;
        let left = 1.0 - problem.progress(problem.optimise.iterations);
        log.progress(1.0 - left * (1.0 - done as f64 / (2 * all) as f64));
    };
    if let Ok(Seen::Linear(linear)) = seen {
        passed(all, log);
        let design = design.to_vec();
        return BodyEvaluation { design, networks: vec![linear], long: Vec::new(), readings, zero_samples };
    }
    let mut trained = |iterations: usize| -> Vec<NetworkEvaluation> {
        let one = |seed: usize| {
            let network = match &seen {
                Ok(Seen::Network(data)) => network(setting, seed, iterations, data, sets, log),
                Ok(Seen::Linear(linear)) => linear.clone(),
                Err(trouble) => nothing(*trouble),
            };
            passed(iterations, log);
            network
        };
        (0..problem.evaluation.seeds).map(one).collect()
    };
    let networks = trained(problem.brain.iterations);
    let mut long = problem.evaluation.long.map(trained).unwrap_or_default();
    long.iter_mut().for_each(|network| network.weights.clear());
    BodyEvaluation { design: design.to_vec(), networks, long, readings, zero_samples }
}

/// A body as the trial's own brain has it before it.
enum Seen {
    /// Training, test and holdout set of a network that is to be trained.
    Network(Box<[Data<f32>; 3]>),
    /// Solved.
    Linear(NetworkEvaluation),
}

/// The sets of a stacked network.
fn stacked(setting: &Setting, sets: &[Plain; 3]) -> Result<[Data<f32>; 3], Trouble> {
    let problem = setting.problem;
    let stack = Stack::new(&problem.decoder, problem.seed, &sets[0])?;
    let data = |set: usize| {
        let x = &sets[set].x;
        let answers = if set == 0 { stack.cross_fitted(x) } else { stack.answers(x) };
        setting.scales.stacked(problem.reader_shape(), &sets[set], &answers)
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

fn network(
    setting: &Setting,
    seed: usize,
    iterations: usize,
    [data, test, unseen]: &[Data<f32>; 3],
    sets: [&Forces; 3],
    log: &mut Log,
) -> NetworkEvaluation {
    let Setting { problem, pool, .. } = setting;
    let mut workspace = Workspace::new(data.shape());
    let (truth, mut aside) = (problem.targets(sets[2]), Workspace::new(data.shape()));
    let mut progress =
        |weights: &[f32]| mean_error(&setting.scales.predict(weights, unseen, &truth, &mut aside, pool).1);
    let training = Training { iterations, ..problem.brain };
    let Fresh { weights, losses, errors, outcome } = log.timed(
        |s| &mut s.train,
        |report| {
            let (schedule, start) = (problem.evaluation.schedule, [problem.seed, seed as u64]);
            let fresh = train_fresh(data, training, schedule, start, &mut progress, &mut workspace, pool);
            report.counters.brain_iterations += fresh.losses.len() as u64;
            fresh
        },
    );
    let mut error = |set: usize, data: &Data<f32>| setting.error(&weights, data, sets[set], &mut workspace);
    NetworkEvaluation {
        error_train: error(0, data),
        error_test: error(1, test),
        error_holdout: error(2, unseen),
        losses,
        errors,
        weights: if seed == 0 { weights } else { Vec::new() },
        trouble: (outcome != TrainOutcome::Ok).then_some(Trouble::Training(outcome)),
    }
}

/// A network trained from the beginning.
pub(super) struct Fresh {
    pub(super) weights: Vec<f32>,
    /// Training loss (normalised) at every iteration.
    pub(super) losses: Vec<f32>,
    /// (Iteration, from 1, `error` there) at its milestones.
    pub(super) errors: Vec<(u32, f64)>,
    pub(super) outcome: TrainOutcome,
}

/// Trains the network that starts from evaluation's initial weights of [seed, number].
pub(super) fn train_fresh(
    data: &Data<f32>,
    training: Training,
    schedule: Schedule,
    [seed, number]: [u64; 2],
    error: &mut dyn FnMut(&[f32]) -> Option<f64>,
    workspace: &mut Workspace<f32>,
    pool: &rayon::ThreadPool,
) -> Fresh {
    let Training { iterations, rate, .. } = training;
    let mut weights = fresh_weights(data.shape(), seed, FIRST_NETWORK + number);
    let (mut adam, mut losses, mut errors) = (Adam::new(weights.len()), Vec::new(), Vec::new());
    let milestones = brain::milestones(iterations);
    let mut watch = |i: usize, weights: &[f32]| {
        if milestones.binary_search(&(i + 1)).is_ok() {
            errors.extend(error(weights).map(|error| (i as u32 + 1, error)));
        }
    };
    let rate = |i| rate * schedule.factor(i, iterations);
    let outcome = brain::train_watched(
        &mut weights,
        &mut adam,
        data.all(),
        &rate,
        iterations,
        &mut losses,
        workspace,
        pool,
        &mut watch,
    );
    Fresh { weights, losses, errors, outcome }
}

/// Initial weights in the precision of training.
pub(super) fn fresh_weights(shape: Shape, seed: u64, which: u64) -> Vec<f32> {
    brain::initial_weights(shape, seed, which).into_iter().map(|w| w as f32).collect()
}
