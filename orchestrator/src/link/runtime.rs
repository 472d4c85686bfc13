//! A run's directory in shared memory, and the removal of what dead runs left.
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
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

pub use metasense_schemas::wire::SHARED_MEMORY;

use crate::scheduler::WorkerId;

/// Prefix of all our names.
const STEM: &str = "metasense-";
/// A directory without a lock file may belong to a run that is starting, up to this age.
const BIRTH: Duration = Duration::from_secs(60);

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
    ///
    /// # Errors
    /// If no directory can be created.
    pub fn new() -> Result<Self, RuntimeError> {
        let shared = PathBuf::from(SHARED_MEMORY);
        let removed = remove_stale(&shared);
        if removed > 0 {
            tracing::warn!(removed, "removed files of dead runs from {SHARED_MEMORY}");
        }
        let mut seed = u64::from(std::process::id()) << 32
            | u64::from(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().subsec_nanos());
        loop {
            seed = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29);
            let name = format!("{STEM}{:010x}", seed & 0xff_ffff_ffff);
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

fn remove_segments(shared: &Path, prefix: &str) -> usize {
    let Ok(entries) = std::fs::read_dir(shared) else { return 0 };
    let ours = |entry: &std::fs::DirEntry| entry.file_name().to_string_lossy().starts_with(prefix);
    entries.flatten().filter(ours).filter(|entry| std::fs::remove_file(entry.path()).is_ok()).count()
}

/// Removes directories and segments of dead runs and returns their number. Those of other users stay.
pub fn remove_stale(shared: &Path) -> usize {
    let Ok(entries) = std::fs::read_dir(shared) else { return 0 };
    let mut removed = 0;
    for entry in entries.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let Some(id) = name.strip_prefix(STEM) else { continue };
        match id.split_once('_') {
            Some((id, _)) => {
                if !shared.join(format!("{STEM}{id}")).exists() {
                    removed += usize::from(std::fs::remove_file(entry.path()).is_ok());
                }
            }
            None => {
                if let Some(_lock) = abandoned(&entry.path()) {
                    removed += remove_segments(shared, &format!("{name}_"));
                    removed += usize::from(std::fs::remove_dir_all(entry.path()).is_ok());
                }
            }
        }
    }
    removed
}

/// Opens the lock, or without one the directory, of a dead run; `None` if the run may be alive.
fn abandoned(directory: &Path) -> Option<File> {
    match File::open(directory.join("lock")) {
        Ok(lock) => lock.try_lock().is_ok().then_some(lock),
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            let age = directory.metadata().ok()?.modified().ok()?.elapsed().ok()?;
            (age > BIRTH).then(|| File::open(directory).ok())?
        }
        Err(_) => None,
    }
}

#[cfg(test)]
mod tests;
