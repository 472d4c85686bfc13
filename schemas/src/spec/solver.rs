//! The clock of forces and signals, and how the equations of motion are integrated.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The clock of forces and signals.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Time {
    /// Length of a sample. Unit: s.
    pub duration: f64,
    /// Number of instants in a sample (T): t_n = n·duration/T, n = 1 … T.
    pub samples: usize,
}

impl Default for Time {
    fn default() -> Self {
        Self { duration: 1.0, samples: 200 }
    }
}

/// An integrator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// The cheapest method that keeps the tolerance, found by a pilot on the first samples.
    Auto,
    /// Tsitouras 5(4), adaptive steps.
    Tsit5,
    /// Störmer and Verlet's method of order 2, equal steps.
    Leapfrog,
    /// Blanes and Moan's Runge–Kutta–Nyström splitting of order 4, equal steps.
    Nystrom4,
    /// Blanes and Moan's Runge–Kutta–Nyström splitting of order 6, equal steps.
    Nystrom6,
}

/// How the equations of motion are integrated.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Solver {
    /// The integrator.
    pub method: Method,
    /// Relative error of the signals, root mean square over the channels. A pilot on the first samples finds the steps that keep
    /// it, with every method. Unit: 1.
    pub tolerance: f64,
}

impl Default for Solver {
    fn default() -> Self {
        Self { method: Method::Auto, tolerance: 1e-3 }
    }
}
