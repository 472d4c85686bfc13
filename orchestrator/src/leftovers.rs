//! Finds and removes files and folders of killed processes. Names of files on disk end with the mark of
//! the process ([`own_mark`]); a run's directory in shared memory contains a lock, which is free once the run is dead.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use tempfile::TempDir;

use crate::files::own_mark;

/// Minimum age before a file of another machine counts as abandoned.
const ABANDONED: Duration = Duration::from_secs(24 * 3600);

/// Whether the process whose mark ends this name (before `.tmp` or `.sqlite`) has abandoned the file or folder. On this
/// machine: the process has ended. On another machine: nothing was written for a day.
pub fn is_abandoned(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let mark = name.strip_suffix(".tmp").or(name.strip_suffix(".sqlite")).unwrap_or(&name);
    let Some((before, Ok(pid))) = mark.rsplit_once('-').map(|(before, pid)| (before, pid.parse::<u32>()))
    else {
        return false;
    };
    let own = own_mark();
    let host = own.rsplit_once('-').map_or("", |(host, _)| host);
    // Another host's name may end with this one's. Therefore a dot or "merge-" must precede the host name; in a copy of a
    // shard, the start time.
    let began = |part: &str| !part.is_empty() && part.bytes().all(|c| c.is_ascii_digit());
    let here = before.strip_suffix(host).is_some_and(|rest| match rest.rsplit('.').next() {
        None | Some("" | "merge-") => true,
        Some(last) => name.starts_with("shard-") && last.strip_suffix('-').is_some_and(began),
    });
    let written = || path.symlink_metadata().and_then(|m| m.modified()).ok()?.elapsed().ok();
    match here {
        true => !Path::new("/proc").join(pid.to_string()).exists(),
        false => written().is_some_and(|age| age > ABANDONED),
    }
}

/// Abandoned files and folders in a folder whose names satisfy `is_one`.
pub fn abandoned(folder: &Path, is_one: impl Fn(&str) -> bool) -> impl Iterator<Item = PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let named = entries.filter(move |entry| is_one(&entry.file_name().to_string_lossy()));
    named.map(|entry| entry.path()).filter(|path| is_abandoned(path))
}

/// Removes abandoned files and folders; ignores failures.
pub fn remove_abandoned(folder: &Path, is_one: impl Fn(&str) -> bool) {
    for path in abandoned(folder, is_one) {
        let _ = remove(&path);
    }
}

/// A new folder in TMPDIR that is removed when dropped; also removes folders of ended processes.
///
/// # Errors
/// If it cannot be created.
pub fn scratch(prefix: &str) -> io::Result<TempDir> {
    remove_abandoned(&std::env::temp_dir(), |name| name.starts_with(prefix));
    tempfile::Builder::new().prefix(prefix).suffix(&format!(".{}", own_mark())).tempdir()
}

/// Removes a file, or a folder with its contents.
///
/// # Errors
/// If the system fails.
pub fn remove(path: &Path) -> io::Result<()> {
    match path.symlink_metadata()?.is_dir() {
        true => std::fs::remove_dir_all(path),
        false => std::fs::remove_file(path),
    }
}

/// Prefix of the names of runs in shared memory.
pub(crate) const STEM: &str = "metasense-";
/// A run's directory in shared memory without a lock file may belong to a run that is starting, up to this age.
const BIRTH: Duration = Duration::from_secs(60);

/// Removes directories and segments of dead runs and returns their number. Those of other users stay.
pub(crate) fn remove_dead_runs(shared: &Path) -> usize {
    let Ok(entries) = std::fs::read_dir(shared) else { return 0 };
    let mut removed = 0;
    for entry in entries.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let Some(id) = name.strip_prefix(STEM) else { continue };
        match id.split_once('_') {
            Some((id, _)) => {
                if !shared.join(format!("{STEM}{id}")).exists() {
                    removed += usize::from(std::fs::remove_file(entry.path()).is_ok());
                }
            }
            None => {
                if let Some(_lock) = dead_run(&entry.path()) {
                    removed += remove_segments(shared, &format!("{name}_"));
                    removed += usize::from(std::fs::remove_dir_all(entry.path()).is_ok());
                }
            }
        }
    }
    removed
}

/// Removes the segments whose names have this prefix, and returns their number.
pub(crate) fn remove_segments(shared: &Path, prefix: &str) -> usize {
    let Ok(entries) = std::fs::read_dir(shared) else { return 0 };
    let ours = |entry: &std::fs::DirEntry| entry.file_name().to_string_lossy().starts_with(prefix);
    entries.flatten().filter(ours).filter(|entry| std::fs::remove_file(entry.path()).is_ok()).count()
}

/// Opens the lock, or without one the directory, of a dead run; `None` if the run may be alive.
fn dead_run(directory: &Path) -> Option<File> {
    match File::open(directory.join("lock")) {
        Ok(lock) => lock.try_lock().is_ok().then_some(lock),
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            let age = directory.metadata().ok()?.modified().ok()?.elapsed().ok()?;
            (age > BIRTH).then(|| File::open(directory).ok())?
        }
        Err(_) => None,
    }
}

#[cfg(test)]
mod tests;
