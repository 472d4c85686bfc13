//! What earlier runs have left of the trials of a sweep.

use std::collections::HashMap;

use super::{Store, StoreError};

/// How far earlier runs have come with a trial.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Attempted {
    /// Attempts at it.
    pub attempts: u32,
    /// Steps behind its checkpoint, if it has one.
    pub steps: Option<u32>,
}

/// What a trial of the sweep had at a part of its steps.
#[derive(Debug, Clone, PartialEq)]
pub struct Reached {
    /// The trial.
    pub hash: String,
    /// Its K and M.
    pub point: (u32, u32),
    /// Its best test error until then (%).
    pub error: f64,
}

impl Store {
    /// How far each trial came that has been attempted and is not settled, by its hash.
    pub async fn attempted(&mut self) -> Result<HashMap<String, Attempted>, StoreError> {
        let rows: Vec<(String, u32, Option<u32>)> = sqlx::query_as(
            "SELECT t.hash, max(a.number), (SELECT c.step FROM checkpoint c WHERE c.trial_id = t.id)
             FROM trial t JOIN attempt a ON a.trial_id = t.id
             WHERE t.state IN ('pending', 'running') GROUP BY t.id",
        )
        .fetch_all(&mut self.connection)
        .await
        .map_err(|source| StoreError::sql(&self.path, "reading", source))?;
        Ok(rows.into_iter().map(|(hash, attempts, steps)| (hash, Attempted { attempts, steps })).collect())
    }

    /// The trials of the sweep that was begun which have done this part of their steps, and what they had then.
    pub async fn reached(&mut self, part: f64) -> Result<Vec<Reached>, StoreError> {
        let rows: Vec<(String, u32, u32, f64)> = sqlx::query_as(
            "WITH some AS (SELECT t.id, t.hash, t.panels, t.sensors,
                    (SELECT max(step) + 1 FROM step p WHERE p.trial_id = t.id) AS steps,
                    ?1 * (t.spec->>'$.optimise.iterations') AS mark
                  FROM sweep_trial x JOIN trial t ON t.id = x.trial_id WHERE x.sweep_id = ?2)
             SELECT hash, panels, sensors, error FROM (SELECT some.*,
                 (SELECT min(p.error_test) FROM step p WHERE p.trial_id = some.id AND p.step < mark) AS error
               FROM some WHERE steps >= mark)
             WHERE error IS NOT NULL ORDER BY hash",
        )
        .bind(part)
        .bind(self.sweep)
        .fetch_all(&mut self.connection)
        .await
        .map_err(|source| StoreError::sql(&self.path, "reading", source))?;
        let reached = |(hash, panels, sensors, error)| Reached { hash, point: (panels, sensors), error };
        Ok(rows.into_iter().map(reached).collect())
    }
}
