//! The fewest sensors with which the trained body beats the initial body with the most sensors.

use super::data::{Grid, Observation, clusters};
use super::numbers::{distinct, geometric_mean, log_squares};
use super::resample::Resampling;

/// The fewest sensors of the trained body.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorSaving {
    /// Largest M of the initial body.
    pub most: f64,
    /// Error of the initial body with this M (%).
    pub initial_error: f64,
    /// Smallest M with which the trained body has less error; `None` if there is none.
    pub fewest: Option<f64>,
    /// Error of the trained body with that M (%).
    pub optimised_error: Option<f64>,
    /// Share of the replicates in which this M or a smaller one suffices; `None` with too few units.
    pub share: Option<f64>,
    /// Units of the votes, or why there are none.
    pub over: String,
}

/// Compares the curves of error against M of both bodies; `None` if either is empty.
pub fn fewer(initial: &[Observation], optimised: &[Observation]) -> Option<SensorSaving> {
    let clusters = clusters(initial.iter().chain(optimised));
    let [initial, optimised] = [initial, optimised].map(|observations| Grid::new(observations, &clusters));
    let most = *initial.places.last()?;
    let find = |weights: &[f64]| -> Option<(f64, Option<(f64, f64)>)> {
        let bar = (*initial.means(weights).last()?)?;
        let means = optimised.places.iter().zip(optimised.means(weights));
        let first = means.filter_map(|(m, mean)| Some((*m, mean?))).find(|&(_, e)| e < bar);
        Some((bar, first))
    };
    let units = Resampling::new(&clusters);
    let (initial_error, first) = find(&units.equal_weights())?;
    let replicates = units.replicates(|weights| find(&weights).map(|(_, first)| first.map(|(m, _)| m)));
    let share = first.filter(|_| !replicates.is_empty()).map(|(m, _)| {
        replicates.iter().filter(|r| r.is_some_and(|r| r <= m)).count() as f64 / replicates.len() as f64
    });
    let (fewest, optimised_error) = first.unzip();
    Some(SensorSaving { most, initial_error, fewest, optimised_error, share, over: units.over() })
}

/// Spread of the error over placements, at equal M and seed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlacementSpread {
    /// Largest number of placements per seed.
    pub placements: usize,
    /// Standard deviation of ln e over placements, pooled over seeds.
    pub deviation: f64,
    /// Largest error divided by smallest, geometric mean over seeds.
    pub ratio: f64,
}

/// Returns the spread of the error over placements; `None` with a single placement.
pub fn spread(observations: &[Observation]) -> Option<PlacementSpread> {
    let (mut squares, mut freedom, mut ratios, mut placements) = (0.0, 0usize, Vec::new(), 0);
    for seed in distinct(observations.iter().map(|o| o.cluster.seed)) {
        let errors: Vec<f64> =
            observations.iter().filter(|o| o.cluster.seed == seed).map(|o| o.error).collect();
        if errors.len() < 2 {
            continue;
        }
        squares += log_squares(&errors);
        freedom += errors.len() - 1;
        placements = placements.max(errors.len());
        ratios.push(
            errors.iter().copied().fold(0.0, f64::max) / errors.iter().copied().fold(f64::INFINITY, f64::min),
        );
    }
    let deviation = (squares / freedom as f64).sqrt();
    (freedom > 0).then(|| PlacementSpread { placements, deviation, ratio: geometric_mean(&ratios) })
}

#[cfg(test)]
mod tests;
