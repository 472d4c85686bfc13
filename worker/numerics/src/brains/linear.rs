//! The linear brain: least squares of the forces on the signals around each instant, solved exactly.
//!
//! ```text
//! x = A / rms(A₀)     y = f / rms(f)     w_i = 1/Σy²     λ: by cross-validation (`ridge`)
//! ```

use super::ridge::{self, Part};
use super::{FitOn, Implicit, Learned, Learner, Learnt, Loss};
use crate::Pool;
use crate::brain::linear::{self, Lags, Linear, Moments, Normal, Order, Sizes};
use crate::trial::{
    Counters, Decoder, Ridge, Samples, Scales, Trial, Trouble, error_of_each, mean_error, pick,
};

/// Unknowns of the longest memory that a body is read with: 0.7 GB and some 5 s a factor.
const UNKNOWNS_MAX: usize = 9600;
/// Bodies on whose batches a learner fits, the present one among them …
const BODIES: usize = 8;
/// … each older one counting less by this factor: the body has moved since.
const FADING: f64 = 0.8;
/// Step of the first new choice of λ.
const FIRST_CHOICE: u32 = 10;

impl Decoder {
    /// Of the whole sample, both ways, or as much of it as can be solved for: what every body is read by.
    pub fn whole(instants: usize, channels: usize) -> Self {
        let both = |reach| Lags { before: reach, after: reach };
        let solvable = |lags: &Lags| lags.groups().len() * channels <= UNKNOWNS_MAX;
        let lags = (0..instants).rev().map(both).find(solvable).unwrap_or(both(0));
        Self { lags, ridge: Ridge::Auto }
    }
}

/// Samples as a linear brain takes them.
#[derive(Debug, Clone)]
pub(crate) struct Plain {
    pub(crate) sizes: Sizes,
    /// x (N, T, 3M).
    pub(crate) x: Vec<f64>,
    /// y (N, T, K).
    pub(crate) y: Vec<f64>,
    /// w (N); 0 without force.
    pub(crate) w: Vec<f64>,
    /// Whether a sample's simulation failed (N).
    pub(crate) failed: Vec<bool>,
    /// Counts what is done with them.
    pub(crate) pool: Pool,
}

impl Plain {
    /// Signals and forces at these scales.
    pub(crate) fn of(samples: &Samples, scales: &Scales, pool: &Pool) -> Self {
        let (sizes, x, scale) = (samples.sizes, scales.inputs(&samples.signals), scales.force());
        let y: Vec<f64> = samples.targets.iter().map(|f| f / scale).collect();
        let power = |sample: &[f64]| sample.iter().map(|f| f * f).sum::<f64>();
        let weight = |power: f64| if power > 0.0 { power.recip() } else { 0.0 };
        let w = y.chunks_exact(sizes.instants * sizes.outputs).map(|sample| weight(power(sample))).collect();
        Self { sizes, x, y, w, failed: samples.failed.clone(), pool: pool.clone() }
    }

    /// Their moments.
    pub(crate) fn moments(&self) -> Moments {
        let mut moments = Moments::new(self.sizes, &self.pool);
        moments.add(&self.x, &self.y, &self.w);
        moments
    }

    /// These samples, in this order.
    pub(crate) fn select(&self, samples: &[usize]) -> Self {
        let [x, y, w] = [&self.x, &self.y, &self.w].map(|values| pick(values, self.w.len(), samples));
        let failed = pick(&self.failed, self.w.len(), samples);
        Self { sizes: self.sizes, x, y, w, failed, pool: self.pool.clone() }
    }

    /// Error (%) of each sample by these predictions (N, T, K).
    pub(crate) fn errors(&self, predicted: &[f64]) -> Vec<Option<f64>> {
        error_of_each(self.sizes, &self.y, &self.failed, predicted)
    }

    /// Their mean.
    pub(crate) fn error(&self, predicted: &[f64]) -> Option<f64> {
        mean_error(&self.errors(predicted))
    }

    /// 2w (ŷ − y)/n of the n samples that have an error: the derivative of its mean, as a part of 1, in the answers.
    pub(crate) fn residual(&self, predicted: &[f64]) -> Vec<f64> {
        let total = self.w.iter().zip(&self.failed).filter(|(w, failed)| **w > 0.0 || **failed).count();
        self.residual_over(total, predicted)
    }

