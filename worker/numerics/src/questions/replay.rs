//! A finished trial once more: forces, signals and predictions of all its samples, and the motion under one of them.
//!
//! Samples stand in one row: training and test set as numbered at the draw, then the holdout.

use crate::Pool;
use crate::brain::linear::{Lags, Sizes};
use crate::brains::{Fitted, Fresh, Inverse, TO_EACH_SIDE, predict_on, reader};
use crate::dynamics::{Forces, simulate};
use crate::random::Purpose;
use crate::trial::{
    BrainKind, Decoder, Failure, Problem, Samples, Scales, Trial, all_well, few_failed, pilot, silence,
    simulated, tuned,
};

/// What a body and a network do with every sample of a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Replay {
    /// Force histories (N, K, T+1) in N, as targets have them where the forces' own clock is finer.
    pub forces: Forces,
    /// 0 training, 1 test, 2 holdout (N).
    pub split: Vec<u8>,
    /// Sensor signals (N, T, channels) in mm/s² and rad/s.
    pub signals: Vec<f64>,
    /// Predicted forces (N, T, K) in N; empty without weights, NaN where an inverse brain has not read.
    pub predictions: Vec<f64>,
    /// Of an inverse brain: half-widths (N, T, K) in N of its 95 % bands, likewise.
    pub half_widths: Vec<f64>,
    /// Prediction error of each sample (%); `None` where there is no force, empty without weights.
    pub errors: Vec<Option<f64>>,
    /// Whether a sample's simulation failed (N): it then has no signals, its forces stand as zero, its error is 100 %.
    pub failed: Vec<bool>,
    /// What is subtracted from each signal channel (channels): 0, or the middle of its range.
    pub signal_offset: Vec<f64>,
    /// What each signal channel is then divided by (channels): its RMS, or half its range.
    pub signal_scale: Vec<f64>,
    /// Mean of each panel's training forces (N), or their least.
    pub force_mean: Vec<f64>,
    /// Their standard deviation (N), or their range.
    pub force_deviation: Vec<f64>,
}

/// Simulates `design` under all samples of the trial and lets a network with `weights` (or none, if empty) predict.
///
/// # Errors
/// If more simulations fail than may in a comparison.
///
/// # Panics
/// If lengths do not fit the problem.
pub fn replay(
    problem: &Problem,
    design: &[f64],
    weights: &[f32],
    pool: &crate::Pool,
) -> Result<Replay, Failure> {
    let trial = Trial::new(problem, pool)?;
    let (problem, solver) = (&trial.problem, trial.tuned(design).solver);
    let mut forces = all_forces(problem);
    let (_, test) = problem.stimuli.split(problem.seed);
    let mut kinds = vec![0; problem.stimuli.samples];
    test.iter().for_each(|&n| kinds[n] = 1);
    kinds.resize(forces.samples, 2);
    let simulation = simulated(problem, &problem.scene, design, &forces, &solver, false, pool);
    for set in 0..3 {
        let own = simulation.outcomes.iter().zip(&kinds).filter(|(_, kind)| **kind == set);
        few_failed(&own.map(|(outcome, _)| *outcome).collect::<Vec<_>>()).map_err(Failure::Initial)?;
    }
    let failed = silence(&mut forces, &simulation.outcomes);
    let signals = trial.heard(simulation.signals, &forces);
    let all = problem.samples(signals, &forces).with_failed(failed);
    let (mut predictions, mut errors) = (Vec::new(), Vec::new());
    if !weights.is_empty() {
        predictions = predicted(&trial, &all, weights, &kinds)?;
        errors = all.errors(&predictions);
    }
    let scales = if problem.reader.is_network() { &trial.network_scales } else { &trial.scales };
    let Scales { offset, channels, mean, deviation } = scales.clone();
    let mut replay = Replay {
        forces: problem.seen(forces),
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
    if problem.reader == BrainKind::Linear {
        let brain = replay.linear(problem, &problem.decoder, pool)?;
        (replay.predictions, replay.errors) = (brain.predictions, brain.errors);
    }
    Ok(replay)
}

/// Forces (N, T, K) (N) of all samples by a network with these weights; kind 0 are those that trained it.
fn predicted(trial: &Trial, all: &Samples, weights: &[f32], kinds: &[u8]) -> Result<Vec<f64>, Failure> {
    let training: Vec<usize> = (0..kinds.len()).filter(|&i| kinds[i] == 0).collect();
    let known = all.select(&training);
    let scales = [trial.scales.clone(), trial.network_scales.clone()];
    let mut reader = reader(trial.problem.recipe(), &known, scales, trial.pool).map_err(Failure::Initial)?;
    *reader.training().expect("a brain with weights is a network") = Some(Fresh::of(weights.to_vec()));
    let mut predictions = reader.predict(&all.signals);
    let one = predictions.len() / kinds.len();
    for (own, sample) in reader.predict_known().chunks_exact(one).zip(training) {
        predictions[sample * one..][..one].copy_from_slice(own);
    }
    Ok(predictions)
}

/// A linear brain fitted on a replay's training samples, and what it says of all of them.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearReplay {
    /// Its memory.
    pub lags: Lags,
    /// λ.
    pub ridge: f64,
    /// W (K, lags, channels) in N: f̂ = b + Σ W · signal / `signal_scale`.
    pub w: Vec<f64>,
    /// b (K) in N.
    pub b: Vec<f64>,
    /// Predicted forces (N, T, K) in N.
    pub predictions: Vec<f64>,
    /// Prediction error of each sample (%); `None` where there is no force.
    pub errors: Vec<Option<f64>>,
}

