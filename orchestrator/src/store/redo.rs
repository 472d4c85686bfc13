//! Trials that other code has made, to be made again; trials that are taken out.

use sqlx::sqlite::SqliteConnection;
use sqlx::{AssertSqlSafe, Connection};

use super::{Store, StoreError};

/// Those of the trials `?1` of which some work that counts was done by other code than `?2`; those that have failed stay.
const OTHERS: &str =
    "INSERT INTO temp.chosen SELECT t.id FROM json_each(?1) j JOIN trial t ON t.hash = j.value
    JOIN v_trial v ON v.hash = t.hash WHERE t.state <> 'failed' AND v.code <> ?2";

/// Trials that something is done to.
const CHOSEN: &str = "DROP TABLE IF EXISTS temp.chosen; CREATE TEMP TABLE chosen (id INTEGER PRIMARY KEY)";

/// Tables of what belongs to trials.
const OF_TRIALS: &str =
    "SELECT t.name FROM sqlite_schema t, pragma_table_info(t.name) c WHERE t.type = 'table'
    AND c.name = 'trial_id' ORDER BY t.name";

/// Deletes what belongs to the chosen trials, but for these tables.
async fn clear(db: &mut SqliteConnection, but: &[&str]) -> sqlx::Result<()> {
    let tables: Vec<String> = sqlx::query_scalar(OF_TRIALS).fetch_all(&mut *db).await?;
    for table in tables.iter().filter(|table| !but.contains(&table.as_str())) {
        // Names of our own schema only.
        let sql = format!("DELETE FROM {table} WHERE trial_id IN (SELECT id FROM temp.chosen)");
        sqlx::query(AssertSqlSafe(sql)).execute(&mut *db).await?;
    }
    Ok(())
}

/// What becomes of the trials themselves. Attempts stay, marked, and so does what was said of them.
const EMPTY: &str = "
    UPDATE attempt SET redone = 1 WHERE trial_id IN (SELECT id FROM temp.chosen);
    UPDATE trial SET state = 'pending', reason = NULL, error_initial = NULL, error_optimised = NULL,
      train_error_initial = NULL, train_error_optimised = NULL, holdout_error_initial = NULL,
      holdout_error_optimised = NULL, holdout_median_initial = NULL, holdout_median_optimised = NULL,
      holdout_p90_initial = NULL, holdout_p90_optimised = NULL, holdout_above_initial = NULL,
      holdout_above_optimised = NULL, best_step = NULL, seconds_evaluation = NULL, simd = NULL, solver = NULL,
      result = NULL, finished_at = NULL WHERE id IN (SELECT id FROM temp.chosen)";

impl Store {
    /// Takes trials out, with all that belongs to them; hashes that are not there are none.
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
        // What they were merged of has them still, and may bring them again.
        let trials =
            "DELETE FROM trial WHERE id IN (SELECT id FROM temp.chosen); UPDATE source SET state = NULL";
        sqlx::raw_sql(trials).execute(&mut *tx).await.map_err(&at)?;
        tx.commit().await.map_err(&at)
    }

    /// Empties those of these trials which other code than this program's has worked on: they are open, and begin anew. Returns how
    /// many.
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
