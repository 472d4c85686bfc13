//! What a trial is to the maths.

use super::chip::{Chip, Disturbance};
use super::linear::Decoder;
use crate::body::Freedom;
use crate::brain::{Architecture, Policy, Shape};
use crate::dynamics::{Forces, Scene, Solver};
use crate::feasible::{Feasible, Limits};
use crate::place::Search;
use crate::random::Purpose;
use crate::stimuli::{Deal, Source, bells, irregular, select, split, targets};

/// Which brain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The convolutional network.
    Network,
    /// The linear brain.
    Linear,
    /// The network on the signals and what the linear brain makes of them; it only reads.
    Stacked,
}

/// Everything that a nested optimisation starts from. Angles in rad.
#[derive(Debug, Clone)]
pub struct Problem {
    /// Body, panels, sensors, clock; without sensors as long as they are to be searched for.
    pub scene: Scene,
    /// How the sensors are placed, where they are not given.
    pub search: Option<Search>,
    /// α of the initial body (mm).
    pub initial: Vec<f64>,
    /// The integrator of every evaluation, and of the steps that ask for no other.
    pub solver: Solver,
    /// Limits of a castable design.
    pub limits: Limits,
    /// Units whose nodes stay where the initial design has them.
    pub kept: Vec<usize>,
    /// Units whose nodes stay there and count for nothing in a gradient's length.
    pub frozen: Vec<usize>,
    /// Cells along x and y of a block whose nodes are shifted together; `[1, 1]`: each by itself.
    pub tie: [usize; 2],
    /// Where the forces come from.
    pub stimuli: Stimuli,
    /// What the sensors' chips add to the signals, where they do.
    pub disturbance: Option<Disturbance>,
    /// The brain that reads the bodies in the comparison at the end.
    pub reader: Kind,
    /// The network, and its training where it starts fresh.
    pub brain: Training,
    /// The linear brain.
    pub decoder: Decoder,
    /// The outer loop.
    pub optimise: Optimise,
    /// The comparison at the end.
    pub evaluation: Evaluation,
    /// Seed of stimuli, split, networks and batches.
    pub seed: u64,
}

/// Force histories and how many of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Stimuli {
    /// Where they come from.
    pub source: Source,
    /// Instants of the forces' own clock, a multiple of the scene's.
    pub instants: usize,
    /// N: samples that train and test the brain.
    pub samples: usize,
    /// How many of the N are the test set.
    pub test: usize,
    /// Samples that neither loop sees.
    pub holdout: usize,
}

/// Full-batch training of a fresh brain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Training {
    /// Adam iterations.
    pub iterations: usize,
    /// Adam's rate.
    pub rate: f64,
    /// Its layers.
    pub architecture: Architecture,
}

/// The outer loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Optimise {
    /// The brain that the body is trained with.
    pub brain: Kind,
    /// How body and brain are trained together.
    pub protocol: Protocol,
    /// Outer steps.
    pub iterations: u32,
    /// Adam's rate on α (mm); of a search the standard deviation of its first candidates.
    pub rate: f64,
    /// A cheaper integrator for the steps that move the body far; the accurate one finishes. `joint` and `envelope`.
    pub coarse: Option<Solver>,
}

/// How body and brain are trained together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Protocol {
    /// A fresh network each outer step, trained `Training::iterations`; the test loss moves the body.
    Paper(Terms),
    /// The network goes on; the training loss moves the body, from a subset of samples.
    Envelope(Going),
    /// The network goes on; the loss on samples drawn for the step alone moves the body.
    Joint(Going),
    /// No gradient: candidates drawn about the initial body; the network goes on from one to the next.
    Random(Going),
    /// Likewise, drawn by CMA-ES.
    Cmaes(Going),
}

/// A network that goes on from body to body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Going {
    /// Samples whose gradient moves the body.
    pub batch: usize,
    /// Adam iterations an outer step.
    pub brain_iterations: usize,
    /// Their rate.
    pub brain_rate: f64,
}

/// Terms of the gradient of the test loss.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Terms {
    /// Through the test signals and, by the implicit function theorem, through the trained weights.
    Implicit(Policy),
    /// Through the test signals alone.
    Direct,
}

/// The comparison of the initial and the best body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evaluation {
    /// Fresh networks a body.
    pub seeds: usize,
    /// Rate schedule of their training.
    pub schedule: Schedule,
    /// Iterations of as many further networks, whose training is to be a long one.
    pub long: Option<usize>,
}

/// Adam's rate over a training.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Schedule {
    /// Falls to 0 by a cosine.
    Cosine,
    /// Stays.
    Constant,
}

impl Schedule {
    /// The rate of an iteration, from 0, as a part of the full one.
    pub fn factor(self, iteration: usize, iterations: usize) -> f64 {
        match self {
            Self::Constant => 1.0,
            Self::Cosine => 0.5 * (1.0 + (std::f64::consts::PI * iteration as f64 / iterations as f64).cos()),
        }
    }
}

/// Looks at the test set in a loop, where a protocol does not need it anyway: so many, at least ten steps apart.
const LOOKS: u32 = 20;
const APART: u32 = 10;

/// The part of the outer steps for which a coarse integrator serves.
const COARSE: f64 = 0.9;

impl Optimise {
    /// Adam's rate on α at an outer step (mm): constant in the paper's protocol, else falling over the second half.
    pub(super) fn rate_of(&self, step: u32) -> f64 {
        let left = 1.0 - f64::from(step) / f64::from(self.iterations);
        match self.protocol {
            Protocol::Paper(_) => self.rate,
            _ => self.rate * (2.0 * left + 0.05).min(1.0),
        }
    }

