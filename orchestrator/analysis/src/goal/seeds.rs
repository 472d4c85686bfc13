//! What fresh seeds show of a body: whether it is worth confirming, and whether it is confirmed.
//!
//! A body is screened on `goal.fresh` seeds, then confirmed on twice as many others. The confirming seeds decide nothing but whether
//! the body passes, so that neither the choice among candidates nor earlier looks make their errors look better than they are.
//!
//! ```text
//! y_1 … y_n = ln error on the n confirming seeds;  p = P(t_{n−1} ≤ (ln limit − ȳ)/(s √(1 + 1/n)))     prediction of a further seed
//! passes: 1 − p ≤ (1 − confidence)/2^(j+1)       j confirmations were begun before this one
//! ```
//! The first confirmation may spend half of the risk 1 − confidence, each later one half of what is left. The j-th one passes a body
//! that misses the requirement on a further seed with a probability of at most its share, so that a search names such a design with a
//! probability of at most 1 − confidence, however many bodies it confirms, if ln error of a body is normal from seed to seed.

use metasense_numerics::student::{chance_above, student_above};
use metasense_numerics::trial::FAILED;
use metasense_schemas::spec::Goal;

use super::super::numbers::{deviation, mean};
use super::Candidate;

/// Least standard deviation of ln error from seed to seed: four seeds that agree by chance are not sure for ever.
const DEVIATION_MIN: f64 = 0.02;
/// Standard deviation of ln error from seed to seed before any body was screened, held as surely as by so many degrees of freedom.
/// Of 0.05 and 0.1 on made-up spaces neither was better.
const DEVIATION: f64 = 0.1;
const FREEDOM: usize = 3;

/// Fresh seeds that confirm a body.
#[must_use]
pub fn confirming(goal: &Goal) -> usize {
    2 * goal.fresh
}

/// Fresh seeds that a body is read on at most: those that screen it, then those that confirm it.
#[must_use]
pub fn most_fresh(goal: &Goal) -> usize {
    goal.fresh + confirming(goal)
}

/// What fresh seeds have shown of a candidate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Judgement {
    /// It was not screened.
    None,
    /// It was screened, not confirmed.
    Screened,
    /// It has passed: on a further seed it meets the requirement with at least this probability.
    Passed(f64),
    /// It has not passed.
    Failed,
}

/// How a candidate stands on fresh seeds.
pub(super) fn judged(goal: &Goal, candidate: &Candidate) -> Judgement {
    match candidate.turn {
        Some(turn) if candidate.fresh.len() >= most_fresh(goal) => {
            let chance = chance_confirmed(goal.error.ln(), turn, &candidate.fresh[goal.fresh..]);
            if chance >= goal.confidence { Judgement::Passed(chance) } else { Judgement::Failed }
        }
        _ if candidate.fresh.len() >= goal.fresh => Judgement::Screened,
        _ => Judgement::None,
    }
}

/// Errors (%) on the seeds that say most of a body: those that confirm it, else those that screen it.
pub(super) fn latest<'a>(goal: &Goal, candidate: &'a Candidate) -> &'a [f64] {
    let confirmed = candidate.turn.is_some() && candidate.fresh.len() >= most_fresh(goal);
    if confirmed { &candidate.fresh[goal.fresh..] } else { screening(goal, candidate) }
}

/// Errors (%) on the seeds that screen a body.
fn screening<'a>(goal: &Goal, candidate: &'a Candidate) -> &'a [f64] {
    &candidate.fresh[..candidate.fresh.len().min(goal.fresh)]
}

/// Probability that ln error on a further seed is at most `limit`, by errors (%) on fresh ones: Student's t.
pub(super) fn chance_below(limit: f64, fresh: &[f64]) -> f64 {
    let ((mean, deviation), n) = (of_seeds(fresh), fresh.len() as f64);
    chance_above(fresh.len() - 1, (mean - limit) / (deviation * (1.0 + 1.0 / n).sqrt()))
}

/// The same by confirming seeds, corrected for the other confirmations.
pub(super) fn chance_confirmed(limit: f64, turn: usize, fresh: &[f64]) -> f64 {
    (1.0 - (1.0 - chance_below(limit, fresh)) / share(turn)).max(0.0)
}

