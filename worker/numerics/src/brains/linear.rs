//! The linear decoder: least squares of the forces on the signals around each instant, solved exactly.
//!
//! ```text
//! x = A / rms(A₀)     y = f / rms(f)     w_i = 1/Σy²     λ: by cross-validation (`ridge`)
//! ```

use super::crossed::{self, CrossValidation};
use super::ridge;
use super::{DecoderState, FitOn, FitResult, Implicit, Learner, Loss};
use crate::Pool;
use crate::brain::linear::{self, Lags, Linear, Normal, Order, Sizes};
use crate::stimuli::members;
use crate::trial::{
    Counters, Decoder, PreparedTrial, RidgeChoice, Samples, Scales, Trouble, error_of_each, mean_error, pick,
};
use std::ops::Range;

/// Largest number of unknowns of the longest memory: 0.7 GB and about 5 s per factorisation.
const UNKNOWNS_MAX: usize = 9600;
/// Bodies whose batches a learner is fitted to, including the current one.
const BODIES: usize = 5;
/// Relative weight of each older body, since the body has changed.
const FADING: f64 = 0.4;
/// First step at which λ is chosen again, in `paper` and `random`.
const FIRST_CHOICE: u32 = 10;

impl Decoder {
    /// The longest memory, up to the whole sample in both directions, that can be solved; every body is decoded with it.
    pub fn whole(instants: usize, channels: usize) -> Self {
        let both = |reach| Lags { before: reach, after: reach };
        let solvable = |lags: &Lags| lags.unknowns(channels) <= UNKNOWNS_MAX;
        let lags = (0..instants).rev().map(both).find(solvable).unwrap_or(both(0));
        Self { lags, ridge: RidgeChoice::Auto }
    }
}

/// Scaled samples for linear decoders.
#[derive(Debug, Clone)]
pub(crate) struct ScaledSamples {
    pub(crate) sizes: Sizes,
    /// Signals x (N, T, 3M).
    pub(crate) x: Vec<f64>,
    /// Forces y (N, T, K).
    pub(crate) y: Vec<f64>,
    /// Weights w (N); 0 without force.
    pub(crate) w: Vec<f64>,
    /// Whether a sample's simulation failed (N).
    pub(crate) failed: Vec<bool>,
    /// Threads, with counters.
    pub(crate) pool: Pool,
}

impl ScaledSamples {
    /// Scales signals and forces.
    pub(crate) fn of(samples: &Samples, scales: &Scales, pool: &Pool) -> Self {
        let (sizes, x, scale) = (samples.sizes, scales.inputs(&samples.signals), scales.force());
        let y: Vec<f64> = samples.targets.iter().map(|f| f / scale).collect();
        let power = |sample: &[f64]| sample.iter().map(|f| f * f).sum::<f64>();
        let weight = |power: f64| if power > 0.0 { power.recip() } else { 0.0 };
        let w = y.chunks_exact(sizes.instants * sizes.outputs).map(|sample| weight(power(sample))).collect();
        Self { sizes, x, y, w, failed: samples.failed.clone(), pool: pool.clone() }
    }

    /// Normal equations of a memory.
    pub(crate) fn normal(&self, lags: Lags) -> Normal {
        self.normal_of(lags, lags.groups())
    }

    /// Normal equations of a memory with these groups of lags that share a weight.
    pub(super) fn normal_of(&self, lags: Lags, groups: Vec<Range<usize>>) -> Normal {
        Normal::new(self.sizes, [&self.x, &self.y, &self.w], lags, groups, &self.pool)
    }

    /// Selects samples in this order.
    pub(crate) fn select(&self, samples: &[usize]) -> Self {
        let [x, y, w] = [&self.x, &self.y, &self.w].map(|values| pick(values, self.w.len(), samples));
        let failed = pick(&self.failed, self.w.len(), samples);
        Self { sizes: self.sizes, x, y, w, failed, pool: self.pool.clone() }
    }

    /// Error (%) of each sample for estimates (N, T, K).
    pub(crate) fn errors(&self, predicted: &[f64]) -> Vec<Option<f64>> {
        error_of_each(self.sizes, &self.y, &self.failed, predicted)
    }

