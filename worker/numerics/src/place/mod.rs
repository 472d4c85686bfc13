//! Which units carry the sensors: those whose signals a linear brain reads the forces from best.
//!
//! An error is that of folds of the training samples (`spectra`). The unit that lowers it most joins the chosen ones, then
//! each gives way to another as long as that lowers it; up to two sensors all sets are tried.

mod candidates;
mod spectra;

pub use candidates::{Candidates, placed};

use crate::body::Layout;
use crate::brain::linear::Sizes;
use crate::brains::ridge::{greatest, ridges};
use crate::trial::Placing;
use rayon::prelude::*;
use spectra::Spectra;
use std::ops::Range;

/// A set of units, and its error (%).
pub type Rated = (Vec<usize>, f64);

/// What a search found.
#[derive(Debug, Clone, PartialEq)]
pub struct Placed {
    /// The units, in the order in which they are worth most.
    pub units: Vec<usize>,
    /// Error (%) of a linear brain on samples that it has not seen, of the first m of them, m = 1 … M.
    pub errors: Vec<f64>,
    /// The next best of the sets that differ by one unit, and its error (%).
    pub runner_up: Option<Rated>,
    /// λ.
    pub ridge: f64,
    /// Whether the linear brain saw the energies of the signals, too.
    pub energies: bool,
}

/// No placement has so many sensors so far apart, or no λ gives their brain a solution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Nowhere;

/// Exchanges of a unit at most: each set is rated by its own λ, so that two might take turns for ever.
const EXCHANGES: usize = 1000;
/// More candidates are thinned out to those that are best alone: what the exchange goes through grows with their square.
pub const CANDIDATES: usize = 64;
/// λ by which single units are rated before one is chosen.
pub const FIRST_RIDGE: f64 = 1e-4;

/// Signals of candidate units, and how well any of them are read.
pub struct Scores<'a> {
    spectra: Spectra,
    layout: &'a Layout,
    /// Units by their channels' order.
    units: Vec<usize>,
    /// Channels of each, its energy among them where that is one.
    each: usize,
    /// Whether it is.
    energies: bool,
    pool: &'a crate::Pool,
}

