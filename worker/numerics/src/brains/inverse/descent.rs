//! Minimises Φ for several samples at once.
//!
//! ```text
//! z ← z + (B + λ)⁻¹ s,  s = −dΦ/dz      B₀ = 1 + JᵀJ, then updated by BFGS
//! ```
//! s is exact (adjoint). J comes from differences along the prior's directions with coarse steps: its errors cost steps, but do
//! not move the minimum. (In f32, rounding would add false information along insensitive directions.)

use super::model::Model;
use super::prior::Prior;
use crate::definite::{half_log, solve_with_floor};
use crate::dynamics::Outcome;
use crate::identify::{Ending, GoOn};
use crate::trial::{Counters, PreparedTrial};
use faer::{Col, Mat, Scale};
use rayon::prelude::*;

/// Least noise of a reading, relative to its channel's RMS on the initial body.
const EXACT: f64 = 1e-4;
/// Samples that are simulated together, in lanes.
const TOGETHER: usize = 32;
/// Predicted decrease of Φ below which a descent has converged. Multiplied by the misfit if that exceeds 1: Φ is then steeper
/// along directions without information.
const CONVERGED_DECREASE: f64 = 0.1;
/// Mean square of the residual (σ²) above which readings count as not explained.
pub(super) const EXPLAINED: f64 = 1.5;
/// Lower bound on the eigenvalues of B.
pub(super) const LEAST: f64 = 1.0;
/// Largest number of evaluations of Φ.
const MAX_EVALUATIONS: usize = 150;
/// Number of steps after which B is computed again.
const OLD: usize = 20;
/// Marquardt damping: factor of its changes, first value, and limit.
const DAMPING: f64 = 10.0;
const DAMPED: f64 = 1.0;
const MAX_DAMPING: f64 = 1e9;

/// Noise per channel.
#[derive(Debug, Clone)]
pub(super) struct Noise {
    /// σ of a reading.
    white: Vec<f64>,
    /// σ_b, standard deviation of a constant per sample; empty for chips without bias.
    bias: Vec<f64>,
}

impl Noise {
    /// Noise of the trial's chips, rounding included, but at least `left`, a twin's residual per channel.
    pub(super) fn of(trial: &PreparedTrial, left: &[f64]) -> Self {
        let rms = &trial.scales.channels;
        let zeros = || vec![0.0; rms.len()];
        let (white, bias) = match &trial.chip {
            Some(chip) => (chip.deviations(), chip.bias.clone()),
            None => (zeros(), zeros()),
        };
        let left = left.iter().chain(std::iter::repeat(&0.0));
        let white =
            white.iter().zip(rms).zip(left).map(|((white, rms), left)| white.max(EXACT * rms).max(*left));
        let white = white.collect();
        Self { white, bias: if bias.iter().any(|s| *s > 0.0) { bias } else { Vec::new() } }
    }

    pub(super) fn channels(&self) -> usize {
        self.white.len()
    }

    /// b/σ_b = 0.
    pub(super) fn no_bias(&self) -> Vec<f64> {
        vec![0.0; self.bias.len()]
    }

    /// (y − A − b)/σ.
    fn residual(&self, readings: &[f64], signals: &[f64], bias: &[f64]) -> Vec<f64> {
        let c = self.channels();
        let of = |(i, (y, a)): (usize, (&f64, &f64))| {
            let b = bias.get(i % c).map_or(0.0, |b| b * self.bias[i % c]);
            (y - a - b) / self.white[i % c]
        };
        readings.iter().zip(signals).enumerate().map(of).collect()
    }
}

/// A point in the space of unknowns.
#[derive(Debug, Clone)]
pub(super) struct Point {
    /// z, then b/σ_b.
    pub(super) z: Vec<f64>,
    /// Φ; infinite if the simulation failed.
    pub(super) phi: f64,
    residual: Vec<f64>,
    pub(super) slope: Col<f64>,
}

/// Descent of one sample.
#[derive(Debug, Clone)]
pub(super) struct Descent {
    pub(super) at: Point,
    /// B; `None` until it is computed.
    curvature: Option<Mat<f64>>,
    /// Steps since B was 1 + JᵀJ.
    age: usize,
    /// Number of further readings for which J is wanted, and J for the available ones.
    further_readings: (usize, Mat<f64>),
    damping: f64,
    pub(super) steps: usize,
    ending: Option<Ending>,
}

/// Start of a descent.
pub(super) struct Start {
    z: Vec<f64>,
    /// B and its age, from fewer readings.
    known: Option<(Mat<f64>, usize)>,
    /// Number of further readings for which J is wanted, and J for the available ones.
    jacobian_ahead: (usize, Mat<f64>),
}

impl Start {
    /// Starts at z, then b/σ_b, with unknown curvature.
    pub(super) fn at_point(z: Vec<f64>) -> Self {
        Self { z, known: None, jacobian_ahead: (0, Mat::new()) }
    }

    /// Also requests J for this many further readings.
    pub(super) fn with_further_readings(self, readings: usize) -> Self {
        Self { jacobian_ahead: (readings, Mat::new()), ..self }
    }