    /// Adam's β₂ on α, and whether it sees gradients of length 1: those of a going network grow and shrink by turns, and
    /// a few great ones would hold the steps small for long. The paper's protocol takes them as they are.
    pub(super) fn scaling(&self) -> (f64, bool) {
        match self.protocol {
            Protocol::Paper(_) => (0.999, false),
            _ => (0.99, true),
        }
    }

    /// Designs that a loop remembers beside the present one, as it fits its brain on their samples too.
    pub(super) fn trail(&self) -> usize {
        match self.brain {
            Kind::Network | Kind::Stacked => 3,
            Kind::Linear => super::protocol::BODIES - 1,
        }
    }

    /// The integrator of an outer step.
    pub(super) fn solver_of(&self, step: u32, accurate: Solver) -> Solver {
        let far = f64::from(step) < COARSE * f64::from(self.iterations);
        self.coarse.filter(|_| far).unwrap_or(accurate)
    }

    /// Whether a step looks at the test set: some do, and the last.
    pub(super) fn looks_at_test(&self, step: u32) -> bool {
        step.is_multiple_of((self.iterations / LOOKS).max(APART)) || step + 1 == self.iterations
    }
}

impl Problem {
    /// Which shifts of a design move, and which together.
    pub fn freedom(&self) -> Freedom {
        let whole = self.tie == [1, 1] && self.frozen.is_empty();
        // what is kept alone has always counted in a gradient's length
        let still = if whole { Vec::new() } else { [&self.frozen[..], &self.kept].concat() };
        Freedom::new(&self.scene.layout, self.tie, &still)
    }

    /// The designs that can be cast and had.
    pub fn castable(&self) -> Feasible {
        let still = [&self.frozen[..], &self.kept].concat();
        Feasible::new(&self.scene.layout, self.limits, &still).tied(&self.freedom())
    }

    /// Of the network on the scene's clock, sensors and panels.
    pub fn shape(&self) -> Shape {
        let sensors = self.search.as_ref().map_or(self.scene.sensors.len(), |search| search.sensors);
        Shape {
            instants: self.scene.instants,
            inputs: 3 * sensors,
            architecture: self.brain.architecture,
            outputs: self.scene.panels.len(),
        }
    }

    /// Of the network that reads: a stacked one sees a linear estimate of each force, too.
    pub fn reader_shape(&self) -> Shape {
        let shape = self.shape();
        let estimates = if self.reader == Kind::Stacked { shape.outputs } else { 0 };
        Shape { inputs: shape.inputs + estimates, ..shape }
    }

    /// The sensors' chips, what is relative in them so to `rms` of each channel.
    pub(super) fn chip(&self, rms: &[f64]) -> Option<Chip> {
        let delta = self.scene.duration / self.scene.instants as f64;
        self.disturbance.map(|d| Chip::new(&d, self.seed, delta, rms))
    }

    /// `count` force histories (N, K, R + 1) of the stimuli's clock, from number `first` of `purpose`: `Stimulus`, of which
    /// [`Problem::known`] are the trial's, `Holdout` or `Fresh`.
    pub fn forces(&self, purpose: Purpose, first: u64, count: usize) -> Forces {
        let (panels, scene) = (self.scene.panels.len(), &self.scene);
        let (duration, instants) = (scene.duration, self.stimuli.instants);
        let samples = first..first + count as u64;
        match &self.stimuli.source {
            Source::Bell(bell) => bells(bell, purpose, self.seed, samples, panels, duration, instants),
            Source::Irregular(kind) => {
                irregular(kind, purpose, self.seed, samples, panels, duration, instants)
            }
            Source::Recorded(records) => {
                let Stimuli { samples, test, .. } = self.stimuli;
                let deal = Deal { seed: self.seed, samples, test };
                records.forces(deal, purpose, first, count, panels, duration)
            }
        }
    }

    /// Training and test set.
    pub fn known(&self) -> [Forces; 2] {
        let Stimuli { samples, test, .. } = self.stimuli;
        let all = self.forces(Purpose::Stimulus, 0, samples);
        let (train, test) = split(self.seed, samples, test);
        [select(&all, &train), select(&all, &test)]
    }

    /// What the network is to say of `forces` (N, T, K) in N.
    pub(super) fn targets(&self, forces: &Forces) -> Vec<f64> {
        let low_pass = matches!(&self.stimuli.source, Source::Recorded(records) if records.low_pass);
        targets(forces, self.scene.instants, low_pass)
    }

    /// Histories on the clock of the signals: those of the targets, and the forces at the beginning.
    pub(super) fn seen(&self, forces: Forces) -> Forces {
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
        Forces { samples: forces.samples, panels, instants, values }
    }

    /// The part of the work that is done after `steps` outer steps, in brain iterations.
    pub(super) fn progress(&self, steps: u32) -> f64 {
        let evaluation = 2.0 * self.evaluation_iterations() as f64 / self.brain.iterations as f64;
        let loop_iterations = f64::from(self.optimise.iterations) * self.step_share();
        f64::from(steps) * self.step_share() / (loop_iterations + evaluation)
    }

    /// Brain iterations of the comparison at the end, a body.
    pub(super) fn evaluation_iterations(&self) -> usize {
        if self.reader == Kind::Linear {
            return self.brain.iterations.div_ceil(20);
        }
        self.evaluation.seeds * (self.brain.iterations + self.evaluation.long.unwrap_or(0))
    }

    /// Work of an outer step relative to a full training.
    fn step_share(&self) -> f64 {
        match self.optimise.protocol {
            Protocol::Paper(_) => 1.0,
            Protocol::Envelope(_) | Protocol::Random(_) | Protocol::Cmaes(_) => 0.1,
            Protocol::Joint(_) => 0.05,
        }
    }
}
