//! Recorded readings: the window in which they count, their noise, and residuals weighted by it.

use crate::dynamics::{Forces, Scene};
use crate::trial::Chip;

/// Fraction of the largest force at which a record begins.
const BEGUN: f64 = 0.01;

/// Recorded readings of a body.
pub struct Readings<'a> {
    /// Of whole records (N, T, channels).
    pub(super) all: &'a [f64],
    /// Standard deviation of each record's clock error (s).
    pub(super) deviation: f64,
    /// First instant of each record's force.
    pub(super) onsets: Vec<usize>,
    /// Records that count: those under which the body can be simulated at z = 0.
    pub(super) counts: Vec<bool>,
    /// Instants from the onset on that count.
    pub(super) window: usize,
    /// Instants per record up to the end of the window.
    pub(super) instants: usize,
    /// Readings up to there.
    pub(super) recorded: Vec<f64>,
    /// Whether each of them counts.
    pub(super) seen: Vec<bool>,
    /// Readings that late clocks may add at either end of the window.
    margin: usize,
    pub(super) chip: Option<&'a Chip>,
    /// Standard deviations of noise and bias per channel.
    pub noise: Vec<f64>,
    bias: Vec<f64>,
}

impl<'a> Readings<'a> {
    /// Readings `all` under these forces; [`Self::look_at`] selects those that count.
    pub(super) fn new(
        all: &'a [f64],
        deviation: f64,
        scene: &Scene,
        forces: &Forces,
        chip: Option<&'a Chip>,
        width: usize,
    ) -> Self {
        Self {
            all,
            deviation,
            onsets: onsets(scene, forces),
            counts: vec![true; forces.samples],
            window: 0,
            instants: 0,
            recorded: Vec::new(),
            seen: Vec::new(),
            margin: 0,
            chip,
            noise: vec![1.0; width],
            bias: chip.map_or_else(|| vec![0.0; width], |chip| chip.bias.clone()),
        }
    }

    /// Channels per instant.
    pub(super) fn width(&self) -> usize {
        self.noise.len()
    }

    /// Readings of a record up to the end of the window.
    pub(super) fn size(&self) -> usize {
        self.instants * self.width()
    }

    /// Number of records that count.
    pub fn counted(&self) -> usize {
        self.counts.iter().filter(|counts| **counts).count()
    }

    /// Sets the window: `window` of the T instants of each record from its onset, plus the margin at either end.
    pub(super) fn look_at(&mut self, window: usize, margin: usize, instants: usize) {
        (self.window, self.margin) = (window, margin);
        let last = self.onsets.iter().map(|o| (o + window + 2 * margin).min(instants)).max();
        self.instants = last.unwrap_or(instants);
        let (whole, size) = (instants * self.width(), self.size());
        self.recorded = self.all.chunks(whole).flat_map(|record| &record[..size]).copied().collect();
        self.see();
    }

    /// Excludes readings outside the window, of excluded records, and at the limit of the chip's range.
    pub(super) fn see(&mut self) {
        let (width, size, margin) = (self.width(), self.size(), self.margin);
        let mut seen = vec![1.0; self.recorded.len()];
        for (i, own) in seen.chunks_exact_mut(size).enumerate() {
            let end = (self.onsets[i] + self.window + margin).min(self.instants.saturating_sub(margin));
            let end = if self.counts[i] { end } else { 0 };
            own.iter_mut().skip(end * width).for_each(|seen| *seen = 0.0);
        }
        if let Some(chip) = self.chip {
            chip.disturb_vjp(&mut seen, &self.recorded);
        }
        self.seen = seen.into_iter().map(|seen| seen != 0.0).collect();
    }

    /// R^{-½}(y − a); zero where a reading does not count.
    pub fn residual(&self, read: &[f64]) -> Vec<f64> {
        let mut left: Vec<f64> = self.recorded.iter().zip(read).map(|(y, a)| y - a).collect();
        self.whiten(&mut left);
        left
    }

    /// R^{-½} x = (x − s x̄)/σ for R = σ² + b² 1 1ᵀ over the n readings of a record's channel that count, (1 − s)² = σ²/(σ² + n b²);
    /// symmetric. Other readings become zero.
    pub(super) fn whiten(&self, of: &mut [f64]) {
        of.chunks_exact_mut(self.size()).enumerate().for_each(|(i, own)| self.whiten_record(i, own));
    }

    /// Applies `whiten` to one record.
    pub(super) fn whiten_record(&self, i: usize, own: &mut [f64]) {
        let (width, seen) = (self.width(), &self.seen[i * own.len()..][..own.len()]);
        for c in 0..width {
            let (noise, bias) = (self.noise[c], self.bias[c]);
            let seen = || seen[c..].iter().step_by(width);
            let n = seen().filter(|seen| **seen).count().max(1) as f64;
            let counts = own[c..].iter().step_by(width).zip(seen()).filter(|(_, seen)| **seen);
            let mean = counts.map(|(x, _)| x).sum::<f64>() / n;
            let part = 1.0 - noise / noise.hypot(n.sqrt() * bias);
            let each = own[c..].iter_mut().step_by(width).zip(seen());
            each.for_each(|(x, seen)| *x = if *seen { (*x - part * mean) / noise } else { 0.0 });
        }
    }
}

/// Instant at which each record's force begins.
fn onsets(scene: &Scene, forces: &Forces) -> Vec<usize> {
    let onset = |i: usize| {
        let history = forces.sample(i);
        let largest = history.iter().fold(0.0f64, |m, f| m.max(f.abs()));
        let begun = |n: &usize| {
            let f = (0..forces.panels).map(|k| history[k * (forces.instants + 1) + n].abs());
            f.fold(0.0, f64::max) > BEGUN * largest
        };
        (0..=forces.instants).find(begun).unwrap_or(0) / forces.kinks(scene)
    };
    (0..forces.samples).map(onset).collect()
}
