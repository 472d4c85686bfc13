//! Atomic file writes: to a temporary file in the same folder, renamed when complete. Readers find the old or the new file,
//! even after a power cut.

pub(crate) mod disk;

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read, Write};
use std::os::fd::{BorrowedFd, RawFd};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::SystemTime;

use crate::leftovers;

/// A path as a word of a shell command.
pub fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,@%+".contains(c);
    if !text.is_empty() && text.chars().all(plain) {
        text
    } else {
        format!("'{}'", text.replace('\'', r"'\''"))
    }
}

/// Reads the text of a spec.
///
/// # Errors
/// If the system fails; `InvalidData`, with a message that names the file, for a database or other encodings than UTF-8.
pub fn read_spec(path: &Path) -> io::Result<String> {
    let (file, word) = (path.display(), quoted(path));
    let refused = |why: String| io::Error::new(io::ErrorKind::InvalidData, why);
    if is_database(path) {
        return Err(refused(format!(
            "{file} is a database; SPEC must be the .toml file of a sweep (metasense query {word} \"SELECT text FROM sweep\")"
        )));
    }
    let text = String::from_utf8(std::fs::read(path)?);
    text.map_err(|_| refused(format!("{file} is not UTF-8 (UTF-16 or Latin-1?): save it as UTF-8")))
}

/// The folder that contains a file; "." for a bare file name.
pub fn folder(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Name of this machine.
pub fn host() -> String {
    std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default().trim().to_owned()
}

/// A host name as part of a file name.
pub(crate) fn mark_of(host: &str) -> String {
    host.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect()
}

/// Host name and process id of this process, as a unique part of file names.
pub fn own_mark() -> String {
    format!("{}-{}", mark_of(&host()), std::process::id())
}

/// Eight hex digits that are unique to this machine, process and call.
pub fn fresh_mark() -> String {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let (mark, now, count) = (own_mark(), SystemTime::now(), COUNT.fetch_add(1, Ordering::Relaxed));
    blake3::hash(format!("{mark} {now:?} {count}").as_bytes()).to_hex()[..8].to_owned()
}

/// Whether PATH contains a program of this name.
pub fn is_in_path(program: &str) -> bool {
    let paths = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&paths).any(|folder| folder.join(program).is_file())
}

/// Whether another process has an exclusive lock on a file; false if the file system has no locks.
pub(crate) fn is_held(file: &File) -> bool {
    matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock))
}

/// Resolves links: the write-ahead log lies beside the file, not beside the link.
pub(crate) fn resolve_links(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}

/// Path of the file beside a database whose name has `end` appended; resolves links.
pub(crate) fn sidecar(file: &Path, end: &str) -> PathBuf {
    let mut name = resolve_links(file).into_os_string();
    name.push(end);
    name.into()
}

/// Whether a non-empty write-ahead log exists.
pub(crate) fn has_journal(file: &Path) -> bool {
    sidecar(file, "-wal").metadata().is_ok_and(|m| m.len() > 0)
}

/// Whether a path still refers to an open file.
pub(crate) fn is_still(file: &File, path: &Path) -> bool {
    let names = |m: std::fs::Metadata| (m.dev(), m.ino());
    file.metadata().ok().map(names) == path.metadata().ok().map(names)
}

/// Moves a finished file over another on the same file system. On return, the result is on disk.
///
/// # Errors
/// If the system fails. The old file remains, unless only syncing the folder failed.
pub fn put_in_place(finished: &Path, path: &Path) -> io::Result<()> {
    File::open(finished)?.sync_all()?;
    std::fs::rename(finished, path)?;
    File::open(folder(path))?.sync_all()
}

/// Writes a whole file atomically with [`Output`].
///
/// # Errors
/// If the system fails or the target is a database; the old file remains.
pub fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut output = Output::create(path)?;
    output.write_all(bytes)?;
    output.finish()
}

