//! A linear brain fitted to any signals and forces, at its own scales.
//!
//! ```text
//! x = signals / rms(signals)     f̂ = rms(f) · (b + W ∗ x)
//! ```

use super::linear::{Decoder, Plain, fit, force_scale};
use super::report::Trouble;
use super::setting::Scales;
use crate::Heartbeat;
use crate::brain::linear::{Linear, Sizes};

/// A linear brain and the scales that it was fitted at.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    linear: Linear,
    /// λ.
    pub ridge: f64,
    /// What each signal channel is divided by (C).
    pub signal_scale: Vec<f64>,
    /// RMS of all forces (N).
    pub force_scale: f64,
    /// Mean error on the samples that it was fitted to (%); `None` where none has a force.
    pub error: Option<f64>,
}

impl Decoder {
    /// Fits the linear brain to signals (N, T, C) and forces (N, T, K) (N), its λ by folds dealt by `seed` where it is not
    /// given. Signals are divided by `signal_scale`, by default their own RMS.
    ///
    /// # Errors
    /// If no λ has a solution.
    ///
    /// # Panics
    /// If lengths do not fit the sizes.
    pub fn fitted(
        &self,
        seed: u64,
        sizes: Sizes,
        signals: &[f64],
        forces: &[f64],
        signal_scale: Option<Vec<f64>>,
    ) -> Result<Fitted, Trouble> {
        let mut scales = Scales::of([sizes.channels, sizes.outputs], signals, forces);
        scales.channels = signal_scale.unwrap_or(scales.channels);
        let force_scale = force_scale(&scales.mean, &scales.deviation);
        let known = Plain::new(sizes, scales.inputs(signals), forces, force_scale, &Heartbeat::default());
        let ridge = self.ridge_of(seed, &known, None)?;
        let linear = fit(&known.moments(), self.lags, ridge)?.linear();
        let error = known.error(&linear.predict(&known.x));
        Ok(Fitted { linear, ridge, signal_scale: scales.channels, force_scale, error })
    }
}

impl Fitted {
    /// T, C, K.
    pub fn sizes(&self) -> Sizes {
        self.linear.sizes
    }

    /// f̂ (N, T, K) (N) of signals (N, T, C).
    ///
    /// # Panics
    /// If the length is not that of whole samples.
    pub fn predict(&self, signals: &[f64]) -> Vec<f64> {
        let x: Vec<f64> = self.scaled(signals).collect();
        self.physical(self.linear.predict(&x))
    }

    /// Transpose of [`Fitted::predict`] but for b: a cotangent on f̂ (N, T, K) as one on the signals.
    ///
    /// # Panics
    /// Likewise.
    pub fn predict_vjp(&self, cotangent: &[f64]) -> Vec<f64> {
        self.physical(self.scaled(&self.linear.predict_vjp(cotangent)).collect())
    }

    /// W (K, lags, C) (N) and b (K) (N): f̂ = b + Σ W · signals / `signal_scale`.
    pub fn weights(&self) -> [Vec<f64>; 2] {
        [&self.linear.w, &self.linear.b].map(|w| self.physical(w.clone()))
    }

    fn scaled(&self, signals: &[f64]) -> impl Iterator<Item = f64> {
        signals.iter().zip(self.signal_scale.iter().cycle()).map(|(a, s)| a / s)
    }

    fn physical(&self, mut values: Vec<f64>) -> Vec<f64> {
        values.iter_mut().for_each(|y| *y *= self.force_scale);
        values
    }
}
