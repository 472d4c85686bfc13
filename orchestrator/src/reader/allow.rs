//! The SQLite authorizer for SQL that users enter: statements may only read rows. The command line and the pages share it.

use std::ffi::{CStr, c_char, c_int, c_void};

use libsqlite3_sys as ffi;
use sqlx::sqlite::SqliteConnection;

/// The temporary view through which [`super::Reader::types`] obtains the types of a result's columns.
pub(super) const TYPES_VIEW: &str = "metasense_types";

/// Pragmas that describe tables and views.
const ABOUT_TABLES: [&[u8]; 7] = [
    b"table_info",
    b"table_xinfo",
    b"table_list",
    b"index_list",
    b"index_info",
    b"index_xinfo",
    b"foreign_key_list",
];

/// Pragmas that only read when they have no argument.
const READING: [&[u8]; 9] = [
    b"application_id",
    b"compile_options",
    b"data_version",
    b"encoding",
    b"freelist_count",
    b"function_list",
    b"page_count",
    b"page_size",
    b"user_version",
];

/// Pragmas that read the whole database in one operation, which cannot be interrupted.
const ABOUT_ALL: [&[u8]; 2] = [b"integrity_check", b"quick_check"];

/// Which statements a connection accepts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum AccessLevel {
    /// Statements that read.
    Reading,
    /// Statements that read and can be interrupted.
    Confined,
    /// Statements that read, and the creation of the temporary view [`TYPES_VIEW`].
    Describing,
}

/// Restricts a connection to these statements. It can attach no database.
pub(super) async fn allow(connection: &mut SqliteConnection, what: AccessLevel) -> sqlx::Result<()> {
    let mut handle = connection.lock_handle().await?;
    let db = handle.as_raw_handle().as_ptr();
    let data: &'static AccessLevel = match what {
        AccessLevel::Reading => &AccessLevel::Reading,
        AccessLevel::Confined => &AccessLevel::Confined,
        AccessLevel::Describing => &AccessLevel::Describing,
    };
    // SAFETY: the handle is locked and open; the data lives as long as the program, and is only read.
    unsafe {
        ffi::sqlite3_limit(db, ffi::SQLITE_LIMIT_ATTACHED, 0);
        ffi::sqlite3_set_authorizer(db, Some(authorize), std::ptr::from_ref(data).cast_mut().cast());
    }
    Ok(())
}

/// Why a text is not a single statement that reads; `None` if it is. The text is prepared, not run.
pub(super) async fn refusal(connection: &mut SqliteConnection, sql: &str) -> sqlx::Result<Option<String>> {
    let mut handle = connection.lock_handle().await?;
    let db = handle.as_raw_handle().as_ptr();
    let (mut rest, mut has_statement) = (sql, false);
    while !rest.is_empty() {
        let (mut statement, mut tail) = (std::ptr::null_mut(), std::ptr::null());
        let (start, length) = (rest.as_ptr().cast(), rest.len() as c_int);
        // SAFETY: the handle is locked and open; the text outlives the call, and the tail points into it or to its end.
        let failed = unsafe { ffi::sqlite3_prepare_v2(db, start, length, &mut statement, &mut tail) };
        if ![ffi::SQLITE_OK, ffi::SQLITE_ERROR, ffi::SQLITE_AUTH].contains(&failed) {
            // the file is at fault; running the statement reports it
            return Ok(None);
        }
        if failed != ffi::SQLITE_OK {
            // SAFETY: the message is there until the next call.
            let message = unsafe { CStr::from_ptr(ffi::sqlite3_errmsg(db)) }.to_string_lossy().into_owned();
            let refused = if failed == ffi::SQLITE_AUTH { NOT_READING } else { "" };
            return Ok(Some(message + refused));
        }
        if !statement.is_null() {
            // SAFETY: it was just prepared, and is not used again.
            let reads = unsafe {
                let reads = ffi::sqlite3_stmt_readonly(statement) != 0;
                ffi::sqlite3_finalize(statement);
                reads
            };
            if has_statement {
                return Ok(Some("one statement at a time; there is more after the first `;`".into()));
            }
            if !reads {
                return Ok(Some(format!("it writes{NOT_READING}")));
            }
            has_statement = true;
        }
        rest = &rest[tail as usize - rest.as_ptr() as usize..];
    }
    Ok(None)
}

/// End of the messages about statements that are refused.
pub(super) const NOT_READING: &str = "; only statements that read rows are allowed";

/// A string from SQLite; `None` for a null pointer.
unsafe fn text<'a>(text: *const c_char) -> Option<&'a [u8]> {
    // SAFETY: the caller passes a pointer from SQLite: NUL-terminated and valid until the callback returns.
    (!text.is_null()).then(|| unsafe { CStr::from_ptr(text) }.to_bytes())
}

unsafe extern "C" fn authorize(
    data: *mut c_void,
    action: c_int,
    first: *const c_char,
    second: *const c_char,
    _: *const c_char,
    _: *const c_char,
) -> c_int {
    // SAFETY: the data is what `allow` has set, the strings are SQLite's.
    let (what, [name, argument]) = unsafe { (*data.cast::<AccessLevel>(), [text(first), text(second)]) };
    if is_allowed(what, action, name.unwrap_or_default(), argument) {
        ffi::SQLITE_OK
    } else {
        ffi::SQLITE_DENY
    }
}

fn is_allowed(what: AccessLevel, action: c_int, name: &[u8], argument: Option<&[u8]>) -> bool {
    let is_one_of = |known: &[&[u8]]| known.iter().any(|known| known.eq_ignore_ascii_case(name));
    match action {
        ffi::SQLITE_SELECT | ffi::SQLITE_READ | ffi::SQLITE_RECURSIVE => true,
        ffi::SQLITE_FUNCTION => !argument.unwrap_or_default().eq_ignore_ascii_case(b"load_extension"),
        ffi::SQLITE_PRAGMA => {
            is_one_of(&ABOUT_TABLES)
                || what != AccessLevel::Confined && is_one_of(&ABOUT_ALL)
                || argument.is_none() && is_one_of(&READING)
        }
        ffi::SQLITE_CREATE_TEMP_VIEW
        | ffi::SQLITE_DROP_TEMP_VIEW
        | ffi::SQLITE_INSERT
        | ffi::SQLITE_UPDATE
        | ffi::SQLITE_DELETE => {
            what == AccessLevel::Describing
                && (name == TYPES_VIEW.as_bytes() || name.starts_with(b"sqlite_temp_"))
        }
        _ => false,
    }
}