/// The share of the risk that a confirmation may spend after so many others.
fn share(turn: usize) -> f64 {
    0.5f64.powi(turn.min(1000) as i32 + 1) // above 0
}

/// Mean and standard deviation of ln error.
pub(super) fn of_seeds(fresh: &[f64]) -> (f64, f64) {
    let logs: Vec<f64> = fresh.iter().map(|e| e.ln()).collect();
    (mean(&logs).expect("it was judged"), deviation(&logs).unwrap_or(0.0).max(DEVIATION_MIN))
}

/// What a body's own result tells of fresh seeds, learnt from the bodies that were screened.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Seeds {
    /// Mean ln error on fresh seeds, less that of the result: a body may owe part of it to its own seed.
    pub shift: f64,
    /// Standard deviation of that, and of ln error from seed to seed.
    about: f64,
    pub between: f64,
    /// Degrees of freedom of the first.
    freedom: usize,
    /// ln of the error that is required.
    error: f64,
    /// Fresh seeds of the next confirmation, and how many deviations below the requirement their mean must lie.
    confirming: usize,
    margin: f64,
}

impl Seeds {
    /// `turn`: confirmations that were begun.
    pub fn of(goal: &Goal, candidates: &[Candidate], turn: usize) -> Self {
        let (mut shifts, mut logs_between, mut freedom) = (Vec::new(), 0.0, 0);
        for candidate in candidates {
            // a failure is that of one body, and tells nothing of others
            let known = screening(goal, candidate).iter().filter(|e| **e < FAILED);
            let logs: Vec<f64> = known.map(|e| e.ln()).collect();
            let Some(middle) = mean(&logs) else { continue };
            if let Some(deviation) = deviation(&logs) {
                // by the logarithm, less its bias (that of ln χ): bodies whose seeds are far apart are held against few others
                let of = (logs.len() - 1) as f64;
                logs_between += of * deviation.max(DEVIATION_MIN).ln() + 0.5 + 1.0 / (6.0 * of);
                freedom += logs.len() - 1;
            }
            shifts.extend(candidate.reached.last().copied().flatten().map(|own| middle - own.ln()));
        }
        let shift = shifts.iter().sum::<f64>() / (shifts.len() + 1) as f64;
        let before = FREEDOM as f64;
        let squares: f64 = shifts.iter().map(|s| (s - shift).powi(2)).sum();
        let about = ((before * DEVIATION.powi(2) + squares) / (FREEDOM + shifts.len()) as f64).sqrt();
        let between = ((before * DEVIATION.ln() + logs_between) / (FREEDOM + freedom) as f64).exp();
        let (confirming, risk) = (confirming(goal), (1.0 - goal.confidence) * share(turn));
        let margin = student_above(confirming - 1, risk) * (1.0 + 1.0 / confirming as f64).sqrt();
        let freedom = FREEDOM + shifts.len();
        Self { shift, about, between, freedom, error: goal.error.ln(), confirming, margin }
    }

    /// Probability that a body of this ln result will be confirmed.
    pub fn confirms(&self, result: f64) -> f64 {
        let limit = self.error - self.margin * self.between;
        1.0 - chance_above(self.freedom, (limit - self.shift - result) / self.about)
    }

    /// The same of a screened body by its errors (%): the scatter of its own seeds counts beside that of others.
    pub fn confirms_screened(&self, fresh: &[f64]) -> f64 {
        let ((mean, own), n) = (of_seeds(fresh), fresh.len() as f64);
        let before = FREEDOM as f64;
        let squares = before * self.between.powi(2) + (n - 1.0) * own.powi(2);
        let between = (squares / (before + n - 1.0)).sqrt();
        let apart = between * (1.0 / n + 1.0 / self.confirming as f64).sqrt();
        let limit = self.error - self.margin * between;
        1.0 - chance_above(FREEDOM + fresh.len() - 1, (limit - mean) / apart)
    }

    /// Probability that it has at most this ln error on a further seed.
    pub fn below(&self, limit: f64, result: f64) -> f64 {
        1.0 - chance_above(self.freedom, (limit - self.shift - result) / self.about.hypot(self.between))
    }
}
