//! Keeps a database of facts of a folder of shards, which answers queries about the folder. New copies of shards are added
//! first; steps, curves and arrays stay in their files.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use rustix::fs::{Access, access};
use tempfile::TempDir;

use super::home::attempts;
use super::merge::{Extent, MergeError, merge};
use crate::files::quoted;
use crate::leftovers;
use crate::reader::ask_unchanging;

/// File name in the folder; merges do not take it for a shard's database.
const NAME: &str = "facts.db";
/// Longest wait for another process that adds copies, and the time between two checks.
const PATIENCE: Duration = Duration::from_secs(600);
const AGAIN: Duration = Duration::from_millis(200);

/// The database of facts of a folder.
#[derive(Debug)]
pub struct Facts {
    folder: PathBuf,
    db: PathBuf,
    /// Holds the database if the folder is not writable.
    _scratch: Option<TempDir>,
    /// The merged files at the last call of `look`: path, size, modification time.
    merged_files: Vec<(PathBuf, u64, Option<SystemTime>)>,
}

/// Unreadable files, with reasons.
pub type UnreadableFiles = Vec<(PathBuf, String)>;

impl Facts {
    /// For this folder; reads nothing yet.
    ///
    /// # Errors
    /// If neither the folder nor TMPDIR is writable.
    pub fn for_folder(folder: &Path) -> std::io::Result<Self> {
        let writable = access(folder, Access::WRITE_OK).is_ok();
        let scratch = (!writable).then(|| leftovers::scratch("metasense-facts-")).transpose()?;
        let db = scratch.as_ref().map_or(folder, TempDir::path).join(NAME);
        Ok(Self { folder: folder.to_owned(), db, _scratch: scratch, merged_files: Vec::new() })
    }

    /// Path of the database.
    pub fn db(&self) -> &Path {
        &self.db
    }

    /// Adds new copies of shards.
    ///
    /// # Errors
    /// `Nothing` if there are none, or an error of the merge.
    pub async fn look(&mut self) -> Result<UnreadableFiles, MergeError> {
        let files: Vec<PathBuf> = attempts(&self.folder).into_values().flatten().collect();
        let stamp = |path: &PathBuf| {
            let known = path.metadata().ok();
            let (size, at) = (known.as_ref().map_or(0, |m| m.len()), known.and_then(|m| m.modified().ok()));
            (path.clone(), size, at)
        };
        let stamps: Vec<_> = files.iter().map(stamp).collect();
        if !stamps.is_empty() && stamps == self.merged_files && self.db.exists() {
            return Ok(UnreadableFiles::new());
        }
        let begun = Instant::now();
        let refused = loop {
            match self.add(&files).await {
                // A file was deleted because a later copy contains it: list the folder again.
                Ok(refused)
                    if refused.iter().any(|(file, _)| !file.exists()) && begun.elapsed() < PATIENCE =>
                {
                    return Box::pin(self.look()).await;
                }
                Err(e) if e.is_in_use() && begun.elapsed() < PATIENCE => tokio::time::sleep(AGAIN).await,
                added => break added?,
            }
        };
        self.merged_files = stamps;
        Ok(refused)
    }

    async fn add(&self, files: &[PathBuf]) -> Result<UnreadableFiles, MergeError> {
        // Recreating the database loses nothing: the shards contain everything.
        let summary = match merge(Extent::Facts, files, &self.db).await {
            Err(MergeError::Result { .. } | MergeError::NotFacts(_)) => self.anew(files).await?,
            Ok(_) if self.has_missing_source().await => self.anew(files).await?,
            summary => summary?,
        };
        Ok(summary.refused)
    }

    async fn anew(&self, files: &[PathBuf]) -> Result<super::merge::Summary, MergeError> {
        let removed = std::fs::remove_file(&self.db);
        removed.map_err(|source| MergeError::Unwritable { path: self.db.clone(), source })?;
        merge(Extent::Facts, files, &self.db).await
    }

    /// Whether the file of a trial is gone: shards remove copies that later ones contain.
    async fn has_missing_source(&self) -> bool {
        let sql = "SELECT id, file FROM source";
        let used = "SELECT DISTINCT source_id FROM elsewhere";
        let asked = ask_unchanging(&self.db, async |db| {
            let sources: Vec<(i64, String)> = sqlx::query_as(sql).fetch_all(&mut *db).await?;
            let gone = sources.into_iter().filter(|(_, file)| !Path::new(file).exists());
            let gone: Vec<i64> = gone.map(|(id, _)| id).collect();
            if gone.is_empty() {
                return Ok(false);
            }
            let used: Vec<i64> = sqlx::query_scalar(used).fetch_all(db).await?;
            Ok(used.iter().any(|id| gone.contains(id)))
        });
        asked.await.unwrap_or(true)
    }

    /// Message about the folder for people.
    pub fn message(&self) -> String {
        let (folder, word) = (self.folder.display(), quoted(&self.folder));
        format!(
            "{folder}: facts of {} merged; steps, curves and arrays are in these files: `metasense cluster merge {word} --out FILE` \
             makes one complete database",
            crate::plan::counted(self.merged_files.len(), "database")
        )
    }
}