impl<'a> Scores<'a> {
    /// Of signals x (N, T, units · channels of each) and forces f (N, T, K); sample i has weight w_i and is judged in fold `dealt[i]`. With
    /// `energies` |x|² of each unit, less its mean and in units of its standard deviation, is a signal, too: what blows leave that
    /// no linear part of the motion tells.
    ///
    /// # Panics
    /// If lengths do not belong to one N, or units have not equally many channels.
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
        let each = sizes.channels / units.len();
        let folds = dealt.iter().max().map_or(0, |most| most + 1);
        let spectra = if energies {
            let sizes = Sizes { channels: (each + 1) * units.len(), ..sizes };
            Spectra::new(sizes, [&with_energies(x, each, units.len()), f, w], dealt, folds, pool)
        } else {
            Spectra::new(sizes, [x, f, w], dealt, folds, pool)
        };
        Self { spectra, layout, units, each: each + usize::from(energies), energies, pool }
    }

    /// Error (%) of a linear brain of these units on samples that it has not seen; infinite where λ gives none.
    ///
    /// # Panics
    /// If one is no candidate.
    pub fn error(&self, units: &[usize], ridge: f64) -> f64 {
        self.spectra.error(&self.channels_of(units), ridge).unwrap_or(f64::INFINITY)
    }

    fn channels_of(&self, units: &[usize]) -> Vec<usize> {
        units.iter().flat_map(|&unit| self.channels(unit)).collect()
    }

    /// Those of a candidate.
    fn channels(&self, unit: usize) -> Range<usize> {
        let at = self.each * self.units.iter().position(|&u| u == unit).expect("a candidate");
        at..at + self.each
    }

    /// Sets and their errors (%), best first; equal ones as they came.
    fn rated(&self, sets: Vec<Vec<usize>>, ridge: f64) -> Vec<Rated> {
        let of = |set: Vec<usize>| {
            let error = self.error(&set, ridge);
            (set, error)
        };
        let mut rated: Vec<_> = self.pool.install(|| sets.into_par_iter().map(of).collect());
        rated.sort_by(|a: &(_, f64), b| a.1.total_cmp(&b.1));
        rated
    }

    /// Error (%) of all candidates together, at the λ of least error.
    pub fn of_all(&self) -> f64 {
        self.error(&self.units, self.ridge(&self.units))
    }

    /// λ for these units, by the rule of `brains::ridge` over the folds.
    fn ridge(&self, units: &[usize]) -> f64 {
        let channels = self.channels_of(units);
        let judged = |ridge| Some((ridge, self.spectra.errors(&channels, ridge)?));
        greatest(&ridges().filter_map(judged).collect::<Vec<_>>()).unwrap_or(FIRST_RIDGE)
    }

    /// Units of `from` that are far enough from the chosen ones, and none of them.
    fn beside(&self, from: &[usize], chosen: &[usize], spacing: f64) -> Vec<usize> {
        let far = |a: usize, b: usize| a != b && self.layout.apart(a, b, spacing);
        from.iter().copied().filter(|&unit| chosen.iter().all(|&other| far(unit, other))).collect()
    }

    /// Each unit of `candidates` that may stand beside the chosen ones, and the error (%) with it, best first.
    pub fn worth(
        &self,
        chosen: &[usize],
        candidates: &[usize],
        spacing: f64,
        ridge: f64,
    ) -> Vec<(usize, f64)> {
        let sets = self.beside(candidates, chosen, spacing).into_iter().map(|unit| with(chosen, unit));
        let rated = self.rated(sets.collect(), ridge);
        rated.into_iter().map(|(set, error)| (set[chosen.len()], error)).collect()
    }

    /// Searches.
    ///
    /// # Errors
    /// If there is no such placement.
    pub fn search(&self, search: &Placing) -> Result<Placed, Nowhere> {
        let &Placing { ref candidates, turn, .. } = search;
        let alone = self.worth(&[], candidates, search.spacing, FIRST_RIDGE);
        let first = alone.get(turn).ok_or(Nowhere)?.0;
        let ridge = self.ridge(&[first]);
        // the unit of a later turn stays; of the first one all may give way
        let kept = usize::from(turn > 0);
        let (chosen, ridge) = self.grown(first, ridge, search)?;
        let (chosen, runner_up, ridge) = self.exchanged(chosen, kept, ridge, search);
        let units = self.by_worth(chosen, kept, ridge);
        let errors: Vec<f64> = (1..=units.len()).map(|m| self.error(&units[..m], ridge)).collect();
        match errors.last() {
            Some(error) if error.is_finite() => {
                Ok(Placed { units, errors, runner_up, ridge, energies: self.energies })
            }
            _ => Err(Nowhere),
        }
    }

    /// From the first unit on, each time the one that lowers the error most, and λ after it.
    fn grown(&self, first: usize, mut ridge: f64, search: &Placing) -> Result<(Vec<usize>, f64), Nowhere> {
        let mut chosen = vec![first];
        while chosen.len() < search.sensors {
            let next = self.worth(&chosen, &search.candidates, search.spacing, ridge);
            chosen.push(next.first().ok_or(Nowhere)?.0);
            ridge = self.ridge(&chosen);
        }
        Ok((chosen, ridge))
    }

    /// Neighbours for as long as one is better; the best that is not, with its error, and λ.
    fn exchanged(
        &self,
        mut chosen: Vec<usize>,
        kept: usize,
        mut ridge: f64,
        search: &Placing,
    ) -> (Vec<usize>, Option<Rated>, f64) {
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

    /// Sets that differ from the chosen one by one unit that is not kept; of two sensors all sets.
    fn neighbours(&self, chosen: &[usize], kept: usize, search: &Placing) -> Vec<Vec<usize>> {
        let Placing { candidates, spacing, .. } = search;
        let mut sets = Vec::new();
        for i in kept..chosen.len() {
            let mut rest = chosen.to_vec();
            let gone = rest.remove(i);
            let others = self.beside(candidates, &rest, *spacing).into_iter().filter(|&unit| unit != gone);
            sets.extend(others.map(|unit| with(&rest, unit)));
        }
        if chosen.len() == 2 && kept == 0 {
            let pairs = candidates.iter().enumerate().flat_map(|(i, &a)| {
                let others = self.beside(&candidates[i + 1..], &[a], *spacing);
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
            ordered.push(self.worth(&ordered, &rest, 0.0, ridge)[0].0);
        }
        ordered
    }
}

/// Signals (N, T, units · each), those of each unit followed by |x|², its mean 0 and its variance 1 (unless it is constant).
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

fn with(chosen: &[usize], unit: usize) -> Vec<usize> {
    let mut set = chosen.to_vec();
    set.push(unit);
    set
}

#[cfg(test)]
mod tests;
