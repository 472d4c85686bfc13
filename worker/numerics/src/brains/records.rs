//! Decoders for given signals and forces of any origin, by cross-validation over records.
//!
//! A seeded shuffle assigns records to folds. The decoder of a fold is fitted to all other folds, with their scales; a network
//! has the initial weights of a trial's final comparison.

use super::{Recipe, new_decoder};
use crate::brain::linear::Sizes;
use crate::dynamics::Forces;
use crate::stimuli::targets;
use crate::trial::{Samples, Scales, Trouble};

/// Estimates for records outside the training set.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HeldOutEstimates {
    /// Estimated forces (n, T, K) (N) of the n unseen records.
    pub predictions: Vec<f64>,
    /// Errors (%); `None` for a record without force.
    pub errors: Vec<Option<f64>>,
    /// Mean error on the training records (%).
    pub error_train: Option<f64>,
    /// Training loss (normalised) of every iteration.
    pub losses: Vec<f32>,
    /// (iteration, from 1, mean error on the unseen records (%)) at the milestones.
    pub progress: Vec<(u32, f64)>,
    /// Failure of the fit, if any.
    pub trouble: Option<Trouble>,
}

/// Samples from one body's signals (N, T, 3M) at T instants under forces. `low_pass`: targets pass a low-pass to T instants.
///
/// # Panics
/// If the signals are not a whole number of channels.
pub fn records(forces: &Forces, signals: Vec<f64>, instants: usize, low_pass: bool) -> Samples {
    let (readings, outputs) = (forces.samples * instants, forces.panels);
    assert!(signals.len().is_multiple_of(readings), "signals of {} samples", forces.samples);
    let sizes = Sizes { instants, channels: signals.len() / readings, outputs };
    Samples::new(sizes, signals, targets(forces, instants, low_pass))
}

impl HeldOutEstimates {
    /// Fits a decoder to the known records, or to samples of another body, such as a twin, and decodes the unseen ones. A network
    /// has number `number` and trains for `iterations`.
    ///
    /// # Panics
    /// If no record is known, or none unseen.
    pub fn of(
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
        let errors = unseen.errors(&predictions);
        Self { predictions, errors, trouble: Some(trouble), ..Self::default() }
    }
}

#[cfg(test)]
mod tests;
