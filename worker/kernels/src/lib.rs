//! What every sample of a trial goes through: the body, its motion and their derivatives, the brain's arithmetic.
//!
//! A crate of its own as it holds what is compiled once an instruction set, most of the work of a build. Pure: no I/O, no
//! clock, no environment, no randomness but a seed passed in. Physics and conventions: `../numerics/MODEL.md`.

pub mod body;
pub mod brain;
pub mod dynamics;
mod lanes;
mod pool;
pub mod random;
pub mod simd;

pub use pool::{Heartbeat, Pool};
