//! Screening and confirmation of trained bodies on fresh seeds.
//!
//! A body is screened on `goal.fresh` seeds and confirmed on twice as many others. These serve only to confirm, so that
//! selection among candidates does not bias their errors.
//! ```text
//! y_1 … y_n = ln error on the n confirming seeds;  p = P(t_{n−1} ≤ (ln limit − ȳ)/(s √(1 + 1/n)))     prediction of a further seed
//! passes: 1 − p ≤ (1 − confidence)/2^(j+1)       j confirmations were begun before this one
//! ```
//! The shares of the risk sum to at most 1 − confidence. If ln error is normal over seeds, at most this fraction of searches
//! names a design that misses the requirement on a further seed, for any number of confirmations.

use metasense_numerics::student::{chance_above, student_above};
use metasense_numerics::trial::FAILED;
use metasense_schemas::spec::Goal;

use super::super::numbers::{deviation, mean};
use super::Candidate;

/// Smallest standard deviation of ln error between seeds: a few seeds can agree by chance.
const DEVIATION_MIN: f64 = 0.02;
/// Prior standard deviation of ln error between seeds, and its degrees of freedom.
const DEVIATION: f64 = 0.1;
const FREEDOM: usize = 3;

/// Number of seeds that confirm a body.
pub fn confirming(goal: &Goal) -> usize {
    2 * goal.fresh
}

/// Largest number of fresh seeds per body: screening and confirming seeds.
pub fn most_fresh(goal: &Goal) -> usize {
    goal.fresh + confirming(goal)
}

/// Result of a candidate on fresh seeds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Judgement {
    /// Not screened.
    None,
    /// Screened, not confirmed.
    Screened,
    /// Passed: the probability that it meets the requirement on a further seed.
    Passed(f64),
    /// Not passed.
    Failed,
}

/// Returns the result of a candidate on fresh seeds.
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

/// Returns the errors (%) on the confirming seeds, or on the screening seeds if these are missing.
pub(super) fn latest<'a>(goal: &Goal, candidate: &'a Candidate) -> &'a [f64] {
    let confirmed = candidate.turn.is_some() && candidate.fresh.len() >= most_fresh(goal);
    if confirmed { &candidate.fresh[goal.fresh..] } else { screening(goal, candidate) }
}

/// Returns the errors (%) on the screening seeds.
fn screening<'a>(goal: &Goal, candidate: &'a Candidate) -> &'a [f64] {
    &candidate.fresh[..candidate.fresh.len().min(goal.fresh)]
}

/// Returns the probability that ln error on a further seed is at most `limit`, given errors (%) on fresh seeds: Student's t.
pub(super) fn chance_below(limit: f64, fresh: &[f64]) -> f64 {
    let ((mean, deviation), n) = (log_mean_deviation(fresh), fresh.len() as f64);
    chance_above(fresh.len() - 1, (mean - limit) / (deviation * (1.0 + 1.0 / n).sqrt()))
}

/// The same from confirming seeds, corrected for multiple confirmations.
pub(super) fn chance_confirmed(limit: f64, turn: usize, fresh: &[f64]) -> f64 {
    (1.0 - (1.0 - chance_below(limit, fresh)) / share(turn)).max(0.0)
}

/// Share of the risk that a confirmation may spend after `turn` others.
fn share(turn: usize) -> f64 {
    0.5f64.powi(turn.min(1000) as i32 + 1) // above 0
}

/// Returns mean and standard deviation of ln error.
pub(super) fn log_mean_deviation(fresh: &[f64]) -> (f64, f64) {
    let logs: Vec<f64> = fresh.iter().map(|e| e.ln()).collect();
    (mean(&logs).expect("it was judged"), deviation(&logs).unwrap_or(0.0).max(DEVIATION_MIN))
}

/// Distribution of errors on fresh seeds, given the result of a body; estimated from screened bodies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Seeds {
    /// Mean of ln error on fresh seeds minus ln error of the result. Training may fit its own seed.
    pub shift: f64,
    /// Standard deviations of this difference between bodies, and of ln error between seeds.
    about: f64,
    pub between: f64,
    /// Degrees of freedom of `about`.
    freedom: usize,
    /// ln of the required error.
    error: f64,
    /// Number of confirming seeds, and the distance of their mean below the requirement that a confirmation needs (standard
    /// deviations).
    confirming: usize,
    margin: f64,
}

impl Seeds {
    /// Estimates the distribution. `turn`: number of confirmations begun.
    pub fn of(goal: &Goal, candidates: &[Candidate], turn: usize) -> Self {
        let (mut shifts, mut logs_between, mut freedom) = (Vec::new(), 0.0, 0);
        for candidate in candidates {
            // a failure concerns only its own body
            let known = screening(goal, candidate).iter().filter(|e| **e < FAILED);
            let logs: Vec<f64> = known.map(|e| e.ln()).collect();
            let Some(middle) = mean(&logs) else { continue };
            if let Some(deviation) = deviation(&logs) {
                // means of logarithms (minus the bias, that of ln χ) are robust to few bodies with a large scatter
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

    /// Probability that a body with this ln error as result will be confirmed.
    pub fn confirms(&self, result: f64) -> f64 {
        let limit = self.error - self.margin * self.between;
        1.0 - chance_above(self.freedom, (limit - self.shift - result) / self.about)
    }

    /// The same for a screened body with these errors (%). Its own scatter is pooled with that of others.
    pub fn confirms_screened(&self, fresh: &[f64]) -> f64 {
        let ((mean, own), n) = (log_mean_deviation(fresh), fresh.len() as f64);
        let before = FREEDOM as f64;
        let squares = before * self.between.powi(2) + (n - 1.0) * own.powi(2);
        let between = (squares / (before + n - 1.0)).sqrt();
        let apart = between * (1.0 / n + 1.0 / self.confirming as f64).sqrt();
        let limit = self.error - self.margin * between;
        1.0 - chance_above(FREEDOM + fresh.len() - 1, (limit - mean) / apart)
    }

    /// Probability that such a body has at most this ln error on a further seed.
    pub fn below(&self, limit: f64, result: f64) -> f64 {
        1.0 - chance_above(self.freedom, (limit - self.shift - result) / self.about.hypot(self.between))
    }
}
