//! Decoders for given signals and forces of any origin, by cross-validation over records.
//!
//! A seeded shuffle assigns records to folds. The decoder of a fold is fitted to all other folds, with their scales; a network
//! has the initial weights of a trial's final comparison.

use super::{Recipe, new_decoder};
use crate::brain::linear::Sizes;
use crate::dynamics::Forces;
use crate::stimuli::targets;
use crate::trial::{Samples, Scales, Trouble};

/// Records of one body.
#[derive(Debug, Clone, PartialEq)]
pub struct Records(Samples);

/// Estimates for records outside the training set.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldOutEstimates {
    /// Estimated forces (n, T, K) (N) of the fold's n records.
    pub predictions: Vec<f64>,
    /// Errors (%); `None` for a record without force.
    pub errors: Vec<Option<f64>>,
    /// Mean error on the training records (%).
    pub error_train: Option<f64>,
    /// Training loss (normalised) of every iteration.
    pub losses: Vec<f32>,
    /// (iteration, from 1, mean error on the fold's records (%)) at the milestones.
    pub progress: Vec<(u32, f64)>,
    /// Failure of the fit, if any.
    pub trouble: Option<Trouble>,
}

impl Records {
    /// Records of signals (N, T, 3M) at T instants under forces. `low_pass`: targets pass a low-pass to T instants.
    ///
    /// # Panics
    /// If the signals are not a whole number of channels.
    pub fn new(forces: &Forces, signals: Vec<f64>, instants: usize, low_pass: bool) -> Self {
        let (readings, outputs) = (forces.samples * instants, forces.panels);
        assert!(signals.len().is_multiple_of(readings), "signals of {} samples", forces.samples);
        let sizes = Sizes { instants, channels: signals.len() / readings, outputs };
        Self(Samples::new(sizes, signals, targets(forces, instants, low_pass)))
    }

    /// True forces (N, T, K) (N).
    pub fn targets(&self) -> &[f64] {
        &self.0.targets
    }

    /// Error (%) per record of these estimates (N, T, K) (N); `None` for a record without force.
    pub fn errors(&self, predicted: &[f64]) -> Vec<Option<f64>> {
        self.0.errors(predicted)
    }

    /// Fits a decoder to the records outside `fold` (`folds` has the fold of each record) and decodes those inside. A network has
    /// number `number` and trains for `iterations`.
    ///
    /// # Panics
    /// If no record is inside, or none outside.
    pub fn decode_fold(
        &self,
        folds: &[usize],
        fold: usize,
        recipe: Recipe,
        number: u64,
        iterations: usize,
        pool: &crate::Pool,
    ) -> HeldOutEstimates {
        let (inside, outside): (Vec<usize>, Vec<usize>) =
            (0..self.0.count()).partition(|&i| folds[i] == fold);
        let [unseen, known] = [inside, outside].map(|records| self.0.select(&records));
        HeldOutEstimates::fit_and_decode(&known, &unseen, recipe, number, iterations, pool)
    }

    /// Decodes all records with a decoder fitted to samples of another body, such as a twin.
    pub fn decode_all(
        &self,
        known: &Samples,
        recipe: Recipe,
        number: u64,
        iterations: usize,
        pool: &crate::Pool,
    ) -> HeldOutEstimates {
        HeldOutEstimates::fit_and_decode(known, &self.0, recipe, number, iterations, pool)
    }
}

impl HeldOutEstimates {
    fn fit_and_decode(
        known: &Samples,
        unseen: &Samples,
        recipe: Recipe,
        number: u64,
        iterations: usize,
        pool: &crate::Pool,
    ) -> Self {
        let scales = Scales::of(known);
        let mut reader = match new_decoder(recipe, known, [scales.clone(), scales], pool) {
            Ok(reader) => reader,
            Err(trouble) => return Self::zero_estimates(unseen, trouble),
        };
        let outcome = reader.fit(number, iterations, unseen, &mut |_| false).expect("it does not pause");
        let trains = reader.training().is_some();
        if let (Err(trouble), false) = (outcome, trains) {
            return Self::zero_estimates(unseen, trouble);
        }
        let predictions = reader.predict(&unseen.signals);
        let errors = unseen.errors(&predictions);
        let error_train = reader.error_known();
        let training = reader.training().and_then(Option::take);
        let (losses, progress) = training.map(|fresh| (fresh.losses, fresh.errors)).unwrap_or_default();
        Self { predictions, errors, error_train, losses, progress, trouble: outcome.err() }
    }

    /// A failed decoder estimates zero force, so its records have 100 % error.
    fn zero_estimates(unseen: &Samples, trouble: Trouble) -> Self {
        let predictions = vec![0.0; unseen.targets.len()];
        Self {
            errors: unseen.errors(&predictions),
            predictions,
            error_train: None,
            losses: Vec::new(),
            progress: Vec::new(),
            trouble: Some(trouble),
        }
    }
}

#[cfg(test)]
mod tests;
