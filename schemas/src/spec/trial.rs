//! What one point of a sweep resolves to, and the hash that names it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{
    Body, Brain, BrainKind, Evaluation, Feasible, Optimise, Sensors, Solver, Stimuli, Time, Variation,
};

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
    /// How castings scatter, where a key asks about them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variation: Option<Variation>,
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
    /// Sensors, by unit; none as long as a search has not placed them.
    pub sensor_units: Vec<usize>,
}

impl TrialSpec {
    /// Signals that a brain sees.
    #[must_use]
    pub fn signals(&self) -> usize {
        self.sensors.read().len() * self.point.sensors
    }

    /// Names the trial: 32 hex digits of BLAKE3 over its JSON with sorted keys and no blanks.
    ///
    /// A key added to the spec later must be left out of the JSON at its default (`skip_serializing_if`), so that the
    /// trials of older databases keep their names.
    /// Recorded stimuli count by their digest, not by the paths of their files; a material by the stiffnesses and the mass that it gives.
    #[must_use]
    pub fn hash(&self) -> String {
        let mut text = String::with_capacity(2048);
        let mut value = serde_json::to_value(self).expect("a trial is JSON");
        if let Some(recorded) = value.pointer_mut("/stimuli/recorded").and_then(|r| r.as_object_mut()) {
            recorded.remove("files");
        }
        if let Some(body) = value.pointer_mut("/body").and_then(|body| body.as_object_mut()) {
            body.remove("material");
        }
        write_canonical(&value, &mut text);
        blake3::hash(text.as_bytes()).to_hex()[..32].to_owned()
    }

    /// Names what trains the trial's body: trials that agree in it pass through the same bodies, to the bit, whatever reads
    /// these in the comparison at the end. 32 hex digits likewise.
    #[must_use]
    pub fn training(&self) -> String {
        Training::of(self).at(self)
    }

    /// Names a body of the trial, of this design, with its sensors: 32 hex digits likewise.
    #[must_use]
    pub fn body_digest(&self, design: &[f64]) -> String {
        let mut text = String::with_capacity(2048);
        let body = Body { material: None, ..self.body.clone() };
        let value = serde_json::json!([body, self.sensor_units, design]);
        write_canonical(&value, &mut text);
        blake3::hash(text.as_bytes()).to_hex()[..32].to_owned()
    }
}

/// What trials of a point share of [`TrialSpec::training`], which costs what a hash does.
#[derive(Debug, Clone)]
pub struct Training(String);

impl Training {
    /// Of the trials that differ from this one in placement and seed at most.
    #[must_use]
    pub fn of(trial: &TrialSpec) -> Self {
        let point = Point { placement: 0, seed: 0, ..trial.point };
        let mut spec =
            TrialSpec { evaluation: Evaluation::default(), point, sensor_units: Vec::new(), ..trial.clone() };
        if spec.optimise.linear() {
            // a body that an inverse brain is to read is simulated in double precision from the beginning
            let kind = Some(spec.brain.kind).filter(|kind| *kind == BrainKind::Inverse).unwrap_or_default();
            let Brain { memory, ridge, .. } = spec.brain;
            spec.brain = Brain { kind, memory, ridge, ..Brain::default() };
        }
        if spec.optimise.objective.is_none() {
            spec.variation = None;
        }
        Self(spec.hash())
    }

    /// Of one of them.
    #[must_use]
    pub fn at(&self, trial: &TrialSpec) -> String {
        let Point { placement, seed, .. } = trial.point;
        let text = format!("{} {placement} {seed} {:?}", self.0, trial.sensor_units);
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

/// A JSON object's leaves by path.
#[must_use]
pub fn flatten(value: &Value) -> BTreeMap<String, Value> {
    fn walk(path: &str, value: &Value, leaves: &mut BTreeMap<String, Value>) {
        match value {
            Value::Object(map) => {
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
