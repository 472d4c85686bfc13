//! Numerical kernels that run for every sample of a trial: geometry of the body, integration of motion, adjoints,
//! decoders.
//!
//! This code is compiled once per instruction set, which takes most of the build time; therefore it is a separate crate.
//! It has no I/O, clock or environment, and random numbers depend only on the given seed. Physics and conventions:
//! `../numerics/MODEL.md`.

pub mod body;
pub mod brain;
pub mod dynamics;
mod lanes;
mod pool;
pub mod random;
pub mod simd;

pub use pool::{Heartbeat, Pool};
