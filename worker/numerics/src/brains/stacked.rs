//! Linear brains beneath a network: it sees their estimates of the forces beside the signals, and of what each was fitted on
//! it never sees one's.

use super::Fitted;
use super::linear::{Plain, solve};
use super::network::predict;
use super::ridge::{self, Part};
use crate::Pool;
use crate::brain::linear::{Linear, Sizes};
use crate::brain::{Data, Shape, Workspace};
use crate::trial::{Decoder, Samples, Scales, Trouble};

/// Linear brains of one body.
pub(crate) struct Stack {
    /// For samples that trained none.
    all: Linear,
    /// The fold of each training sample, and of each fold the brain that was fitted on the others.
    dealt: Vec<usize>,
    parts: Vec<Linear>,
    /// The training samples.
    known: Plain,
    /// Those of the linear brains; the network may have others.
    scales: Scales,
}

impl Stack {
    /// Fitted on these training samples.
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
        let known = Plain::of(known, &scales, pool);
        let (all, dealt) = (known.moments().normal(decoder.lags), ridge::deal(seed, known.w.len()));
        let ridge = decoder.ridge_of(seed, &known, &all)?;
        let part = |part: Part| Ok(solve(part.others, ridge)?.linear());
        let parts = ridge::parts(&known, &all, &dealt).map(part).collect::<Result<_, Trouble>>()?;
        Ok(Self { all: solve(all, ridge)?.linear(), dealt, parts, known, scales })
    }

    /// Signals (N, T, 3M) that are not the training samples' as the network takes them.
    pub(super) fn unseen(&self, shape: Shape, signals: &[f64], scales: &Scales) -> Data<f32> {
        let estimates = physical(&self.estimates(signals), scales);
        beside(shape, signals, &estimates, &vec![0.0; estimates.len()], scales)
    }

    /// The training samples, likewise.
    pub(super) fn known(&self, shape: Shape, samples: &Samples, scales: &Scales) -> Data<f32> {
        let [estimates, targets] = [&self.cross_fitted(), &self.known.y].map(|y| physical(y, scales));
        beside(shape, &samples.signals, &estimates, &targets, scales)
    }

    /// Estimates (N, T, K) of samples that are not the training samples.
    pub(crate) fn estimates(&self, signals: &[f64]) -> Vec<f64> {
        self.all.predict(&self.scales.inputs(signals))
    }

    /// Estimates of the training samples, each by a brain that has not seen it.
    pub(crate) fn cross_fitted(&self) -> Vec<f64> {
        let Sizes { instants, outputs, .. } = self.all.sizes;
        let (size, count) = (instants * outputs, self.dealt.len());
        let mut estimates = vec![0.0; count * size];
        for (fold, part) in self.parts.iter().enumerate() {
            let own: Vec<usize> = (0..count).filter(|&i| self.dealt[i] == fold).collect();
            let of_fold = part.predict(&self.known.select(&own).x);
            for (estimate, i) in of_fold.chunks_exact(size).zip(own) {
                estimates[i * size..][..size].copy_from_slice(estimate);
            }
        }
        estimates
    }
}

/// Forces (N) of a linear brain's normalised ones.
fn physical(y: &[f64], scales: &Scales) -> Vec<f64> {
    let force = scales.force();
    y.iter().map(|y| force * y).collect()
}

/// Signals (N, T, 3M) beside a linear brain's estimates (N, T, K) (N), scaled as forces; with targets (N).
fn beside(shape: Shape, signals: &[f64], estimates: &[f64], targets: &[f64], scales: &Scales) -> Data<f32> {
    let channels = shape.inputs - shape.outputs;
    let (signals, estimates): (Vec<f32>, Vec<f32>) = (scales.inputs(signals), scales.targets(estimates));
    let mut x = Vec::with_capacity(signals.len() + estimates.len());
    for (signals, estimates) in signals.chunks_exact(channels).zip(estimates.chunks_exact(shape.outputs)) {
        x.extend_from_slice(signals);
        x.extend_from_slice(estimates);
    }
    Data::new(shape, &x, &scales.targets(targets))
}

/// Forces (N, T, K) (N) of signals (N, T, 3M) by a network on this linear brain.
pub(crate) fn predict_on(
    linear: &Fitted,
    shape: Shape,
    weights: &[f32],
    signals: &[f64],
    scales: &Scales,
    pool: &Pool,
) -> Vec<f64> {
    let estimates = linear.predict(signals);
    let data = beside(shape, signals, &estimates, &vec![0.0; estimates.len()], scales);
    predict(weights, &data, scales, &mut Workspace::new(shape, pool.width()), pool)
}
