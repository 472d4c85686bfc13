//! Information from `/proc` about processes that another program may have started.

use std::path::Path;

use metasense_schemas::wire::WorkerStart;

/// A worker process as seen in `/proc`.
#[derive(Debug, Clone, PartialEq)]
pub struct WorkerProcess {
    /// Process id.
    pub pid: u32,
    /// Slot and generation, as in the log, for example `0.3`.
    pub worker: String,
    /// Process name: the first fifteen bytes of its trial's hash, or `process::IDLE`.
    pub name: String,
    /// The kernel's state letter: R running, S waiting, T stopped, Z ended.
    pub state: char,
    /// CPU time so far (ticks of 10 ms).
    pub ticks: u64,
}

/// The worker processes of a run, sorted by worker.
pub fn workers_of(orchestrator: u32) -> Vec<WorkerProcess> {
    let mut workers: Vec<WorkerProcess> =
        children(orchestrator).into_iter().filter_map(read_process).collect();
    workers.sort_by(|a, b| (a.worker.len(), &a.worker).cmp(&(b.worker.len(), &b.worker)));
    workers
}

/// Process ids of the children of a process.
pub fn children(parent: u32) -> Vec<u32> {
    let Ok(entries) = std::fs::read_dir("/proc") else { return Vec::new() };
    let pids = entries.flatten().filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    pids.filter(|pid| stat(*pid).is_some_and(|stat| stat.parent == parent)).collect()
}

fn read_process(pid: u32) -> Option<WorkerProcess> {
    let line = std::fs::read_to_string(format!("/proc/{pid}/cmdline")).ok()?;
    let mut words = line.split('\0').skip_while(|word| *word != "worker").skip(1);
    let start: WorkerStart = serde_json::from_str(words.next()?).ok()?;
    let worker = Path::new(&start.root).file_name()?.to_str()?.to_owned();
    let Stat { name, state, ticks, .. } = stat(pid)?;
    Some(WorkerProcess { pid, worker, name, state, ticks })
}

/// CPU time of a process so far (s), in steps of 10 ms; `None` if it does not exist.
pub fn cpu_seconds(pid: u32) -> Option<f64> {
    stat(pid).map(|stat| stat.ticks as f64 / 100.0)
}

/// Peak resident memory of a process (MiB); `None` if it does not exist.
pub fn peak_mib(pid: u32) -> Option<f64> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.split_whitespace().next()?.parse::<f64>().ok().map(|kib| kib / 1024.0)
}

/// The kernel's state letter of a process; `None` if it does not exist.
pub fn state(pid: u32) -> Option<char> {
    stat(pid).map(|stat| stat.state)
}

struct Stat {
    name: String,
    state: char,
    parent: u32,
    ticks: u64,
}

/// Parses `/proc/PID/stat`. The name is in parentheses and can itself contain some.
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
