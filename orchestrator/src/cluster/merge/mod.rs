//! Merges databases into one. The rows of the result do not depend on the order of the files or on duplicates.
//!
//! Keeps the most advanced copy of each trial as a whole, with its attempts, steps, networks and arrays; or only its facts and
//! the path of the file with the rest. The result is built in a temporary folder and renamed into place, so a killed merge
//! changes nothing. An existing result is copied and extended, without reading its sources again. Inputs are never changed.

mod compare;
mod contains;
mod copy;
mod input;

use std::collections::HashMap;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use metasense_schemas::database::VERSION;
use sqlx::Connection;
use sqlx::sqlite::SqliteConnection;

use crate::files;
use crate::leftovers;
use crate::reader;
use crate::store::{self, StoreError};
pub use compare::{FindingKind, MergeFinding};
pub use contains::contains;
pub(super) use input::snapshot;
use input::{Input, InputError};

/// Which parts of a trial are merged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Extent {
    /// All.
    Whole,
    /// All except steps, curves, arrays and checkpoints: some kB per trial.
    Facts,
}

/// Result of a merge.
#[derive(Debug, Default)]
pub struct Summary {
    /// Number of merged databases, including `known`, without the existing result.
    pub read: usize,
    /// Number of unchanged databases that were in the result before and were not read again.
    pub known: usize,
    /// Unreadable files with reasons; they contribute nothing.
    pub refused: Vec<(PathBuf, String)>,
    /// Number of trials in the result.
    pub trials: usize,
    /// Number of discarded copies without new data: earlier states of the same run, or equal results.
    pub covered: usize,
    /// Number of discarded copies with other instruction sets, whose results were not compared.
    pub not_compared: usize,
    /// Discarded data and differences.
    pub findings: Vec<MergeFinding>,
    /// Shards without a run in any database: (sweep, number of shards, missing ones).
    pub missing: Vec<(String, u32, Vec<u32>)>,
}

/// Errors of a merge.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum MergeError {
    /// The result cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The result cannot be written.
    #[error("cannot write the merged database {}", path.display())]
    Unwritable { path: PathBuf, source: std::io::Error },
    /// The existing result cannot be merged with.
    #[error(
        "{} exists and cannot be merged with; it is unchanged: move it away, or choose another file",
        path.display()
    )]
    Result { path: PathBuf, source: Box<StoreError> },
    /// Facts cannot be merged into whole trials.
    #[error("{} contains whole trials; merge facts into another file", .0.display())]
    NotFacts(PathBuf),
    /// An input could not be read for lack of a resource.
    #[error("cannot merge {} into {}; nothing was changed", input.display(), out.display())]
    Stopped { input: PathBuf, out: PathBuf, source: Box<sqlx::Error> },
    /// An SQLite error.
    #[error("cannot write the merged database {}", path.display())]
    Sql { path: PathBuf, source: sqlx::Error },
    /// The folder has no databases, or all files are unreadable.
    #[error("nothing to merge: none of the files is a database that can be read{}", first(refused))]
    Nothing { refused: Vec<(PathBuf, String)> },
}

impl MergeError {
    /// Whether a run or another merge uses the result.
    pub(super) fn is_in_use(&self) -> bool {
        matches!(self, Self::Store(StoreError::InUse(..)))
    }
}

fn first(refused: &[(PathBuf, String)]) -> String {
    refused.first().map_or(String::new(), |(path, why)| format!("; {}: {why}", path.display()))
}

/// Merges `files` into `out`, an existing `out` included, and excludes runs and other merges from it meanwhile. For facts, the
/// last file with a trial takes precedence.
///
/// # Errors
/// If the result is in use, unwritable, unreadable or of another extent, or if no file can be read.
pub async fn merge(extent: Extent, files: &[PathBuf], out: &Path) -> Result<Summary, MergeError> {
    // A shard may delete a copy during the merge, because a later copy contains it. Then list the folder again.
    let gone = |(file, _): &(PathBuf, String)| !file.exists() && !files.contains(file);
    for _ in 1..LOOKS {
        match merge_once(extent, files, out).await {
            Ok(summary) if summary.refused.iter().any(gone) => {}
            Err(MergeError::Nothing { refused }) if refused.iter().any(gone) => {}
            merged => return merged,
        }
    }
    merge_once(extent, files, out).await
}

