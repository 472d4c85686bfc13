//! Resets trials that other code computed, and removes trials.

use sqlx::AssertSqlSafe;

use super::{Result, Store};

/// Selects the trials among `?1` whose result includes work by other code than `?2`, except failed ones.
const OTHERS: &str =
    "INSERT INTO temp.chosen SELECT t.id FROM json_each(?1) j JOIN trial t ON t.hash = j.value
    JOIN v_trial v ON v.hash = t.hash WHERE t.state <> 'failed' AND v.code <> ?2";

/// Table of the selected trials.
const CHOSEN: &str = "DROP TABLE IF EXISTS temp.chosen; CREATE TEMP TABLE chosen (id INTEGER PRIMARY KEY)";

/// Tables with rows of trials.
const OF_TRIALS: &str =
    "SELECT t.name FROM sqlite_schema t, pragma_table_info(t.name) c WHERE t.type = 'table'
    AND c.name = 'trial_id' ORDER BY t.name";

/// Resets the selected trials. Their attempts stay, marked as redone, and so do their logs.
const EMPTY: &str = "
    UPDATE attempt SET redone = 1 WHERE trial_id IN (SELECT id FROM temp.chosen);
    UPDATE trial SET state = 'pending', reason = NULL, error_initial = NULL, error_optimised = NULL,
      train_error_initial = NULL, train_error_optimised = NULL, holdout_error_initial = NULL,
      holdout_error_optimised = NULL, holdout_median_initial = NULL, holdout_median_optimised = NULL,
      holdout_p90_initial = NULL, holdout_p90_optimised = NULL, holdout_above_initial = NULL,
      holdout_above_optimised = NULL, best_step = NULL, seconds_evaluation = NULL, simd = NULL, solver = NULL,
      result = NULL, finished_at = NULL WHERE id IN (SELECT id FROM temp.chosen)";

/// Removes the selected trials. The source files still contain them: a later merge reads them again.
const REMOVE: &str =
    "DELETE FROM trial WHERE id IN (SELECT id FROM temp.chosen); UPDATE source SET state = NULL";

impl Store {
    /// Removes trials with all their data; ignores unknown hashes.
    pub async fn remove(&mut self, hashes: impl Iterator<Item = &str>) -> Result<()> {
        self.in_transaction("removing trials from", async |store| {
            store.execute_all(CHOSEN).await?;
            for hash in hashes {
                run!(store, "INSERT INTO temp.chosen SELECT id FROM trial WHERE hash = ?"; hash)?;
                store.ids.remove(hash);
            }
            store.clear_chosen(&[]).await?;
            store.execute_all(REMOVE).await
        })
        .await
    }

    /// Resets the trials among these that other code has computed, even in part; they restart. Returns their number.
    pub async fn redo_other_code(&mut self, hashes: &[&str]) -> Result<usize> {
        let hashes = serde_json::to_string(hashes).expect("texts are JSON");
        self.in_transaction("reopening trials in", async |store| {
            let code = store.provenance.as_ref().map(|made| made.code.clone());
            store.execute_all(CHOSEN).await?;
            let chosen = run!(store, OTHERS; hashes, code)?.rows_affected();
            store.clear_chosen(&["sweep_trial", "attempt", "log"]).await?;
            store.execute_all(EMPTY).await?;
            Ok(chosen as usize)
        })
        .await
    }

    /// Deletes the rows of the selected trials from all tables except these.
    async fn clear_chosen(&mut self, but: &[&str]) -> sqlx::Result<()> {
        let tables: Vec<String> = sqlx::query_scalar(OF_TRIALS).fetch_all(&mut self.connection).await?;
        for table in tables.iter().filter(|table| !but.contains(&table.as_str())) {
            // Safe: contains only names of our own schema.
            let sql = format!("DELETE FROM {table} WHERE trial_id IN (SELECT id FROM temp.chosen)");
            sqlx::query(AssertSqlSafe(sql)).execute(&mut self.connection).await?;
        }
        Ok(())
    }

    /// Executes several statements.
    pub(super) async fn execute_all(&mut self, statements: &'static str) -> sqlx::Result<()> {
        sqlx::raw_sql(statements).execute(&mut self.connection).await.map(drop)
    }
}
