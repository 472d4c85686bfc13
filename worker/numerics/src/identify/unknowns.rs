//! What is fitted: z standard normal, of all that a variation scatters, and the cast that it stands for.

use crate::Pool;
use crate::dynamics::{Gradient, Parameters, Parts, Scene};
use crate::identify::{BOX, Parameter};
use crate::variation::{Cast, Chips, Variation, shared, shared_vjp};
use std::ops::Range;

/// What one entry of z moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unknown {
    /// A parameter, of all ligaments and units alike.
    Material(Parameter),
    /// l₀ of all ligaments.
    LigamentLength,
    /// How forces run between the instants of their clock: at 0 linearly, at 1 as smoothly as their samples. It belongs to the records, not to
    /// the cast.
    Sharpness,
    /// The gain of a channel (of 3M).
    Gain(usize),
    /// The turn of a chip.
    Turn(usize),
    /// A coordinate of the shift of a node group (of α).
    Shift(usize),
    /// k_l, k_s or k_θ of a ligament beside that of all.
    Ligament(usize, usize),
    /// The density of a unit, likewise.
    Unit(usize),
}

impl Unknown {
    /// The parameter that it moves, if it moves one of all ligaments or units alike.
    #[must_use]
    pub fn parameter(self) -> Option<Parameter> {
        if let Self::Material(parameter) = self { Some(parameter) } else { None }
    }
}

/// ln 10: standard deviation of the logarithm of a free parameter.
const TRUST: f64 = std::f64::consts::LN_10;
/// Longest step of an unknown; of a free parameter, of its logarithm.
pub const STRIDE: f64 = 2.0;
const FREE_STRIDE: f64 = std::f64::consts::LN_2;

/// The unknowns of a body with its sensors, in this order: those of the cast as a whole, its chips, its nodes, its parts.
pub struct Unknowns {
    variation: Variation,
    /// How many are free parameters; they come first.
    free: usize,
    likeness: Vec<f64>,
    all: Vec<Unknown>,
    ligaments: usize,
    units: usize,
    sensors: usize,
}

impl Unknowns {
    /// Of a cast.
    pub fn new(scene: &Scene, variation: &Variation, pool: &Pool) -> Self {
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
            likeness: variation.likeness(layout, pool),
            all,
            ligaments: layout.ligaments.len(),
            units: layout.units(),
            sensors,
        }
    }

    /// Of a cast with these parameters free, the others held, or, if there are none, all as they scatter; and of its records' forces.
    pub fn of_records(scene: &Scene, variation: &Variation, free: &[Parameter], pool: &Pool) -> Self {
        let material = std::array::from_fn(|k| if free.contains(&Parameter::ALL[k]) { TRUST } else { 0.0 });
        let material = if free.is_empty() { variation.material } else { Parameters::from_array(material) };
        let mut unknowns = Self::new(scene, &Variation { material, ..*variation }, pool);
        let is_material = |unknown: &&Unknown| matches!(unknown, Unknown::Material(_));
        let first = unknowns.all.iter().filter(is_material).count();
        unknowns.all.insert(first, Unknown::Sharpness);
        unknowns.free = if free.is_empty() { 0 } else { first };
        unknowns
    }

    pub fn all(&self) -> &[Unknown] {
        &self.all
    }

    /// How many are free parameters; they come first.
    pub fn free(&self) -> usize {
        self.free
    }

    /// The logarithm of z = 1 of a free parameter.
    pub fn log(&self) -> f64 {
        TRUST
    }

    /// Largest |z| of the `k`-th.
    pub fn limit(&self, k: usize) -> f64 {
        if k < self.free { BOX.ln() / TRUST } else { f64::INFINITY }
    }

    /// By how many of its longest steps the `k`-th moves in a step.
    pub fn strides(&self, k: usize, step: f64) -> f64 {
        step.abs() / if k < self.free { FREE_STRIDE / TRUST } else { STRIDE }
    }

    /// By which part forces are smooth.
    pub fn sharpness(&self, z: &[f64]) -> f64 {
        self.all.iter().position(|of| *of == Unknown::Sharpness).map_or(0.0, |k| z[k])
    }

    /// Its standard deviation: of a logarithm, in rad, in mm.
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

    /// The cast that z stands for.
    pub fn cast(&self, z: &[f64]) -> Cast {
        let (mut material, mut ligament_length) = ([1.0; 6], 1.0);
        let count = |deviation: f64, count: usize| if deviation > 0.0 { count } else { 0 };
        let mut chips = Chips {
            gain: vec![1.0; count(self.variation.gain, 3 * self.sensors)],
            turn: vec![0.0; count(self.variation.misalignment, self.sensors)],
        };
        let some = self.variation.ligaments.iter().any(|deviation| *deviation > 0.0);
        let mut parts = Parts {
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
            shifts = shared(&self.likeness, &shifts);
        }
        let material = Parameters::from_array(material);
        Cast { material, parts, ligament_length, relaxation: None, shifts, chips }
    }

    /// dF/dz of a gradient in the parameters, parts and design of the scene of `cast`, and in the logarithms of its chips' gains and
    /// in their turns. Nothing of the length and of the forces.
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
