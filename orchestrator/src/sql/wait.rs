//! Waiting for locks that other programs hold on the database, for instance a backup or an editor with unsaved changes.
//!
//! SQLite calls the busy handler below repeatedly while a lock is held. The handler reports the wait and gives up after a limit. The
//! limit is global because a process has one writer.

use std::ffi::{c_int, c_void};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use libsqlite3_sys as ffi;
use sqlx::sqlite::SqliteConnection;

use crate::say;

/// Default of `run.lock_wait`.
const PATIENCE: Duration = Duration::from_secs(300);
/// Longest wait after a request to stop the run.
const HURRIED: Duration = Duration::from_secs(10);
/// Time between two attempts.
const PAUSE: Duration = Duration::from_millis(50);
/// The wait is reported after this time, and again each time it has doubled.
const SAID: Duration = Duration::from_secs(5);

static LIMIT_MS: AtomicU64 = AtomicU64::new(PATIENCE.as_millis() as u64);
static END_ASKED: OnceLock<Instant> = OnceLock::new();

/// Sets how long the writer waits for a lock.
pub fn wait_for_locks(limit: Duration) {
    LIMIT_MS.store(limit.as_millis() as u64, Ordering::Relaxed);
}

/// Shortens all further waits to a few seconds, because the run is being stopped.
pub fn hurry() {
    END_ASKED.get_or_init(Instant::now);
}

/// Installs the busy handler on a connection.
pub(crate) async fn wait_on(connection: &mut SqliteConnection) -> sqlx::Result<()> {
    let mut handle = connection.lock_handle().await?;
    let (db, data) = (handle.as_raw_handle().as_ptr(), std::ptr::null_mut());
    // SAFETY: the handle is locked and open; the handler has no data of its own.
    unsafe { ffi::sqlite3_busy_handler(db, Some(wait), data) };
    Ok(())
}

/// `tries` counts the previous calls for the same lock.
unsafe extern "C" fn wait(_: *mut c_void, tries: c_int) -> c_int {
    let waited = PAUSE * tries.unsigned_abs();
    let limit = Duration::from_millis(LIMIT_MS.load(Ordering::Relaxed));
    if waited >= limit || END_ASKED.get().is_some_and(|at| at.elapsed() >= HURRIED) {
        let waited = waited.as_secs_f64();
        tracing::error!(waited, "another program still holds a lock on the database; giving up");
        say!("another program has held a lock on the database for {waited:.0} s: giving up (run.lock_wait)");
        return 0;
    }
    let periods = waited.as_millis() / SAID.as_millis();
    if waited.as_millis().is_multiple_of(SAID.as_millis()) && periods.is_power_of_two() {
        let (waited, limit) = (waited.as_secs(), limit.as_secs());
        tracing::warn!(waited, limit, "another program holds a lock on the database; waiting for it");
        say!(
            "another program has held a lock on the database for {waited} s; waiting up to {limit} s (run.lock_wait)"
        );
    }
    std::thread::sleep(PAUSE);
    1
}