async fn merge_once(extent: Extent, files: &[PathBuf], out: &Path) -> Result<Summary, MergeError> {
    let out = &files::resolve_links(out);
    store::check_utf8(out)?;
    let unwritable = |source| MergeError::Unwritable { path: out.to_owned(), source };
    let folder = files::folder(out);
    std::fs::create_dir_all(folder).map_err(unwritable)?;
    let is_new = !out.exists();
    let lock = keep_writers_out(out)?;
    let prefix = format!(".{}.merge-", name_of(out));
    leftovers::remove_abandoned(folder, |name| name.starts_with(&prefix));
    let scratch = folder.join(prefix + &files::own_mark());
    let _ = std::fs::remove_dir_all(&scratch);
    let summary = match std::fs::create_dir(&scratch) {
        Ok(()) => merge_in(&scratch, extent, files, out, &lock).await,
        Err(e) => Err(unwritable(e)),
    };
    let _ = std::fs::remove_dir_all(&scratch);
    if summary.is_err() && is_new && files::is_still(&lock, out) {
        let _ = std::fs::remove_file(out);
    }
    summary
}

/// Locks the result against runs and other merges until it is renamed into place; creates it if missing.
fn keep_writers_out(out: &Path) -> Result<File, MergeError> {
    match store::lock(out, true) {
        // Continue on file systems without locks.
        Err(StoreError::Unwritable(_, source)) if has_no_locks(&source) => {
            File::open(out).map_err(|source| MergeError::Unwritable { path: out.to_owned(), source })
        }
        Err(StoreError::Unwritable(path, source)) => Err(MergeError::Unwritable { path, source }),
        locked => Ok(locked?),
    }
}

fn has_no_locks(e: &io::Error) -> bool {
    e.kind() == io::ErrorKind::Unsupported || e.raw_os_error() == Some(libc::ENOLCK)
}

async fn merge_in(
    scratch: &Path,
    extent: Extent,
    files: &[PathBuf],
    out: &Path,
    lock: &File,
) -> Result<Summary, MergeError> {
    let mut summary = Summary::default();
    let of_result = |source| MergeError::Result { path: out.to_owned(), source: Box::new(source) };
    let stopped = |input: &Path, source| {
        let (input, out, source) = (input.to_owned(), out.to_owned(), Box::new(source));
        MergeError::Stopped { input, out, source }
    };
    // why an input is refused
    let reason = |input: &Path, e: InputError| match e {
        InputError::Shortage(source) => Err(stopped(input, source)),
        InputError::Input(why) => Ok(why),
        InputError::Changed => Ok(CHANGES.to_owned()),
    };
    let checked = check_result(out).await;
    checked.map_err(|e| if let StoreError::InUse(..) = e { e.into() } else { of_result(e) })?;
    let ([facts, whole], known) =
        read_sources(out).await.map_err(|e| of_result(StoreError::sql(out, "reading", e)))?;
    match extent {
        Extent::Whole if facts => return Err(of_result(StoreError::FactsAlone(out.to_owned()))),
        Extent::Facts if whole => return Err(MergeError::NotFacts(out.to_owned())),
        _ => {}
    }
    let is_known = |file: &Path| known.get(file).is_some_and(|state| input::is_as_before(file, state));
    let mut inputs = Vec::new();
    let mut copies = (0..).map(|n| scratch.join(format!("input-{n}.sqlite")));
    let mut copy = || copies.next().expect("numbers do not end");
    for file in distinct(files, out) {
        if is_known(&files::resolve_links(&file)) {
            summary.known += 1;
            continue;
        }
        match opened(&file, &mut copy, files::resolve_links(&file) == out).await {
            Ok(input) => inputs.push(input),
            Err(e) => summary.refused.push((file.clone(), reason(&file, e)?)),
        }
    }
    if summary.known > 0 && inputs.iter().all(|input| input.file == out) {
        let asked = reader::ask_unchanging(out, async |db| {
            Ok((copy::trials(db).await?, compare::missing_shards(db).await?))
        });
        (summary.trials, summary.missing) =
            asked.await.map_err(|e| of_result(StoreError::sql(out, "reading", e)))?;
        summary.read = summary.known;
        return Ok(summary);
    }
    let unwritable = |source| MergeError::Unwritable { path: out.to_owned(), source };
    let built = scratch.join("merged.sqlite");
    loop {
        if inputs.is_empty() {
            return Err(MergeError::Nothing { refused: summary.refused });
        }
        let base = inputs.iter().position(|input| input.file == out);
        let (i, why) = match build(&built, extent, base, &inputs, &mut summary).await {
            Ok(()) => break,
            Err(BuildError::Output(source)) => return Err(MergeError::Sql { path: out.to_owned(), source }),
            Err(BuildError::Input(i, source)) if store::is_shortage(&source) => {
                return Err(stopped(&inputs[i].named, source));
            }
            Err(BuildError::Input(i, source)) if Some(i) == base => {
                return Err(of_result(StoreError::sql(out, "reading", source)));
            }
            Err(BuildError::Input(i, source)) => (i, format!("it cannot be read: {source}")),
            Err(BuildError::Refused(i, InputError::Changed)) => {
                // Read it as it is now; if a process writes to it, make a copy, which does not change.
                match opened(&inputs[i].named, &mut copy, false).await {
                    Ok(input) => {
                        inputs[i] = input;
                        std::fs::remove_file(&built).map_err(unwritable)?;
                        continue;
                    }
                    Err(e) => (i, reason(&inputs[i].named, e)?),
                }
            }
            Err(BuildError::Refused(i, e)) => (i, reason(&inputs[i].named, e)?),
        };
        summary.refused.push((inputs.remove(i).named, why));
        std::fs::remove_file(&built).map_err(unwritable)?;
    }
    summary.read = inputs.iter().filter(|input| input.file != out).count() + summary.known;
    put_in_place(&built, out, lock).await?;
    Ok(summary)
}

