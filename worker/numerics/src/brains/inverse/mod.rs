//! The inverse decoder: finds the forces under which the body's model explains the readings.
//!
//! ```text
//! ẑ = argmin Φ(z),  Φ = ½ Σ (y − A(μ + D z) − b)²/σ² + ½ |z|² + ½ |b|²/σ_b²
//! ```
//! ẑ is the maximum a posteriori for a normal prior (`prior`). Quasi-Newton steps start from a linear decoder's estimate
//! (`descent`). The posterior is approximated by a normal distribution with the curvature of Φ at ẑ (Laplace).

mod descent;
mod model;
mod prior;

use super::Fitted;
use crate::definite::solve_with_floor;
use crate::dynamics::{Forces, IntegratorSettings};
use crate::identify::{Ending, GoOn, Twin};
use crate::random::Purpose;
use crate::trial::{Counters, DesignWithSolver, Failure, PreparedTrial, Problem, Samples, Trouble};
use descent::{Descent, Noise, Start};
use faer::Mat;
use model::Model;
use prior::Prior;
use std::ops::Range;

/// Number of histories for the prior, and the number of the first; outer steps and casts use other numbers.
const KNOWN: usize = 1000;
const KNOWN_FIRST: u64 = 1 << 42;
/// Parts of a sample that a restarted descent fits in turn.
const WINDOWS: [f64; 7] = [0.1, 0.16, 0.24, 0.35, 0.5, 0.7, 1.0];

/// Number of parts of the look-ahead. Readings are added part by part; each part of instants is estimated together.
const PARTS: usize = 4;
/// J is computed for this many parts at once.
const AT_ONCE: usize = 8;

/// Estimate for one sample.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Most probable forces (T, K) (N).
    pub forces: Vec<f64>,
    /// Posterior standard deviations of the forces (T, K) (N).
    pub deviations: Vec<f64>,
    /// Mean square of the residual in units of σ²; about 1 or less if the model explains the readings.
    pub misfit: f64,
    /// Number of steps.
    pub steps: usize,
    /// How the descent ended.
    pub ending: Ending,
}

impl Estimate {
    /// Appends the estimates of the following instants, which use more readings.
    fn append_later(&mut self, next: Self) {
        self.forces.extend(next.forces);
        self.deviations.extend(next.deviations);
        let ending = if self.ending == Ending::Converged { next.ending } else { self.ending };
        (self.misfit, self.steps, self.ending) = (next.misfit, self.steps + next.steps, ending);
    }

    /// Whether the model explains the readings.
    pub fn is_explained(&self) -> bool {
        self.misfit <= descent::EXPLAINED
    }
}

/// An inverse decoder.
pub struct Inverse<'a> {
    trial: &'a PreparedTrial<'a>,
    model: Model<'a>,
    guesses: Vec<Hypothesis>,
    noise: Noise,
    /// Linear decoder for the starts of descents, and its RMS error (N).
    linear: Fitted,
    linear_error: f64,
    /// Counters of the computations.
    pub counters: Counters,
}

/// Hypothesis about which panels are struck.
struct Hypothesis {
    prior: Prior,
    /// Logarithm of its share of the histories.
    share: f64,
    /// D of one panel, converted to decoder targets (T, r) (N).
    directions_of_targets: Mat<f64>,
}

impl Hypothesis {
    fn of(problem: &Problem, prior: Prior, share: f64) -> Self {
        let (directions, instants) = (prior.directions(), problem.scene.instants);
        let estimates = problem.targets(&directions);
        let directions_of_targets =
            Mat::from_fn(instants, directions.samples, |n, k| estimates[k * instants + n]);
        Self { prior, share, directions_of_targets }
    }
}

impl<'a> Inverse<'a> {
    /// Inverse decoder of a design, simulated with the solver tuned on it, or of its twin. A linear decoder fitted to `known`,
    /// samples of that model, starts the descents. The prior comes from fresh forces of the trial, or from the training
    /// samples if forces are recorded.
    ///
    /// # Errors
    /// If the linear decoder has no solution, or all force histories are equal.
    pub fn new(
        trial: &'a PreparedTrial<'a>,
        design: &[f64],
        solver: &IntegratorSettings,
        twin: Option<&Twin>,
        known: &Samples,
    ) -> Result<Self, Trouble> {
        let problem = &trial.problem;
        let linear = Fitted::of(trial, known)?;
        let said = linear.predict(&known.signals);
        let square = said.iter().zip(&known.targets).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
        let linear_error = (square / said.len() as f64).sqrt().max(f64::MIN_POSITIVE);
        let histories = match problem.stimuli.source.is_recorded() {
            true => trial.train.clone(),
            false => problem.forces(Purpose::Fresh, KNOWN_FIRST, KNOWN),
        };
        let guesses = guesses(problem, &histories);
        if guesses.is_empty() {
            return Err(Trouble::Singular);
        }
        let model = Model::new(trial, design, solver, twin.map(|twin| &twin.cast));
        let noise = Noise::of(trial, twin.map_or(&[], |twin| &twin.noise));
        Ok(Self { trial, model, guesses, noise, linear, linear_error, counters: Counters::default() })
    }

