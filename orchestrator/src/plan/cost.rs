//! What a trial costs, roughly, before it has run: counts of work times measured seconds.
//!
//! One core with AVX-512, as README's rates; within a factor of two or so. The engine replaces it by what steps have taken once there are some.

use super::Trial;
use metasense_schemas::spec::{BrainKind, Network, Protocol, TrialSpec};
use metasense_worker::problem::{READINGS_MAX, lags};

/// Integrator steps a second of motion, of the reference scene at its default tolerance.
const STEPS_PER_SECOND: f64 = 3100.0;
/// Seconds a unit and integrator step.
const SECONDS_PER_UNIT_STEP: f64 = 2.4e-7;
/// Of the reverse sweep, forward recomputation included, to the simulation.
const REVERSE: f64 = 2.1;
/// Multiply-adds a second of the brain's kernels.
const BRAIN_RATE: f64 = 1.1e11;
/// Of an iteration (forward, backward) and of a Hessian-vector product to a forward pass.
const ITERATION: f64 = 3.0;
const HESSIAN_PRODUCT: f64 = 6.3;
/// Products of the implicit term.
const PRODUCTS: f64 = 21.0;

/// Multiply-adds a second of a factor, of D³/6 of them.
const FACTOR_RATE: f64 = 2.5e10;
/// Factors of the comparison, a body, and of a step, looks for a ridge included.
const FACTORS: f64 = 8.0;
const STEP_FACTORS: f64 = 1.5;

/// Weights of the brain: of a network those of its kernels, of a linear one those of its lags, of a stacked one both; with biases.
pub(super) fn brain_parameters(trial: &TrialSpec) -> usize {
    let linear = || trial.point.panels * (unknowns(trial, trial.brain.memory) + 1);
    match trial.brain.kind {
        BrainKind::Cnn => network_weights(trial),
        BrainKind::Linear => linear(),
        BrainKind::Stacked => network_weights(trial) + linear(),
    }
}

fn network_weights(trial: &TrialSpec) -> usize {
    let (Network { width, kernels, .. }, last) = (trial.brain.network(), trial.point.panels);
    let estimates = if trial.brain.kind == BrainKind::Stacked { last } else { 0 };
    let mut from = 3 * trial.point.sensors + estimates;
    let layers = kernels.iter().enumerate().map(|(i, kernel)| {
        let to = if i + 1 == kernels.len() { last } else { width };
        (kernel * std::mem::replace(&mut from, to) + 1) * to
    });
    layers.sum()
}

/// Unknowns of a linear brain with this memory, a force.
fn unknowns(trial: &TrialSpec, memory: Option<[f64; 2]>) -> usize {
    3 * trial.point.sensors * lags(&trial.time, memory).groups().len()
}

fn factor(unknowns: usize) -> f64 {
    (unknowns as f64).powi(3) / 6.0 / FACTOR_RATE
}

/// Seconds of a trial on one core.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seconds {
    /// Of all outer steps.
    pub steps: f64,
    /// Of the comparison at the end.
    pub comparison: f64,
}

pub(super) fn seconds(trial: &TrialSpec, units: usize) -> Seconds {
    let stimuli = &trial.stimuli;
    let scale = (trial.solver.tolerance / 1e-6).powf(-0.2);
    // A step ends at every instant, and wherever the forces' own clock has a kink.
    let instants = trial.time.samples as f64;
    let kinks = stimuli.force_samples.map_or(1.0, |n| n as f64 / instants);
    let steps = (trial.time.duration * STEPS_PER_SECOND * scale / instants / kinks).ceil() * kinks * instants;
    let one_sample = steps * units as f64 * SECONDS_PER_UNIT_STEP;
    let simulate = stimuli.samples as f64 * one_sample;
    let network = trial.brain.kind != BrainKind::Linear;
    let weights = network_weights(trial) as f64;
    let train_samples = stimuli.samples.saturating_sub(stimuli.test) as f64;
    let forward = weights * train_samples * trial.time.samples as f64 / BRAIN_RATE;
    let train = trial.brain.iterations as f64 * ITERATION * forward;
    let optimise = trial.optimise.clone().resolved();
    let batch = optimise.batch.unwrap_or(stimuli.test) as f64;
    let going = optimise.brain_iterations.unwrap_or_default() as f64 * ITERATION * forward;
    let differentiate = batch * one_sample * (1.0 + REVERSE);
    let solve = STEP_FACTORS * factor(unknowns(trial, trial.brain.memory));
    let step = match optimise.protocol {
        Protocol::Paper if optimise.linear() => simulate * (1.0 + REVERSE) + solve,
        Protocol::Warm | Protocol::Envelope if optimise.linear() => simulate + differentiate + solve,
        Protocol::Joint if optimise.linear() => 0.5 * differentiate + solve,
        Protocol::Random | Protocol::Cmaes if optimise.linear() => simulate + solve,
        Protocol::Random | Protocol::Cmaes => simulate + going,
        Protocol::Paper => simulate * (1.0 + REVERSE) + train + PRODUCTS * HESSIAN_PRODUCT * forward,
        Protocol::Warm | Protocol::Envelope => simulate + differentiate + going,
        // on four batches, by the coarse integrator mostly
        Protocol::Joint => 0.5 * differentiate + going * 4.0 * batch / train_samples.max(1.0),
    };
    let long = trial.evaluation.long_iterations.unwrap_or(0) as f64 / trial.brain.iterations.max(1) as f64;
    let trainings = if network { trial.evaluation.seeds as f64 * (1.0 + long) } else { 0.0 };
    // as much as fits
    let readings = match 3 * trial.point.sensors * trial.time.samples <= READINGS_MAX {
        true => FACTORS * factor(unknowns(trial, None).min(READINGS_MAX)),
        false => 0.0,
    };
    let comparison =
        2.0 * ((stimuli.samples + stimuli.holdout) as f64 * one_sample + trainings * train + readings);
    Seconds { steps: optimise.steps() as f64 * step, comparison }
}

/// Seconds that trials take on so many workers of so many threads: the work shared out, but no less than the longest.
#[must_use]
pub fn seconds_on(trials: &[&Trial], workers: u32, threads: u32) -> f64 {
    let (total, longest) =
        trials.iter().fold((0.0, 0.0_f64), |(sum, most), trial| (sum + trial.cost, most.max(trial.cost)));
    (total / f64::from(workers.max(1))).max(longest) / f64::from(threads.max(1))
}
