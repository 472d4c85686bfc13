//! What a person writes: the sweep file, and the trial that one point of it resolves to.
//!
//! Units: mm, N, s, Mg; angles in degrees here (radians everywhere else). Physics and names: `worker/numerics/MODEL.md`.

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
    /// Limits of the run itself; no part of what a trial is.
    #[serde(default)]
    pub run: Run,
}

/// The layout of a body's units.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum LayoutKind {
    /// `columns` × `rows` units on a square grid.
    Planar,
    /// The units of a square lattice whose centres lie inside a disc, `columns` across.
    Circular,
}

/// Which units are held.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Clamp {
    /// `"bottom"`: the bottom row (planar); `"hub"`: the innermost units (circular).
    Rule(ClampRule),
    /// Unit indices.
    Units(Vec<usize>),
}

/// A named set of clamped units.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ClampRule {
    /// The bottom row of a planar body.
    Bottom,
    /// The innermost 2 × 2 units, or the one, of a circular body.
    Hub,
}

/// The design that a body starts from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged, deny_unknown_fields)]
pub enum Design {
    /// A file, from the spec's folder: NPY of α in the order of MODEL.md, or CSV of nodes (`unit,node,x,y`, mm).
    File(std::path::PathBuf),
    /// `{ random = SEED }`: rotated squares with every node moved at random, then made castable.
    Random {
        /// The seed.
        random: u64,
    },
    /// `{ shifts = [ … ] }`: α itself (mm); what a file becomes in a trial.
    Shifts {
        /// α, in the order of MODEL.md.
        shifts: Vec<f64>,
    },
}

/// Sizes and material of a body.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Planar or circular.
    #[serde(default = "planar")]
    pub layout: LayoutKind,
    /// Which units are held; by default the bottom row (planar) or the hub (circular).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clamp: Option<Clamp>,
    /// Linear strain measures (node displacements stay exact).
    #[serde(default)]
    pub linearised: bool,
    /// Input panels by unit, instead of the rule in MODEL.md.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub panel_units: Option<Vec<usize>>,
    /// Units along x; across the diameter where circular.
    pub columns: usize,
    /// Units along y; where circular: left out, or equal to `columns`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rows: Option<usize>,
    /// Pitch of the units (mm).
    pub spacing: f64,
    /// Length of a ligament at rest (mm).
    pub ligament_length: f64,
    /// Angle of the rotated squares of the initial design (degrees).
    #[serde(default = "initial_angle")]
    pub initial_angle: f64,
    /// The design to start from, instead of the rotated squares: a file, or `{ random = SEED }`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub design: Option<Design>,
    /// Plane density (Mg/mm²).
    pub density: f64,
    /// ζ: damping of a degree of freedom relative to its own critical one.
    #[serde(default = "damping_ratio")]
    pub damping_ratio: f64,
    /// Ligament stiffnesses.
    pub stiffness: Stiffness,
    /// Contact between neighbouring units; left out: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub contact: Option<Contact>,
}

fn planar() -> LayoutKind {
    LayoutKind::Planar
}
fn initial_angle() -> f64 {
    25.0
}
fn damping_ratio() -> f64 {
    0.02
}

/// Ligament stiffnesses.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Stiffness {
    /// k_l (N/mm).
    pub stretch: f64,
    /// k_s (N/mm).
    pub shear: f64,
    /// k_θ (N·mm/rad).
    pub bend: f64,
}

/// Contact between the edges that face each other across a ligament.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Contact {
    /// k_c (N·mm/rad²).
    pub stiffness: f64,
    /// ψ_min (degrees).
    pub min_angle: f64,
    /// ψ_c (degrees).
    pub cutoff_angle: f64,
}

impl Default for Contact {
    fn default() -> Self {
        Self { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 5.0 }
    }
}

/// The clock of forces and signals.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Time {
    /// Length of a sample (s).
    pub duration: f64,
    /// T: instants t_n = n·duration/T, n = 1…T.
    pub samples: usize,
}

impl Default for Time {
    fn default() -> Self {
        Self { duration: 1.0, samples: 200 }
    }
}

/// An integrator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Chosen from the scene's highest frequency and the tolerance.
    Auto,
    /// Tsitouras 5(4), error control a sample.
    Tsit5,
    /// Störmer and Verlet's, equal steps, order 2.
    Leapfrog,
    /// Blanes and Moan's Runge–Kutta–Nyström splitting, equal steps, order 4.
    Nystrom4,
    /// Blanes and Moan's Runge–Kutta–Nyström splitting, equal steps, order 6.
    Nystrom6,
    /// Hairer and Wanner's SDIRK, equal steps, order 4: stiff modes need not be followed.
    Implicit,
}

/// How the equations of motion are integrated.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Solver {
    /// The integrator.
    pub method: Method,
    /// `tsit5`: tolerance of its own error norm, absolute and relative. Others: relative error asked of the signals.
    pub tolerance: f64,
}

impl Default for Solver {
    fn default() -> Self {
        Self { method: Method::Auto, tolerance: 1e-3 }
    }
}

