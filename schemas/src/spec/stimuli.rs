//! The force histories.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;

/// Kind of force histories.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum StimuliKind {
    /// Smooth pulses, one on every panel.
    Bell,
    /// Gaussian pulses, one on every panel: `width` is σ, `onset` the time of the peak.
    Gauss,
    /// Blows of a hand-held hammer on one panel per sample: rough, skewed and sometimes double.
    Irregular,
    /// Force histories from files, see `stimuli.recorded`.
    Recorded,
    /// A mixture: each sample has one of the kinds of `stimuli.mix`, drawn by weight.
    Mix,
}

impl StimuliKind {
    /// Name in a spec.
    pub fn name(self) -> &'static str {
        ["bell", "gauss", "irregular", "recorded", "mix"][self as usize]
    }
}

/// A kind of forces in `stimuli.mix` or `evaluation.under`, with the keys of that kind as in `[stimuli]`; `"recorded"` uses
/// `stimuli.recorded`.
#[skip_serializing_none]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Part {
    /// Probability of this kind in a mixture; the probabilities of all parts sum to 1. Unit: 1. Default: must be given.
    pub weight: Option<f64>,
    /// Kind of forces: `"bell"`, `"gauss"`, `"irregular"` or `"recorded"`.
    pub kind: StimuliKind,
    /// As `stimuli.amplitude`.
    pub amplitude: Option<[f64; 2]>,
    /// As `stimuli.width`.
    pub width: Option<[f64; 2]>,
    /// As `stimuli.onset`.
    pub onset: Option<[f64; 2]>,
    /// As `stimuli.peak`.
    pub peak: Option<[f64; 2]>,
    /// As `stimuli.power`.
    pub power: Option<[f64; 2]>,
    /// As `stimuli.roughness`.
    pub roughness: Option<[f64; 2]>,
    /// As `stimuli.double`.
    pub double: Option<f64>,
    /// As `stimuli.gap`.
    pub gap: Option<[f64; 2]>,
    /// As `stimuli.rebound`.
    pub rebound: Option<[f64; 2]>,
    /// As `stimuli.silent`.
    pub silent: Option<f64>,
    /// As `stimuli.anywhere`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub anywhere: bool,
    /// As `stimuli.offset`.
    pub offset: Option<f64>,
    /// As `stimuli.angle`.
    pub angle: Option<f64>,
}

impl Part {
    /// Returns stimuli of this kind alone, with the samples and records of `whole`.
    pub fn alone(&self, whole: &Stimuli) -> Stimuli {
        let Self { kind, amplitude, width, onset, peak, power, offset, angle, .. } = *self;
        let Self { roughness, double, gap, rebound, silent, anywhere, .. } = *self;
        let recorded = whole.recorded.clone().filter(|_| kind == StimuliKind::Recorded);
        let pulse = Stimuli { amplitude, width, onset, peak, power, offset, angle, ..whole.clone() };
        Stimuli { kind, mix: None, recorded, roughness, double, gap, rebound, silent, anywhere, ..pulse }
    }

    /// Fills in the defaults of the kind.
    pub fn resolved(&self, whole: &Stimuli) -> Self {
        let own = self.alone(whole).resolved();
        let Stimuli { amplitude, width, onset, peak, power, offset, angle, .. } = own;
        let Stimuli { roughness, double, gap, rebound, silent, .. } = own;
        let Self { weight, kind, .. } = *self;
        let pulse = Self { weight, kind, amplitude, width, onset, peak, power, offset, angle, ..*self };
        Self { roughness, double, gap, rebound, silent, ..pulse }
    }
}

