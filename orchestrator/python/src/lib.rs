//! The Python module: what trials simulate, fit and store with, called from Python.
//!
//! Nothing is computed here. Arrays are checked and copied in with the interpreter's lock held, the maths runs without
//! it, and results are handed over without a copy. Bad input is a `ValueError` (or `TypeError`) that says what it must
//! be; samples that do not reach their end are a `SimulationError`, or a mask.

#![cfg(feature = "extension")]

mod arrays;
mod arrow;
mod body;
mod brain;
mod chosen;
mod database;
mod inverse;
mod simulation;
mod threads;

use metasense_worker::run::Failure;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

pyo3::create_exception!(
    metasense,
    SimulationError,
    PyRuntimeError,
    "Samples that did not reach their end; `outcomes` says how each ended."
);

/// A failure of the worker's as an exception.
fn raised(failure: &Failure) -> PyErr {
    match failure {
        Failure::Rejected(what) => PyValueError::new_err(what.clone()),
        failure => PyRuntimeError::new_err(failure.to_string()),
    }
}

/// An error and its causes, a line each.
fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(e) = cause {
        text += &format!("\n  because: {e}");
        cause = e.source();
    }
    text
}

/// The function of this module by which a pickle is read.
fn unpickler<'py>(py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
    py.import("metasense._metasense")?.getattr(name)
}

#[pymodule]
mod _metasense {
    #[pymodule_export]
    use super::SimulationError;
    /// Version of the package.
    #[pymodule_export]
    #[expect(non_upper_case_globals, reason = "Python's name for it")]
    const __version__: &str = env!("CARGO_PKG_VERSION");
    #[pymodule_export]
    use super::arrow::{Table, unpickle_table};
    #[pymodule_export]
    use super::body::{Body, unpickle_body};
    #[pymodule_export]
    use super::brain::LinearBrain;
    #[pymodule_export]
    use super::database::{Database, default_database};
    #[pymodule_export]
    use super::inverse::{Inverse, Twin, unpickle_twin};
    #[pymodule_export]
    use super::simulation::Simulation;
}
