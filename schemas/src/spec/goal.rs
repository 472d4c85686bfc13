//! The requirement that a search for a design must meet (`[goal]`).

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;

use super::Task;

/// A requirement on body, sensors and decoder together. `metasense design` searches the lists of the sweep for the cheapest
/// design that meets it; `metasense run` ignores it.
#[skip_serializing_none]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Goal {
    /// Largest error on samples that are not used for training. Unit: %. Default: must be given.
    pub error: f64,
    /// Largest error of each sensing task, by the better readout, direct or decoded, such as `{ panel = 5.0, position = 5.0 }`. Needs
    /// `evaluation.tasks = true`. Unit: that of the task (`metasense body tasks --help`). Default: none.
    pub tasks: Option<BTreeMap<Task, f64>>,
    /// Fraction of the casts of `evaluation.casts` whose error must not exceed `error`. Unit: 1. Default: none: the error of
    /// the body as designed counts.
    pub quantile: Option<f64>,
    /// Decoder of the casts: `"design"`, fitted to the design; `"casts"`, fitted to other casts; `{ records = 10 }`, calibrated
    /// on this number of samples of each cast (10, 30, 100). Default: `"casts"`.
    pub reader: Option<GoalReader>,
    /// Longest delay between a force and its estimate, that is, the look-ahead of the decoder. Unit: s. Default: no limit.
    pub delay: Option<f64>,
    /// Largest memory of the decoder on a device (constants and working memory), as written by `metasense export --format c`.
    /// Unit: kB. Default: no limit.
    pub memory: Option<f64>,
    /// Largest number of multiply-adds of the decoder per reading. Unit: 1. Default: no limit.
    pub operations: Option<u64>,
    /// Largest mass of the initial body including its chips. Unit: g. Default: no limit.
    pub mass: Option<f64>,
    /// Longest side of the bounding box of the initial body. Unit: mm. Default: no limit.
    pub size: Option<f64>,
    /// Prices of a design. Default: the design with fewer sensors is cheaper; at equal numbers, the one with fewer
    /// multiply-adds per reading, then with fewer units.
    pub cost: Option<Cost>,
    /// Probability that the chosen design meets the requirement on a further seed. At most 1 − `confidence` of searches choose a
    /// design that misses it. Unit: 1. Default: 0.9.
    #[serde(default = "confidence")]
    pub confidence: f64,
    /// New seeds of forces, networks and casts on which a trained body is screened. Twice as many other seeds confirm it.
    /// Default: 4.
    #[serde(default = "super::number::<4>")]
    pub fresh: usize,
    /// Trials that run between two decisions. Further workers are idle; the number of workers does not change decisions. Default:
    /// 2.
    #[serde(default = "super::number::<2>")]
    pub at_a_time: usize,
    /// CPU time of all trials; beyond it no further trial starts. Unit: h. Default: no limit.
    pub hours: Option<f64>,
}

/// Prices; omitted prices are zero.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Cost {
    /// Price of a sensor. Unit: any, the same for all prices.
    pub sensor: f64,
    /// Price of a multiply-add per reading. Unit: any.
    pub operation: f64,
    /// Price of a unit of the body. Unit: any.
    pub unit: f64,
}

/// Decoder of the casts in a search for a design.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum GoalReader {
    /// a name.
    Named(GoalReaderName),
    /// a calibration on samples of each cast.
    Calibrated(Calibrated),
}

/// Named decoders of the casts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum GoalReaderName {
    /// The decoder fitted to the design.
    Design,
    /// One decoder fitted to other casts.
    Casts,
}

/// A decoder fitted to samples of each cast.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Calibrated {
    /// Number of samples per cast.
    pub records: u32,
}

fn confidence() -> f64 {
    0.9
}
