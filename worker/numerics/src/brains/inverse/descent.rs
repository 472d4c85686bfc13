//! Lowers Φ of many samples at once, each from where it begins.
//!
//! ```text
//! z ← z + (B + λ)⁻¹ s,  s = −dΦ/dz      B₀ = 1 + JᵀJ, then by the secants of the steps
//! ```
//! Slopes are exact, by the adjoint. J is had by differences along the prior's directions at coarse steps: what is
//! off in it costs steps, and moves no minimum. (In f32 its rounding would count as information along directions that tell nothing.)

use super::model::Model;
use super::prior::Prior;
use crate::definite::{half_log, solved};
use crate::dynamics::Outcome;
use crate::identify::{Ending, GoOn};
use crate::trial::{Counters, Trial};
use faer::{Col, Mat, Scale};
use rayon::prelude::*;

/// Noise that a reading has at least, relative to its channel's RMS on the initial body.
const EXACT: f64 = 1e-4;
/// Samples that step together, in lanes.
const TOGETHER: usize = 32;
/// A descent is over where a step promises to lower Φ by less, times the misfit where the model does not explain the readings: Φ is
/// then that much steeper along directions that tell nothing.
const ENOUGH: f64 = 0.1;
/// Mean square of the residual (σ²) above which readings count as not explained.
pub(super) const EXPLAINED: f64 = 1.5;
/// B is so much and more along every direction.
pub(super) const LEAST: f64 = 1.0;
/// Most looks at Φ.
const LOOKS: usize = 150;
/// Steps after which B is made anew.
const OLD: usize = 20;
/// Marquardt's damping: by what it grows and falls, where it begins, and where it is too much.
const DAMPING: f64 = 10.0;
const DAMPED: f64 = 1.0;
const HELD: f64 = 1e9;

/// What a channel's readings are off by.
#[derive(Debug, Clone)]
pub(super) struct Noise {
    /// σ of each reading.
    white: Vec<f64>,
    /// s of a constant a sample; empty of chips without.
    bias: Vec<f64>,
}

impl Noise {
    /// Of the trial's chips, a step's rounding included, and no less than what a twin has left of the signals, a channel.
    pub(super) fn of(trial: &Trial, left: &[f64]) -> Self {
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

    /// b/s of constants that are 0.
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

/// A place on the way.
#[derive(Debug, Clone)]
pub(super) struct Point {
    /// z, then b/s.
    z: Vec<f64>,
    /// Φ; infinite where the simulation failed.
    pub(super) phi: f64,
    residual: Vec<f64>,
    pub(super) slope: Col<f64>,
}

/// The descent of one sample.
#[derive(Debug, Clone)]
pub(super) struct Descent {
    at: Point,
    /// B; none before it is asked for.
    curvature: Option<Mat<f64>>,
    /// Steps since it was 1 + JᵀJ.
    age: usize,
    /// How many of the readings that come next J is wanted of, and what there is of it.
    coming: (usize, Mat<f64>),
    damping: f64,
    steps: usize,
    ending: Option<Ending>,
}

/// Where a descent begins.
pub(super) struct Start {
    z: Vec<f64>,
    /// B with its age, where fewer readings have made it.
    known: Option<(Mat<f64>, usize)>,
    /// How many readings' J is wanted beyond those that are compared, and what there is of it.
    coming: (usize, Mat<f64>),
}

impl Start {
    /// At z, then b/s, with nothing known of the curvature there.
    pub(super) fn at(z: Vec<f64>) -> Self {
        Self { z, known: None, coming: (0, Mat::new()) }
    }

    /// The same, with J also of so many readings that come next.
    pub(super) fn with_coming(self, readings: usize) -> Self {
        Self { coming: (readings, Mat::new()), ..self }
    }

    /// Where a descent has ended, with so many readings more.
    pub(super) fn onward(descent: Descent, readings: usize) -> Self {
        let Descent { at, curvature, age, coming: (wanted, coming), .. } = descent;
        let z = at.z;
        match curvature {
            Some(curvature) if readings <= coming.nrows() => {
                let (new, rest) = coming.split_at_row(readings);
                let known = Some((curvature + new.transpose() * new, age));
                Self { z, known, coming: (wanted, rest.to_owned()) }
            }
            _ => Self::at(z).with_coming(wanted),
        }
    }
}

/// Descends, from a start each, to the first n instants of readings (T, channels) of samples; `None` if it is not to go on.
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
        let mut looks = Looks { model, prior, noise, readings, n, counters };
        let mut begun: Vec<Start> = starts.by_ref().take(readings.len()).collect();
        let at = begun.iter_mut().map(|start| std::mem::take(&mut start.z)).enumerate().collect();
        let mut descents: Vec<Descent> =
            looks.at(at).into_iter().zip(begun).map(|(at, start)| Descent::new(at, start)).collect();
        for _ in 0..LOOKS {
            if !go_on() {
                return None;
            }
            descents.iter_mut().for_each(|descent| looks.curve(descent));
            let ahead = |(i, descent): (usize, &mut Descent)| Some((i, descent.ahead()?));
            let ahead: Vec<(usize, Vec<f64>)> =
                model.pool().install(|| descents.par_iter_mut().enumerate().filter_map(ahead).collect());
            if ahead.is_empty() {
                break;
            }
            let which: Vec<usize> = ahead.iter().map(|(i, _)| *i).collect();
            which.into_iter().zip(looks.at(ahead)).for_each(|(i, point)| descents[i].go(point));
        }
        // one that has spent its looks may just have let go of its B
        descents.iter_mut().for_each(|descent| looks.curve(descent));
        all.extend(descents);
    }
    Some(all)
}