    /// Continues a descent with additional readings.
    pub(super) fn onward(descent: Descent, readings: usize) -> Self {
        let Descent { at, curvature, age, further_readings: (wanted, coming), .. } = descent;
        let z = at.z;
        match curvature {
            Some(curvature) if readings <= coming.nrows() => {
                let (new, rest) = coming.split_at_row(readings);
                let curvature_and_age = Some((curvature + new.transpose() * new, age));
                Self { z, known: curvature_and_age, jacobian_ahead: (wanted, rest.to_owned()) }
            }
            _ => Self::at_point(z).with_further_readings(wanted),
        }
    }
}

/// Fits the first n instants of the readings (T, channels) of each sample; `None` if `go_on` returns false.
pub(super) fn descend(
    model: &Model,
    prior: &Prior,
    noise: &Noise,
    readings: &[&[f64]],
    n: usize,
    starts: Vec<Start>,
    counters: &mut Counters,
    go_on: &mut GoOn,
) -> Option<Vec<Descent>> {
    let mut all = Vec::with_capacity(readings.len());
    let mut starts = starts.into_iter();
    for readings in readings.chunks(TOGETHER) {
        let mut evaluator = Evaluator { model, prior, noise, readings, n, counters };
        let mut begun: Vec<Start> = starts.by_ref().take(readings.len()).collect();
        let points = begun.iter_mut().map(|start| std::mem::take(&mut start.z)).enumerate().collect();
        let mut descents: Vec<Descent> =
            evaluator.at(points).into_iter().zip(begun).map(|(at, start)| Descent::new(at, start)).collect();
        for _ in 0..MAX_EVALUATIONS {
            if !go_on() {
                return None;
            }
            descents.iter_mut().for_each(|descent| evaluator.curve(descent));
            let next_point = |(i, descent): (usize, &mut Descent)| Some((i, descent.ahead()?));
            let proposals: Vec<(usize, Vec<f64>)> =
                model.pool.install(|| descents.par_iter_mut().enumerate().filter_map(next_point).collect());
            if proposals.is_empty() {
                break;
            }
            let which: Vec<usize> = proposals.iter().map(|(i, _)| *i).collect();
            for (i, point) in which.into_iter().zip(evaluator.at(proposals)) {
                descents[i].accept_or_damp(point);
            }
        }
        // A descent that used all evaluations may have discarded its B.
        descents.iter_mut().for_each(|descent| evaluator.curve(descent));
        all.extend(descents);
    }
    Some(all)
}

/// Evaluates Φ for a batch of samples.
pub(super) struct Evaluator<'a> {
    pub(super) model: &'a Model<'a>,
    pub(super) prior: &'a Prior,
    pub(super) noise: &'a Noise,
    pub(super) readings: &'a [&'a [f64]],
    pub(super) n: usize,
    pub(super) counters: &'a mut Counters,
}

impl Evaluator<'_> {
    /// Φ and its slope at given z of samples, identified by number.
    pub(super) fn at(&mut self, at: Vec<(usize, Vec<f64>)>) -> Vec<Point> {
        let Self { model, prior, noise, readings, n, .. } = self;
        let (c, unknowns) = (noise.channels(), prior.unknowns());
        let len = *n * c;
        let histories = prior.forces(at.iter().map(|(_, z)| z.as_slice()));
        let (found, signals) = model.simulate(&histories, *n, true, self.counters);
        let residuals: Vec<Vec<f64>> = at
            .iter()
            .zip(signals.chunks_exact(len))
            .map(|((i, z), signals)| noise.residual(&readings[*i][..len], signals, &z[unknowns..]))
            .collect();
        let cotangent: Vec<f64> = residuals
            .iter()
            .flat_map(|residual| residual.iter().enumerate().map(|(i, r)| r / noise.white[i % c]))
            .collect();
        let bias = |bar: &[f64], k: usize| noise.bias[k] * bar[k..].iter().step_by(c).sum::<f64>();
        let biases: Vec<Vec<f64>> = cotangent
            .chunks_exact(len)
            .map(|bar| (0..noise.bias.len()).map(|k| bias(bar, k)).collect())
            .collect();
        let pushed = model.signals_vjp(&found, cotangent, self.counters);
        let one = pushed.len() / at.len();
        let finer = (one / histories.panels - 1) / (*n * histories.kinks(&model.scene));
        let pushed = pushed.chunks_exact(one);
        let points = at.into_iter().zip(residuals).zip(biases).zip(pushed).zip(&found.outcomes);
        points
            .map(|(((((_, z), residual), biases), pushed), outcome)| {
                let phi = 0.5 * residual.iter().chain(&z).map(|x| x * x).sum::<f64>();
                let slope: Vec<f64> = prior.forces_vjp(pushed, finer).into_iter().chain(biases).collect();
                let slope = Col::from_fn(z.len(), |k| slope[k] - z[k]);
                let phi = if *outcome == Outcome::Ok { phi } else { f64::INFINITY };
                Point { z, phi, residual, slope }
            })
            .collect()
    }

    /// Computes B where it is missing.
    fn curve(&mut self, descent: &mut Descent) {
        if descent.curvature.is_some() || descent.ending.is_some() {
            return;
        }
        let Self { model, prior, noise, n, .. } = self;
        let (unknowns, c) = (prior.unknowns(), noise.channels());
        let (len, all) = (descent.at.residual.len(), descent.at.z.len());
        let (histories, steps) = prior.around(&descent.at.z);
        let farther = (*n + descent.further_readings.0 / c).min(model.scene.instants);
        let (_, found) = model.simulate(&histories, farther, false, self.counters);
        let one = farther * c;
        let jacobian = Mat::from_fn(one, all, |i, k| match k < unknowns {
            true => (found[(1 + k) * one + i] - found[i]) / (steps[k] * noise.white[i % c]),
            false if k - unknowns == i % c => noise.bias[i % c] / noise.white[i % c],
            false => 0.0,
        });
        let (jacobian, coming) = jacobian.split_at_row(len);
        let curvature = jacobian.transpose() * jacobian + Mat::<f64>::identity(all, all);
        (descent.curvature, descent.age) = (Some(curvature), 0);
        descent.further_readings.1 = coming.to_owned();
    }
}

