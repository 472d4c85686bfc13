//! Which code computed the trials of a database, and which trial resembles another most.

use std::collections::{BTreeMap, HashMap};

use metasense_schemas::spec::flatten;
use metasense_worker::run::keeps_error;
use serde_json::Value;

use super::Reader;
use crate::store::StoreError;

/// Trials computed by one code version, or by the same sequence of versions.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CodeVersion {
    /// Digest of the code; `unknown` for versions before 6; several in order of work, separated by spaces.
    pub code: String,
    /// Commits that were built to this code.
    pub revisions: Vec<String>,
    /// Number of trials.
    pub trials: usize,
}

/// The trial that differs least from a given spec.
#[derive(Debug, Clone, PartialEq)]
pub struct Nearest {
    /// Its hash.
    pub hash: String,
    /// Its state.
    pub state: String,
    /// Keys that differ, with their stored and given values; `None`: the key is absent.
    pub differs: Vec<(String, [Option<Value>; 2])>,
}

impl Reader {
    /// Code versions that computed trials, by decreasing number of trials.
    pub async fn code_versions(&mut self) -> Result<Vec<CodeVersion>, StoreError> {
        let at = |path: &std::path::Path, source| StoreError::sql(path, "reading", source);
        let revisions: Vec<(String, String)> = sqlx::query_as(
            "SELECT DISTINCT code, revision FROM attempt WHERE code IS NOT NULL AND revision IS NOT NULL ORDER BY 1, 2",
        )
        .fetch_all(&mut self.connected.connection)
        .await
        .map_err(|e| at(&self.path, e))?;
        let mut of_code: HashMap<String, Vec<String>> = HashMap::new();
        revisions.into_iter().for_each(|(code, revision)| of_code.entry(code).or_default().push(revision));
        let rows: Vec<(String, i64)> = sqlx::query_as(
            // The view orders code versions; it is slow, so use it only for trials with several.
            "SELECT CASE several WHEN 0 THEN code ELSE
                 (SELECT v.code FROM v_trial v JOIN trial t ON t.hash = v.hash WHERE t.id = trial_id) END, count(*) FROM
               (SELECT trial_id, min(coalesce(code, 'unknown')) AS code,
                  min(coalesce(code, 'unknown')) < max(coalesce(code, 'unknown')) AS several FROM attempt
                WHERE NOT redone AND (steps > 0 OR saves > 0 OR state = 'done') GROUP BY trial_id)
             GROUP BY 1 ORDER BY 2 DESC, 1",
        )
        .fetch_all(&mut self.connected.connection)
        .await
        .map_err(|e| at(&self.path, e))?;
        let made = |(code, trials): (String, i64)| {
            let known = code.split(' ').filter_map(|code| of_code.get(code)).flatten();
            CodeVersion { revisions: known.cloned().collect(), trials: trials as usize, code }
        };
        Ok(rows.into_iter().map(made).collect())
    }

    /// Whether a sweep may have stopped early, depending on its results: it has `[until]`, or `[goal]` and unfinished trials,
    /// which `design` leaves but `run` does not.
    ///
    /// # Errors
    /// If SQLite fails.
    pub async fn may_stop_early(&mut self) -> Result<bool, StoreError> {
        let sql = "SELECT EXISTS (SELECT 1 FROM sweep s WHERE s.spec->'$.until' IS NOT NULL OR s.spec->'$.goal' IS NOT NULL
                     AND EXISTS (SELECT 1 FROM sweep_trial x JOIN trial t ON t.id = x.trial_id
                                 WHERE x.sweep_id = s.id AND t.state <> 'done'))";
        sqlx::query_scalar(sql)
            .fetch_one(&mut self.connected.connection)
            .await
            .map_err(|e| StoreError::sql(&self.path, "reading", e))
    }

    /// Hashes of finished trials whose time steps exceed the requested error on one of their bodies.
    ///
    /// # Errors
    /// If SQLite fails.
    pub async fn unresolved(&mut self) -> Result<Vec<String>, StoreError> {
        let mut hashes = Vec::new();
        let sql = "SELECT hash, solver FROM trial WHERE state = 'done' AND solver IS NOT NULL ORDER BY hash";
        self.each(sql, |row| {
            if keeps_error(row.text("solver")) != [true; 2] {
                hashes.push(row.text("hash").to_owned());
            }
            Ok::<_, StoreError>(())
        })
        .await?;
        Ok(hashes)
    }

    /// The trial that differs from a spec in the fewest keys; if several do, the first by hash. `None` if there are no trials.
    ///
    /// # Errors
    /// If SQLite fails or a stored spec is not JSON.
    pub async fn nearest(&mut self, spec: &Value) -> Result<Option<Nearest>, StoreError> {
        let wanted_keys = keys(spec);
        let mut nearest: Option<Nearest> = None;
        self.each("SELECT hash, state, spec FROM trial ORDER BY hash", |row| {
            let stored = serde_json::from_str(row.text("spec"));
            let there = keys(&stored.map_err(|e| StoreError::unreadable(row.text("hash"), "spec", e))?);
            let paths =
                wanted_keys.keys().chain(there.keys().filter(|path| !wanted_keys.contains_key(*path)));
            let differs = paths.filter(|path| wanted_keys.get(*path) != there.get(*path));
            let most = nearest.as_ref().map_or(usize::MAX, |found| found.differs.len());
            let differs: Vec<&String> = differs.take(most).collect();
            if differs.len() < most {
                let pair = |path: &String| {
                    (path.clone(), [there.get(path).cloned(), wanted_keys.get(path).cloned()])
                };
                nearest = Some(Nearest {
                    hash: row.text("hash").to_owned(),
                    state: row.text("state").to_owned(),
                    differs: differs.into_iter().map(pair).collect(),
                });
            }
            Ok(())
        })
        .await?;
        Ok(nearest)
    }
}

/// The keys that identify a trial, by path. The location of recorded forces is excluded; their contents count.
fn keys(spec: &Value) -> BTreeMap<String, Value> {
    let mut keys = flatten(spec);
    keys.remove("stimuli.recorded.files");
    keys
}
