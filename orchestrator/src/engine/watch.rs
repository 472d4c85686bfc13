//! What a person may see of a run while it goes on.

use std::collections::HashSet;
use std::time::Duration;

use metasense_schemas::reason::Reason;
use metasense_schemas::record::{StepRecord, TrialResult};

use super::forecast::{Forecast, Planned};
use crate::control::Command;
use crate::plan::Trial;
use crate::scheduler::{Outcome, Prior, Settings};

/// Who watches a run.
pub trait Watch {
    /// A step has come in.
    fn step(&mut self, _trial: &Trial, _record: &StepRecord) {}
    /// A result is on disk.
    fn done(&mut self, _trial: &Trial, _result: &TrialResult) {}
    /// An attempt has come to nothing; `settled`: for good. `_text`: the reason, with what was said of it.
    fn attempt_failed(
        &mut self,
        _trial: &Trial,
        _attempt: u32,
        _reason: Reason,
        _settled: bool,
        _text: &str,
    ) {
    }
    /// A trial's checkpoint is of no use: it begins anew.
    fn begins_anew(&mut self, _trial: &Trial, _why: &str) {}
    /// A warning for the user.
    fn warned(&mut self, _text: &str) {}
    /// Somebody wants the run to end; `_again`: not for the first time. Steps in progress are waited for at most `_grace`.
    fn interrupted(&mut self, _again: bool, _grace: Duration) {}
    /// Somebody has steered the run; `done`: and something has changed.
    fn steered(&mut self, _command: &Command, _done: bool, _said: &str) {}
    /// Some time has passed.
    fn tick(&mut self, _view: &View) {}
    /// The run is over.
    fn end(&mut self, _view: &View, _outcome: Outcome) {}
}

/// Nobody watches.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Watch for Silent {}

/// Where a run stands.
#[derive(Debug, Clone)]
pub struct View {
    /// Trials of this run.
    pub total: usize,
    /// Done in this run, or as far as it is to go.
    pub done: usize,
    /// Failed in this run.
    pub failed: usize,
    /// Given up in this run on request.
    pub given_up: usize,
    /// Steps that have come in.
    pub steps: u64,
    /// Worker processes.
    pub workers: u32,
    /// Those with a trial.
    pub busy: usize,
    /// Nothing is handed out for the time being.
    pub paused: bool,
    /// Since the beginning.
    pub elapsed: Duration,
    pub(super) forecast: Forecast,
}

impl View {
    pub(super) fn new(trials: &[&Trial], priors: &[Prior], settings: &Settings) -> Self {
        let workers = settings.workers;
        // of trials with one body the first trains it
        let mut bodies = HashSet::new();
        let planned = |(trial, prior): (&&Trial, &Prior)| {
            let trains = bodies.insert(prior.body) && !prior.trained;
            Planned::new(trial, if trains { prior.steps.unwrap_or(0) } else { u32::MAX })
        };
        Self {
            total: trials.len(),
            done: 0,
            failed: 0,
            given_up: 0,
            steps: 0,
            workers,
            busy: 0,
            paused: settings.paused,
            elapsed: Duration::ZERO,
            forecast: Forecast::new(trials.iter().zip(priors).map(planned).collect(), workers),
        }
    }

    /// Trials that are settled in this run.
    pub fn settled(&self) -> usize {
        self.done + self.failed + self.given_up
    }

    /// Part of the estimated work that is done, 0 to 1.
    pub fn fraction(&self) -> f64 {
        self.forecast.part(self.elapsed)
    }

    /// Estimated time to go, once there is something to judge by.
    pub fn eta(&self) -> Option<Duration> {
        self.forecast.to_go(self.elapsed)
    }

    /// A trial more, of which so many steps are done.
    pub(super) fn add(&mut self, trial: &Trial, behind: u32) {
        self.total += 1;
        self.forecast.add(Planned::new(trial, behind));
    }

    pub(super) fn set_workers(&mut self, workers: u32) {
        self.workers = workers;
        self.forecast.set_workers(workers);
    }

    pub(super) fn stepped(&mut self, trial: u32, now: Duration) {
        self.steps += 1;
        self.forecast.stepped(trial, now);
    }

    /// Its result has come in; it counts when it is on disk.
    pub(super) fn finished(&mut self, trial: u32, now: Duration) {
        self.forecast.returned(trial, true, now);
        self.forecast.settled(trial);
    }

    pub(super) fn done(&mut self) {
        self.done += 1;
    }

    pub(super) fn attempt_failed(&mut self, trial: u32, reason: Reason, settled: bool, now: Duration) {
        self.forecast.returned(trial, false, now);
        if settled {
            self.forecast.settled(trial);
            *match reason {
                Reason::Paused => &mut self.done,
                Reason::Cancelled => &mut self.given_up,
                _ => &mut self.failed,
            } += 1;
        }
    }
}
