//! Report of an outer step.

use crate::brains::Implicit;
use crate::trial::{Counters, Trouble};

/// Time per activity (s).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Seconds {
    /// Simulation.
    pub simulate: f64,
    /// Training of the decoder.
    pub train: f64,
    /// Gradient through decoder and body.
    pub differentiate: f64,
    /// Implicit term: its linear system and mixed product.
    pub implicit: f64,
    /// Projection.
    pub project: f64,
}

/// Report of one outer step, on the design before the step.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Report {
    /// Outer step, from 0.
    pub step: u32,
    /// Test loss (N²).
    pub loss_test: Option<f64>,
    /// Training loss (normalised).
    pub loss_train: Option<f64>,
    /// Prediction error on the test set (%).
    pub error_test: Option<f64>,
    /// Prediction error on the training set, or on the step's fresh samples (%).
    pub error_train: Option<f64>,
    /// λ of the linear decoder that the body is trained with.
    pub ridge: Option<f64>,
    /// ‖dL/dα‖.
    pub gradient_norm: Option<f64>,
    /// ‖Δα‖ accepted (mm).
    pub step_length: Option<f64>,
    /// The projection's status.
    pub projection: Option<crate::feasible::Status>,
    /// Distance moved by the projection (mm).
    pub projection_distance: Option<f64>,
    /// Solution of the implicit term, if computed.
    pub implicit: Option<Implicit>,
    /// Why the step was undone.
    pub trouble: Option<Trouble>,
    /// Samples drawn for this step alone.
    pub fresh_samples: u64,
    /// Counts of work.
    pub counters: Counters,
    /// Time per activity.
    pub seconds: Seconds,
}
