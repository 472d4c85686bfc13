//! The Python class `Simulation`: a body's signals and their derivatives.

use std::sync::Arc;

use metasense_lab::prepare::finite;
use metasense_lab::simulate::check_cotangent;
use metasense_numerics::dynamics::{self, Forces, Gradient, Outcome, Parameters, Scene, Tangent, Wrt};
use metasense_numerics::trial::{Chip, Problem};
use numpy::{IntoPyArray, PyArray1, PyArray3, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::exceptions::{PyRuntimeError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;

use crate::arrays::{NumericArray, numbers, vector};
use crate::threads::Threads;
use crate::{SimulationError, raised};

/// A simulation: signals of the sensors, how each sample ended, and derivatives of the signals.
#[pyclass(frozen, module = "metasense", name = "Simulation")]
pub struct PySimulation {
    threads: Threads,
    scene: Scene,
    design: Vec<f64>,
    forces: Forces,
    run: dynamics::Simulation,
    solver: String,
    signals: Py<PyArray3<f64>>,
    chips: Option<PyChips>,
    /// R, the instants of the caller's forces.
    given: usize,
}

/// The chips that measured the signals.
pub struct PyChips {
    /// Has the sensors of the simulation.
    pub problem: Arc<Problem>,
    pub chip: Chip,
}

impl PyChips {
    /// Readings of signals (N, ·, 3M) under the caller's forces; zero for failed samples.
    fn read(&self, signals: Vec<f64>, forces: &Forces, outcomes: &[Outcome]) -> Vec<f64> {
        let mut read = self.problem.read(signals, forces.samples);
        self.chip.disturb(&mut read, forces);
        let one = read.len() / forces.samples;
        let failed = read.chunks_exact_mut(one).zip(outcomes).filter(|(_, outcome)| **outcome != Outcome::Ok);
        failed.for_each(|(sample, _)| sample.fill(0.0));
        read
    }
}

impl PySimulation {
    pub fn new(
        py: Python<'_>,
        threads: Threads,
        scene: Scene,
        design: Vec<f64>,
        [given, forces]: [Forces; 2],
        chips: Option<PyChips>,
        solver: String,
        mut run: dynamics::Simulation,
    ) -> PyResult<Self> {
        let (mut signals, mut shape) = (std::mem::take(&mut run.signals), [given.samples, scene.instants, 3]);
        if let Some(chips) = &chips {
            (shape[1], shape[2]) = (chips.problem.scene.instants, chips.problem.channels.len());
            signals = py.detach(|| chips.read(signals, &given, &run.outcomes));
        }
        shape[2] *= scene.sensors.len();
        let signals = signals.into_pyarray(py).reshape(shape)?;
        signals.try_readwrite()?.make_nonwriteable();
        let (signals, given) = (signals.unbind(), given.instants);
        Ok(Self { threads, scene, design, forces, run, solver, signals, chips, given })
    }

    /// Zeroes, in place, a cotangent or tangent where readings are at the limit of the range.
    fn within_range(&self, py: Python<'_>, cotangent: &mut [f64]) -> PyResult<()> {
        let Some(PyChips { chip, .. }) = &self.chips else { return Ok(()) };
        chip.disturb_vjp(cotangent, self.signals.bind(py).try_readonly()?.as_slice()?);
        Ok(())
    }

    /// # Errors
    /// If the simulation used forces at instants that the caller did not pass.
    fn has_own_forces(&self) -> PyResult<()> {
        match self.forces.instants == self.given {
            true => Ok(()),
            false => Err(PyValueError::new_err(
                "noise_seed: signals behind sensors.delay or sensors.bandwidth have no derivatives in the forces: leave one of the \
                 three out",
            )),
        }
    }

    /// Shape of the signals.
    fn shape(&self, py: Python<'_>) -> [usize; 3] {
        self.signals.bind(py).shape().try_into().expect("three axes")
    }

    fn taped(&self) -> PyResult<()> {
        match self.run.tape {
            Some(_) => Ok(()),
            None => Err(PyValueError::new_err("tape = False: such a simulation cannot be differentiated")),
        }
    }
}

#[pymethods]
impl PySimulation {
    /// (a_x, a_y, ω) of each sensor at n = 1…T, (N, T, 3M) (mm/s², rad/s), read-only; zero for failed samples. With
    /// `noise_seed`, (N, T, C·M), with the spec's C channels per sensor.
    #[getter]
    fn signals(&self, py: Python<'_>) -> Py<PyArray3<f64>> {
        self.signals.clone_ref(py)
    }

    /// The outcome of each sample: "ok" or why it failed.
    #[getter]
    fn outcomes(&self) -> Vec<&'static str> {
        self.run.outcomes.iter().map(|o| o.name()).collect()
    }

    /// Whether each sample succeeded, (N) bool.
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

    /// Raises `SimulationError` if a sample failed.
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

    /// dα (mm⁻¹) of Σ cotangent · signals, cotangent (N, T, 3M). Failed samples contribute nothing.
    fn vjp<'py>(
        &self,
        py: Python<'py>,
        cotangent: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        Ok(self.gradient(py, cotangent, Wrt::Design)?.design.into_pyarray(py))
    }

    /// As `vjp`, with the derivatives in the material: "stiffness" (3) [stretch, shear, bend], "damping_ratio", "density".
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

    /// As `vjp`, with the derivative in the forces (N, K, R + 1), also where they are zero. Takes longer, because it
    /// differentiates each sample from the first instant; dα equals that of `vjp` up to rounding.
    fn vjp_forces<'py>(
        &self,
        py: Python<'py>,
        cotangent: &Bound<'py, PyAny>,
    ) -> PyResult<DesignForceGradients<'py>> {
        let found = self.gradient(py, cotangent, Wrt::Forces)?;
        let Forces { samples, panels, instants, .. } = self.forces;
        let forces = found.forces.expect("asked for").into_pyarray(py);
        Ok((found.design.into_pyarray(py), forces.reshape([samples, panels, instants + 1])?))
    }

    /// Derivative of the signals (N, T, 3M) along `tangent` in α and, if given, tangents in the forces (N, K, R + 1) and the
    /// material, with fixed integrator steps. Takes about a hundred times as long as `vjp`: use it to check and to
    /// linearise. Zero for failed samples.
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
        let pushed = pushed.unwrap_or_else(|| NumericArray { shape: Vec::new(), values: Vec::new() });
        let shape = [given.samples, given.panels, given.instants + 1];
        if forces.is_some() {
            self.has_own_forces()?;
        }
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
        let ideal = self.scene.instants * 3 * self.scene.sensors.len();
        let differentiate_one = |sample: usize| match self.run.outcomes[sample] {
            Outcome::Ok => {
                let len = pushed.values.len() / given.samples;
                let forces = &pushed.values[sample * len..][..len];
                self.run.jvp(sample, Tangent { design: &tangent, parameters, forces }).1
            }
            _ => vec![0.0; ideal],
        };
        let (samples, pool) = (given.samples, self.threads.pool(py)?);
        let found: Vec<Vec<f64>> =
            py.detach(|| pool.install(|| (0..samples).into_par_iter().map(differentiate_one).collect()));
        let mut found = found.concat();
        if let Some(PyChips { problem, .. }) = &self.chips {
            found = problem.read(found, samples);
        }
        self.within_range(py, &mut found)?;
        found.into_pyarray(py).reshape(self.shape(py))
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
type DesignForceGradients<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray3<f64>>);

impl PySimulation {
    fn gradient(&self, py: Python<'_>, cotangent: &Bound<'_, PyAny>, wrt: Wrt) -> PyResult<Gradient> {
        self.taped()?;
        let NumericArray { shape, mut values } = numbers("cotangent", cotangent)?;
        check_cotangent(self.shape(py), &shape, &values).map_err(|e| raised(&e))?;
        if matches!(wrt, Wrt::Forces) {
            self.has_own_forces()?;
        }
        self.within_range(py, &mut values)?;
        if let Some(PyChips { problem, .. }) = &self.chips {
            values = problem.read_vjp(values, self.forces.samples);
        }
        let pool = self.threads.pool(py)?;
        let found = py.detach(|| self.run.vjp(&values, wrt, &pool));
        match found.design.iter().chain(found.forces.iter().flatten()).all(|g| g.is_finite()) {
            true => Ok(found),
            false => Err(PyRuntimeError::new_err("the gradient is not finite")),
        }
    }
}
