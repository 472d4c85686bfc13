//! What earlier runs have left of the trials that are not settled.

use sqlx::Row;

use super::{Store, StoreError};
use crate::scheduler::Prior;

impl Store {
    /// For each trial that is not settled and has been attempted: its hash, and how far it came.
    ///
    /// # Errors
    /// Where SQLite fails.
    pub async fn priors(&mut self) -> Result<Vec<(String, Prior)>, StoreError> {
        let rows = sqlx::query(
            "SELECT t.hash, max(a.number), EXISTS (SELECT 1 FROM checkpoint c WHERE c.trial_id = t.id)
             FROM trial t JOIN attempt a ON a.trial_id = t.id
             WHERE t.state IN ('pending', 'running') GROUP BY t.id",
        )
        .fetch_all(&mut self.connection)
        .await
        .map_err(|source| StoreError::sql(&self.path, "reading", source))?;
        Ok(rows
            .into_iter()
            .map(|row| (row.get(0), Prior { attempts: row.get(1), begun: row.get(2) }))
            .collect())
    }
}
