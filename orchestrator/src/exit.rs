//! Exit codes, and errors as text.

use std::process::ExitCode;

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
    /// Reading or writing failed: disk full, database in use, locked or damaged.
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
  3  reading or writing failed: disk full, database in use, locked or damaged
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
#[must_use]
pub fn chain(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(error.source(), |e| e.source());
    std::iter::once(error.to_string()).chain(causes.map(|e| e.to_string())).collect::<Vec<_>>().join(": ")
}
