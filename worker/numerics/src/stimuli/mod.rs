//! Force histories: random bell pulses per sample and panel, hammer blows, records; the split into training and test set.
//!
//! ```text
//! z = (t − O)/W in (0, 1):  f = A sin(π z^κ)^q,  κ = ln ½ / ln p      else f = 0
//! ```
//! Samples are at t_n = n·duration/T, n = 0…T. f is linear in between; simulations use nothing else.

mod irregular;
mod recorded;

use std::ops::Range;

use crate::dynamics::{Forces, Panel, Strike};
use crate::random::{Purpose, Stream};
pub use irregular::{Irregular, irregular};
use recorded::mirrored_low_pass;
pub use recorded::{REACH, RecordSplit, RecordedForces, anti_aliased, anti_aliased_force, resample};

/// Intervals `[min, max]` of the uniform distributions of a bell pulse's parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bell {
    /// A (N).
    pub amplitude: [f64; 2],
    /// W (s).
    pub width: [f64; 2],
    /// O (s).
    pub onset: [f64; 2],
    /// Peak position p, relative to the width, in (0, 1).
    pub peak: [f64; 2],
    /// Power q.
    pub power: [f64; 2],
}

impl Bell {
    /// Number of parameters of a pulse.
    pub const PARAMETERS: usize = 5;

    /// The pulse whose parameters have these relative positions in their intervals, in the order of the fields.
    pub fn pulse(&self, [a, w, o, p, q]: [f64; Self::PARAMETERS]) -> Pulse {
        let between = |[least, most]: [f64; 2], part: f64| least + (most - least) * part;
        Pulse {
            amplitude: between(self.amplitude, a),
            width: between(self.width, w),
            onset: between(self.onset, o),
            peak: between(self.peak, p),
            power: between(self.power, q),
        }
    }

    fn draw(&self, stream: &mut Stream) -> Pulse {
        self.pulse(std::array::from_fn(|_| stream.uniform()))
    }
}

/// Intervals `[min, max]` of the uniform distributions of the parameters of a Gaussian pulse A exp(−(t − c)²/2σ²).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gauss {
    /// A (N).
    pub amplitude: [f64; 2],
    /// σ (s).
    pub sigma: [f64; 2],
    /// c (s).
    pub centre: [f64; 2],
}

/// Source of force histories.
#[derive(Debug, Clone, PartialEq)]
pub enum HistorySource {
    /// Bell pulses on every panel.
    Bell(Bell),
    /// Gaussian pulses on every panel.
    Gauss(Gauss),
    /// Hammer blows on one panel.
    Irregular(Irregular),
    /// Records.
    Recorded(RecordedForces),
    /// Each sample from one of these sources, drawn by their weights, which sum to 1.
    Mix(Vec<(f64, HistorySource)>),
    /// Another source, with random deviations of point and direction.
    Struck(StrikeScatter, Box<HistorySource>),
    /// Another source, with each panel silent with this probability.
    Silent(f64, Box<HistorySource>),
    /// The first panel's history of another source, at a random point of the line through the panels: see [`point`].
    Anywhere(Box<HistorySource>),
}

impl HistorySource {
    /// The sources of a mixture, or this source.
    pub fn parts(&self) -> Vec<&Self> {
        match self {
            Self::Mix(parts) => parts.iter().flat_map(|(_, part)| part.parts()).collect(),
            Self::Struck(_, source) | Self::Silent(_, source) | Self::Anywhere(source) => source.parts(),
            one => vec![one],
        }
    }

    /// Whether some part consists of records, whose number is limited.
    pub fn is_recorded(&self) -> bool {
        self.parts().iter().any(|part| matches!(part, Self::Recorded(_)))
    }
}

/// Standard deviations of blows from a panel's centroid and direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StrikeScatter {
    /// Offset across the panel's direction (mm).
    pub offset: f64,
    /// Angle (rad).
    pub angle: f64,
}

impl StrikeScatter {
    /// Deviating blows (N, K); each depends on (purpose, seed, sample, panel) only, not on the forces.
    pub fn strikes(&self, panels: &[Panel], purpose: Purpose, seed: u64, samples: Range<u64>) -> Vec<Strike> {
        let strike = |(sample, k): (u64, usize)| {
            let mut stream = Stream::new(Purpose::Strike, seed, [(purpose as u64) << 32 | sample, k as u64]);
            let [offset, angle] = [self.offset, self.angle].map(|deviation| deviation * stream.normal());
            panels[k].deviated_strike(offset, angle)
        };
        samples.flat_map(|sample| (0..panels.len()).map(move |k| (sample, k))).map(strike).collect()
    }
}

