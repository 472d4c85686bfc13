//! Estimates the remaining time: the plan's estimates, corrected by the time of steps and final evaluations so far.
//!
//! A trial consists of steps and a final evaluation ("comparison"). A step of a running trial takes the mean of its earlier
//! steps. Other steps take the plan's estimate times the ratio of measured to planned time of all steps; the same holds for
//! comparisons. The remaining work is assigned to workers in the order of the plan; the last worker to finish gives the end of
//! the run.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};
use std::time::Duration;

use metasense_schemas::record::{Parts, PlannedTrial};

/// With more open trials than this, the work is divided evenly among workers.
const ONE_BY_ONE: usize = 2000;

/// A step or comparison that exceeds its estimate is assumed to take this fraction of its elapsed time longer.
const OVERDUE: f64 = 0.25;

/// Planned time of a trial (s).
#[derive(Debug, Clone, Copy)]
pub struct Planned {
    step: f64,
    comparison: f64,
    steps: u32,
    /// Steps up to its checkpoint.
    behind: u32,
    open: bool,
}

impl Planned {
    /// A trial that has done `behind` steps.
    pub fn new(trial: &PlannedTrial, behind: u32) -> Self {
        let steps = trial.spec.optimise.steps().max(1) as u32;
        let Parts { steps: all, comparison } = trial.cost;
        let (step, comparison) = (all / f64::from(steps), comparison.max(1e-9));
        let (steps, comparison) = trial.pause.map_or((steps, comparison), |pause| (pause, 0.0));
        Self { step, comparison, steps, behind: behind.min(steps), open: true }
    }
}

/// Progress of a running trial.
#[derive(Debug, Clone, Copy)]
struct Running {
    since: Duration,
    /// Whether the comparison had not begun when the worker got the trial.
    whole: bool,
    /// Whether the first step has arrived; its time includes the worker's set-up.
    warm: bool,
    /// Steps after the first.
    steps: u32,
    seconds: f64,
}

/// Measured and planned seconds of the same work.
#[derive(Debug, Clone, Copy, Default)]
struct Ratio {
    seconds: f64,
    planned: f64,
}

impl Ratio {
    fn add(&mut self, seconds: f64, planned: f64) {
        if seconds.is_finite() && planned > 0.0 {
            self.seconds += seconds.max(0.0);
            self.planned += planned;
        }
    }

    fn value(self) -> Option<f64> {
        (self.planned > 0.0 && self.seconds > 0.0).then(|| self.seconds / self.planned)
    }
}

/// Forecast of the time of a run.
#[derive(Debug, Clone, Default)]
pub struct Forecast {
    trials: Vec<Planned>,
    workers: usize,
    running: HashMap<u32, Running>,
    of_steps: Ratio,
    of_comparisons: Ratio,
}

impl Forecast {
    /// A forecast for these trials, in the order of the plan.
    pub fn new(trials: Vec<Planned>, workers: u32) -> Self {
        Self { trials, workers: workers.max(1) as usize, ..Self::default() }
    }

    /// Adds a trial.
    pub fn add(&mut self, trial: Planned) {
        self.trials.push(trial);
    }

    /// Sets the number of workers.
    pub fn set_workers(&mut self, workers: u32) {
        self.workers = workers.max(1) as usize;
    }

    /// A worker got the trial.
    pub fn assigned(&mut self, trial: u32, now: Duration) {
        let Planned { behind, steps, .. } = self.trials[trial as usize];
        let whole = behind < steps;
        self.running.insert(trial, Running { since: now, whole, warm: false, steps: 0, seconds: 0.0 });
    }

    /// The trial resumes after `behind` steps, perhaps of another trial. `whole`: its comparison has not begun.
    pub fn goes_on(&mut self, trial: u32, behind: u32, whole: bool) {
        let planned = &mut self.trials[trial as usize];
        planned.behind = behind.min(planned.steps);
        if let Some(running) = self.running.get_mut(&trial) {
            running.whole = whole;
        }
    }

    /// A step has arrived.
    pub fn stepped(&mut self, trial: u32, now: Duration) {
        let planned = &mut self.trials[trial as usize];
        planned.behind = (planned.behind + 1).min(planned.steps);
        if let Some(running) = self.running.get_mut(&trial) {
            let seconds = now.saturating_sub(running.since).as_secs_f64();
            running.since = now;
            if std::mem::replace(&mut running.warm, true) {
                running.steps += 1;
                running.seconds += seconds;
                self.of_steps.add(seconds, planned.step);
            }
        }
    }

