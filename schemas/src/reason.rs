//! Reasons why an attempt at a trial ends without a result, and the consequences.

use std::fmt;

use crate::wire::{BodyFault, Cause, Trouble};

/// Reason why an attempt ended without a result. `Display` prints its name in the database.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reason {
    /// A signal of this number ended the worker.
    WorkerKilled(i32),
    /// The worker exited with this code.
    WorkerExited(i32),
    /// The worker could not allocate memory: limited by `[run] memory` or by the machine.
    OutOfMemory,
    /// Shared memory had no room for a message from or to the worker.
    SharedMemoryFull,
    /// The machine lacked threads, file descriptors or another resource of every trial.
    Shortage,
    /// The worker reported nothing for longer than `[run] no_progress`.
    NoProgress,
    /// The attempt exceeded `[run] time_limit`.
    TimeLimit,
    /// A numerical failure.
    Numerical(Cause),
    /// The process of an external body failed.
    Body(BodyFault),
    /// Validation rejected the trial.
    Rejected,
    /// A bug: the computation panicked.
    Panicked,
    /// A user cancelled the trial.
    Cancelled,
    /// The run was stopped; the next run resumes the trial.
    Stopped,
    /// The requested steps are done; the trial resumes when more are requested.
    Paused,
}

/// Name of `Reason::Cancelled`, which distinguishes cancelled from failed trials.
pub const CANCELLED: &str = "cancelled";

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::WorkerKilled(signal) => write!(f, "worker_killed({signal})"),
            Self::WorkerExited(code) => write!(f, "worker_exited({code})"),
            Self::OutOfMemory => f.write_str("out_of_memory"),
            Self::SharedMemoryFull => f.write_str("shared_memory_full"),
            Self::Shortage => f.write_str("shortage"),
            Self::NoProgress => f.write_str("no_progress"),
            Self::TimeLimit => f.write_str("time_limit"),
            Self::Numerical(cause) => f.write_str(cause.name()),
            Self::Body(fault) => f.write_str(fault.name()),
            Self::Rejected => f.write_str("rejected"),
            Self::Panicked => f.write_str("panicked"),
            Self::Cancelled => f.write_str(CANCELLED),
            Self::Stopped => f.write_str("stopped"),
            Self::Paused => f.write_str("paused"),
        }
    }
}

impl From<Trouble> for Reason {
    fn from(trouble: Trouble) -> Self {
        match trouble {
            Trouble::Numerical(cause) => Self::Numerical(cause),
            Trouble::Body(fault) => Self::Body(fault),
            Trouble::Rejected => Self::Rejected,
            Trouble::Panicked => Self::Panicked,
            Trouble::Shortage => Self::Shortage,
        }
    }
}

impl Reason {
    /// Advice to the user about a trial that ended for this reason.
    pub fn remedy(self) -> &'static str {
        match self {
            Self::WorkerKilled(9) => {
                "the system may be short of memory: use fewer workers, then run with --retry-failed"
            }
            Self::WorkerKilled(_) | Self::WorkerExited(_) | Self::Panicked => {
                "this is a bug: run `metasense trial SPEC HASH`, and report its output"
            }
            Self::OutOfMemory => {
                "raise `memory` in [run], or use fewer threads, samples or sensors, then run with --retry-failed"
            }
            Self::SharedMemoryFull => {
                "free space in /dev/shm, enlarge it (`mount -o remount,size=1G /dev/shm`, `docker run --shm-size 1g`), or \
                 use fewer workers"
            }
            Self::Shortage => "raise the limit that the log names, or use fewer workers or threads",
            Self::NoProgress => "raise `no_progress` in [run], then run with --retry-failed",
            Self::TimeLimit => "raise `time_limit` in [run], then run with --retry-failed",
            Self::Numerical(Cause::Saturated) => {
                "raise `range` in [sensors] (mm/s², rad/s), use a chip with a larger range, reduce the forces, or move the \
                 sensors"
            }
            Self::Numerical(Cause::Buckled | Cause::NoEquilibrium) => {
                "set `body.compression` nearer to 0, or increase `body.initial_angle`"
            }
            Self::Numerical(Cause::Singular) => {
                "check whether all forces are 0 (`stimuli.onset` and `time.duration`, or clock and scale of records); if not, raise \
                 `brain.ridge`"
            }
            Self::Numerical(_) => {
                "run `metasense trial SPEC HASH`; reduce `solver.tolerance` or the learning rate"
            }
            Self::Body(BodyFault::TimeLimit) => "raise `body.time_limit`, then run with --retry-failed",
            Self::Body(BodyFault::Changed) => "run the spec again: its trials get other hashes",
            Self::Body(_) => "run `metasense lab verify SPEC`, and correct the program of `body.command`",
            Self::Rejected => {
                "the spec is invalid for this trial: run `metasense trial SPEC HASH` for the message"
            }
            Self::Cancelled => "run with --retry-failed to resume it",
            Self::Stopped => "the same command resumes it",
            Self::Paused => "resumes if a search requests more of its steps",
        }
    }

    /// Whether another attempt may succeed, because the process failed and not the trial.
    pub fn is_retried(self) -> bool {
        let body = matches!(self, Self::Body(BodyFault::Died | BodyFault::TimeLimit));
        body || matches!(
            self,
            Self::WorkerKilled(_) | Self::WorkerExited(_) | Self::NoProgress | Self::Stopped
        )
    }

    /// Whether the machine lacked a resource that it may have later.
    pub fn is_shortage(self) -> bool {
        matches!(self, Self::OutOfMemory | Self::SharedMemoryFull | Self::Shortage)
    }
}
