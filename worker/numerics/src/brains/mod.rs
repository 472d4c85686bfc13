//! Decoders, which estimate forces from a body's signals, and their use to train bodies.
//!
//! A [`FittedDecoder`] is fitted to the training samples of one body and decodes its other samples. A [`Learner`] is fitted to one body
//! after another and returns gradients on the signals. A new decoder is a file here that implements either or both, and an arm in
//! the functions `new_decoder` and `learner`.

mod bands;
mod crossed;
mod fitted;
mod implicit;
mod inverse;
mod linear;
mod network;
mod readings;
mod readout;
mod records;
pub(crate) mod ridge;
mod stacked;
mod tasks;

pub use bands::{Band, BandKind, LEVEL, Z_95};
pub use fitted::Fitted;
pub(crate) use fitted::Pooled;
pub use inverse::{Estimate, Inverse};
pub(crate) use linear::ScaledSamples;
#[cfg(test)]
pub(crate) use linear::solve;
pub use network::NetworkTraining;
pub use readings::{READINGS_MAX, Reading, fits};
pub(crate) use readings::{own_reading, readings};
pub use records::{HeldOutEstimates, records};
#[cfg(test)]
pub(crate) use stacked::Stack;
pub use stacked::predict_on;
pub use tasks::{
    Calibration, Labeller, Labels, RECORDS_MIN, Readout, ReadoutWeights, SensingTask, TaskEstimate,
    TaskReadouts, Tasks,
};
pub(crate) use tasks::{task_errors, task_estimates, task_readouts};

use crate::brain::{Adam, Architecture, SolveOutcome};
use crate::trial::{
    Counters, Decoder, DecoderKind, PreparedTrial, Problem, RateSchedule, Result, Samples, Scales,
};

/// How a decoder is constructed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Recipe {
    /// Kind of decoder.
    pub kind: DecoderKind,
    /// Layers of a network.
    pub architecture: Architecture,
    /// Learning rate of Adam.
    pub rate: f64,
    /// Schedule of this rate.
    pub schedule: RateSchedule,
    /// Samples per iteration; `None`: all.
    pub batch: Option<usize>,
    /// The linear decoder; in a stacked decoder, its first part.
    pub decoder: Decoder,
    /// Seed of initial weights and folds.
    pub seed: u64,
}

impl Problem {
    /// Recipe of the trial's decoder.
    pub fn recipe(&self) -> Recipe {
        Recipe {
            kind: self.decoder_kind,
            architecture: self.brain.architecture,
            rate: self.brain.rate,
            schedule: self.evaluation.schedule,
            batch: self.evaluation.batch,
            decoder: self.decoder,
            seed: self.seed,
        }
    }
}

/// A decoder for one body.
pub(crate) trait FittedDecoder {
    /// Fits the decoder. Network `number` trains for `iterations`, at least one more, and records the error on `unseen`. Returns
    /// `None` if `pauses`, called with the iterations done, is true; the same call resumes.
    fn fit(
        &mut self,
        number: u64,
        iterations: usize,
        unseen: &Samples,
        pauses: &mut dyn FnMut(usize) -> bool,
    ) -> Option<Result<()>>;

    /// Forces (N, T, K) (N) from signals (N, T, 3M) outside the training set.
    fn predict(&mut self, signals: &[f64]) -> Vec<f64>;

    /// Forces of the training samples; a stacked decoder uses out-of-fold estimates.
    fn predict_known(&mut self) -> Vec<f64>;

    /// Mean error (%) on the training samples.
    fn error_known(&mut self) -> Option<f64>;

    /// Error (%) of each of these samples.
    fn errors(&mut self, samples: &Samples) -> Vec<Option<f64>> {
        samples.errors(&self.predict(&samples.signals))
    }

    /// Network in training, or trained; `None` for decoders without stored weights.
    fn training(&mut self) -> Option<&mut Option<NetworkTraining>> {
        None
    }

    /// Training loss (normalised) per iteration, each averaged over one pass through the batches.
    fn losses(&self) -> Vec<f32> {
        Vec::new()
    }

    /// λ of a linear decoder, or of the linear part of a stacked one.
    fn ridge(&self) -> Option<f64> {
        None
    }

    /// Weights for signals at other scales; empty for decoders without weights.
    fn weights_at(&self, _: &Scales) -> Vec<f32> {
        Vec::new()
    }
}

/// Creates a decoder for training samples `known`, with the scales for a linear decoder and for a network.
///
/// # Errors
/// If the linear part of a stacked decoder has no solution.
pub(crate) fn new_decoder<'a>(
    recipe: Recipe,
    known: &'a Samples,
    scales: [Scales; 2],
    pool: &'a crate::Pool,
) -> Result<Box<dyn FittedDecoder + 'a>> {
    Ok(match recipe.kind {
        DecoderKind::Network | DecoderKind::Stacked => {
            Box::new(network::NetworkDecoder::new(recipe, known, scales, pool)?)
        }
        DecoderKind::Linear => Box::new(fitted::LinearDecoder::new(recipe, known, scales, pool)),
        DecoderKind::Inverse => unreachable!("it reads a body, by the body's model: `Inverse`"),
    })
}