impl Replay {
    /// Whether a signal of 0 is not 0 for the network.
    pub fn has_offset(&self) -> bool {
        self.signal_offset.iter().any(|offset| *offset != 0.0)
    }

    fn samples(&self, problem: &Problem) -> Samples {
        let (instants, outputs) = (problem.scene.instants, problem.scene.panels.len());
        let sizes = Sizes { instants, channels: self.signal_scale.len(), outputs };
        let targets = crate::stimuli::targets(&self.forces, instants, false);
        Samples::new(sizes, self.signals.clone(), targets).with_failed(self.failed.clone())
    }

    /// Lets the inverse brain of the design read the first `count` test samples, and as many of the holdout.
    ///
    /// # Errors
    /// If the brain cannot be made.
    pub fn invert(
        &mut self,
        problem: &Problem,
        design: &[f64],
        count: usize,
        pool: &crate::Pool,
    ) -> Result<(), Failure> {
        let (trial, all) = (Trial::new(problem, pool)?, self.samples(problem));
        let split = &self.split;
        let of = |set: u8| (0..split.len()).filter(move |&i| split[i] == set);
        let read: Vec<usize> = of(1).take(count).chain(of(2).take(count)).collect();
        let found = Inverse::of(&trial, design, None)?.read(&all.select(&read).signals);
        let [mut forces, mut half_widths] = [(); 2].map(|()| vec![f64::NAN; all.targets.len()]);
        let one = all.targets.len() / all.count();
        for (estimate, i) in found.iter().zip(read) {
            let at = i * one..(i + 1) * one;
            forces[at.clone()].copy_from_slice(&estimate.forces);
            let own = estimate.deviations.iter().map(|deviation| TO_EACH_SIDE * deviation);
            half_widths[at].iter_mut().zip(own).for_each(|(slot, half)| *slot = half);
        }
        let known = |error: Option<f64>| error.filter(|error| error.is_finite());
        self.errors = all.errors(&forces).into_iter().map(known).collect();
        (self.predictions, self.half_widths) = (forces, half_widths);
        Ok(())
    }

    /// Fits a linear brain as a trial does.
    ///
    /// # Errors
    /// If no λ has a solution.
    pub fn linear(&self, problem: &Problem, decoder: &Decoder, pool: &Pool) -> Result<LinearReplay, Failure> {
        let all = self.samples(problem);
        let training: Vec<usize> = (0..self.split.len()).filter(|&i| self.split[i] == 0).collect();
        let scale = Some(self.signal_scale.clone());
        let fitted =
            decoder.fit(problem.seed, &all.select(&training), scale, pool).map_err(Failure::Initial)?;
        Ok(said(&all, decoder.lags, &fitted))
    }

    /// Lets a network with these weights read, on a linear brain, whatever both were fitted to.
    ///
    /// # Panics
    /// If lengths do not fit the problem.
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

    /// What a linear brain of the trial's memory says, fitted to whatever samples.
    pub fn by(&self, problem: &Problem, fitted: &Fitted) -> LinearReplay {
        said(&self.samples(problem), problem.decoder.lags, fitted)
    }
}

fn said(all: &Samples, lags: Lags, fitted: &Fitted) -> LinearReplay {
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

/// How a body moves under one sample.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// Displacement (u, v, θ) of every unit in mm and rad, at n = 1…T.
    pub displacements: Vec<Vec<[f64; 3]>>,
    /// Velocity in mm/s and rad/s.
    pub velocities: Vec<Vec<[f64; 3]>>,
}

/// Simulates `design` under one sample, numbered as in [`Replay`].
///
/// # Errors
/// If the simulation does not end well.
pub fn motion(
    problem: &Problem,
    design: &[f64],
    sample: usize,
    pool: &crate::Pool,
) -> Result<Motion, Failure> {
    let solver = pilot(problem, design, &problem.solver, pool).solver;
    let forces = all_forces(problem).select(&[sample]);
    let simulation = simulate(&problem.scene, design, &forces, &solver, true, pool);
    all_well(&simulation.outcomes).map_err(Failure::Initial)?;
    let tape = simulation.tape.expect("asked for");
    let states = (1..=problem.scene.instants).map(|n| tape.state(0, n));
    let (displacements, velocities) = states.unzip();
    Ok(Motion { displacements, velocities })
}

/// Signals (N, T, channels) of a body under given forces, as its chips give them: those of the trial, which are the same on every body.
///
/// # Errors
/// If a sample does not reach its end, or, where chips are relative to it, the trial's initial body does not.
pub fn sense(
    problem: &Problem,
    design: &[f64],
    forces: &Forces,
    pool: &crate::Pool,
) -> Result<Vec<f64>, Failure> {
    let solver = tuned(problem, &problem.scene, design, forces, &problem.solver, pool).solver;
    let simulation = simulated(problem, &problem.scene, design, forces, &solver, false, pool);
    all_well(&simulation.outcomes).map_err(Failure::Initial)?;
    match problem.disturbance {
        Some(_) => Ok(Trial::new(problem, pool)?.heard(simulation.signals, forces)),
        None => Ok(problem.read(simulation.signals, forces.samples)),
    }
}
