//! Files of a database: where it really lies, what lies beside it, and the lock that keeps other writers out.

use std::fs::{File, OpenOptions, TryLockError};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::StoreError;

/// Attempts at a lock, and the pause between two: a reader that tidies up holds it for some milliseconds, a run for as long
/// as it lasts.
const ATTEMPTS: usize = 20;
const PAUSE: Duration = Duration::from_millis(10);

/// The file behind links: its log lies beside it, not beside the link.
pub(crate) fn real(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}

/// A file beside a database, behind links.
pub(crate) fn beside(file: &Path, end: &str) -> PathBuf {
    let mut name = real(file).into_os_string();
    name.push(end);
    name.into()
}

/// Whether there is a write-ahead log with something in it.
pub(crate) fn has_journal(file: &Path) -> bool {
    beside(file, "-wal").metadata().is_ok_and(|m| m.len() > 0)
}

/// Keeps other writers away from a file for as long as the handle lives; `create`: makes it where it is missing.
///
/// # Errors
/// `InUse` where another holds it, `Unwritable` where it cannot be opened, is no file, or cannot be locked.
pub(crate) fn lock(path: &Path, create: bool) -> Result<File, StoreError> {
    let unwritable = |source| StoreError::Unwritable { path: path.to_owned(), source };
    for attempt in 0..ATTEMPTS {
        if attempt > 0 {
            std::thread::sleep(PAUSE);
        }
        if path.metadata().is_ok_and(|m| !m.is_file()) {
            return Err(unwritable(std::io::Error::other("it is no file")));
        }
        let mut options = OpenOptions::new();
        // Where a pipe has come meanwhile, opening does not wait for its other end.
        options.read(true).write(true).create(create).custom_flags(libc::O_NONBLOCK);
        let file = options.open(path).map_err(unwritable)?;
        match file.try_lock() {
            // What was locked may have been renamed over, or removed, before it was.
            Ok(()) if is_still(&file, path) => return Ok(file),
            Ok(()) | Err(TryLockError::WouldBlock) => {}
            Err(TryLockError::Error(source)) => return Err(unwritable(source)),
        }
    }
    Err(StoreError::InUse { path: path.to_owned() })
}

/// Whether an open file is the one that a path names.
pub(crate) fn is_still(file: &File, path: &Path) -> bool {
    let names = |m: std::fs::Metadata| (m.dev(), m.ino());
    file.metadata().ok().map(names) == path.metadata().ok().map(names)
}