/// Forces (N, T, K) (N) of all samples estimated by the trial's network with these weights. Its training set is kind 0 in `kinds`.
///
/// # Errors
/// If the linear part of a stacked decoder has no solution.
///
/// # Panics
/// If the trial's decoder has no weights, or lengths do not match.
pub fn predict_with(trial: &PreparedTrial, all: &Samples, kinds: &[u8], weights: &[f32]) -> Result<Vec<f64>> {
    let training: Vec<usize> = (0..kinds.len()).filter(|&i| kinds[i] == 0).collect();
    let known = all.select(&training);
    let scales = [trial.scales.clone(), trial.network_scales.clone()];
    let mut reader = new_decoder(trial.problem.recipe(), &known, scales, trial.pool)?;
    *reader.training().expect("a brain with weights is a network") =
        Some(NetworkTraining::of(weights.to_vec()));
    let mut predictions = reader.predict(&all.signals);
    let one = predictions.len() / kinds.len();
    for (own, sample) in reader.predict_known().chunks_exact(one).zip(training) {
        predictions[sample * one..][..one].copy_from_slice(own);
    }
    Ok(predictions)
}

/// State that a learner keeps from body to body.
#[derive(Debug, Clone, PartialEq)]
pub struct DecoderState {
    /// Weights of a network; empty before its first training.
    pub weights: Vec<f32>,
    /// State of Adam.
    pub adam: Adam<f32>,
    /// λ of a linear decoder, once chosen.
    pub ridge: Option<f64>,
}

impl DecoderState {
    /// Empty state for a network with this many weights.
    pub(crate) fn untrained(weights: usize) -> Self {
        Self { weights: Vec::new(), adam: Adam::new(weights), ridge: None }
    }
}

/// How a learner is fitted, and to which samples.
#[derive(Clone, Copy)]
pub(crate) enum FitOn<'a> {
    /// Newly, to its optimum β*(A).
    Optimum(&'a Samples),
    /// Newly, with equal initial weights and iterations for every body.
    Alike(&'a Samples),
    /// Continued, on the last bodies, the newest last, whose samples come from this many casts.
    Recent(&'a [&'a Samples], usize),
}

/// Result of a fit.
pub(crate) struct FitResult {
    /// Training loss (normalised).
    pub(crate) loss: f64,
    /// Error on the training samples, for `Recent` on the newest body (%), if known.
    pub(crate) error: Option<f64>,
    /// λ of the fit; for `Recent`, the decoder's state has the next one.
    pub(crate) ridge: Option<f64>,
}

/// Kind of loss.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Loss {
    /// The loss that training minimises.
    Training,
    /// The loss on the test set; of a network in N².
    Test,
}

/// The linear system of the implicit term.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Implicit {
    /// Conjugate-gradient iterations.
    pub iterations: usize,
    /// ‖r‖/‖b‖ at the end.
    pub residual: f64,
    /// Smallest curvature vᵀHv/vᵀv of all directions v.
    pub smallest_curvature: f64,
    /// How the solver ended.
    pub outcome: SolveOutcome,
}

/// A decoder that trains a body.
pub(crate) trait Learner {
    /// Largest number of bodies whose samples [`FitOn::Recent`] contains.
    fn bodies(&self) -> usize;

    /// Whether the body `age` steps ago is one of them.
    fn includes_age(&self, age: u32) -> bool;

    /// Fits the decoder at an outer step.
    ///
    /// # Errors
    /// If training fails.
    fn fit(
        &mut self,
        on: FitOn,
        step: u32,
        learnt: &mut DecoderState,
        counters: &mut Counters,
    ) -> Result<FitResult>;

    /// Loss at fixed weights, if defined, and its cotangent on the signals (N, T, 3M).
    fn loss_vjp(&mut self, samples: &Samples, loss: Loss) -> (Option<f64>, Vec<f64>);

    /// Σ weight · loss over the casts of the newest body, of which `weigh` gives the weights from the losses: its cotangents on
    /// their signals, at fixed weights unless the loss is cross-validated.
    fn casts_vjp(&mut self, casts: &[&Samples], weigh: &dyn Fn(&[Option<f64>]) -> Vec<f64>) -> Vec<Vec<f64>> {
        let (losses, mut cotangents): (Vec<_>, Vec<_>) =
            casts.iter().map(|cast| self.loss_vjp(cast, Loss::Training)).unzip();
        for (cotangent, by) in cotangents.iter_mut().zip(weigh(&losses)) {
            cotangent.iter_mut().for_each(|x: &mut f64| *x *= by);
        }
        cotangents
    }

    /// Cotangent of the test loss on the training signals (N, T, 3M) through the fitted weights; for a network also the outcome
    /// of its linear system.
    fn implicit(
        &mut self,
        train: &Samples,
        test: &Samples,
        counters: &mut Counters,
    ) -> (Vec<f64>, Option<Implicit>);

    /// Mean error (%).
    fn error(&mut self, samples: &Samples) -> Option<f64>;
}

/// The decoder that trains the trial's bodies.
pub(crate) fn learner<'a>(trial: &'a PreparedTrial<'a>) -> Box<dyn Learner + 'a> {
    match trial.problem.optimise.brain {
        _ if !trial.problem.tasks.trained.is_empty() => Box::new(tasks::TaskLearner::new(trial)),
        DecoderKind::Linear => Box::new(linear::LinearLearner::new(trial)),
        DecoderKind::Network => Box::new(network::NetworkLearner::new(trial)),
        DecoderKind::Stacked | DecoderKind::Inverse => unreachable!("it only reads"),
    }
}
