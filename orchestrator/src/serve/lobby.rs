//! Connections. Those that have shown the key keep a place. Others may stay briefly; if there are too many, the oldest must leave,
//! so that they cannot keep out users with the key.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::AbortHandle;
use tokio::time::{Instant, sleep};

/// Maximum number of connections without the key.
const STRANGERS: usize = 256;
/// Time in which a connection must show the key, of which `GRACE` is guaranteed.
pub const STAY: Duration = Duration::from_secs(3);
const GRACE: Duration = Duration::from_millis(200);
/// Maximum number of connections with the key.
const KNOWN: usize = 64;

#[derive(Debug)]
pub struct ConnectionLimiter {
    /// Connections without the key, the oldest first.
    strangers: Mutex<VecDeque<KeylessConnection>>,
    places: Arc<Semaphore>,
}

#[derive(Debug)]
struct KeylessConnection {
    number: u64,
    since: Instant,
    task: AbortHandle,
}

#[derive(Debug)]
pub struct ClientConnection {
    number: u64,
    lobby: Arc<ConnectionLimiter>,
    place: OnceLock<OwnedSemaphorePermit>,
}

impl ConnectionLimiter {
    pub fn new() -> Arc<Self> {
        Arc::new(Self { strangers: Mutex::default(), places: Arc::new(Semaphore::new(KNOWN)) })
    }

    /// Waits for room, then spawns the task that `serve` returns.
    pub async fn admit<T>(self: &Arc<Self>, number: u64, serve: impl FnOnce(Arc<ClientConnection>) -> T)
    where
        T: Future<Output = ()> + Send + 'static,
    {
        while let Some(left) = self.crowded() {
            sleep(left).await;
        }
        let guest = Arc::new(ClientConnection { number, lobby: Arc::clone(self), place: OnceLock::new() });
        // locked, so that the task cannot end before it is in the list
        let mut strangers = self.strangers();
        let task = tokio::spawn(serve(guest)).abort_handle();
        strangers.push_back(KeylessConnection { number, since: Instant::now(), task });
    }

    /// Makes room by closing the oldest connection without the key; or returns the rest of its guaranteed time.
    fn crowded(&self) -> Option<Duration> {
        let mut strangers = self.strangers();
        if strangers.len() < STRANGERS {
            return None;
        }
        let left = GRACE.saturating_sub(strangers.front()?.since.elapsed());
        if left.is_zero() {
            strangers.pop_front()?.task.abort();
            return None;
        }
        Some(left)
    }

    fn forget(&self, number: u64) {
        let mut strangers = self.strangers();
        if let Ok(at) = strangers.binary_search_by_key(&number, |stranger| stranger.number) {
            strangers.remove(at);
        }
    }

    fn strangers(&self) -> MutexGuard<'_, VecDeque<KeylessConnection>> {
        self.strangers.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl ClientConnection {
    /// Called when the key has been shown: returns whether there is a place for the connection.
    pub fn take_place(&self) -> bool {
        if self.is_known() {
            return true;
        }
        let Ok(place) = Arc::clone(&self.lobby.places).try_acquire_owned() else { return false };
        self.lobby.forget(self.number);
        let _ = self.place.set(place);
        true
    }

    /// Whether the key has been shown.
    pub fn is_known(&self) -> bool {
        self.place.get().is_some()
    }
}

impl Drop for ClientConnection {
    fn drop(&mut self) {
        self.lobby.forget(self.number);
    }
}