/// The frame in which accelerations are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Frame {
    /// Fixed axes.
    #[default]
    World,
    /// Turning with the unit, as a glued chip reads.
    Body,
}

/// Where and how the body is read.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Sensors {
    /// World or body frame.
    pub frame: Frame,
    /// Lists of units instead of `sweep.placements`; a trial with M sensors takes every list of M units.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub placements: Option<Vec<Vec<usize>>>,
}

/// Kind of force histories.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum StimuliKind {
    /// Smooth bell pulses.
    Bell,
}

/// The force histories. Intervals are `[least, most]` of a uniform draw per sample and panel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Stimuli {
    /// What kind of histories.
    pub kind: StimuliKind,
    /// N: samples that train and test the brain.
    #[serde(default = "stimuli_samples")]
    pub samples: usize,
    /// How many of the N are the test set.
    #[serde(default = "stimuli_test")]
    pub test: usize,
    /// Further samples that neither loop ever sees.
    #[serde(default = "stimuli_holdout")]
    pub holdout: usize,
    /// Amplitude A (N).
    #[serde(default = "amplitude")]
    pub amplitude: [f64; 2],
    /// Width W (s).
    #[serde(default = "width")]
    pub width: [f64; 2],
    /// Onset O (s).
    #[serde(default = "onset")]
    pub onset: [f64; 2],
    /// Peak position p, as a part of the width.
    #[serde(default = "peak")]
    pub peak: [f64; 2],
    /// Power q.
    #[serde(default = "power")]
    pub power: [f64; 2],
}

fn stimuli_samples() -> usize {
    300
}
fn stimuli_test() -> usize {
    30
}
fn stimuli_holdout() -> usize {
    60
}
fn amplitude() -> [f64; 2] {
    [0.15, 0.5]
}
fn width() -> [f64; 2] {
    [0.06, 0.25]
}
fn onset() -> [f64; 2] {
    [0.0, 0.5]
}
fn peak() -> [f64; 2] {
    [0.35, 0.65]
}
fn power() -> [f64; 2] {
    [1.5, 4.0]
}

/// The network's training.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Brain {
    /// Full-batch Adam iterations of one training.
    pub iterations: usize,
    /// Adam's rate.
    pub learning_rate: f64,
}

impl Default for Brain {
    fn default() -> Self {
        Self { iterations: 1000, learning_rate: 1e-2 }
    }
}

/// How body and brain are trained together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Protocol {
    /// A fresh network each outer step, trained to its optimum; direct and implicit gradient of the test loss.
    Paper,
    /// The network goes on from body to body, by as many iterations as its loss needs; direct gradient of the test loss.
    Warm,
    /// The network goes on; the training loss moves the body, from a seeded subset of the samples.
    Envelope,
    /// Body and network are stepped together on fresh samples, drawn each step.
    Joint,
}

/// Which terms of the gradient of the test loss are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GradientTerms {
    /// Direct and implicit term.
    Implicit,
    /// The direct term alone.
    Direct,
}

/// The outer loop over the body's design. What is left out gets the default of its protocol.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Optimise {
    /// How body and brain are trained together. By default `"joint"`, which gains most in its time.
    pub protocol: Protocol,
    /// Outer steps. By default 200, for the other protocols 100.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<usize>,
    /// Adam's rate on α (mm). By default 0.2, for the other protocols 0.1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub learning_rate: Option<f64>,
    /// Terms of the gradient; for `protocol = "paper"` alone. By default `"implicit"`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gradient: Option<GradientTerms>,
    /// Samples whose gradient moves the body; for `"envelope"` and `"joint"`. By default 64.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub batch: Option<usize>,
    /// Brain iterations an outer step; not for `"paper"`, which has `brain.iterations`. By default 10.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub brain_iterations: Option<usize>,
    /// Adam's rate of these iterations. By default 1e-3.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub brain_learning_rate: Option<f64>,
    /// A cheaper integrator for the first nine tenths of the outer steps; for `"envelope"` and `"joint"`. By default
    /// `{ method = "auto", tolerance = 0.03 }` for `"joint"`, none for `"envelope"`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coarse: Option<Solver>,
}

impl Optimise {
    /// With the defaults of the protocol in place: only what the protocol does not read stays open.
    #[must_use]
    pub fn resolved(mut self) -> Self {
        let (iterations, learning_rate) = match self.protocol {
            Protocol::Paper | Protocol::Warm | Protocol::Envelope => (100, 0.1),
            Protocol::Joint => (200, 0.2),
        };
        self.iterations.get_or_insert(iterations);
        self.learning_rate.get_or_insert(learning_rate);
        if self.protocol == Protocol::Paper {
            self.gradient.get_or_insert(GradientTerms::Implicit);
        } else {
            self.brain_iterations.get_or_insert(10);
            self.brain_learning_rate.get_or_insert(1e-3);
        }
        if matches!(self.protocol, Protocol::Envelope | Protocol::Joint) {
            self.batch.get_or_insert(64);
        }
        if self.protocol == Protocol::Joint {
            self.coarse.get_or_insert(Solver { method: Method::Auto, tolerance: 0.03 });
        }
        self
    }

