//! Whether a gradient points downhill: a step against it, the network trained on, the holdout's loss before and after.
//!
//! A fresh network is trained on the initial body and goes on from the same weights on every moved one, so that what is
//! compared is the answer of a trained network to a move and not the chance of two trainings.

use super::evaluation::{FIRST_NETWORK, fresh_weights};
use super::implicit::implicit_term;
use super::problem::Problem;
use super::report::{Failure, Implicit, Log, Observe, Trouble};
use super::setting::Setting;
use super::tuning::Tuning;
use crate::brain::{self, Adam, Data, Policy, TrainOutcome, Workspace};
use crate::random::{Purpose, Stream};

/// A step against one gradient.
#[derive(Debug, Clone, PartialEq)]
pub struct Downhill {
    /// `none`, `random`, `training` (that of the training loss), `direct`, or the implicit term's policy with it.
    pub gradient: &'static str,
    /// Cosine of the angle to the direct gradient.
    pub cosine: f64,
    /// The linear system, where there was one.
    pub implicit: Option<Implicit>,
    /// Training loss on the moved body (N²).
    pub loss_train: f64,
    /// Loss on its holdout (N²).
    pub loss_holdout: f64,
}

/// Rate at which the network goes on.
const RATE: f64 = 1e-3;

/// Moves the initial body by `step` (mm, Euclidean) against each gradient that network number `network` gives, and
/// trains it on for `iterations`, its rate falling by a cosine.
///
/// # Errors
/// If a simulation or a training does not end well.
pub fn downhill(
    problem: &Problem,
    network: u64,
    step: f64,
    iterations: usize,
    pool: &rayon::ThreadPool,
    observer: &mut dyn Observe,
) -> Result<Vec<Downhill>, Failure> {
    let Tuning { problem, .. } = &Tuning::new(problem, pool)?;
    let setting = Setting::new(problem, pool)?;
    let mut log = Log::new(0, observer);
    steps(&setting, network, step, iterations, &mut log).map_err(Failure::Initial)
}

fn steps(
    setting: &Setting,
    network: u64,
    step: f64,
    iterations: usize,
    log: &mut Log,
) -> Result<Vec<Downhill>, Trouble> {
    let (problem, pool, shape) = (setting.problem, setting.pool, setting.shape);
    let (design, solver) = (&problem.initial, &problem.solver);
    let holdout = problem.forces(Purpose::Holdout, 0, problem.stimuli.holdout);
    let mut workspace = Workspace::<f32>::new(shape);
    let mut train = |weights: &mut Vec<f32>, data: &Data<f32>, rate: f64, iterations: usize| {
        let (mut adam, mut losses) = (Adam::new(weights.len()), Vec::new());
        let rate = brain::cosine(rate, iterations);
        let outcome = brain::train(
            weights,
            &mut adam,
            data.all(),
            &rate,
            iterations,
            &mut losses,
            &mut workspace,
            pool,
        );
        if outcome == TrainOutcome::Ok { Ok(()) } else { Err(Trouble::Training(outcome)) }
    };

    let on_train = setting.simulate(design, &setting.train, solver, true, &mut log.report)?;
    let on_test = setting.simulate(design, &setting.test, solver, true, &mut log.report)?;
    let mut weights = fresh_weights(shape, problem.seed, FIRST_NETWORK + network);
    train(
        &mut weights,
        &setting.data(&on_train.signals, &setting.train),
        problem.brain.rate,
        problem.brain.iterations,
    )?;

    // All gradients are of losses in N².
    let mut other = Workspace::<f32>::new(shape);
    let mut at_fixed_weights = |simulation, forces, log: &mut Log| {
        let simulation: &crate::dynamics::Simulation = simulation;
        let data = setting.physical_data::<f32>(&simulation.signals, forces);
        let inputs = brain::input_gradient(&weights, data.all(), &mut other, pool).1;
        let inputs: Vec<f64> = inputs.into_iter().map(f64::from).collect();
        setting.pull_back(design, forces, simulation, &inputs, log)
    };
    let direct = at_fixed_weights(&on_test, &setting.test, log)?;
    let training = at_fixed_weights(&on_train, &setting.train, log)?;
    let mut stream = Stream::new(Purpose::Batch, problem.seed, [network, 1]);
    let random = design.iter().map(|_| stream.normal()).collect();
    let mut gradients = vec![
        ("none", None, vec![0.0; design.len()]),
        ("random", None, random),
        ("training", None, training),
        ("direct", None, direct.clone()),
    ];
    for policy in [Policy::Truncate, Policy::GaussNewton(0.0)] {
        let inputs = implicit_term(setting, &weights, &on_train.signals, &on_test.signals, policy, log);
        let term = setting.pull_back(design, &setting.train, &on_train, &inputs, log)?;
        let sum = direct.iter().zip(&term).map(|(d, t)| d + t).collect();
        gradients.push((policy.name(), log.report.implicit, sum));
    }

    let length = |g: &[f64]| g.iter().map(|x| x * x).sum::<f64>().sqrt();
    let mut found = Vec::new();
    for (name, implicit, gradient) in gradients {
        let norm = length(&gradient).max(f64::MIN_POSITIVE);
        let moved: Vec<f64> = design.iter().zip(&gradient).map(|(a, g)| a - step * g / norm).collect();
        let data = |forces, log: &mut Log| -> Result<_, Trouble> {
            let signals = setting.simulate(&moved, forces, solver, false, &mut log.report)?.signals;
            Ok((setting.data::<f32>(&signals, forces), setting.physical_data::<f32>(&signals, forces)))
        };
        let (normalised, physical) = data(&setting.train, log)?;
        let (_, unseen) = data(&holdout, log)?;
        let mut weights = weights.clone();
        train(&mut weights, &normalised, RATE, iterations)?;
        let mut loss = |data: &Data<f32>| brain::loss(&weights, data.all(), &mut other, pool);
        let dot: f64 = gradient.iter().zip(&direct).map(|(a, b)| a * b).sum();
        found.push(Downhill {
            gradient: name,
            cosine: dot / (norm * length(&direct)),
            implicit,
            loss_train: loss(&physical),
            loss_holdout: loss(&unseen),
        });
    }
    Ok(found)
}
