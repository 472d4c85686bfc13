//! Bootstrap over placements and seeds.
//!
//! A replicate draws as many placements and as many seeds as there are, with replacement, each list by itself; the
//! trial of placement p and seed s then counts (times p was drawn) × (times s was drawn). Replicates are
//! numbered, and a draw depends on (seed, replicate, position) alone. Intervals are percentile intervals (Efron 1979):
//! with a handful of placements they are too narrow rather than too wide.

use super::Cluster;

/// Replicates of a bootstrap.
pub const REPLICATES: usize = 1000;

/// The seed of all bootstraps, so that an analysis repeated gives the same numbers.
pub const SEED: u64 = 1;

/// Ends of a 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// 2.5 % quantile.
    pub low: f64,
    /// 97.5 % quantile.
    pub high: f64,
}

impl Interval {
    /// The interval between the 2.5 % and 97.5 % quantiles of finite values; `None` of fewer than twenty.
    #[must_use]
    pub fn of(mut values: Vec<f64>) -> Option<Self> {
        values.retain(|v| v.is_finite());
        if values.len() < 20 {
            return None;
        }
        values.sort_by(f64::total_cmp);
        Some(Self { low: quantile(&values, 0.025), high: quantile(&values, 0.975) })
    }

    /// Both ends through an increasing function.
    #[must_use]
    pub fn map(self, f: impl Fn(f64) -> f64) -> Self {
        Self { low: f(self.low), high: f(self.high) }
    }
}

/// Linear interpolation between order statistics of sorted values.
///
/// # Panics
/// If there are none.
#[must_use]
pub fn quantile(sorted: &[f64], q: f64) -> f64 {
    assert!(!sorted.is_empty(), "a quantile of nothing");
    let at = q * (sorted.len() - 1) as f64;
    let below = at.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (at - below as f64) * (sorted[above] - sorted[below])
}

/// The clusters of some trials, ready to be drawn anew.
#[derive(Debug, Clone)]
pub struct Resampling {
    placements: Vec<u64>,
    seeds: Vec<u64>,
    of_trial: Vec<(usize, usize)>,
}

impl Resampling {
    /// One entry a trial.
    #[must_use]
    pub fn new(clusters: &[Cluster]) -> Self {
        let sorted = |pick: fn(&Cluster) -> u64| {
            let mut values: Vec<u64> = clusters.iter().map(pick).collect();
            values.sort_unstable();
            values.dedup();
            values
        };
        let (placements, seeds) = (sorted(|c| c.placement), sorted(|c| c.seed));
        let find = |list: &[u64], value| list.binary_search(&value).expect("collected above");
        let of_trial =
            clusters.iter().map(|c| (find(&placements, c.placement), find(&seeds, c.seed))).collect();
        Self { placements, seeds, of_trial }
    }

    /// Whether there is more than one cluster to draw from.
    #[must_use]
    pub fn is_possible(&self) -> bool {
        self.placements.len() > 1 || self.seeds.len() > 1
    }

    /// How often each trial counts in a replicate.
    #[must_use]
    pub fn weights(&self, replicate: usize) -> Vec<f64> {
        let mut draw = Draw::new(SEED, replicate as u64);
        let placements = counts(self.placements.len(), &mut draw);
        let seeds = counts(self.seeds.len(), &mut draw);
        self.of_trial.iter().map(|&(p, s)| placements[p] * seeds[s]).collect()
    }

    /// A statistic of every replicate, in their order; replicates without one are left out.
    pub fn replicates<T>(&self, statistic: impl FnMut(Vec<f64>) -> Option<T>) -> Vec<T> {
        if !self.is_possible() {
            return Vec::new();
        }
        (0..REPLICATES).map(|r| self.weights(r)).filter_map(statistic).collect()
    }
}

fn counts(n: usize, draw: &mut Draw) -> Vec<f64> {
    let mut counts = vec![0.0; n];
    for _ in 0..n {
        counts[draw.below(n)] += 1.0;
    }
    counts
}

/// A small stream of random numbers (SplitMix64, Steele, Lea and Flood 2014).
#[derive(Debug, Clone)]
pub struct Draw(u64);

impl Draw {
    /// The stream of this seed and number.
    #[must_use]
    pub fn new(seed: u64, number: u64) -> Self {
        let mut draw = Self(seed);
        draw.0 = draw.next() ^ number.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        draw.next();
        draw
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in 0…n−1.
    pub fn below(&mut self, n: usize) -> usize {
        ((u128::from(self.next()) * n as u128) >> 64) as usize
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Standard normal (Box and Muller 1958; one of the pair).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(placements: u64, seeds: u64) -> Vec<Cluster> {
        (0..placements)
            .flat_map(|placement| (0..seeds).map(move |seed| Cluster { placement, seed }))
            .collect()
    }

    #[test]
    fn a_replicate_draws_as_many_placements_and_seeds_as_there_are() {
        let resampling = Resampling::new(&grid(5, 3));
        for replicate in 0..50 {
            let weights = resampling.weights(replicate);
            assert_eq!(weights.iter().sum::<f64>(), 15.0, "replicate {replicate}: {weights:?}");
        }
        assert_ne!(resampling.weights(0), resampling.weights(1));
        assert_eq!(resampling.weights(7), Resampling::new(&grid(5, 3)).weights(7));
    }

    #[test]
    fn one_cluster_gives_no_replicates() {
        assert!(Resampling::new(&grid(1, 1)).replicates(Some).is_empty());
    }

    /// Mean 0, variance 1 and quantiles of 20 000 draws.
    #[test]
    fn the_interval_of_normal_draws_is_that_of_the_normal_distribution() {
        let mut draw = Draw::new(3, 5);
        let values: Vec<f64> = (0..20_000).map(|_| draw.normal()).collect();
        let mean = values.iter().sum::<f64>() / 2e4;
        let interval = Interval::of(values).unwrap();
        assert!(mean.abs() < 0.03, "{mean}");
        assert!((interval.low + 1.96).abs() < 0.08 && (interval.high - 1.96).abs() < 0.08, "{interval:?}");
    }
}
