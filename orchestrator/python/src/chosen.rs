//! The tuned integrator of a body.

use metasense_numerics::dynamics::{Accuracy, Integrator, IntegratorSettings, Tolerance};
use pyo3::PyResult;
use pyo3::exceptions::PyValueError;

/// A solver for all calls, and the reason for its choice.
#[derive(Clone)]
pub struct Chosen {
    pub solver: IntegratorSettings,
    pub reason: String,
}

/// Pickled solver: method, accuracy, tolerance (relative, absolute), `single`, and the reason.
pub type Pickled = (String, f64, Option<(f64, f64)>, f64, String);

impl Chosen {
    pub fn pickled(&self) -> Pickled {
        let IntegratorSettings { method, accuracy, tolerance, single_below: single } = self.solver;
        let tolerance = tolerance.map(|t| (t.relative, t.absolute));
        (method.name().to_owned(), accuracy.0, tolerance, single, self.reason.clone())
    }

    pub fn unpickled((method, accuracy, tolerance, single, reason): Pickled) -> PyResult<Self> {
        let method = [Integrator::Tsit5, Integrator::Leapfrog, Integrator::Nystrom4, Integrator::Nystrom6]
            .into_iter()
            .find(|known| known.name() == method)
            .ok_or_else(|| {
                PyValueError::new_err(format!("{method}: not an integrator of this version of metasense"))
            })?;
        let tolerance = tolerance.map(|(relative, absolute)| Tolerance { relative, absolute });
        let solver =
            IntegratorSettings { method, accuracy: Accuracy(accuracy), tolerance, single_below: single };
        Ok(Self { solver, reason })
    }
}
