//! Casts of a body: random deviations of manufactured bodies from a design.
//!
//! ```text
//! k′ = k e^{σz}     each of k_l, k_s, k_θ, ζ, density, k_c; common to all ligaments and units of a cast
//! k″ = k′ e^{ρz}    each of k_l, k_s, k_θ per ligament, density per unit
//! l₀′ = l₀ e^{σz}   of all ligaments; the grid stays, units shrink
//! α′ = α + s L z    per coordinate of each shift; L = 1, or L Lᵀ = exp(−r²/2c²) for node groups r apart
//! ```
//! z is standard normal and depends on seed, purpose and number of the cast: all bodies of a trial, and trials of equal seed,
//! have the same casts.

use crate::Pool;
use crate::body::Layout;
use crate::brain::linear::factor;
use crate::dynamics::{MaxwellBranch, Parameters, PartFactors, Scene};
use crate::random::{Purpose, Stream};

mod chips;

pub use chips::Chips;

/// Standard deviations of casts.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Deviations {
    /// Of the logarithm of each material parameter.
    pub material: Parameters,
    /// Of the logarithms of k_l, k_s, k_θ per ligament, in addition to `material`.
    pub ligaments: [f64; 3],
    /// Of the logarithm of the density per unit, in addition to `material`.
    pub units: f64,
    /// Of the logarithm of the ligament length; units shrink accordingly, stiffnesses stay.
    pub ligament_length: f64,
    /// Relaxation of the ligaments, only in casts for the final evaluation.
    pub relaxation: Option<MaxwellBranch>,
    /// Of each coordinate of each shift (mm).
    pub nodes: f64,
    /// Correlation length c of the shifts (mm); 0: independent.
    pub correlation: f64,
    /// Of the logarithm of each channel's gain.
    pub gain: f64,
    /// Of each chip's rotation in the plane (rad).
    pub misalignment: f64,
}

/// Independent share of the shifts' variance; without it the covariance is singular in double precision.
const OWN: f64 = 1e-6;

/// Purposes of casts; each has its own casts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u64)]
pub enum Casts {
    /// Training steps.
    Step = 0,
    /// Evaluations of the test set during training.
    Look = 1,
    /// Training samples of decoders for unseen casts.
    Known = 2,
    /// The final evaluation.
    Unseen = 3,
}

/// One manufactured body.
#[derive(Debug, Clone, PartialEq)]
pub struct Cast {
    /// Factor of each material parameter.
    pub material: Parameters,
    /// Further factors per ligament and unit.
    pub parts: PartFactors,
    /// Factor of the ligament length.
    pub ligament_length: f64,
    /// Relaxation of its ligaments; such a cast has no gradient.
    pub relaxation: Option<MaxwellBranch>,
    /// Deviation of each coordinate of α (mm); empty if there is none.
    pub shifts: Vec<f64>,
    /// Deviations of its chips.
    pub chips: Chips,
}

impl Deviations {
    /// The defaults, those of careful manufacture: stiffnesses 5 %, damping 20 %, density 3 %, nodes 0.1 mm.
    pub const USUAL: Self = Self {
        material: Parameters {
            stretch: 0.05,
            shear: 0.05,
            bend: 0.05,
            damping_ratio: 0.2,
            density: 0.03,
            contact: 0.0,
        },
        ligaments: [0.0; 3],
        units: 0.0,
        ligament_length: 0.0,
        relaxation: None,
        nodes: 0.1,
        correlation: 0.0,
        gain: 0.0,
        misalignment: 0.0,
    };

    /// L, by columns, for node groups at their positions without shifts; empty if shifts are independent.
    ///
    /// # Panics
    /// If two groups of the layout coincide.
    pub fn correlation_factor(&self, layout: &Layout, pool: &Pool) -> Vec<f64> {
        if self.nodes == 0.0 || self.correlation == 0.0 {
            return Vec::new();
        }
        let count = layout.groups.count();
        let (vertices, mut at) = (layout.vertices(&vec![0.0; 2 * count]), vec![([0.0; 2], 0.0); count]);
        for (&group, node) in layout.groups.of_nodes.iter().flatten().zip(vertices.iter().flatten()) {
            let Some(group) = group else { continue };
            let (sum, nodes) = &mut at[group];
            *sum = [sum[0] + node[0], sum[1] + node[1]];
            *nodes += 1.0;
        }
        let at: Vec<_> = at.into_iter().map(|(sum, nodes)| sum.map(|x| x / nodes)).collect();
        let alike = |i: usize, j: usize| {
            let r = (at[i][0] - at[j][0]).hypot(at[i][1] - at[j][1]) / self.correlation;
            if i == j { 1.0 } else { (1.0 - OWN) * (-0.5 * r * r).exp() }
        };
        let mut likeness: Vec<f64> = (0..count * count).map(|k| alike(k / count, k % count)).collect();
        factor(pool, &mut likeness, count).expect("a covariance with a part of each group's own");
        likeness
    }

