//! The maths of metasense: stimuli, feasible designs, placement, modes, identification, nested optimisation, on the kernels.
//!
//! No I/O, no clock, no environment, no randomness but a seed passed in. Physics and conventions: `MODEL.md`.

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
