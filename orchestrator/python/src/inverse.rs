//! Inverse decoders, and twins, which are fitted models of casts.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex};

use metasense_lab::identify::{Fit, identify};
use metasense_lab::inverse::{Posterior, with_brain};
use metasense_lab::measured::{Measured, MeasuredError};
use metasense_lab::twin::{self, parse, read, store};
use metasense_numerics::dynamics::Parameters;
use metasense_numerics::trial::Problem;
use metasense_schemas::spec::TrialSpec;
use metasense_source::Source;
use metasense_worker::run::{NoResult, Pool};
use numpy::{IntoPyArray, PyArray1, PyArray3, PyArrayMethods};
use pyo3::exceptions::{PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{NumericArray, numbers};
use crate::body::PyBody;
use crate::brain::samples;
use crate::threads::PerProcess;
use crate::{chain, raised, unpickler};

/// A twin: the cast of a body that best explains its records. Created by `Body.twin` or `Body.read_twin`.
#[pyclass(frozen, module = "metasense", name = "Twin")]
pub struct PyTwin {
    twin: twin::Twin,
    trial: TrialSpec,
    design: Vec<f64>,
    ending: Option<String>,
}

impl PyTwin {
    /// Fits a twin to records of a body with this design.
    pub fn fitted(
        py: Python<'_>,
        body: &PyBody,
        design: Vec<f64>,
        forces: &Bound<'_, PyAny>,
        signals: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let NumericArray { shape, values } = numbers("forces", forces)?;
        let scene = &body.problem.scene;
        let forces = metasense_lab::simulate::forces(scene, &shape, values).map_err(|e| raised(&e))?;
        let signals = signals_of(body, Some(forces.samples), signals)?;
        let measured = Measured::of(forces, signals, false);
        let threads = body.threads.count();
        let found = py.detach(|| identify(&body.trial, &design, &measured, &[], threads, &[], &mut |_| ()));
        let Fit { twin, ending, .. } = found.map_err(|e| raised(&e))?;
        Ok(Self { twin, trial: body.trial.clone(), design, ending: Some(ending.name().to_owned()) })
    }

    /// Contents of the twin's file.
    fn text(&self) -> String {
        toml::to_string(&store(&self.trial, &self.design, &self.twin)).expect("a twin is TOML")
    }

    /// Reads a twin of a body with this design from a file.
    pub fn read(body: &PyBody, design: Vec<f64>, file: PathBuf) -> PyResult<Self> {
        let twin = read(&file, &body.trial, &design).map_err(|e| match e {
            MeasuredError::Unreadable { .. } => PyOSError::new_err(chain(&e)),
            MeasuredError::Spec(_) => PyValueError::new_err(chain(&e)),
        })?;
        Ok(Self { twin, trial: body.trial.clone(), design, ending: None })
    }
}

/// Pickled twin: trial as JSON, design, file contents, angles of its chips (rad; the file has degrees), ending.
type State = (String, Vec<f64>, String, Vec<f64>, Option<String>);

/// Restores a twin from its pickle.
#[pyfunction]
pub fn unpickle_twin(
    trial: &str,
    design: Vec<f64>,
    text: String,
    turns: Vec<f64>,
    ending: Option<String>,
) -> PyResult<PyTwin> {
    let trial = serde_json::from_str(trial).map_err(|e| {
        PyValueError::new_err(format!("this twin was pickled by another version of metasense: {e}"))
    })?;
    let source = Source::new(Path::new("(pickle)"), text).map_err(|e| PyValueError::new_err(chain(&e)))?;
    let mut twin = parse(&source, &trial, &design).map_err(|e| PyValueError::new_err(chain(&e)))?;
    twin.cast.chips.turn = turns;
    Ok(PyTwin { twin, trial, design, ending })
}

#[pymethods]
impl PyTwin {
    /// RMS of the residual signals relative to the noise of the chips; about 1 if the twin explains its records.
    #[getter]
    fn misfit(&self) -> f64 {
        self.twin.misfit
    }

    /// How the fit ended: "converged" or a reason; None for a twin from a file.
    #[getter]
    fn ending(&self) -> Option<&str> {
        self.ending.as_deref()
    }

    /// Factors on the body's "stretch", "shear", "bend", "damping_ratio" and "density".
    #[getter]
    fn material<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let Parameters { stretch, shear, bend, damping_ratio, density, .. } = self.twin.cast.material;
        let factors = PyDict::new(py);
        for (name, factor) in [
            ("stretch", stretch),
            ("shear", shear),
            ("bend", bend),
            ("damping_ratio", damping_ratio),
            ("density", density),
        ] {
            factors.set_item(name, factor)?;
        }
        Ok(factors)
    }

    /// α of the cast (mm).
    #[getter]
    fn alpha<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.twin.cast.design(&self.design).into_pyarray(py)
    }

    /// Writes the twin to a TOML file, like `metasense lab identify --out`.
    fn save(&self, file: PathBuf) -> PyResult<()> {
        metasense::files::write(&file, self.text().as_bytes())
            .map_err(|e| PyOSError::new_err(format!("cannot write {}: {e}", file.display())))
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, State)> {
        let trial = serde_json::to_string(&self.trial).expect("a trial is JSON");
        let turns = self.twin.cast.chips.turn.clone();
        let state = (trial, self.design.clone(), self.text(), turns, self.ending.clone());
        Ok((unpickler(py, "unpickle_twin")?, state))
    }

    fn __copy__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        slf
    }

    fn __repr__(&self) -> String {
        let ending = self.ending.as_ref().map_or(String::new(), |ending| format!(", {ending}"));
        format!("<metasense.Twin: misfit {:.3}{ending}>", self.twin.misfit)
    }
}

