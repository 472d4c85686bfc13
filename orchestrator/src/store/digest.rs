//! BLAKE3 checksums of checkpoints and arrays, stored with the bytes and verified on every read. Rows without a checksum are
//! not verified.

use std::ffi::c_int;

use libsqlite3_sys as ffi;
use sqlx::sqlite::SqliteConnection;

use super::StoreError;

/// The checksum of bytes.
pub(super) fn digest(bytes: &[u8]) -> Vec<u8> {
    blake3::hash(bytes).as_bytes().to_vec()
}

/// Verifies stored bytes of a trial. An empty checksum is not verified.
///
/// # Errors
/// `Damaged` if they differ.
pub(crate) fn check(hash: &str, what: &str, bytes: &[u8], checksum: &[u8]) -> Result<(), StoreError> {
    match checksum.is_empty() || checksum == blake3::hash(bytes).as_bytes() {
        true => Ok(()),
        false => Err(StoreError::Damaged { hash: hash.to_owned(), what: what.to_owned() }),
    }
}

/// Registers the SQL function `blake3(X)` on a connection.
pub(crate) async fn add_function(connection: &mut SqliteConnection) -> sqlx::Result<()> {
    let mut handle = connection.lock_handle().await?;
    let (db, data) = (handle.as_raw_handle().as_ptr(), std::ptr::null_mut());
    let flags = ffi::SQLITE_UTF8 | ffi::SQLITE_DETERMINISTIC;
    // SAFETY: the handle is locked and open; the function has no data of its own.
    unsafe {
        ffi::sqlite3_create_function_v2(
            db,
            c"blake3".as_ptr(),
            1,
            flags,
            data,
            Some(of_value),
            None,
            None,
            None,
        );
    }
    Ok(())
}

unsafe extern "C" fn of_value(
    context: *mut ffi::sqlite3_context,
    _: c_int,
    values: *mut *mut ffi::sqlite3_value,
) {
    // SAFETY: there is one argument; its bytes are valid until the function returns, and SQLite copies the result.
    unsafe {
        let bytes = ffi::sqlite3_value_blob(*values);
        let length = ffi::sqlite3_value_bytes(*values) as usize;
        let bytes = if length == 0 { &[][..] } else { std::slice::from_raw_parts(bytes.cast(), length) };
        let hash = blake3::hash(bytes);
        ffi::sqlite3_result_blob(context, hash.as_bytes().as_ptr().cast(), 32, ffi::SQLITE_TRANSIENT());
    }
}
