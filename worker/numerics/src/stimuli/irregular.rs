//! Blows of a hand-held hammer: skewed, rough, sometimes double. Each sample strikes one random panel.
//!
//! ```text
//! f(t) = b(t)·max(0, 1 + ρ·r(z)) + λ·b(t − W − G)·max(0, 1 + ρ·r′(z′))        z = (t − O)/W
//! r(z) = Σ c_j sin(π j z + φ_j), j = 3…9,  c_j ~ normal/√j,  of RMS 1
//! ```
//! b is a bell pulse with an early peak. A second hit (probability `double`) follows a gap G after the end of the first, with λ
//! times its amplitude and its own roughness.

use std::f64::consts::PI;
use std::ops::Range;

use super::{Bell, Pulse, sampled};
use crate::dynamics::Forces;
use crate::random::{Purpose, Stream};

/// Intervals `[min, max]` of the uniform distributions of a blow's parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Irregular {
    /// Smooth part.
    pub bell: Bell,
    /// ρ: RMS of the rough part relative to the smooth part.
    pub roughness: [f64; 2],
    /// Probability of a second hit.
    pub double: f64,
    /// G (s).
    pub gap: [f64; 2],
    /// λ.
    pub rebound: [f64; 2],
}

/// Harmonics of the rough part: half waves per width.
const HARMONICS: [f64; 7] = [3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0];

/// One hit: a pulse and its roughness.
struct Hit {
    pulse: Pulse,
    roughness: f64,
    /// Amplitude and phase of each harmonic.
    waves: [[f64; 2]; HARMONICS.len()],
}

impl Hit {
    fn new(pulse: Pulse, roughness: f64, stream: &mut Stream) -> Self {
        let mut waves = HARMONICS.map(|j| [stream.normal() / j.sqrt(), stream.between([0.0, 2.0 * PI])]);
        let size = (0.5 * waves.iter().map(|w| w[0] * w[0]).sum::<f64>()).sqrt().max(f64::MIN_POSITIVE);
        waves.iter_mut().for_each(|w| w[0] /= size);
        Self { pulse, roughness, waves }
    }

    fn force(&self, t: f64) -> f64 {
        let z = (t - self.pulse.onset) / self.pulse.width;
        let rough: f64 =
            HARMONICS.iter().zip(&self.waves).map(|(j, [c, phase])| c * (PI * j * z + phase).sin()).sum();
        self.pulse.force(t) * (1.0 + self.roughness * rough).max(0.0)
    }
}

/// Force histories of the samples numbered `samples`; each depends on (purpose, seed, sample) only.
pub fn irregular(
    kind: &Irregular,
    purpose: Purpose,
    seed: u64,
    samples: Range<u64>,
    panels: usize,
    duration: f64,
    instants: usize,
) -> Forces {
    let count = (samples.end - samples.start) as usize;
    let mut values = vec![0.0; count * panels * (instants + 1)];
    for (sample, histories) in samples.zip(values.chunks_exact_mut(panels * (instants + 1))) {
        let mut stream = Stream::new(purpose, seed, [sample, u64::MAX]);
        let panel = stream.below(panels);
        let first = kind.bell.draw(&mut stream);
        let roughness = stream.between(kind.roughness);
        let mut hits = vec![Hit::new(first, roughness, &mut stream)];
        if stream.uniform() < kind.double {
            let onset = first.onset + first.width + stream.between(kind.gap);
            let second = Pulse { onset, amplitude: first.amplitude * stream.between(kind.rebound), ..first };
            hits.push(Hit::new(second, roughness, &mut stream));
        }
        let history = &mut histories[panel * (instants + 1)..][..=instants];
        sampled(history, duration, |t| hits.iter().map(|hit| hit.force(t)).sum());
    }
    Forces { samples: count, panels, instants, values, strikes: Vec::new() }
}

#[cfg(test)]
mod tests;
