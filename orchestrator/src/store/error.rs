//! Errors of databases, with advice.

use std::path::{Path, PathBuf};

use metasense_schemas::database::VERSION;
use metasense_worker::limits::{Needs, check};

use super::presence::FileLoss;
use crate::files::{quoted, sidecar};
use crate::hashes::HashError;

/// `doing` of errors before anything was started.
pub(crate) const OPENING: &str = "opening";

/// Result of an operation on a database.
pub type Result<T, E = StoreError> = std::result::Result<T, E>;

/// An error of the store.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The file or its folder cannot be written.
    #[error("cannot write the database {}; choose another file", .0.display())]
    Unwritable(PathBuf, #[source] std::io::Error),
    /// The database is on this network file system.
    #[error(
        "the database {} would be on {}, a network file system, where SQLite's write-ahead log does not work: \
         choose a file on a disk of this machine; `cluster merge` copies the finished database anywhere",
        .0.display(),
        .1
    )]
    NetworkDisk(PathBuf, String),
    /// Another run uses the database.
    #[error("the database {} is in use by another run; wait for it, or choose another file", .0.display())]
    InUse(PathBuf),
    /// The database files disappeared while it was open for writing.
    #[error("the database {} {lost} during the run: {}", path.display(), saved_words(path, saved))]
    Lost {
        /// The file.
        path: PathBuf,
        /// What happened.
        lost: FileLoss,
        /// Path of the file with all recorded data, or why there is none.
        saved: Result<PathBuf, String>,
    },
    /// The path is not UTF-8.
    #[error("{0:?}: SQLite needs a path in UTF-8; rename the file or folder, or choose another file")]
    NotUtf8(PathBuf),
    /// The file belongs to another program.
    #[error("{} is not a metasense database; choose another file", .0.display())]
    NotOurs(PathBuf),
    /// Written by a newer version of the schema.
    #[error(
        "the database {} has version {}, this program reads version {VERSION}: update metasense, or choose another file",
        .0.display(),
        .1
    )]
    Newer(PathBuf, i64),
    /// Written by an older version of the schema, before release 1.0.
    #[error(
        "the database {} has version {}, this program reads version {VERSION} only: it was written by an older version of \
         metasense; read it with that program (`metasense query {} … --format csv` saves its rows), or run its spec again \
         into another file",
        .0.display(),
        .1,
        quoted(.0)
    )]
    Older(PathBuf, usize),
    /// The database can only be read as a copy, and copying failed.
    #[error(
        "{}: copying it to TMPDIR failed; a copy is needed because it cannot be read in place",
        .0.display()
    )]
    NotCopied(PathBuf, #[source] std::io::Error),
    /// The database was read without locks and has changed meanwhile.
    #[error("{}: has changed while it was read; run the command again", .0.display())]
    Changed(PathBuf),
    /// The database contains trials without their steps, curves and arrays.
    #[error(
        "{} contains only facts, without steps, curves and arrays, so trials cannot be resumed from it; `metasense cluster merge` without \
         --facts makes a complete database",
        .0.display()
    )]
    FactsAlone(PathBuf),
    /// The file with the other data of a trial whose facts were merged cannot be read.
    #[error(
        "{}: the steps, curves and arrays of trial {hash} were in {}, which cannot be read: merge the facts again",
        path.display(),
        file.display()
    )]
    Elsewhere {
        /// The database of facts.
        path: PathBuf,
        /// The trial.
        hash: String,
        /// File with the other data.
        file: PathBuf,
        /// Why it cannot be read.
        source: Box<StoreError>,
    },
    /// The file does not exist.
    #[error("no database {}; `metasense run SPEC` creates it", .0.display())]
    Missing(PathBuf),
    /// SQLite failed `doing` something to the file.
    #[error("{doing} the database {}{}{}", path.display(), hint(source), shortage(path, source))]
    Sql {
        /// The file.
        path: PathBuf,
        /// The failed operation.
        doing: &'static str,
        /// SQLite's error.
        source: sqlx::Error,
    },
    /// A query is not valid SQL or is not allowed, with SQLite's message.
    #[error("the query failed: {0}")]
    Query(String),
    /// A record of a trial's outdated attempt.
    #[error("trial {0}: attempt {1} is not the current one; its record was dropped")]
    Stale(String, u32),
    /// The file contains no trial with this hash.
    #[error("the database {} contains no trial {}", .0.display(), .1)]
    UnknownTrial(PathBuf, String),
    /// The prefix of a hash matches no trial of the file, or several.
    #[error("{}: {}", .0.display(), .1)]
    NotOne(PathBuf, HashError),
    /// A checkpoint or an array of this trial, whose checksum does not match.
    #[error(
        "trial {0}: the stored {1} is damaged (its checksum does not match): remove the trial with `metasense remove DB hash={0} \
         --yes`; `metasense run` then computes it again"
    )]
    Damaged(String, String),
    /// A stored value that this program cannot read.
    #[error(
        "trial {hash}: the stored {what} cannot be read: {message}; if another version of metasense wrote it, use that version, \
         or only `metasense query`"
    )]
    Unreadable {
        /// The trial.
        hash: String,
        /// The value.
        what: &'static str,
        /// Why.
        message: String,
    },
}

