//! What a body is searched for.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A requirement on body, sensors and brain together, for `metasense design`: the lists of the sweep are then the space in which
/// the cheapest design that meets it is searched for. `metasense run` does not read it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Goal {
    /// The most that the error on samples which no training has seen may be. Unit: %. Default: must be given.
    pub error: f64,
    /// The fraction of the casts of `evaluation.casts` that must be read at this error or a smaller one. Unit: 1. Default: the
    /// body as designed is read, and no cast.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quantile: Option<f64>,
    /// What reads the casts: `"design"`, the brain of the body as designed; `"casts"`, one brain fitted to other casts;
    /// `{ records = 10 }`, a brain fitted to so many samples of each cast (10, 30, 100). Default: `"casts"`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reader: Option<GoalReader>,
    /// The longest time by which a force may be told later than it acts: how far a brain may look ahead. Unit: s. Default: no limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delay: Option<f64>,
    /// The most memory that the brain may take on a device, as `metasense export --format c` writes it: constants and working
    /// memory. Unit: kB. Default: no limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory: Option<f64>,
    /// The most multiply-adds of the brain a reading. Unit: 1. Default: no limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub operations: Option<u64>,
    /// The most mass that the body may have as it starts, its chips with it. Unit: g. Default: no limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mass: Option<f64>,
    /// The longest that a side of the box around the body may be as it starts. Unit: mm. Default: no limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size: Option<f64>,
    /// What a design costs. Default: the design with fewer sensors is cheaper, of equal ones that with fewer multiply-adds a
    /// reading, then that with fewer units.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cost: Option<Cost>,
    /// Probability with which the chosen design must meet the requirement on a further seed. At most 1 − `confidence` of searches
    /// choose a design that then misses it. Unit: 1. Default: 0.9.
    #[serde(default = "confidence")]
    pub confidence: f64,
    /// Fresh seeds of forces, networks and casts on which a trained body is screened; twice as many others then confirm it.
    /// Default: 4.
    #[serde(default = "fresh")]
    pub fresh: usize,
    /// Trials that are run before the next decision. Decisions are the same for any number of workers; more workers than this
    /// have nothing to do. Default: 2.
    #[serde(default = "at_a_time")]
    pub at_a_time: usize,
    /// CPU time of all trials; beyond it no trial is begun. Unit: h. Default: no limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hours: Option<f64>,
}

/// Prices; what is left out costs nothing.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Cost {
    /// Of a sensor. Unit: any, the same for all prices.
    pub sensor: f64,
    /// Of a multiply-add a reading. Unit: any.
    pub operation: f64,
    /// Of a unit of the body. Unit: any.
    pub unit: f64,
}

/// What reads the casts of a body that is searched for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum GoalReader {
    /// By name.
    Named(GoalReaderName),
    /// Fitted to samples of each cast.
    Calibrated(Calibrated),
}

/// The same, by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum GoalReaderName {
    /// The brain of the body as designed.
    Design,
    /// One brain fitted to other casts.
    Casts,
}

/// A brain fitted to samples of each cast.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Calibrated {
    /// So many.
    pub records: u32,
}

fn confidence() -> f64 {
    0.9
}

fn fresh() -> usize {
    4
}

fn at_a_time() -> usize {
    2
}
