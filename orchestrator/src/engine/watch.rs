//! Observers of a run.

use std::time::Duration;

use metasense_schemas::reason::Reason;
use metasense_schemas::record::TrialResult;

pub use crate::analysis::view::View;
use crate::control::Command;
use crate::plan::PlannedTrial;
use crate::scheduler::RunOutcome;

/// Observer of a run.
pub trait Watch {
    /// A result is on disk.
    fn done(&mut self, _trial: &PlannedTrial, _result: &TrialResult) {}
    /// An attempt has failed; `settled`: the trial, too. `_text`: the reason and its details.
    fn attempt_failed(
        &mut self,
        _trial: &PlannedTrial,
        _attempt: u32,
        _reason: Reason,
        _settled: bool,
        _text: &str,
    ) {
    }
    /// The trial restarts, as its checkpoint cannot be used.
    fn begins_anew(&mut self, _trial: &PlannedTrial, _why: &str) {}
    /// A warning for the user.
    fn warned(&mut self, _text: &str) {}
    /// A stop was requested; `_again`: not for the first time. Steps in progress may take up to `_grace`.
    fn interrupted(&mut self, _again: bool, _grace: Duration) {}
    /// A command was answered; `done`: it took effect.
    fn steered(&mut self, _command: &Command, _done: bool, _said: &str) {}
    /// Called about five times per second.
    fn tick(&mut self, _view: &View) {}
    /// The run is over.
    fn end(&mut self, _view: &View, _outcome: RunOutcome) {}
}

/// Observer that does nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Watch for Silent {}
