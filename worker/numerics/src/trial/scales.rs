//! Normalisation of signals and forces for the decoders.
//!
//! ```text
//! x = (A − offset)/scale          y = (f − mean)/deviation        f̂ = mean + deviation·ŷ
//! ```
//! By default, offset 0, scale rms(A₀) per channel of the training signals A₀, mean and standard deviation of each panel's
//! training forces. By extremes: x in [−1, 1] and y in [0, 1] over the training samples. A linear decoder, which has a
//! constant, uses f / rms(f).

use super::Samples;
use crate::brain::Real;

/// Normalisation of signals and forces.
#[derive(Debug, Clone, PartialEq)]
pub struct Scales {
    /// Value of each signal channel (3M) that becomes x = 0.
    pub offset: Vec<f64>,
    /// Value above the offset that becomes x = 1: the RMS of each channel (3M), or half its range.
    pub channels: Vec<f64>,
    /// Force of each panel (N) that becomes y = 0: its mean or minimum.
    pub mean: Vec<f64>,
    /// Force above it that becomes y = 1 (N): the standard deviation, or the range.
    pub deviation: Vec<f64>,
}

impl Scales {
    /// From mean squares of training samples.
    pub(crate) fn of(Samples { sizes, signals, targets, .. }: &Samples) -> Self {
        let force = moments(targets, sizes.outputs);
        Self {
            offset: vec![0.0; sizes.channels],
            channels: rms(signals, sizes.channels),
            mean: force.iter().map(|m| m.0).collect(),
            deviation: force.iter().map(|m| above_zero((m.1 - m.0 * m.0).max(0.0).sqrt())).collect(),
        }
    }

    /// From the extremes of training samples.
    pub(crate) fn by_extremes(Samples { sizes, signals, targets, .. }: &Samples) -> Self {
        let (signals, forces) = (extremes(signals, sizes.channels), extremes(targets, sizes.outputs));
        Self {
            offset: signals.iter().map(|[least, most]| 0.5 * (least + most)).collect(),
            channels: signals.iter().map(|[least, most]| above_zero(0.5 * (most - least))).collect(),
            mean: forces.iter().map(|[least, _]| *least).collect(),
            deviation: forces.iter().map(|[least, most]| above_zero(most - least)).collect(),
        }
    }

    /// These scales with the RMS of other signals (N, T, 3M).
    pub(crate) fn with_rms_of(&self, signals: &[f64]) -> Self {
        Self { channels: rms(signals, self.channels.len()), ..self.clone() }
    }

    /// x on other scales divided by x on these, per channel (3M); both have the same offset.
    pub(crate) fn over(&self, other: &Self) -> Vec<f64> {
        self.channels.iter().zip(&other.channels).map(|(own, other)| own / other).collect()
    }

    /// x of signals (N, T, 3M).
    pub(crate) fn inputs<F: Real>(&self, signals: &[f64]) -> Vec<F> {
        let channels = self.offset.iter().zip(&self.channels).cycle();
        signals.iter().zip(channels).map(|(a, (offset, scale))| F::from_f64((a - offset) / scale)).collect()
    }

    /// Transpose of [`Scales::inputs`]: turns a cotangent on x into one on the signals.
    pub(crate) fn inputs_vjp(&self, cotangent: &[f64]) -> Vec<f64> {
        cotangent.iter().zip(self.channels.iter().cycle()).map(|(c, s)| c / s).collect()
    }

    /// y of forces (N, T, K) in N.
    pub(crate) fn targets<F: Real>(&self, forces: &[f64]) -> Vec<F> {
        let panels = self.mean.iter().zip(&self.deviation).cycle();
        forces.iter().zip(panels).map(|(f, (mean, deviation))| F::from_f64((f - mean) / deviation)).collect()
    }

    /// RMS of the forces of all panels (N), the unit of a linear decoder's targets.
    pub(crate) fn force(&self) -> f64 {
        let squares = self.mean.iter().zip(&self.deviation).map(|(m, d)| m * m + d * d);
        (squares.sum::<f64>() / self.mean.len() as f64).sqrt()
    }

    /// f̂ (N) from ŷ (N, T, K).
    pub(crate) fn physical(&self, normalised: &[f32]) -> Vec<f64> {
        let panels = self.mean.iter().zip(&self.deviation).cycle();
        normalised.iter().zip(panels).map(|(&y, (mean, deviation))| mean + deviation * f64::from(y)).collect()
    }
}

/// Mean and mean square of each of `width` columns.
fn moments(values: &[f64], width: usize) -> Vec<(f64, f64)> {
    let count = (values.len() / width) as f64;
    (0..width)
        .map(|c| {
            let column = || values.iter().skip(c).step_by(width);
            (column().sum::<f64>() / count, column().map(|x| x * x).sum::<f64>() / count)
        })
        .collect()
}

/// Least and greatest value of each of `width` columns.
fn extremes(values: &[f64], width: usize) -> Vec<[f64; 2]> {
    let mut extremes = vec![[f64::INFINITY, f64::NEG_INFINITY]; width];
    for row in values.chunks_exact(width) {
        for ([least, most], x) in extremes.iter_mut().zip(row) {
            (*least, *most) = (least.min(*x), most.max(*x));
        }
    }
    extremes
}

/// RMS of each of `width` channels.
fn rms(signals: &[f64], width: usize) -> Vec<f64> {
    moments(signals, width).iter().map(|m| above_zero(m.1.sqrt())).collect()
}

/// The scale, or 1 for a constant channel.
fn above_zero(scale: f64) -> f64 {
    if scale > 0.0 { scale } else { 1.0 }
}
