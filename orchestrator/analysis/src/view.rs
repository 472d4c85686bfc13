//! Progress of a run for people: counts of trials, and the forecast of the remaining time.

use std::collections::HashSet;
use std::time::Duration;

use metasense_schemas::reason::Reason;
use metasense_schemas::record::PlannedTrial;

use crate::forecast::{Forecast, Planned};

/// Progress of a run.
#[derive(Debug, Clone, Default)]
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
    /// Bodies of the trials.
    bodies: HashSet<u32>,
    /// Forecast of the time.
    pub forecast: Forecast,
}

impl View {
    /// A run without trials.
    pub fn new(workers: u32, paused: bool) -> Self {
        Self { workers, paused, forecast: Forecast::new(Vec::new(), workers), ..Self::default() }
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

    /// Adds a trial after `steps` of a body, or one whose body is `trained`. Of the trials with the same body, the first trains it.
    pub fn add(&mut self, trial: &PlannedTrial, body: u32, steps: u32, trained: bool) {
        let trains = self.bodies.insert(body) && !trained;
        self.forecast.add(Planned::new(trial, if trains { steps } else { u32::MAX }));
        self.total += 1;
    }

    /// An attempt ended without a result; `settled`: the trial, too.
    pub fn attempt_failed(&mut self, trial: u32, reason: Reason, settled: bool, now: Duration) {
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