    /// The same of the n samples that a fit is a mean over: those with a force.
    fn fitted_residual(&self, predicted: &[f64]) -> Vec<f64> {
        self.residual_over(self.w.iter().filter(|w| **w > 0.0).count(), predicted)
    }

    fn residual_over(&self, total: usize, predicted: &[f64]) -> Vec<f64> {
        let total = total as f64;
        let one = self.sizes.instants * self.sizes.outputs;
        let mut residual = Vec::with_capacity(predicted.len());
        for ((p, y), w) in predicted.chunks_exact(one).zip(self.y.chunks_exact(one)).zip(&self.w) {
            residual.extend(p.iter().zip(y).map(|(p, y)| 2.0 * w / total * (p - y)));
        }
        residual
    }
}

/// The weights of a fit, or its trouble.
pub(crate) fn solve(normal: Normal, ridge: f64) -> Result<linear::Fit, Trouble> {
    linear::Fit::new(normal, ridge, Order::Ascending).map_err(|_| Trouble::Singular)
}

impl Decoder {
    /// λ for these training samples, of which `all` are the normal equations: as given, or by cross-validation.
    ///
    /// # Errors
    /// If no λ has a solution.
    pub(super) fn ridge_of(&self, seed: u64, train: &Plain, all: &Normal) -> Result<f64, Trouble> {
        match self.ridge {
            Ridge::Given(ridge) => Ok(ridge),
            Ridge::Auto => ridge::ridge_of(train, all, &ridge::deal(seed, train.w.len())),
        }
    }
}

impl Trial<'_> {
    /// λ of the trial's linear decoder for the initial body's training samples.
    ///
    /// # Errors
    /// If no λ has a solution.
    fn initial_ridge(&self) -> Result<f64, Trouble> {
        let choose = || {
            let (decoder, plain) = (self.problem.decoder, Plain::of(&self.initial, &self.scales, self.pool));
            decoder.ridge_of(self.problem.seed, &plain, &plain.moments().normal(decoder.lags))
        };
        *self.initial_ridge.get_or_init(choose)
    }

    /// λ of a linear decoder for the training samples of a body.
    ///
    /// # Errors
    /// If no λ has a solution.
    pub(super) fn ridge_for(
        &self,
        decoder: &Decoder,
        known: &Samples,
        plain: &Plain,
        all: &Normal,
    ) -> Result<f64, Trouble> {
        match *decoder == self.problem.decoder && *known == self.initial {
            true => self.initial_ridge(),
            false => decoder.ridge_of(self.problem.seed, plain, all),
        }
    }
}

/// A linear brain that trains a body: no fit takes up where another ended.
pub(super) struct LinearLearner<'a> {
    trial: &'a Trial<'a>,
    /// That of this step, and its factor where it may be asked how it would change.
    linear: Option<(Linear, Option<linear::Fit>)>,
    /// Memory for the moments of a step.
    moments: Option<Moments>,
}

/// Whether λ is chosen anew at this step: at 10, 20, 40, 80, …, as a body changes most at first.
fn is_due(step: u32) -> bool {
    step > 0 && step.is_multiple_of(FIRST_CHOICE) && (step / FIRST_CHOICE).is_power_of_two()
}

impl<'a> LinearLearner<'a> {
    pub(super) fn new(trial: &'a Trial<'a>) -> Self {
        Self { trial, linear: None, moments: None }
    }

    fn plain(&self, samples: &Samples) -> Plain {
        Plain::of(samples, &self.trial.scales, self.trial.pool)
    }

    fn linear(&self) -> &Linear {
        &self.linear.as_ref().expect("it has been fitted").0
    }

    /// λ of these training samples, chosen anew where that is due.
    fn ridge_at(&self, step: u32, train: &Plain, all: &Normal, learnt: &mut Learnt) -> Result<f64, Trouble> {
        match learnt.ridge {
            Some(ridge) if !is_due(step) => Ok(ridge),
            _ => {
                let problem = &self.trial.problem;
                Ok(*learnt.ridge.insert(problem.decoder.ridge_of(problem.seed, train, all)?))
            }
        }
    }

