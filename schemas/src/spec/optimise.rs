//! The decoder, the optimisation of the design, and the final comparison.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_with::skip_serializing_none;

use super::is_default;
use super::solver::{Method, Solver};
use super::stimuli::{Part, Stimuli};

/// Named shapes of the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// The paper's: width 64, kernels 3, 3, 1; uses five instants per estimate.
    Paper,
    /// Width 24, kernels 9, 9, 9, 1, dilations 1, 4, 16, 1; uses 169 instants per estimate.
    Long,
}

/// Kind of decoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum BrainKind {
    /// The convolutional network of the paper.
    #[default]
    Cnn,
    /// Linear least squares of the forces on the signals around each instant.
    Linear,
    /// A network on the signals and on the estimate of a linear decoder. The body is trained with the linear decoder or the
    /// network.
    Stacked,
    /// The body's model, inverted for the forces that explain the signals. The body is trained with the linear decoder or the
    /// network. Bands and the check of the model require noise above the integration error (`sensors.noise`).
    Inverse,
}

/// Quantity that a decoder estimates. Of a task other than `forces`, a sample has one label.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Task {
    /// The force history of each panel.
    #[default]
    Forces,
    /// The panel with the greatest force.
    Panel,
    /// The number of panels with more than a tenth of the sample's greatest force.
    Count,
    /// The mean of the panels' positions, weighted by their impulses (mm).
    Position,
    /// The greatest force of each panel (N).
    Peak,
    /// The impulse ∫|f| dt of each panel (mN s).
    Impulse,
    /// The time at which a force first exceeds a tenth of the sample's greatest (ms).
    Onset,
    /// The kind of forces of the sample: its entry of `stimuli.mix`.
    Kind,
    /// All of them that vary, except `forces`, `kind` and, with `window`, `onset`, with equal weights.
    All,
}

impl Task {
    /// Whether the decoder estimates force histories.
    pub fn is_forces(&self) -> bool {
        *self == Self::Forces
    }

    /// Its name in specs and the database.
    pub fn name(self) -> &'static str {
        ["forces", "panel", "count", "position", "peak", "impulse", "onset", "kind", "all"][self as usize]
    }
}

/// Regularisation λ of a linear decoder: factor of its squared weights.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Ridge {
    /// a number, for signals and forces in units of their RMS.
    Given(f64),
    /// `"auto"`, chosen by cross-validation on the training set.
    Auto(Auto),
}

/// The word `"auto"`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Auto {
    /// The word.
    Auto,
}

/// How a network's signals and forces are normalised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Scaling {
    /// Each signal channel is divided by the RMS of the body's training signals; forces have mean 0 and deviation 1.
    #[default]
    Rms,
    /// Signals lie in [−1, 1] and forces in [0, 1] over the training samples of the initial body; the same scales serve every body.
    MinMax,
}

/// The decoder of the final comparison and, unless `optimise.brain` differs, of the training.
#[skip_serializing_none]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Brain {
    /// Decoder of the final comparison. Default: `"cnn"`.
    #[serde(skip_serializing_if = "is_default")]
    pub kind: BrainKind,
    /// What the decoder estimates, and the body is trained for. Tasks other than `"forces"` need `kind = "linear"`: a ridge
    /// regression on the signals of the whole sample or of `window`, whose leave-one-out error trains the body. The errors of such a trial are
    /// 100·(1 − R²). Default: `"forces"`.
    #[serde(skip_serializing_if = "is_default")]
    pub task: Task,
    /// Duration of the signals from the first contact on that the readout of a task uses. A contact is the first reading above a
    /// tenth of its channel's RMS (training samples of the initial body), and above five standard deviations of its error. A sample
    /// without contact is read from its start; after its end, signals are 0. For `evaluation.tasks`, which then also trains small
    /// networks, and for tasks other than `"forces"` and `"onset"`. Unit: s. Default: the whole sample.
    pub window: Option<f64>,
    /// Memory of a linear decoder, `[before, after]` an instant; `after = 0` suits a device that estimates without delay. An
    /// inverse decoder uses all earlier readings and this look-ahead; a `causal` stacked decoder uses all earlier readings and no
    /// look-ahead. Unit: s. Default: the whole sample.
    pub memory: Option<[f64; 2]>,
    /// Regularisation λ of a linear decoder (ridge). Default: `"auto"`.
    pub ridge: Option<Ridge>,
    /// Full-batch Adam iterations per training of the network, at most 10 000 000.
    pub iterations: usize,
    /// Adam's learning rate for the network. Unit: 1.
    pub learning_rate: f64,
    /// Normalisation of the network's signals and forces. Default: `"rms"`.
    #[serde(skip_serializing_if = "is_default")]
    pub scaling: Scaling,
    /// Named shape of the network; `width`, `kernels`, `dilations` and `causal` override parts of it. Default: `"paper"`.
    pub preset: Option<Preset>,
    /// Channels of every hidden layer; multiples of 16 run fastest. Default: 64.
    pub width: Option<usize>,
    /// Kernel size of every layer, output layer last; odd unless `causal`. Default: `[3, 3, 1]`.
    pub kernels: Option<Vec<usize>>,
    /// Instants between the entries of a kernel, for every layer. Default: 1 each.
    pub dilations: Option<Vec<usize>>,
    /// Whether every layer uses earlier instants only, so that estimates need no look-ahead. Default: false.
    pub causal: Option<bool>,
}

