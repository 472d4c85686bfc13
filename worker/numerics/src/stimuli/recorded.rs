//! Resamples recorded histories: linearly for simulations, with a low-pass for targets.
//!
//! Simulations take f as linear between instants, so `resample` onto a sufficiently fine clock (`Scene::instants`) is exact.
//! Targets have T instants, so `anti_aliased` first removes frequencies above half their rate: a sinc in a Kaiser window (β = 8,
//! stopband −80 dB), normalised at zero frequency. `anti_aliased_force` keeps forces within the sample; a plain low-pass would move half of a
//! blow at the start to before it.

use std::sync::Arc;

use super::split;
use crate::dynamics::Forces;
use crate::random::{Purpose, Stream};

/// Records on the clock of the forces, and how samples are made from them.
///
/// A seeded shuffle deals them to training and test set, then to the held-out set. Fresh samples are training records times a
/// factor, shifted by whole instants.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedForces {
    /// Histories: of all panels, or of one panel that `struck` or a random draw determines.
    pub histories: Arc<Forces>,
    /// Panel that each record strikes, for records of one history.
    pub struck: Option<Vec<usize>>,
    /// Interval of the factor of fresh samples.
    pub scale: [f64; 2],
    /// Interval of their shift (s).
    pub shift: [f64; 2],
    /// Whether targets pass a low-pass to their clock.
    pub low_pass: bool,
}

/// How records are divided into sets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RecordSplit {
    /// Seed of the split.
    pub seed: u64,
    /// Number of records for training and test set.
    pub samples: usize,
    /// Size of the test set.
    pub test: usize,
    /// Whether the test set is drawn with replacement.
    pub replacement: bool,
}

impl RecordedForces {
    /// `count` samples of a purpose, from number `first`.
    ///
    /// # Panics
    /// If there are too few records.
    pub fn forces(
        &self,
        deal: RecordSplit,
        purpose: Purpose,
        first: u64,
        count: usize,
        panels: usize,
        duration: f64,
    ) -> Forces {
        let RecordSplit { seed, samples, test, replacement } = deal;
        let order = Stream::new(Purpose::Split, seed, [self.histories.samples as u64, 1])
            .permutation(self.histories.samples);
        let instants = self.histories.instants;
        let mut values = Vec::with_capacity(count * panels * (instants + 1));
        let training = match purpose {
            Purpose::Fresh => split(seed, samples, test, replacement).0,
            _ => Vec::new(),
        };
        for number in first..first + count as u64 {
            let n = number as usize;
            match purpose {
                Purpose::Holdout => self.add(order[samples + n], deal, panels, 1.0, 0, &mut values),
                Purpose::Fresh => {
                    let mut stream = Stream::new(Purpose::Fresh, seed, [number, 0]);
                    let record = order[training[stream.below(training.len())]];
                    let factor = stream.between(self.scale);
                    let shift = (stream.between(self.shift) * instants as f64 / duration).round() as i64;
                    self.add(record, deal, panels, factor, shift, &mut values);
                }
                _ => self.add(order[n], deal, panels, 1.0, 0, &mut values),
            }
        }
        Forces { samples: count, panels, instants, values, strikes: Vec::new() }
    }

    /// Appends a record, with its histories at their panels.
    fn add(
        &self,
        record: usize,
        deal: RecordSplit,
        panels: usize,
        factor: f64,
        shift: i64,
        values: &mut Vec<f64>,
    ) {
        let held = self.histories.panels;
        let struck = match &self.struck {
            Some(struck) => struck[record],
            None => Stream::new(Purpose::Stimulus, deal.seed, [record as u64, u64::MAX]).below(panels),
        };
        for panel in 0..panels {
            let history = match held {
                1 if panel != struck => None,
                1 => Some(0),
                _ => Some(panel),
            };
            let clock = self.histories.instants + 1;
            let source = history.map(|h| &self.histories.sample(record)[h * clock..][..clock]);
            values.extend((0..clock as i64).map(|n| {
                let before = usize::try_from(n - shift).ok();
                source.and_then(|f| f.get(before?)).map_or(0.0, |f| factor * f)
            }));
        }
    }
}

/// f at t_n = n·duration/T, n = 0…T, from a record with entry i at `start` + i·`dt`: linear interpolation, zero outside.
pub fn resample(record: &[f64], start: f64, dt: f64, duration: f64, instants: usize) -> Vec<f64> {
    (0..=instants)
        .map(|n| interpolate(record, (n as f64 * duration / instants as f64 - start) / dt))
        .collect()
}

/// The record at the fractional entry `s`.
fn interpolate(record: &[f64], s: f64) -> f64 {
    // Rounds positions that differ from an entry by rounding error.
    let s = if (s - s.round()).abs() < 1e-9 { s.round() } else { s };
    if record.is_empty() || s < 0.0 || s > (record.len() - 1) as f64 {
        return 0.0;
    }
    let i = (s.floor() as usize).min(record.len().saturating_sub(2));
    let w = s - i as f64;
    let next = record.get(i + 1).copied().unwrap_or(0.0);
    (1.0 - w) * record[i] + w * next
}

