//! What an outer step reports.

use crate::brains::Implicit;
use crate::trial::{Counters, Trouble};

/// Where time went (s).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Seconds {
    /// Simulation.
    pub simulate: f64,
    /// Training of the brain.
    pub train: f64,
    /// Gradient through network and body.
    pub differentiate: f64,
    /// Implicit term: its linear system and mixed product.
    pub implicit: f64,
    /// Projection.
    pub project: f64,
}

/// One outer step. The design it speaks of is the one before the step.
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
    /// The implicit term, where taken.
    pub implicit: Option<Implicit>,
    /// What went wrong; the step was then taken back.
    pub trouble: Option<Trouble>,
    /// Samples drawn for this step alone.
    pub fresh_samples: u64,
    /// Counts of work.
    pub counters: Counters,
    /// Where the time went.
    pub seconds: Seconds,
}
