//! Threads, and values that own threads, in forked processes. A forked process inherits the memory, but not the threads.

use std::mem::forget;
use std::process::id;
use std::sync::{Arc, Mutex};

use metasense_worker::run::{Pool, pool};
use pyo3::prelude::*;

use crate::arrays::parse_integer;
use crate::raised;

/// Greatest number of threads of a body, as on the command line.
const MOST: u64 = 1024;

/// A value that is valid only in the process that created it; a forked process creates its own.
pub struct PerProcess<T>(Mutex<OwnedValue<T>>);

struct OwnedValue<T> {
    process: u32,
    /// `None` during drop.
    value: Option<T>,
}

impl<T: Clone> PerProcess<T> {
    pub fn new(value: T) -> Self {
        Self(Mutex::new(OwnedValue { process: id(), value: Some(value) }))
    }

    /// The value of this process; a forked process creates it with `make`. Holding the interpreter's lock ensures that no other
    /// thread holds the mutex when Python forks.
    pub fn get<E>(&self, _: Python<'_>, make: impl FnOnce() -> Result<T, E>) -> Result<T, E> {
        let mut made = self.0.lock().expect("no panic while it was held");
        if made.process != id() {
            *made = OwnedValue { process: id(), value: Some(make()?) };
        }
        Ok(made.value.clone().expect("it is being dropped"))
    }
}

impl<T> Drop for OwnedValue<T> {
    /// Leaks values of the parent process: joining its threads would wait forever.
    fn drop(&mut self) {
        let value = self.value.take();
        if self.process != id() {
            forget(value);
        }
    }
}

/// Number of threads of a body, and their pool.
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

/// Converts a number of threads from Python.
pub fn threads(given: &Bound<'_, PyAny>) -> PyResult<usize> {
    parse_integer("threads", given, 1..=MOST).map(|count| count as usize)
}
