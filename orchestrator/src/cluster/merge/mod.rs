//! Databases into one: the same rows whatever the order of the files, and however often each is named.
//!
//! Of each trial the copy that has come farthest is kept, whole: its attempts, steps, networks and arrays. The result is
//! built beside its place and renamed into it, so that a merge that is killed has done nothing. Inputs are never
//! written to. An existing result is one more input.

mod compare;
mod copy;
mod input;

use std::path::{Path, PathBuf};

use sqlx::Connection;
use sqlx::sqlite::SqliteConnection;

use crate::files;
use crate::store::StoreError;
pub use compare::{Finding, Kind};
use input::Input;
pub(super) use input::snapshot;

/// What a merge came to.
#[derive(Debug, Default)]
pub struct Summary {
    /// Databases read.
    pub read: usize,
    /// Files that could not be read, and why; nothing of theirs is in the result.
    pub refused: Vec<(PathBuf, String)>,
    /// Trials in the result.
    pub trials: usize,
    /// Copies of trials that hold nothing that is not in the result: older states of the same run, or equal results.
    pub covered: usize,
    /// Copies whose results were not compared with those kept: other instruction sets.
    pub not_compared: usize,
    /// What is left out or disagrees.
    pub findings: Vec<Finding>,
    /// Shards that no database has a run of, by their number: (sweep, shards, missing).
    pub missing: Vec<(String, u32, Vec<u32>)>,
}

/// Why nothing could be merged.
#[derive(Debug, thiserror::Error)]
pub enum MergeError {
    /// The result.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The result cannot be made.
    #[error("cannot write the merged database {}", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// SQLite refused.
    #[error("cannot write the merged database {}", path.display())]
    Sql {
        /// The file.
        path: PathBuf,
        /// What it said.
        source: sqlx::Error,
    },
    /// A folder without databases, or files that are all refused.
    #[error("nothing to merge: none of the files is a database that can be read{}", first(refused))]
    Nothing {
        /// Files, and why they were refused.
        refused: Vec<(PathBuf, String)>,
    },
}

fn first(refused: &[(PathBuf, String)]) -> String {
    refused.first().map_or(String::new(), |(path, why)| format!("; {}: {why}", path.display()))
}

/// Merges `files` into `out`, which is one of them if it exists.
///
/// # Errors
/// If the result is in use, cannot be written, or nothing can be read.
pub async fn merge(files: &[PathBuf], out: &Path) -> Result<Summary, MergeError> {
    let unwritable = |source| MergeError::Unwritable { path: out.to_owned(), source };
    let folder = files::folder(out);
    std::fs::create_dir_all(folder).map_err(unwritable)?;
    let _lock = input::keep_writers_out(out)?;
    let scratch = folder.join(format!(".{}.merge-{}", name_of(out), std::process::id()));
    let _ = std::fs::remove_dir_all(&scratch);
    std::fs::create_dir(&scratch).map_err(unwritable)?;
    let summary = merge_in(&scratch, files, out).await;
    let _ = std::fs::remove_dir_all(&scratch);
    summary
}

async fn merge_in(scratch: &Path, files: &[PathBuf], out: &Path) -> Result<Summary, MergeError> {
    let mut summary = Summary::default();
    let mut inputs = Vec::new();
    for file in distinct(files, out) {
        match Input::open(&file, scratch, inputs.len()).await {
            Ok(input) => inputs.push(input),
            Err(why) => summary.refused.push((file, why)),
        }
    }
    let unwritable = |source| MergeError::Unwritable { path: out.to_owned(), source };
    let built = scratch.join("merged.sqlite");
    loop {
        if inputs.is_empty() {
            return Err(MergeError::Nothing { refused: summary.refused });
        }
        match build(&built, &inputs, &mut summary).await {
            Ok(()) => break,
            Err(Trouble::Input(i, source)) => {
                let input = inputs.remove(i);
                summary.refused.push((input.named, format!("it cannot be read: {source}")));
                std::fs::remove_file(&built).map_err(unwritable)?;
            }
            Err(Trouble::Output(source)) => {
                return Err(MergeError::Sql { path: out.to_owned(), source });
            }
        }
    }
    summary.read = inputs.len();
    put_in_place(&built, out).await?;
    Ok(summary)
}

