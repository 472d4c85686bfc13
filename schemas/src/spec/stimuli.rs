//! The force histories.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Kind of force histories.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum StimuliKind {
    /// Smooth bell pulses on every panel.
    Bell,
    /// Rough, skewed, at times double blows of a hand-held hammer; each sample strikes one panel.
    Irregular,
    /// Histories read from files, see `stimuli.recorded`.
    Recorded,
}

/// The force histories. Intervals are `[least, most]` of a uniform draw per sample and panel; what is left out gets the
/// default of its kind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Stimuli {
    /// What kind of histories.
    pub kind: StimuliKind,
    /// N: samples that train and test the brain.
    #[serde(default = "stimuli_samples")]
    pub samples: usize,
    /// How many of the N are the test set.
    #[serde(default = "stimuli_test")]
    pub test: usize,
    /// Further samples that neither loop ever sees.
    #[serde(default = "stimuli_holdout")]
    pub holdout: usize,
    /// Amplitude A (N). By default `[0.15, 0.5]`, irregular `[0.3, 1.0]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub amplitude: Option<[f64; 2]>,
    /// Width W (s). By default `[0.06, 0.25]`, irregular `[0.02, 0.08]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub width: Option<[f64; 2]>,
    /// Onset O (s). By default `[0.0, 0.5]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub onset: Option<[f64; 2]>,
    /// Peak position p, as a part of the width. By default `[0.35, 0.65]`, irregular `[0.2, 0.45]`: a steep rise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub peak: Option<[f64; 2]>,
    /// Power q. By default `[1.5, 4.0]`, irregular `[1.0, 2.0]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub power: Option<[f64; 2]>,
    /// RMS of the rough part of a blow relative to its smooth one; irregular alone. By default `[0.1, 0.35]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roughness: Option<[f64; 2]>,
    /// Probability that the hammer hits twice; irregular alone. By default 0.25.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub double: Option<f64>,
    /// Time from the end of the first hit to the second (s); irregular alone. By default `[0.01, 0.05]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gap: Option<[f64; 2]>,
    /// Amplitude of the second hit relative to the first; irregular alone. By default `[0.2, 0.7]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rebound: Option<[f64; 2]>,
    /// Instants of the forces' own clock over the sample's length, a multiple of `time.samples`. By default the same.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_samples: Option<usize>,
    /// Where recorded histories come from; recorded alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recorded: Option<Recorded>,
}

impl Stimuli {
    /// With the defaults of the kind in place.
    #[must_use]
    pub fn resolved(mut self) -> Self {
        let [amplitude, width, onset, peak, power] = match self.kind {
            StimuliKind::Bell => [[0.15, 0.5], [0.06, 0.25], [0.0, 0.5], [0.35, 0.65], [1.5, 4.0]],
            StimuliKind::Irregular => [[0.3, 1.0], [0.02, 0.08], [0.0, 0.5], [0.2, 0.45], [1.0, 2.0]],
            StimuliKind::Recorded => return self,
        };
        self.amplitude.get_or_insert(amplitude);
        self.width.get_or_insert(width);
        self.onset.get_or_insert(onset);
        self.peak.get_or_insert(peak);
        self.power.get_or_insert(power);
        if self.kind == StimuliKind::Irregular {
            self.roughness.get_or_insert([0.1, 0.35]);
            self.double.get_or_insert(0.25);
            self.gap.get_or_insert([0.01, 0.05]);
            self.rebound.get_or_insert([0.2, 0.7]);
        }
        self
    }
}

fn stimuli_samples() -> usize {
    300
}
fn stimuli_test() -> usize {
    30
}
fn stimuli_holdout() -> usize {
    60
}

/// A signal of a file: a column of a CSV or an array of an NPZ by name, a row or column by number, from 0.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Signal {
    /// By number.
    Number(usize),
    /// By name.
    Name(String),
}

/// Unit of a file's clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
pub enum TimeUnit {
    /// Seconds.
    #[default]
    #[serde(rename = "s")]
    Second,
    /// Milliseconds.
    #[serde(rename = "ms")]
    Millisecond,
    /// Microseconds.
    #[serde(rename = "us")]
    Microsecond,
}

impl TimeUnit {
    /// In seconds.
    #[must_use]
    pub fn seconds(self) -> f64 {
        match self {
            Self::Second => 1.0,
            Self::Millisecond => 1e-3,
            Self::Microsecond => 1e-6,
        }
    }
}

/// Unit of a file's forces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
pub enum ForceUnit {
    /// Newtons.
    #[default]
    #[serde(rename = "N")]
    Newton,
    /// Millinewtons.
    #[serde(rename = "mN")]
    Millinewton,
    /// Kilonewtons.
    #[serde(rename = "kN")]
    Kilonewton,
}

impl ForceUnit {
    /// In newtons.
    #[must_use]
    pub fn newtons(self) -> f64 {
        match self {
            Self::Newton => 1.0,
            Self::Millinewton => 1e-3,
            Self::Kilonewton => 1e3,
        }
    }
}

/// How a record is read onto another clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Resample {
    /// Without what the new clock cannot say.
    #[default]
    Antialias,
    /// Linear between its entries.
    Linear,
}

/// Where in a record a blow begins.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Trigger {
    /// The first entry whose force reaches this, either way (N).
    pub threshold: f64,
    /// When it comes in the sample (s).
    #[serde(default)]
    pub before: f64,
}

/// How a recorded sample is varied where protocol `"joint"` draws fresh ones from the training set.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Augment {
    /// Interval of a factor on the force.
    pub scale: [f64; 2],
    /// Interval of a shift in time (s).
    pub shift: [f64; 2],
}

impl Default for Augment {
    fn default() -> Self {
        Self { scale: [0.8, 1.25], shift: [-0.02, 0.02] }
    }
}

/// Recorded histories: files, what stands where in them, in which unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Recorded {
    /// CSV, NPY or NPZ files, from the spec's folder.
    pub files: Vec<PathBuf>,
    /// The clock in a file; or give `rate`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<Signal>,
    /// Entries a second, where a file has no clock; its first entry is at 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rate: Option<f64>,
    /// The force, or one a panel. Left out: all that an array of (samples, panels, entries) holds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force: Option<Vec<Signal>>,
    /// Unit of the clock.
    #[serde(default)]
    pub time_unit: TimeUnit,
    /// Unit of the force.
    #[serde(default)]
    pub force_unit: ForceUnit,
    /// Factor on all forces, to suit a blow to a body.
    #[serde(default = "one")]
    pub scale: f64,
    /// Whether each record's median is taken off it: the sensor's offset.
    #[serde(default)]
    pub remove_offset: bool,
    /// Which panel, from 0, each record strikes, where it holds one force. Left out: drawn.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub panels: Option<Vec<usize>>,
    /// How records are read onto the clock of forces and targets.
    #[serde(default)]
    pub resample: Resample,
    /// Aligns the blows. Left out: the file's clock holds, 0 is the sample's beginning.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trigger: Option<Trigger>,
    /// How fresh samples are drawn.
    #[serde(default)]
    pub augment: Augment,
    /// BLAKE3 of the files' contents: by it, not by their paths, a trial is named. Filled in where left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub digest: Option<String>,
}

fn one() -> f64 {
    1.0
}
