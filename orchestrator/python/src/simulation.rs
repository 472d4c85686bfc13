//! The simulation of a body, and its derivatives.

use metasense_numerics::dynamics::{self, Forces, Gradient, Outcome, Parameters, Scene, Tangent, Wrt};
use metasense_worker::run::finite;
use metasense_worker::simulate::check_cotangent;
use numpy::{IntoPyArray, PyArray1, PyArray3, PyArrayMethods};
use pyo3::exceptions::{PyRuntimeError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;

use crate::arrays::{Numbers, numbers, vector};
use crate::threads::Threads;
use crate::{SimulationError, raised};

/// A simulation: signals of the sensors, how each sample ended, and derivatives of the signals.
#[pyclass(frozen, module = "metasense")]
pub struct Simulation {
    threads: Threads,
    scene: Scene,
    design: Vec<f64>,
    forces: Forces,
    run: dynamics::Simulation,
    solver: String,
    signals: Py<PyArray3<f64>>,
}

impl Simulation {
    pub fn new(
        py: Python<'_>,
        threads: Threads,
        scene: Scene,
        design: Vec<f64>,
        forces: Forces,
        solver: String,
        mut run: dynamics::Simulation,
    ) -> PyResult<Self> {
        let shape = [forces.samples, scene.instants, 3 * scene.sensors.len()];
        let signals = std::mem::take(&mut run.signals).into_pyarray(py).reshape(shape)?;
        signals.try_readwrite()?.make_nonwriteable();
        Ok(Self { threads, scene, design, forces, run, solver, signals: signals.unbind() })
    }

    fn taped(&self) -> PyResult<()> {
        match self.run.tape {
            Some(_) => Ok(()),
            None => Err(PyValueError::new_err("tape = False: such a simulation cannot be differentiated")),
        }
    }
}

#[pymethods]
impl Simulation {
    /// (a_x, a_y, ω) of each sensor at n = 1…T, (N, T, 3M) (mm/s², rad/s), read-only; zero for samples that failed.
    #[getter]
    fn signals(&self, py: Python<'_>) -> Py<PyArray3<f64>> {
        self.signals.clone_ref(py)
    }

    /// How each sample ended: "ok" or why it did not reach its end.
    #[getter]
    fn outcomes(&self) -> Vec<&'static str> {
        self.run.outcomes.iter().map(|o| o.name()).collect()
    }

    /// Which samples reached their end, (N) bool.
    #[getter]
    fn ok<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<bool>> {
        let ok: Vec<bool> = self.run.outcomes.iter().map(|o| *o == Outcome::Ok).collect();
        ok.into_pyarray(py)
    }

    /// The integrator, and why it was chosen.
    #[getter]
    fn solver(&self) -> &str {
        &self.solver
    }

    /// Raises `SimulationError` if a sample did not reach its end.
    fn check(&self, py: Python<'_>) -> PyResult<()> {
        let outcomes = self.outcomes();
        let Some(first) = outcomes.iter().position(|o| *o != "ok") else { return Ok(()) };
        let failed = outcomes.iter().filter(|o| **o != "ok").count();
        let error = SimulationError::new_err(format!(
            "{failed} of {} samples did not reach their end; number {first}: {}",
            outcomes.len(),
            outcomes[first]
        ));
        error.value(py).setattr("outcomes", outcomes)?;
        Err(error)
    }

    /// dα (mm⁻¹) of Σ cotangent · signals, cotangent (N, T, 3M). Samples that failed contribute nothing.
    fn vjp<'py>(
        &self,
        py: Python<'py>,
        cotangent: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        Ok(self.gradient(py, cotangent, Wrt::Design)?.design.into_pyarray(py))
    }

    /// As `vjp`, and the derivatives in the material: "stiffness" (3) [stretch, shear, bend], "damping_ratio", "density".
    fn vjp_material<'py>(
        &self,
        py: Python<'py>,
        cotangent: &Bound<'py, PyAny>,
    ) -> PyResult<(Bound<'py, PyArray1<f64>>, Bound<'py, PyDict>)> {
        let found = self.gradient(py, cotangent, Wrt::Parameters)?;
        let p = found.parameters.expect("asked for");
        let material = PyDict::new(py);
        material.set_item("stiffness", vec![p.stretch, p.shear, p.bend].into_pyarray(py))?;
        material.set_item("damping_ratio", p.damping_ratio)?;
        material.set_item("density", p.density)?;
        Ok((found.design.into_pyarray(py), material))
    }

    /// As `vjp`, and the derivative in the forces (N, K, R + 1), also where they are zero. It takes longer, since each sample
    /// is differentiated from its first instant on; dα equals that of `vjp` up to rounding.
    fn vjp_forces<'py>(&self, py: Python<'py>, cotangent: &Bound<'py, PyAny>) -> PyResult<InBoth<'py>> {
        let found = self.gradient(py, cotangent, Wrt::Forces)?;
        let Forces { samples, panels, instants, .. } = self.forces;
        let forces = found.forces.expect("asked for").into_pyarray(py);
        Ok((found.design.into_pyarray(py), forces.reshape([samples, panels, instants + 1])?))
    }

    /// Derivative of the signals (N, T, 3M) along `tangent` in α and, where given, along those in the forces (N, K, R + 1) and in
    /// the material, with the integrator's steps held fixed. It takes some hundred times as long as `vjp`: use it to check and to
    /// linearise. Zero for samples that failed.
    #[pyo3(signature = (tangent, *, forces=None, stiffness=None, damping_ratio=0.0, density=0.0))]
    fn jvp<'py>(
        &self,
        py: Python<'py>,
        tangent: &Bound<'py, PyAny>,
        forces: Option<&Bound<'py, PyAny>>,
        stiffness: Option<&Bound<'py, PyAny>>,
        damping_ratio: f64,
        density: f64,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        self.taped()?;
        let tangent = vector("tangent", tangent)?;
        if tangent.len() != self.design.len() {
            let (given, expected) = (tangent.len(), self.design.len());
            return Err(PyValueError::new_err(format!("the tangent has {given} numbers, α {expected}")));
        }
        let given = &self.forces;
        let pushed = forces.map(|forces| numbers("forces", forces)).transpose()?;
        let pushed = pushed.unwrap_or_else(|| Numbers { shape: Vec::new(), values: Vec::new() });
        let shape = [given.samples, given.panels, given.instants + 1];
        if forces.is_some() && pushed.shape != shape {
            return Err(PyValueError::new_err(format!(
                "the tangent of the forces has shape {:?}, the forces {shape:?}",
                pushed.shape
            )));
        }
        let k = stiffness.map_or(Ok(vec![0.0; 3]), |k| vector("stiffness", k))?;
        let [stretch, shear, bend] = k[..] else {
            let remedy = "must be [stretch, shear, bend]";
            return Err(PyValueError::new_err(format!("stiffness = {k:?}: {remedy}")));
        };
        finite("the tangents", &[&tangent[..], &pushed.values, &k, &[damping_ratio, density]].concat())
            .map_err(|e| raised(&e))?;
        let parameters = Parameters { stretch, shear, bend, damping_ratio, density, contact: 0.0 };
        let (instants, channels) = (self.scene.instants, 3 * self.scene.sensors.len());
        let one = |sample: usize| match self.run.outcomes[sample] {
            Outcome::Ok => {
                let len = pushed.values.len() / given.samples;
                let forces = &pushed.values[sample * len..][..len];
                self.run.jvp(sample, Tangent { design: &tangent, parameters, forces }).1
            }
            _ => vec![0.0; instants * channels],
        };
        let (samples, pool) = (given.samples, self.threads.pool(py)?);
        let found: Vec<Vec<f64>> =
            py.detach(|| pool.install(|| (0..samples).into_par_iter().map(one).collect()));
        found.concat().into_pyarray(py).reshape([samples, instants, channels])
    }

    fn __reduce__(&self) -> PyResult<()> {
        Err(PyTypeError::new_err(
            "a Simulation cannot be pickled: it holds the steps of every sample. Pass its signals and derivatives, or the body, \
             alpha and forces",
        ))
    }

    fn __copy__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        slf
    }

    fn __repr__(&self) -> String {
        let failed = self.run.outcomes.iter().filter(|o| **o != Outcome::Ok).count();
        let (samples, solver) = (self.forces.samples, &self.solver);
        format!("<metasense.Simulation of {samples} samples, {failed} failed: {solver}>")
    }
}

/// Derivatives in α and in the forces.
type InBoth<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray3<f64>>);

impl Simulation {
    fn gradient(&self, py: Python<'_>, cotangent: &Bound<'_, PyAny>, wrt: Wrt) -> PyResult<Gradient> {
        self.taped()?;
        let Numbers { shape, values } = numbers("cotangent", cotangent)?;
        check_cotangent(&self.scene, self.forces.samples, &shape, &values).map_err(|e| raised(&e))?;
        let pool = self.threads.pool(py)?;
        let found = py.detach(|| self.run.vjp(&values, wrt, &pool));
        match found.design.iter().chain(found.forces.iter().flatten()).all(|g| g.is_finite()) {
            true => Ok(found),
            false => Err(PyRuntimeError::new_err("the gradient is not finite")),
        }
    }
}