/// The force histories. Intervals `[least, most]` are those of a uniform draw per sample and panel. Omitted keys have the
/// default of the kind.
#[skip_serializing_none]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Stimuli {
    /// Kind of forces.
    pub kind: StimuliKind,
    /// Samples of training and test set (N), at most 1 000 000.
    #[serde(default = "super::number::<470>")]
    pub samples: usize,
    /// Number of the N samples that form the test set, which selects the trained body. With 30 samples, the selected body is more
    /// than 5 % worse than the best in a quarter of trials; with 200, in one of fifty.
    #[serde(default = "super::number::<200>")]
    pub test: usize,
    /// Whether the test set is drawn with replacement. It may then contain a sample twice; the training set contains all others.
    /// Default: false.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub replacement: bool,
    /// Held-out samples, at most 1 000 000; they give the errors to quote.
    #[serde(default = "super::number::<300>")]
    pub holdout: usize,
    /// Amplitude of a pulse: an interval `[least, most]` of a uniform draw per sample and panel; negative forces act against the
    /// panel's direction. Unit: N. Default: `[0.15, 0.5]`;
    /// gauss `[0.1, 0.5]`; irregular `[0.3, 1.0]`.
    pub amplitude: Option<[f64; 2]>,
    /// Width of a pulse, an interval; σ of a Gaussian pulse. Unit: s. Default: `[0.06, 0.25]`; gauss `[0.01, 0.04]`; irregular
    /// `[0.02, 0.08]`.
    pub width: Option<[f64; 2]>,
    /// Onset of a pulse, an interval; time of the peak of a Gaussian pulse. Unit: s. Default: `[0.0, 0.5]`; gauss `[0.12, 0.4]`.
    pub onset: Option<[f64; 2]>,
    /// Position of the peak as a fraction of the width, an interval. Unit: 1. Default: `[0.35, 0.65]`; irregular
    /// `[0.2, 0.45]`.
    pub peak: Option<[f64; 2]>,
    /// Sharpness of a pulse (a power of its sine), an interval. Unit: 1. Default: `[1.5, 4.0]`; irregular `[1.0, 2.0]`.
    pub power: Option<[f64; 2]>,
    /// RMS of the rough part of a blow relative to its smooth part, an interval; irregular only. Unit: 1. Default:
    /// `[0.1, 0.35]`.
    pub roughness: Option<[f64; 2]>,
    /// Probability that the hammer hits twice; irregular only. Unit: 1. Default: 0.25.
    pub double: Option<f64>,
    /// Time from the end of the first hit to the second, an interval; irregular only. Unit: s. Default: `[0.01, 0.05]`.
    pub gap: Option<[f64; 2]>,
    /// Amplitude of the second hit relative to the first, an interval; irregular only. Unit: 1. Default: `[0.2, 0.7]`.
    pub rebound: Option<[f64; 2]>,
    /// Probability that a panel has no force in a sample; samples without any force are redrawn. Bell and gauss only. Unit: 1.
    /// Default: 0.
    pub silent: Option<f64>,
    /// Whether each sample has a single blow, at a random point of the line through the panels in their order: between a random
    /// pair of neighbours, uniform from one to the other. Its force is divided between the two in inverse proportion to the
    /// distances. Not for recorded forces, and without `silent`, `offset` and `angle`. Default: false.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub anywhere: bool,
    /// Standard deviation of the distance by which blows miss a panel's centroid, across its direction; a normal draw per sample
    /// and panel. Such a blow rotates the unit. Unit: mm. Default: 0.
    pub offset: Option<f64>,
    /// Standard deviation of the angle by which blows deviate from a panel's direction. Unit: degrees. Default: 0.
    pub angle: Option<f64>,
    /// Instants per sample of the clock of the forces, a multiple of `time.samples`. Default: `time.samples`.
    pub force_samples: Option<usize>,
    /// Files of force histories, for `kind = "recorded"`. Default: none.
    pub recorded: Option<Recorded>,
    /// Parts of the mixture, for `kind = "mix"`: tables `[[stimuli.mix]]` of `weight`, `kind` and keys of that kind. Default:
    /// none.
    pub mix: Option<Vec<Part>>,
}

