//! How an outer loop goes over its steps: rates, looks at the test set, and the part that is done.

use crate::trial::{CastReader, Optimise, Problem, Protocol};

/// Parts of a loop after which a search for a design may stop a trial.
pub const RUNGS: [f64; 2] = [1.0 / 9.0, 1.0 / 3.0];
/// Parts of a loop after which a design is evaluated on the test set, where the protocol does not need it anyway. The rate falls, so the
/// best design is nearly always among the last ones.
const LOOKS: [f64; 5] = [0.0, RUNGS[0], RUNGS[1], 0.6, 0.8];
/// Steps of which their steps are multiples.
const APART: u32 = 10;

/// The multiple of `APART` nearest to a part of so many steps; not 0 unless the part is.
pub fn look_near(steps: u32, part: f64) -> u32 {
    let nearest = (f64::from(steps) * part / f64::from(APART)).round() as u32;
    nearest.max(u32::from(part > 0.0)) * APART
}

/// Whether a step of so many has an evaluation on the test set; the last one has.
fn is_look(steps: u32, step: u32) -> bool {
    step + 1 == steps || LOOKS.iter().any(|part| look_near(steps, *part) == step)
}

/// Share of so many steps that have one.
pub fn looked_at(steps: u32) -> f64 {
    (0..steps).filter(|step| is_look(steps, *step)).count() as f64 / f64::from(steps.max(1))
}

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

    /// Whether a step moves the body: the last one only evaluates it.
    pub(super) fn moves_body(&self, step: u32) -> bool {
        step + 1 < self.iterations
    }

    /// Whether a step looks at the test set: some do, and the last.
    pub(super) fn looks_at_test(&self, step: u32) -> bool {
        // a brain of its own for each cast knows too little of it for its error to choose a body by
        let each = self.casting.is_some_and(|casting| casting.reader == CastReader::Each);
        is_look(self.iterations, step) && !each || step + 1 == self.iterations
    }
}

impl Problem {
    /// The part of the work that is done after `steps` outer steps, in brain iterations.
    pub(super) fn progress(&self, steps: u32) -> f64 {
        let evaluation = self.bodies_compared() * self.evaluation_iterations();
        let evaluation = evaluation as f64 / self.brain.iterations as f64;
        let loop_iterations = f64::from(self.optimise.iterations) * self.step_share();
        f64::from(steps) * self.step_share() / (loop_iterations + evaluation)
    }

    /// Of the initial and the best body those that are compared: the best, and the initial one where it is another and asked for.
    pub(super) fn compared<'a, T>(&self, both: &'a [T; 2]) -> &'a [T] {
        match self.optimise.iterations {
            0 => &both[..1],
            _ => &both[usize::from(!self.evaluation.initial)..],
        }
    }

    /// So many.
    pub(super) fn bodies_compared(&self) -> usize {
        self.compared(&[(); 2]).len()
    }

    /// Brain iterations of the comparison at the end, a body.
    pub(super) fn evaluation_iterations(&self) -> usize {
        let casts = self.evaluation.casts * self.linear_iterations();
        casts
            + self.network_of_casts()
            + match self.reader {
                reader if reader.is_network() => {
                    self.evaluation.seeds * (self.brain.iterations + self.evaluation.long.unwrap_or(0))
                }
                _ => self.linear_iterations(),
            }
    }

    /// Iterations of the network that is trained on casts of a body.
    pub(super) fn network_of_casts(&self) -> usize {
        let any = self.evaluation.casts > 0 && self.reader.is_network();
        if any { self.brain.iterations } else { 0 }
    }

    /// What a linear brain on one body, or on a cast of it, is counted as.
    pub(super) fn linear_iterations(&self) -> usize {
        self.brain.iterations.div_ceil(20)
    }

    /// Work of an outer step relative to a full training.
    fn step_share(&self) -> f64 {
        match self.optimise.protocol {
            Protocol::Paper(_) => 1.0,
            Protocol::Random(_) => 0.1,
            Protocol::Joint(_) => 0.05,
        }
    }
}
