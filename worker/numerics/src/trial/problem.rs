//! Settings of a trial: scene, forces, limits, and training of body and decoders.

use super::PreparedTrial;
use super::body::BodyModel;
use super::chip::{Chip, ChipErrors, Size};
use super::filter::Filter;
use super::outcome::Failure;
use super::samples::{Samples, pick};
use super::settings::{Decoder, DecoderKind, FinalComparison, OuterLoop, Training};
use crate::brain::Shape;
use crate::brain::linear::Sizes;
use crate::brains::Tasks;
use crate::dynamics::{Forces, IntegratorSettings, Scene};
use crate::feasible::{FeasibleSet, Limits};
use crate::random::Purpose;
use crate::stimuli::{
    HistorySource, RecordSplit, bells, draw_parts, gauss, irregular, silenced, split, spread, targets,
};
use crate::variation::Deviations;
use std::borrow::Cow;
use std::sync::Arc;

/// Input of a nested optimisation. Angles in rad.
#[derive(Debug, Clone)]
pub struct Problem {
    /// Simulates designs in the scene.
    pub body: Arc<dyn BodyModel>,
    /// Panels, sensors, clock, and the body if it consists of polygons. No sensors before the search has placed them.
    pub scene: Scene,
    /// Search for the sensor units, unless they are given.
    pub search: Option<Placing>,
    /// α of the initial body (mm).
    pub initial: Vec<f64>,
    /// Integrator of evaluations, and of steps without a coarse integrator.
    pub solver: IntegratorSettings,
    /// Limits of a castable design.
    pub limits: Limits,
    /// Units whose nodes keep their initial positions.
    pub frozen: Vec<usize>,
    /// Cells along x and y of a block whose nodes share their shifts; `[1, 1]`: none.
    pub tie: [usize; 2],
    /// Forces.
    pub stimuli: ForceSets,
    /// Measured channels of each sensor: a_x (0), a_y (1), ω (2), ascending.
    pub channels: Vec<usize>,
    /// Imperfections of the sensors' chips, if any.
    pub disturbance: Option<ChipErrors>,
    /// α (mm) of the body whose training signals scale relative noise; `None`: the initial body.
    pub relative_to: Option<Vec<f64>>,
    /// Deviations of casts, if casts are evaluated.
    pub variation: Option<Deviations>,
    /// Decoder in the final comparison.
    pub decoder_kind: DecoderKind,
    /// Sensing tasks of readouts.
    pub tasks: Tasks,
    /// The network, and the training of fresh networks.
    pub brain: Training,
    /// The linear decoder.
    pub decoder: Decoder,
    /// The outer loop.
    pub optimise: OuterLoop,
    /// The final comparison.
    pub evaluation: FinalComparison,
    /// Other kinds of forces under which the final comparison also evaluates both bodies.
    pub under: Vec<HistorySource>,
    /// Seed of stimuli, split, networks and batches.
    pub seed: u64,
}

/// A search for the sensor units.
#[derive(Debug, Clone, PartialEq)]
pub struct Placing {
    /// Units that may carry a sensor.
    pub candidates: Vec<usize>,
    /// M, the number of sensors.
    pub sensors: usize,
    /// 0: the best placement; n: the best one that contains the unit ranked n when single (from 0).
    pub turn: usize,
    /// Least distance between the cells of two sensors (mm).
    pub spacing: f64,
}

/// Source and numbers of force histories.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceSets {
    /// Source.
    pub source: HistorySource,
    /// Instants of the forces' own clock, a multiple of the scene's.
    pub instants: usize,
    /// N: samples in the training and the test set.
    pub samples: usize,
    /// Samples in the test set.
    pub test: usize,
    /// Whether the test set is drawn with replacement.
    pub replacement: bool,
    /// Samples in the held-out set.
    pub holdout: usize,
}

impl ForceSets {
    /// Sample numbers of the training set and of the test set.
    pub fn split(&self, seed: u64) -> (Vec<usize>, Vec<usize>) {
        split(seed, self.samples, self.test, self.replacement)
    }
}

