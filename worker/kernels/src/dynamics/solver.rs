//! Settings of an integrator, and the plan that follows from them.
//!
//! Three similar numbers have separate types: the requested error of the signals, the tolerance of Tsit5's error norm, and the
//! precision of lanes.

use super::schemes::Scheme;

/// Integrators.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Integrator {
    /// Chosen from the scene and the accuracy.
    Auto,
    /// Tsitouras 5(4) with error control per sample.
    Tsit5,
    /// Störmer–Verlet, equal steps, order 2.
    Leapfrog,
    /// Blanes and Moan's Runge–Kutta–Nyström splitting, equal steps, order 4.
    Nystrom4,
    /// Blanes and Moan's Runge–Kutta–Nyström splitting, equal steps, order 6.
    Nystrom6,
}

impl Integrator {
    /// Name in specs and records.
    pub fn name(self) -> &'static str {
        ["auto", "tsit5", "leapfrog", "nystrom4", "nystrom6"][self as usize]
    }

    /// Force evaluations per step of methods with equal steps.
    pub fn stages(self) -> Option<usize> {
        self.scheme().map(|s| s.stages())
    }

    /// The splitting scheme, if the method is a splitting.
    pub(super) fn scheme(self) -> Option<Scheme> {
        match self {
            Self::Leapfrog => Some(Scheme::leapfrog()),
            Self::Nystrom4 => Some(Scheme::fourth()),
            Self::Nystrom6 => Some(Scheme::sixth()),
            Self::Auto | Self::Tsit5 => None,
        }
    }
}

/// Relative error of the signals, by `signal_error`.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Accuracy(pub f64);

/// Tolerance per step of Tsit5's error norm: `absolute` + `relative` · |state| (mm, rad, per second).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tolerance {
    /// Factor on the size of the state.
    pub relative: f64,
    /// Constant part.
    pub absolute: f64,
}

impl Tolerance {
    /// Smallest tolerance that a pilot tries; below it rounding dominates.
    pub(super) const SMALLEST: f64 = 1e-13;
    /// Tolerance divided by the requested error of the signals, before a pilot.
    const TOLERANCE_PER_ACCURACY: f64 = 1e-3;

    /// Sets both parts to `tolerance`.
    pub const fn both(tolerance: f64) -> Self {
        Self { relative: tolerance, absolute: tolerance }
    }

    /// The tolerance that gives the same steps for a linear motion `by` times as large.
    pub fn for_motion_scaled_by(self, by: f64) -> Self {
        Self { absolute: by * self.absolute, ..self }
    }
}

impl From<Accuracy> for Tolerance {
    fn from(Accuracy(asked): Accuracy) -> Self {
        Self::both((Self::TOLERANCE_PER_ACCURACY * asked).max(Self::SMALLEST))
    }
}

/// Scalar type of the lanes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Precision {
    /// f32: twice as many lanes; for steps so coarse that rounding is negligible.
    Single,
    /// f64.
    Double,
}

/// Settings of the integration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IntegratorSettings {
    /// The integrator.
    pub method: Integrator,
    /// Requested error of the signals. After a pilot of equal steps: the error for which the method's law gives the pilot's
    /// steps.
    pub accuracy: Accuracy,
    /// Tolerance of Tsit5, if set by a pilot.
    pub tolerance: Option<Tolerance>,
    /// Highest frequency of a body (rad/s) up to which forces are f32. A pilot sets it if rounding permits; otherwise 0.
    pub single_below: f64,
}

impl IntegratorSettings {
    /// A solver for this error of the signals.
    pub const fn new(method: Integrator, accuracy: Accuracy) -> Self {
        Self { method, accuracy, tolerance: None, single_below: 0.0 }
    }

    /// Tsit5 with this tolerance of its error norm.
    pub const fn tsit5(tolerance: Tolerance) -> Self {
        let accuracy = Accuracy(tolerance.relative / Tolerance::TOLERANCE_PER_ACCURACY);
        Self { tolerance: Some(tolerance), ..Self::new(Integrator::Tsit5, accuracy) }
    }

    /// This solver with equal steps, for finite differences: the steps then do not change with the body.
    pub fn in_equal_steps(self) -> Self {
        let method = if self.method == Integrator::Tsit5 { Integrator::Auto } else { self.method };
        Self { method, ..self }
    }

    /// This solver with at most this error of the signals, in f64: a pilot's choice of f32 is valid only for its own steps.
    pub fn at_most(self, Accuracy(error): Accuracy) -> Self {
        let stricter = (error / self.accuracy.0).min(1.0);
        let tolerance = self.tolerance.map(|t| Tolerance {
            relative: (stricter * t.relative).max(Tolerance::SMALLEST),
            absolute: (stricter * t.absolute).max(Tolerance::SMALLEST),
        });
        Self { accuracy: Accuracy(self.accuracy.0.min(error)), tolerance, single_below: 0.0, ..self }
    }
}

/// Steps of a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Steps {
    /// Steps of Tsit5 by error control.
    Adaptive(Tolerance),
    /// Number of steps per interval. A sample that fails is repeated with more.
    Equal(usize),
}

impl Steps {
    /// Number of equal steps per interval; 0 if adaptive.
    pub fn count(self) -> usize {
        match self {
            Self::Adaptive(_) => 0,
            Self::Equal(steps) => steps,
        }
    }

    /// Multiplies the number of equal steps by `by`.
    pub(super) fn times(self, by: usize) -> Self {
        match self {
            Self::Adaptive(_) => self,
            Self::Equal(steps) => Self::Equal(by * steps),
        }
    }
}

/// The integration that `choose` has selected for one scene.
#[derive(Debug, Clone, PartialEq)]
pub struct IntegrationPlan {
    /// Never `Auto`.
    pub method: Integrator,
    /// Adaptive for Tsit5, equal for the others.
    pub steps: Steps,
    /// `Single` only with equal steps.
    pub precision: Precision,
    /// Reason for the choice, as text.
    pub reason: String,
}

impl IntegrationPlan {
    /// Tsit5 with this tolerance.
    pub fn tsit5(tolerance: Tolerance) -> Self {
        let steps = Steps::Adaptive(tolerance);
        Self { method: Integrator::Tsit5, steps, precision: Precision::Double, reason: String::new() }
    }

    /// A method with `steps` equal steps per interval, in f64.
    pub fn equal(method: Integrator, steps: usize) -> Self {
        let steps = Steps::Equal(steps);
        Self { method, steps, precision: Precision::Double, reason: String::new() }
    }

    /// This plan in f64, for runs whose differences are used.
    pub fn double(self) -> Self {
        Self { precision: Precision::Double, ..self }
    }
}
