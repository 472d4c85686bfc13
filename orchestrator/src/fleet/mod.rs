//! Worker processes: started, watched and ended. Whether one is alive is what the operating system says.
//!
//! A worker is this program again (`/proc/self/exe`), so that both are always the same build. It dies with the
//! *thread* that started it: `Fleet::spawn` is to be called from one that lives as long as the run.

mod processes;

use std::collections::HashMap;
use std::os::unix::process::ExitStatusExt;
use std::path::PathBuf;
use std::process::{ExitStatus, Stdio};

use metasense_schemas::wire::Start;
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::process::{Child, ChildStderr, ChildStdin, Command};
use tokio::sync::mpsc::Sender;
use tokio::sync::oneshot;

pub use processes::{Seen, children, workers_of};

use crate::scheduler::{Reason, WorkerId};

/// Starts, watches and ends worker processes.
#[derive(Debug)]
pub struct Fleet {
    program: PathBuf,
    processes: HashMap<WorkerId, Process>,
    ended: Sender<(WorkerId, Reason)>,
}

#[derive(Debug)]
struct Process {
    pid: u32,
    /// Its end is the sign for the worker to end.
    input: Option<ChildStdin>,
    kill: Option<oneshot::Sender<()>>,
}

impl Fleet {
    /// `program` is asked for its hidden subcommand `worker`; ends of processes go to `ended`.
    pub fn new(program: PathBuf, ended: Sender<(WorkerId, Reason)>) -> Self {
        Self { program, processes: HashMap::new(), ended }
    }

    /// Starts a process.
    ///
    /// # Errors
    /// If the system does not.
    pub fn spawn(&mut self, worker: WorkerId, start: &Start) -> std::io::Result<()> {
        let argument = serde_json::to_string(start).expect("strings and numbers are JSON");
        let mut child = Command::new(&self.program)
            .arg("worker")
            .arg(argument)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .kill_on_drop(true)
            .spawn()?;
        if let Some(errors) = child.stderr.take() {
            tokio::spawn(log_errors(worker, errors));
        }
        let (kill, killed) = oneshot::channel();
        let pid = child.id().unwrap_or_default();
        tracing::info!(%worker, pid, "worker started");
        self.processes.insert(worker, Process { pid, input: child.stdin.take(), kill: Some(kill) });
        tokio::spawn(watch(worker, child, killed, self.ended.clone()));
        Ok(())
    }

    /// Ends a process in order: it sees the end of its input.
    pub fn close(&mut self, worker: WorkerId) {
        if let Some(process) = self.processes.get_mut(&worker) {
            process.input = None;
        }
    }

    /// Ends a process at once.
    pub fn kill(&mut self, worker: WorkerId) {
        if let Some(kill) = self.processes.get_mut(&worker).and_then(|process| process.kill.take()) {
            let _ = kill.send(());
        }
    }

    /// Forgets a process that has ended.
    pub fn forget(&mut self, worker: WorkerId) {
        self.processes.remove(&worker);
    }

    /// Process id of a worker that has not been forgotten.
    pub fn pid(&self, worker: WorkerId) -> Option<u32> {
        self.processes.get(&worker).map(|process| process.pid)
    }
}

async fn watch(
    worker: WorkerId,
    mut child: Child,
    mut killed: oneshot::Receiver<()>,
    ended: Sender<(WorkerId, Reason)>,
) {
    let status = tokio::select! {
        status = child.wait() => status,
        _ = &mut killed => {
            let _ = child.start_kill();
            child.wait().await
        }
    };
    let _ = ended.send((worker, reason(status))).await;
}

fn reason(status: std::io::Result<ExitStatus>) -> Reason {
    match status {
        Ok(status) => match status.signal() {
            Some(signal) => Reason::WorkerKilled(signal),
            None => Reason::WorkerExited(status.code().unwrap_or(-1)),
        },
        Err(_) => Reason::WorkerExited(-1),
    }
}

/// What a worker writes to its standard error goes to the log.
async fn log_errors(worker: WorkerId, errors: ChildStderr) {
    let mut lines = BufReader::new(errors).lines();
    while let Ok(Some(line)) = lines.next_line().await {
        tracing::warn!(%worker, "worker says: {line}");
    }
}
