//! Questions about finished trials and the time of a run, answered by pure functions without files, clock or database.
//!
//! Errors are in % and are compared as logarithms, so that ratios carry over between scenes and no single trial dominates a
//! mean. A *cluster* is a pair (placement, seed). All trials of a cluster share sensors and forces; curves are compared within
//! clusters. [`resample`] computes all intervals and votes, and its tests check their coverage.

pub mod bodies;
pub mod brains;
pub mod capacity;
pub mod casts;
pub mod claims;
pub mod compare;
pub mod data;
pub mod decision;
pub mod elbow;
pub mod forecast;
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
pub mod view;

#[cfg(test)]
mod tests;

pub use data::{Group, Observation};
pub use decision::DecisionTerms;
pub use elbow::{Elbow, ErrorScale, Verdict, elbow};
pub use resample::{Interval, Resampling};
pub use tables::Question;
pub use trial::{BodyState, Cluster, Set, Trial};
