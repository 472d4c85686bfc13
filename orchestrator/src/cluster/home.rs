//! The database of a shard: in use on a disk of its node, and copied to the results folder.
//!
//! At the start it merges copies of earlier attempts, so that a shard can resume on another node. It is copied when the run
//! ends, also by a signal, and periodically, in case the node is lost. Each attempt has its own file name, so none overwrites
//! another; copies are renamed into place when complete.

use std::collections::BTreeMap;
use std::fs::{DirBuilder, File, TryLockError};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use rustix::process::{Signal, getpid, kill_process};
use tokio::sync::Notify;

use super::Shard;
use super::merge::{self, Extent, MergeError};
use crate::files;
use crate::store::StoreError;

/// Pause between attempts at the last copy, and between checks for an earlier attempt that is ending.
const AGAIN: Duration = Duration::from_secs(1);
/// Longest wait for an earlier attempt on the same node that is stopping; it has half of this time to copy its database.
const PREDECESSOR: Duration = Duration::from_secs(120);

/// Name of the submitted spec in a folder of shards.
pub const SUBMITTED_SPEC: &str = "spec.toml";

/// Paths of a shard's database.
#[derive(Debug)]
pub struct Home {
    live: PathBuf,
    /// The folder of `live`, if it is ours to remove.
    scratch: Option<PathBuf>,
    folder: PathBuf,
    shard: Shard,
    /// Path of this attempt's copy.
    handed_in: PathBuf,
    /// Locks `scratch` against later attempts.
    alone: Option<File>,
}