    /// Mean error (%).
    pub(crate) fn error(&self, predicted: &[f64]) -> Option<f64> {
        mean_error(&self.errors(predicted))
    }

    /// 2w (ŷ − y)/n for the n samples that have an error: derivative of the mean error (as a fraction) in the estimates.
    pub(crate) fn residual(&self, predicted: &[f64]) -> Vec<f64> {
        let total = self.w.iter().zip(&self.failed).filter(|(w, failed)| **w > 0.0 || **failed).count();
        self.divided_residual(&vec![total as f64; self.w.len()], predicted)
    }

    /// As `residual`, with n the number of samples with a force, over which a fit averages.
    fn fitted_residual(&self, predicted: &[f64]) -> Vec<f64> {
        let total = self.w.iter().filter(|w| **w > 0.0).count() as f64;
        self.divided_residual(&vec![total; self.w.len()], predicted)
    }

    /// 2w (ŷ − y)/d: derivative of Σ e/d in the estimates, with e the error of a sample (as a fraction) and d its divisor.
    pub(super) fn divided_residual(&self, divisors: &[f64], predicted: &[f64]) -> Vec<f64> {
        let one = self.sizes.instants * self.sizes.outputs;
        let mut residual = Vec::with_capacity(predicted.len());
        let samples = predicted.chunks_exact(one).zip(self.y.chunks_exact(one));
        for ((p, y), (w, d)) in samples.zip(self.w.iter().zip(divisors)) {
            residual.extend(p.iter().zip(y).map(|(p, y)| 2.0 * w / d * (p - y)));
        }
        residual
    }
}

/// Solves the normal equations.
pub(crate) fn solve(normal: Normal, ridge: f64) -> Result<linear::FactoredEquations, Trouble> {
    linear::FactoredEquations::new(normal, ridge, Order::Ascending).map_err(|_| Trouble::Singular)
}

impl Decoder {
    /// λ for these training samples with normal equations `all`: as given, or by cross-validation.
    ///
    /// # Errors
    /// If no λ gives a solution.
    pub(super) fn ridge_of(&self, seed: u64, train: &ScaledSamples, all: &Normal) -> Result<f64, Trouble> {
        match self.ridge {
            RidgeChoice::Given(ridge) => Ok(ridge),
            RidgeChoice::Auto => ridge::ridge_of(train, all, &ridge::assign_folds(seed, train.w.len())),
        }
    }
}

impl PreparedTrial<'_> {
    /// λ of the trial's linear decoder on the initial body's training samples.
    ///
    /// # Errors
    /// If no λ gives a solution.
    fn initial_ridge(&self) -> Result<f64, Trouble> {
        let choose = || {
            let (decoder, plain) =
                (self.problem.decoder, ScaledSamples::of(&self.initial, &self.scales, self.pool));
            decoder.ridge_of(self.problem.seed, &plain, &plain.normal(decoder.lags))
        };
        *self.initial_ridge.get_or_init(choose)
    }

    /// λ of a linear decoder for the training samples of a body.
    ///
    /// # Errors
    /// If no λ gives a solution.
    pub(super) fn ridge_for(
        &self,
        decoder: &Decoder,
        known: &Samples,
        plain: &ScaledSamples,
        all: &Normal,
    ) -> Result<f64, Trouble> {
        match *decoder == self.problem.decoder && *known == self.initial {
            true => self.initial_ridge(),
            false => decoder.ridge_of(self.problem.seed, plain, all),
        }
    }
}

/// A linear decoder that trains a body; each fit is independent of the last.
pub(super) struct LinearLearner<'a> {
    trial: &'a PreparedTrial<'a>,
    /// Decoder of this step, and its factorisation if the implicit term needs it.
    linear: Option<(Linear, Option<linear::FactoredEquations>)>,
    /// Recent bodies' samples, with their normal equations.
    known: Vec<(Samples, Normal)>,
    /// The newest body's samples, decoded without them.
    crossed: Option<CrossValidation>,
}

