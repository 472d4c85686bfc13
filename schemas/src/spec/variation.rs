//! How castings scatter about the design.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How castings scatter about the design: material by a factor common to a cast and by others of each ligament and unit, nodes
/// and chips each by itself. A deviation of 0.05 is 5 %.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Variation {
    /// Standard deviation of the logarithm of `body.stiffness.stretch`. Unit: 1. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stretch: Option<Scatter<OfLigaments>>,
    /// Standard deviation of the logarithm of `body.stiffness.shear`. Unit: 1. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shear: Option<Scatter<OfLigaments>>,
    /// Standard deviation of the logarithm of `body.stiffness.bend`. Unit: 1. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bend: Option<Scatter<OfLigaments>>,
    /// Standard deviation of the logarithm of `body.damping_ratio`. Unit: 1. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub damping: Option<f64>,
    /// Standard deviation of the logarithm of `body.density`. Unit: 1. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub density: Option<Scatter<OfUnits>>,
    /// Standard deviation of the logarithm of `body.contact.stiffness`. Unit: 1. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contact: Option<f64>,
    /// Standard deviation of each coordinate of each node shift, and how far such errors reach. Unit: mm. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nodes: Option<Nodes>,
    /// Standard deviation of the logarithm of the gain of each channel of each chip. Unit: 1. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain: Option<f64>,
    /// Standard deviation of the angle by which each chip is turned in the plane. Unit: degrees. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub misalignment: Option<f64>,
    /// Standard deviation of the logarithm of `body.ligament_length`, of all ligaments of a cast: units shrink by what they are longer, the
    /// stiffnesses stay. Unit: 1. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ligament_length: Option<f64>,
    /// How ligaments relax in the casts that judge (`evaluation.casts`, `metasense casts`), which neither training nor any brain
    /// fitted to other casts knows: a world that the model does not contain. Default: not at all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub relaxation: Option<Relaxation>,
}

/// Maxwell's branch of every ligament: beside each of its springs another and a dashpot in series.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Relaxation {
    /// Stiffness g of the other spring, by that of the ligament's. A motion of angular frequency ω loses g ωτ/(1 + ω²τ²) of the stiffness.
    /// Unit: 1.
    pub share: f64,
    /// Time τ in which the force of the other spring falls to 1/e. Unit: s.
    pub time: f64,
}

/// How a figure of the material scatters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Scatter<Parts> {
    /// a number: one factor for the whole cast.
    Common(f64),
    /// `{ common = s, ligament = r }`, of the density `{ common = s, unit = r }`: beside that factor one of each, of deviation r.
    Parts(Parts),
}

/// Of a stiffness.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OfLigaments {
    /// Standard deviation of the logarithm of the factor that all ligaments of a cast share. Default: 0.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub common: f64,
    /// Of the factor of each ligament.
    pub ligament: f64,
}

/// Of the density.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OfUnits {
    /// Standard deviation of the logarithm of the factor that all units of a cast share. Default: 0.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub common: f64,
    /// Of the factor of each unit.
    pub unit: f64,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "as serde wants it")]
fn is_zero(deviation: &f64) -> bool {
    *deviation == 0.0
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
    /// Deviation of the common factor, and of each part's.
    #[must_use]
    pub fn parts(self) -> [f64; 2] {
        match self {
            Self::Common(common) => [common, 0.0],
            Self::Parts(parts) => parts.into(),
        }
    }

    /// What is the same said in one way; `None` if nothing scatters.
    fn resolved(self) -> Option<Self> {
        match self.parts() {
            [0.0, 0.0] => None,
            [common, 0.0] => Some(Self::Common(common)),
            _ => Some(self),
        }
    }
}

/// How nodes scatter.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Nodes {
    /// a number: each node by itself.
    Each(f64),
    /// `{ scatter = s, correlation = c }`: nodes at a distance r alike with the correlation exp(−r²/2c²).
    Alike(Alike),
}

/// A scatter that neighbours share.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Alike {
    /// Standard deviation (mm).
    pub scatter: f64,
    /// Correlation length (mm).
    pub correlation: f64,
}

impl Nodes {
    /// What is the same said in one way; `None` if nothing scatters.
    fn resolved(self) -> Option<Self> {
        match self {
            Self::Each(0.0) | Self::Alike(Alike { scatter: 0.0, .. }) => None,
            Self::Alike(Alike { scatter, correlation: 0.0 }) => Some(Self::Each(scatter)),
            other => Some(other),
        }
    }
}

/// A file that says how casts scatter, and nothing else.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct VariationFile {
    /// How they do.
    pub variation: Variation,
}

impl Variation {
    /// Without deviations of 0; `None` if nothing is left.
    #[must_use]
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
