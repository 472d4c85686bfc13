//! The trial that one point of a sweep resolves to, and its hash.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{
    Body, Brain, BrainKind, Evaluation, Feasible, Optimise, Sensors, Solver, Stimuli, Time, Variation,
};

/// One point of a sweep.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SweepPoint {
    /// Number of panels (K).
    pub panels: usize,
    /// Number of sensors (M).
    pub sensors: usize,
    /// Number of the placement.
    pub placement: usize,
    /// Seed of forces, split and networks.
    pub seed: u64,
}

/// All settings of a trial. Their hash is its permanent name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrialSpec {
    /// The body.
    pub body: Body,
    /// The clock.
    pub time: Time,
    /// The integrator.
    pub solver: Solver,
    /// The sensors.
    pub sensors: Sensors,
    /// The forces.
    pub stimuli: Stimuli,
    /// Manufacturing variation, if a key uses it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variation: Option<Variation>,
    /// The decoder.
    pub brain: Brain,
    /// The optimisation of the design.
    pub optimise: Optimise,
    /// The final comparison.
    pub evaluation: Evaluation,
    /// Limits of a feasible design.
    pub feasible: Feasible,
    /// Point of the sweep.
    pub point: SweepPoint,
    /// Units of the panels.
    pub panel_units: Vec<usize>,
    /// Units with sensors; empty until a search has placed them.
    pub sensor_units: Vec<usize>,
}

impl TrialSpec {
    /// Number of signals that a decoder uses.
    pub fn signals(&self) -> usize {
        self.sensors.read().len() * self.point.sensors
    }

    /// Returns the trial's name: 32 hex digits of BLAKE3 over its JSON with sorted keys and no spaces.
    ///
    /// A new key of the spec must be omitted from the JSON at its default (`skip_serializing_if`), so that trials of older
    /// databases keep their names. The hash covers the digest of recorded stimuli, not their paths, and the stiffnesses and
    /// density of a material, not the material; of an external body its description, whose digest covers the source.
    pub fn hash(&self) -> String {
        let mut value = serde_json::to_value(self).expect("a trial is JSON");
        if let Some(recorded) = value.pointer_mut("/stimuli/recorded").and_then(|r| r.as_object_mut()) {
            recorded.remove("files");
        }
        if let Some(body) = value.pointer_mut("/body").and_then(|body| body.as_object_mut()) {
            for key in ["material", "command", "time_limit"] {
                body.remove(key);
            }
        }
        digest(value)
    }

    /// Returns a hash (32 hex digits) of the settings that determine the training of the body. Trials that share it train
    /// bit-identical bodies, whatever decodes them in the final comparison.
    pub fn training(&self) -> String {
        SharedTraining::of(self).at(self)
    }

    /// Returns a hash (32 hex digits) of a body of this trial with this design and its sensors.
    pub fn body_digest(&self, design: &[f64]) -> String {
        let body = Body { material: None, command: Vec::new(), time_limit: None, ..self.body.clone() };
        digest(serde_json::json!([body, self.sensor_units, design]))
    }
}

/// The part of [`TrialSpec::training`] that is independent of placement and seed; costs as much as a hash.
#[derive(Debug, Clone)]
pub struct SharedTraining(String);

impl SharedTraining {
    /// Computes this part for all trials that differ from `trial` in placement and seed at most.
    pub fn of(trial: &TrialSpec) -> Self {
        let point = SweepPoint { placement: 0, seed: 0, ..trial.point };
        let mut spec =
            TrialSpec { evaluation: Evaluation::default(), point, sensor_units: Vec::new(), ..trial.clone() };
        if spec.optimise.linear() {
            // a body for an inverse decoder is simulated in double precision from the first step
            let kind = Some(spec.brain.kind).filter(|kind| *kind == BrainKind::Inverse).unwrap_or_default();
            let Brain { task, window, memory, ridge, .. } = spec.brain;
            spec.brain = Brain { kind, task, window, memory, ridge, ..Brain::default() };
        }
        spec.brain.window = spec.brain.window.filter(|_| !spec.brain.task.is_forces());
        if spec.optimise.objective.is_none() {
            spec.variation = None;
        }
        Self(spec.hash())
    }

    /// Returns [`TrialSpec::training`] of one of these trials.
    pub fn at(&self, trial: &TrialSpec) -> String {
        let SweepPoint { placement, seed, .. } = trial.point;
        let text = format!("{} {placement} {seed} {:?}", self.0, trial.sensor_units);
        digest_of_text(&text)
    }
}

/// Returns 32 hex digits of BLAKE3 over JSON with sorted keys and no spaces.
fn digest(mut value: Value) -> String {
    value.sort_all_objects();
    digest_of_text(&value.to_string())
}

fn digest_of_text(text: &str) -> String {
    blake3::hash(text.as_bytes()).to_hex()[..32].to_owned()
}

/// Returns the leaves of a spec by path. A body from a file is one leaf.
pub fn flatten(value: &Value) -> BTreeMap<String, Value> {
    fn walk(path: &str, value: &Value, leaves: &mut BTreeMap<String, Value>) {
        match value {
            Value::Object(map) if path != "body.file" => {
                for (key, value) in map {
                    let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                    walk(&path, value, leaves);
                }
            }
            other => drop(leaves.insert(path.to_owned(), other.clone())),
        }
    }
    let mut leaves = BTreeMap::new();
    walk("", value, &mut leaves);
    leaves
}
