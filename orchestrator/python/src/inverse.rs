//! Bodies read by their own model: the inverse brain, and twins, which say what the model of a cast is.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};

use metasense_numerics::dynamics::Parameters;
use metasense_numerics::identify::twin;
use metasense_schemas::spec::TrialSpec;
use metasense_worker::inverse::{Posterior, with_brain};
use metasense_worker::measured::{Measured, MeasuredError};
use metasense_worker::run::Failure;
use metasense_worker::twin::{fit, read, store};
use numpy::{IntoPyArray, PyArray1, PyArray3, PyArrayMethods};
use pyo3::exceptions::{PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{Numbers, numbers};
use crate::body::Body;
use crate::brain::samples;
use crate::{chain, raised};

/// The cast of a body that best explains records of it, of `Body.twin` or `Body.read_twin`.
#[pyclass(frozen, module = "metasense")]
pub struct Twin {
    twin: twin::Twin,
    trial: TrialSpec,
    design: Vec<f64>,
    ending: Option<&'static str>,
}

impl Twin {
    /// Fits one to records of a body of this design.
    pub fn fitted(
        py: Python<'_>,
        body: &Body,
        design: Vec<f64>,
        forces: &Bound<'_, PyAny>,
        signals: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let Numbers { shape, values } = numbers("forces", forces)?;
        let scene = &body.problem.scene;
        let forces = metasense_worker::simulate::forces(scene, &shape, values).map_err(|e| raised(&e))?;
        let signals = signals_of(body, Some(forces.samples), signals)?;
        let measured = Measured { forces, signals, low_pass: false };
        let found = py.detach(|| fit(&body.trial, &design, &measured, body.pool.threads()));
        let twin::Fit { twin, ending, .. } = found.map_err(|e| raised(&e))?;
        Ok(Self { twin, trial: body.trial.clone(), design, ending: Some(ending.name()) })
    }

    /// Reads the file of one of a body of this design.
    pub fn read(body: &Body, design: Vec<f64>, file: PathBuf) -> PyResult<Self> {
        let twin = read(&file, &body.trial, &design).map_err(|e| match e {
            MeasuredError::Unreadable { .. } => PyOSError::new_err(chain(&e)),
            MeasuredError::Spec(_) => PyValueError::new_err(chain(&e)),
        })?;
        Ok(Self { twin, trial: body.trial.clone(), design, ending: None })
    }
}

#[pymethods]
impl Twin {
    /// Root mean square of what it leaves of the signals, by the noise of the chips; about 1 of a twin that explains its records.
    #[getter]
    fn misfit(&self) -> f64 {
        self.twin.misfit
    }

    /// How the fit ended, "converged" if it did; None of a twin that was read from a file.
    #[getter]
    fn ending(&self) -> Option<&str> {
        self.ending
    }

    /// By what the body's "stretch", "shear", "bend", "damping_ratio" and "density" are multiplied.
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

    /// α of the cast (mm), a copy.
    #[getter]
    fn alpha<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.twin.cast.design(&self.design).into_pyarray(py)
    }

    /// Writes it into a file (TOML), as `metasense twin --out` does.
    fn save(&self, file: PathBuf) -> PyResult<()> {
        let text = toml::to_string(&store(&self.trial, &self.design, &self.twin)).expect("a twin is TOML");
        metasense::files::write(&file, text.as_bytes())
            .map_err(|e| PyOSError::new_err(format!("cannot write {}: {e}", file.display())))
    }

    fn __repr__(&self) -> String {
        let ending = self.ending.map_or(String::new(), |ending| format!(", {ending}"));
        format!("<metasense.Twin: misfit {:.3}{ending}>", self.twin.misfit)
    }
}

/// Signals (N, T, C) as a body's chips give them, of so many samples where that is known.
fn signals_of(body: &Body, count: Option<usize>, object: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
    let (shape, values) = samples("signals", object)?;
    let expected = [count.unwrap_or(shape[0]), body.problem.scene.instants, body.problem.shape().inputs];
    match shape == expected {
        true => Ok(values),
        false => Err(PyValueError::new_err(format!("signals has shape {shape:?}; it must be {expected:?}"))),
    }
}

/// Signals, and who waits for what the brain says of them.
type Ask = (Vec<f64>, Sender<Posterior>);

