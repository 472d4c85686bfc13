//! Clock errors: one unknown offset per record, fitted with the other unknowns.
//!
//! ```text
//! y_i(t_n) ≈ a_i(t_n + δ_i − delay)      δ_i normal of deviation σ, within 3 σ
//! ```
//! The simulated signals a have a finer clock than the readings. They are interpolated by Lagrange polynomials through eight instants;
//! readings are not interpolated. For given signals, a search and Newton steps find the best δ of each record (variable projection: Golub
//! and Pereyra, SIAM J. Numer. Anal. 10, 1973), so the gradient at fixed δ is that of the minimum.

use crate::dynamics::{Forces, IntegratorSettings, Scene, planned, run};
use crate::student::student;
use nalgebra::{DMatrix, DVector};

/// Largest offset, in standard deviations.
const REACH: f64 = 3.0;
/// Instants per polynomial, and how many of them lie before its interval.
const TAPS: usize = 8;
const BEFORE: i64 = 3;
/// Largest interpolation error relative to the signals' RMS; least and greatest number of instants per reading.
const MISSED: f64 = 1e-3;
const FEWEST: usize = 4;
const MOST: usize = 16;
/// Records that measure the interpolation error.
const PILOT: usize = 8;
/// Largest number of Newton steps.
const STEPS: usize = 12;
/// Time segments of a record that are groups for the interval of its offset.
const PARTS: usize = 20;

/// Prior of the clock offsets, and the finer clock of the simulation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clock {
    /// σ (s).
    deviation: f64,
    /// Simulated instants per reading.
    pub finer: usize,
    /// Interval between simulated instants, and between readings (s).
    step: f64,
    interval: f64,
    /// Delay of the chips (s).
    delay: f64,
}

/// The offset of a record's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Offset {
    /// Time by which the readings are later than the record states (s).
    pub value: f64,
    /// Half width of the 95 % interval (s); `None` at the bound.
    pub half: Option<f64>,
}

/// Lagrange weights at `p` in [0, 1] for the values at −BEFORE, …, and their first two derivatives.
fn weights(p: f64) -> [[f64; TAPS]; 3] {
    let mut all = [[0.0; TAPS]; 3];
    for m in 0..TAPS {
        let [mut value, mut slope, mut bend] = [1.0, 0.0, 0.0];
        for l in (0..TAPS).filter(|l| *l != m) {
            let (factor, by) = (p - (l as i64 - BEFORE) as f64, 1.0 / (m as f64 - l as f64));
            bend = (bend * factor + 2.0 * slope) * by;
            slope = (slope * factor + value) * by;
            value *= factor * by;
        }
        (all[0][m], all[1][m], all[2][m]) = (value, slope, bend);
    }
    all
}

/// Interpolates a smooth history at the fractional index `s` with the same polynomial; 0 outside the history.
pub fn between(history: &[f64], s: f64) -> f64 {
    let last = history.len() as i64 - 1;
    let s = if (s - s.round()).abs() < 1e-9 { s.round() } else { s };
    if s < 0.0 || s > last as f64 {
        return 0.0;
    }
    let [weights, ..] = weights(s - s.floor());
    let entries = (s.floor() as i64 - BEFORE..).map(|i| history[i.clamp(0, last) as usize]);
    weights.iter().zip(entries).map(|(weight, f)| weight * f).sum()
}

/// Number of readings excluded at the end of a record: late readings, and the reach of the interpolation. `deviation` and `interval` of the
/// readings in s; `finer`: simulated instants per reading.
pub fn margin(deviation: f64, interval: f64, finer: usize) -> usize {
    (REACH * deviation / interval + TAPS as f64 / finer as f64).ceil() as usize
}

impl Clock {
    /// Clock for records under `forces`; `None` if `deviation` (s) is 0. Uses at least `least` instants per reading, and doubles them until
    /// the interpolation error is small.
    pub fn new(
        deviation: f64,
        delay: f64,
        least: usize,
        (scene, design): (&Scene, &[f64]),
        forces: &Forces,
        solver: &IntegratorSettings,
        pool: &crate::Pool,
    ) -> Option<Self> {
        let (interval, kinks) = (scene.duration / scene.instants as f64, forces.kinks(scene));
        let at = |finer: usize| Self { deviation, finer, step: interval / finer as f64, interval, delay };
        let first: Vec<usize> = (0..forces.samples.min(PILOT)).collect();
        let pilot = forces.select(&first);
        let mut finer = kinks * least.max(FEWEST).div_ceil(kinks);
        while deviation > 0.0 && finer < MOST {
            let (moving, forces) = at(2 * finer).in_motion(scene, &pilot);
            let plan = planned(&moving, design, &forces, solver).double();
            let signals = run(&moving, design, &forces, &plan, false, pool).signals;
            let missed = missed(&signals, forces.samples, moving.instants);
            // The error is NaN if the body cannot be simulated.
            if missed < MISSED || missed.is_nan() {
                break;
            }
            finer *= 2;
        }
        (deviation > 0.0).then(|| at(finer))
    }

