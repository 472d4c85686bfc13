//! A database to be merged: attached as it is where we can keep writers away from it, through a copy where a run may write
//! to it, where it has a journal, or where it is of an older version.

use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

use metasense_schemas::database::MIGRATIONS;
use sqlx::{ConnectOptions, Connection};

use super::{MergeError, name_of};
use crate::store::{self, StoreError};

/// An input that can be attached.
#[derive(Debug)]
pub(super) struct Input {
    /// As it was named.
    pub named: PathBuf,
    /// To attach.
    pub uri: String,
    /// Keeps writers out for as long as it is attached, if it is the file itself.
    _lock: Option<File>,
}

impl Input {
    /// `number` names its copy in `scratch`, if it needs one.
    pub async fn open(file: &Path, scratch: &Path, number: usize) -> Result<Self, String> {
        let named = file.to_owned();
        if !file.is_file() {
            return Err("there is no such file".into());
        }
        let text = |e: &dyn std::error::Error| {
            let cause = e.source().map_or(String::new(), |cause| format!(": {cause}"));
            format!("{e}{cause}")
        };
        let copy = scratch.join(format!("input-{number}.sqlite"));
        let mut path = file.to_owned();
        let lock = File::open(file).map_err(|e| text(&e))?;
        let busy = matches!(lock.try_lock_shared(), Err(TryLockError::WouldBlock));
        if busy || has_journal(file) {
            snapshot(file, &copy, false).await.map_err(|e| text(&e))?;
            path.clone_from(&copy);
        }
        let version = store::ask_unchanging(&path, async |db| Ok(store::check_version(db, file).await)).await;
        let version = version.map_err(|source| StoreError::sql(&path, "opening", source)).and_then(|v| v);
        if version.map_err(|e| text(&e))? < MIGRATIONS.len() {
            if path != copy {
                std::fs::copy(&path, &copy).map_err(|e| text(&e))?;
                path.clone_from(&copy);
            }
            store::upgrade(&copy).await.map_err(|e| text(&e))?;
        }
        Ok(Self { named, uri: uri(&path), _lock: (path != copy).then_some(lock) })
    }
}

/// Whether there is a write-ahead log with something in it.
pub(super) fn has_journal(file: &Path) -> bool {
    beside(file, "-wal").metadata().is_ok_and(|m| m.len() > 0)
}

/// Folds what a killed run has left in the log into the file, so that nothing is lost with the log.
pub(super) async fn fold(file: &Path) -> Result<(), StoreError> {
    if !has_journal(file) {
        return Ok(());
    }
    let at = |source| StoreError::sql(file, "folding the log into", source);
    let mut connection = store::options(file).connect().await.map_err(at)?;
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
/// behind us; otherwise it is only read.
///
/// # Errors
/// Where SQLite fails.
pub(in crate::cluster) async fn snapshot(file: &Path, copy: &Path, ours: bool) -> Result<(), StoreError> {
    let at = |source| StoreError::sql(file, "copying", source);
    let mut connection = store::options(file).read_only(!ours).connect().await.map_err(at)?;
    let done = sqlx::query("VACUUM INTO ?").bind(writable_uri(copy)).execute(&mut connection).await;
    connection.close().await.map_err(at)?;
    done.map(|_| ()).map_err(at)
}

/// Keeps runs and other merges away from the result until it is renamed into its place.
pub(super) fn keep_writers_out(out: &Path) -> Result<Option<File>, MergeError> {
    let Ok(file) = File::open(out) else { return Ok(None) };
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => Err(StoreError::InUse { path: out.to_owned() }.into()),
        // A file system without locks is no reason not to write there.
        Ok(()) | Err(TryLockError::Error(_)) => Ok(Some(file)),
    }
}

/// A file beside a database.
pub(super) fn beside(file: &Path, end: &str) -> PathBuf {
    file.with_file_name(format!("{}{end}", name_of(file)))
}

/// A file that does not change while it is read: neither locks nor a journal are asked for.
fn uri(file: &Path) -> String {
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