/// Shape of the network, with preset and defaults applied.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Network {
    /// Channels of every hidden layer.
    pub width: usize,
    /// Kernel size of every layer, output layer last.
    pub kernels: Vec<usize>,
    /// Dilation of every layer.
    pub dilations: Vec<usize>,
    /// Whether every layer uses earlier instants only.
    pub causal: bool,
}

impl Brain {
    /// Returns the shape of the network, not validated.
    pub fn network(&self) -> Network {
        let (width, kernels, dilations) = match self.preset {
            None | Some(Preset::Paper) => (64, &[3, 3, 1][..], &[1, 1, 1][..]),
            Some(Preset::Long) => (24, &[9, 9, 9, 1][..], &[1, 4, 16, 1][..]),
        };
        let kernels = self.kernels.clone().unwrap_or(kernels.to_vec());
        let dilations = self.dilations.clone().unwrap_or_else(|| match self.preset {
            Some(_) => dilations.to_vec(),
            None => vec![1; kernels.len()],
        });
        let (width, causal) = (self.width.unwrap_or(width), self.causal.unwrap_or(false));
        Network { width, kernels, dilations, causal }
    }

    /// Replaces the preset by its values, and removes values that equal the defaults.
    pub fn resolved(self) -> Self {
        let Network { width, kernels, dilations, causal } = self.network();
        let ones = dilations.len() == kernels.len() && dilations.iter().all(|&d| d == 1);
        Self {
            preset: None,
            width: Some(width).filter(|&width| width != 64),
            dilations: Some(dilations).filter(|_| !ones),
            kernels: Some(kernels).filter(|kernels| kernels != &[3, 3, 1]),
            causal: Some(causal).filter(|&causal| causal),
            ..self
        }
    }
}

impl Default for Brain {
    fn default() -> Self {
        Self {
            kind: BrainKind::Cnn,
            task: Task::Forces,
            window: None,
            memory: None,
            ridge: None,
            iterations: 1000,
            learning_rate: 1e-2,
            scaling: Scaling::Rms,
            preset: None,
            width: None,
            kernels: None,
            dilations: None,
            causal: None,
        }
    }
}

/// How body and decoder are trained together.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Protocol {
    /// The paper's: each outer step trains a fresh network and uses the direct and implicit gradient of its test loss.
    Paper,
    /// Body and network are trained together, on samples drawn for each step.
    #[default]
    Joint,
    /// Search without gradient: each step evaluates a random body near the initial body.
    Random,
}

/// Terms of the gradient of the test loss.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GradientTerms {
    /// The direct term and the term through the decoder's optimum.
    Implicit,
    /// The direct term only.
    Direct,
}

/// Objective of the design.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Objective {
    /// a name.
    Named(ObjectiveName),
    /// `{ cvar = q }`: the mean over the worst fraction 1 − q of the casts.
    Tail(Tail),
}

/// Named objectives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ObjectiveName {
    /// `"nominal"`: the design.
    Nominal,
    /// `"mean"`: the mean over casts.
    Mean,
    /// `"worst"`: the worst cast.
    Worst,
}

/// The level of a conditional value at risk.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Tail {
    /// q: 0.9 counts the worst tenth of the casts. Unit: 1.
    pub cvar: f64,
}

