//! Independent units of a sweep, and intervals and votes over them.
//!
//! Trials of one seed share forces, split and initial weights; trials of one placement share sensors. The *units* of inference
//! are therefore seeds and placements, crossed; only seeds, if each seed has its own placements. A kind with at least four
//! units is resampled. A kind with fewer is held fixed, and results are valid for its units only. The variance of a statistic θ
//! is
//! ```text
//! V = Σ_kinds V_k − Σ_pairs V_kl + …,   V_k = (n−1)/n Σ (θ₋ᵢ − θ̄₋)²   by leaving out one unit at a time
//! ```
//! (Cameron, Gelbach and Miller 2011), with Student's t and Satterthwaite's degrees of freedom. Votes are by bootstrap.

use std::collections::BTreeMap;

use super::numbers::distinct;
use super::trial::Cluster;
use metasense_numerics::random::Draw;
use metasense_numerics::student::{chance_above, student, student_above};

/// Smallest number of units that are resampled; leaving one of three out hardly estimates the spread.
pub const LEAST_UNITS: usize = 4;

/// Number of bootstrap replicates. If there are at most as many ways to draw, each is used once.
pub const REPLICATES: usize = 1000;

/// Seed of all bootstraps, so that repeated analyses agree.
pub const SEED: u64 = 1;

/// A 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// Lower end: in 2.5 % of cases the true value is below.
    pub low: f64,
    /// Upper end: in 2.5 % of cases the true value is above.
    pub high: f64,
}

impl Interval {
    /// Applies an increasing function to both ends.
    pub fn map(self, f: impl Fn(f64) -> f64) -> Self {
        Self { low: f(self.low), high: f(self.high) }
    }

    /// Whether the interval of a ratio is entirely above 1, or below; `None` if it contains 1.
    pub fn is_above_one(self) -> Option<bool> {
        (self.low > 1.0 || self.high < 1.0).then_some(self.low > 1.0)
    }
}

/// Name of placements as units: singular, plural.
pub const PLACEMENTS: [&str; 2] = ["placement", "placements"];
/// Name of seeds as units: singular, plural.
pub const SEEDS: [&str; 2] = ["seed", "seeds"];

/// The same if each seed has its own placements.
const OWN_PLACEMENTS: [&str; 2] = ["seed with its own placements", "seeds, each with its own placements"];

/// A kind of unit: its name (singular, plural), the number of units, and the unit of each trial.
#[derive(Debug, Clone)]
struct Kind {
    name: [&'static str; 2],
    count: usize,
    of_trial: Vec<usize>,
}

/// The units of some trials, for jackknife and bootstrap.
#[derive(Debug, Clone)]
pub struct Resampling {
    trials: usize,
    kinds: Vec<Kind>,
}

impl Resampling {
    /// Units are placements and seeds; one entry per trial.
    pub fn new(clusters: &[Cluster]) -> Self {
        let of = |pick: fn(&Cluster) -> u64| clusters.iter().map(pick).collect::<Vec<u64>>();
        let (placements, seeds) = (of(|c| c.placement), of(|c| c.seed));
        let count = |of: &[u64]| distinct(of.iter().copied()).len();
        let several = distinct(clusters.iter().copied()).len();
        let enough = count(&seeds) >= LEAST_UNITS || count(&seeds) == several;
        if several > 1 && count(&placements) == several && enough {
            return Self::over_units([(OWN_PLACEMENTS, seeds)]);
        }
        Self::over_units([(PLACEMENTS, placements), (SEEDS, seeds)])
    }