/// Checks signals (N, T, C) of a body's chips; `count`: the required N, if any.
fn signals_of(body: &PyBody, count: Option<usize>, object: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
    let (shape, values) = samples("signals", object)?;
    let expected = [count.unwrap_or(shape[0]), body.problem.scene.instants, body.problem.shape().inputs];
    match shape == expected {
        true => Ok(values),
        false => Err(PyValueError::new_err(format!("signals has shape {shape:?}; it must be {expected:?}"))),
    }
}

/// Signals to decode, and the channel for the reply.
type DecodeRequest = (Vec<f64>, Sender<Posterior>);

/// Starts the thread that owns the decoder of a design or twin; returns its channel once the decoder is ready. The thread ends when
/// all senders are dropped.
fn begin(
    problem: Arc<Problem>,
    design: Vec<f64>,
    twin: Option<twin::Twin>,
    pool: Pool,
) -> PyResult<Sender<DecodeRequest>> {
    let (ask, request_receiver) = channel::<DecodeRequest>();
    let (tell, ready_receiver) = channel::<Result<(), NoResult>>();
    let work = move || {
        let made = with_brain(&problem, (&design, twin.as_ref()), &pool, |brain| {
            // the receiver may be gone
            let _ = tell.send(Ok(()));
            for (signals, reply) in request_receiver {
                let _ = reply.send(Posterior::of(&brain.read(&signals)));
            }
        });
        if let Err(why) = made {
            let _ = tell.send(Err(why));
        }
    };
    std::thread::Builder::new().spawn(work).map_err(|e| PyRuntimeError::new_err(e.to_string()))?;
    ready_receiver.recv().map_err(|_| ended())?.map_err(|e| raised(&e))?;
    Ok(ask)
}

/// Inverse decoder: finds the most probable forces under the body's own model.
///
/// It decodes the body of design `alpha` (default: the initial design), or the cast that `twin` describes. The noise is that of the
/// spec's `sensors`, and at least the residual of the twin. The constructor simulates the trial's training samples; `fit` can then
/// be called any number of times.
#[pyclass(frozen, module = "metasense", name = "Inverse")]
pub struct PyInverse {
    body: Py<PyBody>,
    design: Vec<f64>,
    twin: Option<Py<PyTwin>>,
    /// Channel to the thread that owns the decoder.
    ask: PerProcess<Sender<DecodeRequest>>,
    /// Number of samples of the last call that did not converge, and that the model does not explain.
    left: Mutex<[usize; 2]>,
}

