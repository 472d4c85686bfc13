//! Brains on given signals and forces, wherever they come from: each record is predicted by one that has not seen it.
//!
//! A seeded shuffle assigns the records to folds; a fold's brain is fitted to all others, a network from the initial weights of
//! the comparison at the end of a trial. Its scales are those of its own training records.

use super::{Recipe, reader};
use crate::brain::linear::Sizes;
use crate::dynamics::Forces;
use crate::stimuli::targets;
use crate::trial::{Samples, Scales, Trouble};

/// Records of one body.
#[derive(Debug, Clone, PartialEq)]
pub struct Records(Samples);

/// A brain's predictions of records that it was not fitted to.
#[derive(Debug, Clone, PartialEq)]
pub struct Unseen {
    /// Predicted forces (n, T, K) (N) of the fold's n records.
    pub predictions: Vec<f64>,
    /// Their errors (%); `None` where there is no force.
    pub errors: Vec<Option<f64>>,
    /// Mean error on the records that trained it (%).
    pub error_train: Option<f64>,
    /// Training loss (normalised) at every iteration.
    pub losses: Vec<f32>,
    /// (Iteration, from 1, mean error on the fold's records there) at the milestones of the training.
    pub progress: Vec<(u32, f64)>,
    /// What went wrong.
    pub trouble: Option<Trouble>,
}

impl Records {
    /// Signals (N, T, 3M) of T instants under forces; with `low_pass` targets hold what T instants can say.
    ///
    /// # Panics
    /// If the signals are not of whole channels.
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

    /// Error of each (%) by these predictions (N, T, K) (N); `None` where there is no force.
    pub fn errors(&self, predicted: &[f64]) -> Vec<Option<f64>> {
        self.0.errors(predicted)
    }

    /// Fits a brain to the records outside `fold` (of each record, as `folds` deals them) and lets it predict those inside:
    /// of a network number `number`, trained for `iterations`.
    ///
    /// # Panics
    /// If there is no record inside or outside.
    pub fn unseen(
        &self,
        folds: &[usize],
        fold: usize,
        recipe: Recipe,
        number: u64,
        iterations: usize,
        pool: &crate::Pool,
    ) -> Unseen {
        let (inside, outside): (Vec<usize>, Vec<usize>) =
            (0..self.0.count()).partition(|&i| folds[i] == fold);
        let [unseen, known] = [inside, outside].map(|records| self.0.select(&records));
        Unseen::by(&known, &unseen, recipe, number, iterations, pool)
    }

    /// The same of all of them by a brain fitted to samples of another body, such as the records' twin.
    pub fn taught(
        &self,
        known: &Samples,
        recipe: Recipe,
        number: u64,
        iterations: usize,
        pool: &crate::Pool,
    ) -> Unseen {
        Unseen::by(known, &self.0, recipe, number, iterations, pool)
    }
}

impl Unseen {
    fn by(
        known: &Samples,
        unseen: &Samples,
        recipe: Recipe,
        number: u64,
        iterations: usize,
        pool: &crate::Pool,
    ) -> Self {
        let scales = Scales::of(known);
        let mut reader = match reader(recipe, known, [scales.clone(), scales], pool) {
            Ok(reader) => reader,
            Err(trouble) => return Self::nothing(unseen, trouble),
        };
        let outcome = reader.fit(number, iterations, unseen, &mut |_| false).expect("it does not pause");
        let trains = reader.training().is_some();
        if let (Err(trouble), false) = (outcome, trains) {
            return Self::nothing(unseen, trouble);
        }
        let predictions = reader.predict(&unseen.signals);
        let errors = unseen.errors(&predictions);
        let error_train = reader.error_known();
        let training = reader.training().and_then(Option::take);
        let (losses, progress) = training.map(|fresh| (fresh.losses, fresh.errors)).unwrap_or_default();
        Self { predictions, errors, error_train, losses, progress, trouble: outcome.err() }
    }

    /// Of a brain that could not be fitted: it says nothing, so its records have 100 % error.
    fn nothing(unseen: &Samples, trouble: Trouble) -> Self {
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
