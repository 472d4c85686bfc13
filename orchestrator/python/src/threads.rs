//! Threads, and what has threads, in processes that fork. A forked process has memory, but none of its parent's threads.

use std::mem::forget;
use std::process::id;
use std::sync::{Arc, Mutex};

use metasense_worker::run::{Pool, pool};
use pyo3::prelude::*;

use crate::arrays::whole;
use crate::raised;

/// The most threads that a body may have, as on the command line.
const MOST: u64 = 1024;

/// A value that is of use only in the process that made it, and is made anew in a forked one.
pub struct PerProcess<T>(Mutex<Made<T>>);

struct Made<T> {
    process: u32,
    /// `None` while it is dropped.
    value: Option<T>,
}

impl<T: Clone> PerProcess<T> {
    pub fn new(value: T) -> Self {
        Self(Mutex::new(Made { process: id(), value: Some(value) }))
    }

    /// The value of this process, by `make` where it is a forked one that has none yet. The interpreter's lock is held throughout:
    /// no other thread can hold the mutex when Python forks.
    pub fn get<E>(&self, _: Python<'_>, make: impl FnOnce() -> Result<T, E>) -> Result<T, E> {
        let mut made = self.0.lock().expect("no panic while it was held");
        if made.process != id() {
            *made = Made { process: id(), value: Some(make()?) };
        }
        Ok(made.value.clone().expect("it is being dropped"))
    }
}

impl<T> Drop for Made<T> {
    /// To end threads of the parent would wait for ever: its value is left as it is.
    fn drop(&mut self) {
        let value = self.value.take();
        if self.process != id() {
            forget(value);
        }
    }
}

/// The threads of a body, and of what is computed on them.
#[derive(Clone)]
pub struct Threads {
    count: usize,
    pool: Arc<PerProcess<Pool>>,
}

impl Threads {
    pub fn new(count: usize) -> PyResult<Self> {
        let pool = pool(count).map_err(|e| raised(&e))?;
        Ok(Self { count, pool: Arc::new(PerProcess::new(pool)) })
    }

    pub fn count(&self) -> usize {
        self.count
    }

    pub fn pool(&self, py: Python<'_>) -> PyResult<Pool> {
        self.pool.get(py, || pool(self.count).map_err(|e| raised(&e)))
    }
}

/// A number of threads from Python.
pub fn threads(given: &Bound<'_, PyAny>) -> PyResult<usize> {
    whole("threads", given, 1..=MOST).map(|count| count as usize)
}
