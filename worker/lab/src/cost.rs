//! Estimates the time of a trial before it runs: counts of operations over the speed of one core of this machine.
//!
//! During a run, measured times correct the estimate (`analysis::forecast`).

use std::collections::HashSet;

use metasense_schemas::record::{Parts, PlannedTrial};
use metasense_schemas::spec::{BrainKind, Method, Network, Protocol, Solver, TrialSpec};
use metasense_worker::evaluated_fraction;
use metasense_worker::pace::Pace;
use metasense_worker::problem::{INVERTED_PER_CAST, READINGS_MAX, instants, lags};

/// Speed of a core with AVX-512, for weights that are equal on every machine.
const RATED: Pace = Pace { evaluations: 2.9e8, training: 1.1e11, factor: 2.5e10 };
/// Time of a force evaluation in f32 relative to f64, and the tolerance from which most are in f32.
const SINGLE: f64 = 0.65;
const SINGLE_FROM: f64 = 1e-3;
/// Steps of trained bodies relative to the initial one: their natural frequencies are higher.
const GROWN: f64 = 1.3;
/// Time per sample of casts relative to one body: few samples leave half of the SIMD lanes empty, and casts need more steps.
const FEW: f64 = 2.0;
/// Time of the reverse sweep, including forward recomputation, relative to the simulation.
const REVERSE: f64 = 1.7;
/// Time of a training iteration (forward, backward) and of a Hessian-vector product relative to a forward pass.
const ITERATION: f64 = 3.0;
const HESSIAN_PRODUCT: f64 = 6.3;
/// Simulations of single samples that select the integrator for a body.
const PILOTS: f64 = 160.0;
/// Extra training iterations of a network on each candidate of a random search.
const AFRESH: f64 = 100.0;
/// Hessian-vector products per implicit term.
const PRODUCTS: f64 = 21.0;

/// Time in matrix factorisations: per body in the final evaluation, including the choice of the ridge; per step of `joint`, which
/// has six and computes normal equations and gradients; per step of other protocols, with some of the ridge's choices.
const FACTORS: f64 = 8.0;
const JOINT_FACTORS: f64 = 25.0;
const STEP_FACTORS: f64 = 2.0;
/// Matrix factorisations per cast.
const CAST_FACTORS: f64 = 70.0;
/// Time of inverting the model per sample and panel, and of calibrating the twins of a cast, in simulations.
const INVERSION: f64 = 250.0;
const TWINS: f64 = 12_000.0;

/// Number of the decoder's weights, biases included: of a network, a linear decoder (per lag), or both for a stacked decoder.
pub fn brain_parameters(trial: &TrialSpec) -> usize {
    let linear = || trial.point.panels * (unknowns(trial, trial.brain.memory) + 1);
    match trial.brain.kind {
        BrainKind::Cnn => network_weights(trial),
        // an inverse decoder starts from a linear estimate
        BrainKind::Linear | BrainKind::Inverse => linear(),
        BrainKind::Stacked => network_weights(trial) + linear(),
    }
}

fn network_weights(trial: &TrialSpec) -> usize {
    let (Network { width, kernels, .. }, last) = (trial.brain.network(), trial.point.panels);
    let estimates = if trial.brain.kind == BrainKind::Stacked { last } else { 0 };
    let mut from = trial.signals() + estimates;
    let layers = kernels.iter().enumerate().map(|(i, kernel)| {
        let to = if i + 1 == kernels.len() { last } else { width };
        (kernel * std::mem::replace(&mut from, to) + 1) * to
    });
    layers.sum()
}

/// Unknowns of a linear decoder with this memory, per force.
fn unknowns(trial: &TrialSpec, memory: Option<[f64; 2]>) -> usize {
    lags(&trial.time, memory).unknowns(trial.signals())
}

/// Multiply-adds of a factorisation.
fn factor(unknowns: usize) -> f64 {
    let n = unknowns as f64;
    n * n * n / 6.0
}

/// The n-th root of x > 0 by Newton's method: the last bit of a library's power may differ between machines.
fn root(x: f64, n: i32) -> f64 {
    let mut y = 1.0;
    for _ in 0..100 {
        let power = (1..n).fold(1.0, |power, _| power * y);
        let next = y + (x / power - y) / f64::from(n);
        if next == y {
            break;
        }
        y = next;
    }
    y
}