/// The brain that reads a body by the body's own model: the forces under which it gives the signals that are read.
///
/// It reads a body of design `alpha`, by default the initial one, or a cast of it by its `twin`. Noise is what the spec's
/// `sensors` say, no less than what a twin leaves. Making it simulates the trial's training samples; it then keeps the model for
/// any number of calls.
#[pyclass(frozen, module = "metasense")]
pub struct Inverse {
    body: Py<Body>,
    /// To the thread that has the brain, which ends with this.
    ask: Mutex<Sender<Ask>>,
    /// Samples of the last call that did not converge, and that were not explained.
    left: Mutex<[usize; 2]>,
}

#[pymethods]
impl Inverse {
    #[new]
    #[pyo3(signature = (body, alpha=None, *, twin=None))]
    fn new(
        py: Python<'_>,
        body: Py<Body>,
        alpha: Option<&Bound<'_, PyAny>>,
        twin: Option<&Twin>,
    ) -> PyResult<Self> {
        let own = body.get();
        if let Some(twin) = twin {
            if alpha.is_some() {
                return Err(PyValueError::new_err("alpha: must be left out with twin, which has its own"));
            }
            if twin.trial.body_digest(&twin.design) != own.trial.body_digest(&twin.design) {
                return Err(PyValueError::new_err("twin: is of another body, or of other sensors"));
            }
        }
        let design = match twin {
            Some(twin) => twin.design.clone(),
            None => own.design_or_initial(alpha)?,
        };
        let (problem, pool) = (Arc::clone(&own.problem), own.pool.clone());
        let twin = twin.map(|twin| twin.twin.clone());
        let (ask, asked): (Sender<Ask>, Receiver<Ask>) = channel();
        let (tell, told) = channel::<Result<(), Failure>>();
        let work = move || {
            let made = with_brain(&problem, (&design, twin.as_ref()), &pool, |brain| {
                // whoever asked may be gone
                let _ = tell.send(Ok(()));
                for (signals, reply) in asked {
                    let _ = reply.send(Posterior::of(&brain.read(&signals)));
                }
            });
            if let Err(why) = made {
                let _ = tell.send(Err(why));
            }
        };
        std::thread::Builder::new().spawn(work).map_err(|e| PyRuntimeError::new_err(e.to_string()))?;
        py.detach(move || told.recv()).map_err(|_| ended())?.map_err(|e| raised(&e))?;
        Ok(Self { body, ask: Mutex::new(ask), left: Mutex::new([0; 2]) })
    }

    /// Forces of signals (N, T, C), as the sensors' chips give them, and the lower and upper end of their 95 % bands, each
    /// (N, T, K) (N).
    fn fit<'py>(&self, py: Python<'py>, signals: &Bound<'py, PyAny>) -> PyResult<Bands<'py>> {
        let body = self.body.get();
        let signals = signals_of(body, None, signals)?;
        let found = py.detach(|| {
            let (reply, answer) = channel();
            self.ask.lock().ok()?.send((signals, reply)).ok()?;
            answer.recv().ok()
        });
        let Posterior { forces, low, high, unconverged, unexplained, .. } = found.ok_or_else(ended)?;
        *self.left.lock().expect("no panic while it was held") = [unconverged, unexplained];
        let (instants, panels) = (body.instants(), body.problem.scene.panels.len());
        let shape = [forces.len() / (instants * panels), instants, panels];
        let array = |values: Vec<f64>| values.into_pyarray(py).reshape(shape);
        Ok((array(forces)?, array(low)?, array(high)?))
    }

    /// How many samples of the last `fit` did not converge.
    #[getter]
    fn unconverged(&self) -> usize {
        self.left.lock().expect("no panic while it was held")[0]
    }

    /// How many samples of the last `fit` the model does not explain: what is left is above 1.5 times the noise's square.
    #[getter]
    fn unexplained(&self) -> usize {
        self.left.lock().expect("no panic while it was held")[1]
    }
}

/// Forces, and both ends of their bands.
type Bands<'py> = (Bound<'py, PyArray3<f64>>, Bound<'py, PyArray3<f64>>, Bound<'py, PyArray3<f64>>);

fn ended() -> PyErr {
    PyRuntimeError::new_err("the inverse brain has ended")
}