/// Message for an input that changes again and again.
const CHANGES: &str = "it keeps changing: merge again when runs and merges into it have ended";
/// Attempts to read a changing input.
const LOOKS: usize = 5;

/// Opens an input; retries if a run starts or ends on it meanwhile.
async fn opened(file: &Path, copy: &mut impl FnMut() -> PathBuf, held: bool) -> Result<Input, InputError> {
    for _ in 1..LOOKS {
        match Input::open(file, &copy(), held).await {
            Err(InputError::Changed) => {}
            input => return input,
        }
    }
    Input::open(file, &copy(), held).await
}

/// Checks that the existing result can be merged with, after moving the log of a killed run into it.
async fn check_result(out: &Path) -> Result<(), StoreError> {
    input::checkpoint_log(out, false).await?;
    let version = reader::ask_unchanging(out, async |db| Ok(store::check_version(db, out).await)).await;
    version.map_err(|source| StoreError::sql(out, "reading", source))?.map(|_| ())
}

/// Replaces the former result, which is complete until then. Its log is moved into it and deleted first, because SQLite would
/// apply it to the new file.
async fn put_in_place(built: &Path, out: &Path, lock: &File) -> Result<(), MergeError> {
    let unwritable = |source| MergeError::Unwritable { path: out.to_owned(), source };
    if !files::is_still(lock, out) {
        return Err(StoreError::InUse(out.to_owned()).into());
    }
    input::checkpoint_log(out, false).await?;
    for journal in ["-wal", "-shm"] {
        let _ = std::fs::remove_file(files::sidecar(out, journal));
    }
    files::put_in_place(built, out).map_err(unwritable)
}

/// An error with its place: an input, or the result.
#[derive(Debug)]
enum BuildError {
    Input(usize, sqlx::Error),
    Refused(usize, InputError),
    Output(sqlx::Error),
}

