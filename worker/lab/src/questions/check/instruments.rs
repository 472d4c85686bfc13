//! Properties of records without a model: peaks, noise, repeated blows, clipped readings.

use super::{CheckedRecord, ONSET};
use metasense_numerics::student::median;

/// Instrument properties of one record.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Instruments {
    /// Largest force (N).
    pub peak: f64,
    /// Impulse, summed over panels (N·s).
    pub impulse: f64,
    /// Number of blows on the panel with most.
    pub blows: usize,
    /// Level and standard deviation of each force before the first moves (N); `None` if one moves from the start.
    pub rest: Option<Vec<[f64; 2]>>,
    /// Standard deviation of the force before the blow (N); `None` with too few entries.
    pub force_noise: Option<f64>,
    /// Mean and standard deviation of each channel before the blow; `None` with too few readings.
    pub quiet: Option<Vec<[f64; 2]>>,
    /// RMS of each channel from the blow on.
    pub size: Vec<f64>,
}

/// Least number of readings before the blow that measure noise.
const FEWEST: usize = 5;
/// Fraction of the peak above which a force is a blow, and below which it must fall between blows.
const BLOW: f64 = 0.2;
const BETWEEN: f64 = 0.08;
/// Least number of entries equal to an extreme that indicate clipping, and least distance of the extreme from the level at the beginning:
/// in smallest steps, and relative to the other extreme's.
const CLIPPED: usize = 3;
const STEPS: f64 = 50.0;
const FAR: f64 = 0.1;

impl Instruments {
    /// Properties of a record.
    pub fn of(record: &CheckedRecord) -> Self {
        let [onset, _] = record.blow();
        let histories = &record.force.values;
        let largest = |f: &Vec<f64>| f.iter().fold(0.0f64, |m, x| m.max(x.abs()));
        let of_force = record.force.before(onset);
        let force_noise = (of_force >= FEWEST)
            .then(|| histories.iter().map(|f| statistics(&f[..of_force])[1]).fold(0.0, f64::max));
        let before = record.signals.before(onset);
        let signals = &record.signals.values;
        Self {
            peak: histories.iter().map(largest).fold(0.0, f64::max),
            impulse: record.force.dt * histories.iter().flatten().sum::<f64>().abs(),
            blows: histories.iter().map(|f| blows(f)).max().unwrap_or(0),
            rest: rest(histories),
            force_noise,
            quiet: (before >= FEWEST).then(|| signals.iter().map(|y| statistics(&y[..before])).collect()),
            size: signals.iter().map(|y| rms(&y[before.min(y.len().saturating_sub(1))..])).collect(),
        }
    }
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|x| x * x).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

/// Mean and standard deviation.
fn statistics(values: &[f64]) -> [f64; 2] {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let off: Vec<f64> = values.iter().map(|x| x - mean).collect();
    [mean, rms(&off)]
}

/// Level and standard deviation of each force before the first moves.
fn rest(forces: &[Vec<f64>]) -> Option<Vec<[f64; 2]>> {
    let levels: Vec<f64> =
        forces.iter().map(|f| Some(statistics(f.get(..FEWEST)?)[0])).collect::<Option<_>>()?;
    let moved =
        |n: usize| forces.iter().zip(&levels).map(|(f, level)| (f[n] - level).abs()).fold(0.0, f64::max);
    let entries = forces.first()?.len();
    let most = (0..entries).map(moved).fold(0.0, f64::max);
    let still = (0..entries).take_while(|n| moved(*n) <= ONSET * most).count();
    (still >= FEWEST).then(|| forces.iter().map(|f| statistics(&f[..still])).collect())
}

/// Number of blows in a history. A new blow requires that the force has fallen first.
pub fn blows(force: &[f64]) -> usize {
    let peak = force.iter().fold(0.0f64, |m, x| m.max(x.abs()));
    let (mut count, mut within) = (0, false);
    for f in force.iter().map(|f| f.abs()) {
        if !within && f > BLOW * peak {
            (count, within) = (count + 1, true);
        }
        within &= f > BETWEEN * peak;
    }
    count
}

/// Number of clipped entries per history (one history per record of a channel); zeros if the extremes do not repeat as clipped values do.
pub fn clipped(histories: &[&[f64]]) -> Vec<usize> {
    let mut all: Vec<f64> = histories.iter().flat_map(|h| h.iter().copied()).collect();
    all.sort_by(f64::total_cmp);
    let (low, high) = (all.first().copied().unwrap_or(0.0), all.last().copied().unwrap_or(0.0));
    let first: Vec<f64> = histories.iter().filter_map(|h| h.first().copied()).collect();
    let level = if first.is_empty() { 0.0 } else { median(&first) };
    let least = FAR * (low - level).abs().max((high - level).abs());
    let step = all.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > 0.0).fold(f64::INFINITY, f64::min);
    let ends = [low, high].map(|end| {
        let near = |x: &f64| (x - end).abs() <= 1e-9 * end.abs();
        // Values of a quiet channel also repeat, but near its level at the beginning.
        let far = (end - level).abs() > least.max(STEPS * step);
        let counts: Vec<usize> = histories.iter().map(|h| h.iter().filter(|x| near(x)).count()).collect();
        let is_end = far && counts.iter().sum::<usize>() >= CLIPPED;
        if is_end { counts } else { vec![0; histories.len()] }
    });
    ends[0].iter().zip(&ends[1]).map(|(a, b)| a + b).collect()
}
