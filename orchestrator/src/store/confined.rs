//! Questions from whoever: nothing but the database's own rows can be read, and answers have limits.

use std::ffi::{c_char, c_int, c_void};
use std::path::Path;
use std::time::{Duration, Instant};

use libsqlite3_sys as ffi;

use super::read::{Answer, connect, reading};
use super::{OPENING, Reader, StoreError, check_version};

/// What an answer may come to.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Rows.
    pub rows: usize,
    /// Bytes of its values, as JSON has them.
    pub bytes: usize,
    /// Time.
    pub time: Duration,
}

/// The longest text or blob that SQLite makes (bytes): the largest arrays of a trial are below it.
const LONGEST: c_int = 8 << 20;
/// Rows between SQLite and us.
const ROWS_AHEAD: usize = 4;
/// SQLite's operations between two looks at the clock: some tenths of a millisecond.
const OPERATIONS: c_int = 10_000;

impl Reader {
    /// Opens a database to questions that anybody may have put: no other file is opened, made or attached, no setting read
    /// or changed. It must be of the newest version.
    ///
    /// # Errors
    /// Missing, not ours.
    pub async fn confined(path: &Path) -> Result<Self, StoreError> {
        if !path.is_file() {
            return Err(StoreError::Missing { path: path.to_owned() });
        }
        let at = |source| StoreError::sql(path, OPENING, source);
        let mut connection = connect(reading(path).row_buffer_size(ROWS_AHEAD), path).await?;
        check_version(&mut connection, path).await?;
        let mut handle = connection.lock_handle().await.map_err(at)?;
        let db = handle.as_raw_handle().as_ptr();
        // SAFETY: the handle is locked and open; the callback has no data of its own, and both calls keep nothing of ours.
        unsafe {
            ffi::sqlite3_limit(db, ffi::SQLITE_LIMIT_LENGTH, LONGEST);
            ffi::sqlite3_limit(db, ffi::SQLITE_LIMIT_ATTACHED, 0);
            ffi::sqlite3_set_authorizer(db, Some(reads_only), std::ptr::null_mut());
        }
        drop(handle);
        Ok(Self { connection, path: path.to_owned(), alone: false })
    }

    /// Answers one statement as far as the limits allow; beside the rows, what ended them early.
    ///
    /// # Errors
    /// With SQLite's message, or where no row has come in time.
    pub async fn limited<T: From<Answer>>(
        &mut self,
        sql: &str,
        limits: Limits,
    ) -> Result<(T, Option<String>), StoreError> {
        let begun = Instant::now();
        let path = self.path.clone();
        let mut handle = self
            .connection
            .lock_handle()
            .await
            .map_err(|source| StoreError::sql(&path, "querying", source))?;
        handle.set_progress_handler(OPERATIONS, move || begun.elapsed() < limits.time);
        drop(handle);
        let late = || format!("it took more than {} s", limits.time.as_secs_f64());
        let (columns, mut rows) = (self.columns(sql).await?, Vec::new());
        let mut bytes = 0;
        let mut full = None;
        let taken = self
            .each(sql, |row| {
                if rows.len() == limits.rows {
                    full = Some(format!("there are more than {} rows", limits.rows));
                } else if begun.elapsed() >= limits.time {
                    full = Some(late());
                } else {
                    let row = row.values();
                    bytes += row.iter().map(|value| value.as_str().map_or(8, str::len)).sum::<usize>();
                    if bytes > limits.bytes {
                        full = Some(format!("there are more than {} bytes", limits.bytes));
                    } else {
                        rows.push(row);
                        return Ok(());
                    }
                }
                Err(StoreError::Query { message: String::new() })
            })
            .await;
        let why = match (taken, full) {
            (Ok(()), None) => None,
            (_, Some(why)) => Some(why),
            (Err(_), None) if begun.elapsed() >= limits.time && rows.is_empty() => {
                return Err(StoreError::Query { message: late() });
            }
            (Err(_), None) if begun.elapsed() >= limits.time => Some(late()),
            (Err(e), None) => return Err(e),
        };
        Ok((T::from((columns, rows)), why))
    }
}

/// Allows what reads rows.
unsafe extern "C" fn reads_only(
    _: *mut c_void,
    action: c_int,
    _: *const c_char,
    _: *const c_char,
    _: *const c_char,
    _: *const c_char,
) -> c_int {
    match action {
        ffi::SQLITE_SELECT | ffi::SQLITE_READ | ffi::SQLITE_FUNCTION | ffi::SQLITE_RECURSIVE => {
            ffi::SQLITE_OK
        }
        _ => ffi::SQLITE_DENY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Store;

    const LIMITS: Limits = Limits { rows: 10, bytes: 1000, time: Duration::from_millis(300) };

    /// Whatever would touch another file, or change anything, is refused, also behind another statement.
    #[tokio::test]
    async fn nothing_but_rows_can_be_had() {
        let bench = tempfile::tempdir().unwrap();
        let [db, other] = ["db.sqlite", "other.sqlite"].map(|name| bench.path().join(name));
        Store::open(&db).await.unwrap().close().await.unwrap();
        let mut reader = Reader::confined(&db).await.unwrap();
        let file = other.display();
        for sql in [
            format!("ATTACH '{file}' AS other"),
            format!("VACUUM INTO '{file}'"),
            format!("SELECT 1; VACUUM INTO '{file}'"),
            "PRAGMA query_only = OFF".into(),
            "PRAGMA database_list".into(),
            "SELECT * FROM pragma_database_list".into(),
            "SELECT load_extension('libc.so.6')".into(),
            "DELETE FROM trial".into(),
            "CREATE TEMP TABLE t (x)".into(),
            "BEGIN".into(),
            "SELECT '\0'".into(),
        ] {
            let answer = reader.limited::<Answer>(&sql, LIMITS).await;
            assert!(answer.is_err(), "{sql}: {answer:?}");
        }
        assert!(!other.exists());
        let (table, cut) =
            reader.limited::<Answer>("SELECT count(*) AS n FROM v_trial", LIMITS).await.unwrap();
        assert_eq!((table.1[0][0].as_i64(), cut), (Some(0), None));
    }

    /// Rows, bytes, time and the length of a value.
    #[tokio::test]
    async fn answers_end_at_their_limits() {
        let bench = tempfile::tempdir().unwrap();
        let db = bench.path().join("db.sqlite");
        Store::open(&db).await.unwrap().close().await.unwrap();
        let mut reader = Reader::confined(&db).await.unwrap();
        let count = |to: u64, what: &str| {
            format!(
                "WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM c WHERE n < {to}) SELECT {what} FROM c"
            )
        };
        for (sql, rows, why) in [
            (count(10, "n"), 10, None),
            (count(11, "n"), 10, Some("more than 10 rows")),
            (count(9, "printf('%400c', 'x')"), 2, Some("more than 1000 bytes")),
        ] {
            let (table, cut) = reader.limited::<Answer>(&sql, LIMITS).await.unwrap();
            assert_eq!(table.1.len(), rows, "{sql}");
            assert!(
                why.is_none_or(|why| cut.as_ref().is_some_and(|cut| cut.contains(why))),
                "{sql}: {cut:?}"
            );
        }
        for (sql, why) in
            [(count(1 << 40, "count(*)"), "more than 0.3 s"), ("SELECT zeroblob(9000000)".into(), "too big")]
        {
            let begun = Instant::now();
            let said = reader.limited::<Answer>(&sql, LIMITS).await.unwrap_err().to_string();
            assert!(said.contains(why) && begun.elapsed() < Duration::from_secs(5), "{sql}: {said}");
        }
    }
}
