//! SIGINT, SIGTERM and SIGHUP as messages: a person wants the end. Under `nohup` SIGHUP is none.

use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::mpsc;

use super::EngineError;
use crate::store::hurry;

/// Signals since it was made; none of them ends the process any more.
#[derive(Debug)]
pub struct Signals(mpsc::Receiver<()>);

impl Signals {
    /// From here on, signals are messages; a hangup that whoever started us has had ignored stays ignored.
    ///
    /// # Errors
    /// If the system does not let us wait for them.
    pub fn new() -> Result<Self, EngineError> {
        let (out, signals) = mpsc::channel(4);
        let hangup = Some(SignalKind::hangup()).filter(|_| !ignores_hangup());
        for kind in [SignalKind::interrupt(), SignalKind::terminate()].into_iter().chain(hangup) {
            let (mut signal, out) = (signal(kind).map_err(EngineError::Signals)?, out.clone());
            tokio::spawn(async move { while signal.recv().await.is_some() && out.send(()).await.is_ok() {} });
        }
        Ok(Self(signals))
    }

    /// The next one.
    pub(super) async fn next(&mut self) -> Option<()> {
        let next = self.0.recv().await;
        hurry();
        next
    }

    /// Does `work`, unless a signal comes first: then it is dropped where it stands, and this is `None`.
    pub async fn unless<T>(&mut self, work: impl Future<Output = T>) -> Option<T> {
        tokio::select! {
            biased;
            Some(()) = self.next() => None,
            done = work => Some(done),
        }
    }
}

/// Whether this process ignores SIGHUP, the first bit of what the system says.
pub fn ignores_hangup() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    ignored.is_some_and(|mask| mask.trim().ends_with(['1', '3', '5', '7', '9', 'b', 'd', 'f']))
}
