//! Converts Python arrays: real numbers of any layout become C-ordered double precision. Also converts integers.

use std::ops::RangeInclusive;

use numpy::{IxDyn, PyReadonlyArray, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyBool;

/// Numbers and their shape.
pub struct NumericArray {
    pub shape: Vec<usize>,
    pub values: Vec<f64>,
}

/// Copies `numpy.asarray(object)`.
///
/// # Errors
/// `TypeError` if it contains other than real numbers or is a masked array, `ValueError` if it is no array.
pub fn numbers(what: &str, object: &Bound<'_, PyAny>) -> PyResult<NumericArray> {
    of_kind("fiub", "real numbers", what, object)
}

/// As [`numbers`], for these kinds of dtype.
fn of_kind(kinds: &str, which: &str, what: &str, object: &Bound<'_, PyAny>) -> PyResult<NumericArray> {
    static AS_ARRAY: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    static IS_MASKED: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    let py = object.py();
    // `asarray` drops the mask.
    if IS_MASKED.import(py, "numpy.ma", "isMaskedArray")?.call1((object,))?.is_truthy()? {
        return Err(PyTypeError::new_err(format!(
            "{what} is a masked array; pass a plain one, such as .filled(0)"
        )));
    }
    let as_array = AS_ARRAY.import(py, "numpy", "asarray")?;
    let array = as_array.call1((object,)).map_err(|e| PyValueError::new_err(format!("{what}: {e}")))?;
    let dtype = array.cast::<PyUntypedArray>()?.dtype();
    let kind: char = dtype.getattr("kind")?.extract()?;
    // numpy gives empty lists the dtype float64; a scalar has no length
    let untyped = kind == 'f' && array.getattr("size")?.extract::<usize>()? == 0;
    if !kinds.contains(kind) && !untyped {
        return Err(PyTypeError::new_err(format!("{what} has dtype {dtype}; it must hold {which}")));
    }
    let array = as_array.call1((array, "float64"))?;
    let array: PyReadonlyArray<'_, f64, IxDyn> = array.extract()?;
    let shape = array.shape().to_vec();
    // `PyReadonlyArray::as_slice` also accepts Fortran order
    let values = match array.as_array().as_slice() {
        Some(values) => values.to_vec(),
        None => array.as_array().iter().copied().collect(),
    };
    Ok(NumericArray { shape, values })
}

/// As [`numbers`], for one dimension.
///
/// # Errors
/// As [`numbers`], and `ValueError` for another number of dimensions.
pub fn vector(what: &str, object: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
    let NumericArray { shape, values } = numbers(what, object)?;
    match shape.len() {
        1 => Ok(values),
        _ => Err(PyValueError::new_err(format!("{what} has shape {shape:?}; it must have one dimension"))),
    }
}

/// Indices of units or instants, from any sequence.
///
/// # Errors
/// `TypeError` if they are not integers, `ValueError` if one is negative or there are several dimensions.
pub fn indices(what: &str, object: &Bound<'_, PyAny>) -> PyResult<Vec<usize>> {
    let NumericArray { shape, values } = of_kind("iu", "whole numbers", what, object)?;
    match values.iter().find(|x| **x < 0.0) {
        Some(x) => {
            Err(PyValueError::new_err(format!("{what} contains {x}; its values must not be negative")))
        }
        None if shape.len() == 1 => Ok(values.into_iter().map(|x| x as usize).collect()),
        None => Err(PyValueError::new_err(format!("{what} has shape {shape:?}; it must have one dimension"))),
    }
}

/// An integer of Python or numpy.
///
/// # Errors
/// `TypeError` if it is no integer, or a Boolean; `ValueError` if it is out of range.
pub fn parse_integer(what: &str, object: &Bound<'_, PyAny>, range: RangeInclusive<u64>) -> PyResult<u64> {
    let must = match *range.end() {
        u64::MAX => format!("{} or above", range.start()),
        most => format!("from {} to {most}", range.start()),
    };
    let wrong = format!("{what} = {object}: must be a whole number, {must}");
    let index = match object.is_instance_of::<PyBool>() {
        true => None,
        false => object.call_method0("__index__").ok(),
    };
    let index = index.ok_or_else(|| PyTypeError::new_err(wrong.clone()))?;
    let found = index.extract::<u64>().ok().filter(|n| range.contains(n));
    found.ok_or_else(|| PyValueError::new_err(wrong))
}
