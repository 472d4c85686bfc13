//! Reasons why an attempt at a trial ends without a result, and the consequences.

use serde::{Deserialize, Serialize};

/// Declares the failures of a trial with their names in records.
macro_rules! causes {
    ($(#[$about:meta])* $Cause:ident: $($(#[$doc:meta])* $cause:ident = $name:literal,)*) => {
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
        pub enum $Cause {
            $($(#[$doc])* $cause,)*
        }

        impl $Cause {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$cause),*];

            /// Name in the database.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$cause => $name,)*
                }
            }
        }
    };
}

causes! {
    /// A numerical failure that ends a trial.
    Cause:
    /// A sample exceeded the limit of integrator steps.
    StepLimit = "step_limit",
    /// Integrator steps fell below the resolution of the clock.
    StepTooSmall = "step_too_small",
    /// A state was not finite. Older databases have this name for every other cause, too.
    NonFinite = "non_finite",
    /// Void angles fell below `contact.min_angle`.
    ForbiddenContact = "forbidden_contact",
    /// The energy balance failed: steps were too long for the highest mode.
    Unstable = "unstable",
    /// The body lost its stability while `body.compression` moved its held units.
    Buckled = "buckled",
    /// The body has no equilibrium under `body.compression`.
    NoEquilibrium = "no_equilibrium",
    /// A unit of the body is inverted, or has nearly vanished.
    NoMass = "no_mass",
    /// All outputs of a hidden layer are 0.
    DeadLayer = "dead_layer",
    /// The training loss grew without bound.
    Diverged = "diverged",
    /// The training loss was not a finite number.
    LossNonFinite = "loss_non_finite",
    /// The training loss rose far above its trend.
    LossJump = "loss_jump",
    /// The gradient in the design was not finite.
    GradientNonFinite = "gradient_non_finite",
    /// The normal matrix of the linear decoder has no Cholesky factor.
    Singular = "singular",
    /// Too few candidate units are far enough apart for the sensors.
    NowhereToSense = "nowhere_to_sense",
    /// Most readings of the initial body are at the limit of the sensors' range.
    Saturated = "saturated",
}

causes! {
    /// How the process of an external body ends a trial.
    BodyFault:
    /// It ended, or could not be started.
    Died = "body_died",
    /// It took longer than `body.time_limit`.
    TimeLimit = "body_time_limit",
    /// It reported an error, or its answer has another form or shape than asked for.
    Invalid = "body_invalid",
    /// It returned other values when called again.
    NotRepeatable = "body_not_repeatable",
    /// It describes another body than when the trial was planned.
    Changed = "body_changed",
}

/// Reason why an attempt ended without a result. `Display` prints its name in the database.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum Reason {
    /// A signal of this number ended the worker.
    #[error("worker_killed({0})")]
    WorkerKilled(i32),
    /// The worker exited with this code.
    #[error("worker_exited({0})")]
    WorkerExited(i32),
    /// The worker could not allocate memory: limited by `[run] memory` or by the machine.
    #[error("out_of_memory")]
    OutOfMemory,
    /// Shared memory had no room for a message from or to the worker.
    #[error("shared_memory_full")]
    SharedMemoryFull,
    /// The machine lacked threads, file descriptors or another resource of every trial.
    #[error("shortage")]
    Shortage,
    /// The worker reported nothing for longer than `[run] no_progress`.
    #[error("no_progress")]
    NoProgress,
    /// The attempt exceeded `[run] time_limit`.
    #[error("time_limit")]
    TimeLimit,
    /// A numerical failure.
    #[error("{}", .0.name())]
    Numerical(Cause),
    /// The process of an external body failed.
    #[error("{}", .0.name())]
    Body(BodyFault),
    /// Validation rejected the trial.
    #[error("rejected")]
    Rejected,
    /// A bug: the computation panicked.
    #[error("panicked")]
    Panicked,
    /// A user cancelled the trial.
    #[error("{CANCELLED}")]
    Cancelled,
    /// The run was stopped; the next run resumes the trial.
    #[error("stopped")]
    Stopped,
    /// The requested steps are done; the trial resumes when more are requested.
    #[error("paused")]
    Paused,
}

/// Name of `Reason::Cancelled`, which distinguishes cancelled from failed trials.
pub const CANCELLED: &str = "cancelled";

impl Reason {
    /// Whether another attempt may succeed, because the process failed and not the trial.
    pub fn is_retried(self) -> bool {
        let by_body = matches!(self, Self::Body(BodyFault::Died | BodyFault::TimeLimit));
        let by_process = matches!(self, Self::WorkerKilled(_) | Self::WorkerExited(_) | Self::NoProgress);
        by_body || by_process || self == Self::Stopped
    }

    /// Whether the machine lacked a resource that it may have later.
    pub fn is_shortage(self) -> bool {
        matches!(self, Self::OutOfMemory | Self::SharedMemoryFull | Self::Shortage)
    }
}
