//! Connections. Those that have shown the key keep a place. All others may stay for a moment only, and the oldest of them leaves
//! when there are too many: they cannot keep out somebody who has the key.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::AbortHandle;
use tokio::time::{Instant, sleep};

/// Connections without the key at a time.
const STRANGERS: usize = 256;
/// The time that each of them has to show the key, and the part of it that it has in any case.
pub const STAY: Duration = Duration::from_secs(3);
const GRACE: Duration = Duration::from_millis(200);
/// Connections with the key at a time.
const KNOWN: usize = 64;

/// All connections.
#[derive(Debug)]
pub struct Lobby {
    /// Those without the key, the oldest first.
    strangers: Mutex<VecDeque<Stranger>>,
    places: Arc<Semaphore>,
}

#[derive(Debug)]
struct Stranger {
    number: u64,
    since: Instant,
    task: AbortHandle,
}

/// A connection.
#[derive(Debug)]
pub struct Guest {
    number: u64,
    lobby: Arc<Lobby>,
    place: OnceLock<OwnedSemaphorePermit>,
}

impl Lobby {
    /// An empty one.
    pub fn new() -> Arc<Self> {
        Arc::new(Self { strangers: Mutex::default(), places: Arc::new(Semaphore::new(KNOWN)) })
    }

    /// Serves a connection by the task that `serve` makes of it, once there is room for it.
    pub async fn admit<T>(self: &Arc<Self>, number: u64, serve: impl FnOnce(Arc<Guest>) -> T)
    where
        T: Future<Output = ()> + Send + 'static,
    {
        while let Some(left) = self.crowded() {
            sleep(left).await;
        }
        let guest = Arc::new(Guest { number, lobby: Arc::clone(self), place: OnceLock::new() });
        // the task cannot leave before it is on the list
        let mut strangers = self.strangers();
        let task = tokio::spawn(serve(guest)).abort_handle();
        strangers.push_back(Stranger { number, since: Instant::now(), task });
    }

    /// Makes room by the oldest stranger; where even that has not had its time yet, how much of it is left.
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

    fn strangers(&self) -> MutexGuard<'_, VecDeque<Stranger>> {
        self.strangers.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Guest {
    /// The key has been shown: whether there is a place for it to stay.
    pub fn stays(&self) -> bool {
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

impl Drop for Guest {
    fn drop(&mut self) {
        self.lobby.forget(self.number);
    }
}
