//! CPU seconds of attempts, measured from the processes of their workers. They include set-up, repeated steps and the work of
//! killed workers.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use metasense_schemas::wire::Lease;

use crate::fleet::Fleet;
use crate::scheduler::WorkerId;

/// Time between two measurements: at most this much of a killed process is lost.
const LOOK: Duration = Duration::from_secs(1);
/// Longest time between two records: at most this much is lost if this process is killed.
const RECORD: Duration = Duration::from_secs(10);

#[derive(Debug)]
struct AttemptCpu {
    worker: WorkerId,
    /// CPU seconds of the process when it got the trial.
    before: f64,
    seconds: f64,
    recorded: f64,
}

/// CPU seconds of the attempts in progress.
#[derive(Debug)]
pub(super) struct Ledger {
    attempts: HashMap<Lease, AttemptCpu>,
    /// Attempts whose seconds must be recorded.
    pub due: Vec<Lease>,
    looked: Instant,
    recorded: Instant,
}

impl Ledger {
    pub fn new() -> Self {
        Self { attempts: HashMap::new(), due: Vec::new(), looked: Instant::now(), recorded: Instant::now() }
    }

    pub fn begin(&mut self, lease: Lease, worker: WorkerId, fleet: &Fleet) {
        let before = fleet.cpu_seconds(worker).unwrap_or(0.0);
        self.attempts.insert(lease, AttemptCpu { worker, before, seconds: 0.0, recorded: 0.0 });
    }

    pub fn end(&mut self, lease: Lease) {
        self.attempts.remove(&lease);
    }

    /// CPU seconds of an attempt so far, if they have grown since the last call.
    pub fn grown_seconds(&mut self, lease: Lease, fleet: &Fleet) -> Option<f64> {
        let spent = self.attempts.get_mut(&lease)?;
        spent.look(fleet);
        let before = std::mem::replace(&mut spent.recorded, spent.seconds);
        (spent.seconds > before).then_some(spent.seconds)
    }

    /// Measures all processes every `LOOK`; all attempts are due every `RECORD`.
    pub fn tick(&mut self, fleet: &Fleet) {
        if self.looked.elapsed() >= LOOK {
            self.looked = Instant::now();
            self.attempts.values_mut().for_each(|spent| spent.look(fleet));
        }
        if self.due.is_empty() && self.recorded.elapsed() >= RECORD {
            self.recorded = Instant::now();
            self.due = self.attempts.keys().copied().collect();
        }
    }
}

impl AttemptCpu {
    fn look(&mut self, fleet: &Fleet) {
        if let Some(now) = fleet.cpu_seconds(self.worker) {
            self.seconds = self.seconds.max(now - self.before);
        }
    }
}
