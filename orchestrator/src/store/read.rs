//! Read-only questions to a database, also while a run writes to it.
//!
//! A read-only connection makes the journal's two files where they are missing and cannot remove them again: `close`
//! does, unless somebody else is at work on the database.

use std::fs::File;
use std::path::{Path, PathBuf};

use futures_util::TryStreamExt;
use serde_json::Value;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection, SqliteRow};
use sqlx::{
    AssertSqlSafe, Column, ConnectOptions, Connection, Either, Executor, Row as _, SqlSafeStr, Statement,
    TypeInfo, ValueRef,
};
use tempfile::TempDir;

use super::error::{is_not_opened, is_trouble};
use super::write::read_checkpoint;
use super::{
    OPENING, Store, StoreError, beside, check_version, has_journal, is_still, lock, npy_values, options, real,
};
use crate::files;
use crate::leftovers;
use metasense_schemas::database::MIGRATIONS;
use metasense_schemas::record::Checkpoint;
use metasense_schemas::spec::position_of;

/// An answer in whole: names of its columns, and its rows; a blob stands as the text `blob of N bytes`.
pub type Answer = (Vec<String>, Vec<Vec<Value>>);

/// A row of an answer, as SQLite holds it.
#[derive(Debug)]
pub struct Row<'a>(&'a SqliteRow);

impl Row<'_> {
    /// A text; empty where there is none.
    #[must_use]
    pub fn text(&self, column: &str) -> &str {
        std::str::from_utf8(self.bytes(column)).unwrap_or_default()
    }

    /// A text's or blob's bytes; none where there is neither.
    #[must_use]
    pub fn bytes(&self, column: &str) -> &[u8] {
        self.0.try_get_unchecked(column).unwrap_or_default()
    }

    /// A number, where there is one.
    #[must_use]
    pub fn number(&self, column: &str) -> Option<f64> {
        self.0.try_get_unchecked::<Option<f64>, _>(column).unwrap_or_default()
    }

    /// A whole number, 0 where there is none.
    #[must_use]
    pub fn count(&self, column: &str) -> u64 {
        self.0.try_get_unchecked(column).map_or(0, |n: i64| n.max(0) as u64)
    }

    /// All its values; a blob stands as the text `blob of N bytes`.
    #[must_use]
    pub fn values(&self) -> Vec<Value> {
        values(self.0)
    }
}

/// A read-only connection.
#[derive(Debug)]
pub struct Reader {
    pub(super) connection: SqliteConnection,
    pub(super) path: PathBuf,
    pub(super) alone: bool,
    /// What is read in place of the file, where that cannot be.
    pub(super) _copy: Option<TempDir>,
}

/// A stored array.
#[derive(Debug, Clone)]
pub struct Artifact {
    /// Its trial.
    pub hash: String,
    /// Its name within the trial.
    pub name: String,
    /// The NPY file.
    pub bytes: Vec<u8>,
}

impl Artifact {
    /// Its values in C order.
    ///
    /// # Errors
    /// Where the bytes are no array of this type.
    pub fn values<T: npyz::Deserialize>(&self) -> Result<Vec<T>, StoreError> {
        npy_values(&self.bytes).map_err(|e| StoreError::Unreadable {
            hash: self.hash.clone(),
            what: "array",
            message: format!("{}: {e}", self.name),
        })
    }
}

impl Reader {
    /// Opens a database to read; one of an older version is upgraded first.
    ///
    /// # Errors
    /// Missing, not ours, of a newer version.
    pub async fn open(path: impl AsRef<Path>) -> Result<Self, StoreError> {
        Self::open_file(real(path.as_ref())).await.map_err(StoreError::on_opening)
    }

    async fn open_file(path: PathBuf) -> Result<Self, StoreError> {
        if !path.is_file() {
            return Err(StoreError::Missing { path });
        }
        let alone = !beside(&path, "-wal").exists();
        if alone && path.metadata().is_ok_and(|file| file.len() == 0) {
            return Err(StoreError::NotOurs { path });
        }
        let (mut connection, mut copy) = connect(reading(&path), &path).await?;
        let version = check_version(&mut connection, &path).await?;
        if version < MIGRATIONS.len() {
            drop(connection);
            Store::open(&path).await?.close().await?;
            (connection, copy) = connect(reading(&path), &path).await?;
        }
        Ok(Self { connection, path, alone, _copy: copy })
    }

