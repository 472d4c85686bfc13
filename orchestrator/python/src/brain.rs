//! Linear decoder for arbitrary arrays.

use metasense_lab::prepare::finite;
use metasense_numerics::brain::linear::{Lags, Linear, Sizes};
use metasense_numerics::brains::{Fitted, READINGS_MAX, fits};
use metasense_numerics::dynamics::Forces;
use metasense_numerics::stimuli::targets;
use metasense_numerics::trial::{Decoder, RidgeChoice, Samples};
use metasense_worker::run::pool;
use numpy::{IntoPyArray, PyArray1, PyArray3, PyArrayMethods};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{NumericArray, indices, numbers, parse_integer, vector};
use crate::raised;

/// Linear decoder: least squares from the signals around each instant to the forces, with L2 regularisation, solved exactly.
///
/// `memory` is (before, after) in instants; default: the whole sample. `ridge` is λ, the factor of the squared weights; default:
/// chosen by cross-validation. `seed` determines the folds.
#[pyclass(module = "metasense")]
pub struct LinearBrain {
    memory: Option<[usize; 2]>,
    ridge: Option<f64>,
    seed: u64,
    fitted: Option<Fitted>,
}

/// Memory and λ, the positional arguments.
type ConstructorArgs = (Option<[usize; 2]>, Option<f64>);

/// State of a fit: T, C, K and the lags; W, b and the scale of signals; λ and the scale of forces; the error.
type State<'py> = ([usize; 5], [Bound<'py, PyArray1<f64>>; 3], [f64; 2], Option<f64>);

fn memory(given: &Bound<'_, PyAny>) -> PyResult<Option<[usize; 2]>> {
    if given.is_none() {
        return Ok(None);
    }
    let found = indices("memory", given)?;
    let remedy = || format!("memory = {given}: must be two numbers of instants, before and after");
    found[..].try_into().map(Some).map_err(|_| PyValueError::new_err(remedy()))
}

fn seed(given: &Bound<'_, PyAny>) -> PyResult<u64> {
    parse_integer("seed", given, 0..=u64::MAX)
}

/// Checks an array of samples, (N, T, width).
pub fn samples(what: &str, object: &Bound<'_, PyAny>) -> PyResult<([usize; 3], Vec<f64>)> {
    let NumericArray { shape, values } = numbers(what, object)?;
    finite(what, &values).map_err(|e| raised(&e))?;
    match shape[..] {
        [n, t, c] if n * t * c > 0 => Ok(([n, t, c], values)),
        _ => Err(PyValueError::new_err(format!(
            "{what} has shape {shape:?}; it must have three dimensions, none of size 0"
        ))),
    }
}

impl LinearBrain {
    fn fitted(&self) -> PyResult<&Fitted> {
        self.fitted
            .as_ref()
            .ok_or_else(|| PyValueError::new_err("the decoder has not been fitted: call `fit` first"))
    }

    /// Checks samples whose shape must be that of the fit.
    fn known(&self, what: &str, width: usize, object: &Bound<'_, PyAny>) -> PyResult<([usize; 3], Vec<f64>)> {
        let (shape, values) = samples(what, object)?;
        let expected = [shape[0], self.fitted()?.sizes().instants, width];
        match shape == expected {
            true => Ok((shape, values)),
            false => {
                Err(PyValueError::new_err(format!("{what} has shape {shape:?}; it must be {expected:?}")))
            }
        }
    }
}

#[pymethods]
impl LinearBrain {
    #[new]
    #[pyo3(signature = (memory=None, ridge=None, *, seed=1))]
    fn new(
        #[pyo3(from_py_with = memory)] memory: Option<[usize; 2]>,
        ridge: Option<f64>,
        #[pyo3(from_py_with = seed)] seed: u64,
    ) -> PyResult<Self> {
        match ridge {
            Some(ridge) if !(ridge >= 0.0 && ridge.is_finite()) => {
                Err(PyValueError::new_err(format!("ridge = {ridge}: must be a finite number of at least 0")))
            }
            _ => Ok(Self { memory, ridge, seed, fitted: None }),
        }
    }