impl Problem {
    /// The feasible designs of polygons.
    pub fn castable(&self) -> FeasibleSet {
        FeasibleSet::moving(&self.scene.layout, self.limits, self.tie, &self.frozen)
    }

    /// Shape of the network.
    pub fn shape(&self) -> Shape {
        let sensors = self.search.as_ref().map_or(self.scene.sensors.len(), |search| search.sensors);
        Shape {
            instants: self.scene.instants,
            inputs: self.channels.len() * sensors,
            architecture: self.brain.architecture,
            outputs: self.scene.panels.len(),
        }
    }

    /// Shape of the reader's network; if stacked, its inputs include a linear estimate of each force.
    pub fn reader_shape(&self) -> Shape {
        let shape = self.shape();
        let estimates = if self.decoder_kind == DecoderKind::Stacked { shape.outputs } else { 0 };
        Shape { inputs: shape.inputs + estimates, ..shape }
    }

    /// The sensors' chips; `rms` of each channel scales relative noise.
    pub(crate) fn chip(&self, rms: &[f64]) -> Option<Chip> {
        self.disturbance.map(|d| Chip::new(&d, self.seed, rms, &self.channels))
    }

    /// The sensors' chips; simulates the training samples if noise or bias is relative.
    ///
    /// # Errors
    /// If the simulation fails.
    pub fn chips(&self, pool: &crate::Pool) -> Result<Option<Chip>, Failure> {
        let relative = |size: Size| matches!(size, Size::Relative(part) if part > 0.0);
        match self.disturbance.is_some_and(|d| relative(d.noise) || relative(d.bias)) {
            true => Ok(PreparedTrial::new(self, pool)?.chip),
            false => Ok(self.chip(&vec![0.0; self.shape().inputs])),
        }
    }

    /// Time between two readings (s).
    pub(crate) fn interval(&self) -> f64 {
        self.scene.duration / self.scene.instants as f64
    }

