//! Which trials a shard runs: those whose hash, as a number, leaves its remainder. The same for any number of tries, and
//! for any other trials of the sweep.

use std::fmt;
use std::str::FromStr;

use crate::plan::{Plan, Trial};

/// Shard `index` of `count`, counted from 1; written `3/10`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Shard {
    index: u32,
    count: u32,
}

/// Not a shard.
#[derive(Debug, Clone, thiserror::Error, PartialEq, Eq)]
#[error("{0:?} is not a shard: say I/N, with I from 1 to N, for instance 3/10")]
pub struct ShardError(String);

impl Shard {
    /// Most shards of a sweep.
    pub const MOST: u32 = 100_000;

    /// Shard `index`, from 1, of `count`; none where there is no such shard.
    #[must_use]
    pub fn new(index: u32, count: u32) -> Option<Self> {
        (1 <= index && index <= count && count <= Self::MOST).then_some(Self { index, count })
    }

    /// Its number, from 1.
    #[must_use]
    pub fn index(self) -> u32 {
        self.index
    }

    /// How many there are.
    #[must_use]
    pub fn count(self) -> u32 {
        self.count
    }

    /// Whether a trial belongs to it.
    #[must_use]
    pub fn holds(self, hash: &str) -> bool {
        index(hash, self.count) == self.index
    }

    /// Leaves a plan only its own trials, in their places.
    pub fn restrict(self, plan: &mut Plan) {
        plan.trials.retain(|trial| self.holds(&trial.hash));
    }

    /// Name of its files: `shard-3-of-10`.
    #[must_use]
    pub fn file_stem(self) -> String {
        format!("shard-{}-of-{}", self.index, self.count)
    }
}

/// Number, from 1, of the shard of `count` that a trial belongs to.
#[must_use]
pub fn index(hash: &str, count: u32) -> u32 {
    // 64 bits of a cryptographic hash: every remainder is as likely as any other.
    let digits = hash.get(..16).unwrap_or(hash);
    let number = u64::from_str_radix(digits, 16).unwrap_or_else(|_| panic!("{hash} is no trial's hash"));
    (number % u64::from(count)) as u32 + 1
}

/// Estimated core-seconds of each shard of `count`.
#[must_use]
pub fn costs(trials: &[Trial], count: u32) -> Vec<f64> {
    let mut costs = vec![0.0; count as usize];
    for trial in trials {
        costs[index(&trial.hash, count) as usize - 1] += trial.cost;
    }
    costs
}

/// Numbers in runs, as schedulers take them: `1-3,7`.
#[must_use]
pub fn ranges(numbers: &[u32]) -> String {
    let mut runs: Vec<(u32, u32)> = Vec::new();
    for &n in numbers {
        match runs.last_mut() {
            Some((_, last)) if *last + 1 == n => *last = n,
            _ => runs.push((n, n)),
        }
    }
    let text = |(a, b): &(u32, u32)| if a == b { a.to_string() } else { format!("{a}-{b}") };
    runs.iter().map(text).collect::<Vec<_>>().join(",")
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

impl FromStr for Shard {
    type Err = ShardError;

    fn from_str(text: &str) -> Result<Self, ShardError> {
        let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        parts.and_then(|(index, count)| Self::new(index, count)).ok_or_else(|| ShardError(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_shard_is_refused() {
        for text in ["", "3", "0/3", "4/3", "1/0", "-1/3", "1/3/5", "1/1000000"] {
            assert_eq!(text.parse::<Shard>(), Err(ShardError(text.into())), "{text}");
        }
        assert_eq!("3/10".parse::<Shard>().unwrap().to_string(), "3/10");
    }

    #[test]
    fn numbers_are_written_in_runs() {
        assert_eq!(ranges(&[1, 2, 3, 7, 9, 10]), "1-3,7,9-10");
        assert_eq!(ranges(&[]), "");
    }

    /// Hashes spread evenly by construction; a multiplicative sequence stands for them.
    #[test]
    fn each_trial_is_in_one_shard_and_shards_are_even() {
        let hash = |i: u64| format!("{:016x}{i:016x}", i.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        for count in [1, 3, 10] {
            let shards: Vec<Shard> = (1..=count).map(|i| Shard::new(i, count).unwrap()).collect();
            let mut sizes = vec![0_usize; count as usize];
            for i in 0..3000 {
                let holders: Vec<_> = shards.iter().filter(|s| s.holds(&hash(i))).collect();
                assert_eq!(holders.len(), 1, "{i} of {count}: {holders:?}");
                sizes[holders[0].index() as usize - 1] += 1;
            }
            let even = 3000 / count as usize;
            assert!(sizes.iter().all(|n| n.abs_diff(even) < even / 5 + 1), "{sizes:?}");
        }
    }
}
