//! Whole files: written beside their place and renamed into it. Whoever reads finds the old one or the new one, also after
//! a power cut.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::SystemTime;

/// The folder that a file is in.
#[must_use]
pub fn folder(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Name of this machine.
#[must_use]
pub fn host() -> String {
    std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default().trim().to_owned()
}

/// A machine, as part of a file's name.
pub(crate) fn mark_of(host: &str) -> String {
    host.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect()
}

/// This machine and process, as part of a file's name that no other has.
#[must_use]
pub fn own_mark() -> String {
    format!("{}-{}", mark_of(&host()), std::process::id())
}

/// This machine, process and moment in a few characters, for names that no other thing has.
#[must_use]
pub fn fresh_mark() -> String {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let (mark, now, count) = (own_mark(), SystemTime::now(), COUNT.fetch_add(1, Ordering::Relaxed));
    blake3::hash(format!("{mark} {now:?} {count}").as_bytes()).to_hex()[..8].to_owned()
}

/// Whether a program of this name can be started.
#[must_use]
pub fn is_in_path(program: &str) -> bool {
    let paths = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&paths).any(|folder| folder.join(program).is_file())
}

/// Whether somebody has a file to itself. Where there are no locks, nobody has.
pub(crate) fn is_held(file: &File) -> bool {
    matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock))
}

/// Puts a finished file in another's place, on the same file system. When this returns, it is on disk.
///
/// # Errors
/// Where the system fails; what lay there before does so still, unless it is the folder that cannot be written to disk.
pub fn put_in_place(finished: &Path, path: &Path) -> io::Result<()> {
    File::open(finished)?.sync_all()?;
    std::fs::rename(finished, path)?;
    File::open(folder(path))?.sync_all()
}

/// Writes a whole file, as [`Output`] does.
///
/// # Errors
/// Where the system fails or a database lies there; what lay there before does so still.
pub fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut output = Output::create(path)?;
    output.write_all(bytes)?;
    output.finish()
}

/// Copies a whole file with its permissions, as [`Output`] writes one.
///
/// # Errors
/// As [`write`], or where `from` cannot be read.
pub fn copy(from: &Path, path: &Path) -> io::Result<()> {
    let mut from = File::open(from)?;
    let mut output = Output::create(path)?;
    io::copy(&mut from, &mut output.file)?;
    output.file.set_permissions(from.metadata()?.permissions())?;
    output.finish()
}

/// A file that is written beside its place, and put there when it is whole; dropped before that, it leaves nothing. What is
/// no file (a pipe, a terminal) is written to as it is; a link stays one; permissions stay.
#[derive(Debug)]
pub struct Output {
    file: File,
    /// The file beside, and its place.
    whole: Option<(PathBuf, PathBuf)>,
}

impl Output {
    /// Begins a file.
    ///
    /// # Errors
    /// Where the system fails, or a database lies there: nothing that writes whole files may take its place.
    pub fn create(path: &Path) -> io::Result<Self> {
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
        let beside = path.with_file_name(format!(".{name}.{}.tmp", own_mark()));
        let file = File::create(&beside)?;
        let output = Self { file, whole: Some((beside, path)) };
        before.map_or(Ok(()), |before| output.file.set_permissions(before.permissions()))?;
        Ok(output)
    }

    /// Puts the file in its place. When this returns, it is on disk.
    ///
    /// # Errors
    /// Where the system fails; what lay there before does so still.
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

/// Whether a file begins as SQLite's do.
pub(crate) fn is_database(path: &Path) -> bool {
    const MAGIC: &[u8] = b"SQLite format 3\0";
    let mut head = Vec::new();
    let read = File::open(path).and_then(|file| file.take(MAGIC.len() as u64).read_to_end(&mut head));
    read.is_ok() && head == MAGIC
}

#[cfg(test)]
mod tests;
