//! States of the shards of a folder, from their databases and the queue.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use metasense_schemas::reason::CANCELLED;
use sqlx::Row;
use sqlx::sqlite::SqliteRow;

use super::home::attempts;
use super::{Assignment, AssignmentError, Shard};
use crate::reader::ask_unchanging;

/// State of a shard.
#[derive(Debug, Clone, PartialEq)]
pub struct ShardState {
    /// The shard.
    pub shard: Shard,
    /// State in the queue if it is queued and unfinished, else of its database: `complete`, `failed` (all trials ended, some
    /// failed), `partial`, `nothing` (no copy), or an error.
    pub state: String,
    /// Numbers of trials, finished ones and failed ones; `None` without a readable copy.
    pub trials: Option<[usize; 3]>,
    /// Trials without an attempt.
    pub never: Vec<String>,
    /// Open trials, including those without an attempt.
    pub open: Vec<String>,
    /// Failed trials.
    pub failures: Vec<String>,
    /// Its last run.
    pub run: Option<ShardRun>,
    /// Age of the newest copy (s).
    pub age: Option<f64>,
}

/// A run of a shard.
#[derive(Debug, Clone, PartialEq)]
pub struct ShardRun {
    /// Start time.
    pub started_at: String,
    /// Estimated time (s).
    pub estimated_seconds: f64,
    /// Elapsed time (s).
    pub seconds: Option<f64>,
    /// Host and job.
    pub place: String,
    /// Outcome, if it has ended.
    pub outcome: Option<String>,
}

impl ShardState {
    /// Whether all trials have ended.
    pub fn is_settled(&self) -> bool {
        ["complete", "failed"].contains(&self.state.as_str())
    }
}

/// Progress of a trial. The greatest value among copies counts: a finished one; else that with most attempts; among equals the
/// open one, because it may have been reopened after a failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Stage {
    /// Number of attempts so far, and whether the trial is open: the last attempt has not failed.
    Unfinished(u32, bool),
    /// Done or cancelled.
    Done,
}

impl Stage {
    const NEVER: Self = Self::Unfinished(0, true);
}

/// The shards of a folder. `queued`: states in the queue, by shard.
pub async fn states(
    folder: &Path,
    assignment: &Assignment,
    queued: &HashMap<u32, String>,
) -> Vec<ShardState> {
    let mut trials = vec![HashMap::new(); assignment.shards() as usize];
    for (hash, shard) in assignment.hashes() {
        trials[shard as usize - 1].insert(hash.to_owned(), Stage::NEVER);
    }
    let mut states = Vec::with_capacity(trials.len());
    let mut attempts = attempts(folder);
    for (index, trials) in (1..).zip(trials) {
        let Some(shard) = Shard::new(index, assignment.shards()) else { break };
        let mut state = of_shard(shard, &attempts.remove(&shard).unwrap_or_default(), trials).await;
        // A finished shard may stay in the queue for a moment.
        if let Some(queued) = queued.get(&index).filter(|_| !state.is_settled()) {
            state.state.clone_from(queued);
        }
        states.push(state);
    }
    states
}