/// Whether λ is chosen again at this step: at 10, 20, 40, 80, …, since bodies change most at first.
fn is_due(step: u32) -> bool {
    step > 0 && step.is_multiple_of(FIRST_CHOICE) && (step / FIRST_CHOICE).is_power_of_two()
}

impl<'a> LinearLearner<'a> {
    pub(super) fn new(trial: &'a PreparedTrial<'a>) -> Self {
        Self { trial, linear: None, known: Vec::new(), crossed: None }
    }

    fn plain(&self, samples: &Samples) -> ScaledSamples {
        ScaledSamples::of(samples, &self.trial.scales, self.trial.pool)
    }

    fn linear(&self) -> &Linear {
        &self.linear.as_ref().expect("it has been fitted").0
    }

    /// λ for these training samples, chosen again when due.
    fn ridge_at(
        &self,
        step: u32,
        train: &ScaledSamples,
        all: &Normal,
        learnt: &mut DecoderState,
    ) -> Result<f64, Trouble> {
        match learnt.ridge {
            Some(ridge) if !is_due(step) => Ok(ridge),
            _ => {
                let problem = &self.trial.problem;
                Ok(*learnt.ridge.insert(problem.decoder.ridge_of(problem.seed, train, all)?))
            }
        }
    }

    /// λ of the initial body's training samples: a single cast has too few samples for a choice.
    fn first_ridge(&self, learnt: &mut DecoderState) -> Result<f64, Trouble> {
        match learnt.ridge {
            Some(ridge) => Ok(ridge),
            None => Ok(*learnt.ridge.insert(self.trial.initial_ridge()?)),
        }
    }

    /// Fits the samples of the last bodies, oldest first, with smaller weights for older ones, and cross-validates the fit on the
    /// newest body. λ moves along the gradient of the cross-validated error. Returns the training error on the newest body (%) and
    /// the λ of the fit.
    fn fit_recent(
        &mut self,
        bodies: &[&Samples],
        casts: usize,
        learnt: &mut DecoderState,
    ) -> Result<(Option<f64>, f64), Trouble> {
        let problem = &self.trial.problem;
        let ridge = self.first_ridge(learnt)?;
        let (newest, earlier) = bodies.split_last().expect("the newest");
        let mut known = std::mem::take(&mut self.known);
        let mut equations = Vec::with_capacity(bodies.len());
        for body in earlier {
            equations.push(match known.iter().position(|(samples, _)| samples == *body) {
                Some(at) => known.swap_remove(at).1,
                None => sum(&self.equations(body).2),
            });
        }
        let (samples, members, parts) = self.equations(newest);
        let mut all = sum(&parts);
        equations.push(all.clone());
        for (normal, age) in equations.iter().rev().zip(0..).skip(1) {
            all = all.plus(FADING.powi(age), normal);
        }
        self.known = bodies.iter().map(|body| (*body).clone()).zip(equations).collect();

        let crossed = CrossValidation::new(samples, casts, members, &parts, &all, ridge)?;
        if problem.decoder.ridge == RidgeChoice::Auto {
            learnt.ridge = Some(crossed.next_ridge());
        }
        let linear = solve(all, ridge)?.linear();
        let error = crossed.samples.error(&linear.predict(&crossed.samples.x));
        (self.linear, self.crossed) = (Some((linear, None)), Some(crossed));
        Ok((error, ridge))
    }

    /// Scaled samples of a body, and the numbers and normal equations of each fold's samples.
    fn equations(&self, body: &Samples) -> (ScaledSamples, Vec<Vec<usize>>, Vec<Normal>) {
        let (samples, problem) = (self.plain(body), &self.trial.problem);
        let members = members(&ridge::assign_folds(problem.seed, samples.w.len()));
        let parts = crossed::fold_equations(&samples, &members, problem.decoder.lags);
        (samples, members, parts)
    }
}

/// The sum of normal equations.
fn sum(parts: &[Normal]) -> Normal {
    let (first, others) = parts.split_first().expect("a fold");
    others.iter().fold(first.clone(), |sum, part| sum.plus(1.0, part))
}

