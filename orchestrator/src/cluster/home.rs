//! A shard's database: live on a disk of its node, handed in to the results folder as one file.
//!
//! What earlier attempts have handed in is taken in first, so that a shard can go on on another node. It is handed in when
//! the run ends, by itself or by a signal, and from time to time, should the node be lost. Each attempt has a file of its own
//! name, so that none overwrites another's, and one that is there is whole: it is renamed into its place.

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
use crate::store::{self, StoreError};

/// Between two attempts to hand in for the last time, and two looks at an earlier attempt that ends.
const AGAIN: Duration = Duration::from_secs(1);
/// For how long an attempt waits for one on the same node that has been told to end: that one has half of this to hand in.
const PREDECESSOR: Duration = Duration::from_secs(120);

/// In a folder of shards: the spec that they were submitted with.
pub const SUBMITTED_SPEC: &str = "spec.toml";

/// Where a shard's database is, and where it goes.
#[derive(Debug)]
pub struct Home {
    live: PathBuf,
    /// The folder of `live` is ours, and goes with it.
    scratch: Option<PathBuf>,
    folder: PathBuf,
    shard: Shard,
    /// What this attempt hands in.
    handed_in: PathBuf,
    /// Keeps later attempts out of `scratch` until this one has left it.
    alone: Option<File>,
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
    #[error("{} belongs to another user; set TMPDIR, or pass a database with --db", .0.display())]
    Foreign(PathBuf),
    /// What an earlier attempt has handed in.
    #[error("{} cannot be resumed: {why}; move it away to run without it", path.display())]
    Refused {
        /// The file.
        path: PathBuf,
        /// Why not.
        why: String,
    },
    /// After many attempts.
    #[error("the database of the shard could not be copied to the folder; it stays in {}", live.display())]
    NotHandedIn {
        /// Where it is, on this node.
        live: PathBuf,
        /// The last attempt.
        source: Box<HomeError>,
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
    /// by which the next attempt on the same node finds it.
    ///
    /// # Errors
    /// If a folder cannot be made.
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

    /// Makes the scratch folder, for this attempt alone: one that ends takes the folder away with what is in it.
    fn claim(&mut self) -> Result<(), HomeError> {
        let Some(ours) = self.scratch.as_ref().filter(|_| self.alone.is_none()) else { return Ok(()) };
        let at = |source| HomeError::Folder { path: ours.clone(), source };
        DirBuilder::new().recursive(true).mode(0o700).create(ours).map_err(at)?;
        if ours.symlink_metadata().map_err(at)?.uid() != rustix::process::getuid().as_raw() {
            return Err(HomeError::Foreign(ours.clone()));
        }
        let folder = File::open(ours).map_err(at)?;
        // A disk without locks is no reason not to write there.
        let taken = matches!(folder.try_lock(), Err(TryLockError::WouldBlock));
        if taken || !store::is_still(&folder, ours) {
            return Err(StoreError::InUse { path: self.live.clone() }.into());
        }
        self.alone = Some(folder);
        Ok(())
    }

    /// What this attempt hands in.
    #[must_use]
    pub fn handed_in(&self) -> &Path {
        &self.handed_in
    }

    /// The live database.
    #[must_use]
    pub fn live(&self) -> &Path {
        &self.live
    }

    /// The run's log: in the results folder, where it outlives the node.
    #[must_use]
    pub fn log(&self) -> PathBuf {
        self.folder.join(format!("{}.log", self.shard.file_stem()))
    }

    /// Takes in what earlier attempts have handed in. To be called before the database is opened. Returns where the live
    /// database is now, if it was damaged: in the results folder, so that the shard goes on without it and it is not lost.
    /// A scheduler may begin an attempt while the one before it ends on the same node: it waits for that, and says so by
    /// `waits`, once.
    ///
    /// # Errors
    /// If an earlier attempt does not end, what was handed in cannot be read, or the live database is of a newer version or
    /// none of ours.
    pub async fn take_in(&mut self, waits: impl FnOnce()) -> Result<Option<PathBuf>, HomeError> {
        let (end, mut waits) = (Instant::now() + PREDECESSOR, Some(waits));
        loop {
            let taken_in = match self.claim() {
                Ok(()) => self.taken_in().await,
                Err(e) => Err(e),
            };
            match taken_in {
                // Deleted meanwhile, because a later copy contains it: list the folder again.
                Err(HomeError::Refused { path, .. }) if !path.exists() && Instant::now() < end => continue,
                Err(HomeError::Store(StoreError::InUse { .. })) if Instant::now() < end => {}
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
        let (merged, aside) = match merge::merge(Extent::Whole, &earlier, &self.live).await {
            Err(MergeError::Result { source, .. }) if self.is_damage(&source) => {
                let aside = self.set_aside()?;
                (
                    if earlier.is_empty() {
                        return Ok(Some(aside));
                    } else {
                        merge::merge(Extent::Whole, &earlier, &self.live).await
                    },
                    Some(aside),
                )
            }
            merged => (merged, None),
        };
        let summary = match merged {
            Err(MergeError::Nothing { refused }) => merge::Summary { refused, ..Default::default() },
            other => other?,
        };
        match summary.refused.into_iter().next() {
            Some((path, why)) => Err(HomeError::Refused { path, why }),
            None => Ok(aside),
        }
    }

    /// Whether a disk has done this to the live database; in a folder of our own also where nothing of it can be known.
    fn is_damage(&self, error: &StoreError) -> bool {
        error.is_damage() || self.scratch.is_some() && matches!(error, StoreError::NotOurs { .. })
    }

    /// Moves the live database with its log to the results folder, under a name by which no merge takes it.
    fn set_aside(&self) -> Result<PathBuf, HomeError> {
        let aside = self.handed_in.with_extension("damaged");
        for end in ["-wal", ""] {
            let (from, to) = (store::beside(&self.live, end), store::beside(&aside, end));
            let at = |source| HomeError::Folder { path: to.clone(), source };
            if from.exists() {
                // From one disk to another.
                std::fs::copy(&from, &to).and_then(|_| File::open(&to)?.sync_all()).map_err(at)?;
                std::fs::remove_file(&from).map_err(at)?;
            }
        }
        let _ = std::fs::remove_file(store::beside(&self.live, "-shm"));
        Ok(aside)
    }

    /// Copies the database, live or not, to the results folder.
    ///
    /// # Errors
    /// If it cannot be copied; what this attempt has handed in before still lies there.
    pub async fn hand_in(&self) -> Result<(), HomeError> {
        self.hand_in_while(|| true).await
    }

    /// The same, given up when `goes_on` says no.
    async fn hand_in_while(&self, goes_on: impl FnMut() -> bool + Send + 'static) -> Result<(), HomeError> {
        let copy = self.handed_in.with_extension("tmp");
        let _ = std::fs::remove_file(&copy);
        merge::snapshot(&self.live, &copy, true, goes_on).await?;
        let place = self.handed_in.clone();
        // On a thread of its own: a network's disk may take its time, and the run goes on meanwhile.
        let put = tokio::task::spawn_blocking(move || files::put_in_place(&copy, &place));
        let put = put.await.unwrap_or_else(|e| Err(io::Error::other(e)));
        put.map_err(|source| HomeError::Folder { path: self.handed_in.clone(), source })
    }

    /// Hands in for the last time, again and again until it has worked or `notice` is over.
    ///
    /// # Errors
    /// The last attempt's.
    pub async fn hand_in_within(&self, notice: Duration) -> Result<(), HomeError> {
        let end = tokio::time::Instant::now() + notice;
        loop {
            match self.hand_in().await {
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

    /// Hands in every so often until `stopped` says that the run is over, and when somebody has `asked` for the end: steps in
    /// progress may last longer than whoever ends the job waits. What is being copied when the run is over is given up, as the
    /// last copy is to be made within the time that is left; unless it is the one that was made for the end.
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
            let seen = Arc::clone(&over);
            let mut handing_in = std::pin::pin!(self.hand_in_while(move || !seen.load(Ordering::Relaxed)));
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

    /// Leaves the node as it was found, and of what earlier attempts have handed in only what this one's does not hold. Only
    /// after handing in.
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

/// The databases that shards have handed in to a folder.
#[must_use]
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

/// Asks this process to end, as SIGTERM does, when so much time has passed: for a scheduler that gives no notice.
pub fn end_after(time: Duration) {
    tokio::spawn(async move {
        tokio::time::sleep(time).await;
        // This process handles it.
        let _ = kill_process(getpid(), Signal::TERM);
    });
}

#[cfg(test)]
mod tests;
