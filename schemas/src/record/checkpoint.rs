//! What is needed to resume a trial, and how it is stored: postcard bytes behind a version byte. These bytes name no
//! field, so that a field more, also of what a checkpoint holds, is a version more. One version is read.

use serde::{Deserialize, Serialize};

use super::{Band, BodyEvaluation, CastReading, Counters, Seconds};

/// Adam on some parameters.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Moments<T> {
    /// First moments.
    pub first: Vec<T>,
    /// Second moments.
    pub second: Vec<T>,
    /// Steps so far.
    pub steps: u64,
}

/// The best design so far.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Best {
    /// α (mm).
    pub design: Vec<f64>,
    /// Its test error (%).
    pub error: f64,
    /// The outer step that started from it.
    pub step: u32,
}

/// A design that the outer loop has passed.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Waypoint {
    /// The outer step that started from it.
    pub step: u32,
    /// α (mm).
    pub design: Vec<f64>,
}

/// A network in training.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Training {
    /// Its weights.
    pub weights: Vec<f32>,
    /// Adam on them.
    pub moments: Moments<f32>,
    /// Training loss (normalised) at every iteration so far.
    pub losses: Vec<f32>,
    /// (Iteration, from 1, prediction error on the holdout before it (%)), thinned.
    pub errors: Vec<(u32, f64)>,
}

/// How far the comparison at the end has come.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Comparison {
    /// The bodies, the initial one first; the last may lack networks.
    pub bodies: Vec<BodyEvaluation>,
    /// The network that is being trained on it.
    pub training: Option<Training>,
    /// Counts of work.
    pub counters: Counters,
    /// Where the time went.
    pub seconds: Seconds,
}

/// What is needed to go on inside a trial.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Checkpoint {
    /// The next outer step.
    pub step: u32,
    /// α (mm).
    pub design: Vec<f64>,
    /// Adam on α.
    pub design_moments: Moments<f64>,
    /// Brain weights, where the protocol keeps them.
    pub weights: Vec<f32>,
    /// Adam on the brain.
    pub weight_moments: Moments<f32>,
    /// The best design so far.
    pub best: Option<Best>,
    /// The body's rate as a part of what the protocol asks for.
    pub caution: f64,
    /// Steps taken back in a row.
    pub setbacks: u32,
    /// Running geometric mean of the training loss after training.
    pub trend: Option<f64>,
    /// λ of the linear brain, where the body is trained with one and a step has found it.
    pub ridge: Option<f64>,
    /// The last designs before this one, newest last.
    pub trail: Vec<Waypoint>,
    /// The comparison, where it has begun.
    pub comparison: Option<Box<Comparison>>,
    /// Where sensors have moved under programs that moved them: the first outer step there, and their units.
    pub moves: Vec<(u32, Vec<usize>)>,
    /// Fitness of the candidates of a search without gradient so far.
    pub found: Vec<f64>,
    /// How casts of the bodies of the comparison are read so far.
    pub casts: Vec<Vec<CastReading>>,
    /// Bands about what is read of these bodies and casts.
    pub bands: Vec<Vec<Band>>,
}

impl Checkpoint {
    /// What a trial that trains the same body goes on from: all but the comparison, which is its own, and the weights of a
    /// network that trains no body, whose shape may be its own.
    #[must_use]
    pub fn of_body(mut self, by_network: bool) -> Self {
        (self.comparison, self.casts, self.bands) = (None, Vec::new(), Vec::new());
        if !by_network {
            (self.weights, self.weight_moments) = (Vec::new(), Moments::default());
        }
        self
    }

    /// Behind all outer steps, of what is left of them once a trial is done: its best design (mm), found by that step.
    #[must_use]
    pub fn trained(steps: u32, design: Vec<f64>, best_step: u32) -> Self {
        let nothing = vec![0.0; design.len()];
        let design_moments = Moments { first: nothing.clone(), second: nothing, steps: steps.into() };
        let best = Some(Best { design: design.clone(), error: 0.0, step: best_step });
        Self { step: steps, design, design_moments, best, caution: 1.0, ..Self::default() }
    }
}

/// A stored checkpoint that this program cannot go on from.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CheckpointError {
    /// Of another program.
    #[error("it has version {0}, this program reads version {known}", known = Checkpoint::VERSION)]
    Version(u8),
    /// Cut short, or of another shape than its version says.
    #[error("it is damaged: {0}")]
    Damaged(String),
}

impl Checkpoint {
    /// Of what [`Checkpoint::to_bytes`] writes.
    pub const VERSION: u8 = 8;

    /// As it is stored.
    ///
    /// # Panics
    /// Never: it is plain data.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        postcard::to_extend(self, vec![Self::VERSION]).expect("a checkpoint is plain data")
    }

    /// From what is stored.
    ///
    /// # Errors
    /// If it is of another version, or not whole.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CheckpointError> {
        match bytes.split_first() {
            Some((&Self::VERSION, rest)) => read(rest),
            Some((version, _)) => Err(CheckpointError::Version(*version)),
            None => Err(CheckpointError::Damaged("it is empty".into())),
        }
    }
}

/// The value that some bytes hold, all of them.
fn read<'a, T: Deserialize<'a>>(bytes: &'a [u8]) -> Result<T, CheckpointError> {
    match postcard::take_from_bytes(bytes) {
        Ok((value, [])) => Ok(value),
        Ok((_, more)) => Err(CheckpointError::Damaged(format!("{} bytes too many", more.len()))),
        Err(error) => Err(CheckpointError::Damaged(error.to_string())),
    }
}

#[cfg(test)]
mod tests;
