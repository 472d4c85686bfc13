//! Questions from whoever: nothing but the database's own rows can be read, and answers have limits.

use std::ffi::{c_char, c_int, c_void};
use std::path::Path;
use std::time::{Duration, Instant};

use libsqlite3_sys as ffi;

use super::read::{Answer, connect, reading};
use super::{OPENING, Reader, StoreError, check_version, real};

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
        let path = &real(path);
        let at = |source| StoreError::sql(path, OPENING, source);
        let (mut connection, copy) = connect(reading(path).row_buffer_size(ROWS_AHEAD), path).await?;
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
        Ok(Self { connection, path: path.to_owned(), alone: false, _copy: copy })
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
mod tests;
