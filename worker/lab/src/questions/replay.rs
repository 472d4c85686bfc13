//! Replays a finished trial: forces, signals and estimates of all its samples, and the motion under one of them.
//!
//! Order of samples: training and test set by number, then the held-out set.

use metasense_numerics::Pool;
use metasense_numerics::brain::linear::{Lags, Sizes};
use metasense_numerics::brains::{Fitted, Inverse, Z_95, predict_on, predict_with};
use metasense_numerics::dynamics::{Forces, simulate};
use metasense_numerics::random::Purpose;
use metasense_numerics::trial::{
    Decoder, DecoderKind, Failure, PreparedTrial, Problem, Samples, Scales, check_failures, check_outcomes,
    clear_failed_forces, pilot, simulated, tuned,
};

/// Response of a body and its decoder to every sample of a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Replay {
    /// Force histories (N, K, T + 1) (N); on a finer clock of the forces, those of the targets.
    pub forces: Forces,
    /// Set of each sample (N): 0 training, 1 test, 2 held-out.
    pub split: Vec<u8>,
    /// Signals (N, T, channels) (mm/s², rad/s).
    pub signals: Vec<f64>,
    /// Estimated forces (N, T, K) (N); empty without weights, NaN for samples that an inverse decoder skipped.
    pub predictions: Vec<f64>,
    /// Half-widths (N, T, K) (N) of the 95 % bands of an inverse decoder, NaN for skipped samples; empty for others.
    pub half_widths: Vec<f64>,
    /// Error of each sample (%); `None` without force, empty without weights.
    pub errors: Vec<Option<f64>>,
    /// Whether a simulation failed (N). Such a sample has no signals, zero forces and an error of 100 %.
    pub failed: Vec<bool>,
    /// Offset subtracted from each channel: 0, or the middle of its range.
    pub signal_offset: Vec<f64>,
    /// Divisor of each channel: its RMS, or half its range.
    pub signal_scale: Vec<f64>,
    /// Mean of each panel's training forces (N), or their minimum.
    pub force_mean: Vec<f64>,
    /// Standard deviation of each panel's training forces (N), or their range.
    pub force_deviation: Vec<f64>,
}

/// Simulates `design` under all samples of the trial, and decodes them with a network if `weights` is not empty.
///
/// # Errors
/// If too many simulations fail.
///
/// # Panics
/// If lengths do not match the problem.
pub fn replay(
    problem: &Problem,
    design: &[f64],
    weights: &[f32],
    pool: &metasense_numerics::Pool,
) -> Result<Replay, Failure> {
    let trial = PreparedTrial::new(problem, pool)?;
    let (problem, solver) = (&trial.problem, trial.tuned(design).solver);
    let mut forces = all_forces(problem);
    let (_, test) = problem.stimuli.split(problem.seed);
    let mut kinds = vec![0; problem.stimuli.samples];
    test.iter().for_each(|&n| kinds[n] = 1);
    kinds.resize(forces.samples, 2);
    let simulation = simulated(problem, &problem.scene, design, &forces, &solver, false, pool);
    for set in 0..3 {
        let own = simulation.outcomes.iter().zip(&kinds).filter(|(_, kind)| **kind == set);
        check_failures(&own.map(|(outcome, _)| *outcome).collect::<Vec<_>>()).map_err(Failure::Initial)?;
    }
    let failed = clear_failed_forces(&mut forces, &simulation.outcomes);
    let signals = trial.disturbed_signals(simulation.signals, &forces);
    let all = problem.samples(signals, &forces).with_failed(failed);
    let (mut predictions, mut errors) = (Vec::new(), Vec::new());
    if !weights.is_empty() {
        predictions = predict_with(&trial, &all, &kinds, weights).map_err(Failure::Initial)?;
        errors = all.errors(&predictions);
    }
    let scales = if problem.decoder_kind.is_network() { &trial.network_scales } else { &trial.scales };
    let Scales { offset, channels, mean, deviation } = scales.clone();
    let mut replay = Replay {
        forces: problem.to_signal_clock(forces),
        split: kinds,
        signals: all.signals,
        failed: all.failed,
        predictions,
        half_widths: Vec::new(),
        errors,
        signal_offset: offset,
        signal_scale: channels,
        force_mean: mean,
        force_deviation: deviation,
    };
    if problem.decoder_kind == DecoderKind::Linear {
        let brain = replay.linear(problem, &problem.decoder, pool)?;
        (replay.predictions, replay.errors) = (brain.predictions, brain.errors);
    }
    Ok(replay)
}

/// A linear decoder fitted to a replay's training samples, and its estimates of all samples.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearReplay {
    /// Memory (lags).
    pub lags: Lags,
    /// λ.
    pub ridge: f64,
    /// W (K, lags, channels) (N): f̂ = b + Σ W · signal / `signal_scale`.
    pub w: Vec<f64>,
    /// b (K) (N).
    pub b: Vec<f64>,
    /// Estimated forces (N, T, K) (N).
    pub predictions: Vec<f64>,
    /// Error of each sample (%); `None` without force.
    pub errors: Vec<Option<f64>>,
}

impl Replay {
    /// Whether the network's inputs have an offset, so that a signal of 0 is not an input of 0.
    pub fn has_offset(&self) -> bool {
        self.signal_offset.iter().any(|offset| *offset != 0.0)
    }

    fn samples(&self, problem: &Problem) -> Samples {
        let (instants, outputs) = (problem.scene.instants, problem.scene.panels.len());
        let sizes = Sizes { instants, channels: self.signal_scale.len(), outputs };
        let targets = metasense_numerics::stimuli::targets(&self.forces, instants, false);
        Samples::new(sizes, self.signals.clone(), targets).with_failed(self.failed.clone())
    }

