//! Questions to finished trials, answered by pure functions. No file, clock or database.
//!
//! Errors are prediction errors in %, compared on a logarithmic scale: ratios are what carries over from one scene to
//! another, and a mean of logarithms is not ruled by the one worst trial. A *cluster* is a (placement, seed) pair: all
//! of a cluster's trials share sensors and stimuli, so that curves are compared within clusters; what is independent, and
//! with it every interval and vote, is in [`resample`], and whether intervals cover in its tests.

pub mod bodies;
pub mod brains;
pub mod casts;
pub mod claims;
pub mod compare;
pub mod data;
pub mod decision;
pub mod elbow;
pub mod goal;
pub mod kinds;
pub mod numbers;
pub mod operator;
pub mod paired;
pub mod placed;
pub mod predict;
pub mod random;
pub mod records;
pub mod resample;
pub mod run_time;
pub mod scaling;
pub mod sensors;
pub mod setting;
pub mod tables;
pub mod tasks;
pub mod transfer;
pub mod trial;
pub mod until;

#[cfg(test)]
mod tests;

pub use data::{Group, Observation};
pub use decision::Terms;
pub use elbow::{Elbow, Height, Verdict, elbow};
pub use resample::{Interval, Resampling};
pub use tables::Question;
pub use trial::{Body, Cluster, Set, Trial};