    /// Scene and forces on the finer clock.
    pub fn in_motion(&self, scene: &Scene, forces: &Forces) -> (Scene, Forces) {
        let scene = Scene { instants: self.finer * scene.instants, ..scene.clone() };
        let forces = forces.refined_for(&scene).into_owned();
        (scene, forces)
    }

    /// Largest offset (s).
    fn limit(&self) -> f64 {
        REACH * self.deviation
    }

    /// Readings by which a window is extended for late signals, and that the simulation needs after the last counted reading.
    pub fn margin(&self) -> usize {
        margin(self.deviation, self.interval, self.finer)
    }

    /// Position of a reading relative to the first reading's nominal time: simulated instant, and fraction of the next interval.
    fn place(&self, offset: f64) -> (i64, f64) {
        let at = (offset - self.delay) / self.step;
        (at.floor() as i64, at - at.floor())
    }

    /// Interpolates a record's simulated signals (instants, width) at its readings, or their derivative in time (1/s, 1/s²). Zero before
    /// the first instant; constant after the last.
    pub fn read(&self, motion: &[f64], width: usize, offset: f64, derivative: usize) -> Vec<f64> {
        let (first, p) = self.place(offset);
        let weights = weights(p)[derivative].map(|w| w / self.step.powi(derivative as i32));
        let instants = motion.len() / width;
        let mut read = vec![0.0; instants / self.finer * width];
        for (n, reading) in read.chunks_exact_mut(width).enumerate() {
            for (at, weight) in self.taps(n, first, instants, &weights) {
                reading.iter_mut().zip(&motion[at * width..]).for_each(|(to, x)| *to += weight * x);
            }
        }
        read
    }

    /// Transpose of `read`: maps a cotangent of the readings to the simulated signals.
    pub fn read_vjp(&self, cotangent: &[f64], width: usize, offset: f64) -> Vec<f64> {
        let (first, p) = self.place(offset);
        let [weights, ..] = weights(p);
        let instants = cotangent.len() / width * self.finer;
        let mut motion = vec![0.0; instants * width];
        for (n, reading) in cotangent.chunks_exact(width).enumerate() {
            for (at, weight) in self.taps(n, first, instants, &weights) {
                motion[at * width..].iter_mut().zip(reading).for_each(|(to, bar)| *to += weight * bar);
            }
        }
        motion
    }

