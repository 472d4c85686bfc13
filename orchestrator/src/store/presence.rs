//! Detects that the files of an open database were deleted, moved, replaced or truncated, and saves the recorded data.
//!
//! SQLite keeps writing to its open files in these cases. Data written to a deleted file would be lost when the process ends, and a
//! renamed file would lack what is still in its log. Each check therefore compares the paths with the open files.

use std::fs::File;
use std::os::fd::AsRawFd;
use std::os::unix::fs::{FileExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use libsqlite3_sys as ffi;
use sqlx::sqlite::SqliteConnection;
use sqlx::{Connection, Executor};

use super::{Result, StoreError};
use crate::files::{self, is_still, resolve_links, sidecar};

/// What happened to the files of an open database, as the predicate of a sentence about it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FileLoss {
    /// The file was deleted.
    #[error("was deleted")]
    Deleted,
    /// The file or its folder was renamed.
    #[error("was moved or renamed")]
    Moved,
    /// Another file has taken its path.
    #[error("was replaced by another file (left unchanged)")]
    Replaced,
    /// The log (-wal) or its index (-shm) was deleted or replaced.
    #[error("lost its log (-wal, -shm)")]
    Log,
    /// The file was cut short.
    #[error("was truncated")]
    Truncated,
}

/// Device and inode.
type Id = (u64, u64);

fn id_at(path: &Path) -> Option<Id> {
    path.metadata().ok().map(|m| (m.dev(), m.ino()))
}

/// Checks the files of an open database. A check takes a few system calls.
#[derive(Debug, Clone)]
pub struct Presence {
    /// The locked file. It must be closed after SQLite's connection: closing it drops SQLite's own locks.
    file: Arc<File>,
    /// The path as given, and with links resolved.
    paths: [PathBuf; 2],
    /// Suffixes of the files beside the database, with their identities.
    beside: Vec<(&'static str, Id)>,
    /// Largest size seen so far (bytes).
    size: Arc<AtomicU64>,
}

impl Presence {
    /// For a database whose log is open.
    pub(super) fn new(file: Arc<File>, path: &Path) -> Self {
        let of = |end| Some((end, id_at(&sidecar(path, end))?));
        let beside = ["-wal", "-shm"].into_iter().filter_map(of).collect();
        Self { file, paths: [path.to_owned(), resolve_links(path)], beside, size: Arc::default() }
    }

    /// What happened to the files; `None` if nothing did.
    pub fn check(&self) -> Option<FileLoss> {
        let own = self.file.metadata().ok()?;
        for path in &self.paths {
            match path.metadata() {
                Ok(m) if (m.dev(), m.ino()) == (own.dev(), own.ino()) => {}
                Ok(_) => return Some(FileLoss::Replaced),
                Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
                    return Some(if own.nlink() == 0 { FileLoss::Deleted } else { FileLoss::Moved });
                }
                // other errors, such as missing permissions, say nothing about the file
                Err(_) => {}
            }
        }
        let [_, real] = &self.paths;
        if self.beside.iter().any(|(end, id)| id_at(&sidecar(real, end)) != Some(*id)) {
            return Some(FileLoss::Log);
        }
        let before = self.size.fetch_max(own.size(), Ordering::Relaxed);
        (own.size() < before && own.size() < self.stated_size()).then_some(FileLoss::Truncated)
    }

    /// The path as given.
    pub fn path(&self) -> &Path {
        &self.paths[0]
    }

    /// Size of the log (bytes).
    pub fn log_bytes(&self) -> u64 {
        sidecar(&self.paths[1], "-wal").metadata().map_or(0, |m| m.len())
    }

    /// The size according to the file's header. Another program may have compacted the database.
    fn stated_size(&self) -> u64 {
        let mut head = [0; 32];
        if self.file.read_exact_at(&mut head, 0).is_err() {
            return u64::MAX;
        }
        let number = |at: usize| head[at..at + 4].iter().fold(0, |all, byte| all << 8 | u64::from(*byte));
        let page = match number(16) >> 16 {
            1 => 1 << 16,
            page => page,
        };
        page * number(28)
    }

