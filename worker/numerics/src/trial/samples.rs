//! Samples of a body: sensor signals, and the forces to estimate.

use crate::brain::linear::Sizes;
use crate::brain::prediction_error;

/// Signals and forces of N samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Samples {
    /// T; channels (3M or fewer); K.
    pub sizes: Sizes,
    /// (N, T, channels) in mm/s² and rad/s.
    pub signals: Vec<f64>,
    /// Forces (N, T, K) in N.
    pub targets: Vec<f64>,
    /// Whether a sample's simulation failed (N). A failed sample has zero signals and forces, and 100 % error.
    pub failed: Vec<bool>,
}

impl Samples {
    /// Signals (N, T, channels) under forces (N, T, K); no sample failed.
    pub fn new(sizes: Sizes, signals: Vec<f64>, targets: Vec<f64>) -> Self {
        let failed = vec![false; targets.len() / (sizes.instants * sizes.outputs)];
        Self { sizes, signals, targets, failed }
    }

    /// Sets which samples failed.
    pub fn with_failed(self, failed: Vec<bool>) -> Self {
        assert_eq!(failed.len(), self.count(), "one a sample");
        Self { failed, ..self }
    }

    /// Number of samples, N.
    pub fn count(&self) -> usize {
        self.failed.len()
    }

    /// Number of failed samples.
    pub fn failures(&self) -> u64 {
        self.failed.iter().filter(|failed| **failed).count() as u64
    }

    /// The samples with a force that did not fail.
    pub fn with_force(&self) -> Vec<usize> {
        let one = self.sizes.instants * self.sizes.outputs;
        let has_force = |i: &usize| self.targets[i * one..][..one].iter().any(|f| *f != 0.0);
        (0..self.count()).filter(|i| !self.failed[*i] && has_force(i)).collect()
    }

    /// Number of samples without force, including failed ones.
    pub fn without_force(&self) -> u32 {
        let one = self.sizes.instants * self.sizes.outputs;
        self.targets.chunks_exact(one).filter(|sample| sample.iter().all(|f| *f == 0.0)).count() as u32
    }

    /// The samples listed, in the order listed.
    pub fn select(&self, samples: &[usize]) -> Self {
        let (signals, targets) =
            (pick(&self.signals, self.count(), samples), pick(&self.targets, self.count(), samples));
        Self { sizes: self.sizes, signals, targets, failed: pick(&self.failed, self.count(), samples) }
    }

    /// Error of each sample (%) with these estimates (N, T, K): [`error_of_each`].
    pub fn errors(&self, predicted: &[f64]) -> Vec<Option<f64>> {
        error_of_each(self.sizes, &self.targets, &self.failed, predicted)
    }

    /// Mean error (%) with these estimates (N, T, K).
    pub fn error(&self, predicted: &[f64]) -> Option<f64> {
        mean_error(&self.errors(predicted))
    }

    /// Concatenates the samples of all sets.
    ///
    /// # Panics
    /// If there is no set.
    pub fn joined(sets: &[&Self]) -> Self {
        Self {
            sizes: sets[0].sizes,
            signals: sets.iter().flat_map(|set| &set.signals).copied().collect(),
            targets: sets.iter().flat_map(|set| &set.targets).copied().collect(),
            failed: sets.iter().flat_map(|set| &set.failed).copied().collect(),
        }
    }
}

/// The listed ones of `count` equal pieces of `values`, in the order listed.
pub(crate) fn pick<T: Copy>(values: &[T], count: usize, pieces: &[usize]) -> Vec<T> {
    let one = values.len() / count.max(1);
    pieces.iter().flat_map(|&i| &values[i * one..][..one]).copied().collect()
}

/// Error of a failed sample (%), that of a zero estimate.
pub const FAILED: f64 = 100.0;

/// Error of each sample (%), 100·Σ(f − f̂)²/Σf²: 100 for failed samples, `None` without force. Forces and estimates (N, T, K) have
/// the same unit. Every error of this program is a mean of these.
pub(crate) fn error_of_each(
    sizes: Sizes,
    targets: &[f64],
    failed: &[bool],
    predicted: &[f64],
) -> Vec<Option<f64>> {
    let errors = prediction_error(targets, predicted, sizes.outputs, sizes.instants);
    errors.into_iter().zip(failed).map(|(error, failed)| if *failed { Some(FAILED) } else { error }).collect()
}

/// Distribution of the errors of samples. A single sample can dominate the mean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    /// Median (%).
    pub median: f64,
    /// 90th percentile (%).
    pub p90: f64,
    /// Samples above 100 %, the error of a decoder that predicts no force.
    pub above: u32,
}

impl Spread {
    /// For samples that all failed.
    pub const FAILED: Self = Self { median: FAILED, p90: FAILED, above: 0 };

    /// Distribution of the errors that exist; NaN counts as infinite. `None` if no sample has an error. Quantiles are interpolated
    /// linearly between order statistics.
    pub fn of(errors: &[Option<f64>]) -> Option<Self> {
        let known = errors.iter().flatten().map(|error| if error.is_nan() { f64::INFINITY } else { *error });
        let mut known: Vec<f64> = known.collect();
        known.sort_by(f64::total_cmp);
        let last = known.len().checked_sub(1)?;
        let quantile = |q: f64| {
            let at = q * last as f64;
            let (low, high) = (known[at.floor() as usize], known[at.ceil() as usize]);
            if low == high { low } else { low + (at - at.floor()) * (high - low) }
        };
        let above = known.iter().filter(|error| **error > FAILED).count() as u32;
        Some(Self { median: quantile(0.5), p90: quantile(0.9), above })
    }
}

/// Mean over the samples that have an error; `None` if there are none, or the mean is not finite.
pub fn mean_error(errors: &[Option<f64>]) -> Option<f64> {
    let known: Vec<f64> = errors.iter().flatten().copied().collect();
    let mean = known.iter().sum::<f64>() / known.len() as f64;
    mean.is_finite().then_some(mean)
}