impl Descent {
    fn new(at: Point, Start { known, jacobian_ahead: further_readings, .. }: Start) -> Self {
        let ending = at.phi.is_infinite().then_some(Ending::StartFailed);
        let (curvature, age) = known.unzip();
        let age = age.unwrap_or(0);
        Self { at, curvature, age, further_readings, damping: 0.0, steps: 0, ending }
    }

    /// −ln of the marginal likelihood of the readings, by Laplace's method: Φ + ½ ln |B|.
    pub(super) fn surprise(&self) -> f64 {
        self.at.phi + half_log(self.curvature().as_ref(), LEAST)
    }

    /// B; the identity, as for the prior, without readings.
    pub(super) fn curvature(&self) -> Mat<f64> {
        let all = self.at.z.len();
        self.curvature.clone().unwrap_or_else(|| Mat::identity(all, all))
    }

    pub(super) fn ending(&self) -> Ending {
        self.ending.unwrap_or(Ending::StepsSpent)
    }

    /// Mean square of the residual.
    pub(super) fn misfit(&self) -> f64 {
        self.at.residual.iter().map(|r| r * r).sum::<f64>() / self.at.residual.len() as f64
    }

    pub(super) fn is_explained(&self) -> bool {
        self.misfit() <= EXPLAINED
    }

    /// Next point to evaluate; `None` if the descent has ended.
    fn ahead(&mut self) -> Option<Vec<f64>> {
        if self.ending.is_some() {
            return None;
        }
        let (mut curvature, slope) = (self.curvature.clone()?, &self.at.slope);
        (0..curvature.nrows()).for_each(|k| curvature[(k, k)] += self.damping);
        let Some(step) = solve_with_floor(curvature.as_ref(), LEAST, slope.as_mat()) else {
            self.ending = Some(Ending::NoProgress);
            return None;
        };
        let step = step.col(0);
        let enough = CONVERGED_DECREASE * self.misfit().max(1.0);
        if 0.5 * (slope.transpose() * step) < enough && self.damping == 0.0 {
            self.ending = Some(Ending::Converged);
            return None;
        }
        Some(self.at.z.iter().zip(step.iter()).map(|(z, step)| z + step).collect())
    }

    /// Accepts a point of lower Φ and updates B (BFGS; Nocedal and Wright, Numerical Optimization, §6.1). Otherwise increases the
    /// damping, and at its limit computes B again.
    fn accept_or_damp(&mut self, trial_point: Point) {
        let curvature = self.curvature.as_mut().expect("made before");
        if trial_point.phi >= self.at.phi {
            self.damping = (DAMPING * self.damping).max(DAMPED);
            if self.damping > MAX_DAMPING {
                match self.age {
                    0 => self.ending = Some(Ending::NoProgress),
                    _ => (self.curvature, self.damping) = (None, 0.0),
                }
            }
            return;
        }
        let step = Col::from_fn(trial_point.z.len(), |k| trial_point.z[k] - self.at.z[k]);
        let slope_change = &self.at.slope - &trial_point.slope;
        let (along, pulled) = (slope_change.transpose() * &step, &*curvature * &step);
        let square = step.transpose() * &pulled;
        // Skip the update if Φ is concave between the points.
        if along > 1e-3 * square {
            *curvature += &slope_change * slope_change.transpose() * Scale(1.0 / along);
            *curvature -= &pulled * pulled.transpose() * Scale(1.0 / square);
        }
        self.damping = if self.damping > DAMPED { self.damping / DAMPING } else { 0.0 };
        (self.at, self.age, self.steps) = (trial_point, self.age + 1, self.steps + 1);
        if self.age >= OLD {
            self.curvature = None;
        }
    }
}