/// Half-width of the low-pass window (instants).
pub const REACH: f64 = 12.0;
const BETA: f64 = 8.0;

/// Low-pass of a clock: weights of a record's entries around an instant.
struct LowPass {
    /// Position of instant 0, and distance between instants (entries).
    origin: f64,
    delta: f64,
    /// Distance of an instant from its first weight, and the weights; reused while the clocks stay in step.
    known: (f64, Vec<f64>),
}

impl LowPass {
    fn new(origin: f64, delta: f64) -> Self {
        Self { origin, delta, known: (0.0, Vec::new()) }
    }

    /// Filtered value at instant n of the entries that `entry` returns.
    fn filtered_value(&mut self, n: usize, entry: impl Fn(i64) -> f64) -> f64 {
        let (centre, reach) = (self.origin + n as f64 * self.delta, REACH * self.delta);
        let first = (centre - reach).ceil();
        if self.known.1.is_empty() || (centre - first - self.known.0).abs() > 1e-9 {
            let last = (centre + reach).floor();
            let weights: Vec<f64> =
                (0..=(last - first) as i64).map(|i| self.weight(first + i as f64 - centre)).collect();
            let total: f64 = weights.iter().sum();
            self.known = (centre - first, weights.into_iter().map(|w| w / total).collect());
        }
        self.known.1.iter().enumerate().map(|(i, w)| w * entry(first as i64 + i as i64)).sum()
    }

    fn weight(&self, offset: f64) -> f64 {
        let z = offset / self.delta;
        let inside = 1.0 - (z / REACH).powi(2);
        if inside <= 0.0 {
            return 0.0;
        }
        let sinc = if z == 0.0 { 1.0 } else { (std::f64::consts::PI * z).sin() / (std::f64::consts::PI * z) };
        sinc * bessel(BETA * inside.sqrt())
    }
}

/// As [`resample`], without frequencies above half the rate T/duration. A record on a coarser clock is interpolated linearly.
pub fn anti_aliased(record: &[f64], start: f64, dt: f64, duration: f64, instants: usize) -> Vec<f64> {
    let delta = duration / instants as f64;
    if dt >= delta {
        return resample(record, start, dt, duration, instants);
    }
    let mut low_pass = LowPass::new(-start / dt, delta / dt);
    let entry = |i: i64| usize::try_from(i).ok().and_then(|i| record.get(i)).copied().unwrap_or(0.0);
    (0..=instants).map(|n| low_pass.filtered_value(n, entry)).collect()
}

/// As [`anti_aliased`], for a force: what acts from 0 to `duration` stays in the sample.
pub fn anti_aliased_force(record: &[f64], start: f64, dt: f64, duration: f64, instants: usize) -> Vec<f64> {
    let delta = duration / instants as f64;
    if dt >= delta {
        return resample(record, start, dt, duration, instants);
    }
    let origin = -start / dt;
    let mut low_pass = LowPass::new(origin, delta / dt);
    // Force at instant 0, from earlier entries only.
    let beginning = low_pass.filtered_value(0, |i| interpolate(record, origin - (origin - i as f64).abs()));
    mirrored_low_pass(record, start, dt, duration, instants, beginning)
}

/// Low-pass of a force that is mirrored at both ends of the sample, so that no impulse leaves it. Instant 0 has no target: its
/// force is set to `beginning`, and the excess impulse moves to instant 1.
pub(super) fn mirrored_low_pass(
    record: &[f64],
    start: f64,
    dt: f64,
    duration: f64,
    instants: usize,
    beginning: f64,
) -> Vec<f64> {
    let (origin, length) = (-start / dt, duration / dt);
    let mut low_pass = LowPass::new(origin, length / instants as f64);
    let mirrored = |i: i64| {
        let after = i as f64 - origin;
        if (0.0..=length).contains(&after) {
            return interpolate(record, i as f64);
        }
        let turned = after.rem_euclid(2.0 * length);
        interpolate(record, origin + turned.min(2.0 * length - turned))
    };
    let mut values: Vec<f64> = (0..=instants).map(|n| low_pass.filtered_value(n, mirrored)).collect();
    values[1] += 0.5 * (values[0] - beginning);
    values[0] = beginning;
    values
}

/// I₀, the modified Bessel function of order 0, by its series.
fn bessel(x: f64) -> f64 {
    let (mut sum, mut term) = (1.0, 1.0);
    for k in 1..60 {
        term *= (0.5 * x / f64::from(k)).powi(2);
        sum += term;
        if term < 1e-17 * sum {
            break;
        }
    }
    sum
}

#[cfg(test)]
mod tests;