    /// As [`Inverse::new`]; tunes the solver and simulates the training samples.
    ///
    /// # Errors
    /// As [`Inverse::new`], or if too many of those samples fail.
    pub fn of(trial: &'a PreparedTrial<'a>, design: &[f64], twin: Option<&Twin>) -> Result<Self, Failure> {
        let (solver, [train, _]) = (trial.tuned(design).solver, trial.problem.training_and_test());
        let (cast, mut counters) = (twin.map(|twin| &twin.cast), Counters::default());
        let known = DesignWithSolver { trial, design, solver: &solver }.samples(cast, train, &mut counters);
        let brain = known.and_then(|known| Self::new(trial, design, &solver, twin, &known));
        brain.map(|brain| Self { counters, ..brain }).map_err(Failure::Initial)
    }

    /// Estimates forces from signals (N, T, channels).
    ///
    /// # Panics
    /// If the length is not a whole number of samples.
    pub fn read(&mut self, signals: &[f64]) -> Vec<Estimate> {
        self.read_while(signals, &mut || true).expect("told to go on")
    }

    /// As [`Inverse::read`]; `None` if `go_on` returns false.
    ///
    /// # Panics
    /// As [`Inverse::read`].
    pub fn read_while(&mut self, signals: &[f64], go_on: &mut GoOn) -> Option<Vec<Estimate>> {
        let one = self.trial.problem.scene.instants * self.noise.channels();
        let readings: Vec<&[f64]> = signals.chunks_exact(one).collect();
        if let Some(ahead) = self.ahead() {
            return self.estimate_causally(&readings, ahead, go_on);
        }
        let said = self.linear.predict(signals);
        let mut found = Vec::new();
        for guess in 0..self.guesses.len() {
            found.push(self.descend_whole(guess, &readings, &said, go_on)?);
        }
        let unexplained: Vec<usize> =
            (0..readings.len()).filter(|&i| !found.iter().any(|found| found[i].is_explained())).collect();
        for guess in 0..self.guesses.len() {
            for (i, retried) in self.descend_by_windows(guess, &readings, &unexplained, go_on)? {
                if retried.at.phi < found[guess][i].at.phi {
                    found[guess][i] = retried;
                }
            }
        }
        Some(self.likeliest(&found, 0..self.trial.problem.scene.instants))
    }

    /// Descends from the linear decoder's estimates (N, T, K) (N).
    fn descend_whole(
        &mut self,
        guess: usize,
        readings: &[&[f64]],
        said: &[f64],
        go_on: &mut GoOn,
    ) -> Option<Vec<Descent>> {
        let Hypothesis { prior, .. } = &self.guesses[guess];
        let begin = |forces: &[f64]| {
            let mut z = prior.estimate_unknowns(forces, self.linear_error);
            z.extend(self.noise.no_bias());
            Start::at_point(z)
        };
        let starts = said.chunks_exact(said.len() / readings.len().max(1)).map(begin).collect();
        self.descend(guess, readings, self.trial.problem.scene.instants, starts, go_on)
    }

    /// Per sample, the estimate at the instants `of` by the most probable hypothesis.
    fn likeliest(&self, found: &[Vec<Descent>], of: Range<usize>) -> Vec<Estimate> {
        let estimate_sample = |i: usize| {
            let surprise = |guess: usize| match found.len() {
                1 => 0.0,
                _ => found[guess][i].surprise() - self.guesses[guess].share,
            };
            let all = (0..found.len()).map(|guess| (guess, surprise(guess)));
            let (guess, _) = all.min_by(|a, b| a.1.total_cmp(&b.1)).expect("a guess");
            self.estimate(&self.guesses[guess], &found[guess][i], of.clone())
        };
        (0..found[0].len()).map(estimate_sample).collect()
    }

    /// Look-ahead (instants); `None` for the whole sample.
    fn ahead(&self) -> Option<usize> {
        let (after, all) = (self.trial.problem.decoder.lags.after, self.trial.problem.scene.instants);
        (after + 1 < all).then_some(after)
    }

    fn descend(
        &mut self,
        guess: usize,
        readings: &[&[f64]],
        n: usize,
        starts: Vec<Start>,
        go_on: &mut GoOn,
    ) -> Option<Vec<Descent>> {
        let Self { model, guesses, noise, counters, .. } = self;
        descent::descend(model, &guesses[guess].prior, noise, readings, n, starts, counters, go_on)
    }

