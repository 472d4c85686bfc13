//! How long it will take: the plan's estimates, corrected by what steps and comparisons have taken so far.
//!
//! A trial is steps and a comparison at its end. A step of a running trial takes what its own steps took, one of another
//! trial what the plan says times what recorded steps took against that; so for comparisons, apart. What is left is
//! handed to the workers in the order of the plan, and the last one to end says when the run does.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};
use std::time::Duration;

use metasense_schemas::record::Parts;

use crate::plan::Trial;

/// More open trials than this are spread evenly instead of one by one.
const ONE_BY_ONE: usize = 2000;

/// A step or a comparison that takes longer than was thought takes at least this part of the time that it has taken so far.
const OVERDUE: f64 = 0.25;

/// What a trial is thought to take, before it has run (s).
#[derive(Debug, Clone, Copy)]
pub struct Planned {
    step: f64,
    comparison: f64,
    steps: u32,
    /// Behind its checkpoint.
    behind: u32,
    open: bool,
}

impl Planned {
    /// A trial that has `behind` steps behind it.
    pub fn new(trial: &Trial, behind: u32) -> Self {
        let steps = trial.spec.optimise.steps().max(1) as u32;
        let Parts { steps: all, comparison } = trial.cost;
        let (step, comparison) = (all / f64::from(steps), comparison.max(1e-9));
        let (steps, comparison) = trial.pause.map_or((steps, comparison), |pause| (pause, 0.0));
        Self { step, comparison, steps, behind: behind.min(steps), open: true }
    }
}

/// A running trial: what its worker has done of it.
#[derive(Debug, Clone, Copy)]
struct Running {
    since: Duration,
    /// All of its comparison was to come when the worker got it.
    whole: bool,
    /// Its first step has come in, and with it all that a worker does before that.
    warm: bool,
    /// Further ones.
    steps: u32,
    seconds: f64,
}

/// Seconds against what was planned for the same work.
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

/// The estimate of a run's time.
#[derive(Debug, Clone)]
pub struct Forecast {
    trials: Vec<Planned>,
    workers: usize,
    running: HashMap<u32, Running>,
    of_steps: Ratio,
    of_comparisons: Ratio,
}

impl Forecast {
    /// Of these trials, in the order of the plan.
    pub fn new(trials: Vec<Planned>, workers: u32) -> Self {
        Self {
            trials,
            workers: workers.max(1) as usize,
            running: HashMap::new(),
            of_steps: Ratio::default(),
            of_comparisons: Ratio::default(),
        }
    }

    /// A trial more.
    pub fn add(&mut self, trial: Planned) {
        self.trials.push(trial);
    }

    /// So many workers from now on.
    pub fn set_workers(&mut self, workers: u32) {
        self.workers = workers.max(1) as usize;
    }

    /// A worker has the trial.
    pub fn assigned(&mut self, trial: u32, now: Duration) {
        let Planned { behind, steps, .. } = self.trials[trial as usize];
        let whole = behind < steps;
        self.running.insert(trial, Running { since: now, whole, warm: false, steps: 0, seconds: 0.0 });
    }

    /// It goes on behind so many steps, which another trial may have made; `whole`: with all of its comparison to come.
    pub fn goes_on(&mut self, trial: u32, behind: u32, whole: bool) {
        let planned = &mut self.trials[trial as usize];
        planned.behind = behind.min(planned.steps);
        if let Some(running) = self.running.get_mut(&trial) {
            running.whole = whole;
        }
    }

    /// A step has come in.
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

    /// The worker has no longer got it; `done`: since it has a result.
    pub fn returned(&mut self, trial: u32, done: bool, now: Duration) {
        if let Some(running) = self.running.remove(&trial)
            && done
            && running.whole
        {
            let planned = self.trials[trial as usize];
            self.of_comparisons.add(now.saturating_sub(running.since).as_secs_f64(), planned.comparison);
        }
    }

    /// Nothing more will be done for it.
    pub fn settled(&mut self, trial: u32) {
        self.trials[trial as usize].open = false;
    }

    /// What steps and comparisons take against their plan; a guess is taken for what is not known. A comparison that is overdue counts.
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

    /// Part of the work that is done, 0 to 1, also by earlier runs.
    pub fn part(&self, now: Duration) -> f64 {
        let ratios = self.ratios(now).unwrap_or((1.0, 1.0));
        let (mut left, mut whole) = (0.0, 0.0);
        for (planned, trial) in self.trials.iter().zip(0..) {
            whole += ratios.0 * planned.step * f64::from(planned.steps) + ratios.1 * planned.comparison;
            left += if planned.open { self.left(trial, ratios, now) } else { 0.0 };
        }
        if whole > 0.0 { (1.0 - left / whole).clamp(0.0, 1.0) } else { 1.0 }
    }

    /// Seconds that a trial still takes on its worker.
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

    /// Time to go, once a step or a result has come in.
    pub fn to_go(&self, now: Duration) -> Option<Duration> {
        let ratios = self.ratios(now)?;
        let mut workers: Vec<f64> = self.running.keys().map(|trial| self.left(*trial, ratios, now)).collect();
        workers.resize(self.workers.max(workers.len()), 0.0);
        let waiting = self.trials.iter().zip(0..).filter(|(planned, _)| planned.open);
        let waiting: Vec<f64> = waiting
            .filter(|(_, trial)| !self.running.contains_key(trial))
            .map(|(_, trial)| self.left(trial, ratios, now))
            .collect();
        if waiting.len() > ONE_BY_ONE {
            let all = workers.iter().chain(&waiting).sum::<f64>() / workers.len() as f64;
            return Duration::try_from_secs_f64(all).ok();
        }
        // In milliseconds, which have an order.
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
