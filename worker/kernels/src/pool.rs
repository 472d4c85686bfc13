//! The threads that work, the instruction set of their kernels, and a count of what they have done.
//!
//! Whoever computes is given a pool: nothing about how is kept by the process.

use crate::simd::Width;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Signs of life: a count of pieces of some milliseconds: an interval of eight samples, a chunk of an iteration, a factor.
/// Whoever sees it stand still for long looks at a hang. Clones count together; nothing is computed from it.
#[derive(Debug, Clone, Default)]
pub struct Heartbeat(Arc<AtomicU64>);

impl Heartbeat {
    /// Another piece is done.
    #[inline]
    pub fn beat(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    /// Pieces done so far.
    pub fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// Threads and how they work. Clones share them.
#[derive(Debug, Clone)]
pub struct Pool {
    threads: Arc<rayon::ThreadPool>,
    width: Width,
    heartbeat: Heartbeat,
}

impl Pool {
    /// So many threads, the widest kernels that the machine has.
    ///
    /// # Errors
    /// If the system does not start them.
    pub fn new(threads: usize) -> Result<Self, rayon::ThreadPoolBuildError> {
        Self::with(threads, Width::detect(), Heartbeat::default())
    }

    /// So many threads with the kernels of this instruction set, counting there.
    ///
    /// # Errors
    /// If the system does not start them.
    ///
    /// # Panics
    /// If the machine lacks it.
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

    /// The count.
    pub fn heartbeat(&self) -> &Heartbeat {
        &self.heartbeat
    }

    /// How many threads.
    pub fn threads(&self) -> usize {
        self.threads.current_num_threads()
    }

    /// Runs on the threads: rayon's iterators in `work` spread over them.
    pub fn install<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        self.threads.install(work)
    }

    /// Runs on every thread at once.
    pub fn broadcast<R: Send>(&self, work: impl Fn() -> R + Sync) -> Vec<R> {
        self.threads.broadcast(|_| work())
    }
}
