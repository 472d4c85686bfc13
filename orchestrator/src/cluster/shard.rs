//! Shards and their notation.

use std::fmt;
use std::str::FromStr;

/// Shard `index` of `count`, from 1; written as `3/10`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Shard {
    index: u32,
    count: u32,
}

/// Not a shard.
#[derive(Debug, Clone, thiserror::Error, PartialEq, Eq)]
#[error("{0:?} is not a shard: use I/N, with I from 1 to N, such as 3/10")]
pub struct ShardError(String);

impl Shard {
    /// Most shards of a sweep.
    pub const MOST: u32 = 100_000;

    /// Shard `index`, from 1, of `count`; `None` if it does not exist.
    pub fn new(index: u32, count: u32) -> Option<Self> {
        (1 <= index && index <= count && count <= Self::MOST).then_some(Self { index, count })
    }

    /// Number of the shard, from 1.
    pub fn index(self) -> u32 {
        self.index
    }

    /// Number of shards.
    pub fn count(self) -> u32 {
        self.count
    }

    /// Start of the names of its files: `shard-3-of-10`.
    pub fn file_stem(self) -> String {
        format!("shard-{}-of-{}", self.index, self.count)
    }

    /// The shard of a file name such as `shard-3-of-10.sqlite`.
    pub fn of_file(name: &str) -> Option<Self> {
        let (index, count) = name.split('.').next()?.strip_prefix("shard-")?.split_once("-of-")?;
        Self::new(index.parse().ok()?, count.parse().ok()?)
    }
}

/// Formats sorted numbers as ranges for schedulers: `1-3,7`.
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
mod tests;
