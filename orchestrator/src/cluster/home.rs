//! A shard's database: live on a disk of its node, handed in to the results folder as one file.
//!
//! What an earlier try has handed in is taken in first, so that a shard goes on on another node. It is handed in when
//! the run ends, by itself or by a signal, and from time to time, should the node be lost. A file in the results folder
//! is always whole: it is renamed into its place, and what another run has put there meanwhile is merged.

use std::collections::BTreeMap;
use std::fs::{DirBuilder, File, Metadata};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

use tokio::signal::unix::{SignalKind, signal};

use super::Shard;
use super::merge::{self, MergeError};
use crate::store::StoreError;

/// How long steps in progress may go on after SIGTERM. Slurm kills 30 s after it (`KillWait`).
const GRACE: Duration = Duration::from_secs(20);

/// In a folder of shards: the spec that they were submitted with.
pub const SUBMITTED_SPEC: &str = "spec.toml";

/// Where a shard's database is, and where it goes.
#[derive(Debug)]
pub struct Home {
    live: PathBuf,
    /// The folder of `live` is ours, and goes with it.
    scratch: Option<PathBuf>,
    handed_in: PathBuf,
    /// The file as we have last read or written it.
    seen: Option<(u64, i64, i64)>,
}

/// Why a shard's database cannot be had, or handed in.
#[derive(Debug, thiserror::Error)]
pub enum HomeError {
    /// A folder.
    #[error("cannot use {}", path.display())]
    Folder {
        /// The folder or file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The folder of another user.
    #[error("{} belongs to another user; set TMPDIR, or name a database with --db", .0.display())]
    Foreign(PathBuf),
    /// What an earlier try has handed in.
    #[error("{} cannot be gone on with: {why}; move it away to begin the shard anew", path.display())]
    Refused {
        /// The file.
        path: PathBuf,
        /// Why not.
        why: String,
    },
    /// Merging it.
    #[error(transparent)]
    Merge(#[from] MergeError),
    /// Copying it.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl Home {
    /// For a shard of the sweep `name` whose results go to `folder`; by default the database is in `TMPDIR`, under a name
    /// by which the next try on the same node finds it.
    ///
    /// # Errors
    /// If a folder cannot be made.
    pub fn new(name: &str, shard: Shard, folder: &Path, db: Option<PathBuf>) -> Result<Self, HomeError> {
        let at = |path: &Path, source| HomeError::Folder { path: path.to_owned(), source };
        std::fs::create_dir_all(folder).map_err(|e| at(folder, e))?;
        let folder = folder.canonicalize().map_err(|e| at(folder, e))?;
        let file = format!("{}.sqlite", shard.file_stem());
        let (live, scratch) = match db {
            Some(db) => (db, None),
            None => {
                let mut hasher = DefaultHasher::new();
                (&folder, shard).hash(&mut hasher);
                // SAFETY: cannot fail, touches no memory.
                let user = unsafe { libc::getuid() };
                let ours =
                    std::env::temp_dir().join(format!("metasense-{user}-{name}-{:016x}", hasher.finish()));
                DirBuilder::new().recursive(true).mode(0o700).create(&ours).map_err(|e| at(&ours, e))?;
                if ours.symlink_metadata().map_err(|e| at(&ours, e))?.uid() != user {
                    return Err(HomeError::Foreign(ours));
                }
                (ours.join(&file), Some(ours))
            }
        };
        Ok(Self { live, scratch, handed_in: folder.join(file), seen: None })
    }

    /// The live database.
    #[must_use]
    pub fn live(&self) -> &Path {
        &self.live
    }

    /// The run's log: in the results folder, where it outlives the node.
    #[must_use]
    pub fn log(&self) -> PathBuf {
        self.handed_in.with_extension("log")
    }

    /// Takes in what an earlier try has handed in. To be called before the database is opened.
    ///
    /// # Errors
    /// If it cannot be read.
    pub async fn take_in(&mut self) -> Result<(), HomeError> {
        let stamp = stamp(&self.handed_in);
        if stamp.is_some() {
            self.merge_into(&self.live).await?;
        }
        self.seen = stamp;
        Ok(())
    }

    async fn merge_into(&self, out: &Path) -> Result<(), HomeError> {
        let refused = |why| HomeError::Refused { path: self.handed_in.clone(), why };
        let summary = match merge::merge(std::slice::from_ref(&self.handed_in), out).await {
            Err(MergeError::Nothing { refused }) => merge::Summary { refused, ..Default::default() },
            other => other?,
        };
        match summary.refused.into_iter().next() {
            Some((_, why)) => Err(refused(why)),
            None => Ok(()),
        }
    }

    /// Copies the database, live or not, to the results folder.
    ///
    /// # Errors
    /// If it cannot be copied; what lay there before still does.
    pub async fn hand_in(&mut self) -> Result<(), HomeError> {
        let at = |path: &Path, source| HomeError::Folder { path: path.to_owned(), source };
        let copy = self.handed_in.with_extension(format!("{}.tmp", std::process::id()));
        let _ = std::fs::remove_file(&copy);
        merge::snapshot(&self.live, &copy, true).await?;
        if stamp(&self.handed_in) != self.seen && self.handed_in.exists() {
            self.merge_into(&copy).await?;
        }
        File::open(&copy).and_then(|file| file.sync_all()).map_err(|e| at(&copy, e))?;
        std::fs::rename(&copy, &self.handed_in).map_err(|e| at(&self.handed_in, e))?;
        self.seen = stamp(&self.handed_in);
        Ok(())
    }

    /// Hands in every so often until `stopped` says that the run is over.
    pub async fn hand_in_every(
        mut self,
        period: Duration,
        mut stopped: tokio::sync::oneshot::Receiver<()>,
    ) -> Self {
        loop {
            tokio::select! {
                _ = &mut stopped => return self,
                () = tokio::time::sleep(period) => {}
            }
            if let Err(error) = self.hand_in().await {
                tracing::warn!(%error, "the database could not be handed in; it will be tried again");
            }
        }
    }

    /// Leaves the node as it was found. Only after handing in.
    pub fn leave(self) {
        if let Some(scratch) = self.scratch {
            let _ = std::fs::remove_dir_all(scratch);
        }
    }
}

/// The databases that shards have handed in to a folder.
#[must_use]
pub fn tries(folder: &Path) -> BTreeMap<Shard, Vec<PathBuf>> {
    let mut tries = BTreeMap::<Shard, Vec<PathBuf>>::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        if let Some(shard) = Shard::of_file(&name).filter(|_| name.ends_with(".sqlite")) {
            tries.entry(shard).or_default().push(entry.path());
        }
    }
    tries.values_mut().for_each(|files| files.sort());
    tries
}

/// This machine, as part of a file's name.
#[must_use]
pub fn host() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    name.trim().chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect()
}

/// What changes when a file is replaced.
fn stamp(file: &Path) -> Option<(u64, i64, i64)> {
    let of = |m: Metadata| (m.ino(), m.mtime(), m.mtime_nsec());
    file.metadata().ok().map(of)
}

/// Sees to it that a run ends in time: after SIGTERM, or `after`, steps in progress have some seconds to end; then it is
/// asked again, and ends at once.
///
/// # Errors
/// If signals cannot be waited for.
pub fn end_in_time(after: Option<Duration>) -> io::Result<()> {
    let mut terminate = signal(SignalKind::terminate())?;
    // SAFETY: sends a signal to this process, which handles it.
    let ask = || unsafe { libc::kill(libc::getpid(), libc::SIGTERM) };
    tokio::spawn(async move {
        tokio::select! {
            _ = terminate.recv() => {}
            () = tokio::time::sleep(after.unwrap_or(Duration::MAX)) => drop(ask()),
        }
        loop {
            tokio::time::sleep(GRACE).await;
            ask();
        }
    });
    Ok(())
}