async fn of_shard(shard: Shard, files: &[PathBuf], mut trials: HashMap<String, Stage>) -> ShardState {
    let (mut run, mut age, mut unreadable, mut readable) = (None, None, None, false);
    for file in files {
        let written = file.metadata().and_then(|m| m.modified()).ok();
        let since = written.and_then(|at| SystemTime::now().duration_since(at).ok());
        age = [age, since.map(|since| since.as_secs_f64())].into_iter().flatten().reduce(f64::min);
        match read(file).await {
            Ok((stages, last)) => {
                readable = true;
                for (hash, stage) in stages {
                    trials.entry(hash).and_modify(|known| *known = stage.max(*known));
                }
                let began = |run: &Option<ShardRun>| run.as_ref().map(|run| run.started_at.clone());
                if began(&last) >= began(&run) {
                    run = last;
                }
            }
            Err(error) => unreadable = Some(format!("unreadable: {error}")),
        }
    }
    let of = |is_one: fn(&Stage) -> bool| {
        let mut hashes: Vec<String> =
            trials.iter().filter(|(_, stage)| is_one(stage)).map(|(hash, _)| hash.clone()).collect();
        hashes.sort();
        hashes
    };
    let never = of(|stage| *stage == Stage::NEVER);
    let open = of(|stage| matches!(stage, Stage::Unfinished(_, true)));
    let failures = of(|stage| matches!(stage, Stage::Unfinished(_, false)));
    let (all, failed) = (trials.len(), failures.len());
    let done = all - open.len() - failed;
    let state = match unreadable {
        _ if readable && done == all => "complete".into(),
        _ if readable && open.is_empty() => "failed".into(),
        _ if readable => "partial".into(),
        Some(error) => error,
        None => "nothing".into(),
    };
    ShardState {
        shard,
        state,
        trials: readable.then_some([all, done, failed]),
        never,
        open,
        failures,
        run,
        age,
    }
}

async fn read(file: &Path) -> sqlx::Result<(Vec<(String, Stage)>, Option<ShardRun>)> {
    let trials =
        "SELECT hash, state, coalesce(reason, ''), (SELECT count(*) FROM attempt a WHERE a.trial_id = t.id)
        FROM trial t";
    let last =
        "SELECT started_at, estimated_seconds, seconds, host || coalesce(', ' || job, '') AS place, outcome
        FROM v_run ORDER BY started_at DESC LIMIT 1";
    ask_unchanging(file, async |db| {
        let trials: Vec<(String, String, String, u32)> = sqlx::query_as(trials).fetch_all(&mut *db).await?;
        let stage = |(hash, state, reason, attempts): (String, String, String, u32)| {
            let stage = match (state.as_str(), reason.as_str()) {
                ("done", _) => Stage::Done,
                ("failed", CANCELLED) => Stage::Done,
                ("failed", _) => Stage::Unfinished(attempts.max(1), false),
                _ => Stage::Unfinished(attempts, true),
            };
            (hash, stage)
        };
        let run = |row: SqliteRow| {
            Ok(ShardRun {
                started_at: row.try_get(0)?,
                estimated_seconds: row.try_get(1)?,
                seconds: row.try_get(2)?,
                place: row.try_get(3)?,
                outcome: row.try_get(4)?,
            })
        };
        let run = sqlx::query(last).try_map(run).fetch_optional(db).await?;
        Ok((trials.into_iter().map(stage).collect(), run))
    })
    .await
}

/// Trials assigned to shards in the folders of these files, without an attempt in the merged database.
///
/// # Errors
/// If an assignment cannot be read. An unreadable database counts as empty.
pub async fn never_begun(files: &[PathBuf], db: &Path) -> Result<Vec<String>, AssignmentError> {
    let mut assigned = HashSet::new();
    let folders = files.iter().map(|file| if file.is_dir() { &**file } else { crate::files::folder(file) });
    for folder in folders.collect::<HashSet<&Path>>() {
        for assignment in Assignment::all_in(folder)? {
            assigned.extend(assignment.hashes().map(|(hash, _)| hash.to_owned()));
        }
    }
    if !assigned.is_empty() {
        for (hash, stage) in read(db).await.map(|(stages, _)| stages).unwrap_or_default() {
            if stage != Stage::NEVER {
                assigned.remove(&hash);
            }
        }
    }
    let mut never: Vec<String> = assigned.into_iter().collect();
    never.sort();
    Ok(never)
}

#[cfg(test)]
mod tests {
    use super::Stage;

    /// A trial that was reopened after a failure counts as open until its next attempt ends; a finished trial stays finished.
    #[test]
    fn the_copy_that_came_later_counts() {
        let failed = Stage::Unfinished(1, false);
        let later = [
            Stage::Unfinished(1, true),
            Stage::Unfinished(2, false),
            Stage::Unfinished(2, true),
            Stage::Done,
        ];
        assert!(Stage::NEVER < failed && failed < later[0] && later.is_sorted());
    }
}