impl Objective {
    /// Fraction of the casts, the worst ones, whose mean is minimised; 0: the worst cast. `None`: the design, without casts.
    pub fn tail(self) -> Option<f64> {
        match self {
            Self::Named(ObjectiveName::Nominal) => None,
            Self::Named(ObjectiveName::Mean) => Some(1.0),
            Self::Named(ObjectiveName::Worst) => Some(0.0),
            Self::Tail(Tail { cvar }) => Some(1.0 - cvar),
        }
    }

    /// Returns the canonical form; `None` for the nominal objective.
    fn resolved(self) -> Option<Self> {
        match self {
            Self::Named(ObjectiveName::Nominal) => None,
            Self::Tail(Tail { cvar: 0.0 }) => Some(Self::Named(ObjectiveName::Mean)),
            Self::Tail(Tail { cvar: 1.0 }) => Some(Self::Named(ObjectiveName::Worst)),
            other => Some(other),
        }
    }
}

/// The outer loop over the design. Omitted keys have the default of the protocol.
#[skip_serializing_none]
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Optimise {
    /// Decoder with which the body is trained: `"cnn"` or `"linear"`. Default: `brain.kind`, for `"stacked"` and `"inverse"`
    /// `"linear"`.
    pub brain: Option<BrainKind>,
    /// How body and decoder are trained together; details in MODEL.md.
    pub protocol: Protocol,
    /// Number of outer steps, or of candidates of a search. Default: 350, with a linear decoder 100; `"paper"` 100; `"random"`
    /// 80, with a linear decoder 30, which take as long as `"joint"`.
    pub iterations: Option<usize>,
    /// Adam's learning rate on the design, or standard deviation of the candidates of a search. Unit: mm. Default: 0.2, with a
    /// linear decoder 0.3; `"paper"` 0.1; `"random"` 1.0.
    pub learning_rate: Option<f64>,
    /// Terms of the gradient, only for `protocol = "paper"`. Default: `"implicit"`.
    pub gradient: Option<GradientTerms>,
    /// Samples per step for the gradient of the design, at most 1 000 000, with a linear decoder at least 2; with an objective over
    /// casts, per cast. Default: 32 for `"joint"`, for a `brain.task` other than `"forces"` 128, over casts 8.
    pub batch: Option<usize>,
    /// Iterations of the network per outer step, at most 10 000 000; `"paper"` uses `brain.iterations` instead. Default: 10.
    pub brain_iterations: Option<usize>,
    /// Adam's learning rate of these iterations. Unit: 1. Default: 1e-3.
    pub brain_learning_rate: Option<f64>,
    /// A cheaper integrator for the outer steps of `"joint"`. Evaluations on the test set and the final comparison use
    /// `[solver]`. Default: `{ method = "auto", tolerance = 0.03 }`.
    pub coarse: Option<Solver>,
    /// `[p, q]`: the nodes of p × q cells move together, separately for each direction of ligaments. This gives fewer design
    /// parameters at the same size. Default: `[1, 1]`.
    pub tie: Option<[usize; 2]>,
    /// Units whose shape does not change. Default: none.
    pub frozen: Option<Vec<usize>>,
    /// Objective of the design: `"nominal"`, the error of the design itself; or, over casts of `[variation]` drawn per step,
    /// `"mean"`, `"worst"` or `{ cvar = 0.9 }` (mean over the worst tenth). Without `[variation]`, the same over the logarithms
    /// of the errors under each part of `stimuli.mix`. Only for `"joint"`. Default: `"nominal"`.
    pub objective: Option<Objective>,
    /// Casts per step, with `batch` samples each and one decoder for all. Default: 4; over a mixture its parts.
    pub casts: Option<usize>,
}

/// Default casts per step and samples per cast.
const CASTS: usize = 4;
const CAST_BATCH: usize = 8;

impl Optimise {
    /// Default samples per step of `joint` without casts.
    pub const BATCH: usize = 32;
    /// Default samples per step for a task other than forces, which has one label per sample.
    pub const TASK_BATCH: usize = 128;

