//! Shortages of the machine (memory, threads, …). After each, no trials are assigned for a while, longer each time, until a
//! trial makes progress or the machine is given up.

use metasense_schemas::reason::Reason;

use super::Millis;

/// See the module.
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