/// Errors of a shard's database.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum HomeError {
    /// A folder or file cannot be used.
    #[error("cannot use {}", path.display())]
    Folder { path: PathBuf, source: io::Error },
    /// The folder belongs to another user.
    #[error("{} belongs to another user; set TMPDIR, or pass a database with --db", .0.display())]
    Foreign(PathBuf),
    /// The copy of an earlier attempt cannot be merged.
    #[error("{} cannot be resumed: {why}; move it away to run without it", path.display())]
    Refused { path: PathBuf, why: String },
    /// Copying failed repeatedly.
    #[error("the database of the shard could not be copied to the folder; it stays in {}", live.display())]
    NotHandedIn { live: PathBuf, source: Box<HomeError> },
    /// Merging failed.
    #[error(transparent)]
    Merge(#[from] MergeError),
    /// Copying failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl Home {
    /// Paths for a shard of the sweep `name` with results in `folder`. By default, the database is in `TMPDIR`, under a name
    /// that the next attempt on the same node finds.
    ///
    /// # Errors
    /// If the folder cannot be created.
    pub fn new(name: &str, shard: Shard, folder: &Path, db: Option<PathBuf>) -> Result<Self, HomeError> {
        let at = |path: &Path, source| HomeError::Folder { path: path.to_owned(), source };
        std::fs::create_dir_all(folder).map_err(|e| at(folder, e))?;
        let folder = folder.canonicalize().map_err(|e| at(folder, e))?;
        let began = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_millis();
        let stem = shard.file_stem();
        let handed_in = folder.join(format!("{stem}.{began}-{}.sqlite", files::own_mark()));
        let (live, scratch) = match db {
            Some(db) => (db, None),
            None => {
                let which = [folder.as_os_str().as_encoded_bytes(), shard.to_string().as_bytes()].join(&0);
                let (user, mark) = (rustix::process::getuid().as_raw(), blake3::hash(&which).to_hex());
                let ours = std::env::temp_dir().join(format!("metasense-{user}-{name}-{}", &mark[..16]));
                (ours.join(format!("{stem}.sqlite")), Some(ours))
            }
        };
        Ok(Self { live, scratch, folder, shard, handed_in, alone: None })
    }

    /// Creates and locks the scratch folder. An attempt removes its folder with all contents when it ends.
    fn claim(&mut self) -> Result<(), HomeError> {
        let Some(ours) = self.scratch.as_ref().filter(|_| self.alone.is_none()) else { return Ok(()) };
        let at = |source| HomeError::Folder { path: ours.clone(), source };
        DirBuilder::new().recursive(true).mode(0o700).create(ours).map_err(at)?;
        if ours.symlink_metadata().map_err(at)?.uid() != rustix::process::getuid().as_raw() {
            return Err(HomeError::Foreign(ours.clone()));
        }
        let folder = File::open(ours).map_err(at)?;
        // Continue on disks without locks.
        let taken = matches!(folder.try_lock(), Err(TryLockError::WouldBlock));
        if taken || !files::is_still(&folder, ours) {
            return Err(StoreError::InUse(self.live.clone()).into());
        }
        self.alone = Some(folder);
        Ok(())
    }

    /// Path of this attempt's copy.
    pub fn handed_in(&self) -> &Path {
        &self.handed_in
    }

    /// Path of the database in use.
    pub fn live(&self) -> &Path {
        &self.live
    }

    /// Path of the run's log, in the results folder, because the node's disk may be lost.
    pub fn log(&self) -> PathBuf {
        self.folder.join(format!("{}.log", self.shard.file_stem()))
    }

    /// Merges copies of earlier attempts into the live database. Call this before opening the database. Returns the new path of
    /// a damaged live database, which is moved to the results folder; the shard continues without it. A scheduler may start an
    /// attempt while the previous one ends on the same node: this waits for it, after calling `waits` once.
    ///
    /// # Errors
    /// If an earlier attempt does not end, a copy is unreadable, or the live database is of a newer version or not a metasense
    /// database.
    pub async fn merge_earlier_copies(&mut self, waits: impl FnOnce()) -> Result<Option<PathBuf>, HomeError> {
        let (end, mut waits) = (Instant::now() + PREDECESSOR, Some(waits));
        loop {
            let taken_in = match self.claim() {
                Ok(()) => self.taken_in().await,
                Err(e) => Err(e),
            };
            match taken_in {
                // The file was deleted because a later copy contains it: list the folder again.
                Err(HomeError::Refused { path, .. }) if !path.exists() && Instant::now() < end => continue,
                Err(HomeError::Store(StoreError::InUse(..))) if Instant::now() < end => {}
                Err(HomeError::Merge(e)) if e.is_in_use() && Instant::now() < end => {}
                taken_in => return taken_in,
            }
            if let Some(waits) = waits.take() {
                waits();
            }
            tokio::time::sleep(AGAIN).await;
        }
    }

    async fn taken_in(&self) -> Result<Option<PathBuf>, HomeError> {
        let earlier = attempts(&self.folder).remove(&self.shard).unwrap_or_default();
        if earlier.is_empty() && !self.live.exists() {
            return Ok(None);
        }
        let mut merged = merge::merge(Extent::Whole, &earlier, &self.live).await;
        let mut aside = None;
        if let Err(MergeError::Result { source, .. }) = &merged
            && self.is_damage(source)
        {
            aside = Some(self.set_aside()?);
            if earlier.is_empty() {
                return Ok(aside);
            }
            merged = merge::merge(Extent::Whole, &earlier, &self.live).await;
        }
        let summary = match merged {
            Err(MergeError::Nothing { refused }) => merge::Summary { refused, ..Default::default() },
            other => other?,
        };
        match summary.refused.into_iter().next() {
            Some((path, why)) => Err(HomeError::Refused { path, why }),
            None => Ok(aside),
        }
    }

    /// Whether the live database is damaged; in our own folder, also if it is not recognised as a database.
    fn is_damage(&self, error: &StoreError) -> bool {
        error.is_damage() || self.scratch.is_some() && matches!(error, StoreError::NotOurs(..))
    }

    /// Moves the live database with its log to the results folder, under a name that merges ignore.
    fn set_aside(&self) -> Result<PathBuf, HomeError> {
        let aside = self.handed_in.with_extension("damaged");
        for end in ["-wal", ""] {
            let (from, to) = (files::sidecar(&self.live, end), files::sidecar(&aside, end));
            let at = |source| HomeError::Folder { path: to.clone(), source };
            if from.exists() {
                // A rename does not work between disks.
                std::fs::copy(&from, &to).and_then(|_| File::open(&to)?.sync_all()).map_err(at)?;
                std::fs::remove_file(&from).map_err(at)?;
            }
        }
        let _ = std::fs::remove_file(files::sidecar(&self.live, "-shm"));
        Ok(aside)
    }

    /// Copies the database, in use or not, to the results folder; stops when `goes_on` returns false. If copying fails, the
    /// previous copy remains.
    async fn hand_in_while(&self, goes_on: impl FnMut() -> bool + Send + 'static) -> Result<(), HomeError> {
        let copy = self.handed_in.with_extension("tmp");
        let _ = std::fs::remove_file(&copy);
        merge::snapshot(&self.live, &copy, true, goes_on).await?;
        let place = self.handed_in.clone();
        // On another thread, because a network disk may be slow while the run continues.
        let put = tokio::task::spawn_blocking(move || files::put_in_place(&copy, &place));
        let put = put.await.unwrap_or_else(|e| Err(io::Error::other(e)));
        put.map_err(|source| HomeError::Folder { path: self.handed_in.clone(), source })
    }

    /// Makes the last copy; retries until it succeeds or `notice` is over.
    ///
    /// # Errors
    /// Error of the last attempt.
    pub async fn hand_in_within(&self, notice: Duration) -> Result<(), HomeError> {
        let end = tokio::time::Instant::now() + notice;
        loop {
            match self.hand_in_while(|| true).await {
                Ok(()) => return Ok(()),
                Err(error) if tokio::time::Instant::now() < end => {
                    tracing::warn!(%error, "the database could not be copied to the folder; retrying");
                    tokio::time::sleep(AGAIN).await;
                }
                Err(error) => {
                    return Err(HomeError::NotHandedIn { live: self.live.clone(), source: Box::new(error) });
                }
            }
        }
    }

    /// Copies the database every `period` until `stopped`, and when a stop is `asked`, as steps in progress may outlast the
    /// notice of the scheduler. When the run ends, a copy in progress is cancelled to leave time for the last one, unless it
    /// was made for the stop.
    pub async fn hand_in_every(
        &self,
        period: Duration,
        mut stopped: tokio::sync::oneshot::Receiver<()>,
        asked: &Notify,
    ) {
        let mut ends = false;
        loop {
            tokio::select! {
                _ = &mut stopped => return,
                () = asked.notified() => ends = true,
                () = tokio::time::sleep(period) => {}
            }
            let over = Arc::new(AtomicBool::new(false));
            let cancel_flag = Arc::clone(&over);
            let mut handing_in =
                std::pin::pin!(self.hand_in_while(move || !cancel_flag.load(Ordering::Relaxed)));
            let handed_in = loop {
                tokio::select! {
                    handed_in = &mut handing_in => break handed_in,
                    () = asked.notified() => ends = true,
                    _ = &mut stopped => {
                        over.store(!ends, Ordering::Relaxed);
                        let _ = handing_in.await;
                        return;
                    }
                }
            };
            if let Err(error) = handed_in {
                tracing::warn!(%error, "the database could not be copied to the folder; retrying later");
            }
        }
    }

    /// Removes the scratch folder and earlier copies that this attempt's copy contains. Call this only after the last copy.
    pub async fn leave(self) {
        for earlier in attempts(&self.folder).remove(&self.shard).unwrap_or_default() {
            if earlier < self.handed_in
                && matches!(merge::contains(&self.handed_in, &earlier).await, Ok(true))
            {
                let _ = std::fs::remove_file(earlier);
            }
        }
        if let Some(scratch) = &self.scratch {
            let _ = std::fs::remove_dir_all(scratch);
        }
    }
}

/// Copies of the shards' databases in a folder, sorted.
pub fn attempts(folder: &Path) -> BTreeMap<Shard, Vec<PathBuf>> {
    let mut attempts = BTreeMap::<Shard, Vec<PathBuf>>::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        if let Some(shard) = Shard::of_file(&name).filter(|_| name.ends_with(".sqlite")) {
            attempts.entry(shard).or_default().push(entry.path());
        }
    }
    attempts.values_mut().for_each(|files| files.sort());
    attempts
}

/// Sends SIGTERM to this process after some time, for schedulers that give no notice.
pub fn end_after(time: Duration) {
    tokio::spawn(async move {
        tokio::time::sleep(time).await;
        // This process handles the signal.
        let _ = kill_process(getpid(), Signal::TERM);
    });
}

#[cfg(test)]
mod tests;
