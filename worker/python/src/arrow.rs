//! Tables for data frames: columns behind the Arrow C stream interface, which pandas, polars and pyarrow read without a copy.
//!
//! A stream of one batch, a struct of columns: int64 `l`, float64 `g`, text `U` with 64-bit offsets, or null `n`, each of
//! which keeps the table alive until its reader releases it. Layout: arrow.apache.org/docs/format/CDataInterface.html and
//! CStreamInterface.html.

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::ptr::{null, null_mut};
use std::sync::Arc;

use metasense::look::Table as Rows;
use pyo3::prelude::*;
use pyo3::types::{PyCapsule, PyDict, PyList};
use serde_json::Value;

/// The memory of a buffer.
enum Buffer {
    /// A validity bitmap, numbers by their bits, or offsets.
    Words(Vec<u64>),
    Text(Vec<u8>),
}

struct Column {
    name: CString,
    format: &'static CStr,
    nulls: usize,
    /// Validity first; none of a null column.
    buffers: Vec<Buffer>,
}

impl Column {
    /// Whole numbers where all values are, numbers where all are, else texts; null where there is nothing.
    fn new<'a>(name: &str, values: impl Iterator<Item = &'a Value> + Clone) -> Self {
        let present = || values.clone().filter(|value| !value.is_null());
        let count = values.clone().count();
        let nulls = count - present().count();
        let mut valid = vec![0u64; count.div_ceil(64)];
        for (i, _) in values.clone().enumerate().filter(|(_, value)| !value.is_null()) {
            valid[i / 64] |= 1 << (i % 64);
        }
        let words = |bits: &dyn Fn(&Value) -> u64| Buffer::Words(values.clone().map(bits).collect());
        let (format, buffers) = if nulls == count {
            (c"n", Vec::new())
        } else if present().all(Value::is_i64) {
            (c"l", vec![words(&|value| value.as_i64().unwrap_or(0).cast_unsigned())])
        } else if present().all(Value::is_number) {
            (c"g", vec![words(&|value| value.as_f64().unwrap_or(0.0).to_bits())])
        } else {
            let (mut text, mut ends) = (Vec::new(), vec![0u64]);
            for value in values.clone() {
                match value {
                    Value::Null => {}
                    Value::String(value) => text.extend(value.bytes()),
                    other => text.extend(other.to_string().bytes()),
                }
                ends.push(text.len() as u64);
            }
            (c"U", vec![Buffer::Words(ends), Buffer::Text(text)])
        };
        let valid = (nulls < count).then_some(Buffer::Words(valid));
        let name = CString::new(name.replace('\0', "")).expect("no zero is left");
        Self { name, format, nulls, buffers: valid.into_iter().chain(buffers).collect() }
    }

    fn addresses(&self) -> Vec<*const c_void> {
        let of = |buffer: &Buffer| match buffer {
            Buffer::Words(words) => words.as_ptr().cast(),
            Buffer::Text(text) => text.as_ptr().cast(),
        };
        self.buffers.iter().map(of).collect()
    }
}

struct Columns {
    columns: Vec<Column>,
    rows: usize,
}

/// An answer of a database: rows under named columns.
///
/// `pandas.DataFrame.from_arrow`, `polars.DataFrame` and `pyarrow.table` take it as it is.
#[pyclass(frozen, module = "metasense")]
pub struct Table {
    rows: Rows,
    columns: Arc<Columns>,
}

impl From<Rows> for Table {
    fn from(rows: Rows) -> Self {
        let column =
            |(i, name): (usize, &String)| Column::new(name, rows.rows.iter().map(move |row| &row[i]));
        let columns = rows.columns.iter().enumerate().map(column).collect();
        let columns = Arc::new(Columns { columns, rows: rows.rows.len() });
        Self { rows, columns }
    }
}

#[pymethods]
impl Table {
    /// Names of the columns.
    #[getter]
    fn columns(&self) -> Vec<&str> {
        self.rows.columns.iter().map(String::as_str).collect()
    }

