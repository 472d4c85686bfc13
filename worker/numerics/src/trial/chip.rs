//! Imperfections of a sensor chip: bias, noise, resolution and range.
//!
//! ```text
//! a′_c(t_n) = clip(round(y_c(t_n) + b_c + e_c(t_n)))      y: after low-pass and delay (`filter`)
//! ```
//! b is drawn (normal) per sample and channel, e per reading. The key of a draw is the sample's force history, the sensor and
//! the channel, so a sample has the same noise in every body and every set.

use crate::dynamics::Forces;
use crate::random::{Purpose, Stream};

/// Imperfections of a chip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChipErrors {
    /// Standard deviation of e.
    pub noise: Size,
    /// Standard deviation of b.
    pub bias: Size,
    /// Delay of the signals (s).
    pub delay: f64,
    /// Cut-off of the low-pass (Hz); infinite: none.
    pub bandwidth: f64,
    /// Largest magnitude of accelerations (mm/s²) and angular velocities (rad/s).
    pub range: [f64; 2],
    /// Step to which readings are rounded, in the same units; 0: none.
    pub resolution: [f64; 2],
}

impl ChipErrors {
    /// An ideal chip.
    pub const NONE: Self = Self {
        noise: Size::Relative(0.0),
        bias: Size::Relative(0.0),
        delay: 0.0,
        bandwidth: f64::INFINITY,
        range: [f64::INFINITY; 2],
        resolution: [0.0; 2],
    };
}

/// Standard deviation of noise or bias.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Size {
    /// Relative to each channel's RMS over the training signals of the initial body, or of [`Problem::relative_to`].
    ///
    /// [`Problem::relative_to`]: super::Problem::relative_to
    Relative(f64),
    /// For accelerations (mm/s²) and angular velocities (rad/s).
    Physical([f64; 2]),
}

impl Size {
    /// Standard deviation per channel; `rms` is the RMS of each channel.
    pub fn of(self, rms: &[f64], channels: &[usize]) -> Vec<f64> {
        let size = |(rms, &channel): (&f64, &usize)| match self {
            Self::Relative(part) => part * rms,
            Self::Physical(size) => size[usize::from(channel == 2)],
        };
        rms.iter().zip(channels.iter().cycle()).map(size).collect()
    }
}

/// The imperfections of the chips of a trial, with absolute standard deviations.
#[derive(Debug, Clone, PartialEq)]
pub struct Chip {
    seed: u64,
    /// Measured channels of each sensor: a_x (0), a_y (1), ω (2).
    channels: Vec<usize>,
    /// Standard deviation per measured channel.
    pub noise: Vec<f64>,
    /// Standard deviation of the constant error per measured channel.
    pub bias: Vec<f64>,
    range: [f64; 2],
    resolution: [f64; 2],
}

impl Chip {
    /// `rms`: RMS of each measured channel.
    pub(crate) fn new(disturbance: &ChipErrors, seed: u64, rms: &[f64], channels: &[usize]) -> Self {
        Self {
            seed,
            channels: channels.to_vec(),
            noise: disturbance.noise.of(rms, channels),
            bias: disturbance.bias.of(rms, channels),
            range: disturbance.range,
            resolution: disturbance.resolution,
        }
    }

    /// The chip with another seed for its draws.
    pub fn seeded(self, seed: u64) -> Self {
        Self { seed, ..self }
    }

    /// Standard deviation of the error of a reading, per channel: noise and rounding.
    pub(crate) fn deviations(&self) -> Vec<f64> {
        let of = |(i, noise): (usize, &f64)| noise.hypot(self.resolution[self.kind(i)] / 12f64.sqrt());
        self.noise.iter().enumerate().map(of).collect()
    }

    /// Replaces the signals (N, T, channels) under `forces` by the chip's readings.
    pub fn disturb(&self, signals: &mut [f64], forces: &Forces) {
        let (channels, read) = (self.noise.len(), self.channels.len());
        for (i, sample) in
            signals.chunks_exact_mut((signals.len() / forces.samples.max(1)).max(1)).enumerate()
        {
            let key = forces.sample(i).iter().fold(0, |key: u64, f| {
                (key.rotate_left(5) ^ f.to_bits()).wrapping_mul(0x517c_c1b7_2722_0a95)
            });
            for c in (0..channels).filter(|&c| self.noise[c] > 0.0 || self.bias[c] > 0.0) {
                // a channel's noise does not depend on the other channels
                let channel = 3 * (c / read) + self.channels[c % read];
                let mut stream = Stream::new(Purpose::Chip, self.seed, [key, channel as u64]);
                let bias = self.bias[c] * stream.normal();
                for reading in sample[c..].iter_mut().step_by(channels) {
                    *reading += bias + self.noise[c] * stream.normal();
                }
            }
            self.read(sample);
        }
    }

    /// Rounds readings (T, channels) to whole steps and limits them to the range.
    fn read(&self, sample: &mut [f64]) {
        if (self.range, self.resolution) == (ChipErrors::NONE.range, ChipErrors::NONE.resolution) {
            return;
        }
        for (i, reading) in sample.iter_mut().enumerate() {
            let kind = self.kind(i);
            let (most, step) = (self.range[kind], self.resolution[kind]);
            if step > 0.0 {
                *reading = (*reading / step).round() * step;
            }
            *reading = reading.clamp(-most, most);
        }
    }

    /// 0 if the `i`-th reading is an acceleration, 1 if it is an angular velocity.
    fn kind(&self, i: usize) -> usize {
        usize::from(self.channels[i % self.channels.len()] == 2)
    }

    /// Number of readings (.., channels) at the limit of the range.
    pub(crate) fn saturated(&self, says: &[f64]) -> usize {
        says.iter().enumerate().filter(|&(i, reading)| self.is_at_the_end(i, *reading)).count()
    }

    fn is_at_the_end(&self, i: usize, reading: f64) -> bool {
        reading.abs() >= self.range[self.kind(i)]
    }

    /// Turns a cotangent (N, T, channels) on the readings `says` into one on the undisturbed signals: 0 at the limit of the range.
    /// Rounding is ignored.
    pub fn disturb_vjp(&self, cotangent: &mut [f64], says: &[f64]) {
        if self.range != ChipErrors::NONE.range {
            for (i, (cotangent, reading)) in cotangent.iter_mut().zip(says).enumerate() {
                if self.is_at_the_end(i, *reading) {
                    *cotangent = 0.0;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
