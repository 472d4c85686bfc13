//! What a real chip adds to the signals that it reads: a bias, noise, steps, and an end of its range.
//!
//! ```text
//! a′_c(t_n) = clip(round(y_c(t_n) + b_c + e_c(t_n)))      y: behind low-pass and delay (`filter`)
//! ```
//! b normal a sample and channel, e a reading. Draws are keyed by the sample's own force history, sensor and channel, so
//! that every body, and every set in which a sample stands, meets the same ones.

use crate::dynamics::Forces;
use crate::random::{Purpose, Stream};

/// A chip's imperfections.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disturbance {
    /// Standard deviation of e.
    pub noise: Size,
    /// Standard deviation of b.
    pub bias: Size,
    /// How late signals come (s).
    pub delay: f64,
    /// Cut-off of the low-pass (Hz); infinite: none.
    pub bandwidth: f64,
    /// Largest readings of accelerations (mm/s²) and angular velocities (rad/s), either way.
    pub range: [f64; 2],
    /// Steps in which they are read; 0: all of them.
    pub resolution: [f64; 2],
}

impl Disturbance {
    /// That of a chip that tells all.
    pub const NONE: Self = Self {
        noise: Size::Relative(0.0),
        bias: Size::Relative(0.0),
        delay: 0.0,
        bandwidth: f64::INFINITY,
        range: [f64::INFINITY; 2],
        resolution: [0.0; 2],
    };
}

/// A standard deviation of signals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Size {
    /// Relative to each channel's RMS over the training signals of the initial body, or of [`Problem::relative_to`].
    ///
    /// [`Problem::relative_to`]: super::Problem::relative_to
    Relative(f64),
    /// Of accelerations (mm/s²) and angular velocities (rad/s).
    Physical([f64; 2]),
}

impl Size {
    /// Of each channel of the given RMS.
    pub(crate) fn of(self, rms: &[f64], channels: &[usize]) -> Vec<f64> {
        let size = |(rms, &channel): (&f64, &usize)| match self {
            Self::Relative(part) => part * rms,
            Self::Physical(size) => size[usize::from(channel == 2)],
        };
        rms.iter().zip(channels.iter().cycle()).map(size).collect()
    }
}

/// A disturbance at the scale of one trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Chip {
    seed: u64,
    /// Which of a_x (0), a_y (1) and ω (2) are read of each sensor.
    channels: Vec<usize>,
    /// A channel that is read.
    pub(crate) noise: Vec<f64>,
    pub(crate) bias: Vec<f64>,
    range: [f64; 2],
    resolution: [f64; 2],
}

impl Chip {
    /// `rms` is that of each channel that is read.
    pub(crate) fn new(disturbance: &Disturbance, seed: u64, rms: &[f64], channels: &[usize]) -> Self {
        Self {
            seed,
            channels: channels.to_vec(),
            noise: disturbance.noise.of(rms, channels),
            bias: disturbance.bias.of(rms, channels),
            range: disturbance.range,
            resolution: disturbance.resolution,
        }
    }

    /// The same with draws of another seed than the trial's.
    #[must_use]
    pub fn seeded(self, seed: u64) -> Self {
        Self { seed, ..self }
    }

    /// Standard deviation of what a reading of each channel is off by: its noise, and a step's rounding.
    pub(crate) fn deviations(&self) -> Vec<f64> {
        let of = |(i, noise): (usize, &f64)| noise.hypot(self.resolution[self.kind(i)] / 12f64.sqrt());
        self.noise.iter().enumerate().map(of).collect()
    }

    /// Overwrites signals (N, T, channels) of `forces` with what the chip says.
    pub fn disturb(&self, signals: &mut [f64], forces: &Forces) {
        let (channels, read) = (self.noise.len(), self.channels.len());
        for (i, sample) in
            signals.chunks_exact_mut((signals.len() / forces.samples.max(1)).max(1)).enumerate()
        {
            let key = forces.sample(i).iter().fold(0, |key: u64, f| {
                (key.rotate_left(5) ^ f.to_bits()).wrapping_mul(0x517c_c1b7_2722_0a95)
            });
            for c in (0..channels).filter(|&c| self.noise[c] > 0.0 || self.bias[c] > 0.0) {
                // what is read of a channel does not hang on the others
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

    /// Readings (T, channels) in whole steps, and none beyond the range.
    fn read(&self, sample: &mut [f64]) {
        if (self.range, self.resolution) == (Disturbance::NONE.range, Disturbance::NONE.resolution) {
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

    /// 0 of an acceleration, 1 of an angular velocity, of the `i`-th reading.
    fn kind(&self, i: usize) -> usize {
        usize::from(self.channels[i % self.channels.len()] == 2)
    }

    /// How many readings (.., channels) are at the end of the range.
    pub(crate) fn saturated(&self, says: &[f64]) -> usize {
        says.iter().enumerate().filter(|&(i, reading)| self.is_at_the_end(i, *reading)).count()
    }

    /// Of the `i`-th reading.
    fn is_at_the_end(&self, i: usize, reading: f64) -> bool {
        reading.abs() >= self.range[self.kind(i)]
    }

    /// A cotangent (N, T, channels) on what the chip `says` as one on what it read: a reading at the end of its range tells nothing.
    /// Steps pass it on as if they were none.
    pub fn disturb_vjp(&self, cotangent: &mut [f64], says: &[f64]) {
        if self.range != Disturbance::NONE.range {
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
