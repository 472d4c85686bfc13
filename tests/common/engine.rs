//! Runs of the engine as real processes, to be killed.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use metasense::link::SHARED_MEMORY;
use metasense::store::Reader;
use rustix::process::{Pid, Signal, kill_process};

/// A run of `bench engine` on a database, in a process of its own. Dropped, it is killed.
pub struct Run {
    pub child: Child,
    pub db: PathBuf,
}

impl Run {
    pub fn start(db: &Path, arguments: &str) -> Self {
        let child = Command::new(env!("CARGO_BIN_EXE_metasense"))
            .args(["bench", "engine", "--db"])
            .arg(db)
            .args(arguments.split_whitespace())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the binary starts");
        Self { child, db: db.to_owned() }
    }

    /// To the end; the exit code.
    pub fn wait(&mut self) -> Option<i32> {
        let ended = eventually(Duration::from_secs(60), || self.child.try_wait().unwrap());
        ended.expect("the run ends within a minute").code()
    }

    pub fn signal(&self, signal: i32) {
        kill(self.child.id(), signal);
    }

    /// Worker processes that live.
    pub fn workers(&self) -> Vec<u32> {
        children(self.child.id())
    }

    /// Waits for `n` worker processes.
    pub fn some_workers(&self, n: usize) -> Vec<u32> {
        eventually(Duration::from_secs(20), || Some(self.workers()).filter(|workers| workers.len() >= n))
            .expect("workers start within 20 s")
    }

    /// Names in shared memory of all runs on this database, as its log has them.
    pub fn places(&self) -> Vec<String> {
        let log = std::fs::read_to_string(self.db.with_extension("log")).unwrap_or_default();
        let names = log.lines().filter_map(|line| line.split_once("place=")).map(|(_, rest)| rest);
        names.map(|rest| rest.split_whitespace().next().unwrap().trim_matches('"').to_owned()).collect()
    }

    /// What of those is still there.
    pub fn leftovers(&self) -> Vec<String> {
        let places = self.places();
        assert!(!places.is_empty(), "the log names no place");
        let there = std::fs::read_dir(SHARED_MEMORY).unwrap().flatten();
        let there = there.map(|entry| entry.file_name().to_string_lossy().into_owned());
        there.filter(|name| places.iter().any(|place| name.starts_with(place))).collect()
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

pub fn kill(pid: u32, signal: i32) {
    let (pid, signal) = (Pid::from_raw(pid as i32).unwrap(), Signal::from_named_raw(signal).unwrap());
    let _ = kill_process(pid, signal);
}

/// Processes whose parent this is, the living ones.
pub fn children(parent: u32) -> Vec<u32> {
    let processes = std::fs::read_dir("/proc").unwrap().flatten();
    let pids = processes.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    pids.filter(|pid| parent_and_state(*pid).is_some_and(|(p, state)| p == parent && state != 'Z')).collect()
}

pub fn is_alive(pid: u32) -> bool {
    parent_and_state(pid).is_some_and(|(_, state)| state != 'Z')
}

fn parent_and_state(pid: u32) -> Option<(u32, char)> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let mut fields = stat.rsplit_once(") ")?.1.split(' ');
    let state = fields.next()?.chars().next()?;
    Some((fields.next()?.parse().ok()?, state))
}

/// Asks until there is an answer, or the time is over.
pub fn eventually<T>(within: Duration, mut ask: impl FnMut() -> Option<T>) -> Option<T> {
    let began = Instant::now();
    loop {
        match ask() {
            Some(answer) => return Some(answer),
            None if began.elapsed() > within => return None,
            None => std::thread::sleep(Duration::from_millis(2)),
        }
    }
}

/// Answers of a database, one text a row.
pub fn rows(db: &Path, sql: &str) -> Vec<String> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let mut reader = Reader::open(db).await.unwrap();
        let table = reader.query(sql).await.unwrap();
        table.rows.iter().map(|row| serde_json::to_string(row).unwrap()).collect()
    })
}

/// Everything that a run's result is: all but times and attempts.
pub fn results(db: &Path) -> Vec<String> {
    [
        "SELECT hash, state, reason, error_initial, error_optimised, holdout_error_initial, holdout_error_optimised,
           best_step, simd, solver, result FROM trial ORDER BY hash",
        "SELECT t.hash, p.step, p.error_test, p.projection, p.outcome, p.fresh_samples
           FROM step p JOIN trial t ON t.id = p.trial_id ORDER BY t.hash, p.step",
        "SELECT t.hash, n.body, n.network, n.error_train, n.error_test, n.error_holdout, n.iterations, n.outcome
           FROM network n JOIN trial t ON t.id = n.trial_id ORDER BY 1, 2, 3",
        "SELECT t.hash, a.name, a.shape, hex(a.bytes)
           FROM artifact a JOIN trial t ON t.id = a.trial_id ORDER BY 1, 2",
        "SELECT count(*) FROM checkpoint",
    ]
    .iter()
    .flat_map(|sql| rows(db, sql))
    .collect()
}
