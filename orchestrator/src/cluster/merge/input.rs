//! An input of a merge. It is attached directly if no process writes to it; otherwise, or if it has a journal or is empty,
//! through a copy.
//!
//! Only one input is open at a time. Size and modification time show whether an input has changed in between; a changed input
//! is copied.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use sqlx::{ConnectOptions, Connection};

use crate::exit::chain;
use crate::files;
use crate::reader;
use crate::store::{self, StoreError};

/// An input that can be attached.
#[derive(Debug)]
pub(super) struct Input {
    /// Path as given.
    pub named: PathBuf,
    /// Real path of the file.
    pub file: PathBuf,
    /// Path to attach: the file or its copy.
    pub path: PathBuf,
    /// State of the file if no process was writing to it.
    pub state: Option<String>,
    /// Whether writers are already excluded.
    held: bool,
}

/// Why an input cannot be attached.
#[derive(Debug)]
pub(super) enum InputError {
    /// The input is faulty.
    Input(String),
    /// The disk, memory or descriptors are short.
    Shortage(sqlx::Error),
    /// A run writes to it or has changed it.
    Changed,
}

impl From<io::Error> for InputError {
    fn from(e: io::Error) -> Self {
        match e.kind() {
            io::ErrorKind::NotFound | io::ErrorKind::PermissionDenied => Self::Input(e.to_string()),
            _ => Self::Shortage(sqlx::Error::Io(e)),
        }
    }
}

impl From<StoreError> for InputError {
    fn from(e: StoreError) -> Self {
        match e {
            StoreError::Sql { source, .. } if store::is_shortage(&source) => Self::Shortage(source),
            StoreError::NotCopied(_, source) => source.into(),
            e => Self::Input(chain(&e)),
        }
    }
}

impl Input {
    /// Opens an input. `copy`: path for a copy if one is needed; `held`: writers are already excluded.
    pub async fn open(named: &Path, copy: &Path, held: bool) -> Result<Self, InputError> {
        if !named.is_file() {
            return Err(InputError::Input("no such file".into()));
        }
        let file = files::resolve_links(named);
        let lock = File::open(&file)?;
        let mut state = Some(state_of(&lock)?);
        let busy = !held && files::is_held(&lock);
        let mut path = file.clone();
        if busy {
            snapshot(&file, copy, false, || true).await?;
            (path, state) = (copy.to_owned(), None);
        } else if files::has_journal(&file) {
            match reader::copy_with_journal(&file, copy) {
                // a run has started since
                Err(StoreError::InUse(..)) => return Err(InputError::Changed),
                copied => copied?,
            }
            checkpoint_log(copy, true).await?;
            (path, state) = (copy.to_owned(), None);
        }
        let version =
            reader::ask_unchanging(&path, async |db| Ok(store::check_version(db, &file).await)).await;
        let version = version.map_err(|source| StoreError::sql(&file, "opening", source)).and_then(|v| v)?;
        if version == 0 {
            if path != copy {
                std::fs::copy(&path, copy)?;
                path = copy.to_owned();
            }
            store::create(copy).await?;
        }
        Ok(Self { named: named.to_owned(), file, path, state, held })
    }

    /// Excludes writers while the handle exists; `None` for copies.
    pub fn hold(&self) -> Result<Option<File>, InputError> {
        if self.path != self.file || self.held {
            return Ok(None);
        }
        let lock = File::open(&self.file)?;
        match files::is_held(&lock) || Some(state_of(&lock)?) != self.state || files::has_journal(&self.file)
        {
            true => Err(InputError::Changed),
            false => Ok(Some(lock)),
        }
    }

    /// URI to attach.
    pub fn uri(&self) -> String {
        uri(&self.path)
    }
}

/// Current state of a file.
fn state_of(file: &File) -> io::Result<String> {
    file.metadata().map(|m| reader::state_of(&m))
}

/// Whether a file (real path) has the given state and no log.
pub(super) fn is_as_before(file: &Path, state: &str) -> bool {
    let now = File::open(file).and_then(|file| state_of(&file));
    now.is_ok_and(|now| now == state) && !files::has_journal(file)
}

/// Moves the log of a killed run into the file, so that its data is not lost. `alone`: no other process knows the file.
pub(super) async fn checkpoint_log(file: &Path, alone: bool) -> Result<(), StoreError> {
    if !files::has_journal(file) {
        return Ok(());
    }
    let at = |source| StoreError::sql(file, "folding the log into", source);
    let mut options = store::options(file);
    if alone {
        // Needs no index in shared memory, which network file systems may lack.
        options = options.pragma("locking_mode", "EXCLUSIVE");
    }
    let mut connection = options.connect().await.map_err(at)?;
    // Whether busy, frames in the log, frames moved into the file.
    let folded: (i64, i64, i64) =
        sqlx::query_as("PRAGMA wal_checkpoint(TRUNCATE)").fetch_one(&mut connection).await.map_err(at)?;
    connection.close().await.map_err(at)?;
    match folded.0 {
        0 => Ok(()),
        _ => Err(StoreError::InUse(file.to_owned())),
    }
}

/// Copies a consistent state of a database to a file without a journal, even while a run writes to it. `ours`: journals may be
/// removed; otherwise the database is opened read-only. Stops when `goes_on` returns false.
///
/// # Errors
/// If SQLite fails.
pub(in crate::cluster) async fn snapshot(
    file: &Path,
    copy: &Path,
    ours: bool,
    goes_on: impl FnMut() -> bool + Send + 'static,
) -> Result<(), StoreError> {
    let at = |source| StoreError::sql(file, "copying", source);
    let mut connection = store::options(file).read_only(!ours).connect().await.map_err(at)?;
    connection.lock_handle().await.map_err(at)?.set_progress_handler(OPERATIONS, goes_on);
    let done = sqlx::query("VACUUM INTO ?").bind(writable_uri(copy)).execute(&mut connection).await;
    connection.close().await.map_err(at)?;
    done.map(|_| ()).map_err(at)
}

/// SQLite operations between two calls of `goes_on`: some milliseconds.
const OPERATIONS: i32 = 10_000;

/// URI of a file that does not change: SQLite uses neither locks nor a journal.
pub(super) fn uri(file: &Path) -> String {
    format!("file:{}?immutable=1", escaped(file))
}

/// URI of a file that no other process knows: no locks, which network file systems may lack.
pub(super) fn writable_uri(file: &Path) -> String {
    format!("file:{}?nolock=1", escaped(file))
}

/// Escapes a path for SQLite's URIs.
fn escaped(file: &Path) -> String {
    let file = std::path::absolute(file).unwrap_or_else(|_| file.to_owned());
    let escape = |c: char| match c {
        '%' => "%25".to_owned(),
        '?' => "%3f".to_owned(),
        '#' => "%23".to_owned(),
        c => c.to_string(),
    };
    file.to_string_lossy().chars().map(escape).collect()
}

#[cfg(test)]
mod tests;
