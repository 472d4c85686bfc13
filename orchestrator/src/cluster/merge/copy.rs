//! SQL statements of a merge. They read the lists of tables and columns from the schema, so additions of later versions are
//! included.
//!
//! First all copies of trials are listed (`candidate`), then the best copy of each is chosen (`kept`), then each input in turn
//! is copied, so that tables only grow at their ends.

use std::path::Path;

use sqlx::sqlite::SqliteConnection;
use sqlx::{AssertSqlSafe, ConnectOptions, Executor};

use super::Extent;
use crate::{sql, store};

/// Tables with most of the bytes of a trial; all others contain its facts.
const BULK: [&str; 4] = ["step", "curve", "artifact", "checkpoint"];

/// Opens or creates the database to build, without durability: after a crash it is discarded.
pub(super) async fn open(path: &Path) -> sqlx::Result<SqliteConnection> {
    let mut out = store::options(path)
        .create_if_missing(true)
        .foreign_keys(false)
        .pragma("locking_mode", "EXCLUSIVE")
        .pragma("journal_mode", "OFF")
        .pragma("synchronous", "OFF")
        .pragma("cache_size", "-65536")
        .pragma("temp_store", "FILE")
        .connect()
        .await?;
    sql::add_blake3(&mut out).await?;
    let version = store::version(&mut out).await? as usize;
    store::add_schema(&mut out, version).await?;
    out.execute(
        "CREATE TEMP TABLE candidate (input INTEGER, old INTEGER, hash TEXT, settled INTEGER, reached INTEGER,
           attempts INTEGER, redone INTEGER, since TEXT, ended INTEGER, open INTEGER, finished_at TEXT, last TEXT,
           simd TEXT, error REAL, damaged INTEGER NOT NULL DEFAULT 0);
         CREATE TEMP TABLE damage (input INTEGER, old INTEGER, what TEXT);
         CREATE TEMP TABLE thrown (hash TEXT, since TEXT, PRIMARY KEY (hash, since)) WITHOUT ROWID;
         CREATE TEMP TABLE sweeps (input INTEGER, old INTEGER, name TEXT, text TEXT, version TEXT, spec TEXT,
           created_at TEXT, new INTEGER, chosen INTEGER);
         CREATE TEMP TABLE kept (new INTEGER PRIMARY KEY, input INTEGER, old INTEGER, hash TEXT, reached INTEGER);",
    )
    .await?;
    Ok(out)
}

/// A column of the attached input that is not as in this program's schema. Views in place of tables, computed columns or
/// defaults could expand a small file to a huge one. Additional tables and columns are ignored.
pub(super) async fn foreign(out: &mut SqliteConnection) -> sqlx::Result<Option<String>> {
    let columns = |schema: &str| {
        format!(
            "SELECT t.name || '.' || c.name AS name, c.type, c.\"notnull\", c.dflt_value, c.pk, c.hidden
             FROM pragma_table_list t, pragma_table_xinfo(t.name, '{schema}') c
             WHERE t.schema = '{schema}' AND t.type = 'table' AND substr(t.name, 1, 7) <> 'sqlite_'"
        )
    };
    // Safe: contains only names of our own schema.
    let sql = format!("SELECT name FROM ({} EXCEPT {}) LIMIT 1", columns("main"), columns("src"));
    sqlx::query_scalar(AssertSqlSafe(sql)).fetch_optional(out).await
}

/// Lists an input's sweeps and trials. Progress is ordered by steps, then by the size of the checkpoint, which grows in the
/// final evaluation.
pub(super) async fn survey(out: &mut SqliteConnection, input: usize) -> sqlx::Result<()> {
    for sql in [
        "INSERT INTO temp.candidate (input, old, hash, settled, reached, attempts, redone, since, ended, open, finished_at, last, simd,
           error)
         SELECT ?, t.id, t.hash,
           CASE t.state WHEN 'done' THEN 2 WHEN 'failed' THEN 0 WHEN 'pending' THEN 0 WHEN 'running' THEN 0 ELSE 1 END,
           coalesce((SELECT (c.step << 32) + length(c.bytes) FROM src.checkpoint c WHERE c.trial_id = t.id),
             (SELECT e.reached FROM src.elsewhere e WHERE e.trial_id = t.id), 0),
           (SELECT count(*) FROM src.attempt a WHERE a.trial_id = t.id),
           (SELECT coalesce(sum(a.redone), 0) FROM src.attempt a WHERE a.trial_id = t.id),
           (SELECT min(a.started_at) FROM src.attempt a
            WHERE a.trial_id = t.id AND NOT a.redone AND (a.steps > 0 OR a.saves > 0 OR a.state = 'done')),
           coalesce((SELECT a.state <> 'running' AND a.reason IS NOT 'orchestrator_lost' FROM src.attempt a
                     WHERE a.trial_id = t.id ORDER BY a.number DESC LIMIT 1), 0),
           t.state IN ('pending', 'running'), t.finished_at,
           (SELECT max(coalesce(a.ended_at, a.started_at)) FROM src.attempt a WHERE a.trial_id = t.id),
           t.simd, t.error_optimised
         FROM src.trial t",
        "INSERT INTO temp.sweeps (input, old, name, text, version, spec, created_at)
         SELECT ?, id, name, text, version, spec, created_at FROM src.sweep",
    ] {
        sqlx::query(sql).bind(input as i64).execute(&mut *out).await?;
    }
    let thrown = "INSERT OR IGNORE INTO temp.thrown
         SELECT t.hash, a.started_at FROM src.attempt a JOIN src.trial t ON t.id = a.trial_id WHERE a.redone";
    out.execute(thrown).await.map(drop)
}

