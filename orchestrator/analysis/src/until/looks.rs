//! What a look may spend: nominal chances of being wrong that come to the whole one over all looks.
//!
//! ```text
//! look k of a grid of n units: chance_k = c·w_k      w_k = (k² − (k−1)²)/n², of the first all before it, too
//! ```
//! (the shape of Kim and DeMets 1987, ρ = 2), with c so that a running mean of normal units whose truth is the bound is held
//! for above it at any look in `chance` of sequences: by so many of them drawn, as AdaStop's boundaries are (Mathieu et al.,
//! TMLR 2024), at their lower 2.5 % limit.

use std::collections::HashMap;

use metasense_numerics::random::Draw;
use metasense_numerics::student::{chance_above, student_above};

use super::super::resample::LEAST_UNITS;

/// Sequences drawn.
const SEQUENCES: u64 = 40_000;

/// The looks of a grid.
pub(super) struct Looks {
    /// w by number of units.
    weights: Vec<f64>,
    /// min over looks of (chance above that sequence's t)/w, ascending; none: every look spends all.
    least: Vec<f64>,
    /// Quantiles by degrees of freedom and chance.
    known: HashMap<(usize, u64), f64>,
}

impl Looks {
    /// Of a grid of so many units.
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

    /// Looks that are not paid for, to be compared with.
    #[cfg(test)]
    pub(super) fn naive(grid: usize) -> Self {
        Self { weights: vec![1.0; grid + 1], least: Vec::new(), known: HashMap::new() }
    }

    /// How many standard errors a bound is away that is wrong with this chance, all looks taken together: after so many
    /// units of the grid, of which `known` have a result.
    pub(super) fn bound(&mut self, passed: usize, known: usize, chance: f64) -> f64 {
        let spent = match self.least.len() as f64 * chance {
            _ if self.least.is_empty() => chance,
            // so few that none is drawn: a union bound
            hits if hits < 16.0 => chance * self.weights[passed],
            hits => self.least[(hits - 2.0 * hits.sqrt()) as usize] * self.weights[passed],
        };
        let spent = spent.min(0.49);
        *self.known.entry((known, spent.to_bits())).or_insert_with(|| student_above(known - 1, spent))
    }
}

/// What the chance of a t above this one is not below, whatever its degrees of freedom: for a t above 0 the normal one's bound by
/// Birnbaum (1942), doi:10.1214/aoms/1177731611; a chance proper takes as many terms as there are units.
pub(super) fn at_least(t: f64) -> f64 {
    let density = (-0.5 * t * t).exp() / (2.0 * std::f64::consts::PI).sqrt();
    if t > 0.0 { density * 2.0 / (t + (t * t + 4.0).sqrt()) } else { 0.5 }
}
