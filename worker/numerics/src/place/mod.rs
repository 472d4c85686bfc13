//! Sensor search: selects the units with the least error of a linear decoder.
//!
//! Errors are cross-validated on the training samples (`spectra`). The search adds the unit that lowers the error most, then
//! exchanges units while that lowers the error. For up to two sensors it tests all sets.

mod candidates;
mod spectra;

pub use candidates::{Candidates, placed};

use crate::body::Layout;
use crate::brain::linear::Sizes;
use crate::brains::ridge::{one_se_choice, ridges};
use crate::trial::Placing;
use rayon::prelude::*;
use spectra::Spectra;
use std::ops::Range;

/// A set of units, and its error (%).
pub type ScoredSet = (Vec<usize>, f64);

/// Result of a search.
#[derive(Debug, Clone, PartialEq)]
pub struct Placed {
    /// The units, in the order in which each lowers the error most.
    pub units: Vec<usize>,
    /// Cross-validated error (%) of a linear decoder of the first m units, m = 1 … M.
    pub errors: Vec<f64>,
    /// The next best set that differs by one unit, and its error (%).
    pub runner_up: Option<ScoredSet>,
    /// λ.
    pub ridge: f64,
    /// Whether energies of the signals were additional inputs.
    pub energies: bool,
}

/// No placement has this many sensors at this distance, or no λ gives a solution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoPlacement;

/// Largest number of exchanges: each set is rated with its own λ, so exchanges could cycle.
const EXCHANGES: usize = 1000;
/// Of more candidates, only the best single units are searched: the cost of exchanges grows with the square of their number.
pub const CANDIDATES: usize = 64;
/// λ for rating single units before the first choice.
pub const FIRST_RIDGE: f64 = 1e-4;

/// Signals of candidates, prepared for errors of subsets.
pub struct Scores<'a> {
    spectra: Spectra,
    layout: &'a Layout,
    /// Units, in the order of their channels.
    units: Vec<usize>,
    /// Channels per unit, including its energy if used.
    each: usize,
    /// Whether energies are used.
    energies: bool,
    pool: &'a crate::Pool,
}

impl<'a> Scores<'a> {
    /// From signals x (N, T, units · channels per unit) and forces f (N, T, K); sample i has weight w_i and fold `dealt[i]`.
    /// `energies` adds |x|² of each unit, normalised to mean 0 and standard deviation 1: it contains information on blows that is
    /// not linear in the motion.
    ///
    /// # Panics
    /// If lengths do not match one N, or units have different numbers of channels.
    pub fn new(
        layout: &'a Layout,
        units: Vec<usize>,
        sizes: Sizes,
        [x, f, w]: [&[f64]; 3],
        dealt: &[usize],
        energies: bool,
        pool: &'a crate::Pool,
    ) -> Self {
        assert!(sizes.channels.is_multiple_of(units.len()), "as many channels a unit");
        let own = sizes.channels / units.len();
        let each = own + usize::from(energies);
        let sizes = Sizes { channels: each * units.len(), ..sizes };
        let with_energies = energies.then(|| with_energies(x, own, units.len()));
        let spectra = Spectra::new(sizes, [with_energies.as_deref().unwrap_or(x), f, w], dealt, pool);
        Self { spectra, layout, units, each, energies, pool }
    }

    /// Cross-validated error (%) of a linear decoder of these units; infinite if λ gives no solution.
    ///
    /// # Panics
    /// If one is not a candidate.
    pub fn error(&self, units: &[usize], ridge: f64) -> f64 {
        self.spectra.error(&self.channels_of(units), ridge).unwrap_or(f64::INFINITY)
    }

    fn channels_of(&self, units: &[usize]) -> Vec<usize> {
        units.iter().flat_map(|&unit| self.channels(unit)).collect()
    }

    /// Channels of a candidate.
    fn channels(&self, unit: usize) -> Range<usize> {
        let at = self.each * self.units.iter().position(|&u| u == unit).expect("a candidate");
        at..at + self.each
    }

    /// Sets with their errors (%), best first; ties keep their order.
    fn rated(&self, sets: Vec<Vec<usize>>, ridge: f64) -> Vec<ScoredSet> {
        let of = |set: Vec<usize>| {
            let error = self.error(&set, ridge);
            (set, error)
        };
        let mut rated: Vec<_> = self.pool.install(|| sets.into_par_iter().map(of).collect());
        rated.sort_by(|a: &(_, f64), b| a.1.total_cmp(&b.1));
        rated
    }

    /// Error (%) of all candidates together, with λ by the usual rule.
    pub fn of_all(&self) -> f64 {
        self.error(&self.units, self.ridge(&self.units))
    }

    /// λ for these units, by the rule of `brains::ridge` over the folds.
    fn ridge(&self, units: &[usize]) -> f64 {
        let channels = self.channels_of(units);
        let judged = |ridge| Some((ridge, self.spectra.errors(&channels, ridge)?));
        one_se_choice(&ridges().filter_map(judged).collect::<Vec<_>>()).unwrap_or(FIRST_RIDGE)
    }

    /// Units of `from` that are not chosen and far enough from the chosen ones.
    fn allowed_units(&self, from: &[usize], chosen: &[usize], spacing: f64) -> Vec<usize> {
        let far = |a: usize, b: usize| a != b && self.layout.are_apart(a, b, spacing);
        from.iter().copied().filter(|&unit| chosen.iter().all(|&other| far(unit, other))).collect()
    }

