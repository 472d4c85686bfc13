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
        let sql = "SELECT DISTINCT code, revision FROM attempt WHERE code IS NOT NULL AND revision IS NOT NULL ORDER BY 1, 2";
        let mut of_code: HashMap<String, Vec<String>> = HashMap::new();
        for (code, revision) in self.ask::<(String, String)>(sql, "").await? {
            of_code.entry(code).or_default().push(revision);
        }
        // The view orders code versions; it is slow, so use it only for trials with several.
        let sql = "SELECT CASE several WHEN 0 THEN code ELSE
                 (SELECT v.code FROM v_trial v JOIN trial t ON t.hash = v.hash WHERE t.id = trial_id) END, count(*) FROM
               (SELECT trial_id, min(coalesce(code, 'unknown')) AS code,
                  min(coalesce(code, 'unknown')) < max(coalesce(code, 'unknown')) AS several FROM attempt
                WHERE NOT redone AND (steps > 0 OR saves > 0 OR state = 'done') GROUP BY trial_id)
             GROUP BY 1 ORDER BY 2 DESC, 1";
        let made = |(code, trials): (String, i64)| {
            let known = code.split(' ').filter_map(|code| of_code.get(code)).flatten();
            CodeVersion { revisions: known.cloned().collect(), trials: trials as usize, code }
        };
        Ok(self.ask(sql, "").await?.into_iter().map(made).collect())
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
        Ok(self.ask::<(bool,)>(sql, "").await?[0].0)
    }

    /// Hashes of finished trials whose time steps exceed the requested error on one of their bodies.
    ///
    /// # Errors
    /// If SQLite fails.
    pub async fn unresolved(&mut self) -> Result<Vec<String>, StoreError> {
        let sql = "SELECT hash, solver FROM trial WHERE state = 'done' AND solver IS NOT NULL ORDER BY hash";
        let rows = self.rows(sql, |row| {
            (keeps_error(row.text("solver")) != [true; 2]).then(|| row.text("hash").to_owned())
        });
        Ok(rows.await?.into_iter().flatten().collect())
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
                let [hash, state] = ["hash", "state"].map(|column| row.text(column).to_owned());
                nearest = Some(Nearest { hash, state, differs: differs.into_iter().map(pair).collect() });
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
