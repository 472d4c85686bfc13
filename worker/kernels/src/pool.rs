//! Worker threads, the instruction set of their kernels, and a counter of completed work.
//!
//! Functions receive a pool as an argument; there is no global state.

use crate::simd::Width;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Counts completed pieces of work, each of a few milliseconds: an interval of eight samples, a chunk of an iteration, a
/// factorisation. A counter that stands still for long indicates a hang. Clones share the counter; no result depends on
/// it.
#[derive(Debug, Clone, Default)]
pub struct Heartbeat(Arc<AtomicU64>);

impl Heartbeat {
    /// Counts one completed piece.
    #[inline]
    pub fn beat(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    /// Number of pieces completed so far.
    pub fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// Threads, instruction set and heartbeat. Clones share the threads.
#[derive(Debug, Clone)]
pub struct Pool {
    threads: Arc<rayon::ThreadPool>,
    width: Width,
    heartbeat: Heartbeat,
}

impl Pool {
    /// Creates a pool of `threads` threads with the widest supported kernels.
    ///
    /// # Errors
    /// If the system cannot start the threads.
    pub fn new(threads: usize) -> Result<Self, rayon::ThreadPoolBuildError> {
        Self::with(threads, Width::detect(), Heartbeat::default())
    }

    /// Creates a pool of `threads` threads with the kernels of `width`, counting in `heartbeat`.
    ///
    /// # Errors
    /// If the system cannot start the threads.
    ///
    /// # Panics
    /// If the machine does not support `width`.
    pub fn with(
        threads: usize,
        width: Width,
        heartbeat: Heartbeat,
    ) -> Result<Self, rayon::ThreadPoolBuildError> {
        width.check();
        let threads = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        Ok(Self { threads: Arc::new(threads), width, heartbeat })
    }

    /// The instruction set of the kernels.
    pub fn width(&self) -> Width {
        self.width
    }

    /// The counter of completed work.
    pub fn heartbeat(&self) -> &Heartbeat {
        &self.heartbeat
    }

    /// Number of threads.
    pub fn threads(&self) -> usize {
        self.threads.current_num_threads()
    }

    /// Runs `work` in the pool: its rayon iterators use these threads.
    pub fn install<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        self.threads.install(work)
    }

    /// Runs `work` once on every thread and returns all results.
    pub fn broadcast<R: Send>(&self, work: impl Fn() -> R + Sync) -> Vec<R> {
        self.threads.broadcast(|_| work())
    }
}
