//! The spec that a user writes, and the trial that one point of its sweep resolves to.
//!
//! Units: mm, N, s, Mg; angles in degrees here (radians everywhere else). Physics and names: `worker/numerics/MODEL.md`.

mod body;
mod external;
mod feasible;
mod goal;
mod optimise;
mod sensors;
mod solver;
mod stimuli;
mod trial;
mod until;
mod variation;

pub use body::{
    Body, Clamp, ClampRule, Contact, Denser, Design, Follow, FollowBy, Guide, Inertia, Lattice, LayoutKind,
    Material, Own, Polygons, Rubber, Stiffness, Struck,
};
pub use external::{BodyKind, Constraint, Description};
pub use feasible::Feasible;
pub use goal::{Calibrated, Cost, Goal, GoalReader, GoalReaderName};
pub use optimise::{
    Auto, Brain, BrainKind, Evaluation, GradientTerms, Network, Objective, ObjectiveName, Optimise, Preset,
    Protocol, Ridge, Scaling, Schedule, Tail, Task,
};
pub use sensors::{Channel, Disturbance, Frame, From as SearchFrom, Search, Sensors};
pub use solver::{Method, Solver, Time};
pub use stimuli::{
    Augment, Decimal, ForceUnit, Part, Recorded, Resample, Separator, Signal, Stimuli, StimuliKind, TimeUnit,
    Trigger,
};
pub use trial::{SharedTraining, SweepPoint, TrialSpec, flatten};
pub use until::{AtMost, Until};
pub use variation::{Alike, Nodes, OfLigaments, OfUnits, Relaxation, Scatter, Variation, VariationFile};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;

/// A spec: a scene, its training, and the axes of a sweep.
#[skip_serializing_none]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SweepSpec {
    /// Another spec (TOML), by its path relative to this file. It supplies omitted keys: tables are merged key by key, any other
    /// value in this file replaces that of the base. The base may have a base. Default: none.
    pub base: Option<std::path::PathBuf>,
    /// Name of the sweep and of its database, `results/NAME.sqlite`.
    pub name: String,
    /// The body: layout, sizes, material, the design to start from.
    pub body: Body,
    /// Length and sampling of forces and signals.
    #[serde(default)]
    pub time: Time,
    /// How the equations of motion are integrated.
    #[serde(default)]
    pub solver: Solver,
    /// Positions of the sensors, and properties of real sensors.
    #[serde(default)]
    pub sensors: Sensors,
    /// The applied forces.
    pub stimuli: Stimuli,
    /// Manufacturing variation, for training over casts (`optimise.objective`) and for evaluation on casts (`evaluation.casts`).
    /// Default: none.
    pub variation: Option<Variation>,
    /// The decoder: the paper's network, a linear decoder, both stacked, or the body's model inverted.
    #[serde(default)]
    pub brain: Brain,
    /// Optimisation of the design. Omitted keys have the default of the protocol.
    #[serde(default)]
    pub optimise: Optimise,
    /// The comparison of initial and trained body at the end of a trial, with fresh networks.
    #[serde(default)]
    pub evaluation: Evaluation,
    /// Limits of a design that can be cast. Other designs are projected onto the nearest feasible design.
    #[serde(default)]
    pub feasible: Feasible,
    /// Swept values. Lists multiply: one trial per combination.
    pub sweep: Sweep,
    /// Questions that end the sweep once they are answered; without them every trial runs.
    pub until: Option<Until>,
    /// A requirement: `metasense design` searches the sweep for the cheapest design that meets it. Default: none.
    pub goal: Option<Goal>,
    /// Processes and limits of the run. They do not change results and are not part of a trial's hash.
    #[serde(default)]
    pub run: Run,
}

/// The axes of the sweep; lists multiply.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Sweep {
    /// Numbers of panels (K). Omit if `points` gives them. Default: must be given.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub panels: Vec<usize>,
    /// Numbers of sensors (M). Omit if `points` gives them. Default: must be given.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<usize>,
    /// Number of sensor placements.
    #[serde(default = "number::<1>")]
    pub placements: usize,
    /// Whether each seed has its own `placements`, numbered consecutively from seed to seed. An interval over seeds then also
    /// covers placements, with a fraction of the trials. Add seeds at the end and do not change `placements`; otherwise trials
    /// change. Default: `false`, all seeds have the same.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub own_placements: bool,
    /// Seeds of forces, of the split into training and test set, and of networks.
    #[serde(default = "one_seed")]
    pub seeds: Vec<u64>,
    /// Values that vary together, for instance `[{ panels = 4, "body.columns" = 8 }, { panels = 8, "body.columns" = 16 }]`;
    /// multiplied with the lists. Keys that an entry omits have the value of the spec. A key may not be both in `points` and a
    /// list. Default: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub points: Vec<serde_json::Map<String, serde_json::Value>>,
    /// Combinations to exclude, for instance `[{ sensors = 2, "body.columns" = 5 }]`: all that agree with every key of an entry.
    /// Keys are paths, `panels`, `sensors`, `placement`, `seed`. Default: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub exclude: Vec<serde_json::Map<String, serde_json::Value>>,
    /// Further axes: any key of the spec by its path, for instance `"body.columns"`.
    #[serde(flatten)]
    pub axes: std::collections::BTreeMap<String, Vec<serde_json::Value>>,
}

impl Sweep {
    /// Returns the keys that axes and points set, except panels, sensors, placement and seed.
    pub fn keys(&self) -> std::collections::BTreeSet<&str> {
        let linked = self.points.iter().flat_map(|point| point.keys()).filter(|key| key.contains('.'));
        self.axes.keys().chain(linked).map(String::as_str).collect()
    }
}

/// Whether a value is the default of its type, which is not written.
fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// A default of this value.
fn number<const N: usize>() -> usize {
    N
}
fn one_seed() -> Vec<u64> {
    vec![1]
}

/// Limits of the run itself.
#[skip_serializing_none]
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Run {
    /// Worker processes, at most 1024; each runs one trial at a time. Default: one per core.
    pub workers: Option<usize>,
    /// Threads of each worker, at most 1024. Default: 1.
    pub threads: Option<usize>,
    /// Added to the niceness of the workers, 0 to 19. Default: 0.
    #[schemars(range(max = 19))]
    pub niceness: Option<u8>,
    /// Memory limit of each worker. A trial whose arrays need more is rejected before the run starts; a trial that exceeds it
    /// later fails with the reason `out_of_memory`. Without a limit, that is a shortage of the machine. Unit: MiB. Default: no
    /// limit.
    pub memory: Option<u64>,
    /// Number of retries of a trial whose worker died without completing a step. Also the number of consecutive restarts after a
    /// shortage of the machine, before the run ends and leaves trials pending. Default: 5.
    pub retries: Option<u32>,
    /// Wait before the first retry; doubled for each further retry, up to a minute. Unit: s. Default: 0.5.
    pub backoff: Option<f64>,
    /// Longest time without a report from a worker, which reports every second while it computes. Unit: s. Default: 600.
    pub no_progress: Option<f64>,
    /// How long a run waits while another program, for instance a backup, holds a lock on the database. Unit: s. Default: 300.
    pub lock_wait: Option<f64>,
    /// Longest time of one attempt at a trial. Unit: s. Default: no limit.
    pub time_limit: Option<f64>,
    /// Longest wait for steps in progress when the run is stopped. Workers that need longer are killed, and the next run repeats
    /// their steps. Shards are notified another 15 s before their time limit. Unit: s. Default: 10; in shards on Slurm and
    /// HyperQueue 45.
    pub grace: Option<f64>,
}
