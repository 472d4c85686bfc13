//! Resets trials that other code computed, and removes trials.

use sqlx::sqlite::SqliteConnection;
use sqlx::{AssertSqlSafe, Connection};

use super::{Store, StoreError};

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

/// Deletes the rows of the selected trials from all tables except these.
async fn clear(db: &mut SqliteConnection, but: &[&str]) -> sqlx::Result<()> {
    let tables: Vec<String> = sqlx::query_scalar(OF_TRIALS).fetch_all(&mut *db).await?;
    for table in tables.iter().filter(|table| !but.contains(&table.as_str())) {
        // Safe: contains only names of our own schema.
        let sql = format!("DELETE FROM {table} WHERE trial_id IN (SELECT id FROM temp.chosen)");
        sqlx::query(AssertSqlSafe(sql)).execute(&mut *db).await?;
    }
    Ok(())
}

/// Resets the selected trials. Their attempts stay, marked as redone, and so do their logs.
const EMPTY: &str = "
    UPDATE attempt SET redone = 1 WHERE trial_id IN (SELECT id FROM temp.chosen);
    UPDATE trial SET state = 'pending', reason = NULL, error_initial = NULL, error_optimised = NULL,
      train_error_initial = NULL, train_error_optimised = NULL, holdout_error_initial = NULL,
      holdout_error_optimised = NULL, holdout_median_initial = NULL, holdout_median_optimised = NULL,
      holdout_p90_initial = NULL, holdout_p90_optimised = NULL, holdout_above_initial = NULL,
      holdout_above_optimised = NULL, best_step = NULL, seconds_evaluation = NULL, simd = NULL, solver = NULL,
      result = NULL, finished_at = NULL WHERE id IN (SELECT id FROM temp.chosen)";

impl Store {
    /// Removes trials with all their data; ignores unknown hashes.
    pub async fn remove(&mut self, hashes: impl Iterator<Item = &str>) -> Result<(), StoreError> {
        let at = self.at("removing trials from");
        let mut tx = self.connection.begin_with("BEGIN IMMEDIATE").await.map_err(&at)?;
        sqlx::raw_sql(CHOSEN).execute(&mut *tx).await.map_err(&at)?;
        for hash in hashes {
            let choose =
                sqlx::query("INSERT INTO temp.chosen SELECT id FROM trial WHERE hash = ?").bind(hash);
            choose.execute(&mut *tx).await.map_err(&at)?;
            self.ids.remove(hash);
        }
        clear(&mut tx, &[]).await.map_err(&at)?;
        // The source files still contain these trials: let a later merge read them again.
        let trials =
            "DELETE FROM trial WHERE id IN (SELECT id FROM temp.chosen); UPDATE source SET state = NULL";
        sqlx::raw_sql(trials).execute(&mut *tx).await.map_err(&at)?;
        tx.commit().await.map_err(&at)
    }

    /// Resets the trials among these that other code has computed, even in part; they restart. Returns their number.
    pub async fn redo_other_code(&mut self, hashes: &[&str]) -> Result<usize, StoreError> {
        let at = self.at("reopening trials in");
        let hashes = serde_json::to_string(hashes).expect("texts are JSON");
        let code = self.provenance.as_ref().map(|made| made.code.clone());
        let mut tx = self.connection.begin_with("BEGIN IMMEDIATE").await.map_err(&at)?;
        sqlx::raw_sql(CHOSEN).execute(&mut *tx).await.map_err(&at)?;
        sqlx::query(OTHERS).bind(hashes).bind(code).execute(&mut *tx).await.map_err(&at)?;
        clear(&mut tx, &["sweep_trial", "attempt", "log"]).await.map_err(&at)?;
        sqlx::raw_sql(EMPTY).execute(&mut *tx).await.map_err(&at)?;
        let count: i64 =
            sqlx::query_scalar("SELECT count(*) FROM temp.chosen").fetch_one(&mut *tx).await.map_err(&at)?;
        tx.commit().await.map_err(&at)?;
        Ok(count as usize)
    }
}