    /// Other kinds of units: a name, and the unit of each trial.
    pub fn over_units(kinds: impl IntoIterator<Item = ([&'static str; 2], Vec<u64>)>) -> Self {
        let kind = |(name, of_trial): ([&'static str; 2], Vec<u64>)| {
            let values = distinct(of_trial.iter().copied());
            let find = |value| values.binary_search(value).expect("collected above");
            Kind { name, count: values.len(), of_trial: of_trial.iter().map(find).collect() }
        };
        let kinds: Vec<Kind> = kinds.into_iter().map(kind).collect();
        Self { trials: kinds.first().map_or(0, |k| k.of_trial.len()), kinds }
    }

    fn resampled_kinds(&self) -> Vec<&Kind> {
        self.kinds.iter().filter(|k| k.count >= LEAST_UNITS).collect()
    }

    /// Whether any kind has enough units for intervals.
    pub fn has_enough_units(&self) -> bool {
        !self.resampled_kinds().is_empty()
    }

    /// Describes the units of an interval or vote: `5 placements`, `6 placements at 2 seeds`,
    /// `no interval, too few units: 3 seeds`.
    pub fn over(&self) -> String {
        let list = |kinds: &[&Kind]| -> String {
            let each = kinds.iter().map(|k| format!("{} {}", k.count, k.name[usize::from(k.count > 1)]));
            each.collect::<Vec<_>>().join(" × ")
        };
        let held: Vec<&Kind> = self.kinds.iter().filter(|k| (2..LEAST_UNITS).contains(&k.count)).collect();
        match (self.has_enough_units(), held.is_empty()) {
            (true, true) => list(&self.resampled_kinds()),
            (true, false) => format!("{} at {}", list(&self.resampled_kinds()), list(&held)),
            (false, false) => format!("no interval, too few units: {}", list(&held)),
            (false, true) => {
                format!("no interval, too few units: {}", list(&self.kinds.iter().collect::<Vec<_>>()))
            }
        }
    }

    /// Unit of each trial, for the resampled kind with the fewest units; `None` if no kind has enough.
    pub fn units(&self) -> Option<&[usize]> {
        self.resampled_kinds().into_iter().min_by_key(|k| k.count).map(|k| &k.of_trial[..])
    }

    /// Weights of 1 for every trial.
    pub(super) fn equal_weights(&self) -> Vec<f64> {
        vec![1.0; self.trials]
    }

    /// Weights of the trials in a replicate. Of n units, n − 1 are drawn with replacement, so that the variance of a mean is
    /// unbiased (Rao and Wu 1988).
    pub fn weights(&self, replicate: usize) -> Vec<f64> {
        let mut draw = Draw::numbered(SEED, replicate as u64);
        self.weighed(|count| draw.below(count))
    }

    /// The same with a function that draws a number below its argument.
    fn weighed(&self, mut below: impl FnMut(usize) -> usize) -> Vec<f64> {
        let mut weights = self.equal_weights();
        for kind in self.resampled_kinds() {
            let mut counts = vec![0.0; kind.count];
            for _ in 1..kind.count {
                counts[below(kind.count)] += kind.count as f64 / (kind.count - 1) as f64;
            }
            for (weight, unit) in weights.iter_mut().zip(&kind.of_trial) {
                *weight *= counts[*unit];
            }
        }
        weights
    }

    /// Returns a statistic of every replicate, in order, without those that lack it. Empty with too few units.
    pub fn replicates<T>(&self, statistic: impl FnMut(Vec<f64>) -> Option<T>) -> Vec<T> {
        if !self.has_enough_units() {
            return Vec::new();
        }
        let ways = self.resampled_kinds().iter().fold(1usize, |ways, kind| {
            ways.saturating_mul(kind.count.saturating_pow((kind.count - 1) as u32))
        });
        if ways > REPLICATES {
            return (0..REPLICATES).map(|r| self.weights(r)).filter_map(statistic).collect();
        }
        let way = |mut number: usize| {
            self.weighed(|count| {
                let drawn = number % count;
                number /= count;
                drawn
            })
        };
        (0..ways).map(way).filter_map(statistic).collect()
    }

    /// Returns a statistic of all trials, and with each unit left out. `None` with too few units, or if a statistic is missing.
    pub fn jackknife<T>(&self, mut statistic: impl FnMut(&[f64]) -> Option<T>) -> Option<Jackknife<T>> {
        let drawn = self.resampled_kinds();
        let fewest = drawn.iter().map(|k| k.count).min()?;
        let whole = statistic(&self.equal_weights())?;
        let mut parts = Vec::new();
        for chosen in 1usize..1 << drawn.len() {
            let kinds: Vec<&&Kind> =
                (0..drawn.len()).filter(|i| chosen >> i & 1 == 1).map(|i| &drawn[i]).collect();
            let unit = |trial: usize| kinds.iter().fold(0, |unit, k| unit * k.count + k.of_trial[trial]);
            let mut members: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
            (0..self.trials).for_each(|trial| members.entry(unit(trial)).or_default().push(trial));
            let mut weights = self.equal_weights();
            let mut without = |members: &Vec<usize>| {
                members.iter().for_each(|&trial| weights[trial] = 0.0);
                let found = statistic(&weights);
                members.iter().for_each(|&trial| weights[trial] = 1.0);
                found
            };
            let left_out = members.values().map(&mut without).collect::<Option<Vec<T>>>()?;
            parts.push((kinds.len(), left_out));
        }
        Some(Jackknife { whole, fewest, parts })
    }

    /// Returns the 95 % interval of a statistic of weighted trials.
    pub fn interval(&self, statistic: impl FnMut(&[f64]) -> Option<f64>) -> Option<Interval> {
        self.judged(statistic).map(|judged| judged.interval)
    }

    /// Returns interval, p-value and detectable value of a statistic with the null value 0.
    pub fn judged(&self, statistic: impl FnMut(&[f64]) -> Option<f64>) -> Option<Inference> {
        self.jackknife(statistic)?.judged(|x| *x)
    }
}

/// Inference on a statistic with the null value 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inference {
    /// The 95 % interval.
    pub interval: Interval,
    /// Two-sided p-value.
    pub chance: f64,
    /// True value that the interval would distinguish from 0 with a power of 80 %: t.975 + t.8 standard errors.
    pub tells: f64,
}

/// A statistic with units left out one at a time, for each kind and each crossing of kinds.
#[derive(Debug, Clone, PartialEq)]
pub struct Jackknife<T> {
    /// Statistic of all trials.
    pub whole: T,
    fewest: usize,
    parts: Vec<(usize, Vec<T>)>,
}

impl<T> Jackknife<T> {
    /// Returns the 95 % interval of a function of the statistic.
    pub fn interval(&self, number: impl Fn(&T) -> f64) -> Option<Interval> {
        self.judged(number).map(|judged| judged.interval)
    }

    fn judged(&self, number: impl Fn(&T) -> f64) -> Option<Inference> {
        let (mut variance, mut most, mut squares) = (0.0, 0.0f64, 0.0);
        for (kinds, left_out) in &self.parts {
            let values: Vec<f64> = left_out.iter().map(&number).collect();
            let n = values.len() as f64;
            let mean = values.iter().sum::<f64>() / n;
            let part = (n - 1.0) / n * values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
            if *kinds == 1 {
                most = most.max(part);
                squares += part * part / (n - 1.0);
            }
            variance += if kinds % 2 == 1 { part } else { -part };
        }
        let (whole, variance) = (number(&self.whole), variance.max(most));
        let freedom = if squares > 0.0 { variance * variance / squares } else { 0.0 };
        let freedom = freedom.max((self.fewest - 1) as f64);
        let between = |of: &dyn Fn(usize) -> f64| {
            let [below, above] = [freedom.floor(), freedom.ceil()].map(|f| of(f as usize));
            below + (freedom - freedom.floor()) * (above - below)
        };
        let half = between(&student) * variance.sqrt();
        let tells = half + between(&|freedom| student_above(freedom, 0.2)) * variance.sqrt();
        let t = if whole == 0.0 { 0.0 } else { whole.abs() / variance.sqrt() };
        let chance = 2.0 * between(&|freedom| chance_above(freedom, t));
        let interval = Interval { low: whole - half, high: whole + half };
        (whole.is_finite() && half.is_finite()).then_some(Inference { interval, chance, tells })
    }
}

/// Returns p-values adjusted for multiple tests (Holm, Scand. J. Stat. 6, 1979), in the order of `chances`.
pub fn holm(chances: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..chances.len()).collect();
    order.sort_by(|a, b| chances[*a].total_cmp(&chances[*b]));
    let (mut corrected, mut most) = (vec![0.0; chances.len()], 0.0f64);
    for (rank, i) in order.into_iter().enumerate() {
        most = most.max((chances.len() - rank) as f64 * chances[i]).min(1.0);
        corrected[i] = most;
    }
    corrected
}

#[cfg(test)]
mod tests;
