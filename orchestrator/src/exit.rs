//! The exit codes, all of them; and errors in words.

use std::process::ExitCode;

/// How the program ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// All that was asked is done.
    Done = 0,
    /// A check failed, trials failed, or a run refused a command.
    Failed = 1,
    /// An error in the command line, the spec or the choice of database; nothing was started.
    BadInput = 2,
    /// Reading or writing failed: disk full, database in use, locked or damaged.
    Io = 3,
    /// Stopped on request; `run` goes on from there, as do commands that keep their progress.
    Interrupted = 4,
    /// This machine is at fault: it is short of something, no worker comes up, or trials die one after the other.
    Unfit = 5,
}

/// The codes with their meaning, as `--help` shows them.
pub const EXIT_CODES: &str = "\
Exit codes:
  0  done
  1  a check failed, trials failed (`status` says which and why), or the run refused a
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

/// An error with its causes.
#[must_use]
pub fn chain(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(error.source(), |e| e.source());
    std::iter::once(error.to_string()).chain(causes.map(|e| e.to_string())).collect::<Vec<_>>().join(": ")
}