    /// The path that the open file has now.
    fn name(&self) -> Option<PathBuf> {
        let known = std::fs::read_link(format!("/proc/self/fd/{}", self.file.as_raw_fd())).ok()?;
        is_still(&self.file, &known).then_some(known)
    }
}

/// Closes a database whose files were taken away. Moves the log into the database if that still has a path; otherwise copies everything
/// into a new file. The error says where the data is.
pub(super) async fn rescue(
    mut connection: SqliteConnection,
    presence: &Presence,
    lost: FileLoss,
) -> StoreError {
    let path = presence.paths[0].clone();
    // a transaction that an error has left open
    let _ = connection.execute("ROLLBACK").await;
    let truncated = lost == FileLoss::Truncated;
    let saved = if truncated && !is_intact(&mut connection).await {
        Err("the recorded data cannot be read any more; restore the file from a backup".to_owned())
    } else if !truncated
        && is_folded(&mut connection).await
        && let Some(name) = presence.name()
    {
        Ok(name)
    } else {
        copied(&mut connection, &presence.paths[1]).await
    };
    // A normal close would delete the log by its path, which may belong to another file now.
    if let Ok(mut handle) = connection.lock_handle().await {
        let db = handle.as_raw_handle().as_ptr();
        let none = std::ptr::null_mut::<std::ffi::c_int>();
        // SAFETY: the handle is locked and open; this option takes a number and a pointer that may be null.
        unsafe { ffi::sqlite3_db_config(db, ffi::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, 1, none) };
    }
    let _ = connection.close().await;
    if saved.is_ok() {
        for (end, id) in &presence.beside {
            let own = sidecar(&presence.paths[1], end);
            if id_at(&own) == Some(*id) {
                let _ = std::fs::remove_file(own);
            }
        }
    }
    StoreError::Lost { path, lost, saved }
}

/// Whether the connection can read the whole database.
async fn is_intact(connection: &mut SqliteConnection) -> bool {
    let checked = sqlx::query_scalar::<_, String>("PRAGMA integrity_check(1)").fetch_one(connection).await;
    checked.is_ok_and(|result| result == "ok")
}

/// Moves the log into the database; whether that succeeded.
async fn is_folded(connection: &mut SqliteConnection) -> bool {
    let folded =
        sqlx::query_as::<_, (i64, i64, i64)>("PRAGMA wal_checkpoint(TRUNCATE)").fetch_one(connection).await;
    folded.is_ok_and(|(blocked, ..)| blocked == 0)
}

/// Copies the database into a new file beside it, or else in the current folder or TMPDIR.
async fn copied(connection: &mut SqliteConnection, path: &Path) -> Result<PathBuf, String> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let mut why = String::new();
    for folder in [files::folder(path).to_owned(), PathBuf::from("."), std::env::temp_dir()] {
        let mut names = (0..).map(|n| folder.join(format!("{stem}.saved-{}-{n}.sqlite", std::process::id())));
        let copy = names.find(|name| !name.exists()).expect("numbers do not end");
        let part = folder.join(format!(".{stem}.{}.tmp", files::own_mark()));
        let _ = std::fs::remove_file(&part);
        let into = part.to_string_lossy().into_owned();
        let made = sqlx::query("VACUUM INTO ?").bind(into).execute(&mut *connection).await;
        let placed_copy = made
            .map_err(|error| error.to_string())
            .and_then(|_| files::put_in_place(&part, &copy).map_err(|error| error.to_string()));
        match placed_copy {
            Ok(()) => return Ok(copy),
            Err(error) => {
                let _ = std::fs::remove_file(&part);
                why = format!("copying the recorded data to {} failed: {error}", copy.display());
            }
        }
    }
    Err(why)
}

#[cfg(test)]
mod tests;
