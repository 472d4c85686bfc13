//! The checkpoint of a trial, stored as a version byte followed by postcard bytes. These contain no field names, so every
//! change of a field, also of nested types, needs a new version. Only one version can be read.

use serde::{Deserialize, Serialize};

use super::{BandRecord, BodyRecord, CastRecord, StepSeconds, WorkCounts};

/// State of Adam.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Moments<T> {
    /// First moments.
    pub first: Vec<T>,
    /// Second moments.
    pub second: Vec<T>,
    /// Number of steps so far.
    pub steps: u64,
}

/// The best design so far.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct BestDesign {
    /// α (mm).
    pub design: Vec<f64>,
    /// Its test error (%).
    pub error: f64,
    /// Outer step that started from this design.
    pub step: u32,
}

/// An earlier design of the outer loop.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Waypoint {
    /// Outer step that started from this design.
    pub step: u32,
    /// α (mm).
    pub design: Vec<f64>,
}

/// A network in training.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct NetworkInTraining {
    /// Its weights.
    pub weights: Vec<f32>,
    /// State of Adam.
    pub moments: Moments<f32>,
    /// Training loss (normalised) at every iteration so far.
    pub losses: Vec<f32>,
    /// (Iteration, from 1, held-out error before it (%)), thinned.
    pub errors: Vec<(u32, f64)>,
}

/// Progress of the final comparison.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ComparisonProgress {
    /// The bodies, the initial one first; the last may lack networks.
    pub bodies: Vec<BodyRecord>,
    /// The network in training on the last body.
    pub training: Option<NetworkInTraining>,
    /// Counts of work.
    pub counters: WorkCounts,
    /// CPU time by part.
    pub seconds: StepSeconds,
}

/// The state from which a trial resumes.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Checkpoint {
    /// The next outer step.
    pub step: u32,
    /// α (mm).
    pub design: Vec<f64>,
    /// State of Adam for α.
    pub design_moments: Moments<f64>,
    /// Weights of the decoder, if the protocol continues it.
    pub weights: Vec<f32>,
    /// State of Adam for these weights.
    pub weight_moments: Moments<f32>,
    /// The best design so far.
    pub best: Option<BestDesign>,
    /// Learning rate of the design relative to that of the protocol.
    pub caution: f64,
    /// Number of consecutive steps that were undone.
    pub setbacks: u32,
    /// Running geometric mean of the training loss after training.
    pub trend: Option<f64>,
    /// λ of the linear decoder that trains the body, once a step has chosen it.
    pub ridge: Option<f64>,
    /// The previous designs, newest last.
    pub trail: Vec<Waypoint>,
    /// The final comparison, if it has begun.
    pub comparison: Option<Box<ComparisonProgress>>,
    /// Moves of sensors, by older programs only: outer step before a move, and the new units.
    pub moves: Vec<(u32, Vec<usize>)>,
    /// Fitness of the candidates so far, in protocol `random`.
    pub found: Vec<f64>,
    /// Errors on casts so far, per body.
    pub casts: Vec<Vec<CastRecord>>,
    /// Bands so far, per body.
    pub bands: Vec<Vec<BandRecord>>,
}

impl Checkpoint {
    /// Returns the checkpoint from which another trial with the same body resumes: without the comparison and, unless a network
    /// trains the body, without the weights, whose shape may differ.
    pub fn of_body(mut self, by_network: bool) -> Self {
        (self.comparison, self.casts, self.bands) = (None, Vec::new(), Vec::new());
        if !by_network {
            (self.weights, self.weight_moments) = (Vec::new(), Moments::default());
        }
        self
    }

    /// Returns a checkpoint after all outer steps, from the best design (mm) of a finished trial and its step.
    pub fn after_training(steps: u32, design: Vec<f64>, best_step: u32) -> Self {
        let nothing = vec![0.0; design.len()];
        let design_moments = Moments { first: nothing.clone(), second: nothing, steps: steps.into() };
        let best = Some(BestDesign { design: design.clone(), error: 0.0, step: best_step });
        Self { step: steps, design, design_moments, best, caution: 1.0, ..Self::default() }
    }

    /// Version that [`Checkpoint::to_bytes`] writes.
    pub const VERSION: u8 = 8;

    /// Encodes the checkpoint for storage.
    pub fn to_bytes(&self) -> Vec<u8> {
        postcard::to_extend(self, vec![Self::VERSION]).expect("a checkpoint is plain data")
    }

    /// Decodes a stored checkpoint.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CheckpointError> {
        match bytes.split_first() {
            Some((&Self::VERSION, rest)) => match postcard::take_from_bytes(rest) {
                Ok((checkpoint, [])) => Ok(checkpoint),
                Ok((_, more)) => Err(CheckpointError::Damaged(format!("{} surplus bytes", more.len()))),
                Err(error) => Err(CheckpointError::Damaged(error.to_string())),
            },
            Some((version, _)) => Err(CheckpointError::Version(*version)),
            None => Err(CheckpointError::Damaged("no bytes".into())),
        }
    }
}

/// A stored checkpoint that this program cannot read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CheckpointError {
    /// Written in another version.
    #[error("the checkpoint has version {0}; this program reads version {known}", known = Checkpoint::VERSION)]
    Version(u8),
    /// Truncated, or not of the format of its version.
    #[error("the checkpoint is damaged: {0}")]
    Damaged(String),
}

#[cfg(test)]
mod tests;