    /// λ of the initial body's training samples: those of a single cast are too few for a choice.
    fn first_ridge(&self, learnt: &mut Learnt) -> Result<f64, Trouble> {
        match learnt.ridge {
            Some(ridge) => Ok(ridge),
            None => Ok(*learnt.ridge.insert(self.trial.initial_ridge()?)),
        }
    }

    /// The weights for the samples of the last bodies, older ones counting less. Where λ is due it is the one by which the
    /// other bodies read the newest best.
    fn solve_recent(&mut self, bodies: &[Plain], step: u32, learnt: &mut Learnt) -> Result<Linear, Trouble> {
        let (trial, lags) = (self.trial, self.trial.problem.decoder.lags);
        let newest = bodies.len() - 1;
        let weighted = |body: usize| -> Vec<f64> {
            let fading = FADING.powi((newest - body) as i32);
            bodies[body].w.iter().map(|w| w * fading).collect()
        };
        let moments = self.moments.get_or_insert_with(|| Moments::new(bodies[newest].sizes, trial.pool));
        moments.clear();
        for (body, samples) in bodies.iter().enumerate() {
            moments.add(&samples.x, &samples.y, &weighted(body));
        }
        let normal = moments.normal(lags);
        self.first_ridge(learnt)?;
        if newest > 0 && is_due(step) && trial.problem.decoder.ridge == Ridge::Auto {
            let judges = bodies[newest].clone();
            let others = normal.clone().plus(-1.0, &judges.moments().normal(lags));
            let part = std::iter::once(Part { judges, others });
            let judged = ridge::judged(ridge::ridges(), true, part, Part::errors_of_others);
            learnt.ridge = ridge::least(&judged).ok().or(learnt.ridge);
        }
        Ok(solve(normal, learnt.ridge.unwrap_or_default())?.linear())
    }
}

impl Learner for LinearLearner<'_> {
    fn bodies(&self) -> usize {
        BODIES
    }

    fn recalls(&self, _: u32) -> bool {
        true
    }

    fn fit(
        &mut self,
        on: FitOn,
        step: u32,
        learnt: &mut Learnt,
        _: &mut Counters,
    ) -> Result<Learned, Trouble> {
        let judged = match on {
            FitOn::Recent(bodies) => {
                let mut bodies: Vec<Plain> = bodies.iter().map(|samples| self.plain(samples)).collect();
                self.linear = Some((self.solve_recent(&bodies, step, learnt)?, None));
                bodies.pop().expect("the newest")
            }
            FitOn::Optimum(train) | FitOn::Alike(train) | FitOn::Cast(train) => {
                let train = self.plain(train);
                let all = train.moments().normal(self.trial.problem.decoder.lags);
                let ridge = match on {
                    FitOn::Cast(_) => self.first_ridge(learnt)?,
                    _ => self.ridge_at(step, &train, &all, learnt)?,
                };
                let fit = solve(all, ridge)?;
                self.linear = Some((fit.linear(), matches!(on, FitOn::Optimum(_)).then_some(fit)));
                train
            }
        };
        let error = judged.error(&self.linear().predict(&judged.x));
        // what is no number stays none
        Ok(Learned { loss: error.map_or(f64::NAN, |error| 0.01 * error), error })
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
        let inputs = through_weights(&train, linear, &linear.predict(&train.x), &z);
        (self.trial.scales.inputs_vjp(&inputs), None)
    }

    fn error(&mut self, samples: &Samples) -> Option<f64> {
        let samples = self.plain(samples);
        samples.error(&self.linear().predict(&samples.x))
    }
}

/// Cotangent on the training inputs through the weights, which answer a force on them by −`z`.
///
/// ∂L_train/∂W = 2 Σ ŵ φ (ŷ − y) + 2λW stays zero as x moves: dL = −⟨z, d(∂L_train/∂W)⟩.
fn through_weights(samples: &Plain, linear: &Linear, said: &[f64], z: &Linear) -> Vec<f64> {
    let residual = samples.fitted_residual(said);
    // 2ŵ of z's own answers
    let answers = z.predict(&samples.x);
    let zero = Plain { y: vec![0.0; samples.y.len()], ..samples.clone() };
    let mut inputs = z.predict_vjp(&residual);
    let more = linear.predict_vjp(&zero.fitted_residual(&answers));
    inputs.iter_mut().zip(more).for_each(|(a, b)| *a = -(*a + b));
    inputs
}