/// What is looked at.
pub(super) struct Looks<'a> {
    pub(super) model: &'a Model<'a>,
    pub(super) prior: &'a Prior,
    pub(super) noise: &'a Noise,
    pub(super) readings: &'a [&'a [f64]],
    pub(super) n: usize,
    pub(super) counters: &'a mut Counters,
}

impl Looks<'_> {
    /// Φ and its slope for samples of the readings, by number, each at a z.
    pub(super) fn at(&mut self, at: Vec<(usize, Vec<f64>)>) -> Vec<Point> {
        let Self { model, prior, noise, readings, n, .. } = self;
        let (c, unknowns) = (noise.channels(), prior.unknowns());
        let len = *n * c;
        let histories = prior.forces(at.iter().map(|(_, z)| z.as_slice()));
        let (found, signals) = model.simulate(&histories, *n, self.counters);
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
        let pushed = model.push(&found, cotangent, self.counters);
        let one = pushed.len() / at.len();
        let finer = (one / histories.panels - 1) / (model.instants_of(&histories, *n));
        let pushed = pushed.chunks_exact(one);
        let points = at.into_iter().zip(residuals).zip(biases).zip(pushed).zip(&found.outcomes);
        points
            .map(|(((((_, z), residual), biases), pushed), outcome)| {
                let phi = 0.5 * residual.iter().chain(&z).map(|x| x * x).sum::<f64>();
                let slope: Vec<f64> = prior.along(pushed, finer).into_iter().chain(biases).collect();
                let slope = Col::from_fn(z.len(), |k| slope[k] - z[k]);
                let phi = if *outcome == Outcome::Ok { phi } else { f64::INFINITY };
                Point { z, phi, residual, slope }
            })
            .collect()
    }

    /// B where there is none.
    fn curve(&mut self, descent: &mut Descent) {
        if descent.curvature.is_some() || descent.ending.is_some() {
            return;
        }
        let Self { model, prior, noise, n, .. } = self;
        let (unknowns, c) = (prior.unknowns(), noise.channels());
        let (len, all) = (descent.at.residual.len(), descent.at.z.len());
        let (histories, steps) = prior.around(&descent.at.z);
        let farther = model.within(*n + descent.coming.0 / c);
        let found = model.coarse(&histories, farther, self.counters);
        let one = farther * c;
        let jacobian = Mat::from_fn(one, all, |i, k| match k < unknowns {
            true => (found[(1 + k) * one + i] - found[i]) / (steps[k] * noise.white[i % c]),
            false if k - unknowns == i % c => noise.bias[i % c] / noise.white[i % c],
            false => 0.0,
        });
        let (jacobian, coming) = jacobian.split_at_row(len);
        let curvature = jacobian.transpose() * jacobian + Mat::<f64>::identity(all, all);
        (descent.curvature, descent.age) = (Some(curvature), 0);
        descent.coming.1 = coming.to_owned();
    }
}

