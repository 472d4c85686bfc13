//! The exit codes, all of them; and errors in words.

use std::process::ExitCode;

/// How the program ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// All that was asked is done.
    Done = 0,
    /// A check did not hold, trials have failed, or a run refuses what it is asked.
    Failed = 1,
    /// The command line, the spec or the choice of database is at fault; nothing was started.
    BadInput = 2,
    /// Reading or writing failed: disk full, database in use, locked or damaged.
    Io = 3,
    /// Stopped on request; `run` goes on from there, and what keeps what it has come to.
    Interrupted = 4,
}

/// The codes with their meaning, as `--help` shows them.
pub const EXIT_CODES: &str = "\
Exit codes:
  0  all that was asked is done
  1  a check did not hold, trials have failed (`status` names them and why), or a run
     refuses what `control` asks
  2  the command line, the spec or the choice of database is at fault (of `control`: no
     run holds it); nothing was started
  3  reading or writing failed (disk full, database in use, locked or damaged)
  4  stopped on request; `run` goes on from there, as do `evaluate` and `identify`
     with --out; other commands begin anew";

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