    /// Scene and forces on the clock of the motion, which is finer than that of the readings if chips filter.
    pub fn in_motion<'a>(&self, scene: &'a Scene, forces: &'a Forces) -> (Cow<'a, Scene>, Cow<'a, Forces>) {
        let clock = self.disturbance.map_or(1, |d| d.clock(self.interval()));
        if clock == 1 {
            return (Cow::Borrowed(scene), Cow::Borrowed(forces));
        }
        let scene = Scene { instants: clock * scene.instants, ..scene.clone() };
        let forces = forces.refined_for(&scene).into_owned();
        (Cow::Owned(scene), Cow::Owned(forces))
    }

    /// Instants of the motion per reading, and delay of a reading (s).
    pub(crate) fn clock_and_delay(&self) -> (usize, f64) {
        self.disturbance.map_or((1, 0.0), |d| (d.clock(self.interval()), d.delay))
    }

    fn filter(&self) -> Option<Filter> {
        let some = |d: &ChipErrors| d.clock(self.interval()) > 1;
        self.disturbance.filter(some).map(|d| Filter::new(&d, self.interval()))
    }

    /// Selects the measured channels of simulated signals (N, ·, C·M) on the clock of the motion, and applies low-pass and delay.
    /// Returns (N, T, channels).
    pub fn read(&self, signals: Vec<f64>, samples: usize) -> Vec<f64> {
        let some = self.chosen(signals);
        match self.filter() {
            Some(filter) => filter.run(some, samples, self.shape().inputs),
            None => some,
        }
    }

    /// Transpose of [`Problem::read`].
    pub fn read_vjp(&self, cotangent: Vec<f64>, samples: usize) -> Vec<f64> {
        self.chosen_vjp(match self.filter() {
            Some(filter) => filter.run_vjp(&cotangent, samples, self.shape().inputs),
            None => cotangent,
        })
    }

    /// The measured channels (N, ·, channels) after the low-pass, with `finer` instants per reading.
    pub(crate) fn low_pass_channels(&self, signals: Vec<f64>, samples: usize, finer: usize) -> Vec<f64> {
        let mut some = self.chosen(signals);
        if let Some(disturbance) = &self.disturbance {
            disturbance.low_pass(&mut some, samples, self.shape().inputs, self.interval() / finer as f64);
        }
        some
    }

    /// Transpose of [`Problem::low_pass_channels`].
    pub(crate) fn low_pass_channels_vjp(
        &self,
        mut cotangent: Vec<f64>,
        samples: usize,
        finer: usize,
    ) -> Vec<f64> {
        if let Some(disturbance) = &self.disturbance {
            let step = self.interval() / finer as f64;
            disturbance.low_pass_vjp(&mut cotangent, samples, self.shape().inputs, step);
        }
        self.chosen_vjp(cotangent)
    }

    /// Selects the measured channels.
    fn chosen(&self, signals: Vec<f64>) -> Vec<f64> {
        let all = self.body.channels();
        if self.channels.len() == all {
            return signals;
        }
        signals.chunks_exact(all).flat_map(|all| self.channels.iter().map(|&c| all[c])).collect()
    }

    fn chosen_vjp(&self, cotangent: Vec<f64>) -> Vec<f64> {
        let count = self.body.channels();
        if self.channels.len() == count {
            return cotangent;
        }
        let all = |read: &[f64]| {
            let mut all = [0.0; 3];
            self.channels.iter().zip(read).for_each(|(&c, x)| all[c] = *x);
            all.into_iter().take(count)
        };
        cotangent.chunks_exact(self.channels.len()).flat_map(all).collect()
    }

    /// `count` force histories (N, K, R + 1) on the clock of the stimuli, from number `first`. `purpose`: `Stimulus` (see
    /// [`Problem::training_and_test`]), `Holdout` or `Fresh`.
    pub fn forces(&self, purpose: Purpose, first: u64, count: usize) -> Forces {
        self.forces_of(&self.stimuli.source, self.scene.panels.len(), purpose, first, count)
    }

    /// As [`Problem::forces`], for one part of a mixture; equals the part's own samples of the same numbers.
    pub(crate) fn part(&self, part: usize, purpose: Purpose, first: u64, count: usize) -> Forces {
        let source = match &self.stimuli.source {
            HistorySource::Mix(parts) => &parts[part].1,
            whole => whole,
        };
        self.forces_of(source, self.scene.panels.len(), purpose, first, count)
    }

    /// Part of the mixture, from 0, of each sample of [`Problem::forces`].
    pub fn parts_of(&self, purpose: Purpose, first: u64, count: usize) -> Vec<usize> {
        match &self.stimuli.source {
            HistorySource::Mix(parts) => {
                let weights: Vec<f64> = parts.iter().map(|(weight, _)| *weight).collect();
                draw_parts(&weights, purpose, self.seed, first..first + count as u64)
            }
            _ => vec![0; count],
        }
    }

    /// Part of the mixture of each training, test and held-out sample.
    pub fn parts(&self) -> [Vec<usize>; 3] {
        let of = self.parts_of(Purpose::Stimulus, 0, self.stimuli.samples);
        let (train, test) = self.stimuli.split(self.seed);
        let [train, test] = [train, test].map(|set| pick(&of, of.len(), &set));
        [train, test, self.parts_of(Purpose::Holdout, 0, self.stimuli.holdout)]
    }

    fn forces_of(
        &self,
        source: &HistorySource,
        panels: usize,
        purpose: Purpose,
        first: u64,
        count: usize,
    ) -> Forces {
        let scene = &self.scene;
        let (duration, instants) = (scene.duration, self.stimuli.instants);
        let samples = first..first + count as u64;
        match source {
            HistorySource::Bell(bell) => bells(bell, purpose, self.seed, samples, panels, duration, instants),
            HistorySource::Gauss(kind) => {
                gauss(kind, purpose, self.seed, samples, panels, duration, instants)
            }
            HistorySource::Irregular(kind) => {
                irregular(kind, purpose, self.seed, samples, panels, duration, instants)
            }
            HistorySource::Recorded(records) => {
                let ForceSets { samples, test, replacement, .. } = self.stimuli;
                let deal = RecordSplit { seed: self.seed, samples, test, replacement };
                records.forces(deal, purpose, first, count, panels, duration)
            }
            HistorySource::Mix(parts) => {
                let weights: Vec<f64> = parts.iter().map(|(weight, _)| *weight).collect();
                let of_part =
                    |(_, part): &(f64, HistorySource)| self.forces_of(part, panels, purpose, first, count);
                let of: Vec<Forces> = parts.iter().map(of_part).collect();
                let drawn = draw_parts(&weights, purpose, self.seed, samples);
                let values = drawn.iter().enumerate().flat_map(|(i, &part)| of[part].sample(i)).copied();
                let central = of.iter().all(|forces| forces.strikes.is_empty());
                let strike = |n: usize| of[drawn[n / panels]].strike(&scene.panels, n / panels, n % panels);
                let strikes = if central { 0 } else { count * panels };
                let strikes = (0..strikes).map(strike).collect();
                Forces { samples: count, panels, instants, values: values.collect(), strikes }
            }
            HistorySource::Silent(silent, source) => {
                let mut forces = self.forces_of(source, panels, purpose, first, count);
                let mask = samples.flat_map(|i| silenced(*silent, purpose, self.seed, i, panels));
                let histories = forces.values.chunks_exact_mut(instants + 1);
                histories.zip(mask).filter(|(_, silent)| *silent).for_each(|(own, _)| own.fill(0.0));
                forces
            }
            HistorySource::Anywhere(source) => {
                let blows = self.forces_of(source, 1, purpose, first, count);
                spread(&blows, purpose, self.seed, first, panels)
            }
            HistorySource::Struck(hand, source) => {
                let strikes = hand.strikes(&scene.panels, purpose, self.seed, samples);
                Forces { strikes, ..self.forces_of(source, panels, purpose, first, count) }
            }
        }
    }

    /// Training and test set.
    pub fn training_and_test(&self) -> [Forces; 2] {
        let all = self.forces(Purpose::Stimulus, 0, self.stimuli.samples);
        let (train, test) = self.stimuli.split(self.seed);
        [all.select(&train), all.select(&test)]
    }

    /// The held-out set.
    pub fn holdout(&self) -> Forces {
        self.forces(Purpose::Holdout, 0, self.stimuli.holdout)
    }

    /// The first of `samples` held-out samples that evaluates bands. Records have no fresh samples, so the first half
    /// calibrates the bands.
    pub(crate) fn first_band_sample(&self, samples: usize) -> usize {
        if self.stimuli.source.is_recorded() { samples.div_ceil(2) } else { 0 }
    }

    /// Whether targets from forces on a finer clock pass a low-pass.
    pub fn low_pass(&self) -> bool {
        let records =
            |part: &&HistorySource| matches!(part, HistorySource::Recorded(records) if records.low_pass);
        self.stimuli.source.parts().iter().any(records)
    }

    /// Targets (N, T, K) of the decoders (N).
    pub fn targets(&self, forces: &Forces) -> Vec<f64> {
        targets(forces, self.scene.instants, self.low_pass())
    }

    /// Signals (N, T, channels) with the targets of `forces`.
    pub fn samples(&self, signals: Vec<f64>, forces: &Forces) -> Samples {
        let Shape { instants, inputs, outputs, .. } = self.shape();
        let sizes = Sizes { instants, channels: inputs, outputs };
        Samples::new(sizes, signals, self.targets(forces))
    }

    /// Force histories on the clock of the signals: the targets, preceded by the forces at instant 0.
    pub fn to_signal_clock(&self, forces: Forces) -> Forces {
        let (instants, panels) = (self.scene.instants, forces.panels);
        if forces.instants == instants {
            return forces;
        }
        let targets = self.targets(&forces);
        let mut values = Vec::with_capacity(forces.samples * panels * (instants + 1));
        for (i, sample) in targets.chunks_exact(instants * panels).enumerate() {
            for k in 0..panels {
                values.push(forces.sample(i)[k * (forces.instants + 1)]);
                values.extend(sample[k..].iter().step_by(panels));
            }
        }
        Forces { samples: forces.samples, panels, instants, values, strikes: Vec::new() }
    }
}