impl StoreError {
    /// An SQLite error while `doing` something to a database.
    pub fn sql(path: &Path, doing: &'static str, source: sqlx::Error) -> Self {
        match code(&source) {
            Some(26) => Self::NotOurs(path.to_owned()),
            _ => Self::Sql { path: path.to_owned(), doing, source },
        }
    }

    /// A stored value of a trial cannot be read.
    pub(crate) fn unreadable(hash: &str, what: &'static str, message: impl ToString) -> Self {
        Self::Unreadable { hash: hash.to_owned(), what, message: message.to_string() }
    }

    /// Changes the failed operation to opening.
    pub(crate) fn on_opening(self) -> Self {
        match self {
            Self::Sql { path, source, .. } => Self::Sql { path, doing: OPENING, source },
            other => other,
        }
    }

    /// Whether the file is damaged.
    pub fn is_damage(&self) -> bool {
        matches!(self, Self::Sql { source, .. } if code(source) == Some(11))
    }

    /// Whether the user's input is wrong, rather than the disk, the state of the file or another process.
    pub fn is_bad_input(&self) -> bool {
        match self {
            Self::Sql { doing, source, .. } => *doing == OPENING && !is_trouble(source),
            Self::Unwritable(_, source) => source.kind() != std::io::ErrorKind::StorageFull,
            other => !matches!(
                other,
                Self::Lost { .. }
                    | Self::NotCopied(..)
                    | Self::Changed(..)
                    | Self::InUse(..)
                    | Self::Stale(..)
                    | Self::Damaged(..)
                    | Self::Unreadable { .. }
            ),
        }
    }
}

/// Refuses a path that SQLite cannot open.
pub(crate) fn check_utf8(path: &Path) -> Result<()> {
    match std::path::absolute(path).is_ok_and(|path| path.to_str().is_none()) {
        true => Err(StoreError::NotUtf8(path.to_owned())),
        false => Ok(()),
    }
}

/// Text about where the recorded data is.
fn saved_words(path: &Path, saved: &Result<PathBuf, String>) -> String {
    match saved {
        Ok(saved) if saved == path || Some(saved) == path.canonicalize().ok().as_ref() => {
            "it contains all recorded data; run the same command to resume".into()
        }
        Ok(saved) => {
            let word = quoted(saved);
            format!(
                "all recorded data is in {}; run the same command with --db {word} to resume",
                saved.display()
            )
        }
        Err(why) => why.clone(),
    }
}

/// SQLite's primary result code.
fn code(source: &sqlx::Error) -> Option<u32> {
    let code = source.as_database_error()?.code()?;
    code.parse().ok().map(|code: u32| code & 0xff)
}

/// Whether the file is locked or damaged, or the disk full or failing, so that every statement would fail.
pub(crate) fn is_trouble(source: &sqlx::Error) -> bool {
    matches!(source, sqlx::Error::Io(_)) || matches!(code(source), Some(5 | 6 | 10 | 11 | 13))
}

/// Whether the error is malformed JSON in a column.
pub(crate) fn is_no_json(source: &sqlx::Error) -> bool {
    source.as_database_error().is_some_and(|e| e.message() == "malformed JSON")
}

/// Whether a file of the database could not be opened or written.
pub(crate) fn is_not_opened(source: &sqlx::Error) -> bool {
    matches!(code(source), Some(8 | 14))
}

/// Whether memory, the disk or descriptors are short, rather than the file faulty.
pub(crate) fn is_shortage(source: &sqlx::Error) -> bool {
    matches!(source, sqlx::Error::Io(_)) || matches!(code(source), Some(7 | 8 | 10 | 13 | 14))
}

/// The resource that is short, if SQLite cannot write or open a file; otherwise empty.
fn shortage(path: &Path, source: &sqlx::Error) -> String {
    // Sorted rows go to the temporary folder.
    let (journal, temporary) = (sidecar(path, "-wal"), std::env::temp_dir());
    let needs = Needs { files: &[path, &journal, &temporary], ..Needs::default() };
    let short = matches!(code(source), Some(10 | 13 | 14)).then(|| check(&needs).err()).flatten();
    short.map_or(String::new(), |short| format!(" ({short})"))
}

/// Advice by SQLite's primary result code.
fn hint(source: &sqlx::Error) -> &'static str {
    match code(source) {
        Some(5 | 6) => {
            " failed: another program holds a lock on it and did not release it in time; end that program and run again, nothing \
             recorded is lost"
        }
        Some(8) => " failed: it is read-only; allow writing, or choose another file",
        Some(10) => " failed: the disk reports an error",
        Some(11) => " failed: the file is damaged; restore it from a copy",
        Some(13) => " failed: the disk is full; free space and run again; nothing recorded is lost",
        Some(14) => " failed: it cannot be opened; check the folder and its permissions",
        _ => " failed",
    }
}