/// Seconds of a trial on one core of this machine, and its weight: milliseconds on the rated core, at least 1, the same on
/// every machine.
pub fn of(trial: &TrialSpec, units: usize) -> (Parts<f64>, Parts<u64>) {
    let whole = |seconds: f64| (seconds * 1e3).round().clamp(1.0, MOST_WEIGHT) as u64;
    let Parts { steps, comparison } = seconds(trial, units, RATED);
    (seconds(trial, units, Pace::here()), Parts { steps: whole(steps), comparison: whole(comparison) })
}

/// Largest weight of a part of a trial (30 years): the sum of 10⁶ does not overflow.
const MOST_WEIGHT: f64 = 1e12;

/// Seconds of trials on one core if each body is trained once.
pub fn total<'a>(trials: impl IntoIterator<Item = &'a PlannedTrial>) -> f64 {
    let mut trained = HashSet::new();
    trials.into_iter().map(|trial| trial.cost.sum(trained.insert(&trial.training))).sum()
}

/// Marks the first trial of each body as the one that trains it.
pub fn first_trains(trials: &mut [PlannedTrial]) {
    let mut trained = HashSet::new();
    for trial in trials {
        trial.trains = trained.insert(&trial.training);
    }
}

/// Highest frequency relative to the reference scene's, from √(k/m) of a square unit; 1 for other bodies.
fn frequency(trial: &TrialSpec) -> f64 {
    let body = &trial.body;
    let divided = body.diameter.or(body.width).zip(body.columns).map(|(width, n)| width / n as f64);
    match (body.stiffness, body.density, divided.or(body.spacing), &body.file) {
        (Some(stiffness), Some(density), Some(spacing), None) => {
            let k = stiffness.stretch.max(stiffness.shear) / 3.0;
            (k / (density / 1e-8)).sqrt() * 15.0 / spacing
        }
        _ => 1.0,
    }
}

/// Force evaluations per sample, from the diagram of the reference scene (`results/committed/work-precision.svg`).
fn evaluations(solver: Solver, trial: &TrialSpec) -> f64 {
    // Evaluations per second of motion at an error of 1e-3, order of convergence, and evaluations per step.
    let (at, power, stages) = match solver.method {
        Method::Auto | Method::Nystrom6 => (12_000.0, 6, 11.0),
        Method::Nystrom4 => (14_000.0, 4, 6.0),
        Method::Leapfrog => (63_000.0, 2, 1.0),
        // Each takes about 1.4 times as long as those of other methods; each sample has its own steps.
        Method::Tsit5 => (28_000.0, 6, 1.0),
    };
    let steps = frequency(trial) * trial.time.duration * at / stages / root(solver.tolerance / 1e-3, power);
    // Steps end at every instant of the motion and at every kink of the forces.
    let kinks = trial.stimuli.force_samples.unwrap_or(trial.time.samples).max(instants(trial)) as f64;
    (steps / kinks).ceil() * kinks * stages
}

