//! Clocks that are off: each record's by its own unknown time, which is fitted with the rest.
//!
//! ```text
//! y_i(t_n) ≈ a_i(t_n + δ_i − delay)      δ_i normal of deviation σ, within 3 σ
//! ```
//! The simulated signals a are taken on a clock finer than that of the readings, and interpolated by Lagrange's polynomial through
//! eight instants; readings never are. For given signals the best δ of a record is found by search, then by Newton's steps
//! (variable projection: Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973), so that a gradient at fixed δ is that of the least.

use crate::dynamics::{Forces, Scene, Solver, planned, run};
use crate::student::student;
use nalgebra::{DMatrix, DVector};

/// Deviations that an offset may have.
const REACH: f64 = 3.0;
/// Instants through which a polynomial goes, the first so many before the one sought.
const TAPS: usize = 8;
const BEFORE: i64 = 3;
/// Part of the signals' RMS that interpolation may miss, and instants for each reading between which that is tried.
const MISSED: f64 = 1e-3;
const FEWEST: usize = 4;
const MOST: usize = 16;
/// Records of which it is measured.
const PILOT: usize = 8;
/// Newton's steps, at most.
const STEPS: usize = 12;
/// Parts of a record in time that are groups for the interval of its offset.
const PARTS: usize = 20;

/// How records' clocks may be off, and the finer clock on which motion is taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clock {
    /// σ (s).
    deviation: f64,
    /// Instants of the motion for each reading.
    pub finer: usize,
    /// Between two of them, and between two readings (s).
    step: f64,
    interval: f64,
    /// Delay of the chips (s).
    delay: f64,
}

/// The offset of a record's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Offset {
    /// By how much later its readings were taken than it says (s).
    pub value: f64,
    /// Half the 95 % interval (s); none where the offset is as large as it may be.
    pub half: Option<f64>,
}

/// Lagrange's weights of the values at −BEFORE, … for the place `p` from 0 to 1, and their first two derivatives.
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

/// A smooth history at entry `s`, which need not be whole, by the same polynomial; 0 before its first entry and after its last.
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

/// Readings at the end of a record that do not count where clocks are off by a `deviation` (s): those that may be late, and as many as
/// interpolation needs, on motion so many times as fine as the readings are, `interval` apart (s).
pub fn margin(deviation: f64, interval: f64, finer: usize) -> usize {
    (REACH * deviation / interval + TAPS as f64 / finer as f64).ceil() as usize
}

impl Clock {
    /// Of records under `forces`, off by a `deviation` (s); none if that is 0. Motion is taken `least` times as often as readings
    /// or so often that its interpolation misses little.
    pub fn new(
        deviation: f64,
        delay: f64,
        least: usize,
        (scene, design): (&Scene, &[f64]),
        forces: &Forces,
        solver: &Solver,
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
            // a body that cannot be simulated has no signals
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
        let forces = forces.on(&scene).into_owned();
        (scene, forces)
    }

    /// Largest offset (s).
    fn limit(&self) -> f64 {
        REACH * self.deviation
    }

    /// Readings by which a window is longer, as signals may be that late; and by which motion must go on behind the last that counts.
    pub fn margin(&self) -> usize {
        margin(self.deviation, self.interval, self.finer)
    }

    /// First instant, counted from that of the first reading, and where between it and the next the reading is.
    fn place(&self, offset: f64) -> (i64, f64) {
        let at = (offset - self.delay) / self.step;
        (at.floor() as i64, at - at.floor())
    }

    /// What a record's motion (instants, width) is at its readings, or a derivative of it (1/s, 1/s²). Rest before its beginning, its
    /// last value after its end.
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

    /// Its transpose: a cotangent on the readings as one on the motion.
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

    /// Instants of the motion and their weights in the n-th reading.
    fn taps<'a>(
        &self,
        n: usize,
        first: i64,
        instants: usize,
        weights: &'a [f64; TAPS],
    ) -> impl Iterator<Item = (usize, f64)> + use<'a> {
        // signals are those of the instants 1, 2, …
        let begin = (self.finer * (n + 1)) as i64 + first - BEFORE - 1;
        let of = move |(m, &weight): (usize, &f64)| {
            let at = begin + m as i64;
            (at >= 0 && weight != 0.0).then(|| ((at as usize).min(instants - 1), weight))
        };
        weights.iter().enumerate().filter_map(of)
    }

    /// The offset of least ½‖W (y − a(δ))‖² + ½ (δ/σ)² of a record.
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

    /// Whether an offset is as large as it may be.
    fn is_at_the_bound(&self, offset: f64) -> bool {
        offset.abs() >= self.limit() * (1.0 - 1e-9)
    }

    /// d: the derivative of a record's readings by its offset (1/s), 0 at the bound, where that does not move with the rest.
    pub fn slope(&self, motion: &[f64], width: usize, offset: f64) -> Vec<f64> {
        let mut slope = self.read(motion, width, offset, 1);
        if self.is_at_the_bound(offset) {
            slope.fill(0.0);
        }
        slope
    }

    /// R^{-½} x of a record, R = 1 + σ² d dᵀ, where d is its whitened derivative: an offset that is not known is noise along it.
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

    /// The same of a residual at fitted `offsets`: first without what they explain.
    pub fn whiten_residual(&self, slopes: &[f64], offsets: &[f64], record: usize, residual: &mut [f64]) {
        let all = residual.iter_mut().zip(slopes).enumerate();
        all.for_each(|(i, (left, slope))| *left += slope * offsets[i / record]);
        self.whiten_each(slopes, record, residual);
    }

    /// What R^{-½} leaves along d.
    fn known(&self, square: f64) -> f64 {
        (1.0 + square * self.deviation * self.deviation).sqrt().recip()
    }

    /// A record's offset with its interval, from d, the whitened residual, the record's rows of R^{-½} J, and the covariance of the other
    /// unknowns times Student's t squared; `unmodelled` is the share of the residual that does not average out.
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
        // no less than white noise has: few parts hold most of a record's d
        let score = scores.iter().map(|s| s * s).sum::<f64>().max(square);
        let own = (alike * score + prior) / curvature.powi(2);
        let along = rows.tr_mul(&DVector::from_column_slice(d)) / (self.known(square) * curvature);
        let with_the_rest = (covariance * &along).dot(&along);
        let half = (student(PARTS - 1).powi(2) * own + with_the_rest.max(0.0)).sqrt();
        Offset { value, half: Some(half) }
    }
}

/// Part of the RMS of signals (samples, instants, 3M) that a polynomial through every other instant misses in the middle, of
/// accelerations or of rotation rates.
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
