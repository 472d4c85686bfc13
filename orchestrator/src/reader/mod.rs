//! Read-only queries of a database for commands, reports and pages, also while a run writes to it. A run does not need them.
//!
//! A read-only connection creates missing journal files, but cannot remove them. `close` does, unless another process uses the
//! database.

mod allow;
mod confined;
mod connect;
mod looks;
mod made;
mod stored;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use futures_util::TryStreamExt;
use serde_json::Value;
use sqlx::sqlite::SqliteRow;
use sqlx::{
    AssertSqlSafe, Column, ConnectOptions, Connection, Executor, FromRow, Row as _, SqlSafeStr, Statement,
    TypeInfo, ValueRef,
};

use crate::cell;
use crate::files::{has_journal, resolve_links, sidecar};
use crate::hashes::position_of;
use crate::store::{
    StoreError, check, check_utf8, is_no_json, is_trouble, lock, npy_values, options, read_checkpoint,
};
use allow::{AccessLevel, NOT_READING, TYPES_VIEW, allow};
pub use confined::AnswerLimits;
pub use connect::ask_unchanging;
use connect::{Connected, connect, state};
pub(crate) use connect::{copy_with_journal, state_of};
pub use looks::TrialProgress;
pub use made::{CodeVersion, Nearest};
use metasense_schemas::record::Checkpoint;
pub use stored::StoredTrial;

/// A complete answer: column names, and rows; blobs are replaced by the text `blob of N bytes`.
pub type QueryResult = (Vec<String>, Vec<Vec<Value>>);

/// A row of an answer.
#[derive(Debug)]
pub struct Row<'a>(&'a SqliteRow);

impl Row<'_> {
    /// A text; empty if it is missing.
    pub fn text(&self, column: &str) -> &str {
        std::str::from_utf8(self.bytes(column)).unwrap_or_default()
    }

    /// The bytes of a text or blob; empty if it is missing.
    pub fn bytes(&self, column: &str) -> &[u8] {
        self.0.try_get_unchecked(column).unwrap_or_default()
    }

    /// A number; `None` if it is missing.
    pub fn number(&self, column: &str) -> Option<f64> {
        self.0.try_get_unchecked::<Option<f64>, _>(column).unwrap_or_default()
    }

    /// A non-negative integer; 0 if it is missing.
    pub fn count(&self, column: &str) -> u64 {
        self.0.try_get_unchecked(column).map_or(0, |n: i64| n.max(0) as u64)
    }

    /// An array of a trial, in the columns `name`, `bytes` and `digest`.
    pub fn array(&self, hash: &str) -> Artifact {
        let [bytes, digest] = ["bytes", "digest"].map(|column| self.bytes(column).to_owned());
        Artifact { hash: hash.to_owned(), name: self.text("name").to_owned(), bytes, digest: Some(digest) }
    }

    /// All values; blobs are replaced by the text `blob of N bytes`.
    pub fn values(&self) -> Vec<Value> {
        (0..self.0.len()).map(|i| value(self.0, i)).collect()
    }
}

/// A read-only connection.
#[derive(Debug)]
pub struct Reader {
    connected: Connected,
    path: PathBuf,
    /// Which statements it accepts.
    allowed: AccessLevel,
    /// Whether no other connection existed when it was opened.
    alone: bool,
}

/// SQLite operations between two checks of [`Reader::stop_when`].
const OPERATIONS: i32 = 10_000;

/// A stored array.
#[derive(Debug, Clone)]
pub struct Artifact {
    /// Its trial.
    pub hash: String,
    /// Its name within the trial.
    pub name: String,
    /// The NPY file, and its checksum.
    bytes: Vec<u8>,
    digest: Option<Vec<u8>>,
}

impl Artifact {
    /// The NPY file.
    ///
    /// # Errors
    /// If it is damaged.
    pub fn npy(&self) -> Result<&[u8], StoreError> {
        let checksum = self.digest.as_deref().unwrap_or_default();
        check(&self.hash, &format!("array {}", self.name), &self.bytes, checksum).map(|()| &*self.bytes)
    }

    /// The values in C order.
    ///
    /// # Errors
    /// If it is damaged or not an array of this type.
    pub fn values<T: npyz::Deserialize>(&self) -> Result<Vec<T>, StoreError> {
        npy_values(self.npy()?)
            .map_err(|e| StoreError::unreadable(&self.hash, "array", format!("{}: {e}", self.name)))
    }
}

