//! The lock that excludes other writers from a database.

use std::fs::{File, OpenOptions, TryLockError};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::Duration;

use super::{Result, StoreError};
use crate::files::is_still;

/// Attempts at a lock, and the pause between them: a reader that tidies up holds the lock for some milliseconds, a run for its
/// whole duration.
const ATTEMPTS: usize = 20;
const PAUSE: Duration = Duration::from_millis(10);

/// Excludes other writers from a file while the handle exists; `create`: creates a missing file.
/// Fails with `InUse` if another process holds the lock; `Unwritable` if the file cannot be opened or locked, or is not regular.
pub(crate) fn lock(path: &Path, create: bool) -> Result<File> {
    let unwritable = |source| StoreError::Unwritable(path.to_owned(), source);
    for attempt in 0..ATTEMPTS {
        if attempt > 0 {
            std::thread::sleep(PAUSE);
        }
        if path.metadata().is_ok_and(|m| !m.is_file()) {
            return Err(unwritable(std::io::Error::other("it is not a regular file")));
        }
        let mut options = OpenOptions::new();
        // If a pipe has replaced the file, opening must not wait for its other end.
        options.read(true).write(true).create(create).custom_flags(libc::O_NONBLOCK);
        let file = options.open(path).map_err(unwritable)?;
        match file.try_lock() {
            // The file may have been replaced or removed before it was locked.
            Ok(()) if is_still(&file, path) => return Ok(file),
            Ok(()) | Err(TryLockError::WouldBlock) => {}
            Err(TryLockError::Error(source)) => return Err(unwritable(source)),
        }
    }
    Err(StoreError::InUse(path.to_owned()))
}
