//! Starts, watches and ends worker processes. The operating system reports whether a worker is alive.
//!
//! A worker runs the same program (`/proc/self/exe`), so that both are always the same build. It is killed when the *thread*
//! that started it ends: call `Fleet::spawn` from a thread that lives as long as the run.

use std::collections::HashMap;
use std::os::unix::process::ExitStatusExt;
use std::path::PathBuf;
use std::pin::pin;
use std::process::{ExitStatus, Stdio};
use std::time::Duration;

use metasense_schemas::reason::Reason;
use metasense_schemas::wire::WorkerStart;
use metasense_worker::{limits, process};
use rustix::process::{Pid, Signal, kill_process};
use tokio::io::{AsyncBufReadExt, AsyncRead, BufReader};
use tokio::process::{Child, ChildStdin, Command};
use tokio::sync::mpsc::Sender;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio::time::timeout;

use crate::processes;
use crate::scheduler::WorkerId;

/// Starts, watches and ends worker processes.
#[derive(Debug)]
pub struct Fleet {
    program: PathBuf,
    processes: HashMap<WorkerId, Process>,
    heard: Sender<(WorkerId, ProcessEvent)>,
}

/// An event of a worker process.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ProcessEvent {
    /// A line on its standard error.
    Line(String),
    /// It has ended; no more lines follow.
    End(Reason),
}

/// Longest wait for the last lines of an ended process: its child processes may keep standard error open.
const LINES_GRACE: Duration = Duration::from_millis(300);
/// Longest wait for a killed process: one that waits for a disk or a device ends only when that responds.
const UNKILLABLE: Duration = Duration::from_secs(5);

#[derive(Debug)]
struct Process {
    pid: u32,
    /// Closing this tells the worker to end.
    input: Option<ChildStdin>,
    kill: Option<oneshot::Sender<()>>,
}

impl Fleet {
    /// `program` must have the hidden subcommand `worker`.
    pub fn new(program: PathBuf, heard: Sender<(WorkerId, ProcessEvent)>) -> Self {
        Self { program, processes: HashMap::new(), heard }
    }

    /// Starts a worker process.
    pub fn spawn(&mut self, worker: WorkerId, start: &WorkerStart) -> std::io::Result<()> {
        let argument = serde_json::to_string(start).expect("strings and numbers are JSON");
        let mut command = Command::new(&self.program);
        command.arg("worker").arg(argument).kill_on_drop(true);
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn()?;
        let errors = child.stderr.take().expect("it is piped");
        let lines = tokio::spawn(pass_on(worker, errors, self.heard.clone()));
        let (kill, killed) = oneshot::channel();
        let pid = child.id().unwrap_or_default();
        tracing::info!(%worker, pid, "worker started");
        self.processes.insert(worker, Process { pid, input: child.stdin.take(), kill: Some(kill) });
        let before = limits::killed_for_memory();
        tokio::spawn(watch(worker, child, lines, killed, before, self.heard.clone()));
        Ok(())
    }

    /// Ends a process in order by closing its input.
    pub fn close(&mut self, worker: WorkerId) {
        if let Some(process) = self.processes.get_mut(&worker) {
            process.input = None;
        }
    }

    /// Kills a process.
    pub fn kill(&mut self, worker: WorkerId) {
        if let Some(kill) = self.processes.get_mut(&worker).and_then(|process| process.kill.take()) {
            let _ = kill.send(());
        }
    }

    /// Removes a process that has ended from the table.
    pub fn forget(&mut self, worker: WorkerId) {
        self.processes.remove(&worker);
    }

    /// CPU seconds that all threads of a worker have used so far.
    pub fn cpu_seconds(&self, worker: WorkerId) -> Option<f64> {
        processes::cpu_seconds(self.processes.get(&worker)?.pid)
    }
}

