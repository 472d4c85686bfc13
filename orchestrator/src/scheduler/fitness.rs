//! Whether this machine is fit for trials: deaths of workers, and shortages of the machine (memory, threads, …).

use std::collections::BTreeSet;

use metasense_schemas::reason::Reason;

use super::Millis;

/// Number of deaths after which the machine counts as unfit …
pub const UNFIT_DEATHS: u32 = 10;
/// … if they include this many trials.
pub const UNFIT_TRIALS: usize = 3;

/// Consecutive deaths of workers without progress of any trial in between.
#[derive(Debug, Clone, Default)]
pub(super) struct Deaths {
    in_a_row: u32,
    trials: BTreeSet<u32>,
    /// Reason of the last.
    reason: Option<Reason>,
}

impl Deaths {
    pub fn note(&mut self, trial: u32, reason: Reason) {
        self.in_a_row += 1;
        self.trials.insert(trial);
        self.reason = Some(reason);
    }

    /// The reason of the last death, if the machine counts as unfit.
    pub fn unfit(&self) -> Option<Reason> {
        let many = self.in_a_row >= UNFIT_DEATHS && self.trials.len() >= UNFIT_TRIALS;
        self.reason.filter(|_| many)
    }
}

/// Shortages. After each, no trials are assigned for a while, longer each time, until a trial makes progress or the machine is
/// given up.
#[derive(Debug, Clone, Default)]
pub(super) struct Shortage {
    /// Reason of the last shortage.
    reason: Option<Reason>,
    /// Consecutive shortages without progress of a trial assigned after them.
    in_a_row: u32,
    /// Time before which no trials are assigned.
    until: Millis,
}

impl Shortage {
    /// Notes that an attempt failed for this reason; `wait` maps the number of consecutive shortages to a time. Simultaneous
    /// ones count once.
    pub fn note_failure(&mut self, reason: Reason, now: Millis, wait: impl FnOnce(u32) -> Millis) {
        self.reason = Some(reason);
        if now >= self.until {
            self.in_a_row += 1;
            self.until = now + wait(self.in_a_row);
        }
    }

    /// Notes progress of a trial that was assigned at this time.
    pub fn came_further(&mut self, since: Millis) {
        if since >= self.until {
            self.in_a_row = 0;
        }
    }

    /// A worker has freed its resources: assign trials again before the machine is given up.
    pub fn relieved(&mut self, now: Millis, retries: u32) {
        self.in_a_row = self.in_a_row.min(retries);
        self.until = self.until.min(now);
    }

    /// Whether assignments wait.
    pub fn is_waited_for(&self, now: Millis) -> bool {
        now < self.until
    }

    /// The reason, if there were more consecutive shortages than retries.
    pub fn lasting(&self, retries: u32) -> Option<Reason> {
        self.reason.filter(|_| self.in_a_row > retries)
    }
}