    /// Fits to signals (N, T, C) and forces (N, K, R + 1) (N), with R a multiple of T; returns self.
    ///
    /// Signals are divided by `signal_scale` (C), by default their RMS. A trial uses the RMS of its initial body.
    #[pyo3(signature = (signals, forces, *, signal_scale=None))]
    fn fit<'py>(
        mut slf: PyRefMut<'py, Self>,
        py: Python<'py>,
        signals: &Bound<'py, PyAny>,
        forces: &Bound<'py, PyAny>,
        signal_scale: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<PyRefMut<'py, Self>> {
        let ([n, instants, channels], signals) = samples("signals", signals)?;
        let ([records, panels, clock], values) = samples("forces", forces)?;
        if values.iter().all(|f| *f == 0.0) {
            return Err(PyValueError::new_err("forces: all are zero; there is nothing to fit"));
        }
        if records != n || clock < 2 || !(clock - 1).is_multiple_of(instants) {
            return Err(PyValueError::new_err(format!(
                "forces has shape {:?}; beside {n} samples of {instants} instants it must be ({n}, K, {} + 1), or a \
                 clock finer by a whole factor",
                [records, panels, clock],
                instants
            )));
        }
        if !fits(instants, channels) {
            let readings = instants.saturating_mul(channels);
            return Err(PyValueError::new_err(format!(
                "signals has {readings} readings per sample (T × C); the limit is {READINGS_MAX}"
            )));
        }
        let signal_scale = signal_scale.map(|scale| vector("signal_scale", scale)).transpose()?;
        if let Some(scale) = signal_scale
            .as_ref()
            .filter(|scale| scale.len() != channels || !scale.iter().all(|s| *s > 0.0 && s.is_finite()))
        {
            return Err(PyValueError::new_err(format!(
                "signal_scale = {scale:?}: must be {channels} numbers above 0"
            )));
        }
        let [before, after] = slf.memory.unwrap_or([instants - 1; 2]);
        let decoder = Decoder {
            lags: Lags { before, after }.within(instants),
            ridge: slf.ridge.map_or(RidgeChoice::Auto, RidgeChoice::Given),
        };
        let (seed, pool) = (slf.seed, pool(1).map_err(|e| raised(&e))?);
        let fitted = py.detach(|| {
            let forces = Forces { samples: n, panels, instants: clock - 1, values, strikes: Vec::new() };
            let sizes = Sizes { instants, channels, outputs: panels };
            let known = Samples::new(sizes, signals, targets(&forces, instants, false));
            decoder.fit(seed, &known, signal_scale, &pool)
        });
        let singular = |_| {
            PyRuntimeError::new_err("no ridge gives a solution: the signals carry too little information")
        };
        slf.fitted = Some(fitted.map_err(singular)?);
        Ok(slf)
    }

    /// Estimates forces (N, T, K) (N) from signals (N, T, C).
    fn predict<'py>(
        &self,
        py: Python<'py>,
        signals: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let fitted = self.fitted()?;
        let ([n, ..], signals) = self.known("signals", fitted.sizes().channels, signals)?;
        let shape = [n, fitted.sizes().instants, fitted.sizes().outputs];
        py.detach(|| fitted.predict(&signals)).into_pyarray(py).reshape(shape)
    }

    /// Derivative of Σ cotangent · predict(signals) by the signals, (N, T, C); cotangent (N, T, K).
    fn vjp<'py>(
        &self,
        py: Python<'py>,
        cotangent: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let fitted = self.fitted()?;
        let ([n, ..], cotangent) = self.known("cotangent", fitted.sizes().outputs, cotangent)?;
        let shape = [n, fitted.sizes().instants, fitted.sizes().channels];
        py.detach(|| fitted.predict_vjp(&cotangent)).into_pyarray(py).reshape(shape)
    }

    fn __getnewargs_ex__<'py>(&self, py: Python<'py>) -> PyResult<(ConstructorArgs, Bound<'py, PyDict>)> {
        let seed = PyDict::new(py);
        seed.set_item("seed", self.seed)?;
        Ok(((self.memory, self.ridge), seed))
    }

    fn __getstate__<'py>(&self, py: Python<'py>) -> Option<State<'py>> {
        let Fitted { linear, ridge, signal_scale, force_scale, error } = self.fitted.as_ref()?;
        let Linear { sizes: Sizes { instants, channels, outputs }, lags, w, b } = linear;
        let array = |values: &Vec<f64>| values.clone().into_pyarray(py);
        let sizes = [*instants, *channels, *outputs, lags.before, lags.after];
        let arrays = [array(w), array(b), array(signal_scale)];
        Some((sizes, arrays, [*ridge, *force_scale], *error))
    }

    fn __setstate__(&mut self, state: State<'_>) -> PyResult<()> {
        let (sizes, arrays, scalars, error) = state;
        let [instants, channels, outputs, before, after] = sizes;
        let [w, b, signal_scale] = arrays.map(|array| array.readonly().as_slice().map(<[f64]>::to_vec));
        let sizes = Sizes { instants, channels, outputs };
        let linear = Linear { sizes, lags: Lags { before, after }, w: w?, b: b? };
        let [ridge, force_scale] = scalars;
        self.fitted = Some(Fitted { linear, ridge, signal_scale: signal_scale?, force_scale, error });
        Ok(())
    }

    /// λ of the fit.
    #[getter]
    fn ridge(&self) -> PyResult<f64> {
        Ok(self.fitted()?.ridge)
    }

    /// Mean error (%) on the samples of the fit; None if no sample has a force.
    #[getter]
    fn error(&self) -> PyResult<Option<f64>> {
        Ok(self.fitted()?.error)
    }

    /// Bias b (K) (N).
    #[getter]
    fn bias<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let [_, b] = self.fitted()?.weights();
        Ok(b.into_pyarray(py))
    }
}
