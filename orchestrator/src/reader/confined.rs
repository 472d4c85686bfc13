//! Queries by untrusted users: they can read only the database's own rows, within limits.

use std::ffi::c_int;
use std::path::Path;
use std::time::{Duration, Instant};

use libsqlite3_sys as ffi;

use super::allow::{AccessLevel, allow};
use super::{QueryResult, Reader};
use crate::files::resolve_links;
use crate::sql::{self, Scalar};
use crate::store::{OPENING, StoreError};

/// Limits of an answer.
#[derive(Debug, Clone, Copy)]
pub struct AnswerLimits {
    /// Rows.
    pub rows: usize,
    /// Bytes of its values as JSON.
    pub bytes: usize,
    /// Time.
    pub time: Duration,
}

/// Longest text or blob that SQLite may read or create (bytes). It keeps every function below one second, except those in
/// `SLOW`. Specs and results are shorter; most arrays are longer.
const LONGEST: c_int = 256 << 10;
/// Longest pattern of LIKE and GLOB (bytes).
const PATTERN: c_int = 500;
/// Functions of two arguments whose run time grows as the product of their lengths.
const SLOW: [Scalar; 5] = [
    (c"trim", 2, refuse),
    (c"ltrim", 2, refuse),
    (c"rtrim", 2, refuse),
    (c"json_patch", 2, refuse),
    (c"jsonb_patch", 2, refuse),
];
/// Rows buffered between SQLite and the reader.
const ROWS_AHEAD: usize = 4;
/// SQLite operations between two checks of the time limit. Each may call a function.
const OPERATIONS: c_int = 20;

impl Reader {
    /// Opens a database for untrusted SQL. As [`Reader::open`], but limits the length of values and thereby the time of a
    /// single operation, which cannot be interrupted.
    ///
    /// # Errors
    /// As [`Reader::open`].
    pub async fn confined(path: &Path) -> Result<Self, StoreError> {
        let path = resolve_links(path);
        let at = |source| StoreError::sql(&path, OPENING, source);
        let mut reader = Self::open_file(path.clone(), Some(ROWS_AHEAD)).await?;
        reader.allowed = AccessLevel::Confined;
        allow(&mut reader.connected.connection, reader.allowed).await.map_err(at)?;
        sql::add(&mut reader.connected.connection, &SLOW, &[]).await.map_err(at)?;
        let mut handle = reader.connected.connection.lock_handle().await.map_err(at)?;
        let db = handle.as_raw_handle().as_ptr();
        // SAFETY: the handle is locked and open.
        unsafe {
            ffi::sqlite3_limit(db, ffi::SQLITE_LIMIT_LENGTH, LONGEST);
            ffi::sqlite3_limit(db, ffi::SQLITE_LIMIT_LIKE_PATTERN_LENGTH, PATTERN);
        }
        drop(handle);
        Ok(reader)
    }

    /// Answers one statement within limits. Returns the rows and, if they were cut off, the reason.
    ///
    /// # Errors
    /// If SQLite fails or no row arrives in time.
    pub async fn limited<T: From<QueryResult>>(
        &mut self,
        sql: &str,
        limits: AnswerLimits,
    ) -> Result<(T, Option<String>), StoreError> {
        let begun = Instant::now();
        self.ask_while(OPERATIONS, move || begun.elapsed() < limits.time).await?;
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
                Err(StoreError::Query(String::new()))
            })
            .await;
        let why = match (taken, full) {
            (Ok(()), None) => None,
            (_, Some(why)) => Some(why),
            (Err(_), None) if begun.elapsed() >= limits.time && rows.is_empty() => {
                return Err(StoreError::Query(late()));
            }
            (Err(_), None) if begun.elapsed() >= limits.time => Some(late()),
            (Err(e), None) => return Err(e),
        };
        Ok((T::from((columns, rows)), why))
    }
}

/// Replaces a function that could run for minutes.
unsafe extern "C" fn refuse(context: *mut ffi::sqlite3_context, _: c_int, _: *mut *mut ffi::sqlite3_value) {
    let why =
        c"trim, ltrim, rtrim and json_patch of two arguments are not available here; use `metasense query`";
    // SAFETY: the context is SQLite's; it copies the text.
    unsafe { ffi::sqlite3_result_error(context, why.as_ptr(), -1) }
}

#[cfg(test)]
mod tests;
