//! Where and how the body is read.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The frame in which accelerations are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Frame {
    /// Fixed axes.
    #[default]
    World,
    /// Turning with the unit, as a glued chip reads.
    Body,
}

/// Size of what a chip adds to its signals: standard deviations.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Disturbance {
    /// Relative to the RMS of each channel over the initial body's training signals.
    Relative(f64),
    /// Of accelerations (mm/s²) and of angular velocities (rad/s).
    Physical([f64; 2]),
}

/// How the units that carry sensors are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Search {
    /// Seeded shuffles.
    Random,
    /// What a linear brain reads the initial body's training samples from best: greedily, then by exchange.
    Greedy,
    /// The same by what signals say of forces, were both Gaussian (Bayesian D-optimality).
    #[serde(rename = "d_optimal")]
    DOptimal,
    /// Pivots of the signals' covariance (PySensors' SSPOR), forces unseen.
    Pivots,
}

/// Units among which a search looks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum From {
    /// Neither at the boundary nor held, as seeded placements.
    Interior,
    /// Not held.
    Free,
}

/// Where and how the body is read.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Sensors {
    /// World or body frame.
    pub frame: Frame,
    /// Lists of units instead of `sweep.placements`; a trial with M sensors takes every list of M units.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub placements: Option<Vec<Vec<usize>>>,
    /// How `sweep.placements` placements are found; by default at random. Of a search the first is the best, the n-th
    /// the best that holds the n-th best single unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub search: Option<Search>,
    /// Where a search looks; by default in the interior.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub from: Option<From>,
    /// Least distance (mm) of the cells of two sensors that a search places; by default none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spacing: Option<f64>,
    /// White noise of every reading; by default none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise: Option<Disturbance>,
    /// A constant added to every reading of a sample and channel, drawn anew a sample; by default none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bias: Option<Disturbance>,
    /// How late the signals come (s); by default not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub delay: Option<f64>,
}
