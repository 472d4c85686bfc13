//! Casts of a body: what mould, silicone and hands make of one design.
//!
//! ```text
//! k′ = k e^{σz}     each of k_l, k_s, k_θ, ζ, density, k_c, the same for all ligaments and units of a cast
//! α′ = α + s z      each coordinate of each shift
//! ```
//! z standard normal, keyed by seed, purpose and number of the cast: all bodies of a trial, and trials of equal seed, meet the
//! same casts.

use crate::dynamics::{Parameters, Scene};
use crate::random::{Purpose, Stream};

/// How casts scatter about what was designed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Variation {
    /// Standard deviation of the logarithm of each parameter.
    pub material: Parameters,
    /// Standard deviation of each coordinate of each shift (mm).
    pub nodes: f64,
}

/// What casts are for; no two purposes share one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u64)]
pub enum Casts {
    /// A step of training.
    Step = 0,
    /// The looks at the test set on the way.
    Look = 1,
    /// Samples for a brain that is to read casts which it has not seen.
    Known = 2,
    /// The judgement at the end.
    Unseen = 3,
}

/// One body as it came out of its mould.
#[derive(Debug, Clone, PartialEq)]
pub struct Cast {
    /// By what each parameter is multiplied.
    pub material: Parameters,
    /// What is added to each coordinate of α (mm); empty where moulds are exact.
    pub shifts: Vec<f64>,
}

impl Variation {
    /// A cast of a body of so many design parameters.
    pub fn cast(&self, seed: u64, casts: Casts, number: u64, parameters: usize) -> Cast {
        let stream = |what| Stream::new(Purpose::Cast, seed, [(casts as u64) << 32 | number, what]);
        let mut material = stream(0);
        let factor = |deviation: f64| (deviation * material.normal()).exp();
        let mut nodes = stream(1);
        let shifts = if self.nodes > 0.0 { parameters } else { 0 };
        Cast {
            material: Parameters::from_array(self.material.array().map(factor)),
            shifts: (0..shifts).map(|_| self.nodes * nodes.normal()).collect(),
        }
    }
}

impl Cast {
    /// The scene of this cast.
    pub fn scene(&self, scene: &Scene) -> Scene {
        let [mut own, by] = [Parameters::of(scene), self.material].map(Parameters::array);
        own.iter_mut().zip(by).for_each(|(own, by)| *own *= by);
        Parameters::from_array(own).set(scene)
    }

    /// α of this cast (mm); dα of a function of it is that of the design.
    pub fn design(&self, design: &[f64]) -> Vec<f64> {
        let mut design = design.to_vec();
        design.iter_mut().zip(&self.shifts).for_each(|(own, by)| *own += by);
        design
    }
}

#[cfg(test)]
mod tests;
