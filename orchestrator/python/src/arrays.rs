//! Arrays in: any real numbers of any layout, checked, as C-ordered double precision.

use numpy::{IxDyn, PyReadonlyArray, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;

/// Numbers and their shape.
pub struct Numbers {
    pub shape: Vec<usize>,
    pub values: Vec<f64>,
}

/// What `numpy.asarray` makes of `object`, copied.
///
/// # Errors
/// `TypeError` if it holds no real numbers, `ValueError` if it is no array.
pub fn numbers(what: &str, object: &Bound<'_, PyAny>) -> PyResult<Numbers> {
    static AS_ARRAY: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    let py = object.py();
    let as_array = AS_ARRAY.import(py, "numpy", "asarray")?;
    let array = as_array.call1((object,)).map_err(|e| PyValueError::new_err(format!("{what}: {e}")))?;
    let dtype = array.cast::<PyUntypedArray>()?.dtype();
    let kind: char = dtype.getattr("kind")?.extract()?;
    if !"fiub".contains(kind) {
        return Err(PyTypeError::new_err(format!("{what} has dtype {dtype}; it must hold real numbers")));
    }
    let array = as_array.call1((array, "float64"))?;
    let array: PyReadonlyArray<'_, f64, IxDyn> = array.extract()?;
    let shape = array.shape().to_vec();
    // `PyReadonlyArray::as_slice` gives Fortran's order, too
    let values = match array.as_array().as_slice() {
        Some(values) => values.to_vec(),
        None => array.as_array().iter().copied().collect(),
    };
    Ok(Numbers { shape, values })
}

/// As `numbers`, of so many dimensions.
///
/// # Errors
/// Likewise, and `ValueError` if there are more or fewer.
pub fn vector(what: &str, object: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
    let Numbers { shape, values } = numbers(what, object)?;
    match shape.len() {
        1 => Ok(values),
        _ => Err(PyValueError::new_err(format!("{what} has shape {shape:?}; it must have one dimension"))),
    }
}