    /// Each of the `candidates` that may join the chosen ones, with the resulting error (%), best first.
    pub fn errors_with_each(
        &self,
        chosen: &[usize],
        candidates: &[usize],
        spacing: f64,
        ridge: f64,
    ) -> Vec<(usize, f64)> {
        let allowed = self.allowed_units(candidates, chosen, spacing).into_iter();
        let rated = self.rated(allowed.map(|unit| [chosen, &[unit]].concat()).collect(), ridge);
        rated.into_iter().map(|(set, error)| (set[chosen.len()], error)).collect()
    }

    /// Runs the search.
    ///
    /// # Errors
    /// If no placement exists.
    pub fn search(&self, search: &Placing) -> Result<Placed, NoPlacement> {
        let &Placing { ref candidates, turn, .. } = search;
        let alone = self.errors_with_each(&[], candidates, search.spacing, FIRST_RIDGE);
        let first = alone.get(turn).ok_or(NoPlacement)?.0;
        // In later turns the first unit stays; in turn 0 all can be exchanged.
        let kept = usize::from(turn > 0);
        let (chosen, ridge) = self.grown(first, search)?;
        let (chosen, runner_up, ridge) = self.exchange_units(chosen, kept, ridge, search);
        let units = self.by_worth(chosen, kept, ridge);
        let errors: Vec<f64> = (1..=units.len()).map(|m| self.error(&units[..m], ridge)).collect();
        match errors.last() {
            Some(error) if error.is_finite() => {
                Ok(Placed { units, errors, runner_up, ridge, energies: self.energies })
            }
            _ => Err(NoPlacement),
        }
    }

    /// Adds the unit that lowers the error most, and updates λ, until there are enough.
    fn grown(&self, first: usize, search: &Placing) -> Result<(Vec<usize>, f64), NoPlacement> {
        let (mut chosen, mut ridge) = (vec![first], self.ridge(&[first]));
        while chosen.len() < search.sensors {
            let next = self.errors_with_each(&chosen, &search.candidates, search.spacing, ridge);
            chosen.push(next.first().ok_or(NoPlacement)?.0);
            ridge = self.ridge(&chosen);
        }
        Ok((chosen, ridge))
    }

    /// Exchanges units while that lowers the error. Returns the set, the best rejected neighbour with its error, and λ.
    fn exchange_units(
        &self,
        mut chosen: Vec<usize>,
        kept: usize,
        mut ridge: f64,
        search: &Placing,
    ) -> (Vec<usize>, Option<ScoredSet>, f64) {
        let mut left = EXCHANGES;
        loop {
            let neighbours = self.neighbours(&chosen, kept, search);
            match self.rated(neighbours, ridge).into_iter().next() {
                Some((set, error)) if left > 0 && error < self.error(&chosen, ridge) => {
                    left -= 1;
                    ridge = self.ridge(&set);
                    chosen = set;
                }
                other => return (chosen, other, ridge),
            }
        }
    }

    /// Sets that differ by one unit that is not kept; for two sensors all pairs.
    fn neighbours(&self, chosen: &[usize], kept: usize, search: &Placing) -> Vec<Vec<usize>> {
        let Placing { candidates, spacing, .. } = search;
        let mut sets = Vec::new();
        for i in kept..chosen.len() {
            let mut rest = chosen.to_vec();
            let gone = rest.remove(i);
            let others =
                self.allowed_units(candidates, &rest, *spacing).into_iter().filter(|&unit| unit != gone);
            sets.extend(others.map(|unit| [&rest[..], &[unit]].concat()));
        }
        if chosen.len() == 2 && kept == 0 {
            let pairs = candidates.iter().enumerate().flat_map(|(i, &a)| {
                let others = self.allowed_units(&candidates[i + 1..], &[a], *spacing);
                others.into_iter().map(move |b| vec![a, b])
            });
            sets = pairs.filter(|pair| !chosen.iter().all(|unit| pair.contains(unit))).collect();
        }
        sets
    }

    /// The chosen units in the order in which each lowers the error most, kept ones first.
    fn by_worth(&self, chosen: Vec<usize>, kept: usize, ridge: f64) -> Vec<usize> {
        let mut ordered = chosen[..kept].to_vec();
        while ordered.len() < chosen.len() {
            let rest: Vec<usize> = chosen.iter().copied().filter(|unit| !ordered.contains(unit)).collect();
            ordered.push(self.errors_with_each(&ordered, &rest, 0.0, ridge)[0].0);
        }
        ordered
    }
}

/// Signals (N, T, units · each), with |x|² appended per unit, normalised to mean 0 and variance 1 (unless constant).
fn with_energies(x: &[f64], each: usize, units: usize) -> Vec<f64> {
    let energy = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>();
    let mut out: Vec<f64> = x.chunks_exact(each).flat_map(|x| x.iter().copied().chain([energy(x)])).collect();
    let width = each + 1;
    for unit in 0..units {
        let energy = || (width * unit + each..out.len()).step_by(width * units);
        let count = energy().len() as f64;
        let mean = energy().map(|i| out[i]).sum::<f64>() / count;
        let variance = energy().map(|i| (out[i] - mean).powi(2)).sum::<f64>() / count;
        let scale = if variance > 0.0 { variance.sqrt().recip() } else { 1.0 };
        for i in (width * unit + each..out.len()).step_by(width * units) {
            out[i] = scale * (out[i] - mean);
        }
    }
    out
}

#[cfg(test)]
mod tests;
