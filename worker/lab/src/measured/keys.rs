//! The keys of a file of measured records: forces, and the sensor signals that they caused.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;

use metasense_schemas::spec::{Decimal, Recorded, Separator, Signal, TimeUnit};

/// Forces, as in a spec, and signals.
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
#[skip_serializing_none]
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MeasuredSignals {
    /// Signal files, one per entry of `recorded.files`. Default: the same files.
    pub files: Option<Vec<PathBuf>>,
    /// Columns or arrays: a_x, a_y, ω of each sensor in turn (only the channels in `sensors.channels`), 3M in total; or one array
    /// of shape (samples, entries, 3M) or (samples, 3M, entries). A single record has no dimension of samples. Default: all
    /// channels of an NPY file.
    pub channels: Option<Vec<Signal>>,
    /// Clock of the signals, as a column or array. Default: `rate`; without either, the clock of the forces.
    pub time: Option<Signal>,
    /// Entries per second. Unit: 1/s. Default: `time`.
    pub rate: Option<f64>,
    /// As `recorded.header`, for `files`. Default: yes.
    pub header: Option<bool>,
    /// As `recorded.separator`, for `files`. Default: the one that gives all lines equally many
    /// fields.
    pub separator: Option<Separator>,
    /// As `recorded.decimal`, for `files`. Default: the mark in the file's numbers.
    pub decimal: Option<Decimal>,
    /// Unit of `time`. Default: `recorded.time_unit`.
    pub time_unit: Option<TimeUnit>,
    /// Time on the forces' clock at which the signals' clock is 0. Unit: s. Default: 0.
    pub start: Option<SignalStart>,
    /// Standard deviation of the unknown error of each record's `start`. `lab identify` fits these errors, up to three
    /// deviations. Unit: s. Default: 0.
    pub start_deviation: Option<f64>,
    /// Unit of accelerations.
    pub acceleration_unit: AccelerationUnit,
    /// Unit of angular velocities.
    pub angular_velocity_unit: AngularVelocityUnit,
    /// Factor per channel; −1 for an axis that points the other way. Unit: 1. Default: 1.
    pub factors: Option<Vec<f64>>,
}

/// Time on the forces' clock at which the signals' clock is 0 (s).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum SignalStart {
    /// a number, for all records.
    All(f64),
    /// a list, one per record in the order of the files.
    Each(Vec<f64>),
}

impl SignalStart {
    /// Returns the time of one record.
    pub fn time_of(&self, record: usize) -> f64 {
        match self {
            Self::All(start) => *start,
            Self::Each(starts) => starts.get(record).copied().unwrap_or(0.0),
        }
    }
}

/// Unit of measured accelerations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
pub enum AccelerationUnit {
    /// Millimetres per second squared.
    #[default]
    #[serde(rename = "mm/s2")]
    Millimetre,
    /// Metres per second squared.
    #[serde(rename = "m/s2")]
    Metre,
    /// Standard gravity, 9806.65 mm/s².
    #[serde(rename = "g")]
    Gravity,
}

impl AccelerationUnit {
    /// The unit in mm/s².
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
    /// Radians per second.
    #[default]
    #[serde(rename = "rad/s")]
    Radian,
    /// Degrees per second.
    #[serde(rename = "deg/s")]
    Degree,
}

impl AngularVelocityUnit {
    /// The unit in rad/s.
    pub fn factor(self) -> f64 {
        match self {
            Self::Radian => 1.0,
            Self::Degree => std::f64::consts::PI / 180.0,
        }
    }
}
