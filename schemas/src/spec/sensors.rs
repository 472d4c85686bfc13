//! Positions and properties of the sensors (`[sensors]`).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;

use super::body::Design;

/// Axes of the measured accelerations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Frame {
    /// Fixed axes.
    #[default]
    World,
    /// Axes that rotate with the unit, as for a chip glued to it.
    Body,
}

/// A signal of a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Channel {
    /// Acceleration along x.
    Ax,
    /// Acceleration along y.
    Ay,
    /// Angular velocity.
    Omega,
}

impl Channel {
    /// All channels, in the order of the signals.
    pub const ALL: [Self; 3] = [Self::Ax, Self::Ay, Self::Omega];

    /// Its name in a spec.
    pub fn name(self) -> &'static str {
        ["ax", "ay", "omega"][self as usize]
    }

    /// Its symbol in MODEL.md.
    pub fn symbol(self) -> &'static str {
        ["a_x", "a_y", "ω"][self as usize]
    }
}

/// Standard deviation of a chip's noise or bias.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Disturbance {
    /// a number: relative to the RMS of each channel on the initial body, or on the body of `relative_to`.
    Relative(f64),
    /// two numbers: for accelerations (mm/s²) and angular velocities (rad/s).
    Physical([f64; 2]),
}

/// A commercial chip.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Part {
    /// The paper's chip: 9 g, 23.5 × 32.5 mm, ±16 g in steps of 0.5 mg, ±2 000 °/s in steps of 0.061 °/s (WitMotion's data sheet
    /// of the WT9011DCL-BT5.0, which does not state the noise).
    #[serde(rename = "WT9011DCL")]
    Wt9011dcl,
}

/// How the units with sensors are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Search {
    /// At random, by seed.
    Random,
    /// The units from which a linear decoder estimates the forces on the initial body best, found greedily, then by exchange.
    Greedy,
}

/// Candidate units of a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum From {
    /// Units that are neither at the boundary nor clamped, as for random placements.
    Interior,
    /// Units that are not clamped.
    Free,
}

/// Positions of the sensors, and properties of real sensors.
#[skip_serializing_none]
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Sensors {
    /// Axes of the accelerations.
    pub frame: Frame,
    /// Signals that each sensor measures. Default: `["ax", "ay", "omega"]`.
    pub channels: Option<Vec<Channel>>,
    /// Placements as lists of units, instead of `sweep.placements`. Trials with M sensors use the lists with M units. Default:
    /// none.
    pub placements: Option<Vec<Vec<usize>>>,
    /// How the `sweep.placements` placements are chosen. In a search, placement 0 is the best, placement 1 the best that contains
    /// the second-best single unit, and so on. Default: `"random"`.
    pub search: Option<Search>,
    /// Candidate units of a search. Default: `"interior"`.
    pub from: Option<From>,
    /// Smallest distance between two sensors that a search places. Unit: mm. Default: none.
    pub spacing: Option<f64>,
    /// Standard deviation of the white noise of every reading. Default: none.
    pub noise: Option<Disturbance>,
    /// Standard deviation of the offset of every channel, constant during a sample and drawn per sample. Default: none.
    pub bias: Option<Disturbance>,
    /// The body to whose signals a scalar `noise` or `bias` is relative, in the form of `body.design`. Default: the body that the
    /// trial starts from.
    pub relative_to: Option<Design>,
    /// Delay of the signals. Unit: s. Default: 0.
    pub delay: Option<f64>,
    /// Cut-off frequency of the chip's low-pass (Butterworth, order 2). Unit: Hz. Default: none.
    pub bandwidth: Option<f64>,
    /// Largest absolute readings of accelerations and angular velocities; larger values are clipped. Unit: mm/s², rad/s. Default:
    /// none.
    pub range: Option<[f64; 2]>,
    /// Resolution of accelerations and angular velocities. Unit: mm/s², rad/s. Default: none.
    pub resolution: Option<[f64; 2]>,
    /// A commercial chip: sets mass, inertia, range and resolution if these keys are omitted. Default: none.
    pub chip: Option<Part>,
    /// Mass of each chip, on the centroid of its unit. Candidates of `sensors.search` carry no chip. Unit: Mg. Default: 0.
    pub mass: Option<f64>,
    /// Moment of inertia of each chip about the centroid. Unit: Mg mm². Default: 0.
    pub inertia: Option<f64>,
    /// Position of each chip on its unit: `[x, y]` from the centroid, in the unit's frame. Cannot be combined with `mass` or
    /// `inertia`, which act at the centroid. Unit: mm. Default: `[0, 0]`.
    pub offset: Option<[f64; 2]>,
    /// In-plane angle of each chip's axes relative to those of `frame`. Unit: degrees. Default: 0.
    pub tilt: Option<f64>,
}

/// Standard gravity (mm/s²).
const GRAVITY: f64 = 9806.65;
/// A degree (rad).
const DEGREE: f64 = std::f64::consts::PI / 180.0;

impl Sensors {
    /// Signals that each sensor measures.
    pub fn read(&self) -> &[Channel] {
        self.channels.as_deref().unwrap_or(&Channel::ALL)
    }

    /// Replaces the chip's name by its data and sorts the channels; `channels` becomes `None` if it lists all.
    pub fn resolved(mut self) -> Self {
        if let Some(Part::Wt9011dcl) = self.chip.take() {
            let (mass, [width, height]) = (9e-6, [23.5, 32.5]);
            self.mass.get_or_insert(mass);
            self.inertia.get_or_insert(mass * (width * width + height * height) / 12.0);
            self.range.get_or_insert([16.0 * GRAVITY, 2000.0 * DEGREE]);
            self.resolution.get_or_insert([16.0 * GRAVITY / 32768.0, 2000.0 * DEGREE / 32768.0]);
        }
        self.channels.iter_mut().for_each(|channels| channels.sort_unstable());
        self.channels = self.channels.filter(|channels| *channels != Channel::ALL);
        self
    }

    /// Whether noise or bias are relative to the signals of a body.
    pub fn is_relative(&self) -> bool {
        let relative = |size: &Disturbance| matches!(size, Disturbance::Relative(part) if *part > 0.0);
        [&self.noise, &self.bias].into_iter().flatten().any(relative)
    }
}