    /// Estimates each instant from readings up to `ahead` instants later. Readings are added in parts; each descent continues the
    /// one before.
    fn estimate_causally(
        &mut self,
        readings: &[&[f64]],
        ahead: usize,
        go_on: &mut GoOn,
    ) -> Option<Vec<Estimate>> {
        let (all, width) = (self.trial.problem.scene.instants, self.noise.channels());
        let together = 1 + ahead / PARTS;
        let start = |guess: &Hypothesis| {
            Start::at_point(self.start(guess)).with_further_readings(together * width * AT_ONCE)
        };
        let mut starts: Vec<Vec<Start>> =
            self.guesses.iter().map(|guess| readings.iter().map(|_| start(guess)).collect()).collect();
        let mut estimates: Vec<Estimate> = Vec::new();
        let (mut from, mut n) = (0, ahead + 1);
        loop {
            let mut found = Vec::new();
            for (guess, starts) in starts.into_iter().enumerate() {
                found.push(self.descend(guess, readings, n, starts, go_on)?);
            }
            let to = if n == all { all } else { n - ahead - 1 + together };
            let here = self.likeliest(&found, from..to);
            if estimates.is_empty() {
                estimates = here;
            } else {
                estimates.iter_mut().zip(here).for_each(|(estimates, here)| estimates.append_later(here));
            }
            if n == all {
                return Some(estimates);
            }
            let more = together.min(all - n);
            (from, n) = (to, n + more);
            let onward = |descent| Start::onward(descent, more * width);
            starts = found.into_iter().map(|of| of.into_iter().map(onward).collect()).collect();
        }
    }

    /// The prior's mean.
    fn start(&self, guess: &Hypothesis) -> Vec<f64> {
        vec![0.0; guess.prior.unknowns() + self.noise.no_bias().len()]
    }

    /// Descends from the prior's mean through growing windows of the readings of these samples: early motion is almost linear,
    /// and later motion is then nearly determined. Drops samples whose window the model does not explain.
    fn descend_by_windows(
        &mut self,
        guess: usize,
        readings: &[&[f64]],
        samples: &[usize],
        go_on: &mut GoOn,
    ) -> Option<Vec<(usize, Descent)>> {
        let all = self.trial.problem.scene.instants;
        let start = self.start(&self.guesses[guess]);
        let mut remaining_samples: Vec<(usize, Start)> =
            samples.iter().map(|&i| (i, Start::at_point(start.clone()))).collect();
        let mut found = Vec::new();
        for part in WINDOWS {
            let n = ((part * all as f64) as usize).max(1);
            let (which, starts): (Vec<usize>, Vec<Start>) = remaining_samples.into_iter().unzip();
            let readings: Vec<&[f64]> = which.iter().map(|&i| readings[i]).collect();
            found = which.into_iter().zip(self.descend(guess, &readings, n, starts, go_on)?).collect();
            found.retain(|(_, descent): &(usize, Descent)| n == all || descent.is_explained());
            let again = |(i, descent): &(usize, Descent)| (*i, Start::at_point(descent.at.z.clone()));
            remaining_samples = found.iter().map(again).collect();
        }
        Some(found)
    }

    /// Estimate at the instants `of`.
    fn estimate(
        &self,
        Hypothesis { prior, directions_of_targets: seen, .. }: &Hypothesis,
        descent: &Descent,
        of: Range<usize>,
    ) -> Estimate {
        let (panels, directions) = (self.trial.problem.scene.panels.len(), seen.ncols());
        let forces = self.trial.problem.targets(&prior.forces([&descent.at.z[..]].into_iter()));
        let forces = forces[of.start * panels..of.end * panels].to_vec();
        let (from, instants) = (of.start, of.len());
        let mut deviations = vec![0.0; instants * panels];
        // One column per instant, panel by panel, so that B is factored once.
        let struck = &prior.struck;
        let mut right = Mat::<f64>::zeros(descent.at.z.len(), struck.len() * instants);
        for i in 0..struck.len() {
            let mut own = right.as_mut().submatrix_mut(i * directions, i * instants, directions, instants);
            own.copy_from(seen.subrows(from, instants).transpose());
        }
        // If B is not finite, the prior's deviations remain.
        let solved = solve_with_floor(descent.curvature().as_ref(), descent::LEAST, right.as_ref());
        let solved = solved.unwrap_or_else(|| right.clone());
        for (i, (right, solved)) in right.col_iter().zip(solved.col_iter()).enumerate() {
            let variance = right.transpose() * solved;
            deviations[i % instants * panels + struck[i / instants]] = variance.max(0.0).sqrt();
        }
        let (misfit, steps, ending) = (descent.misfit(), descent.steps, descent.ending());
        Estimate { forces, deviations, misfit, steps, ending }
    }
}

/// One hypothesis per set of panels that these histories strike together.
fn guesses(problem: &Problem, histories: &Forces) -> Vec<Hypothesis> {
    Prior::of(histories).into_iter().map(|(prior, share)| Hypothesis::of(problem, prior, share)).collect()
}

#[cfg(test)]
mod tests;