/// Copies a file and its permissions atomically with [`Output`].
///
/// # Errors
/// As [`write`], or if `from` cannot be read.
pub fn copy(from: &Path, path: &Path) -> io::Result<()> {
    let mut from = File::open(from)?;
    let mut output = Output::create(path)?;
    io::copy(&mut from, &mut output.file)?;
    output.file.set_permissions(from.metadata()?.permissions())?;
    output.finish()
}

/// Whether a file is a pipe, a device, or an open file of this process such as /dev/stdout.
pub fn is_stream(path: &Path) -> bool {
    own_descriptor(path).is_some() || path.metadata().is_ok_and(|file| !file.is_file() && !file.is_dir())
}

/// The descriptor of this process that a path names, such as /dev/stdout or /dev/fd/3.
fn own_descriptor(path: &Path) -> Option<RawFd> {
    let (own, mut path) = (Path::new("/proc/self/fd").canonicalize().ok()?, path.to_owned());
    // A path may be a link to a link.
    for _ in 0..4 {
        if folder(&path).canonicalize().ok()? == own {
            return path.file_name()?.to_str()?.parse::<RawFd>().ok().filter(|number| *number >= 0);
        }
        path = folder(&path).join(path.read_link().ok()?);
    }
    None
}

/// A temporary file that [`Output::finish`] renames to its target; dropping it before deletes it. Pipes, devices and open files
/// of this process are written to directly; symbolic links and permissions are kept.
#[derive(Debug)]
pub struct Output {
    file: File,
    /// Temporary path and target.
    whole: Option<(PathBuf, PathBuf)>,
}

impl Output {
    /// Creates the temporary file.
    ///
    /// # Errors
    /// If the system fails or the target is a database, which must not be replaced.
    pub fn create(path: &Path) -> io::Result<Self> {
        if let Some(number) = own_descriptor(path) {
            // SAFETY: a number that is not open is an error of the duplication.
            let open = unsafe { BorrowedFd::borrow_raw(number) };
            return Ok(Self { file: open.try_clone_to_owned()?.into(), whole: None });
        }
        let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        let before = path.metadata().ok();
        if before.as_ref().is_some_and(|before| !before.is_file()) {
            return Ok(Self { file: OpenOptions::new().write(true).open(path)?, whole: None });
        }
        if before.is_some() && is_database(&path) {
            return Err(io::Error::new(
                io::ErrorKind::AlreadyExists,
                "it is a database, which only `run` and `cluster merge` may write; choose another file",
            ));
        }
        let name = path.file_name().ok_or(io::ErrorKind::InvalidFilename)?.to_string_lossy();
        let (prefix, mark) = (format!(".{name}."), own_mark());
        // Marks contain no dot.
        let mark_in = |found: &str| Some(!found.strip_prefix(&prefix)?.strip_suffix(".tmp")?.contains('.'));
        leftovers::remove_abandoned(folder(&path), |found| mark_in(found).unwrap_or(false));
        let beside = path.with_file_name(format!("{prefix}{mark}.tmp"));
        let file = File::create(&beside)?;
        let output = Self { file, whole: Some((beside, path)) };
        before.map_or(Ok(()), |before| output.file.set_permissions(before.permissions()))?;
        Ok(output)
    }

    /// Renames the file to its target. On return, it is on disk.
    ///
    /// # Errors
    /// If the system fails; the old file remains.
    pub fn finish(mut self) -> io::Result<()> {
        if let Some((beside, path)) = &self.whole {
            put_in_place(beside, path)?;
            self.whole = None;
        }
        Ok(())
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        if let Some((beside, _)) = &self.whole {
            let _ = std::fs::remove_file(beside);
        }
    }
}

/// Whether a file starts with the SQLite signature.
pub(crate) fn is_database(path: &Path) -> bool {
    const MAGIC: &[u8] = b"SQLite format 3\0";
    let mut head = Vec::new();
    // Bytes that are read from a pipe are lost.
    let mut read = || File::open(path)?.take(MAGIC.len() as u64).read_to_end(&mut head);
    path.is_file() && read().is_ok() && head == MAGIC
}

#[cfg(test)]
mod tests;