    /// The trial left its worker; `done`: with a result.
    pub fn returned(&mut self, trial: u32, done: bool, now: Duration) {
        if let Some(running) = self.running.remove(&trial)
            && done
            && running.whole
        {
            let planned = self.trials[trial as usize];
            self.of_comparisons.add(now.saturating_sub(running.since).as_secs_f64(), planned.comparison);
        }
    }

    /// The trial has ended.
    pub fn settled(&mut self, trial: u32) {
        self.trials[trial as usize].open = false;
    }

    /// Ratios of measured to planned time of steps and of comparisons; overdue comparisons count. An unknown ratio is replaced
    /// by the other.
    fn ratios(&self, now: Duration) -> Option<(f64, f64)> {
        let (steps, comparisons) = (self.of_steps.value(), self.of_comparisons.value());
        let (of_steps, known) = (steps.or(comparisons)?, comparisons.or(steps)?);
        let mut of_comparisons = self.of_comparisons;
        for (trial, running) in &self.running {
            let planned = self.trials[*trial as usize];
            let least = (1.0 + OVERDUE) * now.saturating_sub(running.since).as_secs_f64();
            if planned.behind == planned.steps && least > known * planned.comparison {
                of_comparisons.add(least, planned.comparison);
            }
        }
        Some((of_steps, of_comparisons.value().unwrap_or(known)))
    }

    /// Fraction of the work that is done, in this run and before, 0 to 1.
    pub fn part(&self, now: Duration) -> f64 {
        let ratios = self.ratios(now).unwrap_or((1.0, 1.0));
        let (mut remaining_seconds, mut whole) = (0.0, 0.0);
        for (planned, trial) in self.trials.iter().zip(0..) {
            whole += ratios.0 * planned.step * f64::from(planned.steps) + ratios.1 * planned.comparison;
            remaining_seconds += if planned.open { self.left(trial, ratios, now) } else { 0.0 };
        }
        if whole > 0.0 { (1.0 - remaining_seconds / whole).clamp(0.0, 1.0) } else { 1.0 }
    }

    /// Remaining seconds of a trial on its worker.
    fn left(&self, trial: u32, (of_steps, of_comparisons): (f64, f64), now: Duration) -> f64 {
        let planned = self.trials[trial as usize];
        let steps = f64::from(planned.steps - planned.behind);
        let comparison = of_comparisons * planned.comparison;
        let Some(running) = self.running.get(&trial) else {
            return steps * of_steps * planned.step + comparison;
        };
        let step = match running.steps {
            0 => of_steps * planned.step,
            n => running.seconds / f64::from(n),
        };
        let spent = now.saturating_sub(running.since).as_secs_f64();
        let in_progress = if planned.behind < planned.steps { step } else { comparison };
        steps * step + comparison - in_progress + (in_progress - spent).max(OVERDUE * spent)
    }

    /// Remaining time of the run; `None` before the first measured step or result.
    pub fn to_go(&self, now: Duration) -> Option<Duration> {
        let ratios = self.ratios(now)?;
        let mut workers: Vec<f64> = self.running.keys().map(|trial| self.left(*trial, ratios, now)).collect();
        workers.resize(self.workers.max(workers.len()), 0.0);
        let waiting = self.trials.iter().zip(0..).filter(|(planned, _)| planned.open);
        let waiting = waiting.filter(|(_, trial)| !self.running.contains_key(trial));
        let waiting: Vec<f64> = waiting.map(|(_, trial)| self.left(trial, ratios, now)).collect();
        if waiting.len() > ONE_BY_ONE {
            let all = workers.iter().chain(&waiting).sum::<f64>() / workers.len() as f64;
            return Duration::try_from_secs_f64(all).ok();
        }
        // In milliseconds: integers can be ordered.
        let mut ends: BinaryHeap<Reverse<u64>> =
            workers.iter().map(|left| Reverse((1000.0 * left) as u64)).collect();
        for left in waiting {
            if let Some(mut first) = ends.peek_mut() {
                first.0 = first.0.saturating_add((1000.0 * left) as u64);
            }
        }
        ends.into_iter().map(|Reverse(end)| end).max().map(Duration::from_millis)
    }
}

#[cfg(test)]
mod tests;
