//! What a trial costs, roughly, before it has run: counts of work, by how fast a core of this machine does such work.
//!
//! The engine replaces it by what steps have taken once there are some.

use std::collections::HashSet;

use super::Trial;
use metasense_schemas::record::Parts;
use metasense_schemas::spec::{BrainKind, Method, Network, Protocol, Solver, TrialSpec};
use metasense_worker::looked_at;
use metasense_worker::pace::Pace;
use metasense_worker::problem::{INVERTED_OF_A_CAST, READINGS_MAX, instants, lags};

/// A core with AVX-512, for weights that are the same on every machine.
const RATED: Pace = Pace { evaluations: 2.9e8, training: 1.1e11, factor: 2.5e10 };
/// Part of a force evaluation's time where forces are f32, and the tolerance from which on they mostly are.
const SINGLE: f64 = 0.65;
const SINGLE_FROM: f64 = 1e-3;
/// Steps of a body in training, and once trained, against those of the initial one: it rings higher.
const GROWN: f64 = 1.3;
/// Time of a cast's few samples against as many of one body: they leave half of the lanes empty, and casts ring higher still.
const FEW: f64 = 2.0;
/// Of the reverse sweep, forward recomputation included, to the simulation.
const REVERSE: f64 = 1.7;
/// Of an iteration (forward, backward) and of a Hessian-vector product to a forward pass.
const ITERATION: f64 = 3.0;
const HESSIAN_PRODUCT: f64 = 6.3;
/// Iterations of a search's network on each candidate, before the spec's own.
const AFRESH: f64 = 100.0;
/// Products of the implicit term.
const PRODUCTS: f64 = 21.0;

/// Factors of the comparison, a body, and of a step, looks for a ridge included.
const FACTORS: f64 = 8.0;
const STEP_FACTORS: f64 = 1.5;
/// Of the brains fitted to a cast.
const CAST_FACTORS: f64 = 70.0;
/// Simulations in the time of an inverse brain's descent, a sample and panel, and in that of the twins of a cast.
const INVERSION: f64 = 250.0;
const TWINS: f64 = 12_000.0;

