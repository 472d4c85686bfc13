//! Receives SIGINT, SIGTERM and SIGHUP as requests to stop. SIGHUP is ignored under `nohup`.

use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::mpsc;

use crate::sql::hurry;

/// Signals cannot be received.
#[derive(Debug, thiserror::Error)]
#[error("cannot wait for signals")]
pub struct SignalError(#[from] std::io::Error);

/// A stream of signals. While it exists, and after, signals do not end the process.
#[derive(Debug)]
pub struct Signals(mpsc::Receiver<()>);

impl Signals {
    /// Starts receiving signals. SIGHUP stays ignored if it is ignored at the start.
    ///
    /// # Errors
    /// If the system cannot deliver signals.
    pub fn new() -> Result<Self, SignalError> {
        let (out, signals) = mpsc::channel(4);
        let hangup = Some(SignalKind::hangup()).filter(|_| !ignores_hangup());
        for kind in [SignalKind::interrupt(), SignalKind::terminate()].into_iter().chain(hangup) {
            let (mut signal, out) = (signal(kind)?, out.clone());
            tokio::spawn(async move { while signal.recv().await.is_some() && out.send(()).await.is_ok() {} });
        }
        Ok(Self(signals))
    }

    /// The next signal.
    pub(crate) async fn next(&mut self) -> Option<()> {
        let next = self.0.recv().await;
        hurry();
        next
    }

    /// Runs `work`; drops it and returns `None` if a signal comes first.
    pub async fn or_signal<T>(&mut self, work: impl Future<Output = T>) -> Option<T> {
        tokio::select! {
            biased;
            Some(()) = self.next() => None,
            done = work => Some(done),
        }
    }
}

/// Whether this process ignores SIGHUP: bit 0 of the `SigIgn` mask.
pub fn ignores_hangup() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    ignored.is_some_and(|mask| mask.trim().ends_with(['1', '3', '5', '7', '9', 'b', 'd', 'f']))
}