    /// Outer steps.
    #[must_use]
    pub fn steps(&self) -> usize {
        self.resolved().iterations.unwrap_or_default()
    }
}

impl Default for Optimise {
    fn default() -> Self {
        Self {
            protocol: Protocol::Joint,
            iterations: None,
            learning_rate: None,
            gradient: None,
            batch: None,
            brain_iterations: None,
            brain_learning_rate: None,
            coarse: None,
        }
    }
}

/// Learning-rate schedule of the final comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Schedule {
    /// Falls to 0 by a cosine.
    Cosine,
    /// The paper's.
    Constant,
}

/// The comparison at the end.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Evaluation {
    /// Fresh networks a body.
    pub seeds: usize,
    /// Rate schedule of their training.
    pub schedule: Schedule,
}

impl Default for Evaluation {
    fn default() -> Self {
        Self { seeds: 1, schedule: Schedule::Cosine }
    }
}

/// Limits of a castable design (degrees, mm).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Feasible {
    /// Least interior angle of a unit (degrees).
    pub min_block_angle: f64,
    /// Greatest interior angle of a unit (degrees).
    pub max_block_angle: f64,
    /// Least void angle at a ligament (degrees).
    pub min_void_angle: f64,
    /// Least angle between a ligament and an edge (degrees).
    pub min_ligament_angle: f64,
    /// Least edge of a unit (mm).
    pub min_edge: f64,
    /// Least distance between units (mm).
    pub clearance: f64,
    /// Least distance where ligaments are involved (mm).
    pub ligament_clearance: f64,
    /// Whether the units that are struck keep their initial shape.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub keep_panels: bool,
    /// Whether the clamped units keep their initial shape.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub keep_clamped: bool,
}

impl Default for Feasible {
    fn default() -> Self {
        Self {
            min_block_angle: 25.0,
            max_block_angle: 170.0,
            min_void_angle: 5.0,
            min_ligament_angle: 10.0,
            min_edge: 3.0,
            clearance: 1.0,
            ligament_clearance: 0.5,
            keep_panels: false,
            keep_clamped: false,
        }
    }
}

/// The axes of the sweep; lists multiply.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Sweep {
    /// K: numbers of input panels.
    pub panels: Vec<usize>,
    /// M: numbers of sensors.
    pub sensors: Vec<usize>,
    /// How many seeded placements.
    #[serde(default = "one_placement")]
    pub placements: usize,
    /// Seeds of stimuli, split and networks.
    #[serde(default = "one_seed")]
    pub seeds: Vec<u64>,
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

/// Limits of the run itself.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
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
}

/// One point of a sweep.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Point {
    /// K.
    pub panels: usize,
    /// M.
    pub sensors: usize,
    /// Which placement.
    pub placement: usize,
    /// Seed of stimuli, split and networks.
    pub seed: u64,
}

/// Everything that a trial is. Its hash names it for ever.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrialSpec {
    /// The body.
    pub body: Body,
    /// The clock.
    pub time: Time,
    /// The integrator.
    pub solver: Solver,
    /// The frame.
    pub sensors: Sensors,
    /// The stimuli.
    pub stimuli: Stimuli,
    /// The brain.
    pub brain: Brain,
    /// The outer loop.
    pub optimise: Optimise,
    /// The final comparison.
    pub evaluation: Evaluation,
    /// The limits.
    pub feasible: Feasible,
    /// Where in the sweep.
    pub point: Point,
    /// Input panels, by unit.
    pub panel_units: Vec<usize>,
    /// Sensors, by unit.
    pub sensor_units: Vec<usize>,
}

impl TrialSpec {
    /// Names the trial: 32 hex digits of BLAKE3 over its JSON with sorted keys and no blanks.
    ///
    /// A key added to the spec later must be left out of the JSON at its default (`skip_serializing_if`), so that the
    /// trials of older databases keep their names.
    #[must_use]
    pub fn hash(&self) -> String {
        let mut text = String::with_capacity(2048);
        write_canonical(&serde_json::to_value(self).expect("a trial is JSON"), &mut text);
        blake3::hash(text.as_bytes()).to_hex()[..32].to_owned()
    }
}

/// JSON with sorted keys, whatever order the map type keeps.
fn write_canonical(value: &serde_json::Value, text: &mut String) {
    match value {
        serde_json::Value::Object(map) => {
            let mut entries: Vec<_> = map.iter().collect();
            entries.sort_unstable_by_key(|(key, _)| *key);
            text.push('{');
            for (i, (key, value)) in entries.into_iter().enumerate() {
                if i > 0 {
                    text.push(',');
                }
                *text += &serde_json::Value::from(key.as_str()).to_string();
                text.push(':');
                write_canonical(value, text);
            }
            text.push('}');
        }
        serde_json::Value::Array(values) => {
            text.push('[');
            for (i, value) in values.iter().enumerate() {
                if i > 0 {
                    text.push(',');
                }
                write_canonical(value, text);
            }
            text.push(']');
        }
        scalar => *text += &scalar.to_string(),
    }
}
