//! Read-only access to a database of finished and running trials.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use clap::ValueEnum;
use metasense::analysis::{DecisionTerms, Question};
use metasense::control::run_of;
use metasense::export::npz;
use metasense::look::Table as Rows;
use metasense::reader::{Reader, quoted};
use metasense::report::load::finished_trials;
use metasense::store::StoreError;
use numpy::{IntoPyArray, PyArray1};
use pyo3::exceptions::{PyOSError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::arrow::PyTable;
use crate::body::{path, read_plan};
use crate::chain;
use crate::threads::threads;

/// A database of trials, written by `metasense run`. Reading is possible during a run.
#[pyclass(frozen, subclass, module = "metasense")]
pub struct Database {
    path: PathBuf,
}

/// Time between two checks for signals.
const SIGNALS: Duration = Duration::from_millis(100);

fn raised(error: &StoreError) -> PyErr {
    let text = chain(error);
    if error.is_bad_input() { PyValueError::new_err(text) } else { PyOSError::new_err(text) }
}

impl Database {
    /// Runs `ask` on the database without the interpreter's lock. A signal whose handler raises ends the statement.
    fn asked<T: Send>(
        &self,
        py: Python<'_>,
        ask: impl AsyncFnOnce(&mut Reader) -> Result<T, StoreError> + Send,
    ) -> PyResult<T> {
        let stop = Arc::new(AtomicBool::new(false));
        let asking = || {
            let runtime = tokio::runtime::Builder::new_current_thread()
                .enable_all()
                .build()
                .map_err(|e| PyOSError::new_err(e.to_string()))?;
            let ask = async |reader: &mut Reader| {
                reader.stop_when(Arc::clone(&stop)).await?;
                ask(reader).await
            };
            runtime.block_on(Reader::with_reader(&self.path, ask)).map_err(|e| raised(&e))
        };
        py.detach(|| {
            let (done, answer) = channel();
            std::thread::scope(|scope| {
                scope.spawn(move || done.send(asking()).is_ok());
                loop {
                    match answer.recv_timeout(SIGNALS) {
                        Ok(answer) => return answer,
                        Err(RecvTimeoutError::Timeout) => Python::attach(|py| py.check_signals())
                            .inspect_err(|_| stop.store(true, Ordering::Relaxed))?,
                        Err(RecvTimeoutError::Disconnected) => panic!("the thread has panicked"),
                    }
                }
            })
        })
    }
}

#[pymethods]
impl Database {
    /// Opens a database.
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let database = Self { path };
        database.asked(py, async |_| Ok(()))?;
        Ok(database)
    }

    /// Path of the file.
    #[getter]
    fn path(&self) -> PathBuf {
        self.path.clone()
    }

    /// Runs one SQL statement, which cannot change the database; `metasense query DB` lists the views.
    fn query(&self, py: Python<'_>, sql: &str) -> PyResult<PyTable> {
        Ok(self.asked(py, async |reader| reader.query::<Rows>(sql).await)?.into())
    }

    /// All trials, one row each (`v_trial`).
    fn trials(&self, py: Python<'_>) -> PyResult<PyTable> {
        self.query(py, "SELECT * FROM v_trial ORDER BY panels, sensors, units, placement, seed, hash")
    }

    /// The outer steps of the trial whose hash begins with `hash`, one row each (`v_step`).
    fn steps(&self, py: Python<'_>, hash: &str) -> PyResult<PyTable> {
        let table = self.asked(py, async |reader| {
            let named = quoted(&reader.hash_of(hash).await?);
            reader.query::<Rows>(&format!("SELECT * FROM v_step WHERE hash = {named} ORDER BY step")).await
        })?;
        Ok(table.into())
    }

    /// α (mm) of the "initial" or "optimised" body of a trial.
    #[pyo3(signature = (hash, body="optimised"))]
    fn design<'py>(&self, py: Python<'py>, hash: &str, body: &str) -> PyResult<Bound<'py, PyArray1<f64>>> {
        if !["initial", "optimised"].contains(&body) {
            return Err(PyValueError::new_err(format!(
                "body = {body:?}: must be \"initial\" or \"optimised\""
            )));
        }
        let arrays = self.asked(py, async |reader| {
            let hash = reader.hash_of(hash).await?;
            reader.arrays_of(&hash).await
        })?;
        let found = arrays.iter().find(|array| array.name == format!("alpha_{body}"));
        let found = found.ok_or_else(|| PyValueError::new_err(format!("trial {hash} is not finished")))?;
        Ok(found.values::<f64>().map_err(|e| raised(&e))?.into_pyarray(py))
    }

    /// The archive of `metasense export --format npz`.
    fn _archive<'py>(
        &self,
        py: Python<'py>,
        hash: &str,
        #[pyo3(from_py_with = threads)] threads: usize,
    ) -> PyResult<Bound<'py, PyBytes>> {
        let stored = self.asked(py, async |reader| reader.stored(hash).await)?;
        let stored = stored.ok_or_else(|| PyValueError::new_err(format!("trial {hash} is not finished")))?;
        // decoders that cannot be fitted are left out
        let archive = py.detach(|| npz::of_trial(&stored, threads, &mut |_| ())).map_err(|e| raised(&e))?;
        Ok(PyBytes::new(py, &archive))
    }

    /// Answers a question of `metasense analyse`, for instance "elbow", from the finished trials.
    fn analyse(&self, py: Python<'_>, question: &str) -> PyResult<PyTable> {
        let question = Question::from_str(question, false).map_err(|_| {
            let known = Question::value_variants().iter().filter_map(Question::to_possible_value);
            let known: Vec<String> = known.map(|value| value.get_name().to_owned()).collect();
            PyValueError::new_err(format!("question = {question:?}: must be one of {}", known.join(", ")))
        })?;
        let trials = self.asked(py, async |reader| finished_trials(reader).await)?;
        Ok(py.detach(|| question.answer(&trials, DecisionTerms::default())).into())
    }

    /// Whether a run writes to the database.
    fn is_running(&self, py: Python<'_>) -> PyResult<bool> {
        self.asked(py, async |reader| Ok(run_of(reader.path()).await.is_some()))
    }

    fn __repr__(&self) -> String {
        format!("<metasense.Database {}>", self.path.display())
    }
}

/// The database that `metasense run` writes for a spec with changes (KEY=VALUE), unless `--db` is given.
#[pyfunction]
pub fn default_database(
    #[pyo3(from_py_with = path)] spec: PathBuf,
    changes: Vec<String>,
) -> PyResult<PathBuf> {
    Ok(read_plan(&spec, &changes)?.default_database())
}
