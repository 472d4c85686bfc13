//! Linear decoders for stacked decoders: their estimates are additional inputs of a network. Estimates of training samples are
//! out-of-fold.

use super::Fitted;
use super::linear::{ScaledSamples, solve};
use super::network::predict;
use super::ridge::{self, FoldSplit};
use crate::Pool;
use crate::brain::linear::{Linear, Sizes};
use crate::brain::{Data, Shape, Workspace};
use crate::stimuli::members;
use crate::trial::{Decoder, Samples, Scales, Trouble};

/// Linear decoders of one body.
pub(crate) struct Stack {
    /// For samples outside the training set.
    all: Linear,
    /// Fold of each training sample, and per fold the decoder fitted to the others.
    dealt: Vec<usize>,
    parts: Vec<Linear>,
    /// The training samples.
    known: ScaledSamples,
    /// Scales of the linear decoders; the network may have others.
    scales: Scales,
    /// λ of these decoders.
    pub(crate) ridge: f64,
}

impl Stack {
    /// Fits the decoders to these training samples.
    ///
    /// # Errors
    /// If one has no solution.
    pub(crate) fn new(
        decoder: &Decoder,
        seed: u64,
        known: &Samples,
        scales: Scales,
        pool: &Pool,
    ) -> Result<Self, Trouble> {
        let known = ScaledSamples::of(known, &scales, pool);
        let (all, dealt) = (known.normal(decoder.lags), ridge::assign_folds(seed, known.w.len()));
        let ridge = decoder.ridge_of(seed, &known, &all)?;
        let part = |part: FoldSplit| Ok(solve(part.others, ridge)?.linear());
        let parts = ridge::split_folds(&known, &all, &dealt).map(part).collect::<Result<_, Trouble>>()?;
        Ok(Self { all: solve(all, ridge)?.linear(), dealt, parts, known, scales, ridge })
    }

    /// Network inputs for signals (N, T, 3M) outside the training set.
    pub(super) fn unseen(&self, shape: Shape, signals: &[f64], scales: &Scales) -> Data<f32> {
        let estimates = physical(&self.estimates(signals), scales);
        stacked_data(shape, signals, &estimates, &vec![0.0; estimates.len()], scales)
    }

    /// Network data of the training samples.
    pub(super) fn known(&self, shape: Shape, samples: &Samples, scales: &Scales) -> Data<f32> {
        let [estimates, targets] = [&self.cross_fitted(), &self.known.y].map(|y| physical(y, scales));
        stacked_data(shape, &samples.signals, &estimates, &targets, scales)
    }

    /// Estimates (N, T, K) for signals outside the training set.
    pub(crate) fn estimates(&self, signals: &[f64]) -> Vec<f64> {
        self.all.predict(&self.scales.inputs(signals))
    }

    /// Out-of-fold estimates of the training samples.
    pub(crate) fn cross_fitted(&self) -> Vec<f64> {
        let Sizes { instants, outputs, .. } = self.all.sizes;
        let (size, count) = (instants * outputs, self.dealt.len());
        let mut estimates = vec![0.0; count * size];
        for (own, part) in members(&self.dealt).into_iter().zip(&self.parts) {
            let of_fold = part.predict(&self.known.select(&own).x);
            for (estimate, i) in of_fold.chunks_exact(size).zip(own) {
                estimates[i * size..][..size].copy_from_slice(estimate);
            }
        }
        estimates
    }
}

/// Converts normalised forces to N.
fn physical(y: &[f64], scales: &Scales) -> Vec<f64> {
    let force = scales.force();
    y.iter().map(|y| force * y).collect()
}

/// Network data: signals (N, T, 3M) with estimates (N, T, K) (N), scaled as forces, and targets (N).
fn stacked_data(
    shape: Shape,
    signals: &[f64],
    estimates: &[f64],
    targets: &[f64],
    scales: &Scales,
) -> Data<f32> {
    let channels = shape.inputs - shape.outputs;
    let (signals, estimates): (Vec<f32>, Vec<f32>) = (scales.inputs(signals), scales.targets(estimates));
    let mut x = Vec::with_capacity(signals.len() + estimates.len());
    for (signals, estimates) in signals.chunks_exact(channels).zip(estimates.chunks_exact(shape.outputs)) {
        x.extend_from_slice(signals);
        x.extend_from_slice(estimates);
    }
    Data::new(shape, &x, &scales.targets(targets))
}

/// Forces (N, T, K) (N) estimated by a network stacked on this linear decoder.
pub fn predict_on(
    linear: &Fitted,
    shape: Shape,
    weights: &[f32],
    signals: &[f64],
    scales: &Scales,
    pool: &Pool,
) -> Vec<f64> {
    let estimates = linear.predict(signals);
    let data = stacked_data(shape, signals, &estimates, &vec![0.0; estimates.len()], scales);
    predict(weights, &data, scales, &mut Workspace::new(shape, pool.width()), pool)
}