#[pymethods]
impl PyInverse {
    #[new]
    #[pyo3(signature = (body, alpha=None, *, twin=None))]
    fn new(
        py: Python<'_>,
        body: Py<PyBody>,
        alpha: Option<&Bound<'_, PyAny>>,
        twin: Option<Py<PyTwin>>,
    ) -> PyResult<Self> {
        let own = body.get();
        let known = twin.as_ref().map(Py::get);
        if let Some(twin) = known {
            if alpha.is_some() {
                return Err(PyValueError::new_err(
                    "alpha: cannot be passed together with twin, which has its own design",
                ));
            }
            if twin.trial.body_digest(&twin.design) != own.trial.body_digest(&twin.design) {
                return Err(PyValueError::new_err("twin: belongs to another body, or to other sensors"));
            }
        }
        let design = match known {
            Some(twin) => twin.design.clone(),
            None => own.design_or_initial(alpha)?,
        };
        let (problem, pool) = (Arc::clone(&own.problem), own.threads.pool(py)?);
        let (asked, fitted) = (design.clone(), known.map(|twin| twin.twin.clone()));
        let ask = py.detach(|| begin(problem, asked, fitted, pool))?;
        Ok(Self { body, design, twin, ask: PerProcess::new(ask), left: Mutex::new([0; 2]) })
    }

    /// Pickles contain the constructor's arguments; restoring simulates the training samples again.
    fn __getnewargs_ex__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(ConstructorArgs<'py>, Bound<'py, PyDict>)> {
        let twin = PyDict::new(py);
        twin.set_item("twin", &self.twin)?;
        let design = self.twin.is_none().then(|| self.design.clone().into_pyarray(py));
        Ok(((self.body.clone_ref(py), design), twin))
    }

    fn __getstate__(&self) {}

    /// Estimates forces from signals (N, T, C) of the sensors' chips. Returns forces, lower and upper end of the 95 % bands, each
    /// (N, T, K) (N).
    fn fit<'py>(&self, py: Python<'py>, signals: &Bound<'py, PyAny>) -> PyResult<Bands<'py>> {
        let body = self.body.get();
        let signals = signals_of(body, None, signals)?;
        let ask = self.ask.get(py, || {
            let twin = self.twin.as_ref().map(|twin| twin.get().twin.clone());
            begin(Arc::clone(&body.problem), self.design.clone(), twin, body.threads.pool(py)?)
        })?;
        let found = py.detach(|| {
            let (reply, answer) = channel();
            ask.send((signals, reply)).ok()?;
            answer.recv().ok()
        });
        let Posterior { forces, low, high, unconverged, unexplained, .. } = found.ok_or_else(ended)?;
        *self.left.lock().expect("no panic while it was held") = [unconverged, unexplained];
        let (instants, panels) = (body.instants(), body.problem.scene.panels.len());
        let shape = [forces.len() / (instants * panels), instants, panels];
        let array = |values: Vec<f64>| values.into_pyarray(py).reshape(shape);
        Ok((array(forces)?, array(low)?, array(high)?))
    }

    /// Number of samples of the last `fit` that did not converge.
    #[getter]
    fn unconverged(&self) -> usize {
        self.left.lock().expect("no panic while it was held")[0]
    }

    /// Number of samples of the last `fit` that the model does not explain: residual² above 1.5 noise².
    #[getter]
    fn unexplained(&self) -> usize {
        self.left.lock().expect("no panic while it was held")[1]
    }
}

/// Constructor arguments except the twin.
type ConstructorArgs<'py> = (Py<PyBody>, Option<Bound<'py, PyArray1<f64>>>);

/// Forces, lower and upper ends of their bands.
type Bands<'py> = (Bound<'py, PyArray3<f64>>, Bound<'py, PyArray3<f64>>, Bound<'py, PyArray3<f64>>);

fn ended() -> PyErr {
    PyRuntimeError::new_err("the thread of the inverse decoder has ended unexpectedly")
}
