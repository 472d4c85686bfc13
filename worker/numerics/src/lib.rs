//! The maths of metasense: body, dynamics, stimuli, brain, feasible designs, nested optimisation.
//!
//! No I/O, no clock, no environment, no randomness but a seed passed in. Physics and conventions: `MODEL.md`.

pub mod body;
pub mod brain;
pub mod dynamics;
pub mod feasible;
pub mod identify;
mod lanes;
pub mod modes;
pub mod nested;
pub mod place;
pub mod pulse;
pub mod random;
pub mod simd;
pub mod stimuli;
pub mod student;