    /// Decodes the first `count` test samples and as many held-out samples with the inverse decoder of the design.
    ///
    /// # Errors
    /// If the decoder cannot be created.
    pub fn invert(
        &mut self,
        problem: &Problem,
        design: &[f64],
        count: usize,
        pool: &metasense_numerics::Pool,
    ) -> Result<(), Failure> {
        let (trial, all) = (PreparedTrial::new(problem, pool)?, self.samples(problem));
        let split = &self.split;
        let of = |set: u8| (0..split.len()).filter(move |&i| split[i] == set);
        let read: Vec<usize> = of(1).take(count).chain(of(2).take(count)).collect();
        let found = Inverse::of(&trial, design, None)?.read(&all.select(&read).signals);
        let [mut forces, mut half_widths] = [(); 2].map(|()| vec![f64::NAN; all.targets.len()]);
        let one = all.targets.len() / all.count();
        for (estimate, i) in found.iter().zip(read) {
            let at = i * one..(i + 1) * one;
            forces[at.clone()].copy_from_slice(&estimate.forces);
            let own = estimate.deviations.iter().map(|deviation| Z_95 * deviation);
            half_widths[at].iter_mut().zip(own).for_each(|(slot, half)| *slot = half);
        }
        let known = |error: Option<f64>| error.filter(|error| error.is_finite());
        self.errors = all.errors(&forces).into_iter().map(known).collect();
        (self.predictions, self.half_widths) = (forces, half_widths);
        Ok(())
    }

    /// Fits a linear decoder as a trial does.
    ///
    /// # Errors
    /// If no λ gives a solution.
    pub fn linear(&self, problem: &Problem, decoder: &Decoder, pool: &Pool) -> Result<LinearReplay, Failure> {
        let all = self.samples(problem);
        let training: Vec<usize> = (0..self.split.len()).filter(|&i| self.split[i] == 0).collect();
        let scale = Some(self.signal_scale.clone());
        let fitted =
            decoder.fit(problem.seed, &all.select(&training), scale, pool).map_err(Failure::Initial)?;
        Ok(replay_of_fit(&all, decoder.lags, &fitted))
    }

    /// Decodes all samples with a network stacked on a linear decoder, both given.
    ///
    /// # Panics
    /// If lengths do not match the problem.
    pub fn read_on(&mut self, problem: &Problem, linear: &Fitted, weights: &[f32], pool: &Pool) {
        let scales = Scales {
            offset: self.signal_offset.clone(),
            channels: self.signal_scale.clone(),
            mean: self.force_mean.clone(),
            deviation: self.force_deviation.clone(),
        };
        self.predictions = predict_on(linear, problem.reader_shape(), weights, &self.signals, &scales, pool);
        self.errors = self.samples(problem).errors(&self.predictions);
    }

    /// Estimates of a given linear decoder with the trial's memory.
    pub fn decode_with(&self, problem: &Problem, fitted: &Fitted) -> LinearReplay {
        replay_of_fit(&self.samples(problem), problem.decoder.lags, fitted)
    }
}

fn replay_of_fit(all: &Samples, lags: Lags, fitted: &Fitted) -> LinearReplay {
    let predictions = fitted.predict(&all.signals);
    let errors = all.errors(&predictions);
    let [w, b] = fitted.weights();
    LinearReplay { lags, ridge: fitted.ridge, w, b, predictions, errors }
}

fn all_forces(problem: &Problem) -> Forces {
    let mut forces = problem.forces(Purpose::Stimulus, 0, problem.stimuli.samples);
    let holdout = problem.holdout();
    forces.samples += holdout.samples;
    forces.values.extend(holdout.values);
    forces.strikes.extend(holdout.strikes);
    forces
}

/// Motion of a body under one sample.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// Displacement (u, v, θ) of every unit (mm, rad) at n = 1…T.
    pub displacements: Vec<Vec<[f64; 3]>>,
    /// Velocity (mm/s, rad/s).
    pub velocities: Vec<Vec<[f64; 3]>>,
}

/// Simulates `design` under one sample, numbered as in [`Replay`].
///
/// # Errors
/// If the simulation fails.
pub fn motion(
    problem: &Problem,
    design: &[f64],
    sample: usize,
    pool: &metasense_numerics::Pool,
) -> Result<Motion, Failure> {
    let solver = pilot(problem, design, &problem.solver, pool).solver;
    let forces = all_forces(problem).select(&[sample]);
    let simulation = simulate(&problem.scene, design, &forces, &solver, true, pool);
    check_outcomes(&simulation.outcomes).map_err(Failure::Initial)?;
    let tape = simulation.tape.expect("asked for");
    let states = (1..=problem.scene.instants).map(|n| tape.state(0, n));
    let (displacements, velocities) = states.unzip();
    Ok(Motion { displacements, velocities })
}

/// Signals (N, T, channels) of a body under given forces, with the chips of the trial, which are the same on every body.
///
/// # Errors
/// If a simulation fails, of this body or of the initial body, to which chips can be relative.
pub fn sense(
    problem: &Problem,
    design: &[f64],
    forces: &Forces,
    pool: &metasense_numerics::Pool,
) -> Result<Vec<f64>, Failure> {
    let solver = tuned(problem, &problem.scene, design, forces, &problem.solver, pool).solver;
    let simulation = simulated(problem, &problem.scene, design, forces, &solver, false, pool);
    check_outcomes(&simulation.outcomes).map_err(Failure::Initial)?;
    match problem.disturbance {
        Some(_) => Ok(PreparedTrial::new(problem, pool)?.disturbed_signals(simulation.signals, forces)),
        None => Ok(problem.read(simulation.signals, forces.samples)),
    }
}
