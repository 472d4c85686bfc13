//! Signs of life: how much has been done in this process, in pieces of some milliseconds: an interval of eight samples, a chunk of
//! an iteration, a factor. Whoever sees the count stand still for long looks at a hang. Nothing is computed from it.

use std::sync::atomic::{AtomicU64, Ordering};

static DONE: AtomicU64 = AtomicU64::new(0);

/// Another piece is done.
#[inline]
pub fn beat() {
    DONE.fetch_add(1, Ordering::Relaxed);
}

/// Pieces done so far.
pub fn count() -> u64 {
    DONE.load(Ordering::Relaxed)
}
