//! Error probability that each look may spend, so that all looks together spend the nominal one.
//!
//! ```text
//! look k of a grid of n units: chance_k = c·w_k      w_k = (k² − (k−1)²)/n²; the first look also spends the share of all before it
//! ```
//! (shape of Kim and DeMets 1987, ρ = 2). c is such that in `chance` of the sequences of normal units, a bound at any look
//! excludes the true mean. It is estimated from simulated sequences, as in AdaStop (Mathieu et al., TMLR 2024), at its lower
//! 2.5 % limit.

use std::collections::{BTreeMap, HashMap};

use metasense_numerics::random::Draw;
use metasense_numerics::student::{chance_above, student_above};

use super::super::resample::LEAST_UNITS;

/// Number of simulated sequences.
const SEQUENCES: u64 = 40_000;

/// Bounds at the looks of a grid.
pub(super) struct Looks {
    /// w by number of units.
    weights: Vec<f64>,
    /// Per sequence, the minimum over looks of (p-value of t)/w; ascending. Empty: every look spends the whole probability.
    least: Vec<f64>,
    /// Cached quantiles by number of units and probability.
    known: HashMap<(usize, u64), f64>,
}

/// Bounds by number of units of the grid. Their simulation takes long for a large grid: keep them from decision to decision.
#[derive(Default)]
pub struct KnownLooks(pub(super) BTreeMap<usize, Looks>);

impl Looks {
    /// Simulates the looks of a grid with this number of units.
    pub(super) fn new(grid: usize) -> Self {
        let part = |units: usize| (units as f64 / grid as f64).powi(2);
        let weight = |k: usize| if k <= LEAST_UNITS { part(k) } else { part(k) - part(k - 1) };
        let weights: Vec<f64> = (0..=grid).map(weight).collect();
        let mut least: Vec<f64> = (0..SEQUENCES)
            .map(|number| {
                let (mut draw, [mut sum, mut squares]) = (Draw::numbered(5, number), [0.0; 2]);
                let mut least = f64::INFINITY;
                for k in 1..=grid {
                    let x = draw.normal();
                    (sum, squares) = (sum + x, squares + x * x);
                    if k >= LEAST_UNITS {
                        let n = k as f64;
                        let deviation = ((squares - sum * sum / n) / (n - 1.0)).sqrt();
                        let t = sum / (deviation * n.sqrt());
                        if at_least(t) / weights[k] < least {
                            least = least.min(chance_above(k - 1, t) / weights[k]);
                        }
                    }
                }
                least
            })
            .collect();
        least.sort_by(f64::total_cmp);
        Self { weights, least, known: HashMap::new() }
    }

    /// Looks without correction, for comparison.
    #[cfg(test)]
    pub(super) fn uncorrected(grid: usize) -> Self {
        Self { weights: vec![1.0; grid + 1], least: Vec::new(), known: HashMap::new() }
    }

    /// Returns the distance (standard errors) of a bound that fails with probability `chance` over all looks. `passed`: units
    /// of the grid so far; `known`: those with a result.
    pub(super) fn bound(&mut self, passed: usize, known: usize, chance: f64) -> f64 {
        let spent = match self.least.len() as f64 * chance {
            _ if self.least.is_empty() => chance,
            // too few sequences to estimate: a union bound
            hits if hits < 16.0 => chance * self.weights[passed],
            hits => self.least[(hits - 2.0 * hits.sqrt()) as usize] * self.weights[passed],
        };
        let spent = spent.min(0.49);
        *self.known.entry((known, spent.to_bits())).or_insert_with(|| student_above(known - 1, spent))
    }
}

/// Returns a lower bound of P(T > t) for any degrees of freedom: for t > 0 that of the normal distribution by Birnbaum (1942),
/// doi:10.1214/aoms/1177731611. The exact probability takes as many terms as there are units.
pub(super) fn at_least(t: f64) -> f64 {
    let density = (-0.5 * t * t).exp() / (2.0 * std::f64::consts::PI).sqrt();
    if t > 0.0 { density * 2.0 / (t + (t * t + 4.0).sqrt()) } else { 0.5 }
}
