//! Counter-based random streams: a draw depends only on its key, not on earlier draws.
//!
//! A stream is ChaCha8 keyed by (purpose, seed, two counters). Trials of equal seed and K therefore share forces and split.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Purpose of a stream. Streams of different purposes share no draws.
///
/// One stream of `Stimulus` has two uses: it selects the panel of a recorded force and that of an irregular blow. In a mixture of both,
/// these panels are dependent where record and sample have the same number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u64)]
pub enum Purpose {
    /// Parameters of a force history; counters: sample, panel.
    Stimulus = 1,
    /// Force histories of the held-out set; counters: sample, panel.
    Holdout = 2,
    /// Fresh samples of the `joint` protocol; counters: sample, panel.
    Fresh = 3,
    /// The split into training and test set.
    Split = 4,
    /// Initial weights of a network; counters: network, layer.
    Weights = 5,
    /// Sensor placements; counters: placement, number of units.
    Placement = 6,
    /// Subsets and batches; counters: outer step, inner step.
    Batch = 7,
    /// Random designs; counters: design, attempt.
    Design = 8,
    /// Noise and bias of sensors; counters: history of the sample, channel.
    Chip = 9,
    /// Candidates of a search without gradient; counters: candidate, unused.
    Search = 10,
    /// Casts of a body; counters: use and number of the cast, material or mould.
    Cast = 11,
    /// Position of a blow; counters: purpose and number of the sample, panel.
    Strike = 12,
    /// Random drive of a body; counters: drive, unused.
    Drive = 13,
}

/// A source of random bits.
pub trait Bits {
    /// The next 64 bits.
    fn next(&mut self) -> u64;
}

impl Bits for ChaCha8Rng {
    fn next(&mut self) -> u64 {
        self.next_u64()
    }
}

/// A small generator (SplitMix64, Steele, Lea and Flood 2014).
#[derive(Debug, Clone)]
pub struct SplitMix(u64);

impl Bits for SplitMix {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
}

/// A stream of random numbers, addressed by its key.
#[derive(Debug, Clone)]
pub struct Stream<B = ChaCha8Rng>(B);

/// A stream for bootstrap draws.
pub type Draw = Stream<SplitMix>;

impl Draw {
    /// The stream of this seed and number, at its beginning.
    pub fn numbered(seed: u64, number: u64) -> Self {
        let mut bits = SplitMix(seed);
        bits.0 = bits.next() ^ number.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        bits.next();
        Self(bits)
    }
}

impl Stream {
    /// The stream of this key, at its beginning.
    pub fn new(purpose: Purpose, seed: u64, counters: [u64; 2]) -> Self {
        let mut key = [0; 32];
        for (bytes, word) in key.chunks_exact_mut(8).zip([purpose as u64, seed, counters[0], counters[1]]) {
            bytes.copy_from_slice(&word.to_le_bytes());
        }
        Self(ChaCha8Rng::from_seed(key))
    }
}

impl<B: Bits> Stream<B> {
    /// Uniform in [0, 1), 53 bits.
    pub fn uniform(&mut self) -> f64 {
        (self.0.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in [least, most).
    pub fn between(&mut self, [least, most]: [f64; 2]) -> f64 {
        least + (most - least) * self.uniform()
    }

    /// Standard normal (Box and Muller 1958; one of the pair).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    /// Uniform in 0…n−1.
    pub fn below(&mut self, n: usize) -> usize {
        ((u128::from(self.0.next()) * n as u128) >> 64) as usize
    }

    /// A uniform random permutation of 0…n−1 (Fisher and Yates).
    pub fn permutation(&mut self, n: usize) -> Vec<usize> {
        let mut order: Vec<usize> = (0..n).collect();
        for i in (1..n).rev() {
            order.swap(i, self.below(i + 1));
        }
        order
    }
}
