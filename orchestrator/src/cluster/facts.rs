//! The facts of the shards of a folder, as one database that is kept there: questions to the folder are put to it. What has been
//! handed in since is added first; steps, curves and arrays stay where they are.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use rustix::fs::{Access, access};
use tempfile::TempDir;

use super::home::attempts;
use super::merge::{Extent, MergeError, merge};
use crate::leftovers;
use crate::store::ask_unchanging;

/// Its name in the folder, by which no merge takes it for a shard's.
const NAME: &str = "facts.db";
/// How long another process may take to add what is new, and between two looks at whether it has.
const PATIENCE: Duration = Duration::from_secs(600);
const AGAIN: Duration = Duration::from_millis(200);

/// The facts of a folder.
#[derive(Debug)]
pub struct Facts {
    folder: PathBuf,
    db: PathBuf,
    /// Where they lie if the folder cannot be written to.
    _scratch: Option<TempDir>,
    /// What they were made of at the last look.
    of: Vec<(PathBuf, u64, Option<SystemTime>)>,
}

/// Files that could not be read, each with why.
pub type Refused = Vec<(PathBuf, String)>;

impl Facts {
    /// Of this folder; nothing is read yet.
    ///
    /// # Errors
    /// Where neither the folder nor TMPDIR can be written to.
    pub fn of(folder: &Path) -> std::io::Result<Self> {
        let writable = access(folder, Access::WRITE_OK).is_ok();
        let scratch = (!writable).then(|| leftovers::scratch("metasense-facts-")).transpose()?;
        let db = scratch.as_ref().map_or(folder, TempDir::path).join(NAME);
        Ok(Self { folder: folder.to_owned(), db, _scratch: scratch, of: Vec::new() })
    }

    /// The database.
    #[must_use]
    pub fn db(&self) -> &Path {
        &self.db
    }

    /// Adds what has been handed in since.
    ///
    /// # Errors
    /// `Nothing` where nothing has been handed in, or as a merge.
    pub async fn look(&mut self) -> Result<Refused, MergeError> {
        let files: Vec<PathBuf> = attempts(&self.folder).into_values().flatten().collect();
        let stamp = |path: &PathBuf| {
            let known = path.metadata().ok();
            let (size, at) = (known.as_ref().map_or(0, |m| m.len()), known.and_then(|m| m.modified().ok()));
            (path.clone(), size, at)
        };
        let of: Vec<_> = files.iter().map(stamp).collect();
        if !of.is_empty() && of == self.of && self.db.exists() {
            return Ok(Refused::new());
        }
        let begun = Instant::now();
        let refused = loop {
            match self.add(&files).await {
                // Deleted meanwhile, because a later copy contains it: list the folder again.
                Ok(refused)
                    if refused.iter().any(|(file, _)| !file.exists()) && begun.elapsed() < PATIENCE =>
                {
                    return Box::pin(self.look()).await;
                }
                Err(e) if e.is_in_use() && begun.elapsed() < PATIENCE => {
                    tokio::time::sleep(AGAIN).await;
                }
                added => break added?,
            }
        };
        self.of = of;
        Ok(refused)
    }

    async fn add(&self, files: &[PathBuf]) -> Result<Refused, MergeError> {
        // Of it nothing is lost: all is in the shards.
        let summary = match merge(Extent::Facts, files, &self.db).await {
            Err(MergeError::Result { .. } | MergeError::NotFacts(_)) => self.anew(files).await?,
            Ok(_) if self.points_nowhere().await => self.anew(files).await?,
            summary => summary?,
        };
        Ok(summary.refused)
    }

    async fn anew(&self, files: &[PathBuf]) -> Result<super::merge::Summary, MergeError> {
        let removed = std::fs::remove_file(&self.db);
        removed.map_err(|source| MergeError::Unwritable { path: self.db.clone(), source })?;
        merge(Extent::Facts, files, &self.db).await
    }

    /// Whether a trial's file is gone, as a shard removes copies that a later one contains.
    async fn points_nowhere(&self) -> bool {
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

    /// In words, for whoever asks the folder.
    #[must_use]
    pub fn said(&self) -> String {
        let folder = self.folder.display();
        format!(
            "{folder}: facts of {} merged; steps, curves and arrays are in these files: `metasense cluster merge {folder} --out FILE` \
             makes one complete database",
            crate::plan::counted(self.of.len(), "database")
        )
    }
}