/// Builds the result. `base`: index of the input that is the former result, which is extended.
async fn build(
    path: &Path,
    extent: Extent,
    base: Option<usize>,
    inputs: &[Input],
    summary: &mut Summary,
) -> Result<(), BuildError> {
    if let Some(i) = base {
        std::fs::copy(&inputs[i].path, path).map_err(|e| BuildError::Output(e.into()))?;
    }
    let mut out = copy::open(path).await.map_err(BuildError::Output)?;
    for (i, input) in inputs.iter().enumerate() {
        let refused = attached(&mut out, i, input, async |out| {
            if let Some(column) = copy::foreign(out).await? {
                return Ok(Some(format!("its {column} is not a stored column of version {VERSION}")));
            }
            if Some(i) != base && copy::extents(out, "src").await?[0] {
                return Ok(Some(
                    "it contains only facts: pass the databases of the shards instead".to_owned(),
                ));
            }
            copy::survey(out, i).await.map(|()| None)
        });
        if let Some(why) = refused.await? {
            return Err(BuildError::Refused(i, InputError::Input(why)));
        }
    }
    if extent == Extent::Whole {
        for (i, input) in inputs.iter().enumerate() {
            attached(&mut out, i, input, async |out| copy::verify(out, i, Some(i) == base).await).await?;
        }
    }
    copy::choose(&mut out, base, extent).await.map_err(BuildError::Output)?;
    if let Some(base) = base {
        copy::make_room(&mut out, base).await.map_err(BuildError::Output)?;
    }
    for (i, input) in inputs.iter().enumerate().filter(|(i, _)| Some(*i) != base) {
        attached(&mut out, i, input, async |out| copy::copy(out, i, &input.file, extent).await).await?;
    }
    copy::finish(&mut out).await.map_err(BuildError::Output)?;
    (summary.findings, summary.covered, summary.not_compared) = (Vec::new(), 0, 0);
    if extent == Extent::Whole {
        compare::damaged(&mut out, inputs, summary).await.map_err(BuildError::Output)?;
        let losers = compare::losers(&mut out).await.map_err(BuildError::Output)?;
        for (i, input) in inputs.iter().enumerate().filter(|(i, _)| losers.contains(i)) {
            attached(&mut out, i, input, async |out| compare::compare(out, i, inputs, summary).await).await?;
        }
        summary.findings.sort();
    }
    // Files with findings are read and reported again by the next merge, so do not note their state.
    let is_said = |input: &Input| summary.findings.iter().any(|f| f.other == input.named);
    let noted = inputs.iter().filter(|input| !is_said(input));
    let noted = noted.filter_map(|input| Some((&*input.file, input.state.as_deref()?)));
    copy::note(&mut out, noted).await.map_err(BuildError::Output)?;
    summary.trials = copy::trials(&mut out).await.map_err(BuildError::Output)?;
    summary.missing = compare::missing_shards(&mut out).await.map_err(BuildError::Output)?;
    out.close().await.map_err(BuildError::Output)
}

/// Files in a result by real path, with their states at that time.
type SourceStates = HashMap<PathBuf, String>;

/// The extents of a result, as in [`copy::extents`], and its files.
async fn read_sources(out: &Path) -> sqlx::Result<([bool; 2], SourceStates)> {
    let sql = "SELECT file, state FROM source WHERE state IS NOT NULL";
    reader::ask_unchanging(out, async |db| {
        if store::version(db).await? == 0 {
            return Ok(([false, out.metadata()?.len() > 0], SourceStates::new()));
        }
        let rows: Vec<(String, String)> = sqlx::query_as(sql).fetch_all(&mut *db).await?;
        let known = rows.into_iter().map(|(file, state)| (file.into(), state)).collect();
        Ok((copy::extents(db, "main").await?, known))
    })
    .await
}

/// Runs `work` with an input attached as `src`.
async fn attached<T>(
    out: &mut SqliteConnection,
    i: usize,
    input: &Input,
    work: impl AsyncFnOnce(&mut SqliteConnection) -> sqlx::Result<T>,
) -> Result<T, BuildError> {
    let _lock = input.hold().map_err(|why| BuildError::Refused(i, why))?;
    let blame = |e: sqlx::Error| BuildError::Input(i, e);
    sqlx::query("ATTACH ? AS src").bind(input.uri()).execute(&mut *out).await.map_err(blame)?;
    // After an error it may stay attached; then the built file is discarded.
    let done = work(out).await.map_err(blame)?;
    sqlx::query("DETACH src").execute(&mut *out).await.map_err(BuildError::Output)?;
    Ok(done)
}

/// Paths without duplicates, folders replaced by their databases, plus an existing result.
fn distinct(files: &[PathBuf], out: &Path) -> Vec<PathBuf> {
    let is_database = |path: &PathBuf| path.extension().is_some_and(|e| e == "sqlite");
    let mut all = Vec::new();
    for file in files {
        match std::fs::read_dir(file) {
            Ok(entries) => all.extend(entries.flatten().map(|entry| entry.path()).filter(is_database)),
            Err(_) => all.push(file.clone()),
        }
    }
    // An empty file was created by `keep_writers_out`.
    match out.metadata().is_ok_and(|m| m.len() > 0) {
        true => all.push(out.to_owned()),
        false => all.retain(|file| files::resolve_links(file) != out),
    }
    // Sorted, so that rows without an order are in the same order, too.
    all.sort();
    let mut seen = std::collections::HashSet::new();
    all.retain(|file| seen.insert(files::resolve_links(file)));
    all
}

fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests;