async fn watch(
    worker: WorkerId,
    mut child: Child,
    mut lines: JoinHandle<bool>,
    mut killed: oneshot::Receiver<()>,
    killed_before: u64,
    heard: Sender<(WorkerId, ProcessEvent)>,
) {
    let pid = child.id().unwrap_or_default();
    // The pid stays valid until `wait` returns, as the process is not reaped before.
    let kill = || Pid::from_raw(pid as i32).map(|pid| kill_process(pid, Signal::KILL));
    let status = end(child.wait(), &mut killed, kill, UNKILLABLE).await;
    let mut out_of_memory = matches!(timeout(LINES_GRACE, &mut lines).await, Ok(Ok(true)));
    lines.abort();
    out_of_memory |= limits::killed_for_memory() > killed_before;
    let reason = match status {
        Some(status) => reason(status, out_of_memory),
        None => {
            let state = processes::state(pid).map_or(String::new(), |state| format!(" (state {state})"));
            tracing::error!(%worker, pid, "the killed process does not end{state}, because it waits for a disk or device; the run continues without it");
            Reason::WorkerKilled(libc::SIGKILL)
        }
    };
    let _ = heard.send((worker, ProcessEvent::End(reason))).await;
}

/// Waits for a process to end by itself or by `kill` on request. `None`: it did not end `within` this time after the kill.
async fn end<T, K>(
    wait: impl Future<Output = T>,
    killed: &mut oneshot::Receiver<()>,
    kill: impl FnOnce() -> K,
    within: Duration,
) -> Option<T> {
    let mut wait = pin!(wait);
    tokio::select! {
        status = &mut wait => return Some(status),
        _ = killed => drop(kill()),
    }
    timeout(within, wait).await.ok()
}

fn reason(status: std::io::Result<ExitStatus>, out_of_memory: bool) -> Reason {
    let (signal, code) = status.map_or((None, None), |status| (status.signal(), status.code()));
    match (signal, code) {
        (Some(libc::SIGABRT | libc::SIGKILL), _) if out_of_memory => Reason::OutOfMemory,
        (_, Some(process::SHORT)) => Reason::Shortage,
        // A page of shared memory could not be allocated.
        (Some(libc::SIGBUS), _) | (_, Some(process::NO_ROOM)) => Reason::SharedMemoryFull,
        (Some(signal), _) => Reason::WorkerKilled(signal),
        (None, code) => Reason::WorkerExited(code.unwrap_or(-1)),
    }
}

/// Start of the standard library's message before it aborts for lack of memory.
const OUT_OF_MEMORY: &[u8] = b"memory allocation of ";

/// Largest number of bytes per line and of lines per worker that are forwarded; the rest is read and discarded.
const LINE: usize = 4096;
const LINES: usize = 1000;

/// Forwards a worker's standard error to the log and to `heard`. Reads everything, so that the worker never blocks. Returns
/// whether the worker ran out of memory.
async fn pass_on(
    worker: WorkerId,
    errors: impl AsyncRead + Unpin,
    heard: Sender<(WorkerId, ProcessEvent)>,
) -> bool {
    let (mut errors, mut line) = (BufReader::new(errors), Vec::new());
    let (mut lines, mut out_of_memory) = (0, false);
    while let Ok(read) = errors.fill_buf().await {
        let (end, at) = (read.is_empty(), read.iter().position(|byte| *byte == b'\n'));
        let text = &read[..at.unwrap_or(read.len())];
        line.extend_from_slice(&text[..text.len().min(LINE.saturating_sub(line.len()))]);
        let used = text.len() + usize::from(at.is_some());
        errors.consume(used);
        if at.is_some() || end && !line.is_empty() {
            out_of_memory |= line.starts_with(OUT_OF_MEMORY);
            lines += 1;
            let text = match lines {
                ..LINES => {
                    String::from_utf8_lossy(line.trim_ascii_end()).replace(char::is_control, "\u{fffd}")
                }
                _ => "later output of the worker is not kept".to_owned(),
            };
            line.clear();
            if lines <= LINES {
                tracing::warn!(%worker, "worker output: {text}");
                if heard.send((worker, ProcessEvent::Line(text))).await.is_err() {
                    break;
                }
            }
        }
        if end {
            break;
        }
    }
    out_of_memory
}

#[cfg(test)]
mod tests;
