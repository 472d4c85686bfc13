//! Exit codes, and errors as text.

use std::process::ExitCode;

use metasense_schemas::reason::{BodyFault, Cause, Reason};

/// Exit code of the program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// Everything requested is done.
    Done = 0,
    /// A check failed, trials failed, or a run refused a command.
    Failed = 1,
    /// An error in the command line, the spec or the choice of database; nothing was started.
    BadInput = 2,
    /// Reading or writing failed: file not writable, database in use, locked or damaged.
    Io = 3,
    /// Stopped on request; `run` and other commands that keep their progress can resume.
    Interrupted = 4,
    /// This machine is unfit: it lacks a resource, no worker starts, or trials fail one after another.
    Unfit = 5,
}

/// Exit codes and their meanings, as `--help` prints them.
pub const EXIT_CODES: &str = "\
Exit codes:
  0  done
  1  a check failed, trials failed (`status` lists them with reasons), or the run refused a
     `control` command
  2  an error in the command line, the spec or the choice of database; nothing was started
     (`control`: no run holds the database)
  3  reading or writing failed: file not writable, database in use, locked or damaged
  4  stopped on request; the same `run` command resumes, and so do `lab evaluate` and `lab identify`
     with --out-dir; other commands start again
  5  this machine is unfit: it lacks a resource that the message names (threads, memory,
     descriptors, disk space), no worker starts, or all trials die without a step; trials
     stay pending, and the same `run` command resumes them, preferably on another machine";

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}

/// Formats an error with its causes, separated by ": ".
pub fn chain(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(error.source(), |e| e.source());
    std::iter::once(error.to_string()).chain(causes.map(|e| e.to_string())).collect::<Vec<_>>().join(": ")
}

/// Advice to the user about a trial that ended for this reason.
pub fn remedy(reason: Reason) -> &'static str {
    match reason {
        Reason::WorkerKilled(9) => {
            "the system may be short of memory: use fewer workers, then run with --retry-failed"
        }
        Reason::WorkerKilled(_) | Reason::WorkerExited(_) | Reason::Panicked => {
            "this is a bug: run `metasense trial SPEC HASH`, and report its output"
        }
        Reason::OutOfMemory => {
            "raise `memory` in [run], or use fewer threads, samples or sensors, then run with --retry-failed"
        }
        Reason::SharedMemoryFull => {
            "free space in /dev/shm, enlarge it (`mount -o remount,size=1G /dev/shm`, `docker run --shm-size 1g`), or \
             use fewer workers"
        }
        Reason::Shortage => "raise the limit that the log names, or use fewer workers or threads",
        Reason::NoProgress => "raise `no_progress` in [run], then run with --retry-failed",
        Reason::TimeLimit => "raise `time_limit` in [run], then run with --retry-failed",
        Reason::Numerical(Cause::Saturated) => {
            "raise `range` in [sensors] (mm/s², rad/s), use a chip with a larger range, reduce the forces, or move the \
             sensors"
        }
        Reason::Numerical(Cause::Buckled | Cause::NoEquilibrium) => {
            "set `body.compression` nearer to 0, or increase `body.initial_angle`"
        }
        Reason::Numerical(Cause::NoMass) => {
            "set `feasible.limits = true`, reduce the spread of `body.design`, or choose another design"
        }
        Reason::Numerical(Cause::Singular) => {
            "check whether all forces are 0 (`stimuli.onset` and `time.duration`, or clock and scale of records); if not, raise \
             `brain.ridge`"
        }
        Reason::Numerical(Cause::StepLimit | Cause::StepTooSmall) => {
            "reduce the forces, `body.stiffness` or the damping, increase `body.density`, or raise `solver.tolerance`"
        }
        Reason::Numerical(Cause::Unstable) => {
            "reduce `solver.tolerance`, set `solver.method = \"tsit5\"`, or reduce the forces"
        }
        Reason::Numerical(Cause::NonFinite) => {
            "reduce the forces, and check `body.density`, `body.stiffness` and the damping"
        }
        Reason::Numerical(Cause::ForbiddenContact) => {
            "reduce the forces or `body.contact.min_angle`, or increase `body.contact.stiffness` or `feasible.min_void_angle`"
        }
        Reason::Numerical(Cause::DeadLayer | Cause::Diverged | Cause::LossNonFinite) => {
            "reduce `brain.learning_rate`, or `optimise.brain_learning_rate` if the failure is in training"
        }
        Reason::Numerical(Cause::LossJump | Cause::GradientNonFinite) => {
            "reduce `optimise.learning_rate` or the forces"
        }
        Reason::Numerical(Cause::NowhereToSense) => "reduce `sensors.spacing` or the number of sensors",
        Reason::Body(BodyFault::TimeLimit) => "raise `body.time_limit`, then run with --retry-failed",
        Reason::Body(BodyFault::Changed) => "run the spec again: its trials get other hashes",
        Reason::Body(_) => "run `metasense lab verify SPEC`, and correct the program of `body.command`",
        Reason::Rejected => {
            "the spec is invalid for this trial: run `metasense trial SPEC HASH` for the message"
        }
        Reason::Cancelled => "run with --retry-failed to resume it",
        Reason::Stopped => "the same command resumes it",
        Reason::Paused => "resumes if a search requests more of its steps",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// No learning rate remedies a failed simulation, and no integrator a failed training of a network.
    #[test]
    fn a_remedy_fits_its_cause() {
        for cause in [Cause::StepLimit, Cause::StepTooSmall, Cause::NonFinite, Cause::Unstable] {
            assert!(!remedy(Reason::Numerical(cause)).contains("learning_rate"), "{cause:?}");
        }
        for cause in [Cause::DeadLayer, Cause::Diverged, Cause::LossNonFinite] {
            let remedy = remedy(Reason::Numerical(cause));
            assert!(remedy.contains("learning_rate") && !remedy.contains("solver"), "{cause:?}");
        }
    }
}