fn seconds(trial: &TrialSpec, units: usize, pace: Pace) -> Parts<f64> {
    let stimuli = &trial.stimuli;
    let optimise = trial.optimise.clone().resolved();
    let sample_by = |solver: Solver| {
        let exact = solver.method == Method::Tsit5 || trial.brain.kind == BrainKind::Inverse;
        let single = solver.tolerance >= SINGLE_FROM && !exact;
        evaluations(solver, trial) * units as f64 * if single { SINGLE } else { 1.0 } / pace.evaluations
    };
    let one_sample = sample_by(trial.solver);
    // simulation of a trained body
    let ringing = GROWN * one_sample;
    let simulate = stimuli.samples as f64 * ringing;
    let network = matches!(trial.brain.kind, BrainKind::Cnn | BrainKind::Stacked);
    let weights = network_weights(trial) as f64;
    let train_samples = stimuli.samples.saturating_sub(stimuli.test) as f64;
    let forward = weights * train_samples * trial.time.samples as f64 / pace.training;
    let train = trial.brain.iterations as f64 * ITERATION * forward;
    let batch = optimise.batch.unwrap_or(stimuli.test) as f64;
    let going = optimise.brain_iterations.unwrap_or_default() as f64 * ITERATION * forward;
    // Fresh samples use the coarse integrator; the test set, at some steps, uses the other.
    let coarse = GROWN * sample_by(optimise.coarse.unwrap_or(trial.solver));
    let looks = evaluated_fraction(optimise.steps() as u32);
    let fresh = batch * coarse * (1.0 + REVERSE) + looks * stimuli.test as f64 * ringing;
    let casts = optimise.casts.map_or(1.0, |casts| FEW * casts as f64);
    let solve = STEP_FACTORS * factor(unknowns(trial, trial.brain.memory)) / pace.factor;
    let groups = lags(&trial.time, trial.brain.memory).training_groups(trial.signals());
    let folds = JOINT_FACTORS * factor(trial.signals() * groups.len()) / pace.factor;
    let step = match optimise.protocol {
        Protocol::Paper if optimise.linear() => simulate * (1.0 + REVERSE) + solve,
        Protocol::Joint if optimise.linear() => casts * (fresh + folds),
        Protocol::Random if optimise.linear() => simulate + solve,
        Protocol::Random => simulate + AFRESH * ITERATION * forward + going,
        Protocol::Paper => simulate * (1.0 + REVERSE) + train + PRODUCTS * HESSIAN_PRODUCT * forward,
        // each iteration uses a batch, and the loss takes four forward passes
        Protocol::Joint => casts * (fresh + (going + 4.0 * forward) * batch / train_samples.max(1.0)),
    };
    let long = trial.evaluation.long_iterations.unwrap_or(0) as f64 / trial.brain.iterations.max(1) as f64;
    // one more network is trained on casts
    let of_casts = if trial.evaluation.casts.is_some_and(|casts| casts > 0) { 1.0 } else { 0.0 };
    let networks = trial.evaluation.networks() as f64 * (1.0 + long) + of_casts;
    let part = trial.evaluation.batch.map_or(1.0, |batch| (batch as f64 / train_samples.max(1.0)).min(1.0));
    let trainings = if network { networks * part } else { 0.0 };
    // limited by the memory of the matrix
    let readings = match trial.signals() * trial.time.samples <= READINGS_MAX {
        true => FACTORS * factor(unknowns(trial, None).min(READINGS_MAX)) / pace.factor,
        false => 0.0,
    };
    // Simulated samples, and factorisations, for casts and other forces; the known casts count as four sets of samples
    let each = (stimuli.samples + stimuli.holdout) as f64;
    let [casts_read, under] =
        [trial.evaluation.casts.unwrap_or(0), trial.evaluation.under.as_ref().map_or(0, Vec::len)];
    let calibrated = trial.evaluation.records != Some(false);
    let cast = if calibrated { each } else { stimuli.holdout as f64 };
    let known = if trial.evaluation.casts.is_some() { 4.0 * each } else { 0.0 };
    let samples = each + known + casts_read as f64 * cast + under as f64 * each;
    let fitted = under as f64 + if calibrated { casts_read as f64 } else { 0.0 };
    let factors = fitted * CAST_FACTORS * factor(unknowns(trial, trial.brain.memory)) / pace.factor;
    let inverted = if trial.brain.kind == BrainKind::Inverse {
        let sample = INVERSION * trial.point.panels as f64;
        // for the model of the design and for two twins
        let of_a_cast = TWINS + 3.0 * stimuli.holdout.min(INVERTED_PER_CAST) as f64 * sample;
        (stimuli.test + stimuli.holdout) as f64 * sample + casts_read as f64 * of_a_cast
    } else {
        0.0
    };
    let compares_initial = optimise.steps() > 0 && trial.evaluation.initial.unwrap_or(true);
    let best = if optimise.steps() > 0 { ringing } else { one_sample };
    let [bodies, times] = if compares_initial { [2.0, one_sample + best] } else { [1.0, best] };
    let comparison =
        times * (samples + PILOTS + inverted) + bodies * (trainings * train + readings + factors);
    Parts { steps: optimise.steps() as f64 * step, comparison }
}

/// Seconds of trials on some workers with some threads each: the work divided evenly, but at least that of the longest trial.
pub fn seconds_on(trials: &[&PlannedTrial], workers: u32, threads: u32) -> f64 {
    let longest = trials.iter().map(|trial| trial.cost.sum(true)).fold(0.0, f64::max);
    (total(trials.iter().copied()) / f64::from(workers.max(1))).max(longest) / f64::from(threads.max(1))
}