impl Stimuli {
    /// Fills in the defaults of the kind.
    pub fn resolved(mut self) -> Self {
        let some = |deviation: &f64| *deviation != 0.0;
        (self.offset, self.angle) = (self.offset.filter(some), self.angle.filter(some));
        self.silent = self.silent.filter(|probability| *probability != 0.0);
        if self.kind == StimuliKind::Gauss {
            self.amplitude.get_or_insert([0.1, 0.5]);
            self.width.get_or_insert([0.01, 0.04]);
            self.onset.get_or_insert([0.12, 0.4]);
            return self;
        }
        let [amplitude, width, onset, peak, power] = match self.kind {
            StimuliKind::Bell => [[0.15, 0.5], [0.06, 0.25], [0.0, 0.5], [0.35, 0.65], [1.5, 4.0]],
            StimuliKind::Irregular => [[0.3, 1.0], [0.02, 0.08], [0.0, 0.5], [0.2, 0.45], [1.0, 2.0]],
            StimuliKind::Gauss | StimuliKind::Recorded => return self,
            StimuliKind::Mix => {
                let whole = self.clone();
                for part in self.mix.iter_mut().flatten().filter(|part| part.kind != StimuliKind::Mix) {
                    *part = part.resolved(&whole);
                }
                return self;
            }
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

/// A signal of a file: a column of a CSV or an array of an NPZ by name, a row or column by number, from 0.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Signal {
    /// the number of a column or row, from 0.
    Number(usize),
    /// the name of a column or array.
    Name(String),
}

/// Separator of the fields of a CSV.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Separator {
    /// Commas.
    #[serde(rename = ",")]
    Comma,
    /// Semicolons.
    #[serde(rename = ";")]
    Semicolon,
    /// Tabs.
    #[serde(rename = "tab", alias = "\t")]
    Tab,
}

/// The decimal mark of a CSV.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Decimal {
    /// A point.
    #[serde(rename = ".")]
    Point,
    /// A comma.
    #[serde(rename = ",")]
    Comma,
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

/// How a record is resampled to another clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Resample {
    /// Low-pass filter at half the lower rate, then interpolation.
    #[default]
    Antialias,
    /// Linear interpolation between entries.
    Linear,
}

/// Detection of the beginning of a blow in a record.
#[skip_serializing_none]
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Trigger {
    /// Absolute force, after `scale`, that marks the beginning of a blow where it is first reached. Unit: N.
    pub threshold: f64,
    /// Time of the beginning of the blow in the sample. Unit: s. Default: enough for the earliest `augment.shift` and for 12
    /// instants of `time.samples`, the reach of the low-pass; 0 for measured signals.
    pub before: Option<f64>,
}

/// Variation of recorded training samples, from which protocol `"joint"` draws fresh samples.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Augment {
    /// Factor on the force, an interval. Unit: 1.
    pub scale: [f64; 2],
    /// Shift in time, an interval. Unit: s.
    pub shift: [f64; 2],
}

impl Default for Augment {
    fn default() -> Self {
        Self { scale: [0.8, 1.25], shift: [-0.02, 0.02] }
    }
}

/// Recorded histories: files, their contents and units.
#[skip_serializing_none]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Recorded {
    /// CSV, NPY or NPZ files, relative to the spec. A record may not occur twice.
    pub files: Vec<PathBuf>,
    /// Clock of a file, as a column or array. Default: `rate` must be given.
    pub time: Option<Signal>,
    /// Entries per second, if a file has no clock; its first entry is at 0. Unit: 1/s. Default: `time` must be given.
    pub rate: Option<f64>,
    /// The force, or one force per panel, as columns or arrays. Default: all that an array of shape (samples, panels, entries)
    /// holds.
    pub force: Option<Vec<Signal>>,
    /// Whether the first line of a CSV names its columns. Must be given if that line contains numbers. Default: yes.
    pub header: Option<bool>,
    /// What separates the fields of a CSV. Default: the one that gives all lines equally many fields.
    pub separator: Option<Separator>,
    /// The decimal mark of a CSV. Default: the mark in the file's numbers.
    pub decimal: Option<Decimal>,
    /// Unit of the clock.
    #[serde(default)]
    pub time_unit: TimeUnit,
    /// Unit of the force.
    #[serde(default)]
    pub force_unit: ForceUnit,
    /// Factor on all forces, to adapt the blows to the body. Unit: 1.
    #[serde(default = "one")]
    pub scale: f64,
    /// Whether the median of each record (the offset of the force sensor) is subtracted.
    #[serde(default)]
    pub remove_offset: bool,
    /// Panel, counted from 0, of each record with one force. Default: drawn by seed.
    pub panels: Option<Vec<usize>>,
    /// How records are resampled to the clocks of the simulation and of the signals.
    #[serde(default)]
    pub resample: Resample,
    /// Aligns blows by the first force above a threshold. Default: none, the file's clock counts from the sample's beginning.
    pub trigger: Option<Trigger>,
    /// Variation of a record for fresh samples, for `optimise.protocol = "joint"`.
    #[serde(default)]
    pub augment: Augment,
    /// BLAKE3 hash of the contents of the files. It is part of the trial's hash, the paths are not. If given, it must agree.
    /// Default: filled in.
    pub digest: Option<String>,
}

fn one() -> f64 {
    1.0
}
