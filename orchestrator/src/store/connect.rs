//! Opening a database for reading. The file is never changed: a database of an earlier version is upgraded in a temporary copy.
//! If the file or its folder is not writable, the database is read without creating journal files.

use std::fs::{File, Metadata};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, Weak};

use metasense_schemas::database::MIGRATIONS;
use rustix::fs::{Access, access};
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{ConnectOptions, Connection, Executor};
use tempfile::TempDir;

use super::allow::{Allowed, allow};
use super::error::is_not_opened;
use super::{OPENING, StoreError, beside, check_version, has_journal, is_still, options, upgrade};
use crate::files;
use crate::leftovers;

/// A read-only connection and what it reads.
#[derive(Debug)]
pub(super) struct Connected {
    pub connection: SqliteConnection,
    /// The folder of the copy that is read instead of the file, if any.
    pub copy: Option<Arc<TempDir>>,
    /// The state of the file when it was opened without locks, if it was.
    pub unchanging: Option<String>,
}

/// Rows buffered between SQLite's thread and the reader. With few rows the two threads wait for each other most of the time.
const ROWS: usize = 256;

/// Options of a read-only connection that buffers this many rows.
fn reading(path: &Path, rows: Option<usize>) -> SqliteConnectOptions {
    options(path).read_only(true).row_buffer_size(rows.unwrap_or(ROWS))
}

/// Connects to a database of any version. The connection sees it at the newest version and is limited to [`Allowed::Reading`].
/// `rows`: number of rows to buffer.
pub(super) async fn connect(path: &Path, rows: Option<usize>) -> Result<Connected, StoreError> {
    let at = |source| StoreError::sql(path, OPENING, source);
    let mut found = open(path, rows).await?;
    let version = check_version(&mut found.connection, path).await?;
    if version < MIGRATIONS.len() {
        let copy = upgraded(path, found).await?;
        let file = copy.path().join(COPY);
        let connection = reading(&file, rows).connect().await.map_err(at)?;
        found = Connected { connection, copy: Some(copy), unchanging: None };
    }
    allow(&mut found.connection, Allowed::Reading).await.map_err(at)?;
    Ok(found)
}

/// Connects to a database without upgrading it.
async fn open(path: &Path, rows: Option<usize>) -> Result<Connected, StoreError> {
    let at = |source| StoreError::sql(path, OPENING, source);
    let writable =
        access(path, Access::WRITE_OK).and_then(|()| access(files::folder(path), Access::WRITE_OK));
    // In a folder that others may write to, SQLite would create journal files that belong to this user. The owner of the database could
    // then no longer write.
    if writable.is_ok() || beside(path, "-shm").exists() {
        let mut connection = reading(path, rows).connect().await.map_err(at)?;
        match connection.execute("SELECT count(*) FROM sqlite_schema").await {
            Ok(_) => return Ok(Connected { connection, copy: None, unchanging: None }),
            Err(e) if is_not_opened(&e) => {}
            Err(source) => return Err(at(source)),
        }
    }
    if has_journal(path) {
        let scratch = scratch(path)?;
        let copy = scratch.path().join(COPY);
        copy_with_journal(path, &copy)?;
        let connection = reading(&copy, rows).connect().await.map_err(at)?;
        return Ok(Connected { connection, copy: Some(Arc::new(scratch)), unchanging: None });
    }
    let unchanging = Some(state(path)?);
    let connection = reading(path, rows).immutable(true).connect().await.map_err(at)?;
    Ok(Connected { connection, copy: None, unchanging })
}

/// File name of a copy in its temporary folder.
const COPY: &str = "copy.sqlite";

fn scratch(path: &Path) -> Result<TempDir, StoreError> {
    let failed = |source| StoreError::NotCopied { path: path.to_owned(), source };
    leftovers::scratch("metasense-read-").map_err(failed)
}

/// Upgraded copies that are in use, with the path and state of their originals. Further readers share them.
static UPGRADED: Mutex<Vec<(PathBuf, String, Weak<TempDir>)>> = Mutex::new(Vec::new());

/// Upgrades a copy of the database to the newest version.
async fn upgraded(path: &Path, older: Connected) -> Result<Arc<TempDir>, StoreError> {
    let at = |source| StoreError::sql(path, "copying", source);
    let state = state(path)?;
    {
        let mut known = UPGRADED.lock().expect("nobody panics with it");
        known.retain(|(.., copy)| copy.strong_count() > 0);
        let same = known.iter().filter(|(file, was, _)| file == path && *was == state && !has_journal(path));
        if let Some(copy) = same.filter_map(|(.., copy)| copy.upgrade()).next() {
            return Ok(copy);
        }
    }
    let Connected { mut connection, copy, .. } = older;
    let copy = match copy {
        Some(copy) => copy,
        None => {
            let scratch = scratch(path)?;
            let file = scratch.path().join(COPY).to_string_lossy().into_owned();
            sqlx::query("VACUUM INTO ?").bind(file).execute(&mut connection).await.map_err(at)?;
            Arc::new(scratch)
        }
    };
    connection.close().await.map_err(at)?;
    upgrade(&copy.path().join(COPY)).await?;
    let mut known = UPGRADED.lock().expect("nobody panics with it");
    known.push((path.to_owned(), state, Arc::downgrade(&copy)));
    Ok(copy)
}

/// The current state of a file.
pub(super) fn state(path: &Path) -> Result<String, StoreError> {
    let failed = |source| StoreError::NotCopied { path: path.to_owned(), source };
    path.metadata().map(|m| state_of(&m)).map_err(failed)
}

/// What tells a file from what it was before: device, inode, size, time of its last change.
pub(crate) fn state_of(m: &Metadata) -> String {
    format!("{} {} {} {}.{:09}", m.dev(), m.ino(), m.size(), m.mtime(), m.mtime_nsec())
}

/// Copies a database that nobody writes to, with what lies in its journal.
///
/// # Errors
/// `InUse` where somebody does; `NotCopied` where the system fails.
pub(crate) fn copy_with_journal(path: &Path, copy: &Path) -> Result<(), StoreError> {
    let failed = |source| StoreError::NotCopied { path: path.to_owned(), source };
    let lock = File::open(path).map_err(failed)?;
    if files::is_held(&lock) || !is_still(&lock, path) {
        return Err(StoreError::InUse { path: path.to_owned() });
    }
    for end in ["", "-wal"] {
        std::fs::copy(beside(path, end), beside(copy, end)).map_err(failed)?;
    }
    Ok(())
}

/// Asks a database that nobody writes to, as a file that does not change: neither locks nor a journal are looked for. It may
/// be of an older version.
pub async fn ask_unchanging<T>(
    path: &Path,
    ask: impl AsyncFnOnce(&mut SqliteConnection) -> sqlx::Result<T>,
) -> sqlx::Result<T> {
    let mut connection = options(path).read_only(true).immutable(true).connect().await?;
    let answer = ask(&mut connection).await?;
    connection.close().await?;
    Ok(answer)
}
