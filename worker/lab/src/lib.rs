//! Questions about one body or about measured records, asked outside of trials: modes, bounds, capacities, placements, simulations,
//! replays of finished trials, fits and checks of records, comparisons with reference cases, estimates of computing time.
//!
//! No trial uses this package, so it cannot change the results of a trial. `questions` contains the algorithms, which use neither
//! files nor clocks; the other modules convert specs and files, and call the algorithms.

pub mod bound;
pub mod capacity;
pub mod casts;
pub mod check;
pub mod cost;
pub mod demands;
pub mod evaluate;
pub mod identify;
pub mod inverse;
pub mod measured;
pub mod modes;
pub mod operator;
pub mod place;
pub mod prepare;
mod questions;
pub mod replay;
pub mod simulate;
pub mod tasks;
pub mod twin;
pub mod verify;

#[cfg(test)]
#[path = "../../numerics/src/nested/tests/small.rs"]
mod small;
