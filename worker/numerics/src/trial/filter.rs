//! Filter of a chip before its readings: a low-pass and a delay, on a clock finer than that of the readings.
//!
//! ```text
//! y″ + √2 ω y′ + ω² y = ω² a      ω = 2π·bandwidth (Butterworth, order 2)      reading_n = y(t_n − delay)
//! ```
//! Exact for signals that are linear between instants of this clock and zero before the first. The delay interpolates with a cubic
//! through the last four instants. Both are causal.

use super::ChipErrors;
use faer::c64;
use std::f64::consts::TAU;

/// Least number of clock instants per reading: the cubic is then exact to 4e-4 at 0.8 of the readings' Nyquist frequency.
const CLOCK: usize = 8;
/// Least ratio of the clock rate to the bandwidth: linear interpolation then lowers the gain by 0.3 %.
const BESIDE_BANDWIDTH: f64 = 32.0;

/// Angle ω h below which the low-pass is computed by series.
const SMALL_ANGLE: f64 = 1e-3;

/// A low-pass and a delay.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Filter {
    /// Instants per reading.
    clock: usize,
    low_pass: Option<LowPass>,
    /// Delay of the first of four taps in whole instants, and their weights.
    back: usize,
    taps: [f64; 4],
}

/// A step of the low-pass's state z = (y, y′/ω): z₁ = E z₀ + g₀ a₀ + g₁ a₁.
#[derive(Debug, Clone, PartialEq)]
struct LowPass {
    e: [[f64; 2]; 2],
    g: [[f64; 2]; 2],
}

impl ChipErrors {
    /// Instants per reading at which the body's motion is computed; `interval` is the time between two readings (s).
    pub fn clock(&self, interval: f64) -> usize {
        if self.delay == 0.0 && self.bandwidth.is_infinite() {
            return 1;
        }
        let low_pass = if self.bandwidth.is_finite() { self.bandwidth } else { 0.0 };
        // tolerates rounding errors
        CLOCK.max((BESIDE_BANDWIDTH * low_pass * interval - 1e-9).ceil() as usize)
    }

    /// Applies the low-pass, if any, in place to signals (N, instants, width); `step`: interval between instants (s).
    pub fn low_pass(&self, signals: &mut [f64], samples: usize, width: usize, step: f64) {
        self.each(signals, samples, width, step, LowPass::run);
    }

    /// Transpose of [`Self::low_pass`].
    pub(crate) fn low_pass_vjp(&self, cotangent: &mut [f64], samples: usize, width: usize, step: f64) {
        self.each(cotangent, samples, width, step, LowPass::run_vjp);
    }

    fn each(
        &self,
        of: &mut [f64],
        samples: usize,
        width: usize,
        step: f64,
        run: fn(&LowPass, &mut [f64], usize),
    ) {
        if self.bandwidth.is_finite() {
            let (low_pass, one) = (LowPass::new(TAU * self.bandwidth * step), of.len() / samples.max(1));
            of.chunks_exact_mut(one.max(1)).for_each(|sample| run(&low_pass, sample, width));
        }
    }

    /// Complex gain of the filter at this frequency (Hz).
    pub fn passes(&self, hertz: f64) -> c64 {
        let part = hertz / self.bandwidth;
        c64::cis(-TAU * hertz * self.delay) / c64::new(1.0 - part * part, 2f64.sqrt() * part)
    }
}

/// The same integrals by their series Σ Aᵏ b hᵏ⁺¹/(k + `first`)!, which does not cancel for small angles.
fn integral(angle: f64, first: f64) -> [f64; 2] {
    let (mut term, mut sum) = ([0.0, angle / first], [0.0; 2]);
    for k in 1..6 {
        sum = [sum[0] + term[0], sum[1] + term[1]];
        let next = angle / (first + f64::from(k));
        term = [next * term[1], -next * (term[0] + 2f64.sqrt() * term[1])];
    }
    sum
}

impl LowPass {
    /// `angle`: ω h, with h the interval between instants.
    fn new(angle: f64) -> Self {
        let a = [[0.0, 1.0], [-1.0, -2f64.sqrt()]];
        let half = angle / 2f64.sqrt();
        let (s, c) = half.sin_cos();
        let e = |i: usize, j: usize| {
            let unit = f64::from(u8::from(i == j));
            (-half).exp() * (c * unit + s * (2f64.sqrt() * a[i][j] + unit))
        };
        let e = [[e(0, 0), e(0, 1)], [e(1, 0), e(1, 1)]];
        // ∫ e^{A s} b ds = A⁻¹(E − 1) b and ∫ e^{A(h − s)} b s/h ds = A⁻¹(A⁻¹(E − 1) b − h b)/h, with b = (0, 1)
        let solved = |x: [f64; 2]| [-2f64.sqrt() * x[0] - x[1], x[0]];
        let [whole, late] = if angle < SMALL_ANGLE {
            [1.0, 2.0].map(|first| integral(angle, first))
        } else {
            let whole = solved([e[0][1], e[1][1] - 1.0]);
            [whole, solved([whole[0], whole[1] - angle]).map(|x| x / angle)]
        };
        Self { e, g: [[whole[0] - late[0], whole[1] - late[1]], late] }
    }