impl Descent {
    fn new(at: Point, Start { known, coming, .. }: Start) -> Self {
        let ending = at.phi.is_infinite().then_some(Ending::StartFailed);
        let (curvature, age) = known.unzip();
        Self { at, curvature, age: age.unwrap_or(0), coming, damping: 0.0, steps: 0, ending }
    }

    /// z, then b/s.
    pub(super) fn z(&self) -> &[f64] {
        &self.at.z
    }

    pub(super) fn phi(&self) -> f64 {
        self.at.phi
    }

    /// −ln of what the readings' likelihood comes to over all forces that the prior holds, by Laplace: Φ + ½ ln |B|.
    pub(super) fn surprise(&self) -> f64 {
        self.at.phi + half_log(self.curvature().as_ref(), LEAST)
    }

    /// B; where no reading could be compared the prior's, 1.
    pub(super) fn curvature(&self) -> Mat<f64> {
        let all = self.at.z.len();
        self.curvature.clone().unwrap_or_else(|| Mat::identity(all, all))
    }

    pub(super) fn steps(&self) -> usize {
        self.steps
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

    /// Where to look next; `None` if it is over.
    fn ahead(&mut self) -> Option<Vec<f64>> {
        if self.ending.is_some() {
            return None;
        }
        let (mut curvature, slope) = (self.curvature.clone()?, &self.at.slope);
        (0..curvature.nrows()).for_each(|k| curvature[(k, k)] += self.damping);
        let Some(step) = solved(curvature.as_ref(), LEAST, slope.as_mat()) else {
            self.ending = Some(Ending::NoProgress);
            return None;
        };
        let step = step.col(0);
        let enough = ENOUGH * self.misfit().max(1.0);
        if 0.5 * (slope.transpose() * step) < enough && self.damping == 0.0 {
            self.ending = Some(Ending::Converged);
            return None;
        }
        Some(self.at.z.iter().zip(step.iter()).map(|(z, step)| z + step).collect())
    }

    /// Goes there if that is lower, and learns from it (Broyden, Fletcher, Goldfarb and Shanno; Nocedal and Wright, Numerical
    /// Optimization, §6.1). If not, steps are damped, at last by another B.
    fn go(&mut self, to: Point) {
        let curvature = self.curvature.as_mut().expect("made before");
        if to.phi >= self.at.phi {
            self.damping = (DAMPING * self.damping).max(DAMPED);
            if self.damping > HELD {
                match self.age {
                    0 => self.ending = Some(Ending::NoProgress),
                    _ => (self.curvature, self.damping) = (None, 0.0),
                }
            }
            return;
        }
        let step = Col::from_fn(to.z.len(), |k| to.z[k] - self.at.z[k]);
        let turned = &self.at.slope - &to.slope;
        let (along, pulled) = (turned.transpose() * &step, &*curvature * &step);
        let square = step.transpose() * &pulled;
        // Φ may be hollow between the two
        if along > 1e-3 * square {
            *curvature += &turned * turned.transpose() * Scale(1.0 / along);
            *curvature -= &pulled * pulled.transpose() * Scale(1.0 / square);
        }
        self.damping = if self.damping > DAMPED { self.damping / DAMPING } else { 0.0 };
        (self.at, self.age, self.steps) = (to, self.age + 1, self.steps + 1);
        if self.age >= OLD {
            self.curvature = None;
        }
    }
}
