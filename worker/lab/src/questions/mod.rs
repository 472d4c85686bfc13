//! Algorithms of the questions: small motions, information of the sensors, replays, capacities, checks of records.

mod bound;
pub mod capacity;
mod chain;
pub mod check;
pub mod modes;
mod operator;
mod replay;

pub use bound::{Bound, bound};
pub use operator::{OperatorFigures, compute_figures};
pub use replay::{LinearReplay, Motion, Replay, motion, replay, sense};

#[cfg(test)]
mod tests;
