//! Recomputes a finished trial from its stored design and weights: geometry, signals, estimates, motion. Converts its decoder to
//! layers, also in integers for a device.

use metasense_numerics::body::moments;
use metasense_numerics::brains::fits;
pub use metasense_numerics::dynamics::{Panel, PrescribedMotion};
use metasense_numerics::feasible::{Active, FeasibleSet};
use metasense_numerics::nested::{DecoderForCasts, brain_for_casts};
use metasense_numerics::place::placed;
use metasense_numerics::trial::{Decoder, DecoderKind, Failure as OfMaths, PreparedTrial};
use metasense_schemas::spec::TrialSpec;
use metasense_worker::run::{NoResult, pool};

use crate::casts::NO_VARIATION;
use crate::prepare::{check_length, prepared, simulable, with_design};
use crate::questions;
pub use crate::questions::{LinearReplay, Motion, Replay};

mod integers;
mod layers;

pub use integers::{Integers, Rescaled};
pub use layers::{Convolution, SinglePrecision, holdout_error, layers};

/// Geometry for drawings of a body.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawing {
    /// Corners of every unit (mm), counter-clockwise.
    pub units: Vec<Vec<[f64; 2]>>,
    /// Area centroids (mm).
    pub centroids: Vec<[f64; 2]>,
    /// Ends of every ligament (mm).
    pub ligaments: Vec<[[f64; 2]; 2]>,
    /// The two nodes (unit, node) that each ligament joins.
    pub joints: Vec<[(usize, usize); 2]>,
    /// Panels, and the points where their forces act (mm).
    pub panels: Vec<(Panel, [f64; 2])>,
    /// Units with sensors.
    pub sensors: Vec<usize>,
    /// Clamped units.
    pub clamped: Vec<usize>,
    /// Guided units.
    pub guided: Vec<usize>,
    /// Active constraints.
    pub active: Vec<Active>,
    /// Grid spacing (mm).
    pub spacing: f64,
    /// Instants (s) of signals and motion.
    pub clock: Vec<f64>,
}

impl Drawing {
    /// Area of all units (mm²).
    pub fn area(&self) -> f64 {
        self.units.iter().map(|unit| moments(unit).area).sum()
    }
}

/// Geometry of a body.
///
/// # Errors
/// If the spec is invalid, or the design belongs to another body.
pub fn drawing(trial: &TrialSpec, design: &[f64]) -> Result<Drawing, NoResult> {
    let problem = with_design(trial, design)?;
    let scene = &problem.scene;
    let geometry = scene.geometry(design);
    let ligaments = scene.layout.ligaments.iter();
    let instants = 1..=scene.instants;
    let struck =
        |panel: &Panel| (*panel, panel.foot(geometry.centroids[panel.unit], &geometry.vertices[panel.unit]));
    Ok(Drawing {
        panels: scene.panels.iter().map(struck).collect(),
        ligaments: ligaments
            .map(|l| [geometry.vertices[l.a.unit][l.a.node], geometry.vertices[l.b.unit][l.b.node]])
            .collect(),
        joints: scene.layout.ligaments.iter().map(|l| [(l.a.unit, l.a.node), (l.b.unit, l.b.node)]).collect(),
        units: geometry.vertices,
        centroids: geometry.centroids,
        sensors: scene.sensors.clone(),
        clamped: scene.clamped.clone(),
        guided: scene.guided.iter().map(|guided| guided.0).collect(),
        // An initial body may violate a limit; such constraints are not active.
        active: FeasibleSet::new(&scene.layout, problem.limits, &[])
            .active(design)
            .into_iter()
            .filter(|a| a.slack >= 0.0)
            .collect(),
        spacing: scene.layout.spacing,
        clock: instants.map(|n| n as f64 * scene.duration / scene.instants as f64).collect(),
    })
}

/// Signals of a body under all samples of its trial, and the estimates of its decoder. Networks need `weights`. An inverse
/// decoder estimates the first `inverse` test samples and as many held-out samples.
///
/// # Errors
/// If the spec is invalid, lengths do not match it, or a simulation fails.
pub fn replay(
    trial: &TrialSpec,
    design: &[f64],
    weights: &[f32],
    inverse: usize,
    threads: usize,
) -> Result<Replay, NoResult> {
    let problem = simulable(trial, design)?;
    if !weights.is_empty() {
        check_length("network", weights.len(), problem.reader_shape().weights())?;
    }
    let pool = pool(threads)?;
    let (problem, _) = placed(&problem, &pool)?;
    let mut replay = questions::replay(&problem, design, weights, &pool)?;
    if problem.decoder_kind == DecoderKind::Inverse && inverse > 0 {
        replay.invert(&problem, design, inverse, &pool)?;
    }
    Ok(replay)
}

