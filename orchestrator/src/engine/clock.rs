//! Clock for deadlines that counts only time in which the engine observes. While this process is stopped or blocked by a disk,
//! workers must not time out: their messages were not read, or they were stopped as well. `elapsed` counts all time.

use std::time::{Duration, Instant};

/// Longest gap between two looks that counts in full; the loop looks every `TICK`.
const GAP: Duration = Duration::from_secs(1);

/// See the module.
#[derive(Debug)]
pub(super) struct Clock {
    began: Instant,
    looked: Instant,
    counted: Duration,
}

impl Clock {
    pub fn start() -> Self {
        let now = Instant::now();
        Self { began: now, looked: now, counted: Duration::ZERO }
    }

    /// Time since the start, with unobserved time.
    pub fn elapsed(&self) -> Duration {
        self.began.elapsed()
    }

    /// Milliseconds since the start, without unobserved time.
    pub fn look(&mut self) -> u64 {
        let now = Instant::now();
        self.pass(now.duration_since(self.looked));
        self.looked = now;
        self.counted.as_millis() as u64
    }

    fn pass(&mut self, gap: Duration) {
        self.counted += gap.min(GAP);
    }
}

#[cfg(test)]
mod tests;