    /// Opens a database, asks it, and closes it, whatever came of that.
    ///
    /// # Errors
    /// As [`Reader::open`], or as what was asked.
    pub async fn asked<T, E: From<StoreError>>(
        path: impl AsRef<Path>,
        ask: impl AsyncFnOnce(&mut Self) -> Result<T, E>,
    ) -> Result<T, E> {
        let mut reader = Self::open(path.as_ref()).await?;
        let answer = ask(&mut reader).await;
        reader.close().await;
        answer
    }

    /// Closes the connection and leaves no file behind that was not there before.
    pub async fn close(self) {
        let Self { connection, path, alone, _copy } = self;
        // Whatever goes wrong here harms nobody: the next writer tidies up as well.
        let closed = connection.close().await;
        if closed.is_ok()
            && alone
            && let Ok(_lock) = lock(&path, false)
            && let Ok(mut writable) = options(&path).connect().await
        {
            let _ = writable.execute("SELECT count(*) FROM sqlite_schema").await;
            let _ = writable.close().await;
        }
    }

    /// Answers one statement. A write is refused, and so are several statements: their rows have no common columns.
    ///
    /// # Errors
    /// With SQLite's message.
    pub async fn query<T: From<Answer>>(&mut self, sql: &str) -> Result<T, StoreError> {
        let (columns, mut rows) = (self.columns(sql).await?, Vec::new());
        self.each(sql, |row| {
            rows.push(row.values());
            Ok::<_, StoreError>(())
        })
        .await?;
        Ok(T::from((columns, rows)))
    }

    /// The names of an answer's columns.
    ///
    /// # Errors
    /// With SQLite's message.
    pub async fn columns(&mut self, sql: &str) -> Result<Vec<String>, StoreError> {
        let path = &self.path;
        // It ends sqlx's thread, and whoever has asked waits for ever.
        if sql.contains('\0') {
            return Err(StoreError::Query { message: "a statement holds no NUL".into() });
        }
        let word = sql.split(|c: char| c.is_whitespace() || c == ';').find(|word| !word.is_empty());
        let refused = match word {
            None => Some("there is no statement"),
            // it would leave an empty file
            Some(word) if word.eq_ignore_ascii_case("vacuum") => {
                Some("VACUUM writes; only what reads is answered")
            }
            Some(_) => None,
        };
        if let Some(message) = refused {
            return Err(StoreError::Query { message: message.into() });
        }
        // The user's own statement, on a connection that cannot write.
        let statement = self.connection.prepare(AssertSqlSafe(sql.to_owned()).into_sql_str()).await;
        let statement = statement.map_err(|source| wrong(path, source))?;
        Ok(statement.columns().iter().map(|c| c.name().to_owned()).collect())
    }