    /// Simulated instants and their weights in reading n.
    fn taps<'a>(
        &self,
        n: usize,
        first: i64,
        instants: usize,
        weights: &'a [f64; TAPS],
    ) -> impl Iterator<Item = (usize, f64)> + use<'a> {
        // The first signal is that of instant 1.
        let begin = (self.finer * (n + 1)) as i64 + first - BEFORE - 1;
        let of = move |(m, &weight): (usize, &f64)| {
            let at = begin + m as i64;
            (at >= 0 && weight != 0.0).then(|| ((at as usize).min(instants - 1), weight))
        };
        weights.iter().enumerate().filter_map(of)
    }

    /// Offset that minimises ½‖W (y − a(δ))‖² + ½ (δ/σ)² for a record.
    pub fn settle(&self, motion: &[f64], recorded: &[f64], width: usize, whiten: &dyn Fn(&mut [f64])) -> f64 {
        let left = |offset: f64| {
            let mut left = self.read(motion, width, offset, 0);
            left.iter_mut().zip(recorded).for_each(|(a, y)| *a = y - *a);
            whiten(&mut left);
            left
        };
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let cost = |left: &[f64], offset: f64| dot(left, left) + (offset / self.deviation).powi(2);
        let steps = (self.limit() / self.step).floor() as i64;
        let all = (-steps..=steps).map(|j| j as f64 * self.step);
        let costs = all.map(|offset| (cost(&left(offset), offset), offset));
        let (mut least, start) = costs.min_by(|a, b| a.0.total_cmp(&b.0)).expect("an offset of 0");
        let within =
            |x: f64| x.clamp(start - self.step, start + self.step).clamp(-self.limit(), self.limit());
        let mut offset = start;
        for _ in 0..STEPS {
            let here = left(offset);
            let [slopes, bends] = [1, 2].map(|derivative| {
                let mut of = self.read(motion, width, offset, derivative);
                whiten(&mut of);
                of
            });
            let prior = self.deviation.powi(-2);
            let slope = offset * prior - dot(&slopes, &here);
            let gauss = dot(&slopes, &slopes) + prior;
            let newton = gauss - dot(&bends, &here);
            let mut by = -slope / if newton > 0.1 * gauss { newton } else { gauss };
            let mut moved = false;
            while by.abs() > 1e-9 * self.step {
                let there = within(offset + by);
                let found = cost(&left(there), there);
                if found < least {
                    (moved, offset, least) = (true, there, found);
                    break;
                }
                by *= 0.25;
            }
            if !moved {
                break;
            }
        }
        offset
    }

    /// Whether an offset is at its bound.
    fn is_at_the_bound(&self, offset: f64) -> bool {
        offset.abs() >= self.limit() * (1.0 - 1e-9)
    }

    /// d: derivative of a record's readings in its offset (1/s); 0 at the bound, where the offset is constant.
    pub fn slope(&self, motion: &[f64], width: usize, offset: f64) -> Vec<f64> {
        let mut slope = self.read(motion, width, offset, 1);
        if self.is_at_the_bound(offset) {
            slope.fill(0.0);
        }
        slope
    }

    /// R^{-½} x of a record for R = 1 + σ² d dᵀ, d its whitened derivative: an unknown offset is noise along d.
    pub fn whiten(&self, d: &[f64], x: &mut [f64]) {
        let square: f64 = d.iter().map(|d| d * d).sum();
        let part = (1.0 - self.known(square)) / square;
        if part.is_finite() {
            let along: f64 = part * d.iter().zip(&*x).map(|(d, x)| d * x).sum::<f64>();
            x.iter_mut().zip(d).for_each(|(x, d)| *x -= along * d);
        }
    }

    /// Applies `whiten` to each record of `record` entries; `slopes` has each record's d.
    pub fn whiten_each(&self, slopes: &[f64], record: usize, of: &mut [f64]) {
        let each = of.chunks_exact_mut(record).zip(slopes.chunks_exact(record));
        each.for_each(|(own, d)| self.whiten(d, own));
    }

    /// Applies `whiten` to the residual, extrapolated linearly from the fitted `offsets` to 0.
    pub fn whiten_residual(&self, slopes: &[f64], offsets: &[f64], record: usize, residual: &mut [f64]) {
        let all = residual.iter_mut().zip(slopes).enumerate();
        all.for_each(|(i, (left, slope))| *left += slope * offsets[i / record]);
        self.whiten_each(slopes, record, residual);
    }

    /// Factor of R^{-½} along d.
    fn known(&self, square: f64) -> f64 {
        (1.0 + square * self.deviation * self.deviation).sqrt().recip()
    }

    /// Offset with its interval, from d, the whitened residual, the record's rows of R^{-½} J, and the covariance of the other unknowns
    /// times Student's t squared. `unmodelled`: share of the residual that does not average out.
    pub fn offset(
        &self,
        value: f64,
        [d, residual]: [&[f64]; 2],
        rows: &DMatrix<f64>,
        covariance: &DMatrix<f64>,
        unmodelled: f64,
    ) -> Offset {
        if self.is_at_the_bound(value) {
            return Offset { value, half: None };
        }
        let square: f64 = d.iter().map(|d| d * d).sum();
        let prior = self.deviation.powi(-2);
        let curvature = square + prior;
        let mut scores = [0.0; PARTS];
        for (i, r) in residual.iter().enumerate() {
            scores[i * PARTS / residual.len()] += d[i] * r;
        }
        let alike = 1.0 + unmodelled * (PARTS - 1) as f64;
        // At least the score of white noise, since few segments contain most of d.
        let score = scores.iter().map(|s| s * s).sum::<f64>().max(square);
        let own = (alike * score + prior) / curvature.powi(2);
        let along = rows.tr_mul(&DVector::from_column_slice(d)) / (self.known(square) * curvature);
        let with_the_rest = (covariance * &along).dot(&along);
        let half = (student(PARTS - 1).powi(2) * own + with_the_rest.max(0.0)).sqrt();
        Offset { value, half: Some(half) }
    }
}

/// Interpolation error of signals (samples, instants, 3M) from every other instant, relative to the RMS: the larger of those for
/// accelerations and rotation rates.
fn missed(signals: &[f64], samples: usize, instants: usize) -> f64 {
    let width = signals.len() / (samples * instants).max(1);
    let [weights, ..] = weights(0.5);
    let (mut off, mut size) = ([0.0; 2], [0.0; 2]);
    for own in signals.chunks_exact((instants * width).max(1)) {
        for n in (2 * TAPS..instants.saturating_sub(2 * TAPS)).step_by(2) {
            for c in 0..width {
                let at = |m: usize| own[(n + 1 + 2 * m - 2 * BEFORE as usize - 2) * width + c];
                let between: f64 = weights.iter().enumerate().map(|(m, w)| w * at(m)).sum();
                let kind = usize::from(c % 3 == 2);
                off[kind] += (between - own[n * width + c]).powi(2);
                size[kind] += own[n * width + c].powi(2);
            }
        }
    }
    let part = |kind: usize| if size[kind] > 0.0 { (off[kind] / size[kind]).sqrt() } else { 0.0 };
    part(0).max(part(1))
}

#[cfg(test)]
mod tests;
