//! CPU seconds of attempts, by what the system says of their workers' processes: set-up, steps that are done again and what a
//! killed worker has done count like all else.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use metasense_schemas::wire::Lease;

use crate::fleet::Fleet;
use crate::scheduler::WorkerId;

/// Time between two looks at a process: what is not seen of one that is killed.
const LOOK: Duration = Duration::from_secs(1);
/// Time between two records where nothing else is recorded: what is not known if this process is killed.
const RECORD: Duration = Duration::from_secs(10);

#[derive(Debug)]
struct Spent {
    worker: WorkerId,
    /// The process's when it was given the trial.
    before: f64,
    seconds: f64,
    recorded: f64,
}

/// Those of the attempts in progress.
#[derive(Debug)]
pub(super) struct Ledger {
    attempts: HashMap<Lease, Spent>,
    looked: Instant,
    recorded: Instant,
}

impl Ledger {
    pub fn new() -> Self {
        Self { attempts: HashMap::new(), looked: Instant::now(), recorded: Instant::now() }
    }

    pub fn begin(&mut self, lease: Lease, worker: WorkerId, fleet: &Fleet) {
        let before = fleet.cpu_seconds(worker).unwrap_or(0.0);
        self.attempts.insert(lease, Spent { worker, before, seconds: 0.0, recorded: 0.0 });
    }

    pub fn end(&mut self, lease: Lease) {
        self.attempts.remove(&lease);
    }

    /// The seconds of an attempt until now, if there are more than when they were asked for last.
    pub fn more(&mut self, lease: Lease, fleet: &Fleet) -> Option<f64> {
        let spent = self.attempts.get_mut(&lease)?;
        spent.look(fleet);
        let before = std::mem::replace(&mut spent.recorded, spent.seconds);
        (spent.seconds > before).then_some(spent.seconds)
    }

    /// Looks at all processes from time to time; from time to time, the attempts whose seconds are to be recorded.
    pub fn tick(&mut self, fleet: &Fleet) -> Vec<Lease> {
        if self.looked.elapsed() >= LOOK {
            self.looked = Instant::now();
            self.attempts.values_mut().for_each(|spent| spent.look(fleet));
        }
        if self.recorded.elapsed() < RECORD {
            return Vec::new();
        }
        self.recorded = Instant::now();
        self.attempts.keys().copied().collect()
    }
}

impl Spent {
    fn look(&mut self, fleet: &Fleet) {
        if let Some(now) = fleet.cpu_seconds(self.worker) {
            self.seconds = self.seconds.max(now - self.before);
        }
    }
}
