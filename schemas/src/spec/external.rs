//! A body that another program simulates: what that program answers to `describe`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;

/// What simulates a body.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum BodyKind {
    /// metasense: rigid polygons joined by ligaments.
    #[default]
    Polygons,
    /// The program of `body.command`.
    External,
}

impl BodyKind {
    /// Whether metasense simulates the body.
    pub fn is_polygons(&self) -> bool {
        *self == Self::Polygons
    }
}

/// What the program of an external body computes.
#[skip_serializing_none]
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Description {
    /// Name of the body.
    pub name: String,
    /// Version of the program. Default: none.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub version: String,
    /// Initial design. A trial stores it as `body.design`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub alpha: Vec<f64>,
    /// Least value of each number of the design. Default: none.
    pub lower: Option<Vec<f64>>,
    /// Greatest value of each number of the design. Default: none.
    pub upper: Option<Vec<f64>>,
    /// Linear constraints of the design. Default: none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub constraints: Vec<Constraint>,
    /// Names of the places where forces act.
    pub panels: Vec<String>,
    /// Names of the places where sensors can be.
    pub sensors: Vec<String>,
    /// Names of the signals of each sensor, at most three. Specs and records call them `ax`, `ay`, `omega` in this order.
    pub channels: Vec<String>,
    /// The only `time.duration` that the program computes. Unit: s. Default: any.
    pub duration: Option<f64>,
    /// The only `time.samples` that the program computes. Default: any.
    pub samples: Option<usize>,
    /// Whether the program uses the tolerances of `solver` and `optimise.coarse`.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub tolerance: bool,
    /// Whether the program projects designs itself, after bounds and constraints.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub project: bool,
    /// Whether the program draws designs.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub draw: bool,
    /// BLAKE3 of this description and of the text files that `body.command` names. The program does not give it.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub digest: String,
}

/// A linear constraint: least ≤ Σ coefficient · number of the design ≤ most.
#[skip_serializing_none]
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Constraint {
    /// Number of the design, from 0, and its coefficient.
    pub terms: Vec<(usize, f64)>,
    /// Least value of the sum. Default: none.
    pub least: Option<f64>,
    /// Greatest value of the sum; equal to `least`: an equation. Default: none.
    pub most: Option<f64>,
}
