//! Schedule of the outer loop: learning rates, test evaluations, and progress.

use crate::trial::{OuterLoop, Problem, TrainingProtocol};
use std::collections::BTreeSet;

/// Fractions of a loop after which a design search may stop a trial.
pub const RUNGS: [f64; 2] = [1.0 / 9.0, 1.0 / 3.0];
/// Fractions of a loop after which a design is evaluated on the test set, unless the protocol always does so. The rate falls, so
/// the best design is nearly always a late one.
const TEST_FRACTIONS: [f64; 5] = [0.0, RUNGS[0], RUNGS[1], 0.6, 0.8];
/// These evaluations take place at multiples of this number of steps.
const APART: u32 = 10;

/// The multiple of `APART` nearest to a fraction of `steps`; 0 only for fraction 0.
pub fn evaluation_step_near(steps: u32, part: f64) -> u32 {
    let nearest = (f64::from(steps) * part / f64::from(APART)).round() as u32;
    nearest.max(u32::from(part > 0.0)) * APART
}

/// The steps out of `steps` that evaluate the test set, in ascending order; the last one always does.
fn evaluated_steps(steps: u32) -> BTreeSet<u32> {
    let planned = TEST_FRACTIONS.map(|part| evaluation_step_near(steps, part));
    planned.into_iter().filter(|step| *step < steps).chain(steps.checked_sub(1)).collect()
}

/// Fraction of `steps` that evaluate the test set.
pub fn evaluated_fraction(steps: u32) -> f64 {
    evaluated_steps(steps).len() as f64 / f64::from(steps.max(1))
}

impl OuterLoop {
    /// Adam's rate on α in an outer step (mm): constant in protocol `paper`, else falling over the second half.
    pub(super) fn rate_of(&self, step: u32) -> f64 {
        let left = 1.0 - f64::from(step) / f64::from(self.iterations);
        match self.protocol {
            TrainingProtocol::Paper(_) => self.rate,
            _ => self.rate * (2.0 * left + 0.05).min(1.0),
        }
    }

    /// Adam's β₂ on α, and whether gradients are scaled to length 1. With a continued network they vary greatly, and a few large
    /// ones would keep the steps small for long. Protocol `paper` does not scale them.
    pub(super) fn scaling(&self) -> (f64, bool) {
        match self.protocol {
            TrainingProtocol::Paper(_) => (0.999, false),
            _ => (0.99, true),
        }
    }

    /// Whether a step moves the body: the last one only evaluates it.
    pub(super) fn moves_body(&self, step: u32) -> bool {
        step + 1 < self.iterations
    }

    /// Whether a step evaluates the test set.
    pub(super) fn looks_at_test(&self, step: u32) -> bool {
        evaluated_steps(self.iterations).contains(&step)
    }
}

impl Problem {
    /// Fraction of the work that is done after `steps` outer steps.
    pub(super) fn progress(&self, steps: u32) -> f64 {
        let evaluation = self.bodies_compared() * self.evaluation_iterations();
        let evaluation = evaluation as f64 / self.brain.iterations as f64;
        let loop_iterations = f64::from(self.optimise.iterations) * self.step_share();
        f64::from(steps) * self.step_share() / (loop_iterations + evaluation)
    }

    /// Those of the initial and the best body that are compared: the best, and the initial one if it differs and is requested.
    pub(super) fn compared<'a, T>(&self, both: &'a [T; 2]) -> &'a [T] {
        match self.optimise.iterations {
            0 => &both[..1],
            _ => &both[usize::from(!self.evaluation.initial)..],
        }
    }

    /// Number of bodies compared.
    pub(super) fn bodies_compared(&self) -> usize {
        self.compared(&[(); 2]).len()
    }

    /// Decoder iterations of the final comparison per body.
    pub(super) fn evaluation_iterations(&self) -> usize {
        let casts = self.evaluation.casts * self.linear_iterations();
        casts
            + self.network_of_casts()
            + match self.decoder_kind {
                reader if reader.is_network() => {
                    self.evaluation.seeds * (self.brain.iterations + self.evaluation.long.unwrap_or(0))
                }
                _ => self.linear_iterations(),
            }
    }

    /// Iterations of the network that is trained on casts of a body.
    pub(super) fn network_of_casts(&self) -> usize {
        let any = self.evaluation.casts > 0 && self.decoder_kind.is_network();
        if any { self.brain.iterations } else { 0 }
    }

    /// Iterations that the cost of a linear decoder, per body or cast, corresponds to.
    pub(super) fn linear_iterations(&self) -> usize {
        self.brain.iterations.div_ceil(20)
    }

    /// Work of an outer step relative to a full training.
    fn step_share(&self) -> f64 {
        match self.optimise.protocol {
            TrainingProtocol::Paper(_) => 1.0,
            TrainingProtocol::Random(_) => 0.1,
            TrainingProtocol::Joint(_) => 0.05,
        }
    }
}
