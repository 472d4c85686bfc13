//! A database to be merged: attached as it is where nobody writes to it, through a copy where a run does, where it has a
//! journal, or where it is of an older version.
//!
//! One input at a time is open. That it is between two looks what it was is seen by its size and time; one that is not is
//! taken as a copy.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use sqlx::{ConnectOptions, Connection};

use crate::exit::chain;
use crate::files;
use crate::store::{self, StoreError};

/// An input that can be attached.
#[derive(Debug)]
pub(super) struct Input {
    /// As it was named.
    pub named: PathBuf,
    /// The file behind links.
    pub file: PathBuf,
    /// What is attached: the file, or its copy.
    pub path: PathBuf,
    /// What the file was, where nobody was at work on it.
    pub state: Option<String>,
    /// Writers are kept out of it already.
    held: bool,
}

/// Why an input cannot be attached.
#[derive(Debug)]
pub(super) enum Refusal {
    /// It is at fault.
    Input(String),
    /// Something else: the disk, memory, descriptors.
    Shortage(sqlx::Error),
    /// A run writes to it, or has.
    Changed,
}

impl From<io::Error> for Refusal {
    fn from(e: io::Error) -> Self {
        match e.kind() {
            io::ErrorKind::NotFound | io::ErrorKind::PermissionDenied => Self::Input(e.to_string()),
            _ => Self::Shortage(sqlx::Error::Io(e)),
        }
    }
}

impl From<StoreError> for Refusal {
    fn from(e: StoreError) -> Self {
        match e {
            StoreError::Sql { source, .. } if store::is_shortage(&source) => Self::Shortage(source),
            StoreError::NotCopied { source, .. } => source.into(),
            e => Self::Input(chain(&e)),
        }
    }
}

impl Input {
    /// `copy` is where its copy goes, if it needs one; `held`: writers are kept out already.
    pub async fn open(named: &Path, copy: &Path, held: bool) -> Result<Self, Refusal> {
        if !named.is_file() {
            return Err(Refusal::Input("no such file".into()));
        }
        let file = store::real(named);
        let lock = File::open(&file)?;
        let mut state = Some(state_of(&lock)?);
        let busy = !held && files::is_held(&lock);
        let mut path = file.clone();
        if busy {
            snapshot(&file, copy, false, || true).await?;
            (path, state) = (copy.to_owned(), None);
        } else if store::has_journal(&file) {
            match store::copy_with_journal(&file, copy) {
                // begun since
                Err(StoreError::InUse { .. }) => return Err(Refusal::Changed),
                copied => copied?,
            }
            fold(copy, true).await?;
            (path, state) = (copy.to_owned(), None);
        }
        let version =
            store::ask_unchanging(&path, async |db| Ok(store::check_version(db, &file).await)).await;
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

    /// Keeps writers out for as long as the handle lives; of a copy there is none.
    pub fn hold(&self) -> Result<Option<File>, Refusal> {
        if self.path != self.file || self.held {
            return Ok(None);
        }
        let lock = File::open(&self.file)?;
        match files::is_held(&lock) || Some(state_of(&lock)?) != self.state || store::has_journal(&self.file)
        {
            true => Err(Refusal::Changed),
            false => Ok(Some(lock)),
        }
    }

    /// To attach.
    pub fn uri(&self) -> String {
        uri(&self.path)
    }
}

/// What a file is now.
fn state_of(file: &File) -> io::Result<String> {
    file.metadata().map(|m| store::state_of(&m))
}

/// Whether a file, behind links, is what it was, and nobody has left a log beside it.
pub(super) fn is_as_before(file: &Path, state: &str) -> bool {
    let now = File::open(file).and_then(|file| state_of(&file));
    now.is_ok_and(|now| now == state) && !store::has_journal(file)
}

/// Folds what a killed run has left in the log into the file, so that nothing is lost with the log. `alone`: nobody else
/// knows of the file.
pub(super) async fn fold(file: &Path, alone: bool) -> Result<(), StoreError> {
    if !store::has_journal(file) {
        return Ok(());
    }
    let at = |source| StoreError::sql(file, "folding the log into", source);
    let mut options = store::options(file);
    if alone {
        // Without an index in shared memory, which network file systems may not have.
        options = options.pragma("locking_mode", "EXCLUSIVE");
    }
    let mut connection = options.connect().await.map_err(at)?;
    // Busy, frames in the log, those of them that are in the file.
    let folded: (i64, i64, i64) =
        sqlx::query_as("PRAGMA wal_checkpoint(TRUNCATE)").fetch_one(&mut connection).await.map_err(at)?;
    connection.close().await.map_err(at)?;
    match folded.0 {
        0 => Ok(()),
        _ => Err(StoreError::InUse { path: file.to_owned() }),
    }
}

/// One consistent state of a database, whoever writes to it, as a file without a journal. `ours`: it may be tidied up
/// behind us; otherwise it is only read. It is given up when `goes_on` says no.
///
/// # Errors
/// Where SQLite fails.
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

/// SQLite's operations between two looks at whether a copy is still wanted: some milliseconds.
const OPERATIONS: i32 = 10_000;

/// A file that does not change while it is read: neither locks nor a journal are asked for.
pub(super) fn uri(file: &Path) -> String {
    format!("file:{}?immutable=1", escaped(file))
}

/// A file that nobody else knows of: no locks, which network file systems may not have.
pub(super) fn writable_uri(file: &Path) -> String {
    format!("file:{}?nolock=1", escaped(file))
}

/// As SQLite's URIs want it.
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
