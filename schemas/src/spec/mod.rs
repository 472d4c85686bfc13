//! What a person writes: the sweep file, and the trial that one point of it resolves to.
//!
//! Units: mm, N, s, Mg; angles in degrees here (radians everywhere else). Physics and names: `worker/numerics/MODEL.md`.

mod body;
mod feasible;
mod measured;
mod optimise;
mod sensors;
mod solver;
mod stimuli;
mod trial;
mod until;

pub use body::{Body, Clamp, ClampRule, Contact, Design, LayoutKind, Stiffness};
pub use feasible::Feasible;
pub use measured::{AccelerationUnit, AngularVelocityUnit, Measured, MeasuredSignals};
pub use optimise::{
    Auto, Brain, BrainKind, Curvature, Evaluation, GradientTerms, Network, Optimise, Placement, Preset,
    Protocol, Ridge, Schedule,
};
pub use sensors::{Disturbance, Frame, From as SearchFrom, Search, Sensors};
pub use solver::{Method, Solver, Time};
pub use stimuli::{Augment, ForceUnit, Recorded, Resample, Signal, Stimuli, StimuliKind, TimeUnit, Trigger};
pub use trial::{Point, TrialSpec};
pub use until::{AtMost, Until};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A sweep: one scene, one way to train it, and the axes along which it is varied.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SweepSpec {
    /// Names the database (`results/NAME.sqlite`) and the sweep in it.
    pub name: String,
    /// The body: layout, sizes, material.
    pub body: Body,
    /// The clock of forces and signals.
    #[serde(default)]
    pub time: Time,
    /// How the equations of motion are integrated.
    #[serde(default)]
    pub solver: Solver,
    /// Where and how the body is read.
    #[serde(default)]
    pub sensors: Sensors,
    /// The force histories.
    pub stimuli: Stimuli,
    /// The network and its training.
    #[serde(default)]
    pub brain: Brain,
    /// The outer loop over the body's design.
    #[serde(default)]
    pub optimise: Optimise,
    /// The comparison of initial and optimised body at the end, the same for every protocol.
    #[serde(default)]
    pub evaluation: Evaluation,
    /// The limits of a castable design.
    #[serde(default)]
    pub feasible: Feasible,
    /// The axes of the sweep.
    pub sweep: Sweep,
    /// Questions that end the sweep when they are settled; by default none, and all of it is run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until: Option<Until>,
    /// Limits of the run itself; no part of what a trial is.
    #[serde(default)]
    pub run: Run,
}

/// The axes of the sweep; lists multiply.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Sweep {
    /// K: numbers of input panels; left out where `points` say it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub panels: Vec<usize>,
    /// M: numbers of sensors; likewise.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<usize>,
    /// How many seeded placements.
    #[serde(default = "one_placement")]
    pub placements: usize,
    /// Seeds of stimuli, split and networks.
    #[serde(default = "one_seed")]
    pub seeds: Vec<u64>,
    /// Values that belong together, multiplied with the lists: keys by their paths, `panels`, `sensors`. A key that an entry
    /// leaves out is as the spec has it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub points: Vec<serde_json::Map<String, serde_json::Value>>,
    /// Points left out: those that agree with every key of an entry.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub exclude: Vec<serde_json::Map<String, serde_json::Value>>,
    /// Further axes: any key of the spec by its path, for instance `"body.columns"`.
    #[serde(flatten)]
    pub axes: std::collections::BTreeMap<String, Vec<serde_json::Value>>,
}

fn one_placement() -> usize {
    1
}
fn one_seed() -> Vec<u64> {
    vec![1]
}

/// Trials that are given up early: worse than the median of equal K and M.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Prune {
    /// Parts of a trial's outer steps at which its best test error so far is compared.
    pub at: Vec<f64>,
    /// Trials of equal K and M that must have come as far before it.
    pub grace: usize,
}

impl Default for Prune {
    fn default() -> Self {
        Self { at: vec![0.5], grace: 4 }
    }
}

/// Limits of the run itself.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Run {
    /// Worker processes; by default one a core.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub workers: Option<usize>,
    /// Threads a worker; by default 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub threads: Option<usize>,
    /// Added to the workers' niceness, 0 to 19; by default 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub niceness: Option<u8>,
    /// Memory of a worker (MiB); by default no limit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub memory: Option<u64>,
    /// How often a trial is tried again after deaths of its worker without a step in between; by default 5.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub retries: Option<u32>,
    /// Wait before the first such retry (s), doubled for each further one; by default 0.5.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub backoff: Option<f64>,
    /// Longest time that a worker gives no sign of life (s); by default 600 and the estimated time of the costliest trial.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub no_progress: Option<f64>,
    /// Longest time of an attempt at a trial (s); by default no limit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_limit: Option<f64>,
    /// Which trials are given up early; by default none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub prune: Option<Prune>,
}
