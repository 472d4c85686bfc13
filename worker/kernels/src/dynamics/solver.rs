//! What is asked of an integrator, and what is carried out.
//!
//! Three numbers that are easily confused have types of their own: the error asked of the signals, the tolerance of Tsit5's
//! error norm, and the precision of the lanes.

use super::schemes::Scheme;

/// Integrators.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Chosen from the scene and the accuracy.
    Auto,
    /// Tsitouras 5(4), error control a sample.
    Tsit5,
    /// Störmer and Verlet's, equal steps, order 2.
    Leapfrog,
    /// Blanes and Moan's Runge–Kutta–Nyström splitting, equal steps, order 4.
    Nystrom4,
    /// Blanes and Moan's Runge–Kutta–Nyström splitting, equal steps, order 6.
    Nystrom6,
}

impl Method {
    /// The name by which specs and records know it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Tsit5 => "tsit5",
            Self::Leapfrog => "leapfrog",
            Self::Nystrom4 => "nystrom4",
            Self::Nystrom6 => "nystrom6",
        }
    }

    /// Forces a step of equal steps.
    pub fn stages(self) -> Option<usize> {
        self.scheme().map(|s| s.stages())
    }

    /// The splitting scheme, if it is one.
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

impl Accuracy {
    /// The stricter of two.
    #[must_use]
    pub fn min(self, other: Self) -> Self {
        Self(self.0.min(other.0))
    }
}

/// Tolerance of Tsit5's error norm of a step; a state's error may be `absolute` + `relative` · its size (mm, rad, per second).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tolerance {
    /// Part of the state.
    pub relative: f64,
    /// Where the state is small.
    pub absolute: f64,
}

impl Tolerance {
    /// The least that a pilot asks for: below it rounding decides.
    pub(super) const LEAST: f64 = 1e-13;
    /// By an accuracy of the signals, before a pilot has found better.
    const BY_ACCURACY: f64 = 1e-3;

    /// The same number for both.
    pub const fn both(tolerance: f64) -> Self {
        Self { relative: tolerance, absolute: tolerance }
    }

    /// The same steps for a motion `by` times as large, where it is linear.
    #[must_use]
    pub fn of_motion(self, by: f64) -> Self {
        Self { absolute: by * self.absolute, ..self }
    }
}

impl From<Accuracy> for Tolerance {
    fn from(Accuracy(asked): Accuracy) -> Self {
        Self::both((Self::BY_ACCURACY * asked).max(Self::LEAST))
    }
}

/// What lanes hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Precision {
    /// f32: twice as many lanes, for steps so coarse that rounding hardly shows.
    Single,
    /// f64.
    Double,
}

/// How to integrate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solver {
    /// The integrator.
    pub method: Method,
    /// Asked of the signals; of equal steps that a pilot has found, the accuracy for which the method's law gives them.
    pub accuracy: Accuracy,
    /// Tsit5's, where a pilot has found it.
    pub tolerance: Option<Tolerance>,
    /// Forces are f32 in bodies whose highest frequency (rad/s) is no more: where a pilot has found that rounding keeps the error
    /// asked; else 0.
    pub single: f64,
}

impl Solver {
    /// By what is asked of the signals.
    pub const fn new(method: Method, accuracy: Accuracy) -> Self {
        Self { method, accuracy, tolerance: None, single: 0.0 }
    }

    /// Tsit5 by its own error norm.
    pub const fn tsit5(tolerance: Tolerance) -> Self {
        let accuracy = Accuracy(tolerance.relative / Tolerance::BY_ACCURACY);
        Self { tolerance: Some(tolerance), ..Self::new(Method::Tsit5, accuracy) }
    }

    /// The same by steps that no other body changes, for differences.
    #[must_use]
    pub fn in_equal_steps(self) -> Self {
        let method = if self.method == Method::Tsit5 { Method::Auto } else { self.method };
        Self { method, ..self }
    }

    /// The same, of at most this error of the signals, in f64: what a pilot has found of f32 was found for other steps.
    #[must_use]
    pub fn at_most(self, error: Accuracy) -> Self {
        let stricter = (error.0 / self.accuracy.0).min(1.0);
        let tolerance = self.tolerance.map(|t| Tolerance {
            relative: (stricter * t.relative).max(Tolerance::LEAST),
            absolute: (stricter * t.absolute).max(Tolerance::LEAST),
        });
        Self { accuracy: self.accuracy.min(error), tolerance, single: 0.0, ..self }
    }
}

/// Steps of a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Steps {
    /// Tsit5's, by error control.
    Adaptive(Tolerance),
    /// So many an interval. A sample that fails with them is tried again with more.
    Equal(usize),
}

impl Steps {
    /// Equal ones an interval; 0 of adaptive ones.
    pub fn count(self) -> usize {
        match self {
            Self::Adaptive(_) => 0,
            Self::Equal(steps) => steps,
        }
    }

    /// So many times as many, where they are equal.
    pub(super) fn times(self, by: usize) -> Self {
        match self {
            Self::Adaptive(_) => self,
            Self::Equal(steps) => Self::Equal(by * steps),
        }
    }
}

/// What `choose` made of a solver for one scene, and why.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Never `Auto`.
    pub method: Method,
    /// Adaptive of Tsit5, equal of the others.
    pub steps: Steps,
    /// Single of equal steps alone.
    pub precision: Precision,
    /// Why, in words.
    pub reason: String,
}

impl Plan {
    /// Tsit5 with this tolerance.
    pub fn tsit5(tolerance: Tolerance) -> Self {
        let steps = Steps::Adaptive(tolerance);
        Self { method: Method::Tsit5, steps, precision: Precision::Double, reason: String::new() }
    }

    /// A method of so many equal steps an interval, in f64.
    pub fn equal(method: Method, steps: usize) -> Self {
        let steps = Steps::Equal(steps);
        Self { method, steps, precision: Precision::Double, reason: String::new() }
    }

    /// The same in f64 whatever its steps are, for runs whose differences count.
    #[must_use]
    pub fn double(self) -> Self {
        Self { precision: Precision::Double, ..self }
    }
}
