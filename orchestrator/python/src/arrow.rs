//! Tables for data frames, with the Arrow C stream interface that pandas, polars and pyarrow read without a copy.

use std::sync::Arc;

use arrow_array::ffi_stream::FFI_ArrowArrayStream;
use arrow_array::{
    Array, ArrayRef, Float64Array, Int64Array, LargeStringArray, NullArray, RecordBatch, RecordBatchIterator,
    RecordBatchOptions,
};
use arrow_schema::{Field, Schema};
use metasense::cell;
use metasense::look::Table as Rows;
use pyo3::exceptions::{PyKeyError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyCapsule, PyDict, PyIterator, PyList};
use serde_json::Value;

use crate::unpickler;

/// Converts a column: integers if all values are, floating-point numbers if all are numbers, else text. NULL becomes null.
fn column<'a>(values: impl Iterator<Item = &'a Value> + Clone) -> ArrayRef {
    let present = || values.clone().filter(|value| !value.is_null());
    let text = |value: &Value| match value {
        Value::Null => None,
        Value::String(text) => Some(text.clone()),
        other => Some(cell::plain(other)),
    };
    if present().next().is_none() {
        Arc::new(NullArray::new(values.count()))
    } else if present().all(Value::is_i64) {
        Arc::new(values.map(Value::as_i64).collect::<Int64Array>())
    } else if present().all(|value| cell::number(value).is_some()) {
        Arc::new(values.map(cell::number).collect::<Float64Array>())
    } else {
        Arc::new(values.map(text).collect::<LargeStringArray>())
    }
}

/// A table from a database: rows under named columns.
///
/// `pandas.DataFrame`, `polars.DataFrame` and `pyarrow.table` accept it directly; `to_pandas` needs no pyarrow.
#[pyclass(frozen, module = "metasense", name = "Table")]
pub struct PyTable {
    rows: Rows,
    batch: RecordBatch,
}

impl From<Rows> for PyTable {
    fn from(rows: Rows) -> Self {
        let of = |i: usize| column(rows.rows.iter().map(move |row| &row[i]));
        let columns: Vec<ArrayRef> = (0..rows.columns.len()).map(of).collect();
        // C strings end at a zero byte
        let field = |(name, column): (&String, &ArrayRef)| {
            Field::new(name.replace('\0', ""), column.data_type().clone(), true)
        };
        let fields: Vec<Field> = rows.columns.iter().zip(&columns).map(field).collect();
        let options = RecordBatchOptions::new().with_row_count(Some(rows.rows.len()));
        let batch = RecordBatch::try_new_with_options(Arc::new(Schema::new(fields)), columns, &options);
        Self { rows, batch: batch.expect("columns of one length") }
    }
}

impl PyTable {
    fn values<'py>(&self, py: Python<'py>, column: usize) -> PyResult<Bound<'py, PyList>> {
        let values = self.rows.rows.iter().map(|row| object(py, &row[column]));
        PyList::new(py, values.collect::<PyResult<Vec<_>>>()?)
    }
}

#[pymethods]
impl PyTable {
    /// Names of the columns.
    #[getter]
    fn columns(&self) -> Vec<&str> {
        self.rows.columns.iter().map(String::as_str).collect()
    }

    /// Values by column: a dictionary of lists.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        for (i, name) in self.rows.columns.iter().enumerate() {
            dict.set_item(name, self.values(py, i)?)?;
        }
        Ok(dict)
    }

    /// The table as a pandas.DataFrame; the columns exist even without rows.
    fn to_pandas<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let columns = PyDict::new(py);
        columns.set_item("columns", self.columns())?;
        py.import("pandas")?.getattr("DataFrame")?.call((self.to_dict(py)?,), Some(&columns))
    }

    /// The table as a polars.DataFrame.
    fn to_polars<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        slf.py().import("polars")?.getattr("DataFrame")?.call1((slf,))
    }

    /// Iterates over the rows, each a dictionary.
    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyIterator>> {
        let rows = self.rows.rows.iter().map(|row| {
            let dict = PyDict::new(py);
            for (name, value) in self.rows.columns.iter().zip(row) {
                dict.set_item(name, object(py, value)?)?;
            }
            Ok(dict)
        });
        PyList::new(py, rows.collect::<PyResult<Vec<_>>>()?)?.try_iter()
    }

    /// The values of a column.
    fn __getitem__<'py>(&self, py: Python<'py>, column: &str) -> PyResult<Bound<'py, PyList>> {
        let Some(at) = self.rows.columns.iter().position(|name| name == column) else {
            return Err(PyKeyError::new_err(format!(
                "{column}: the columns are {}",
                self.columns().join(", ")
            )));
        };
        self.values(py, at)
    }

    /// The table as an Arrow stream (PyCapsule); ignores `requested_schema`.
    #[pyo3(signature = (requested_schema=None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        let _ = requested_schema;
        let batches = RecordBatchIterator::new([Ok(self.batch.clone())], self.batch.schema());
        let stream = FFI_ArrowArrayStream::new(Box::new(batches));
        PyCapsule::new_with_value(py, stream, c"arrow_array_stream")
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Pickle<'py>> {
        let rows = serde_json::to_string(&self.rows.rows).expect("rows are JSON");
        Ok((unpickler(py, "unpickle_table")?, (self.rows.columns.clone(), rows)))
    }

    fn __copy__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        slf
    }

    fn __len__(&self) -> usize {
        self.batch.num_rows()
    }

    fn __repr__(&self) -> String {
        format!("<metasense.Table of {} rows: {}>", self.batch.num_rows(), self.rows.columns.join(", "))
    }

    fn _repr_html_(&self) -> String {
        const MOST: usize = 20;
        let Rows { columns, rows } = &self.rows;
        let shown = Rows { columns: columns.clone(), rows: rows.iter().take(MOST).cloned().collect() };
        let more = rows.len().saturating_sub(MOST);
        let note = if more > 0 { format!("<p>and {more} more rows</p>") } else { String::new() };
        shown.html(None).into_string() + &note
    }
}

/// Function that restores a pickle, with columns and rows as arguments.
type Pickle<'py> = (Bound<'py, PyAny>, (Vec<String>, String));

/// Restores a table from its pickle.
#[pyfunction]
pub fn unpickle_table(columns: Vec<String>, rows: &str) -> PyResult<PyTable> {
    let rows = serde_json::from_str(rows).map_err(|e| PyValueError::new_err(e.to_string()))?;
    Ok(Rows { columns, rows }.into())
}

fn object<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::Null => py.None().into_bound(py),
        Value::Number(n) if n.is_i64() => n.as_i64().unwrap_or_default().into_pyobject(py)?.into_any(),
        Value::String(text) => text.into_pyobject(py)?.into_any(),
        other => match cell::number(other) {
            Some(x) => x.into_pyobject(py)?.into_any(),
            None => other.to_string().into_pyobject(py)?.into_any(),
        },
    })
}
