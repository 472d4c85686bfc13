//! The Python module: simulations, fits and databases of trials.
//!
//! This crate only converts data. Arrays are checked and copied while the interpreter's lock is held; computations run without it,
//! and results are returned without a copy. Invalid input raises `ValueError` or `TypeError`; failed samples raise
//! `SimulationError` or are masked.

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

use metasense::cli::with_causes as chain;
use metasense_worker::run::NoResult;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

pyo3::create_exception!(
    metasense,
    SimulationError,
    PyRuntimeError,
    "The simulation of samples failed; `outcomes` lists how each sample ended."
);

/// Converts a worker's failure to an exception.
fn raised(failure: &NoResult) -> PyErr {
    match failure {
        NoResult::Rejected(what) => PyValueError::new_err(what.clone()),
        failure => PyRuntimeError::new_err(failure.to_string()),
    }
}

/// The function of this module that restores a pickle.
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
    use super::arrow::{PyTable, unpickle_table};
    #[pymodule_export]
    use super::body::{PyBody, unpickle_body};
    #[pymodule_export]
    use super::brain::LinearBrain;
    #[pymodule_export]
    use super::database::{Database, default_database};
    #[pymodule_export]
    use super::inverse::{PyInverse, PyTwin, unpickle_twin};
    #[pymodule_export]
    use super::simulation::PySimulation;
}