    /// Values by column: a dictionary of lists.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        for (i, name) in self.rows.columns.iter().enumerate() {
            let values =
                self.rows.rows.iter().map(|row| object(py, &row[i])).collect::<PyResult<Vec<_>>>()?;
            dict.set_item(name, PyList::new(py, values)?)?;
        }
        Ok(dict)
    }

    /// The table as an Arrow stream (PyCapsule); it comes in its own types, whatever is requested.
    #[pyo3(signature = (requested_schema=None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        let _ = requested_schema;
        PyCapsule::new_with_value(py, Stream::new(Arc::clone(&self.columns)), c"arrow_array_stream")
    }

    fn __len__(&self) -> usize {
        self.columns.rows
    }

    fn __repr__(&self) -> String {
        format!("<metasense.Table of {} rows: {}>", self.columns.rows, self.rows.columns.join(", "))
    }

    fn _repr_html_(&self) -> String {
        const MOST: usize = 20;
        let escaped = |text: &str| text.replace('&', "&amp;").replace('<', "&lt;");
        let cells = |tag: &str, texts: Vec<String>| -> String {
            let cells: String =
                texts.iter().map(|text| format!("<{tag}>{}</{tag}>", escaped(text))).collect();
            format!("<tr>{cells}</tr>\n")
        };
        let shown = |value: &Value| match value {
            Value::Null => String::new(),
            Value::String(text) => text.clone(),
            Value::Number(n) if n.is_f64() => format!("{:.4}", n.as_f64().unwrap_or(f64::NAN)),
            other => other.to_string(),
        };
        let mut html = cells("th", self.rows.columns.clone());
        for row in self.rows.rows.iter().take(MOST) {
            html += &cells("td", row.iter().map(shown).collect());
        }
        let more = self.columns.rows.saturating_sub(MOST);
        let note = if more > 0 { format!("<p>and {more} more rows</p>") } else { String::new() };
        format!("<table>\n{html}</table>{note}")
    }
}

fn object<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::Null => py.None().into_bound(py),
        Value::Number(n) if n.is_i64() => n.as_i64().unwrap_or_default().into_pyobject(py)?.into_any(),
        Value::Number(n) => n.as_f64().unwrap_or(f64::NAN).into_pyobject(py)?.into_any(),
        Value::String(text) => text.into_pyobject(py)?.into_any(),
        other => other.to_string().into_pyobject(py)?.into_any(),
    })
}

#[repr(C)]
struct ArrowSchema {
    format: *const c_char,
    name: *const c_char,
    metadata: *const c_char,
    flags: i64,
    n_children: i64,
    children: *mut *mut ArrowSchema,
    dictionary: *mut ArrowSchema,
    release: Option<unsafe extern "C" fn(*mut ArrowSchema)>,
    private_data: *mut c_void,
}

#[repr(C)]
struct ArrowArray {
    length: i64,
    null_count: i64,
    offset: i64,
    n_buffers: i64,
    n_children: i64,
    buffers: *mut *const c_void,
    children: *mut *mut ArrowArray,
    dictionary: *mut ArrowArray,
    release: Option<unsafe extern "C" fn(*mut ArrowArray)>,
    private_data: *mut c_void,
}

/// What a schema or an array owns; `T` is which of them.
struct Owned<T> {
    /// Of names and buffers.
    _columns: Arc<Columns>,
    buffers: Vec<*const c_void>,
    children: Vec<*mut T>,
}

/// Nullable.
const FLAGS: i64 = 2;

impl ArrowSchema {
    fn new(columns: &Arc<Columns>, format: &'static CStr, name: *const c_char, children: Vec<Self>) -> Self {
        let children = children.into_iter().map(|child| Box::into_raw(Box::new(child))).collect();
        let mut owned = Box::new(Owned { _columns: Arc::clone(columns), buffers: Vec::new(), children });
        Self {
            format: format.as_ptr(),
            name,
            metadata: null(),
            flags: FLAGS,
            n_children: owned.children.len() as i64,
            children: owned.children.as_mut_ptr(),
            dictionary: null_mut(),
            release: Some(release_schema),
            private_data: Box::into_raw(owned).cast(),
        }
    }

    fn of(columns: &Arc<Columns>) -> Self {
        let child = |column: &Column| Self::new(columns, column.format, column.name.as_ptr(), Vec::new());
        Self::new(columns, c"+s", c"".as_ptr(), columns.columns.iter().map(child).collect())
    }
}

