//! Checks row by row whether one database contains another.

use std::path::Path;

use sqlx::{AssertSqlSafe, ConnectOptions, Connection, Executor};

use super::{copy, input};
use crate::files;
use crate::{sql, store};

/// Pairs trials and sweeps of the part with those of the whole.
const PAIRS: &str = "
    CREATE TEMP TABLE pair AS SELECT s.id AS old, m.id AS new FROM src.trial s LEFT JOIN main.trial m ON m.hash = s.hash;
    CREATE INDEX temp.pair_old ON pair (old);
    CREATE TEMP TABLE sweeps AS SELECT s.id AS old, m.id AS new
      FROM src.sweep s LEFT JOIN main.sweep m ON m.name = s.name AND m.text = s.text";

/// Queries for rows that the whole lacks. A trial that has continued in the whole must have all attempts, and a more advanced,
/// undamaged checkpoint.
const LACKING: [&str; 5] = [
    "SELECT 1 FROM temp.pair WHERE new IS NULL UNION ALL SELECT 1 FROM temp.sweeps WHERE new IS NULL",
    "SELECT 1 FROM temp.pair p JOIN src.trial s ON s.id = p.old JOIN main.trial m ON m.id = p.new
     WHERE s.spec <> m.spec OR s.state = 'done' AND (m.state, m.finished_at, m.result, m.best_step, m.error_initial, m.error_optimised,
         m.train_error_initial, m.train_error_optimised, m.holdout_error_initial, m.holdout_error_optimised)
       IS NOT (s.state, s.finished_at, s.result, s.best_step, s.error_initial, s.error_optimised,
         s.train_error_initial, s.train_error_optimised, s.holdout_error_initial, s.holdout_error_optimised)",
    "SELECT 1 FROM src.attempt s JOIN temp.pair p ON p.old = s.trial_id WHERE NOT EXISTS (SELECT 1 FROM main.attempt m
       WHERE m.trial_id = p.new AND m.number = s.number AND m.started_at = s.started_at AND m.steps >= s.steps)",
    "SELECT 1 FROM src.checkpoint s JOIN temp.pair p ON p.old = s.trial_id JOIN main.trial t ON t.id = p.new
     WHERE t.state <> 'done' AND NOT EXISTS (SELECT 1 FROM main.checkpoint m WHERE m.trial_id = p.new
       AND (m.digest IS NULL OR m.digest = blake3(m.bytes))
       AND (m.bytes = s.bytes OR (m.step << 32) + length(m.bytes) > (s.step << 32) + length(s.bytes)))",
    "SELECT 1 FROM src.run s JOIN temp.sweeps w ON w.old = s.sweep_id WHERE NOT EXISTS (SELECT 1 FROM main.run m
       WHERE m.sweep_id = w.new AND m.started_at = s.started_at AND m.host = s.host AND m.shard = s.shard
         AND m.shards = s.shards AND (s.ended_at IS NULL OR m.ended_at = s.ended_at))
     UNION ALL
     SELECT 1 FROM src.sweep_trial s JOIN temp.sweeps w ON w.old = s.sweep_id JOIN temp.pair p ON p.old = s.trial_id
     WHERE NOT EXISTS (SELECT 1 FROM main.sweep_trial m WHERE m.sweep_id = w.new AND m.trial_id = p.new)",
];

/// Whether `whole` contains every row of `part`. Both files must not change. False for different versions.
///
/// # Errors
/// If SQLite fails.
pub async fn contains(whole: &Path, part: &Path) -> sqlx::Result<bool> {
    if files::has_journal(whole) || files::has_journal(part) {
        return Ok(false);
    }
    let mut db = store::options(whole).read_only(true).immutable(true).connect().await?;
    sql::add_blake3(&mut db).await?;
    sqlx::query("ATTACH ? AS src").bind(input::uri(part)).execute(&mut db).await?;
    let version: i64 = sqlx::query_scalar("PRAGMA main.user_version").fetch_one(&mut db).await?;
    let other: i64 = sqlx::query_scalar("PRAGMA src.user_version").fetch_one(&mut db).await?;
    let mut lacking = version != other || copy::foreign(&mut db).await?.is_some();
    if !lacking {
        db.execute(PAIRS).await?;
        let mut questions: Vec<String> = LACKING.map(String::from).to_vec();
        for (table, key) in copy::tables_of_trials(&mut db).await? {
            if !["trial", "attempt", "checkpoint"].contains(&&*table) {
                let columns = copy::columns(&mut db, &table, &key).await?;
                questions.push(format!(
                    "SELECT p.new, {} FROM src.{table} x LEFT JOIN temp.pair p ON p.old = x.{key}
                     EXCEPT SELECT {key}, {columns} FROM main.{table}",
                    copy::prefix_columns(&columns)
                ));
            }
        }
        for sql in questions {
            // Safe: contains only names of our own schema.
            let sql = format!("SELECT EXISTS ({sql})");
            lacking = sqlx::query_scalar(AssertSqlSafe(sql)).fetch_one(&mut db).await?;
            if lacking {
                break;
            }
        }
    }
    db.close().await?;
    Ok(!lacking)
}