impl Reader {
    /// Opens a database for reading; the file is not changed.
    ///
    /// # Errors
    /// If the file is missing, not a metasense database, or of another version.
    pub async fn open(path: impl AsRef<Path>) -> Result<Self, StoreError> {
        Self::open_file(resolve_links(path.as_ref()), None).await.map_err(StoreError::on_opening)
    }

    /// The same, with this number of rows buffered.
    async fn open_file(path: PathBuf, rows: Option<usize>) -> Result<Self, StoreError> {
        if !path.is_file() {
            return Err(StoreError::Missing(path));
        }
        check_utf8(&path)?;
        let alone = !sidecar(&path, "-wal").exists();
        if alone && path.metadata().is_ok_and(|file| file.len() == 0) {
            return Err(StoreError::NotOurs(path));
        }
        let connected = connect(&path, rows).await?;
        let alone = alone && connected.unchanging.is_none();
        Ok(Self { connected, path, allowed: AccessLevel::Reading, alone })
    }

    /// Opens a database, calls `ask`, and closes the database in any case.
    ///
    /// # Errors
    /// As [`Reader::open`], or as `ask`; `Changed` if the file was read without locks and has changed meanwhile.
    pub async fn with_reader<T, E: From<StoreError>>(
        path: impl AsRef<Path>,
        ask: impl AsyncFnOnce(&mut Self) -> Result<T, E>,
    ) -> Result<T, E> {
        let mut reader = Self::open(path.as_ref()).await?;
        let answer = ask(&mut reader).await;
        let current = reader.is_current();
        let path = reader.path.clone();
        reader.close().await;
        if current { answer } else { Err(StoreError::Changed(path).into()) }
    }

    /// Makes statements fail once `stop` is true.
    ///
    /// # Errors
    /// If SQLite fails.
    pub async fn stop_when(&mut self, stop: Arc<AtomicBool>) -> Result<(), StoreError> {
        self.ask_while(OPERATIONS, move || !stop.load(Ordering::Relaxed)).await
    }

    /// Makes statements fail once `goes_on` is false, which is called after so many operations.
    async fn ask_while(
        &mut self,
        operations: i32,
        goes_on: impl FnMut() -> bool + Send + 'static,
    ) -> Result<(), StoreError> {
        let handle = self.connected.connection.lock_handle().await;
        let mut handle = handle.map_err(|source| StoreError::sql(&self.path, "querying", source))?;
        handle.set_progress_handler(operations, goes_on);
        Ok(())
    }

    /// Whether the file has not changed since it was opened without locks. Always true of files that are locked for reading.
    pub fn is_current(&self) -> bool {
        let same = |was: &String| state(&self.path).is_ok_and(|now| now == *was) && !has_journal(&self.path);
        self.connected.unchanging.as_ref().is_none_or(same)
    }

    /// Closes the connection and removes the files that it created.
    pub async fn close(self) {
        let Self { connected, path, alone, .. } = self;
        // Failures do no harm here: the next writer tidies up as well.
        let closed = connected.connection.close().await;
        if closed.is_ok()
            && alone
            && let Ok(_lock) = lock(&path, false)
            && let Ok(mut writable) = options(&path).connect().await
        {
            let _ = writable.execute("SELECT count(*) FROM sqlite_schema").await;
            let _ = writable.close().await;
        }
    }

    /// Answers a single statement that reads.
    ///
    /// # Errors
    /// With SQLite's message, if the statement is invalid or refused.
    pub async fn query<T: From<QueryResult>>(&mut self, sql: &str) -> Result<T, StoreError> {
        let columns = self.columns(sql).await?;
        Ok(T::from((columns, self.rows(sql, |row| row.values()).await?)))
    }

    /// The column names of an answer.
    ///
    /// # Errors
    /// With SQLite's message, if the statement is invalid or refused.
    pub async fn columns(&mut self, sql: &str) -> Result<Vec<String>, StoreError> {
        // A NUL kills sqlx's thread, and the caller would wait forever.
        if sql.contains('\0') {
            return Err(StoreError::Query("a statement must not contain NUL".into()));
        }
        if sql.chars().all(|c| c.is_whitespace() || c == ';') {
            return Err(StoreError::Query("the statement is empty".into()));
        }
        let (path, connection) = (&self.path, &mut self.connected.connection);
        let refused = allow::refusal(connection, sql).await;
        if let Some(message) = refused.map_err(|source| StoreError::sql(path, "querying", source))? {
            return Err(StoreError::Query(message));
        }
        // The user's own statement, on a connection that cannot write.
        let statement = connection.prepare(AssertSqlSafe(sql.to_owned()).into_sql_str()).await;
        let statement = statement.map_err(|source| wrong(path, source))?;
        Ok(statement.columns().iter().map(|c| c.name().to_owned()).collect())
    }

