//! Waiting for locks, and additional SQL functions for readers: `exp`, `ln`, `pow`, `sqrt`; aggregates `median(X)` and `percentile(X, P)`. The result
//! is NULL if an argument is not a number or outside the domain; aggregates skip NULL.

mod wait;

use std::ffi::{CStr, c_int};

use libsqlite3_sys as ffi;
use sqlx::sqlite::SqliteConnection;

use crate::analysis::numbers::quantile;
pub(crate) use wait::wait_on;
pub use wait::{hurry, wait_for_locks};

type Arguments = *mut *mut ffi::sqlite3_value;
type Function = unsafe extern "C" fn(*mut ffi::sqlite3_context, c_int, Arguments);
/// Name, number of arguments and code of a scalar function.
pub(crate) type Scalar = (&'static CStr, c_int, Function);

const SCALARS: [Scalar; 4] = [(c"exp", 1, exp), (c"ln", 1, ln), (c"pow", 2, pow), (c"sqrt", 1, sqrt)];
const AGGREGATES: [(&CStr, c_int); 2] = [(c"median", 1), (c"percentile", 2)];

/// Registers the functions on a connection.
pub(crate) async fn register(connection: &mut SqliteConnection) -> sqlx::Result<()> {
    add(connection, &SCALARS, &AGGREGATES).await
}

/// Registers the function `blake3(X)` on a connection.
pub(crate) async fn add_blake3(connection: &mut SqliteConnection) -> sqlx::Result<()> {
    add(connection, &[(c"blake3", 1, hash)], &[]).await
}

/// Registers scalar functions, and aggregates that `step` and `end` compute.
pub(crate) async fn add(
    connection: &mut SqliteConnection,
    scalars: &[Scalar],
    aggregates: &[(&CStr, c_int)],
) -> sqlx::Result<()> {
    let mut handle = connection.lock_handle().await?;
    let (db, data) = (handle.as_raw_handle().as_ptr(), std::ptr::null_mut());
    let flags = ffi::SQLITE_UTF8 | ffi::SQLITE_DETERMINISTIC;
    let scalars = scalars.iter().map(|(name, count, function)| (*name, *count, Some(*function), None, None));
    let aggregates =
        aggregates.iter().map(|(name, n)| (*name, *n, None, Some(step as Function), Some(end as _)));
    for (name, arguments, scalar, step, end) in scalars.chain(aggregates) {
        let name = name.as_ptr();
        // SAFETY: the handle is locked and open; the functions have no data of their own.
        unsafe { ffi::sqlite3_create_function_v2(db, name, arguments, flags, data, scalar, step, end, None) };
    }
    Ok(())
}

/// The BLAKE3 hash of a text or blob.
unsafe extern "C" fn hash(context: *mut ffi::sqlite3_context, _: c_int, values: Arguments) {
    // SAFETY: there is one argument; its bytes are valid until the function returns, and SQLite copies the result.
    unsafe {
        let bytes = ffi::sqlite3_value_blob(*values);
        let length = ffi::sqlite3_value_bytes(*values) as usize;
        let bytes = if length == 0 { &[][..] } else { std::slice::from_raw_parts(bytes.cast(), length) };
        let hash = blake3::hash(bytes);
        ffi::sqlite3_result_blob(context, hash.as_bytes().as_ptr().cast(), 32, ffi::SQLITE_TRANSIENT());
    }
}

/// An argument as a number; `None` if it is not one.
///
/// # Safety
/// SQLite must have passed more than `at` arguments.
unsafe fn number(arguments: Arguments, at: usize) -> Option<f64> {
    // SAFETY: as above.
    unsafe {
        let value = *arguments.add(at);
        let numeric =
            [ffi::SQLITE_INTEGER, ffi::SQLITE_FLOAT].contains(&ffi::sqlite3_value_numeric_type(value));
        numeric.then(|| ffi::sqlite3_value_double(value))
    }
}

/// # Safety
/// The context must be that of a call by SQLite.
unsafe fn answer(context: *mut ffi::sqlite3_context, result: Option<f64>) {
    match result.filter(|result| !result.is_nan()) {
        // SAFETY: as above.
        Some(result) => unsafe { ffi::sqlite3_result_double(context, result) },
        // SAFETY: as above.
        None => unsafe { ffi::sqlite3_result_null(context) },
    }
}

macro_rules! scalar {
    ($name:ident, |$($argument:ident),+| $result:expr) => {
        unsafe extern "C" fn $name(context: *mut ffi::sqlite3_context, _: c_int, arguments: Arguments) {
            let mut at = 0..;
            // SAFETY: the function is registered with this number of arguments.
            unsafe {
                $(let $argument = number(arguments, at.next().unwrap_or_default());)+
                answer(context, (|| { $(let $argument = $argument?;)+ $result })());
            }
        }
    };
}
scalar!(exp, |x| Some(x.exp()));
scalar!(ln, |x| (x > 0.0).then(|| x.ln()));
scalar!(pow, |x, y| Some(x.powf(y)));
scalar!(sqrt, |x| Some(x.sqrt()));

/// State of an aggregate: its values, and P of `percentile`.
struct Values(Vec<f64>, f64);

unsafe extern "C" fn step(context: *mut ffi::sqlite3_context, count: c_int, arguments: Arguments) {
    // SAFETY: SQLite provides zeroed memory for a pointer, the same for all rows of a group, until `end` is called.
    unsafe {
        let percent = if count == 1 { Some(50.0) } else { number(arguments, 1) };
        let Some(percent) = percent.filter(|percent| (0.0..=100.0).contains(percent)) else {
            let why = c"the second argument of percentile must be a number from 0 to 100";
            return ffi::sqlite3_result_error(context, why.as_ptr(), -1);
        };
        let place =
            ffi::sqlite3_aggregate_context(context, size_of::<*mut Values>() as c_int).cast::<*mut Values>();
        if place.is_null() {
            return ffi::sqlite3_result_error_nomem(context);
        }
        if (*place).is_null() {
            *place = Box::into_raw(Box::new(Values(Vec::new(), percent)));
        }
        (**place).0.extend(number(arguments, 0));
    }
}

unsafe extern "C" fn end(context: *mut ffi::sqlite3_context) {
    // SAFETY: for size 0, SQLite returns the memory of `step`, or null; `step` boxed the value behind the pointer.
    unsafe {
        let place = ffi::sqlite3_aggregate_context(context, 0).cast::<*mut Values>();
        if place.is_null() || (*place).is_null() {
            return ffi::sqlite3_result_null(context);
        }
        let Values(mut values, percent) =
            *Box::from_raw(std::mem::replace(&mut *place, std::ptr::null_mut()));
        values.sort_by(f64::total_cmp);
        answer(context, (!values.is_empty()).then(|| quantile(&values, 0.01 * percent)));
    }
}