    /// Draws a cast of a body with this layout, number of sensors and [`Deviations::correlation_factor`].
    pub fn cast(
        &self,
        seed: u64,
        casts: Casts,
        number: u64,
        (layout, sensors): (&Layout, usize),
        likeness: &[f64],
    ) -> Cast {
        let stream = |what| Stream::new(Purpose::Cast, seed, [(casts as u64) << 32 | number, what]);
        let mut material = stream(0);
        let factor = |deviation: f64| (deviation * material.normal()).exp();
        let each = |deviation: f64, count: usize, mut stream: Stream| -> Vec<f64> {
            let count = if deviation > 0.0 { count } else { 0 };
            (0..count).map(|_| deviation * stream.normal()).collect()
        };
        let own = each(self.nodes, layout.design_len(), stream(1));
        let shifts = if likeness.is_empty() { own } else { correlate(likeness, &own) };
        let gain = each(self.gain, 3 * sensors, stream(2)).into_iter().map(f64::exp).collect();
        let chips = Chips { gain, turn: each(self.misalignment, sensors, stream(3)) };
        // Every ligament draws all factors, so that one standard deviation does not affect the others.
        let ligaments = if self.ligaments == [0.0; 3] { 0 } else { layout.ligaments.len() };
        let mut of_ligaments = stream(4);
        let mut factors = || self.ligaments.map(|deviation| (deviation * of_ligaments.normal()).exp());
        let parts = PartFactors {
            ligaments: (0..ligaments).map(|_| factors()).collect(),
            units: each(self.units, layout.units(), stream(5)).into_iter().map(f64::exp).collect(),
        };
        let ligament_length = (self.ligament_length * stream(6).normal()).exp();
        let relaxation = self.relaxation.filter(|_| casts == Casts::Unseen);
        let material = Parameters::from_array(self.material.array().map(factor));
        Cast { material, parts, ligament_length, relaxation, shifts, chips }
    }
}

/// Applies L to independent shifts, per axis.
pub(crate) fn correlate(likeness: &[f64], own: &[f64]) -> Vec<f64> {
    let groups = own.len() / 2;
    let shared = |i: usize| {
        let [group, axis] = [i / 2, i % 2];
        (0..=group).map(|other| likeness[other * groups + group] * own[2 * other + axis]).sum()
    };
    (0..own.len()).map(shared).collect()
}

/// Applies Lᵀ; the transpose of [`correlate`].
pub(crate) fn shared_vjp(likeness: &[f64], shared: &[f64]) -> Vec<f64> {
    let groups = shared.len() / 2;
    let own = |i: usize| {
        let [other, axis] = [i / 2, i % 2];
        (other..groups).map(|group| likeness[other * groups + group] * shared[2 * group + axis]).sum()
    };
    (0..shared.len()).map(own).collect()
}

impl Cast {
    /// The scene of this cast.
    pub fn scene(&self, scene: &Scene) -> Scene {
        let [mut own, by] = [Parameters::of(scene), self.material].map(Parameters::array);
        own.iter_mut().zip(by).for_each(|(own, by)| *own *= by);
        let (parts, relaxation) = (self.parts.clone(), self.relaxation);
        let mut scene = Scene { parts, relaxation, ..Parameters::from_array(own).set(scene) };
        if self.ligament_length != 1.0 {
            scene.layout =
                scene.layout.with_ligament_length(self.ligament_length * scene.layout.ligament_length);
        }
        scene
    }

    /// α of this cast (mm). Gradients in it equal those in the design.
    pub fn design(&self, design: &[f64]) -> Vec<f64> {
        let mut design = design.to_vec();
        design.iter_mut().zip(&self.shifts).for_each(|(own, by)| *own += by);
        design
    }
}

#[cfg(test)]
mod tests;
