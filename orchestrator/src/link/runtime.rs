//! A run's directory in shared memory.
//!
//! ```text
//! /dev/shm/metasense-ID/lock      locked while the run lives
//! /dev/shm/metasense-ID/3.12/     root path of the domain of worker 3.12
//! /dev/shm/metasense-ID_3.12_…    its segments
//! ```
//! A directory whose lock is free is abandoned, and so are segments without a directory. Those of other users cannot be
//! removed, but do no harm: no two runs share a name.

use std::fs::{DirBuilder, File};
use std::io;
use std::os::unix::fs::DirBuilderExt;
use std::path::PathBuf;

pub use metasense_schemas::wire::SHARED_MEMORY;

use crate::files::fresh_mark;
use crate::leftovers::{STEM, remove_dead_runs, remove_segments};
use crate::scheduler::WorkerId;

/// A run's directory in shared memory cannot be created.
#[derive(Debug, thiserror::Error)]
#[error("cannot create {}; check that {SHARED_MEMORY} is mounted and writable", .0.display())]
pub struct RuntimeError(PathBuf, #[source] io::Error);

/// A run's directory in shared memory; dropping it removes everything in it.
#[derive(Debug)]
pub struct Runtime {
    shared: PathBuf,
    name: String,
    // Held until everything is removed.
    _lock: File,
}

/// Location of a worker's domain.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Domain {
    shared: PathBuf,
    /// Root path.
    pub root: PathBuf,
    /// Prefix of its segments.
    pub prefix: String,
}

impl Runtime {
    /// Creates a directory for a run, after removing those of dead runs.
    pub fn new() -> Result<Self, RuntimeError> {
        let shared = PathBuf::from(SHARED_MEMORY);
        let removed = remove_dead_runs(&shared);
        if removed > 0 {
            tracing::warn!(removed, "removed files of dead runs from {SHARED_MEMORY}");
        }
        loop {
            let name = format!("{STEM}{}", fresh_mark());
            let path = shared.join(&name);
            match DirBuilder::new().mode(0o700).create(&path) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => continue,
                Err(source) => return Err(RuntimeError(path, source)),
                Ok(()) => {}
            }
            let lock = File::create(path.join("lock"));
            let lock = lock.map_err(|source| RuntimeError(path.clone(), source))?;
            // Between creation and lock, another run may have removed the directory as abandoned.
            if lock.try_lock().is_ok() && path.join("lock").exists() {
                tracing::info!(place = name, "the run has a directory in {SHARED_MEMORY}");
                return Ok(Self { shared, name, _lock: lock });
            }
        }
    }

    /// The domain of a worker; creating its services creates it.
    pub fn domain(&self, worker: WorkerId) -> Domain {
        Domain {
            shared: self.shared.clone(),
            root: self.shared.join(&self.name).join(worker.to_string()),
            prefix: format!("{}_{worker}_", self.name),
        }
    }
}

impl Drop for Runtime {
    fn drop(&mut self) {
        remove_segments(&self.shared, &format!("{}_", self.name));
        let _ = std::fs::remove_dir_all(self.shared.join(&self.name));
    }
}

impl Domain {
    /// Removes the whole domain, in whatever state a killed worker left it.
    pub fn remove(&self) {
        remove_segments(&self.shared, &self.prefix);
        let _ = std::fs::remove_dir_all(&self.root);
    }
}

#[cfg(test)]
mod tests;