impl Learner for LinearLearner<'_> {
    fn bodies(&self) -> usize {
        BODIES
    }

    fn includes_age(&self, _: u32) -> bool {
        true
    }

    fn fit(
        &mut self,
        on: FitOn,
        step: u32,
        learnt: &mut DecoderState,
        _: &mut Counters,
    ) -> Result<FitResult, Trouble> {
        let (error, ridge) = match on {
            FitOn::Recent(bodies, casts) => self.fit_recent(bodies, casts, learnt)?,
            FitOn::Optimum(train) | FitOn::Alike(train) => {
                let train = self.plain(train);
                let all = train.normal(self.trial.problem.decoder.lags);
                let ridge = self.ridge_at(step, &train, &all, learnt)?;
                let fit = solve(all, ridge)?;
                self.linear = Some((fit.linear(), matches!(on, FitOn::Optimum(_)).then_some(fit)));
                (train.error(&self.linear().predict(&train.x)), ridge)
            }
        };
        // Without an error, the loss is NaN.
        Ok(FitResult { loss: error.map_or(f64::NAN, |error| 0.01 * error), error, ridge: Some(ridge) })
    }

    fn casts_vjp(&mut self, casts: &[&Samples], weigh: &dyn Fn(&[Option<f64>]) -> Vec<f64>) -> Vec<Vec<f64>> {
        let crossed = self.crossed.take().expect("it has been fitted");
        let signals = crossed.vjp(&weigh(&crossed.error_of_casts()));
        let cotangent = self.trial.scales.inputs_vjp(&signals);
        cotangent.chunks_exact(cotangent.len() / casts.len()).map(<[f64]>::to_vec).collect()
    }

    fn loss_vjp(&mut self, samples: &Samples, _: Loss) -> (Option<f64>, Vec<f64>) {
        let (samples, linear) = (self.plain(samples), self.linear());
        let residual = samples.residual(&linear.predict(&samples.x));
        (None, self.trial.scales.inputs_vjp(&linear.predict_vjp(&residual)))
    }

    fn implicit(
        &mut self,
        train: &Samples,
        test: &Samples,
        _: &mut Counters,
    ) -> (Vec<f64>, Option<Implicit>) {
        let [train, test] = [train, test].map(|samples| self.plain(samples));
        let (linear, fit) = self.linear.as_ref().expect("it has been fitted");
        let residual = test.residual(&linear.predict(&test.x));
        let z = fit.as_ref().expect("to its optimum").sensitivity(&linear.weights_vjp(&test.x, &residual));
        let direct = vec![0.0; train.y.len()];
        let inputs = through_weights(&train, linear, &linear.predict(&train.x), &z, &direct);
        (self.trial.scales.inputs_vjp(&inputs), None)
    }

    fn error(&mut self, samples: &Samples) -> Option<f64> {
        let samples = self.plain(samples);
        samples.error(&self.linear().predict(&samples.x))
    }
}

/// Cotangent on the training inputs: of `direct` on their estimates, and through the fitted weights; z is the solution of
/// H z = ∂L/∂W.
///
/// ∂L_train/∂W = 2 Σ ŵ φ (ŷ − y) + 2λW stays zero when x changes: dL = −⟨z, d(∂L_train/∂W)⟩.
pub(super) fn through_weights(
    samples: &ScaledSamples,
    linear: &Linear,
    estimates: &[f64],
    z: &Linear,
    direct: &[f64],
) -> Vec<f64> {
    // Estimates with the weights z.
    let answers = z.predict(&samples.x);
    let zero = ScaledSamples { y: vec![0.0; samples.y.len()], ..samples.clone() };
    let on_estimates: Vec<f64> =
        direct.iter().zip(zero.fitted_residual(&answers)).map(|(direct, x)| direct - x).collect();
    let mut inputs = linear.predict_vjp(&on_estimates);
    let of_residual = z.predict_vjp(&samples.fitted_residual(estimates));
    inputs.iter_mut().zip(of_residual).for_each(|(a, b)| *a -= b);
    inputs
}
