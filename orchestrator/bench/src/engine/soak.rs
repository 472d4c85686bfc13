//! Observes a long run: kills workers at random and reports memory.

use std::time::Duration;

use metasense::engine::{View, Watch};
use metasense::plan::Trial;
use metasense::print_line;
use metasense::processes::children;
use metasense_schemas::record::TrialResult;
use rustix::process::{Pid, Signal, getpid, kill_process};
use serde_json::json;

/// Mean time between kills.
const KILL_EVERY: Duration = Duration::from_secs(2);
/// Time between rows.
const ROW_EVERY: Duration = Duration::from_secs(60);

/// Kills workers at random, prints a row per minute, and stops the run after its duration.
#[derive(Debug)]
pub struct Soak {
    length: Duration,
    next_kill: Duration,
    next_row: Duration,
    kills: u64,
    done: u64,
    dice: u64,
    over: bool,
}

impl Soak {
    pub fn new(minutes: f64) -> Self {
        Self {
            length: Duration::from_secs_f64(60.0 * minutes),
            next_kill: KILL_EVERY,
            next_row: Duration::from_secs(5),
            kills: 0,
            done: 0,
            dice: u64::from(std::process::id()),
            over: false,
        }
    }

    fn roll(&mut self, n: u64) -> u64 {
        self.dice = self.dice.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.dice >> 33) % n
    }

    fn row(&self, elapsed: Duration) {
        let row = json!({
            "bench": "soak",
            "minutes": elapsed.as_secs_f64() / 60.0,
            "resident_mib": resident_mib(),
            "open_files": std::fs::read_dir("/proc/self/fd").map_or(0, Iterator::count),
            "threads": std::fs::read_dir("/proc/self/task").map_or(0, Iterator::count),
            "kills": self.kills,
            "trials": self.done,
        });
        // Ignore errors: only the last row matters.
        let _ = print_line!("{row}");
    }
}

impl Watch for Soak {
    fn done(&mut self, _: &Trial, _: &TrialResult) {
        self.done += 1;
    }

    fn tick(&mut self, view: &View) {
        if view.elapsed >= self.next_kill && !self.over {
            self.next_kill =
                view.elapsed + Duration::from_millis(self.roll(2 * KILL_EVERY.as_millis() as u64));
            let workers = children(std::process::id());
            if !workers.is_empty() {
                let pid = workers[self.roll(workers.len() as u64) as usize];
                if let Some(pid) = Pid::from_raw(pid as i32) {
                    let _ = kill_process(pid, Signal::KILL);
                }
                self.kills += 1;
            }
        }
        if view.elapsed >= self.next_row {
            self.next_row += ROW_EVERY;
            self.row(view.elapsed);
        }
        if view.elapsed >= self.length && !self.over {
            self.over = true;
            self.row(view.elapsed);
            // As Ctrl-C
            let _ = kill_process(getpid(), Signal::INT);
        }
    }
}

/// Resident memory of this process (MiB).
fn resident_mib() -> f64 {
    let statm = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let pages: f64 = statm.split(' ').nth(1).and_then(|pages| pages.parse().ok()).unwrap_or(f64::NAN);
    pages * rustix::param::page_size() as f64 / f64::from(1 << 20)
}