/// Puts what was built where the former result lies, which is whole until then: a log that a killed run has left beside it
/// would be taken for the new one's, and goes when all that it holds is in the former file.
async fn put_in_place(built: &Path, out: &Path) -> Result<(), MergeError> {
    let unwritable = |source| MergeError::Unwritable { path: out.to_owned(), source };
    input::fold(out).await?;
    for journal in ["-wal", "-shm"] {
        let _ = std::fs::remove_file(input::beside(out, journal));
    }
    files::put_in_place(built, out).map_err(unwritable)
}

/// Where something went wrong: in an input, or in what is made.
#[derive(Debug)]
enum Trouble {
    Input(usize, sqlx::Error),
    Output(sqlx::Error),
}

async fn build(path: &Path, inputs: &[Input], summary: &mut Summary) -> Result<(), Trouble> {
    let mut out = copy::create(path).await.map_err(Trouble::Output)?;
    for (i, input) in inputs.iter().enumerate() {
        attached(&mut out, i, input, async |out| copy::survey(out, i).await).await?;
    }
    copy::choose(&mut out).await.map_err(Trouble::Output)?;
    for (i, input) in inputs.iter().enumerate() {
        attached(&mut out, i, input, async |out| copy::copy(out, i).await).await?;
    }
    copy::finish(&mut out).await.map_err(Trouble::Output)?;
    let losers = compare::losers(&mut out).await.map_err(Trouble::Output)?;
    (summary.findings, summary.covered, summary.not_compared) = (Vec::new(), 0, 0);
    for (i, input) in inputs.iter().enumerate().filter(|(i, _)| losers.contains(i)) {
        attached(&mut out, i, input, async |out| compare::compare(out, i, inputs, summary).await).await?;
    }
    summary.findings.sort();
    summary.trials = copy::trials(&mut out).await.map_err(Trouble::Output)?;
    summary.missing = compare::missing_shards(&mut out).await.map_err(Trouble::Output)?;
    out.close().await.map_err(Trouble::Output)
}

/// Does something with an input attached as `src`.
async fn attached(
    out: &mut SqliteConnection,
    i: usize,
    input: &Input,
    work: impl AsyncFnOnce(&mut SqliteConnection) -> sqlx::Result<()>,
) -> Result<(), Trouble> {
    let blame = |e: sqlx::Error| match e.as_database_error().and_then(|e| e.code()).as_deref() {
        // full, read-only, out of memory: nothing that an input can be blamed for
        Some("13" | "8" | "7") => Trouble::Output(e),
        _ => Trouble::Input(i, e),
    };
    sqlx::query("ATTACH ? AS src").bind(&input.uri).execute(&mut *out).await.map_err(blame)?;
    let done = work(out).await;
    sqlx::query("DETACH src").execute(&mut *out).await.map_err(Trouble::Output)?;
    done.map_err(blame)
}

/// Each file once, the databases of a folder for the folder, and the result if there is one already.
fn distinct(files: &[PathBuf], out: &Path) -> Vec<PathBuf> {
    let is_database = |path: &PathBuf| path.extension().is_some_and(|e| e == "sqlite");
    let mut all = Vec::new();
    for file in files {
        match std::fs::read_dir(file) {
            Ok(entries) => all.extend(entries.flatten().map(|entry| entry.path()).filter(is_database)),
            Err(_) => all.push(file.clone()),
        }
    }
    if out.metadata().is_ok_and(|m| m.len() > 0) {
        all.push(out.to_owned());
    }
    // Sorted, so that also the order of rows without an order is the same.
    all.sort();
    let mut seen = std::collections::HashSet::new();
    all.retain(|file| seen.insert(file.canonicalize().unwrap_or_else(|_| file.clone())));
    all
}

fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests;
