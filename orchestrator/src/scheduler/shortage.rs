//! What the machine is short of. Nothing is handed out for a while then, each time for longer, until trials come further again or
//! the machine is given up.

use metasense_schemas::reason::Reason;

use super::Millis;

/// See the module.
#[derive(Debug, Clone, Default)]
pub(super) struct Shortage {
    /// The last one.
    of: Option<Reason>,
    /// Since a trial that was handed out after one has come further.
    in_a_row: u32,
    /// Nothing is handed out before this time.
    until: Millis,
}

impl Shortage {
    /// An attempt came to nothing for it; `wait` after so many. Those of several workers at the same time are one.
    pub fn met(&mut self, reason: Reason, now: Millis, wait: impl FnOnce(u32) -> Millis) {
        self.of = Some(reason);
        if now >= self.until {
            self.in_a_row += 1;
            self.until = now + wait(self.in_a_row);
        }
    }

    /// A trial that was handed out at this time has come further.
    pub fn came_further(&mut self, since: Millis) {
        if since >= self.until {
            self.in_a_row = 0;
        }
    }

    /// A worker has come to an end, and what it had is free again: that is tried before the machine is given up.
    pub fn relieved(&mut self, now: Millis, retries: u32) {
        self.in_a_row = self.in_a_row.min(retries);
        self.until = self.until.min(now);
    }

    /// Whether it is waited for.
    pub fn is_waited_for(&self, now: Millis) -> bool {
        now < self.until
    }

    /// What has been short more often than is tried again.
    pub fn lasting(&self, retries: u32) -> Option<Reason> {
        self.of.filter(|_| self.in_a_row > retries)
    }
}
