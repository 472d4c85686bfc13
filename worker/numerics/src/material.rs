//! Stiffnesses of a ligament: a short rubber beam of rectangular section.
//!
//! ```text
//! k_l = E t w/l      k_θ = E I/l      k_s = 12 E I/(l³ (1 + Φ))      I = t w³/12      Φ = 12 E I/(κ G A l²) = (E/κG) (w/l)²
//! ```
//! Timoshenko beam between two rigid ends (Przemieniecki, Theory of Matrix Structural Analysis, 1968, §5.6). Its energy, ½ k_l
//! Δl² + ½ k_s (l γ)² + ½ k_θ Δθ², has the terms of MODEL.md. Rubber is incompressible: E/G = 3, and κ = 10 (1 + ν)/(12 + 11 ν) =
//! 6/7 with ν = ½ (Cowper 1966, doi:10.1115/1.3625046).

use crate::dynamics::LigamentStiffness;

/// κ of a rectangle, ν = ½.
const SHEAR_CORRECTION: f64 = 6.0 / 7.0;
/// E/G, ν = ½.
const YOUNG_TO_SHEAR: f64 = 3.0;

/// Material and dimensions of a ligament.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LigamentMaterial {
    /// E (MPa).
    pub modulus: f64,
    /// t, out of the plane (mm).
    pub thickness: f64,
    /// w, in the plane and across the ligament (mm).
    pub width: f64,
    /// l (mm).
    pub length: f64,
}

impl LigamentMaterial {
    /// The ligament with these stiffnesses in stretch and bending: w = √(12 k_θ/k_l), E t = k_l l/w. Its shear stiffness follows.
    pub fn of(stiffness: &LigamentStiffness, length: f64, thickness: f64) -> Self {
        let width = (12.0 * stiffness.bend / stiffness.stretch).sqrt();
        Self { modulus: stiffness.stretch * length / (thickness * width), thickness, width, length }
    }

    /// Stiffnesses of the ligament.
    pub fn stiffness(&self) -> LigamentStiffness {
        let Self { modulus, thickness, width, length } = *self;
        let bend = modulus * thickness * width.powi(3) / (12.0 * length);
        let shearing = YOUNG_TO_SHEAR / SHEAR_CORRECTION * (width / length).powi(2);
        LigamentStiffness {
            stretch: modulus * thickness * width / length,
            shear: 12.0 * bend / (length * length * (1.0 + shearing)),
            bend,
        }
    }
}

/// Young's modulus (MPa) at small strain of rubber with this engineering stress (MPa) at 100 % strain: incompressible
/// neo-Hookean, σ = E/3 (λ − λ⁻²) at λ = 2.
pub fn modulus_at_rest(stress_at_100_percent: f64) -> f64 {
    3.0 * stress_at_100_percent / (2.0 - 0.25)
}

/// Shore A hardness of rubber of this Young's modulus (MPa): E = 0.0981 (56 + 7.62336 S)/(0.137505 (254 − 2.54 S)), by Gent 1958
/// (doi:10.5254/1.3542351). Negative if too soft for the scale.
pub fn shore_a(modulus: f64) -> f64 {
    let lifted = 0.137505 * modulus;
    (254.0 * lifted - 0.0981 * 56.0) / (0.0981 * 7.62336 + 2.54 * lifted)
}

#[cfg(test)]
mod tests;