    /// Applies the low-pass in place to the signals (instants, width) of a sample.
    fn run(&self, sample: &mut [f64], width: usize) {
        let Self { e, g } = self;
        for channel in 0..width {
            let (mut z, mut before) = ([0.0; 2], 0.0);
            for value in sample[channel..].iter_mut().step_by(width) {
                let now = *value;
                let step = |i: usize| e[i][0] * z[0] + e[i][1] * z[1] + g[0][i] * before + g[1][i] * now;
                (z, before) = ([step(0), step(1)], now);
                *value = z[0];
            }
        }
    }

    /// Transpose of [`Self::run`]: turns a cotangent on y into one on the signals.
    fn run_vjp(&self, cotangent: &mut [f64], width: usize) {
        let Self { e, g } = self;
        for channel in 0..width {
            let mut later = [0.0; 2];
            for value in cotangent[channel..].iter_mut().step_by(width).rev() {
                let back = |i: usize| e[0][i] * later[0] + e[1][i] * later[1];
                let here = [*value + back(0), back(1)];
                *value = g[1][0] * here[0] + g[1][1] * here[1] + g[0][0] * later[0] + g[0][1] * later[1];
                later = here;
            }
        }
    }
}

impl Filter {
    /// `interval` is the time between two readings (s).
    pub(crate) fn new(disturbance: &ChipErrors, interval: f64) -> Self {
        let clock = disturbance.clock(interval);
        let step = interval / clock as f64;
        let late = disturbance.delay / step;
        let back = (late.floor() as usize).saturating_sub(1);
        let p = late - back as f64;
        let taps = [
            -(p - 1.0) * (p - 2.0) * (p - 3.0) / 6.0,
            p * (p - 2.0) * (p - 3.0) / 2.0,
            -p * (p - 1.0) * (p - 3.0) / 2.0,
            p * (p - 1.0) * (p - 2.0) / 6.0,
        ];
        let angle = TAU * disturbance.bandwidth * step;
        let low_pass = disturbance.bandwidth.is_finite().then(|| LowPass::new(angle));
        Self { clock, low_pass, back, taps }
    }

    /// Readings (N, readings, width) of signals (N, clock · readings, width) of `samples` samples.
    pub(crate) fn run(&self, mut signals: Vec<f64>, samples: usize, width: usize) -> Vec<f64> {
        let one = signals.len() / samples.max(1);
        let mut read = Vec::with_capacity(signals.len() / self.clock);
        for sample in signals.chunks_exact_mut(one.max(1)) {
            if let Some(low_pass) = &self.low_pass {
                low_pass.run(sample, width);
            }
            for (at, c) in self.readings(one, width) {
                let tapped = self.tapped(at).map(|(tap, at)| tap * sample[at * width + c]);
                read.push(tapped.sum());
            }
        }
        read
    }

    /// Transpose of [`Self::run`]: turns a cotangent on readings into one on signals.
    pub(crate) fn run_vjp(&self, cotangent: &[f64], samples: usize, width: usize) -> Vec<f64> {
        let one = self.clock * cotangent.len() / samples.max(1);
        let mut signals = vec![0.0; one * samples];
        let mut read = cotangent.iter();
        for sample in signals.chunks_exact_mut(one.max(1)) {
            for ((at, c), bar) in self.readings(one, width).zip(&mut read) {
                self.tapped(at).for_each(|(tap, at)| sample[at * width + c] += tap * bar);
            }
            if let Some(low_pass) = &self.low_pass {
                low_pass.run_vjp(sample, width);
            }
        }
        signals
    }

    /// Clock instant, from 0, and channel of each reading of a sample with `values` values.
    fn readings(&self, values: usize, width: usize) -> impl Iterator<Item = (usize, usize)> {
        let clock = self.clock;
        let instants = (1..=values / (width * clock).max(1)).map(move |n| n * clock - 1);
        instants.flat_map(move |at| (0..width).map(move |c| (at, c)))
    }

    /// Weights and instants of the taps for a reading at instant `at`, without those before the first.
    fn tapped(&self, at: usize) -> impl Iterator<Item = (f64, usize)> {
        let newest = at.checked_sub(self.back);
        let tap = move |(j, tap): (usize, f64)| Some((tap, newest?.checked_sub(j)?));
        self.taps.into_iter().enumerate().filter_map(tap)
    }
}

#[cfg(test)]
mod tests;