/// Which panels are silent in a sample, each with probability `silent` given that not all are; depends on (purpose, seed, sample)
/// only.
pub fn silenced(silent: f64, purpose: Purpose, seed: u64, sample: u64, panels: usize) -> Vec<bool> {
    // A counter that no kind of forces uses.
    let mut stream = Stream::new(purpose, seed, [sample, u64::MAX - 2]);
    loop {
        let mask: Vec<bool> = (0..panels).map(|_| stream.uniform() < silent).collect();
        if mask.contains(&false) {
            return mask;
        }
    }
}

/// Point of a blow between neighbouring panels, in numbers of panels: uniform from 0, the first panel, to `panels` − 1, the last.
/// Depends on (purpose, seed, sample) only.
pub fn point(purpose: Purpose, seed: u64, sample: u64, panels: usize) -> f64 {
    // A counter that no kind of forces uses.
    (panels - 1) as f64 * Stream::new(purpose, seed, [sample, u64::MAX - 3]).uniform()
}

/// Divides the force of each sample, numbered from `first`, between the two of `panels` panels beside its [`point`], in inverse
/// proportion to the distances.
pub fn spread(blows: &Forces, purpose: Purpose, seed: u64, first: u64, panels: usize) -> Forces {
    let len = blows.instants + 1;
    let mut values = vec![0.0; blows.samples * panels * len];
    for (i, histories) in values.chunks_exact_mut(panels * len).enumerate() {
        let at = point(purpose, seed, first + i as u64, panels);
        let left = (at as usize).min(panels - 2);
        for (panel, share) in [(left, left as f64 + 1.0 - at), (left + 1, at - left as f64)] {
            let history = &mut histories[panel * len..][..len];
            history.iter_mut().zip(blows.sample(i)).for_each(|(f, blow)| *f = share * blow);
        }
    }
    Forces { panels, values, strikes: Vec::new(), ..*blows }
}

/// Part of a mixture, from 0, of each of the samples numbered `samples`; depends on (purpose, seed, sample) only.
pub fn draw_parts(weights: &[f64], purpose: Purpose, seed: u64, samples: Range<u64>) -> Vec<usize> {
    let last = weights.len() - 1;
    let draw = |sample| {
        // A counter that no kind of forces uses.
        let mut left = Stream::new(purpose, seed, [sample, u64::MAX - 1]).uniform();
        let taken = |w: &f64| {
            left -= w;
            left < 0.0
        };
        weights.iter().position(taken).unwrap_or(last)
    };
    samples.map(draw).collect()
}

/// One bell pulse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pulse {
    /// A (N).
    pub amplitude: f64,
    /// W (s).
    pub width: f64,
    /// O (s).
    pub onset: f64,
    /// p.
    pub peak: f64,
    /// q.
    pub power: f64,
}

impl Pulse {
    /// f(t) in N.
    pub fn force(&self, t: f64) -> f64 {
        let z = (t - self.onset) / self.width;
        if !(z > 0.0 && z < 1.0) {
            return 0.0;
        }
        let kappa = 0.5f64.ln() / self.peak.ln();
        // At an argument rounded up to π, the sine is negative and its power NaN.
        self.amplitude * (std::f64::consts::PI * z.powf(kappa)).sin().max(0.0).powf(self.power)
    }

    /// Overwrites `history` with f(t_n), n = 0…T, where T + 1 is its length.
    pub fn history_into(&self, duration: f64, history: &mut [f64]) {
        sampled(history, duration, |t| self.force(t));
    }
}

/// Overwrites `history` with f(t_n), n = 0…T, where T + 1 is its length.
pub(super) fn sampled(history: &mut [f64], duration: f64, force: impl Fn(f64) -> f64) {
    let instants = (history.len() - 1) as f64;
    history.iter_mut().enumerate().for_each(|(n, f)| *f = force(n as f64 * duration / instants));
}

/// Bell pulses of the samples numbered `samples`; each depends on (purpose, seed, sample, panel) only.
pub fn bells(
    bell: &Bell,
    purpose: Purpose,
    seed: u64,
    samples: Range<u64>,
    panels: usize,
    duration: f64,
    instants: usize,
) -> Forces {
    each_panel((purpose, seed), samples, panels, instants, |stream, history| {
        bell.draw(stream).history_into(duration, history);
    })
}

