//! The unknowns z (standard normal prior) and the cast that they define.

use crate::Pool;
use crate::dynamics::{Gradient, Parameters, PartFactors, Scene};
use crate::identify::{BOX, Parameter};
use crate::variation::{Cast, Chips, Deviations, correlate, shared_vjp};
use std::ops::Range;

/// Quantity that one entry of z changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unknown {
    /// A parameter, common to all ligaments and units.
    Material(Parameter),
    /// l₀ of all ligaments.
    LigamentLength,
    /// Forces between their samples: linear at 0, smooth at 1. A property of the records, not of the cast.
    Sharpness,
    /// Gain of a channel (of 3M).
    Gain(usize),
    /// Misalignment angle of a chip.
    Turn(usize),
    /// Coordinate of a node group's shift (index into α).
    Shift(usize),
    /// k_l, k_s or k_θ of one ligament, relative to the common value.
    Ligament(usize, usize),
    /// Density of one unit, relative to the common value.
    Unit(usize),
}

impl Unknown {
    /// The common parameter that this unknown changes, if any.
    pub fn parameter(self) -> Option<Parameter> {
        if let Self::Material(parameter) = self { Some(parameter) } else { None }
    }
}

/// ln 10: prior standard deviation of the logarithm of a free parameter.
pub const TRUST: f64 = std::f64::consts::LN_10;
/// Longest step of an unknown (standard deviations), and of a free parameter's logarithm.
pub const STRIDE: f64 = 2.0;
const FREE_STRIDE: f64 = std::f64::consts::LN_2;

/// Unknowns of a body with sensors, in this order: of the whole cast, chips, nodes, ligaments and units.
pub struct Unknowns {
    variation: Deviations,
    /// Number of free parameters; they come first.
    free: usize,
    likeness: Vec<f64>,
    all: Vec<Unknown>,
    ligaments: usize,
    units: usize,
    sensors: usize,
}

impl Unknowns {
    /// Unknowns of a cast.
    pub fn new(scene: &Scene, variation: &Deviations, pool: &Pool) -> Self {
        let (layout, sensors) = (&scene.layout, scene.sensors.len());
        let own = Parameters::of(scene).array();
        let mut all = Vec::new();
        for (parameter, deviation) in Parameter::ALL.into_iter().zip(variation.material.array()) {
            if deviation > 0.0 && own[parameter as usize] > 0.0 {
                all.push(Unknown::Material(parameter));
            }
        }
        let count = |deviation: f64, count: usize| if deviation > 0.0 { count } else { 0 };
        all.extend((0..count(variation.ligament_length, 1)).map(|_| Unknown::LigamentLength));
        all.extend((0..count(variation.gain, 3 * sensors)).map(Unknown::Gain));
        all.extend((0..count(variation.misalignment, sensors)).map(Unknown::Turn));
        all.extend((0..count(variation.nodes, layout.design_len())).map(Unknown::Shift));
        for k in 0..3 {
            let some = count(variation.ligaments[k], layout.ligaments.len());
            all.extend((0..some).map(|ligament| Unknown::Ligament(ligament, k)));
        }
        all.extend((0..count(variation.units, layout.units())).map(Unknown::Unit));
        Self {
            free: 0,
            variation: *variation,
            likeness: variation.correlation_factor(layout, pool),
            all,
            ligaments: layout.ligaments.len(),
            units: layout.units(),
            sensors,
        }
    }

    /// Unknowns of a cast and of its records' forces. Parameters in `free` are fitted and the others held; if it is empty, all have the
    /// variation's prior.
    pub fn of_records(scene: &Scene, variation: &Deviations, free: &[Parameter], pool: &Pool) -> Self {
        let material = std::array::from_fn(|k| if free.contains(&Parameter::ALL[k]) { TRUST } else { 0.0 });
        let material = if free.is_empty() { variation.material } else { Parameters::from_array(material) };
        let mut unknowns = Self::new(scene, &Deviations { material, ..*variation }, pool);
        let is_material = |unknown: &&Unknown| matches!(unknown, Unknown::Material(_));
        let first = unknowns.all.iter().filter(is_material).count();
        unknowns.all.insert(first, Unknown::Sharpness);
        unknowns.free = if free.is_empty() { 0 } else { first };
        unknowns
    }

    pub fn all(&self) -> &[Unknown] {
        &self.all
    }

    /// Number of free parameters; they come first.
    pub fn free(&self) -> usize {
        self.free
    }

    /// Largest |z| of unknown `k`.
    pub fn limit(&self, k: usize) -> f64 {
        if k < self.free { BOX.ln() / TRUST } else { f64::INFINITY }
    }

