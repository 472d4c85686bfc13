//! What a person may see of a run while it goes on.

use std::collections::HashMap;
use std::time::Duration;

use metasense_schemas::record::{StepRecord, TrialResult};

use crate::plan::Trial;
use crate::scheduler::{Outcome, Reason};

/// Who watches a run.
pub trait Watch {
    /// A step has come in.
    fn step(&mut self, _trial: &Trial, _record: &StepRecord) {}
    /// A result is on disk.
    fn done(&mut self, _trial: &Trial, _result: &TrialResult) {}
    /// An attempt has come to nothing; `settled`: for good.
    fn attempt_failed(&mut self, _trial: &Trial, _attempt: u32, _reason: Reason, _settled: bool) {}
    /// Somebody wants the run to end; `again`: not for the first time.
    fn interrupted(&mut self, _again: bool) {}
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
    /// Done in this run.
    pub done: usize,
    /// Given up in this run.
    pub failed: usize,
    /// Steps that have come in.
    pub steps: u64,
    /// Worker processes.
    pub workers: u32,
    /// Those with a trial.
    pub busy: usize,
    /// Since the beginning.
    pub elapsed: Duration,
    costs: Vec<f64>,
    settled_cost: f64,
    total_cost: f64,
    /// Part done of each running trial: where this run found it, and now.
    fractions: HashMap<u32, (Option<f64>, f64)>,
    /// Cost worked off in this run by trials that are settled.
    worked: f64,
}

impl View {
    pub(super) fn new(trials: &[&Trial], workers: u32) -> Self {
        let costs: Vec<f64> = trials.iter().map(|trial| trial.cost.max(1e-9)).collect();
        Self {
            total: trials.len(),
            done: 0,
            failed: 0,
            steps: 0,
            workers,
            busy: 0,
            elapsed: Duration::ZERO,
            settled_cost: 0.0,
            total_cost: costs.iter().sum(),
            costs,
            fractions: HashMap::new(),
            worked: 0.0,
        }
    }

    /// Part of the estimated work that is done, 0 to 1.
    pub fn fraction(&self) -> f64 {
        let running: f64 =
            self.fractions.iter().map(|(trial, (_, now))| self.costs[*trial as usize] * now).sum();
        if self.total_cost > 0.0 { ((self.settled_cost + running) / self.total_cost).min(1.0) } else { 1.0 }
    }

    /// Estimated time to go, once there is something to judge by: the work left, at the rate of this run so far.
    pub fn eta(&self) -> Option<Duration> {
        let running = |(trial, (first, now)): (&u32, &(Option<f64>, f64))| {
            self.costs[*trial as usize] * (now - first.unwrap_or(*now))
        };
        let worked = self.worked + self.fractions.iter().map(running).sum::<f64>();
        let rate = worked / self.elapsed.as_secs_f64();
        let left = (1.0 - self.fraction()) * self.total_cost;
        (rate > 0.0 && rate.is_finite()).then(|| Duration::try_from_secs_f64(left / rate).ok())?
    }

    /// What a trial that goes on from a checkpoint has behind it was not done in this attempt.
    pub(super) fn assigned(&mut self, trial: u32, begun: bool) {
        self.fractions.insert(trial, ((!begun).then_some(0.0), 0.0));
    }

    pub(super) fn progressed(&mut self, trial: u32, fraction: f64) {
        if let Some((first, now)) = self.fractions.get_mut(&trial) {
            *now = if fraction.is_finite() { fraction.clamp(0.0, 1.0) } else { *now };
            first.get_or_insert(*now);
        }
    }

    pub(super) fn stepped(&mut self, _trial: u32) {
        self.steps += 1;
    }

    pub(super) fn returned(&mut self, trial: u32) {
        self.fractions.remove(&trial);
    }

    pub(super) fn done(&mut self, trial: u32) {
        self.done += 1;
        self.settle(trial);
    }

    pub(super) fn failed(&mut self, trial: u32) {
        self.failed += 1;
        self.settle(trial);
    }

    fn settle(&mut self, trial: u32) {
        let cost = self.costs[trial as usize];
        let first = self.fractions.remove(&trial).and_then(|(first, _)| first).unwrap_or(0.0);
        self.settled_cost += cost;
        self.worked += cost * (1.0 - first);
    }
}
