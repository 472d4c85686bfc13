//! Manufacturing variation (`[variation]`).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;

use super::is_default;

/// Manufacturing variation: the material by a factor per cast and factors per ligament and unit, nodes and chips individually. A
/// deviation of 0.05 is 5 %.
#[skip_serializing_none]
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Variation {
    /// Standard deviation of the logarithm of `body.stiffness.stretch`. Unit: 1. Default: 0.
    pub stretch: Option<Scatter<OfLigaments>>,
    /// Standard deviation of the logarithm of `body.stiffness.shear`. Unit: 1. Default: 0.
    pub shear: Option<Scatter<OfLigaments>>,
    /// Standard deviation of the logarithm of `body.stiffness.bend`. Unit: 1. Default: 0.
    pub bend: Option<Scatter<OfLigaments>>,
    /// Standard deviation of the logarithm of `body.damping_ratio`. Unit: 1. Default: 0.
    pub damping: Option<f64>,
    /// Standard deviation of the logarithm of `body.density`. Unit: 1. Default: 0.
    pub density: Option<Scatter<OfUnits>>,
    /// Standard deviation of the logarithm of `body.contact.stiffness`. Unit: 1. Default: 0.
    pub contact: Option<f64>,
    /// Standard deviation of each coordinate of each node shift, and the correlation between nodes. Unit: mm. Default: 0.
    pub nodes: Option<Nodes>,
    /// Standard deviation of the logarithm of the gain of each channel of each chip. Unit: 1. Default: 0.
    pub gain: Option<f64>,
    /// Standard deviation of the in-plane angle of each chip. Unit: degrees. Default: 0.
    pub misalignment: Option<f64>,
    /// Standard deviation of the logarithm of `body.ligament_length`, common to all ligaments of a cast. Units shrink by the
    /// added length; stiffnesses stay. Unit: 1. Default: 0.
    pub ligament_length: Option<f64>,
    /// Relaxation of the ligaments in the casts that evaluate a body (`evaluation.casts`, `metasense body casts`). Training and
    /// decoders fitted to other casts do not include it, so it tests a model error. Default: none.
    pub relaxation: Option<Relaxation>,
}

/// Maxwell branch of every ligament: parallel to each of its springs, another spring in series with a dashpot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Relaxation {
    /// Stiffness g of the additional spring relative to that of the ligament. At the angular frequency ω, the loss modulus is g
    /// ωτ/(1 + ω²τ²) of the stiffness. Unit: 1.
    pub share: f64,
    /// Relaxation time τ, in which the force of the additional spring falls to 1/e. Unit: s.
    pub time: f64,
}

/// Standard deviation of a material parameter.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Scatter<Parts> {
    /// a number: one factor for the whole cast.
    Common(f64),
    /// `{ common = s, ligament = r }`, for the density `{ common = s, unit = r }`: a further factor per ligament or unit, of
    /// deviation r.
    Parts(Parts),
}

/// Deviations of a stiffness.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OfLigaments {
    /// Standard deviation of the logarithm of the factor that all ligaments of a cast share. Default: 0.
    #[serde(default, skip_serializing_if = "is_default")]
    pub common: f64,
    /// Standard deviation of the logarithm of the factor of each ligament.
    pub ligament: f64,
}

/// Deviations of the density.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OfUnits {
    /// Standard deviation of the logarithm of the factor that all units of a cast share. Default: 0.
    #[serde(default, skip_serializing_if = "is_default")]
    pub common: f64,
    /// Standard deviation of the logarithm of the factor of each unit.
    pub unit: f64,
}

impl From<OfLigaments> for [f64; 2] {
    fn from(OfLigaments { common, ligament }: OfLigaments) -> Self {
        [common, ligament]
    }
}

impl From<OfUnits> for [f64; 2] {
    fn from(OfUnits { common, unit }: OfUnits) -> Self {
        [common, unit]
    }
}

impl<Parts: Copy + Into<[f64; 2]>> Scatter<Parts> {
    /// Standard deviations of the common factor and of the factor per ligament or unit.
    pub fn parts(self) -> [f64; 2] {
        match self {
            Self::Common(common) => [common, 0.0],
            Self::Parts(parts) => parts.into(),
        }
    }

    /// Returns the canonical form; `None` if all deviations are 0.
    fn resolved(self) -> Option<Self> {
        match self.parts() {
            [0.0, 0.0] => None,
            [common, 0.0] => Some(Self::Common(common)),
            _ => Some(self),
        }
    }
}

/// Deviations of the node shifts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Nodes {
    /// a number: nodes are independent.
    Each(f64),
    /// `{ scatter = s, correlation = c }`: nodes at the distance r have the correlation exp(−r²/2c²).
    Alike(Alike),
}

/// Deviations that are correlated between neighbours.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Alike {
    /// Standard deviation (mm).
    pub scatter: f64,
    /// Correlation length (mm).
    pub correlation: f64,
}

impl Nodes {
    /// Returns the canonical form; `None` if all deviations are 0.
    fn resolved(self) -> Option<Self> {
        match self {
            Self::Each(0.0) | Self::Alike(Alike { scatter: 0.0, .. }) => None,
            Self::Alike(Alike { scatter, correlation: 0.0 }) => Some(Self::Each(scatter)),
            other => Some(other),
        }
    }
}

/// A file that contains a variation only.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct VariationFile {
    /// The variation.
    pub variation: Variation,
}

impl Variation {
    /// Removes deviations of 0; `None` if none is left.
    pub fn resolved(self) -> Option<Self> {
        let some = |deviation: Option<f64>| deviation.filter(|deviation| *deviation != 0.0);
        let found = Self {
            stretch: self.stretch.and_then(Scatter::resolved),
            shear: self.shear.and_then(Scatter::resolved),
            bend: self.bend.and_then(Scatter::resolved),
            damping: some(self.damping),
            density: self.density.and_then(Scatter::resolved),
            contact: some(self.contact),
            nodes: self.nodes.and_then(Nodes::resolved),
            gain: some(self.gain),
            misalignment: some(self.misalignment),
            ligament_length: some(self.ligament_length),
            relaxation: self.relaxation.filter(|relaxation| relaxation.share != 0.0),
        };
        (found != Self::default()).then_some(found)
    }
}
