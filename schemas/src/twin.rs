//! A twin on disk (TOML): the cast of a body that best explains records of it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What `metasense lab identify --out` writes and `metasense lab evaluate` reads. Empty lists stand for what did not scatter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Twin {
    /// The body that it is one of: [`crate::spec::TrialSpec::body_digest`].
    pub body: String,
    /// Root mean square of what it leaves of the records' signals, by the noise of the chips.
    pub misfit: f64,
    /// What stands for the noise of each signal that is read: what it leaves, but no less than the chips'. Unit: mm/s², rad/s.
    pub noise: Vec<f64>,
    /// By what the ligaments' length is multiplied.
    pub ligament_length: f64,
    /// By what each channel of the sensors (a_x, a_y, ω of each).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub gain: Vec<f64>,
    /// By how much each sensor is turned. Unit: degrees.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub turn: Vec<f64>,
    /// What is added to each coordinate of the design. Unit: mm.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shifts: Vec<f64>,
    /// By what stretch, shear and bend of each ligament are multiplied, beside the material.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub ligaments: Vec<[f64; 3]>,
    /// By what the density of each unit, likewise.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub units: Vec<f64>,
    /// By what each parameter of the spec is multiplied.
    pub material: Factors,
}

/// Factors of the material's parameters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Factors {
    /// Of k_l.
    pub stretch: f64,
    /// Of k_s.
    pub shear: f64,
    /// Of k_θ.
    pub bend: f64,
    /// Of ζ.
    pub damping: f64,
    /// Of the plane density.
    pub density: f64,
    /// Of k_c.
    pub contact: f64,
}