    /// Fills in the defaults of the protocol. Keys that the protocol does not use stay as they are.
    pub fn resolved(mut self) -> Self {
        let (iterations, learning_rate) = match self.protocol {
            Protocol::Random if self.linear() => (30, 1.0),
            Protocol::Random => (80, 1.0),
            Protocol::Paper => (100, 0.1),
            Protocol::Joint if self.linear() => (100, 0.3),
            Protocol::Joint => (350, 0.2),
        };
        self.objective = self.objective.and_then(Objective::resolved);
        let mut batch = Self::BATCH;
        if self.objective.is_some() {
            self.casts.get_or_insert(CASTS);
            batch = CAST_BATCH;
        }
        self.iterations.get_or_insert(iterations);
        self.learning_rate.get_or_insert(learning_rate);
        if self.protocol == Protocol::Paper {
            self.gradient.get_or_insert(GradientTerms::Implicit);
        } else if !self.linear() {
            self.brain_iterations.get_or_insert(10);
            self.brain_learning_rate.get_or_insert(1e-3);
        }
        if self.protocol == Protocol::Joint {
            self.batch.get_or_insert(batch);
            self.coarse.get_or_insert(Solver { method: Method::Auto, tolerance: 0.03 });
        }
        self
    }

    /// Whether the body is trained with a linear decoder; valid for a resolved trial.
    pub fn linear(&self) -> bool {
        self.brain == Some(BrainKind::Linear)
    }

    /// Number of outer steps.
    pub fn steps(&self) -> usize {
        self.clone().resolved().iterations.unwrap_or_default()
    }
}

/// Learning-rate schedule of the final comparison.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Schedule {
    /// Falls to 0 along a cosine.
    #[default]
    Cosine,
    /// Constant, as in the paper.
    Constant,
}

/// The final comparison of initial and trained body.
#[skip_serializing_none]
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Evaluation {
    /// Number of fresh networks per body; their errors differ by tens of per cent. A linear decoder is fitted once. Default: 3.
    pub seeds: Option<usize>,
    /// Learning-rate schedule of their training.
    pub schedule: Schedule,
    /// Training samples per iteration (mini-batch). A quarter of all samples costs about a quarter of the time.
    /// Larger values mean all samples. Default: all, as in the paper.
    pub batch: Option<usize>,
    /// Iterations of further networks, as many as `seeds`, that are trained longer (10 000 in the paper), at most 10 000 000. In
    /// `v_network` and `v_curve` they follow the others. Default: none.
    pub long_iterations: Option<usize>,
    /// Number of new casts of the initial and of the trained body on which decoders are evaluated (`v_cast`); 0: none. Default:
    /// 24 with a `[variation]`.
    pub casts: Option<usize>,
    /// Whether linear decoders are also calibrated on 10, 30, 100 and all training samples of a cast. This is most of the work on
    /// a cast; inverse decoders need it. Default: true.
    pub records: Option<bool>,
    /// Further kinds of forces under which both bodies are evaluated with linear decoders (`v_under`): tables
    /// `[[evaluation.under]]` of `kind` and keys of that kind, each kind once. Default: none.
    pub under: Option<Vec<Part>>,
    /// Whether the initial body is evaluated, too, to measure the gain by training. It takes half of the comparison. A search for
    /// a design (`[goal]`) does not need it. Default: true.
    pub initial: Option<bool>,
    /// Whether readouts of all sensing tasks (`brain.task`) are fitted to both bodies and stored (`v_task`). `metasense body tasks`
    /// otherwise simulates the bodies again. Default: false.
    pub tasks: Option<bool>,
}

impl Evaluation {
    /// Fills in the defaults for a trial whose decoder is a network. `varied`: the spec has a variation.
    pub fn resolved(self, varied: bool, stimuli: &Stimuli) -> Self {
        let casts = Some(self.casts.unwrap_or(24)).filter(|casts| varied && *casts > 0);
        let under =
            self.under.as_ref().map(|kinds| kinds.iter().map(|kind| kind.resolved(stimuli)).collect());
        let tasks = self.tasks.filter(|estimated| *estimated);
        Self { seeds: Some(self.networks()), casts, under, tasks, ..self }
    }

    /// Reduces the settings to those of a linear decoder, which is fitted once.
    pub fn of_linear(self) -> Self {
        Self { seeds: Some(1), schedule: Schedule::default(), batch: None, long_iterations: None, ..self }
    }

    /// Number of fresh networks per body.
    pub fn networks(&self) -> usize {
        self.seeds.unwrap_or(3)
    }
}