/// Verifies the checksums of an input's checkpoints and arrays and notes mismatches. For the former result (`base`), verifies
/// only trials that another input has, too. A damaged checkpoint counts as no progress.
pub(super) async fn verify(out: &mut SqliteConnection, input: usize, base: bool) -> sqlx::Result<()> {
    let damage_query = |table: &str, name: &str| {
        format!(
            "INSERT INTO temp.damage SELECT c.input, c.old, {name} FROM temp.candidate c CROSS JOIN src.{table} x ON x.trial_id = c.old
             WHERE c.input = ?1
               AND (NOT {base} OR EXISTS (SELECT 1 FROM temp.candidate d WHERE d.hash = c.hash AND d.input <> c.input))
               AND x.digest IS NOT NULL AND x.digest <> blake3(x.bytes)"
        )
    };
    for sql in [
        damage_query("artifact", "x.name"),
        damage_query("checkpoint", "'checkpoint'"),
        "UPDATE temp.candidate SET reached = 0 WHERE input = ?1
           AND old IN (SELECT old FROM temp.damage WHERE input = ?1 AND what = 'checkpoint')"
            .to_owned(),
        "UPDATE temp.candidate AS c SET damaged =
           (SELECT count(*) FROM temp.damage d WHERE d.input = c.input AND d.old = c.old) WHERE input = ?1"
            .to_owned(),
    ] {
        // Safe: contains only names of our own schema.
        sqlx::query(AssertSqlSafe(sql)).bind(input as i64).execute(&mut *out).await?;
    }
    Ok(())
}

/// Chooses a copy of each trial, by these criteria in order: its work was not discarded by another copy for a recomputation
/// with other code; done; fewest damaged parts; recomputed; most steps; most attempts if not done; ended properly; open again
/// after a failure; finished first. Among equals the former result (`base`) takes precedence; among equal facts the last input,
/// because its file exists longest. Sweep ids decrease with age, as in the store.
pub(super) async fn choose(
    out: &mut SqliteConnection,
    base: Option<usize>,
    extent: Extent,
) -> sqlx::Result<()> {
    let base = base.map_or(-1, |base| base as i64);
    let among_equals = match extent {
        Extent::Whole => format!("input <> {base}, input"),
        Extent::Facts => format!("input = {base}, input DESC"),
    };
    // Safe: contains only our own numbers and names.
    out.execute(AssertSqlSafe(format!(
        "INSERT INTO temp.kept
         SELECT coalesce(there, (SELECT coalesce(max(old), 0) FROM temp.candidate WHERE input = {base})
             + row_number() OVER (PARTITION BY there IS NULL ORDER BY input, old)), input, old, hash, reached FROM
           (SELECT input, old, hash, reached, max(CASE input WHEN {base} THEN old END) OVER (PARTITION BY hash) AS there,
              row_number() OVER (PARTITION BY hash ORDER BY thrown, settled DESC, damaged, redone DESC, reached DESC,
                CASE WHEN settled = 0 THEN attempts END DESC, ended DESC, open DESC, finished_at, last DESC, simd, error,
                {among_equals}) AS place
            FROM (SELECT *, EXISTS (SELECT 1 FROM temp.thrown t WHERE t.hash = c.hash AND t.since = c.since) AS thrown
              FROM temp.candidate c))
         WHERE place = 1;
         CREATE INDEX temp.kept_input ON kept (input, old);
         CREATE INDEX temp.kept_hash ON kept (hash);
         UPDATE temp.sweeps SET (new, chosen) = (n.new, n.chosen) FROM
           (SELECT rowid AS row, dense_rank() OVER (ORDER BY first DESC, name DESC, text DESC) AS new,
              1 = row_number() OVER (PARTITION BY name, text ORDER BY version DESC, spec, input <> {base}, input) AS chosen
            FROM (SELECT rowid, *, min(created_at) OVER (PARTITION BY name, text) AS first FROM temp.sweeps)) n
         WHERE n.row = sweeps.rowid"
    )))
    .await?;
    Ok(())
}

