//! Trials of a run, and their phases.

use metasense_schemas::reason::Reason;

use super::WorkerId;

/// State of a trial at the start of the run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Prior {
    /// Attempts in earlier runs.
    pub attempts: u32,
    /// Steps up to its checkpoint; trials with a checkpoint start first.
    pub steps: Option<u32>,
    /// Number of the trial's body. Trials with the same body share its training and its checkpoints.
    pub body: u32,
    /// Whether one of these trials has trained the body completely.
    pub trained: bool,
}

/// Phase of a trial.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Phase {
    /// Waits for a worker.
    #[default]
    Pending,
    /// Runs on a worker.
    Running(WorkerId),
    /// Its result is being written to disk.
    Recording(WorkerId),
    /// Its result is on disk.
    Done,
    /// Ended without a result.
    Failed(Reason),
}

#[derive(Debug, Clone, Default)]
pub(super) struct Trial {
    pub phase: Phase,
    pub attempt: u32,
    pub begun: bool,
    /// Deaths since the last step.
    pub deaths: u32,
    /// Shortages of the machine since the last step.
    pub shortages: u32,
    pub stepped: bool,
    pub body: u32,
    /// Why the trial must not be finished, if so; its worker is told to stop it.
    pub unwanted: Option<Reason>,
    /// Rank of a trial that a `Next` command moved ahead of the others: the lower, the earlier.
    pub first: Option<i64>,
}

impl Trial {
    pub fn new(prior: &Prior) -> Self {
        Self { attempt: prior.attempts, begun: prior.steps.is_some(), body: prior.body, ..Self::default() }
    }

    /// Rank in the queue, lowest first. Failed attempts move a trial back.
    pub fn rank(&self) -> i64 {
        self.first.unwrap_or(2 * i64::from(self.deaths + self.shortages) + i64::from(!self.begun))
    }
}
