//! Whole files: written beside their place and renamed into it. Whoever reads finds the old one or the new one, also after
//! a power cut.

use std::fs::File;
use std::io;
use std::path::Path;

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

/// This machine and process, as part of a file's name that no other has.
#[must_use]
pub fn own_mark() -> String {
    let host: String = host().chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
    format!("{host}-{}", std::process::id())
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

/// Writes a whole file. What is no file (a pipe, a terminal) is written to as it is; a link stays one.
///
/// # Errors
/// Where the system fails; what lay there before does so still.
pub fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let path = &path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let before = path.metadata().ok();
    if before.as_ref().is_some_and(|before| !before.is_file()) {
        return std::fs::write(path, bytes);
    }
    let name = path.file_name().ok_or(io::ErrorKind::InvalidFilename)?.to_string_lossy();
    let beside = path.with_file_name(format!(".{name}.{}.tmp", own_mark()));
    let written = std::fs::write(&beside, bytes)
        .and_then(|()| {
            before.map_or(Ok(()), |before| std::fs::set_permissions(&beside, before.permissions()))
        })
        .and_then(|()| put_in_place(&beside, path));
    written.inspect_err(|_| drop(std::fs::remove_file(&beside)))
}

#[cfg(test)]
mod tests;
