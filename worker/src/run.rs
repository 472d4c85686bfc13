//! One trial from its spec to its result, for a worker process or in the foreground.

use metasense_schemas::record::{Checkpoint, StepRecord};

/// Who watches a trial.
pub trait Observe {
    /// The part of the trial that is done, in [0, 1].
    fn progress(&mut self, fraction: f64);
    /// A finished outer step, and what is needed to go on after it.
    fn step(&mut self, record: StepRecord, checkpoint: Checkpoint) -> Control;
}

/// What an observer wants next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Control {
    /// Another step.
    Continue,
    /// No more.
    Stop,
}

/// Why a trial has no result.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Failure {
    /// The observer said stop.
    #[error("stopped")]
    Stopped,
    /// The spec stands for no trial, or the checkpoint belongs to another one.
    #[error("rejected: {0}")]
    Rejected(String),
    /// The maths got into trouble that no smaller step leads out of.
    #[error("numerical: {0}")]
    NonFinite(String),
}