/// Deletes trials of the former result, input `base`, of which another copy is kept, with all their rows. Sweeps get their new
/// ids.
pub(super) async fn make_room(out: &mut SqliteConnection, base: usize) -> sqlx::Result<()> {
    let mut sql = format!(
        "BEGIN;
         CREATE TEMP TABLE replaced AS SELECT c.old FROM temp.candidate c JOIN temp.kept k ON k.hash = c.hash
           WHERE c.input = {base} AND k.input <> {base};
         DELETE FROM main.sweep WHERE id IN (SELECT old FROM temp.sweeps WHERE input = {base} AND NOT chosen);"
    );
    for (table, key) in tables_of_trials(out).await? {
        sql += &format!("DELETE FROM main.{table} WHERE {key} IN (SELECT old FROM temp.replaced);");
    }
    // Via unused ids, to avoid collisions.
    for (table, key) in [("sweep", "id"), ("run", "sweep_id"), ("sweep_trial", "sweep_id")] {
        sql += &format!(
            "UPDATE main.{table} AS x SET {key} = s.new + (1 << 40) FROM temp.sweeps s
               WHERE s.input = {base} AND s.old = x.{key} AND s.new <> s.old;
             UPDATE main.{table} SET {key} = {key} - (1 << 40) WHERE {key} > (1 << 40);"
        );
    }
    // Safe: contains only our own numbers and names.
    out.execute(AssertSqlSafe(sql + "COMMIT")).await.map(drop)
}

/// Copies the chosen rows of an input, which is this file.
pub(super) async fn copy(
    out: &mut SqliteConnection,
    input: usize,
    file: &Path,
    extent: Extent,
) -> sqlx::Result<()> {
    out.execute("BEGIN").await?;
    let sql = "INSERT INTO main.source (file) VALUES (?) ON CONFLICT DO UPDATE SET state = NULL RETURNING id";
    let source: i64 = sqlx::query_scalar(sql).bind(file.to_string_lossy()).fetch_one(&mut *out).await?;
    let sweep = columns(out, "sweep", "id").await?;
    let run = columns(out, "run", "sweep_id").await?;
    let mut statements = vec![
        format!(
            "INSERT INTO main.sweep (id, {sweep}) SELECT s.new, {} FROM temp.sweeps s JOIN src.sweep x ON x.id = s.old
             WHERE s.input = ?1 AND s.chosen",
            prefix_columns(&sweep)
        ),
        format!(
            "INSERT INTO main.run (sweep_id, {run}) SELECT s.new, {} FROM temp.sweeps s
             JOIN src.run x ON x.sweep_id = s.old WHERE s.input = ?1
             ON CONFLICT DO UPDATE SET ended_at = excluded.ended_at, seconds = excluded.seconds, outcome = excluded.outcome,
               done = excluded.done, failed = excluded.failed WHERE ended_at IS NULL",
            prefix_columns(&run)
        ),
        "INSERT INTO main.sweep_trial (sweep_id, trial_id, position)
         SELECT s.new, k.new, x.position FROM temp.sweeps s JOIN src.sweep_trial x ON x.sweep_id = s.old
         JOIN src.trial t ON t.id = x.trial_id JOIN temp.kept k ON k.hash = t.hash WHERE s.input = ?1
         ON CONFLICT DO UPDATE SET position = min(position, excluded.position)"
            .to_owned(),
    ];
    for (table, key) in tables_of_trials(out).await? {
        if table == "elsewhere" || extent == Extent::Facts && BULK.contains(&table.as_str()) {
            continue;
        }
        let columns = columns(out, &table, &key).await?;
        let mut values = prefix_columns(&columns);
        if extent == Extent::Facts && table == "attempt" {
            for (column, value) in FROM_STEPS {
                values = values.replace(&format!("x.\"{column}\""), value);
            }
        }
        // CROSS JOIN fixes the loop order, so that rows arrive in the order of the result.
        statements.push(format!(
            "INSERT INTO main.{table} ({key}, {columns}) SELECT k.new, {values} FROM temp.kept k
             CROSS JOIN src.{table} x ON x.{key} = k.old WHERE k.input = ?1"
        ));
    }
    if extent == Extent::Facts {
        statements.push(format!(
            "INSERT INTO main.elsewhere (trial_id, source_id, reached) SELECT k.new, {source}, k.reached FROM temp.kept k
             WHERE k.input = ?1"
        ));
    }
    for sql in statements {
        // Safe: contains only names of our own schema.
        sqlx::query(AssertSqlSafe(sql)).bind(input as i64).execute(&mut *out).await?;
    }
    out.execute("COMMIT").await.map(drop)
}

