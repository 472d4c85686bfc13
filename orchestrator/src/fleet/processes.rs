//! What `/proc` says of processes that somebody else may have started.

use std::path::Path;

use metasense_schemas::wire::Start;

/// A worker process, seen from outside.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// Its process id.
    pub pid: u32,
    /// Slot and generation, as in the log: `0.3`.
    pub worker: String,
    /// What it calls itself: the first fifteen bytes of its trial's hash, or `process::IDLE`.
    pub name: String,
    /// The kernel's letter: R runs, S waits, T is stopped, Z has ended.
    pub state: char,
    /// CPU time so far, in ticks of a hundredth of a second.
    pub ticks: u64,
}

/// The worker processes of a run, in order.
#[must_use]
pub fn workers_of(orchestrator: u32) -> Vec<Seen> {
    let mut workers: Vec<Seen> = children(orchestrator).into_iter().filter_map(seen).collect();
    workers.sort_by(|a, b| (a.worker.len(), &a.worker).cmp(&(b.worker.len(), &b.worker)));
    workers
}

/// Process ids whose parent this is.
#[must_use]
pub fn children(parent: u32) -> Vec<u32> {
    let Ok(entries) = std::fs::read_dir("/proc") else { return Vec::new() };
    let pids = entries.flatten().filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    pids.filter(|pid| stat(*pid).is_some_and(|stat| stat.parent == parent)).collect()
}

fn seen(pid: u32) -> Option<Seen> {
    let line = std::fs::read_to_string(format!("/proc/{pid}/cmdline")).ok()?;
    let mut words = line.split('\0').skip_while(|word| *word != "worker").skip(1);
    let start: Start = serde_json::from_str(words.next()?).ok()?;
    let worker = Path::new(&start.root).file_name()?.to_str()?.to_owned();
    let Stat { name, state, ticks, .. } = stat(pid)?;
    Some(Seen { pid, worker, name, state, ticks })
}

/// CPU time of a process so far (s), to a hundredth; `None` once it is gone.
#[must_use]
pub fn cpu_seconds(pid: u32) -> Option<f64> {
    stat(pid).map(|stat| stat.ticks as f64 / 100.0)
}

/// The most memory that a process has had resident (MiB); `None` once it is gone.
#[must_use]
pub fn peak_mib(pid: u32) -> Option<f64> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.split_whitespace().next()?.parse::<f64>().ok().map(|kib| kib / 1024.0)
}

/// The kernel's letter for what a process does; `None` once it is gone.
#[must_use]
pub fn state(pid: u32) -> Option<char> {
    stat(pid).map(|stat| stat.state)
}

struct Stat {
    name: String,
    state: char,
    parent: u32,
    ticks: u64,
}

/// `/proc/PID/stat`: the name stands in parentheses and may hold any.
fn stat(pid: u32) -> Option<Stat> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let (head, tail) = text.rsplit_once(") ")?;
    let fields: Vec<&str> = tail.split(' ').collect();
    Some(Stat {
        name: head.split_once('(')?.1.to_owned(),
        state: fields.first()?.chars().next()?,
        parent: fields.get(1)?.parse().ok()?,
        ticks: fields.get(11)?.parse::<u64>().ok()? + fields.get(12)?.parse::<u64>().ok()?,
    })
}