    /// The declared SQL types of a result's columns: those of table columns, view columns and CASTs. Empty for other expressions.
    pub async fn types(&mut self, sql: &str) -> Vec<String> {
        let connection = &mut self.connected.connection;
        if allow(connection, AccessLevel::Describing).await.is_err() {
            return Vec::new();
        }
        // The authorizer refuses everything but reading and this view.
        let view = format!("CREATE TEMP VIEW {TYPES_VIEW} AS {sql}");
        let mut types = Vec::new();
        if connection.execute(AssertSqlSafe(view)).await.is_ok() {
            let asked = sqlx::query_scalar("SELECT type FROM pragma_table_info(?)").bind(TYPES_VIEW);
            types = asked.fetch_all(&mut *connection).await.unwrap_or_default();
            let gone = format!("DROP VIEW temp.{TYPES_VIEW}");
            let _ = connection.execute(AssertSqlSafe(gone)).await;
        }
        let _ = allow(connection, self.allowed).await;
        types
    }

    /// Passes the rows of one statement to `take`, until it fails. [`Reader::columns`] must have accepted the statement.
    ///
    /// # Errors
    /// If SQLite or `take` fails.
    pub async fn each<E: From<StoreError>>(
        &mut self,
        sql: &str,
        mut take: impl FnMut(&Row<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let sql = AssertSqlSafe(sql.to_owned()).into_sql_str();
        let mut rows = self.connected.connection.fetch(sqlx::raw_sql(sql));
        let failed = loop {
            match rows.try_next().await {
                Ok(Some(row)) => take(&Row(&row))?,
                Ok(None) => return Ok(()),
                Err(source) => break source,
            }
        };
        drop(rows);
        let cell = if is_no_json(&failed) { self.cell_without_json().await } else { None };
        Err(cell.unwrap_or_else(|| wrong(&self.path, failed)).into())
    }

    /// A value per row of one statement; see [`Reader::each`].
    ///
    /// # Errors
    /// If SQLite fails.
    pub async fn rows<T>(
        &mut self,
        sql: &str,
        mut of: impl FnMut(&Row<'_>) -> T,
    ) -> Result<Vec<T>, StoreError> {
        let mut found = Vec::new();
        let taken = self.each(sql, |row| {
            found.push(of(row));
            Ok(())
        });
        taken.await.map(|()| found)
    }

    /// Finds a trial whose spec or result is not JSON. SQLite's message does not name it.
    async fn cell_without_json(&mut self) -> Option<StoreError> {
        let sql = "SELECT hash, json_valid(spec) FROM trial WHERE NOT json_valid(spec) OR NOT json_valid(result) LIMIT 1";
        let asked = sqlx::query_as(sql).fetch_optional(&mut self.connected.connection).await;
        let (hash, spec): (String, bool) = asked.ok()??;
        let what = if spec { "result" } else { "spec" };
        Some(StoreError::unreadable(&hash, what, "it is not JSON"))
    }

    /// Path of the database.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The hash of the only trial whose hash starts with `beginning`.
    ///
    /// # Errors
    /// `NotOne` if no trial or several match.
    pub async fn hash_of(&mut self, beginning: &str) -> Result<String, StoreError> {
        // Hashes are hex digits, all below 'g'.
        let sql = "SELECT hash FROM trial WHERE hash >= ?1 AND hash < ?1 || 'g' LIMIT 2";
        if let [(hash,)] = &self.ask::<(String,)>(sql, beginning).await?[..] {
            return Ok(hash.clone());
        }
        let all: Vec<(String,)> = self.ask("SELECT hash FROM trial ORDER BY hash", "").await?;
        let found = position_of(beginning, all.iter().map(|(hash,)| hash.as_str()));
        let at = found.map_err(|which| StoreError::NotOne(self.path.clone(), which))?;
        Ok(all[at].0.clone())
    }

    /// The rows of a statement of ours, whose parameter, if it has one, is `value`.
    async fn ask<T>(&mut self, sql: &'static str, value: &str) -> Result<Vec<T>, StoreError>
    where
        T: for<'r> FromRow<'r, SqliteRow> + Send + Unpin,
    {
        let query = sqlx::query_as::<sqlx::Sqlite, T>(sql);
        let query = if sql.contains('?') { query.bind(value) } else { query };
        let found = query.fetch_all(&mut self.connected.connection).await;
        found.map_err(|source| StoreError::sql(&self.path, "reading", source))
    }

    /// Opens the database with a trial's steps, curves and arrays if only its facts are stored here. The caller must close it.
    ///
    /// # Errors
    /// `Elsewhere` if that database cannot be read or lacks the trial.
    pub async fn open_source_of(&mut self, hash: &str) -> Result<Option<Self>, StoreError> {
        let sql = "SELECT s.file FROM trial t JOIN elsewhere e ON e.trial_id = t.id JOIN source s ON s.id = e.source_id
             WHERE t.hash = ?";
        let Some((file,)) = self.ask::<(String,)>(sql, hash).await?.pop() else { return Ok(None) };
        let file = PathBuf::from(file);
        let opened = async {
            let mut rest = Self::open(&file).await?;
            rest.hash_of(hash).await.map(|_| rest)
        };
        let gone = |error| {
            let (path, hash, source) = (self.path.clone(), hash.to_owned(), Box::new(error));
            StoreError::Elsewhere { path, hash, file: file.clone(), source }
        };
        opened.await.map(Some).map_err(gone)
    }

    /// Last checkpoint of a trial; `None` without one.
    ///
    /// # Errors
    /// If SQLite fails, or the checkpoint is damaged or of another version.
    pub async fn checkpoint(&mut self, hash: &str) -> Result<Option<Checkpoint>, StoreError> {
        let sql =
            "SELECT c.bytes, c.digest FROM checkpoint c JOIN trial t ON t.id = c.trial_id WHERE t.hash = ?";
        let stored = sqlx::query_as(sql).bind(hash).fetch_optional(&mut self.connected.connection).await;
        let stored = stored.map_err(|e| StoreError::sql(&self.path, "reading a checkpoint from", e))?;
        stored.map(|stored| read_checkpoint(hash, stored)).transpose()
    }

    /// The stored arrays of a trial by name, from the database that contains them.
    pub async fn arrays_of(&mut self, hash: &str) -> Result<Vec<Artifact>, StoreError> {
        if let Some(mut rest) = self.open_source_of(hash).await? {
            let arrays = rest.own_arrays_of(hash).await;
            rest.close().await;
            return arrays;
        }
        self.own_arrays_of(hash).await
    }

    async fn own_arrays_of(&mut self, hash: &str) -> Result<Vec<Artifact>, StoreError> {
        let sql = "SELECT t.hash, a.name, a.bytes, a.digest FROM artifact a JOIN trial t ON t.id = a.trial_id
             WHERE t.hash = ? ORDER BY a.name";
        let array = |(hash, name, bytes, digest)| Artifact { hash, name, bytes, digest };
        Ok(self.ask(sql, hash).await?.into_iter().map(array).collect())
    }
}

/// A text as an SQL literal. Databases from elsewhere may contain any hash.
pub fn quoted(text: &str) -> String {
    format!("'{}'", text.replace('\'', "''"))
}

/// The error of a user's statement.
fn wrong(path: &Path, source: sqlx::Error) -> StoreError {
    match &source {
        sqlx::Error::Database(e) if !is_trouble(&source) => {
            let refused = if e.code().as_deref() == Some("23") { NOT_READING } else { "" };
            StoreError::Query(format!("{}{refused}", e.message()))
        }
        _ => StoreError::sql(path, "querying", source),
    }
}

fn value(row: &SqliteRow, i: usize) -> Value {
    let raw = row.try_get_raw(i).expect("a column of this row");
    if raw.is_null() {
        return Value::Null;
    }
    match raw.type_info().name() {
        "INTEGER" => Value::from(row.get_unchecked::<i64, _>(i)),
        "REAL" => cell::real(row.get_unchecked(i)),
        "BLOB" => Value::from(format!("blob of {} bytes", row.get_unchecked::<&[u8], _>(i).len())),
        // SQLite text need not be UTF-8.
        _ => Value::from(String::from_utf8_lossy(row.get_unchecked::<&[u8], _>(i))),
    }
}

#[cfg(test)]
mod tests;