/// As [`bells`], with Gaussian pulses.
pub fn gauss(
    Gauss { amplitude, sigma, centre }: &Gauss,
    purpose: Purpose,
    seed: u64,
    samples: Range<u64>,
    panels: usize,
    duration: f64,
    instants: usize,
) -> Forces {
    each_panel((purpose, seed), samples, panels, instants, |stream, history| {
        let [amplitude, sigma, centre] = [*amplitude, *sigma, *centre].map(|own| stream.between(own));
        sampled(history, duration, |t| {
            let z = (t - centre) / sigma;
            amplitude * (-0.5 * z * z).exp()
        });
    })
}

/// Histories that `draw` writes per sample and panel, each from its own random stream.
fn each_panel(
    (purpose, seed): (Purpose, u64),
    samples: Range<u64>,
    panels: usize,
    instants: usize,
    draw: impl Fn(&mut Stream, &mut [f64]),
) -> Forces {
    let count = (samples.end - samples.start) as usize;
    let mut values = vec![0.0; count * panels * (instants + 1)];
    for (slot, history) in values.chunks_exact_mut(instants + 1).enumerate() {
        let of = [samples.start + (slot / panels) as u64, (slot % panels) as u64];
        draw(&mut Stream::new(purpose, seed, of), history);
    }
    Forces { samples: count, panels, instants, values, strikes: Vec::new() }
}

/// Decoder targets (N, T, K): f at n = 1…T, T = `instants`, a divisor of the forces' instants. `low_pass` filters a finer clock
/// to T instants.
pub fn targets(forces: &Forces, instants: usize, low_pass: bool) -> Vec<f64> {
    let (panels, clock, every) = (forces.panels, forces.instants + 1, forces.instants / instants);
    let mut targets = Vec::with_capacity(forces.samples * instants * panels);
    for sample in forces.values.chunks_exact(panels * clock) {
        if low_pass && every > 1 {
            let read = |history: &[f64]| {
                mirrored_low_pass(history, 0.0, 1.0, forces.instants as f64, instants, history[0])
            };
            let histories: Vec<Vec<f64>> = sample.chunks_exact(clock).map(read).collect();
            (1..=instants).for_each(|n| targets.extend(histories.iter().map(|f| f[n])));
        } else {
            (1..=instants).for_each(|n| targets.extend((0..panels).map(|k| sample[k * clock + n * every])));
        }
    }
    targets
}

/// Seeded shuffle of `samples` samples into (training set, test set of `test`), both ascending. With `replacement`, the test set
/// may contain a sample several times, and the training set contains all others.
///
/// # Panics
/// If the training set is empty.
pub fn split(seed: u64, samples: usize, test: usize, replacement: bool) -> (Vec<usize>, Vec<usize>) {
    if replacement {
        let mut stream = Stream::new(Purpose::Split, seed, [samples as u64, 1]);
        let mut drawn: Vec<usize> = (0..test).map(|_| stream.below(samples)).collect();
        drawn.sort_unstable();
        let training: Vec<usize> = (0..samples).filter(|i| drawn.binary_search(i).is_err()).collect();
        assert!(!training.is_empty(), "{test} of {samples} samples test");
        return (training, drawn);
    }
    let mut order = Stream::new(Purpose::Split, seed, [samples as u64, 0]).permutation(samples);
    let mut training = order.split_off(test);
    order.sort_unstable();
    training.sort_unstable();
    (training, order)
}

/// Fold, from 0, of each record: a seeded shuffle into folds whose sizes differ by at most one.
pub fn folds(seed: u64, records: usize, folds: usize) -> Vec<usize> {
    let mut fold_of = vec![0; records];
    let order = Stream::new(Purpose::Split, seed, [records as u64, 2]).permutation(records);
    order.into_iter().enumerate().for_each(|(n, record)| fold_of[record] = n % folds);
    fold_of
}

/// Numbers of the records in each fold.
pub fn members(fold_of: &[usize]) -> Vec<Vec<usize>> {
    let mut members = vec![Vec::new(); fold_of.iter().max().map_or(0, |last| last + 1)];
    fold_of.iter().enumerate().for_each(|(record, fold)| members[*fold].push(record));
    members
}

#[cfg(test)]
mod tests;