    /// Answers one statement row by row, as [`Reader::query`] does, until `take` has had enough or fails.
    ///
    /// # Errors
    /// With SQLite's message, or as `take`.
    pub async fn each<E: From<StoreError>>(
        &mut self,
        sql: &str,
        mut take: impl FnMut(&Row<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let path = &self.path;
        let sql = AssertSqlSafe(sql.to_owned()).into_sql_str();
        let mut ended = false;
        let mut answers = self.connection.fetch_many(sqlx::raw_sql(sql));
        while let Some(answer) = answers.try_next().await.map_err(|source| wrong(path, source))? {
            if ended {
                let message = "one statement at a time; more follows the first one's `;`".into();
                return Err(StoreError::Query { message }.into());
            }
            match answer {
                Either::Right(row) => take(&Row(&row))?,
                Either::Left(_) => ended = true,
            }
        }
        Ok(())
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The one trial whose hash begins so.
    ///
    /// # Errors
    /// `NotOne` where there is none, or are several.
    pub async fn hash_of(&mut self, beginning: &str) -> Result<String, StoreError> {
        // Hashes are hex digits, none of which comes after f.
        let sql = "SELECT hash FROM trial WHERE hash >= ?1 AND hash < ?1 || 'g' LIMIT 2";
        if let [hash] = &self.hashes(sql, beginning).await?[..] {
            return Ok(hash.clone());
        }
        let all = self.hashes("SELECT hash FROM trial ORDER BY hash", "").await?;
        let found = position_of(beginning, all.iter().map(String::as_str));
        let at = found.map_err(|which| StoreError::NotOne { path: self.path.clone(), which })?;
        Ok(all[at].clone())
    }

    async fn hashes(&mut self, sql: &'static str, beginning: &str) -> Result<Vec<String>, StoreError> {
        let query = sqlx::query_scalar(sql);
        let query = if sql.contains('?') { query.bind(beginning) } else { query };
        let found = query.fetch_all(&mut self.connection).await;
        found.map_err(|source| StoreError::sql(&self.path, "reading", source))
    }

    /// The database that has a trial's steps, curves and arrays, where its facts alone are here; to be closed.
    ///
    /// # Errors
    /// `Elsewhere` where that does not have it any more.
    pub async fn rest_of(&mut self, hash: &str) -> Result<Option<Self>, StoreError> {
        let sql = "SELECT s.file FROM trial t JOIN elsewhere e ON e.trial_id = t.id JOIN source s ON s.id = e.source_id
             WHERE t.hash = ?";
        let file: Option<String> = sqlx::query_scalar(sql)
            .bind(hash)
            .fetch_optional(&mut self.connection)
            .await
            .map_err(|source| StoreError::sql(&self.path, "reading", source))?;
        let Some(file) = file.map(PathBuf::from) else { return Ok(None) };
        let opened = async {
            let mut rest = Self::open(&file).await?;
            rest.hash_of(hash).await.map(|_| rest)
        };
        let gone = |source| StoreError::Elsewhere {
            path: self.path.clone(),
            hash: hash.to_owned(),
            file: file.clone(),
            source: Box::new(source),
        };
        opened.await.map(Some).map_err(gone)
    }

    /// A trial's last checkpoint; `None` where it has none.
    ///
    /// # Errors
    /// Where SQLite fails, or the checkpoint is of another program.
    pub async fn checkpoint(&mut self, hash: &str) -> Result<Option<Checkpoint>, StoreError> {
        let sql = "SELECT c.bytes FROM checkpoint c JOIN trial t ON t.id = c.trial_id WHERE t.hash = ?";
        let bytes: Option<Vec<u8>> = sqlx::query_scalar(sql)
            .bind(hash)
            .fetch_optional(&mut self.connection)
            .await
            .map_err(|source| StoreError::sql(&self.path, "reading a checkpoint from", source))?;
        bytes.map(|bytes| read_checkpoint(hash, &bytes)).transpose()
    }

    /// The stored arrays of a trial, by name, wherever they lie.
    pub async fn arrays_of(&mut self, hash: &str) -> Result<Vec<Artifact>, StoreError> {
        if let Some(mut rest) = self.rest_of(hash).await? {
            let arrays = rest.own_arrays_of(hash).await;
            rest.close().await;
            return arrays;
        }
        self.own_arrays_of(hash).await
    }

    async fn own_arrays_of(&mut self, hash: &str) -> Result<Vec<Artifact>, StoreError> {
        let rows: Vec<(String, String, Vec<u8>)> = sqlx::query_as(
            "SELECT t.hash, a.name, a.bytes FROM artifact a JOIN trial t ON t.id = a.trial_id
             WHERE t.hash = ? ORDER BY a.name",
        )
        .bind(hash)
        .fetch_all(&mut self.connection)
        .await
        .map_err(|source| StoreError::sql(&self.path, "reading", source))?;
        Ok(rows.into_iter().map(|(hash, name, bytes)| Artifact { hash, name, bytes }).collect())
    }
}

/// A text as SQL has it: databases from elsewhere may name trials as they like.
#[must_use]
pub fn quoted(text: &str) -> String {
    format!("'{}'", text.replace('\'', "''"))
}

/// What SQLite says of a statement that a person has put.
fn wrong(path: &Path, source: sqlx::Error) -> StoreError {
    match &source {
        sqlx::Error::Database(e) if !is_trouble(&source) => {
            StoreError::Query { message: e.message().to_owned() }
        }
        _ => StoreError::sql(path, "querying", source),
    }
}

/// Asks a database that nobody writes to, as a file that does not change: neither locks nor a journal are looked for. It may
/// be of an older version.
pub async fn ask_unchanging<T>(
    path: &Path,
    ask: impl AsyncFnOnce(&mut SqliteConnection) -> sqlx::Result<T>,
) -> sqlx::Result<T> {
    let mut connection = options(path).read_only(true).immutable(true).connect().await?;
    let answer = ask(&mut connection).await?;
    connection.close().await?;
    Ok(answer)
}

/// Rows on their way, of some kB at most but for arrays, which are some tens.
const ROWS: usize = 256;

/// Read-only.
pub(super) fn reading(path: &Path) -> SqliteConnectOptions {
    // Rows on their way from SQLite's thread: with fewer the two wait for each other most of the time.
    options(path).read_only(true).pragma("query_only", "ON").row_buffer_size(ROWS)
}

/// Where the folder cannot hold the journal's index (a read-only medium), as an unchanging file; where there is a journal, a
/// copy of both, which lives as long as its folder.
pub(super) async fn connect(
    options: SqliteConnectOptions,
    path: &Path,
) -> Result<(SqliteConnection, Option<TempDir>), StoreError> {
    let at = |source| StoreError::sql(path, OPENING, source);
    let mut connection = options.clone().connect().await.map_err(at)?;
    match connection.execute("SELECT count(*) FROM sqlite_schema").await {
        Ok(_) => return Ok((connection, None)),
        Err(e) if is_not_opened(&e) => {}
        Err(source) => return Err(at(source)),
    }
    if !has_journal(path) {
        return Ok((options.immutable(true).connect().await.map_err(at)?, None));
    }
    let failed = |source| StoreError::NotCopied { path: path.to_owned(), source };
    let scratch = leftovers::scratch("metasense-read-").map_err(failed)?;
    let copy = scratch.path().join("copy.sqlite");
    copy_with_journal(path, &copy)?;
    Ok((options.filename(copy).connect().await.map_err(at)?, Some(scratch)))
}

/// Copies a database that nobody writes to, with what lies in its journal.
///
/// # Errors
/// `InUse` where somebody does; `NotCopied` where the system fails.
pub(crate) fn copy_with_journal(path: &Path, copy: &Path) -> Result<(), StoreError> {
    let failed = |source| StoreError::NotCopied { path: path.to_owned(), source };
    let lock = File::open(path).map_err(failed)?;
    if files::is_held(&lock) || !is_still(&lock, path) {
        return Err(StoreError::InUse { path: path.to_owned() });
    }
    for end in ["", "-wal"] {
        std::fs::copy(beside(path, end), beside(copy, end)).map_err(failed)?;
    }
    Ok(())
}

fn values(row: &SqliteRow) -> Vec<Value> {
    (0..row.len()).map(|i| value(row, i)).collect()
}

fn value(row: &SqliteRow, i: usize) -> Value {
    let raw = row.try_get_raw(i).expect("a column of this row");
    if raw.is_null() {
        return Value::Null;
    }
    match raw.type_info().name() {
        "INTEGER" => Value::from(row.get_unchecked::<i64, _>(i)),
        "REAL" => Value::from(row.get_unchecked::<f64, _>(i)),
        "BLOB" => Value::from(format!("blob of {} bytes", row.get_unchecked::<&[u8], _>(i).len())),
        // Not all that SQLite calls text is UTF-8.
        _ => Value::from(String::from_utf8_lossy(row.get_unchecked::<&[u8], _>(i))),
    }
}