/// Weights of the brain: of a network those of its kernels, of a linear one those of its lags, of a stacked one both; with biases.
pub(super) fn brain_parameters(trial: &TrialSpec) -> usize {
    let linear = || trial.point.panels * (unknowns(trial, trial.brain.memory) + 1);
    match trial.brain.kind {
        BrainKind::Cnn => network_weights(trial),
        // an inverse one has those that it begins with
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

/// Unknowns of a linear brain with this memory, a force.
fn unknowns(trial: &TrialSpec, memory: Option<[f64; 2]>) -> usize {
    trial.signals() * lags(&trial.time, memory).groups().len()
}

/// Multiply-adds of a factor.
fn factor(unknowns: usize) -> f64 {
    let n = unknowns as f64;
    n * n * n / 6.0
}

/// The n-th root of x > 0, by Newton: a library's power may differ in its last bit from machine to machine.
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

/// Seconds of a trial on one core of this machine, and what it weighs against others, in whole milliseconds on AVX-512: the same
/// numbers on every machine, and nothing is for free.
#[must_use]
pub fn of(trial: &TrialSpec, units: usize) -> (Parts<f64>, Parts<u64>) {
    let whole = |seconds: f64| (seconds * 1e3).round().clamp(1.0, MOST_WEIGHT) as u64;
    let Parts { steps, comparison } = seconds(trial, units, RATED);
    (seconds(trial, units, Pace::here()), Parts { steps: whole(steps), comparison: whole(comparison) })
}

/// Of a part of a trial (30 years): a million of them still add up.
const MOST_WEIGHT: f64 = 1e12;

/// Seconds of trials on one core, each body trained once.
pub fn total<'a>(trials: impl IntoIterator<Item = &'a Trial>) -> f64 {
    let mut trained = HashSet::new();
    trials.into_iter().map(|trial| trial.cost.sum(trained.insert(&trial.training))).sum()
}

/// Of trials with one body the first trains it.
pub(crate) fn first_trains(trials: &mut [Trial]) {
    let mut trained = HashSet::new();
    for trial in trials {
        trial.trains = trained.insert(&trial.training);
    }
}

/// Force evaluations of one sample's motion, by the diagram of the reference scene (`results/committed/work-precision.svg`).
fn evaluations(solver: Solver, trial: &TrialSpec) -> f64 {
    // In a second at an error of 1e-3, the power by which an error falls with them, and how many a step makes.
    let (at, power, stages) = match solver.method {
        Method::Auto | Method::Nystrom6 => (12_000.0, 6, 11.0),
        Method::Nystrom4 => (14_000.0, 4, 6.0),
        Method::Leapfrog => (63_000.0, 2, 1.0),
        // Of the time of some 1.4 others each; steps are a sample's own.
        Method::Tsit5 => (28_000.0, 6, 1.0),
    };
    let steps = trial.time.duration * at / stages / root(solver.tolerance / 1e-3, power);
    // A step ends at every instant of the motion, and wherever the forces' own clock has a kink.
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
    // of the bodies on the way
    let ringing = GROWN * one_sample;
    let simulate = stimuli.samples as f64 * ringing;
    let network = matches!(trial.brain.kind, BrainKind::Cnn | BrainKind::Stacked);
    let weights = network_weights(trial) as f64;
    let train_samples = stimuli.samples.saturating_sub(stimuli.test) as f64;
    let forward = weights * train_samples * trial.time.samples as f64 / pace.training;
    let train = trial.brain.iterations as f64 * ITERATION * forward;
    let batch = optimise.batch.unwrap_or(stimuli.test) as f64;
    let going = optimise.brain_iterations.unwrap_or_default() as f64 * ITERATION * forward;
    // By the coarse integrator, and now and then the test set by the other
    let coarse = GROWN * sample_by(optimise.coarse.unwrap_or(trial.solver));
    let looks = looked_at(optimise.steps() as u32);
    let fresh = batch * coarse * (1.0 + REVERSE) + looks * stimuli.test as f64 * ringing;
    let casts = optimise.casts.map_or(1.0, |casts| FEW * casts as f64);
    let solve = STEP_FACTORS * factor(unknowns(trial, trial.brain.memory)) / pace.factor;
    let step = match optimise.protocol {
        Protocol::Paper if optimise.linear() => simulate * (1.0 + REVERSE) + solve,
        Protocol::Joint if optimise.linear() => casts * (fresh + solve),
        Protocol::Random if optimise.linear() => simulate + solve,
        Protocol::Random => simulate + AFRESH * ITERATION * forward + going,
        Protocol::Paper => simulate * (1.0 + REVERSE) + train + PRODUCTS * HESSIAN_PRODUCT * forward,
        // each iteration on as many samples as a batch, and the loss of four of them
        Protocol::Joint => casts * (fresh + (going + 4.0 * forward) * batch / train_samples.max(1.0)),
    };
    let long = trial.evaluation.long_iterations.unwrap_or(0) as f64 / trial.brain.iterations.max(1) as f64;
    // one more is trained on casts
    let of_casts = if trial.evaluation.casts.is_some_and(|casts| casts > 0) { 1.0 } else { 0.0 };
    let networks = trial.evaluation.networks() as f64 * (1.0 + long) + of_casts;
    let part = trial.evaluation.batch.map_or(1.0, |batch| (batch as f64 / train_samples.max(1.0)).min(1.0));
    let trainings = if network { networks * part } else { 0.0 };
    // as much as fits
    let readings = match trial.signals() * trial.time.samples <= READINGS_MAX {
        true => FACTORS * factor(unknowns(trial, None).min(READINGS_MAX)) / pace.factor,
        false => 0.0,
    };
    // Samples that are simulated, and factors, of casts and of other forces; those of many casts are known beforehand
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
        // by the model of the design and by two twins
        let of_a_cast = TWINS + 3.0 * stimuli.holdout.min(INVERTED_OF_A_CAST) as f64 * sample;
        (stimuli.test + stimuli.holdout) as f64 * sample + casts_read as f64 * of_a_cast
    } else {
        0.0
    };
    let compares_initial = optimise.steps() > 0 && trial.evaluation.initial.unwrap_or(true);
    let best = if optimise.steps() > 0 { ringing } else { one_sample };
    let [bodies, times] = if compares_initial { [2.0, one_sample + best] } else { [1.0, best] };
    let comparison = times * (samples + inverted) + bodies * (trainings * train + readings + factors);
    Parts { steps: optimise.steps() as f64 * step, comparison }
}

/// Seconds that trials take on so many workers of so many threads: the work shared out, but no less than the longest.
#[must_use]
pub fn seconds_on(trials: &[&Trial], workers: u32, threads: u32) -> f64 {
    let longest = trials.iter().map(|trial| trial.cost.sum(true)).fold(0.0, f64::max);
    (total(trials.iter().copied()) / f64::from(workers.max(1))).max(longest) / f64::from(threads.max(1))
}
