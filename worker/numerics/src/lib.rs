//! The numerics of metasense: stimuli, feasible designs, sensor search, modes, identification and nested optimisation, built on
//! the kernels.
//!
//! No I/O, clock or environment; random numbers depend only on seeds passed in. `MODEL.md` describes the physics and conventions.

pub mod brains;
pub mod check;
mod definite;
pub mod feasible;
pub mod identify;
pub mod material;
pub mod modes;
pub mod nested;
pub mod place;
pub mod questions;
pub mod stimuli;
pub mod student;
pub mod trial;
pub mod variation;

pub use metasense_kernels::{Heartbeat, Pool, body, brain, dynamics, random, simd};
