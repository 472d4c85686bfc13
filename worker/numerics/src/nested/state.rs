//! State of the outer loop between steps, and the step that moves the body.

use super::evaluation::Comparison;
use super::report::Report;
use crate::body::Freedom;
use crate::brain::{Adam, TrainOutcome};
use crate::brains::DecoderState;
use crate::feasible::{Castable, Projection};
use crate::trial::{Failure, Problem, Trouble};

/// State of an outer loop, complete: a resumed loop gives the same bits.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// The next outer step.
    pub step: u32,
    /// α (mm).
    pub design: Vec<f64>,
    /// Adam on α.
    pub design_adam: Adam<f64>,
    /// State of the decoder that carries over to the next body.
    pub decoder_state: DecoderState,
    /// The design of least test error so far.
    pub best: Option<Best>,
    /// Factor on the protocol's learning rate of α, at most 1: halved when a step is undone, raised by 10 % otherwise.
    pub rate_factor: f64,
    /// Consecutive undone steps.
    pub consecutive_undone: u32,
    /// Running geometric mean of the training loss.
    pub trend: Option<f64>,
    /// The last designs before `design`, newest last.
    pub recent_designs: Vec<PastDesign>,
    /// Results of the final comparison so far.
    pub comparison: Comparison,
    /// Fitness of the candidates of a search so far, in order.
    pub fitness: Vec<f64>,
}

/// An earlier design of the loop.
#[derive(Debug, Clone, PartialEq)]
pub struct PastDesign {
    /// The outer step that started from it.
    pub step: u32,
    /// α (mm).
    pub design: Vec<f64>,
}

/// The design of least test error so far.
#[derive(Debug, Clone, PartialEq)]
pub struct Best {
    /// α (mm).
    pub design: Vec<f64>,
    /// Its test error (%).
    pub error: f64,
    /// The outer step that started from it.
    pub step: u32,
}

/// A training loss above this multiple of its trend counts as a failed step. Losses of fresh networks vary by a factor of two
/// between seeds, and Adam's spikes reach another factor of three.
const JUMP: f64 = 10.0;
/// Training loss (normalised) that never counts as a failed step: that of an error of 0.01 %.
const NEGLIGIBLE: f64 = 1e-4;
/// Least weight of a coordinate in the projection's metric, relative to the mean: v̂ can be 0.
const METRIC_FLOOR: f64 = 1e-3;

impl State {
    /// The state before the first step.
    pub(super) fn new(problem: &Problem) -> Self {
        Self {
            step: 0,
            design: problem.initial.clone(),
            design_adam: Adam::new(problem.initial.len()),
            decoder_state: DecoderState::untrained(problem.shape().weights()),
            best: None,
            rate_factor: 1.0,
            consecutive_undone: 0,
            trend: None,
            recent_designs: Vec::new(),
            comparison: Comparison::default(),
            fitness: Vec::new(),
        }
    }

    /// Checks that a training loss is finite and in line with its trend.
    pub(super) fn check_trend(&self, loss: f64) -> Result<(), Trouble> {
        match self.trend {
            _ if !loss.is_finite() => Err(Trouble::Training(TrainOutcome::NonFinite)),
            Some(trend) if loss > NEGLIGIBLE.max(JUMP * trend) => Err(Trouble::LossJump(loss / trend)),
            _ => Ok(()),
        }
    }

    /// Updates trend and best design with a step's training loss and test error (%).
    pub(super) fn remember(&mut self, loss_train: f64, error_test: Option<f64>) {
        self.trend = Some(match self.trend {
            None => loss_train,
            Some(trend) => trend.powf(0.7) * loss_train.powf(0.3),
        });
        self.consecutive_undone = 0;
        self.rate_factor = (self.rate_factor * 1.1).min(1.0);
        if let Some(error) = error_test
            && self.best.as_ref().is_none_or(|best| error < best.error)
        {
            self.best = Some(Best { design: self.design.clone(), error, step: self.step });
        }
    }

    /// α ← Π(α − Adam(g)), Π in the metric √v̂ of Adam. Tied designs step in z instead of α. `bodies`: designs to remember,
    /// including the new one.
    pub(super) fn move_body(
        &mut self,
        problem: &Problem,
        freedom: &Freedom,
        gradient: &[f64],
        castable: &mut dyn Castable,
        bodies: usize,
        report: &mut Report,
    ) {
        let rate = problem.optimise.rate_of(self.step) * self.rate_factor;
        let mut target = self.design.clone();
        let gradient = freedom.vjp(gradient);
        let length = norm(gradient.iter().copied());
        let (beta, unit) = problem.optimise.scaling();
        let scale = if unit && length > 0.0 { length.recip() } else { 1.0 };
        let scaled: Vec<f64> = gradient.iter().map(|g| scale * g).collect();
        self.design_adam.step_with(&mut target, &freedom.spread(&scaled), rate, beta);
        let metric = metric(&self.design_adam);
        let projection = castable.project(&self.design, &target, metric.as_deref());
        report.gradient_norm = Some(length);
        let design = self.set_design(problem, freedom, projection, report);
        self.recent_designs.push(PastDesign { step: self.step, design });
        self.recent_designs.drain(..(self.recent_designs.len() + 1).saturating_sub(bodies));
    }

    /// Moves the body to a projected design; returns the previous design.
    pub(super) fn set_design(
        &mut self,
        problem: &Problem,
        freedom: &Freedom,
        projection: Projection,
        report: &mut Report,
    ) -> Vec<f64> {
        let design = freedom.snap(&problem.initial, projection.design);
        report.counters.projection_iterations += projection.iterations;
        report.step_length = Some(norm(design.iter().zip(&self.design).map(|(new, old)| new - old)));
        report.projection = Some(projection.status);
        report.projection_distance = Some(projection.distance);
        std::mem::replace(&mut self.design, design)
    }

    /// Undoes the last move of this state, which is the one before the failed step, and halves the rate.
    pub(super) fn undo_step(mut self, trouble: Trouble, report: &mut Report) -> Result<Self, Failure> {
        report.trouble = Some(trouble);
        self.rate_factor *= 0.5;
        self.consecutive_undone += 1;
        match self.recent_designs.pop() {
            Some(passed) => self.design = passed.design,
            None if self.consecutive_undone == 1 => return Err(Failure::Initial(trouble)),
            None => return Err(Failure::Stuck(self.consecutive_undone, trouble)),
        }
        // a dead or diverged network is replaced
        if matches!(trouble, Trouble::Training(_)) {
            let ridge = self.decoder_state.ridge;
            self.decoder_state =
                DecoderState { ridge, ..DecoderState::untrained(self.decoder_state.adam.m.len()) };
            self.trend = None;
        }
        Ok(self)
    }
}

/// √v̂ of Adam relative to its mean, at least `METRIC_FLOOR`; `None` while all gradients have been zero.
fn metric(adam: &Adam<f64>) -> Option<Vec<f64>> {
    let scale: Vec<f64> = adam.v.iter().map(|v| v.sqrt()).collect();
    let mean = scale.iter().sum::<f64>() / scale.len() as f64;
    (mean > 0.0).then(|| scale.iter().map(|s| (s / mean).max(METRIC_FLOOR)).collect())
}

pub(super) fn norm(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|x| x * x).sum::<f64>().sqrt()
}
