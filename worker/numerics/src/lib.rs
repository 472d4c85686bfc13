//! The numerics of metasense: stimuli, feasible designs, sensor search, identification and nested optimisation, built on the
//! kernels.
//!
//! No I/O, clock or environment; random numbers depend only on seeds passed in. `MODEL.md` describes the physics and conventions.

pub mod brains;
pub mod definite;
pub mod feasible;
pub mod identify;
pub mod material;
pub mod nested;
pub mod place;
pub mod stimuli;
pub mod student;
pub mod trial;
pub mod variation;

#[cfg(test)] // for files that the tests of other packages include, too
extern crate self as metasense_numerics;

pub use metasense_kernels::{Heartbeat, Pool, body, brain, dynamics, random, simd};