/// The decoder of a trial.
#[derive(Debug, Clone, PartialEq)]
pub enum ReplayDecoder {
    /// A linear decoder.
    Linear(LinearReplay),
    /// The weights of a network.
    Network(Vec<f32>),
    /// A linear decoder, and the weights of the network stacked on it.
    Stacked(LinearReplay, Vec<f32>),
}

/// The decoder of a replay: the network with these weights, a linear decoder fitted to the training samples, or both stacked.
///
/// # Errors
/// If the spec is invalid, the network has no weights, or the fit fails.
pub fn fit_decoder(trial: &TrialSpec, weights: &[f32], replay: &Replay) -> Result<ReplayDecoder, NoResult> {
    let (problem, weights) = (prepared(trial)?, weights.to_vec());
    if problem.decoder_kind.is_network() && weights.is_empty() {
        return Err(NoResult::Rejected("the trial has trained no network on this body".into()));
    }
    let linear = || Ok::<_, NoResult>(replay.linear(&problem, &problem.decoder, &pool(1)?)?);
    Ok(match problem.decoder_kind {
        DecoderKind::Stacked => ReplayDecoder::Stacked(linear()?, weights),
        DecoderKind::Network => ReplayDecoder::Network(weights),
        DecoderKind::Linear | DecoderKind::Inverse => ReplayDecoder::Linear(linear()?),
    })
}

/// As [`replay`], with a decoder fitted again to casts of the design, as in the trial's comparison. Also returns the decoder.
///
/// # Errors
/// As [`replay`]; if there is no variation, or if the fit fails.
pub fn replay_for_casts(
    trial: &TrialSpec,
    design: &[f64],
    threads: usize,
) -> Result<(Replay, ReplayDecoder), NoResult> {
    let (problem, pool) = (simulable(trial, design)?, pool(threads)?);
    if problem.variation.is_none() {
        return Err(NoResult::Rejected(format!("the trial has {NO_VARIATION}")));
    }
    let (problem, _) = placed(&problem, &pool)?;
    Ok(match brain_for_casts(&PreparedTrial::new(&problem, &pool)?, design).map_err(OfMaths::Initial)? {
        DecoderForCasts::Linear(fitted) => {
            let mut replay = questions::replay(&problem, design, &[], &pool)?;
            let brain = replay.decode_with(&problem, &fitted);
            (replay.predictions, replay.errors) = (brain.predictions.clone(), brain.errors.clone());
            (replay, ReplayDecoder::Linear(brain))
        }
        DecoderForCasts::Network(weights) => {
            (questions::replay(&problem, design, &weights, &pool)?, ReplayDecoder::Network(weights))
        }
        DecoderForCasts::Stacked(fitted, weights) => {
            let mut replay = questions::replay(&problem, design, &[], &pool)?;
            replay.read_on(&problem, &fitted, &weights, &pool);
            let linear = replay.decode_with(&problem, &fitted);
            (replay, ReplayDecoder::Stacked(linear, weights))
        }
    })
}

/// The linear decoder of the whole sample, with which every body is compared; `None` if it is too large.
///
/// # Errors
/// If the spec is invalid, or the fit fails.
pub fn linear(trial: &TrialSpec, replay: &Replay) -> Result<Option<LinearReplay>, NoResult> {
    let problem = prepared(trial)?;
    let (instants, channels) = (problem.scene.instants, replay.signal_scale.len());
    if !fits(instants, channels) {
        return Ok(None);
    }
    let found = replay.linear(&problem, &Decoder::whole(instants, channels), &pool(1)?);
    Ok(Some(found?))
}

/// Motion of a body under one sample of its trial, numbered as in [`replay`].
///
/// # Errors
/// As [`replay`].
pub fn motion(trial: &TrialSpec, design: &[f64], sample: usize, threads: usize) -> Result<Motion, NoResult> {
    let problem = with_design(trial, design)?;
    Ok(questions::motion(&problem, design, sample, &pool(threads)?)?)
}

#[cfg(test)]
pub(crate) mod tests;
