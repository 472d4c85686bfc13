//! Opens a database for reading and never changes it. If the file or its folder is not writable, no journal files are created.

use std::fs::{File, Metadata};
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use rustix::fs::{Access, access};
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{ConnectOptions, Connection, Executor};
use tempfile::TempDir;

use super::allow::{AccessLevel, allow};
use crate::files::{self, has_journal, is_still, sidecar};
use crate::leftovers;
use crate::sql;
use crate::store::{OPENING, StoreError, add_views, check_version, is_not_opened, options};

/// A read-only connection and what it reads.
#[derive(Debug)]
pub(super) struct Connected {
    pub connection: SqliteConnection,
    /// The folder of the copy that is read instead of the file, if any; it is removed with this.
    _copy: Option<TempDir>,
    /// The state of the file when it was opened without locks, if it was.
    pub unchanging: Option<String>,
}

/// Rows buffered between SQLite's thread and the reader. With few rows the two threads wait for each other most of the time.
const ROWS: usize = 256;

/// Options of a read-only connection that buffers this many rows.
fn reading(path: &Path, rows: Option<usize>) -> SqliteConnectOptions {
    options(path).read_only(true).row_buffer_size(rows.unwrap_or(ROWS))
}

/// Connects to a database. The connection is limited to [`AccessLevel::Reading`]. `rows`: number of rows to buffer.
pub(super) async fn connect(path: &Path, rows: Option<usize>) -> Result<Connected, StoreError> {
    let at = |source| StoreError::sql(path, OPENING, source);
    let mut found = open(path, rows).await?;
    if check_version(&mut found.connection, path).await? == 0 {
        return Err(StoreError::NotOurs(path.to_owned()));
    }
    sql::register(&mut found.connection).await.map_err(at)?;
    add_views(&mut found.connection, "CREATE TEMP").await.map_err(at)?;
    allow(&mut found.connection, AccessLevel::Reading).await.map_err(at)?;
    Ok(found)
}

/// Connects to a database of any version.
async fn open(path: &Path, rows: Option<usize>) -> Result<Connected, StoreError> {
    let at = |source| StoreError::sql(path, OPENING, source);
    let writable =
        access(path, Access::WRITE_OK).and_then(|()| access(files::folder(path), Access::WRITE_OK));
    // In a folder that others may write to, SQLite would create journal files that belong to this user. The owner of the database could
    // then no longer write.
    if writable.is_ok() || sidecar(path, "-shm").exists() {
        let mut connection = reading(path, rows).connect().await.map_err(at)?;
        match connection.execute("SELECT count(*) FROM sqlite_schema").await {
            Ok(_) => return Ok(Connected { connection, _copy: None, unchanging: None }),
            Err(e) if is_not_opened(&e) => {}
            Err(source) => return Err(at(source)),
        }
    }
    if has_journal(path) {
        let failed = |source| StoreError::NotCopied(path.to_owned(), source);
        let scratch = leftovers::scratch("metasense-read-").map_err(failed)?;
        let copy = scratch.path().join(COPY);
        copy_with_journal(path, &copy)?;
        let connection = reading(&copy, rows).connect().await.map_err(at)?;
        return Ok(Connected { connection, _copy: Some(scratch), unchanging: None });
    }
    let unchanging = Some(state(path)?);
    let connection = reading(path, rows).immutable(true).connect().await.map_err(at)?;
    Ok(Connected { connection, _copy: None, unchanging })
}

/// File name of a copy in its temporary folder.
const COPY: &str = "copy.sqlite";

/// The current state of a file.
pub(super) fn state(path: &Path) -> Result<String, StoreError> {
    let failed = |source| StoreError::NotCopied(path.to_owned(), source);
    path.metadata().map(|m| state_of(&m)).map_err(failed)
}

/// A string that differs if a file was changed or replaced: device, inode, size, modification time.
pub(crate) fn state_of(m: &Metadata) -> String {
    format!("{} {} {} {}.{:09}", m.dev(), m.ino(), m.size(), m.mtime(), m.mtime_nsec())
}

/// Copies a database that no process writes to, with its write-ahead log.
///
/// # Errors
/// `InUse` if a process writes to it; `NotCopied` if the system fails.
pub(crate) fn copy_with_journal(path: &Path, copy: &Path) -> Result<(), StoreError> {
    let failed = |source| StoreError::NotCopied(path.to_owned(), source);
    let lock = File::open(path).map_err(failed)?;
    if files::is_held(&lock) || !is_still(&lock, path) {
        return Err(StoreError::InUse(path.to_owned()));
    }
    for end in ["", "-wal"] {
        std::fs::copy(sidecar(path, end), sidecar(copy, end)).map_err(failed)?;
    }
    Ok(())
}

/// Queries a database that no process writes to. Uses neither locks nor journals, and accepts any version.
pub async fn ask_unchanging<T>(
    path: &Path,
    ask: impl AsyncFnOnce(&mut SqliteConnection) -> sqlx::Result<T>,
) -> sqlx::Result<T> {
    let mut connection = options(path).read_only(true).immutable(true).connect().await?;
    let answer = ask(&mut connection).await?;
    connection.close().await?;
    Ok(answer)
}
