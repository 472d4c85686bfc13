//! The sources of the program, for its build script: a digest of the code that affects results, and the git commit.
//!
//! Trials depend on the digest only. It distinguishes uncommitted states and needs no git; changes of documents or the report
//! do not change it. The commit is for people.

use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Sources of the program, relative to the workspace root; the first five affect the results of trials, the sixth other results.
pub const PROGRAM: [&str; 12] = [
    "Cargo.lock",
    "schemas/src",
    "worker/kernels/src",
    "worker/numerics/src",
    "worker/src",
    "worker/lab/src",
    "Cargo.toml",
    "orchestrator/render/src",
    "orchestrator/analysis/src",
    "orchestrator/src",
    "schemas/source/src",
    "schemas/schema.sql",
];

/// Sixteen hex digits: FNV-1a (64 bits) of names and contents of the sources that affect the results of trials.
///
/// # Errors
/// If a source cannot be read.
pub fn digest(root: &Path) -> io::Result<String> {
    digest_of(root, &PROGRAM[..5])
}

/// The same of the sources that affect the results of any command.
///
/// # Errors
/// If a source cannot be read.
pub fn digest_with_lab(root: &Path) -> io::Result<String> {
    digest_of(root, &PROGRAM[..6])
}

fn digest_of(root: &Path, sources: &[&str]) -> io::Result<String> {
    let mut files = Vec::new();
    for path in sources {
        add_files(root, Path::new(path), &mut files)?;
    }
    files.sort();
    let mut digest = 0xcbf2_9ce4_8422_2325_u64;
    for file in files {
        let name = file.to_string_lossy().into_owned().into_bytes();
        for byte in [name, vec![0], std::fs::read(root.join(&file))?, vec![0]].into_iter().flatten() {
            digest = (digest ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
    Ok(format!("{digest:016x}"))
}

fn add_files(root: &Path, path: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
    if !root.join(path).is_dir() {
        files.push(path.to_owned());
        return Ok(());
    }
    for entry in std::fs::read_dir(root.join(path))? {
        add_files(root, &path.join(entry?.file_name()), files)?;
    }
    Ok(())
}

/// Twelve digits of the commit, with `-dirty` if the sources have uncommitted changes; `None` if git does not track them.
pub fn revision(root: &Path) -> Option<String> {
    git(root, &["ls-files", "--error-unmatch", "Cargo.toml"])?;
    let commit = git(root, &["rev-parse", "--short=12", "HEAD"])?;
    let changes = git(root, &[&["status", "--porcelain", "--"][..], &PROGRAM].concat())?;
    Some(if changes.is_empty() { commit } else { format!("{commit}-dirty") })
}

/// Files in the git directory that change with each commit.
#[allow(dead_code, reason = "the build script's")]
pub fn moves_with_commits(root: &Path) -> Vec<PathBuf> {
    let path = |name| Some(root.join(git(root, &["rev-parse", "--git-path", name])?));
    ["HEAD", "logs/HEAD"].into_iter().filter_map(path).filter(|path| path.exists()).collect()
}

fn git(root: &Path, arguments: &[&str]) -> Option<String> {
    let output =
        Command::new("git").args(["--no-optional-locks", "-C"]).arg(root).args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}
