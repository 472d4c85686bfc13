//! The time that deadlines count: time in which we were looking. What passes while this process is stopped, or stuck on a
//! disk, is nobody's silence: whoever is late by it has not been heard, or was stopped as well.

use std::time::{Duration, Instant};

/// Longest time between two looks that counts in full; the loop looks every `TICK`.
const GAP: Duration = Duration::from_secs(1);

/// See the module.
#[derive(Debug)]
pub(super) struct Clock {
    looked: Instant,
    counted: Duration,
}

impl Clock {
    pub fn start() -> Self {
        Self { looked: Instant::now(), counted: Duration::ZERO }
    }

    /// Milliseconds since the start, without those that went by unseen.
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
