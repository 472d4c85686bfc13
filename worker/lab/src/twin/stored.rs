//! The file of a twin (TOML): the model of the cast that best explains measured records of a body.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The file that `metasense lab identify --out` writes and `metasense lab evaluate` reads. Lists of quantities that were not
/// varied are empty.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TwinFile {
    /// Hash of the body: [`metasense_schemas::spec::TrialSpec::body_digest`].
    pub body: String,
    /// RMS residual of the records' signals relative to the noise of the chips.
    pub misfit: f64,
    /// Noise of each signal: its RMS residual, at least the chip's noise. Unit: mm/s², rad/s.
    pub noise: Vec<f64>,
    /// Factor of the ligaments' length.
    pub ligament_length: f64,
    /// Factor of each channel (a_x, a_y, ω of each sensor).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub gain: Vec<f64>,
    /// In-plane angle of each sensor. Unit: degrees.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub turn: Vec<f64>,
    /// Shift of each coordinate of the design. Unit: mm.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shifts: Vec<f64>,
    /// Factors of k_l, k_s and k_θ of each ligament, in addition to `material`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub ligaments: Vec<[f64; 3]>,
    /// Factor of the density of each unit, in addition to `material`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub units: Vec<f64>,
    /// Factors of the material parameters of the spec.
    pub material: Factors,
}

/// Factors of the material parameters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Factors {
    /// Factor of k_l.
    pub stretch: f64,
    /// Factor of k_s.
    pub shear: f64,
    /// Factor of k_θ.
    pub bend: f64,
    /// Factor of ζ.
    pub damping: f64,
    /// Factor of the mass per area.
    pub density: f64,
    /// Factor of k_c.
    pub contact: f64,
}