/// Values of attempts that are computed from their steps if missing, because facts contain no steps.
const FROM_STEPS: [(&str, &str); 2] = [
    (
        "cpu_seconds",
        "coalesce(x.cpu_seconds, (SELECT sum(p.seconds_simulate + p.seconds_train + p.seconds_differentiate
             + p.seconds_implicit + p.seconds_project + p.seconds_store)
           FROM src.step p WHERE p.trial_id = x.trial_id AND p.attempt = x.number), 0)
         + CASE WHEN x.cpu_seconds IS NULL AND x.state = 'done'
             THEN (SELECT coalesce(t.seconds_evaluation, 0) FROM src.trial t WHERE t.id = x.trial_id) ELSE 0 END",
    ),
    (
        "ended_at",
        "CASE x.state WHEN 'running' THEN (SELECT max(p.recorded_at) FROM src.step p
           WHERE p.trial_id = x.trial_id AND p.attempt = x.number) ELSE x.ended_at END",
    ),
];

/// Notes the state of fully merged files, which are not read again while unchanged.
pub(super) async fn note(
    out: &mut SqliteConnection,
    sources: impl Iterator<Item = (&Path, &str)>,
) -> sqlx::Result<()> {
    out.execute("BEGIN").await?;
    for (file, state) in sources {
        let sql = "UPDATE main.source SET state = ? WHERE file = ?";
        sqlx::query(sql).bind(state).bind(file.to_string_lossy()).execute(&mut *out).await?;
    }
    out.execute("COMMIT").await.map(drop)
}

/// Completes the result: ends attempts that a dead run, or one that continues elsewhere, left running.
pub(super) async fn finish(out: &mut SqliteConnection) -> sqlx::Result<()> {
    out.execute(store::RELEASE_ORPHANS).await?;
    let first = "UPDATE main.sweep
         SET created_at = (SELECT min(s.created_at) FROM temp.sweeps s WHERE s.new = sweep.id)";
    out.execute(first).await.map(drop)
}

/// Whether a database contains trials with facts only, and whether it contains whole trials.
pub(super) async fn extents(db: &mut SqliteConnection, schema: &str) -> sqlx::Result<[bool; 2]> {
    // Safe: contains only our own names.
    let sql = format!(
        "SELECT EXISTS (SELECT 1 FROM {schema}.elsewhere),
           (SELECT count(*) FROM {schema}.trial) > (SELECT count(*) FROM {schema}.elsewhere)"
    );
    let (facts, whole): (bool, bool) = sqlx::query_as(AssertSqlSafe(sql)).fetch_one(db).await?;
    Ok([facts, whole])
}

/// Number of trials in the result.
pub(super) async fn trials(out: &mut SqliteConnection) -> sqlx::Result<usize> {
    let count: i64 = sqlx::query_scalar("SELECT count(*) FROM main.trial").fetch_one(out).await?;
    Ok(count as usize)
}

/// `trial` and the tables with rows of trials, each with its column for the trial's id.
pub(super) async fn tables_of_trials(out: &mut SqliteConnection) -> sqlx::Result<Vec<(String, String)>> {
    let sql = "SELECT t.name, c.name FROM main.sqlite_schema t, pragma_table_info(t.name) c
         WHERE t.type = 'table' AND c.name = 'trial_id' AND t.name <> 'sweep_trial' ORDER BY t.name";
    let children: Vec<(String, String)> = sqlx::query_as(sql).fetch_all(out).await?;
    Ok([("trial".to_owned(), "id".to_owned())].into_iter().chain(children).collect())
}

/// All columns of a table except `but`, as an SQL list.
pub(super) async fn columns(out: &mut SqliteConnection, table: &str, but: &str) -> sqlx::Result<String> {
    let sql = "SELECT group_concat('\"' || name || '\"', ', ' ORDER BY cid) FROM pragma_table_info(?, 'main')
         WHERE name <> ?";
    sqlx::query_scalar(sql).bind(table).bind(but).fetch_one(out).await
}

pub(super) fn prefix_columns(columns: &str) -> String {
    columns.split(", ").map(|name| format!("x.{name}")).collect::<Vec<_>>().join(", ")
}