impl ArrowArray {
    fn new(columns: &Arc<Columns>, nulls: usize, buffers: Vec<*const c_void>, children: Vec<Self>) -> Self {
        let children = children.into_iter().map(|child| Box::into_raw(Box::new(child))).collect();
        let mut owned = Box::new(Owned { _columns: Arc::clone(columns), buffers, children });
        Self {
            length: columns.rows as i64,
            null_count: nulls as i64,
            offset: 0,
            n_buffers: owned.buffers.len() as i64,
            n_children: owned.children.len() as i64,
            buffers: owned.buffers.as_mut_ptr(),
            children: owned.children.as_mut_ptr(),
            dictionary: null_mut(),
            release: Some(release_array),
            private_data: Box::into_raw(owned).cast(),
        }
    }

    fn of(columns: &Arc<Columns>) -> Self {
        let child = |column: &Column| Self::new(columns, column.nulls, column.addresses(), Vec::new());
        Self::new(columns, 0, vec![null()], columns.columns.iter().map(child).collect())
    }
}

/// # Safety
/// `schema` is one that `ArrowSchema::new` made and nobody has released.
unsafe extern "C" fn release_schema(schema: *mut ArrowSchema) {
    // SAFETY: made by `new` from boxes; a child that was moved away has no `release` left.
    unsafe {
        let owned: Box<Owned<ArrowSchema>> = Box::from_raw((*schema).private_data.cast());
        for &child in &owned.children {
            if let Some(release) = (*child).release {
                release(child);
            }
            drop(Box::from_raw(child));
        }
        (*schema).release = None;
    }
}

/// # Safety
/// `array` is one that `ArrowArray::new` made and nobody has released.
unsafe extern "C" fn release_array(array: *mut ArrowArray) {
    // SAFETY: as of `release_schema`.
    unsafe {
        let owned: Box<Owned<ArrowArray>> = Box::from_raw((*array).private_data.cast());
        for &child in &owned.children {
            if let Some(release) = (*child).release {
                release(child);
            }
            drop(Box::from_raw(child));
        }
        (*array).release = None;
    }
}

#[repr(C)]
struct Stream {
    get_schema: unsafe extern "C" fn(*mut Stream, *mut ArrowSchema) -> c_int,
    get_next: unsafe extern "C" fn(*mut Stream, *mut ArrowArray) -> c_int,
    get_last_error: unsafe extern "C" fn(*mut Stream) -> *const c_char,
    release: Option<unsafe extern "C" fn(*mut Stream)>,
    private_data: *mut c_void,
}

/// What a stream owns.
struct Source {
    columns: Arc<Columns>,
    given: bool,
}

// SAFETY: it owns its source, and that may go from thread to thread.
unsafe impl Send for Stream {}

impl Stream {
    fn new(columns: Arc<Columns>) -> Self {
        let private_data = Box::into_raw(Box::new(Source { columns, given: false })).cast();
        let release: unsafe extern "C" fn(*mut Self) = release_stream;
        Self { get_schema, get_next, get_last_error, release: Some(release), private_data }
    }
}

impl Drop for Stream {
    /// A reader that has taken it has left no `release`.
    fn drop(&mut self) {
        if let Some(release) = self.release {
            // SAFETY: it has not been released.
            unsafe { release(self) };
        }
    }
}

unsafe extern "C" fn get_schema(stream: *mut Stream, out: *mut ArrowSchema) -> c_int {
    // SAFETY: a stream of `Stream::new` that was not released, and room for a schema.
    unsafe {
        let source: &Source = &*(*stream).private_data.cast();
        out.write(ArrowSchema::of(&source.columns));
    }
    0
}

unsafe extern "C" fn get_next(stream: *mut Stream, out: *mut ArrowArray) -> c_int {
    // SAFETY: likewise; the end of a stream is an array that is released.
    unsafe {
        let source: &mut Source = &mut *(*stream).private_data.cast();
        let mut next = ArrowArray::of(&source.columns);
        if std::mem::replace(&mut source.given, true) {
            release_array(&raw mut next);
        }
        out.write(next);
    }
    0
}

unsafe extern "C" fn get_last_error(_: *mut Stream) -> *const c_char {
    null()
}

unsafe extern "C" fn release_stream(stream: *mut Stream) {
    // SAFETY: a stream of `Stream::new` that was not released.
    unsafe {
        drop(Box::from_raw((*stream).private_data.cast::<Source>()));
        (*stream).release = None;
    }
}
