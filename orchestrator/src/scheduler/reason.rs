//! Why an attempt ended without a result, and what follows from it.

use std::fmt;

use metasense_schemas::wire::Trouble;

/// Why an attempt ended without a result. Its `Display` is its name in the database.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reason {
    /// The worker died by a signal.
    WorkerKilled(i32),
    /// The worker ended by itself, with this exit code.
    WorkerExited(i32),
    /// No sign of life for longer than `[run] no_progress`.
    NoProgress,
    /// Longer than `[run] time_limit`.
    TimeLimit,
    /// Numbers that are not finite.
    NonFinite,
    /// Another numerical outcome that ends a trial.
    Numerical,
    /// Validation says no.
    Rejected,
    /// A bug: the computation panicked.
    Panicked,
    /// Handed back on request; goes on with the next run.
    Stopped,
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::WorkerKilled(signal) => write!(f, "worker_killed({signal})"),
            Self::WorkerExited(code) => write!(f, "worker_exited({code})"),
            Self::NoProgress => f.write_str("no_progress"),
            Self::TimeLimit => f.write_str("time_limit"),
            Self::NonFinite => f.write_str("non_finite"),
            Self::Numerical => f.write_str("numerical"),
            Self::Rejected => f.write_str("rejected"),
            Self::Panicked => f.write_str("panicked"),
            Self::Stopped => f.write_str("stopped"),
        }
    }
}

impl From<Trouble> for Reason {
    fn from(trouble: Trouble) -> Self {
        match trouble {
            Trouble::NonFinite => Self::NonFinite,
            Trouble::Numerical => Self::Numerical,
            Trouble::Rejected => Self::Rejected,
            Trouble::Panicked => Self::Panicked,
        }
    }
}

impl Reason {
    /// Whether another attempt may end otherwise: what happened to the process, not to the trial.
    pub fn is_retried(self) -> bool {
        matches!(self, Self::WorkerKilled(_) | Self::WorkerExited(_) | Self::NoProgress | Self::Stopped)
    }
}