    /// Length of a step of unknown `k` relative to its longest.
    pub fn strides(&self, k: usize, step: f64) -> f64 {
        step.abs() / if k < self.free { FREE_STRIDE / TRUST } else { STRIDE }
    }

    /// Value of `Sharpness` in z.
    pub fn sharpness(&self, z: &[f64]) -> f64 {
        self.all.iter().position(|of| *of == Unknown::Sharpness).map_or(0.0, |k| z[k])
    }

    /// Prior standard deviation: of a logarithm, in rad, or in mm.
    pub fn deviation(&self, unknown: Unknown) -> f64 {
        let of = &self.variation;
        match unknown {
            Unknown::Material(parameter) => of.material.array()[parameter as usize],
            Unknown::LigamentLength => of.ligament_length,
            Unknown::Sharpness => 1.0,
            Unknown::Gain(_) => of.gain,
            Unknown::Turn(_) => of.misalignment,
            Unknown::Shift(_) => of.nodes,
            Unknown::Ligament(_, k) => of.ligaments[k],
            Unknown::Unit(_) => of.units,
        }
    }

    fn shifts(&self) -> Range<usize> {
        let is = |unknown: &&Unknown| matches!(unknown, Unknown::Shift(_));
        let first = self.all.iter().position(|unknown| is(&unknown)).unwrap_or(0);
        first..first + self.all.iter().filter(is).count()
    }

    /// The cast that z defines.
    pub fn cast(&self, z: &[f64]) -> Cast {
        let (mut material, mut ligament_length) = ([1.0; 6], 1.0);
        let count = |deviation: f64, count: usize| if deviation > 0.0 { count } else { 0 };
        let mut chips = Chips {
            gain: vec![1.0; count(self.variation.gain, 3 * self.sensors)],
            turn: vec![0.0; count(self.variation.misalignment, self.sensors)],
        };
        let some = self.variation.ligaments.iter().any(|deviation| *deviation > 0.0);
        let mut parts = PartFactors {
            ligaments: vec![[1.0; 3]; if some { self.ligaments } else { 0 }],
            units: vec![1.0; count(self.variation.units, self.units)],
        };
        let mut shifts = vec![0.0; self.shifts().len()];
        for (&unknown, z) in self.all.iter().zip(z) {
            let by = self.deviation(unknown) * z;
            match unknown {
                Unknown::Material(parameter) => material[parameter as usize] = by.exp(),
                Unknown::LigamentLength => ligament_length = by.exp(),
                Unknown::Sharpness => {}
                Unknown::Gain(channel) => chips.gain[channel] = by.exp(),
                Unknown::Turn(chip) => chips.turn[chip] = by,
                Unknown::Shift(i) => shifts[i] = by,
                Unknown::Ligament(ligament, k) => parts.ligaments[ligament][k] = by.exp(),
                Unknown::Unit(unit) => parts.units[unit] = by.exp(),
            }
        }
        if !self.likeness.is_empty() {
            shifts = correlate(&self.likeness, &shifts);
        }
        let material = Parameters::from_array(material);
        Cast { material, parts, ligament_length, relaxation: None, shifts, chips }
    }

    /// Part of dF/dz from gradients in the parameters, parts and design of the scene of `cast`, and in the chips' log gains and angles.
    /// Zero for ligament length and sharpness.
    pub fn pull(&self, scene: &Scene, cast: &Cast, gradient: &Gradient, chips: &Chips) -> Vec<f64> {
        let parameters = gradient.parameters.expect("asked for").array();
        let at = Parameters::of(scene).array();
        let own = gradient.parts.as_ref().expect("asked for");
        let shifts = match self.likeness.is_empty() {
            true => gradient.design.clone(),
            false => shared_vjp(&self.likeness, &gradient.design),
        };
        let of = |&unknown: &Unknown| {
            let slope = match unknown {
                Unknown::Material(parameter) => parameters[parameter as usize] * at[parameter as usize],
                Unknown::LigamentLength | Unknown::Sharpness => 0.0,
                Unknown::Gain(channel) => chips.gain[channel],
                Unknown::Turn(chip) => chips.turn[chip],
                Unknown::Shift(i) => shifts[i],
                Unknown::Ligament(ligament, k) => {
                    own.ligaments[ligament][k] * cast.parts.ligaments[ligament][k]
                }
                Unknown::Unit(unit) => own.units[unit] * cast.parts.units[unit],
            };
            self.deviation(unknown) * slope
        };
        self.all.iter().map(of).collect()
    }
}
