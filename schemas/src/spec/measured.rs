//! Measured records: forces with the signals that sensors gave under them, in a file of their own.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Recorded, Signal};

/// What stands where: the forces as a spec has them, and the signals.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Measured {
    /// The forces, with the keys of `stimuli.recorded`.
    pub recorded: Recorded,
    /// The signals.
    #[serde(default)]
    pub signals: MeasuredSignals,
}

/// Where the signals of measured records come from.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MeasuredSignals {
    /// Files, one for each of the forces'. Left out: the same files.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub files: Option<Vec<PathBuf>>,
    /// a_x, a_y, ω of each sensor in turn, or one array that holds them all. Left out: all that an NPY holds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub channels: Option<Vec<Signal>>,
    /// Their clock, or give `rate`. Both left out: the forces' clock.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time: Option<Signal>,
    /// Entries a second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate: Option<f64>,
    /// When the signals' clock reads 0, on the forces' clock (s). By default 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start: Option<f64>,
    /// Unit of accelerations.
    pub acceleration_unit: AccelerationUnit,
    /// Unit of angular velocities.
    pub angular_velocity_unit: AngularVelocityUnit,
    /// A factor a channel, −1 where an axis points the other way. By default 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub factors: Option<Vec<f64>>,
}

/// Unit of measured accelerations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
pub enum AccelerationUnit {
    /// mm/s².
    #[default]
    #[serde(rename = "mm/s2")]
    Millimetre,
    /// m/s².
    #[serde(rename = "m/s2")]
    Metre,
    /// Standard gravity.
    #[serde(rename = "g")]
    Gravity,
}

impl AccelerationUnit {
    /// In mm/s².
    #[must_use]
    pub fn factor(self) -> f64 {
        match self {
            Self::Millimetre => 1.0,
            Self::Metre => 1e3,
            // ISO 80000-3
            Self::Gravity => 9806.65,
        }
    }
}

/// Unit of measured angular velocities.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
pub enum AngularVelocityUnit {
    /// rad/s.
    #[default]
    #[serde(rename = "rad/s")]
    Radian,
    /// Degrees a second.
    #[serde(rename = "deg/s")]
    Degree,
}

impl AngularVelocityUnit {
    /// In rad/s.
    #[must_use]
    pub fn factor(self) -> f64 {
        match self {
            Self::Radian => 1.0,
            Self::Degree => std::f64::consts::PI / 180.0,
        }
    }
}
