//! Samples of a body: what its sensors tell, and the forces that brains are to say.

use crate::brain::linear::Sizes;

/// Signals and forces of N samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Samples {
    /// T, 3M, K.
    pub sizes: Sizes,
    /// (N, T, 3M) in mm/s² and rad/s.
    pub signals: Vec<f64>,
    /// Forces (N, T, K) in N.
    pub targets: Vec<f64>,
}

impl Samples {
    /// N.
    pub fn count(&self) -> usize {
        self.targets.len() / (self.sizes.instants * self.sizes.outputs)
    }

    /// How many have no force.
    pub fn without_force(&self) -> u32 {
        let one = self.sizes.instants * self.sizes.outputs;
        self.targets.chunks_exact(one).filter(|sample| sample.iter().all(|f| *f == 0.0)).count() as u32
    }

    /// The samples listed, in the order listed.
    #[must_use]
    pub fn select(&self, samples: &[usize]) -> Self {
        let (signals, targets) =
            (pick(&self.signals, self.count(), samples), pick(&self.targets, self.count(), samples));
        Self { sizes: self.sizes, signals, targets }
    }

    /// The samples of all of these, one set after another.
    ///
    /// # Panics
    /// If there is no set.
    #[must_use]
    pub fn joined(sets: &[&Self]) -> Self {
        Self {
            sizes: sets[0].sizes,
            signals: sets.iter().flat_map(|set| &set.signals).copied().collect(),
            targets: sets.iter().flat_map(|set| &set.targets).copied().collect(),
        }
    }
}

/// Those of `count` equal pieces of `values` that are listed, in the order listed.
pub(crate) fn pick(values: &[f64], count: usize, pieces: &[usize]) -> Vec<f64> {
    let one = values.len() / count.max(1);
    pieces.iter().flat_map(|&i| &values[i * one..][..one]).copied().collect()
}

/// Mean over the samples with force; `None` where there is none, or it is no number.
pub fn mean_error(errors: &[Option<f64>]) -> Option<f64> {
    let known: Vec<f64> = errors.iter().flatten().copied().collect();
    let mean = known.iter().sum::<f64>() / known.len() as f64;
    mean.is_finite().then_some(mean)
}
