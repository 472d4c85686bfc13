//! Progress of a run for people.

use std::collections::HashSet;
use std::time::Duration;

use metasense_schemas::reason::Reason;
use metasense_schemas::record::{StepRecord, TrialResult};

use crate::analysis::forecast::{Forecast, Planned};
use crate::control::Command;
use crate::plan::Trial;
use crate::scheduler::{Outcome, Prior, Settings};

/// Observer of a run.
pub trait Watch {
    /// A step has arrived.
    fn step(&mut self, _trial: &Trial, _record: &StepRecord) {}
    /// A result is on disk.
    fn done(&mut self, _trial: &Trial, _result: &TrialResult) {}
    /// An attempt has failed; `settled`: the trial, too. `_text`: the reason and its details.
    fn attempt_failed(
        &mut self,
        _trial: &Trial,
        _attempt: u32,
        _reason: Reason,
        _settled: bool,
        _text: &str,
    ) {
    }
    /// The trial restarts, as its checkpoint cannot be used.
    fn begins_anew(&mut self, _trial: &Trial, _why: &str) {}
    /// A warning for the user.
    fn warned(&mut self, _text: &str) {}
    /// A stop was requested; `_again`: not for the first time. Steps in progress may take up to `_grace`.
    fn interrupted(&mut self, _again: bool, _grace: Duration) {}
    /// A command was answered; `done`: it took effect.
    fn steered(&mut self, _command: &Command, _done: bool, _said: &str) {}
    /// Called about five times per second.
    fn tick(&mut self, _view: &View) {}
    /// The run is over.
    fn end(&mut self, _view: &View, _outcome: Outcome) {}
}

/// Observer that does nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Watch for Silent {}

/// Progress of a run.
#[derive(Debug, Clone)]
pub struct View {
    /// Trials of this run.
    pub total: usize,
    /// Trials done in this run, or paused at their requested step.
    pub done: usize,
    /// Trials failed in this run.
    pub failed: usize,
    /// Trials cancelled in this run.
    pub given_up: usize,
    /// Steps that have arrived.
    pub steps: u64,
    /// Requested number of workers.
    pub workers: u32,
    /// Workers that have a trial.
    pub busy: usize,
    /// Whether the run is paused.
    pub paused: bool,
    /// Time since the start.
    pub elapsed: Duration,
    pub(super) forecast: Forecast,
}

impl View {
    pub(super) fn new(trials: &[&Trial], priors: &[Prior], settings: &Settings) -> Self {
        let workers = settings.workers;
        // of the trials with the same body, the first trains it
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

    /// Number of trials that have ended in this run.
    pub fn settled(&self) -> usize {
        self.done + self.failed + self.given_up
    }

    /// Fraction of the estimated work that is done, 0 to 1.
    pub fn fraction(&self) -> f64 {
        self.forecast.part(self.elapsed)
    }

    /// Estimated remaining time; `None` before the first measurement.
    pub fn eta(&self) -> Option<Duration> {
        self.forecast.to_go(self.elapsed)
    }

    /// Adds a trial that has done `behind` steps.
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

    /// A result has arrived; it counts as done once it is on disk.
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
