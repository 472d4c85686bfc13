//! Analyses of a body without training: information of its sensors, nonlinearity, motion under single samples.

mod bound;
mod chain;
mod nonlinear;
mod operator;
mod replay;
pub mod tasks;
mod under;

pub use bound::{Bound, bound};
pub use nonlinear::Nonlinear;
pub(crate) use nonlinear::nonlinear;
pub use operator::{OperatorFigures, compute_figures};
pub use replay::{LinearReplay, Motion, Replay, motion, replay, sense};
pub use under::UnderReading;
pub(crate) use under::under;
