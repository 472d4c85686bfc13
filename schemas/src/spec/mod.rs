//! What a person writes: the sweep file, and the trial that one point of it resolves to.
//!
//! Units: mm, N, s, Mg; angles in degrees here (radians everywhere else). Physics and names: `worker/numerics/MODEL.md`.

mod body;
mod feasible;
mod goal;
mod gone;
mod measured;
mod named;
mod optimise;
mod sensors;
mod solver;
mod stimuli;
mod table;
mod trial;
mod until;
mod variation;

pub use body::{
    Body, Clamp, ClampRule, Contact, Denser, Design, Follow, FollowBy, Guide, Hinge, Inertia, Lattice,
    LayoutKind, Material, Own, Polygons, Rubber, Stiffness, Struck,
};
pub use feasible::Feasible;
pub use goal::{Calibrated, Cost, Goal, GoalReader, GoalReaderName};
pub use gone::{gone, gone_key};
pub use measured::{AccelerationUnit, AngularVelocityUnit, Measured, MeasuredSignals};
pub use named::{NotOne, position_of};
pub use optimise::{
    Auto, Brain, BrainKind, CastReader, Curvature, Evaluation, GradientTerms, Network, Objective,
    ObjectiveName, Optimise, Preset, Protocol, Ridge, Scaling, Schedule, Tail,
};
pub use sensors::{Channel, Disturbance, Frame, From as SearchFrom, Search, Sensors};
pub use solver::{Method, Solver, Time};
pub use stimuli::{
    Augment, ForceUnit, Part, Recorded, Resample, Signal, Stimuli, StimuliKind, TimeUnit, Trigger,
};
pub use table::{Decimal, Separator};
pub use trial::{Point, Training, TrialSpec, flatten};
pub use until::{AtMost, Until};
pub use variation::{Alike, Nodes, OfLigaments, OfUnits, Relaxation, Scatter, Variation, VariationFile};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A sweep: one scene, one way to train it, and the axes along which it is varied.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SweepSpec {
    /// Another spec (TOML), by its path from the folder of this one. It gives the keys that this one leaves out: tables are
    /// merged key by key, any other value here replaces the one there. It may have a base, too.
    /// Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base: Option<std::path::PathBuf>,
    /// Names the sweep and its database, `results/NAME.sqlite`.
    pub name: String,
    /// The body: layout, sizes, material, the design to start from.
    pub body: Body,
    /// Length and sampling of forces and signals.
    #[serde(default)]
    pub time: Time,
    /// How the equations of motion are integrated.
    #[serde(default)]
    pub solver: Solver,
    /// Where the sensors are, and what a real sensor adds to its signal.
    #[serde(default)]
    pub sensors: Sensors,
    /// The forces that strike the body.
    pub stimuli: Stimuli,
    /// How castings scatter about the design: for bodies that are trained for it (`optimise.objective`), and to see what is
    /// left of any (`evaluation.casts`). Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variation: Option<Variation>,
    /// What reads forces from signals: the paper's network, a linear decoder, or both.
    #[serde(default)]
    pub brain: Brain,
    /// How the body's design is optimised. A key that is left out has the default of its protocol.
    #[serde(default)]
    pub optimise: Optimise,
    /// The comparison of initial and optimised body at the end of a trial, with fresh networks.
    #[serde(default)]
    pub evaluation: Evaluation,
    /// The limits of a design that can be cast. A design outside is projected onto the nearest one inside.
    #[serde(default)]
    pub feasible: Feasible,
    /// What is varied. Lists multiply: a trial for each combination.
    pub sweep: Sweep,
    /// Questions that end the sweep once they are answered; without them every trial is run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until: Option<Until>,
    /// A requirement: `metasense design` searches the sweep for the cheapest design that meets it. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub goal: Option<Goal>,
    /// Processes and limits of the run. They change no result and are not part of a trial's hash.
    #[serde(default)]
    pub run: Run,
}

/// The axes of the sweep; lists multiply.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Sweep {
    /// Numbers of input panels (K). Left out if `points` gives them. Default: must be given.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub panels: Vec<usize>,
    /// Numbers of sensors (M). Left out if `points` gives them. Default: must be given.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<usize>,
    /// Number of sensor placements.
    #[serde(default = "one_placement")]
    pub placements: usize,
    /// Whether each seed has `placements` of its own, the next seed the next ones: an interval over seeds is then one over placements,
    /// too, at a fraction of the trials. Their numbers run on from seed to seed: add seeds at the end, and leave `placements` as it is,
    /// or trials are others. Default: `false`, all seeds have the same.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub own_placements: bool,
    /// Seeds of forces, split into training and test set, and networks.
    #[serde(default = "one_seed")]
    pub seeds: Vec<u64>,
    /// Values that belong together, for instance `[{ panels = 4, "body.columns" = 8 }, { panels = 8, "body.columns" = 16 }]`;
    /// multiplied with the lists. A key that an entry leaves out is as the spec has it; no key stands in both `points` and a
    /// list. Default: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub points: Vec<serde_json::Map<String, serde_json::Value>>,
    /// Combinations to leave out, for instance `[{ sensors = 2, "body.columns" = 5 }]`: those that agree with every key of an
    /// entry. Keys are paths, `panels`, `sensors`, `placement`, `seed`. Default: none.
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

/// Which trials are given up early.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Prune {
    /// Fractions of a trial's outer steps at which its best test error so far is compared with that of other trials.
    /// Unit: 1.
    pub at: Vec<f64>,
    /// Trials of equal K and M that must have come as far before one is given up.
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
    /// Worker processes, at most 1024; each runs one trial at a time. Default: one per core.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub workers: Option<usize>,
    /// Threads of each worker, at most 1024. Default: 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub threads: Option<usize>,
    /// Added to the workers' niceness, 0 to 19. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub niceness: Option<u8>,
    /// Memory limit of each worker. A trial whose arrays alone need more is refused before anything starts; one that comes to need more
    /// fails with the reason `out_of_memory`; without a limit that is a shortage of the machine. Unit: MiB. Default: no limit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub memory: Option<u64>,
    /// How often a trial is retried after its worker has died without completing a step; and how often in a row trials are begun
    /// again where the machine is short of something, before the run ends and leaves them pending. Default: 5.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub retries: Option<u32>,
    /// Wait before the first retry; doubled for each further one, up to a minute. Unit: s. Default: 0.5.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub backoff: Option<f64>,
    /// Longest time without a sign of life from a worker, which reports every second while it computes. Unit: s. Default: 600.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub no_progress: Option<f64>,
    /// How long a run waits while another program, for instance a backup, holds a lock on the database. Unit: s. Default: 300.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lock_wait: Option<f64>,
    /// Longest time of one attempt at a trial. Unit: s. Default: no limit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_limit: Option<f64>,
    /// Longest wait for steps in progress when the run is stopped; workers that are not done by then are killed, and their steps
    /// are done again by the next run. Shards are given notice of their time limit by 15 s more. Unit: s. Default: 10; in shards
    /// on Slurm and HyperQueue 45.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grace: Option<f64>,
    /// Gives up a trial early if its best test error is above the median of other trials of equal K and M. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub prune: Option<Prune>,
}
