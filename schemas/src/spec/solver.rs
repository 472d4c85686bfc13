//! The clock of forces and signals, and how the equations of motion are integrated.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The clock of forces and signals.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Time {
    /// Length of a sample (s).
    pub duration: f64,
    /// T: instants t_n = n·duration/T, n = 1…T.
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
    /// Chosen from the scene's highest frequency and the tolerance.
    Auto,
    /// Tsitouras 5(4), error control a sample.
    Tsit5,
    /// Störmer and Verlet's, equal steps, order 2.
    Leapfrog,
    /// Blanes and Moan's Runge–Kutta–Nyström splitting, equal steps, order 4.
    Nystrom4,
    /// Blanes and Moan's Runge–Kutta–Nyström splitting, equal steps, order 6.
    Nystrom6,
    /// What old databases may hold; no longer an integrator.
    #[schemars(skip)]
    Implicit,
}

/// How the equations of motion are integrated.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Solver {
    /// The integrator.
    pub method: Method,
    /// Relative error asked of the signals, whatever the method.
    pub tolerance: f64,
}

impl Default for Solver {
    fn default() -> Self {
        Self { method: Method::Auto, tolerance: 1e-3 }
    }
}
