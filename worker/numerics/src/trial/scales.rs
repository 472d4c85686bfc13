//! Scales between physics and brains.
//!
//! ```text
//! x = A / rms(A₀)          y = (f − mean)/deviation        f̂ = mean + deviation·ŷ
//! ```
//! rms of each channel of training signals A₀, mean and deviation of each panel's training forces. A linear brain, which
//! needs no mean, takes f / rms(f).

use super::Samples;
use crate::brain::Real;

/// Scales between physics and brains.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Scales {
    /// RMS of each signal channel (3M).
    pub(crate) channels: Vec<f64>,
    /// Mean force of each panel (N).
    pub(crate) mean: Vec<f64>,
    /// Standard deviation of each panel's force (N).
    pub(crate) deviation: Vec<f64>,
}

impl Scales {
    /// Of training samples.
    pub(crate) fn of(Samples { sizes, signals, targets, .. }: &Samples) -> Self {
        let force = moments(targets, sizes.outputs);
        Self {
            channels: rms(signals, sizes.channels),
            mean: force.iter().map(|m| m.0).collect(),
            deviation: force.iter().map(|m| above_zero((m.1 - m.0 * m.0).max(0.0).sqrt())).collect(),
        }
    }

    /// These, with the RMS of other signals (N, T, 3M).
    pub(crate) fn with_rms_of(&self, signals: &[f64]) -> Self {
        Self { channels: rms(signals, self.channels.len()), ..self.clone() }
    }

    /// x on other scales / x on these, a channel (3M).
    pub(crate) fn over(&self, other: &Self) -> Vec<f64> {
        self.channels.iter().zip(&other.channels).map(|(own, other)| own / other).collect()
    }

    /// x of signals (N, T, 3M).
    pub(crate) fn inputs<F: Real>(&self, signals: &[f64]) -> Vec<F> {
        signals.iter().zip(self.channels.iter().cycle()).map(|(a, s)| F::from_f64(a / s)).collect()
    }

    /// Transpose of [`Scales::inputs`]: a cotangent on x as one on the signals.
    pub(crate) fn inputs_vjp(&self, cotangent: &[f64]) -> Vec<f64> {
        cotangent.iter().zip(self.channels.iter().cycle()).map(|(c, s)| c / s).collect()
    }

    /// y of forces (N, T, K) in N.
    pub(crate) fn targets<F: Real>(&self, forces: &[f64]) -> Vec<F> {
        let panels = self.mean.iter().zip(&self.deviation).cycle();
        forces.iter().zip(panels).map(|(f, (mean, deviation))| F::from_f64((f - mean) / deviation)).collect()
    }

    /// RMS of all panels' forces (N): 1 of a linear brain's targets.
    pub(crate) fn force(&self) -> f64 {
        let squares = self.mean.iter().zip(&self.deviation).map(|(m, d)| m * m + d * d);
        (squares.sum::<f64>() / self.mean.len() as f64).sqrt()
    }

    /// f̂ in N of ŷ (N, T, K).
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

/// RMS of each of `width` channels.
fn rms(signals: &[f64], width: usize) -> Vec<f64> {
    moments(signals, width).iter().map(|m| above_zero(m.1.sqrt())).collect()
}

/// A channel that never stirs stays as it is.
fn above_zero(scale: f64) -> f64 {
    if scale > 0.0 { scale } else { 1.0 }
}
