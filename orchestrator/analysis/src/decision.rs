//! Decisions on the number of sensors M. The elbow only describes the curve.
//!
//! ```text
//! within:  the smallest M with e(M) ≤ (1 + δ)·min e          price p:  argmin e(M) + p·M
//! fall f:  the smallest M with 100 − e(M) ≥ f·(100 − min e)  of the fall from 100 %, the error of the estimate zero
//! ```
//! e(M) is the geometric mean of the error (%). Votes are shares of bootstrap replicates over placements and seeds. The
//! decision without the largest M shows whether it depends on the range of M.

use super::data::{Grid, Observation, clusters};
use super::resample::Resampling;

/// Parameters of the decisions.
#[derive(Debug, Clone, Copy, PartialEq, clap::Args)]
pub struct DecisionTerms {
    /// Also shows the smallest M whose error is at most this fraction above the smallest error
    #[arg(long, value_name = "PART", default_value_t = Self::default().within, value_parser = at_least_zero, help_heading = "Decision on the number of sensors")]
    pub within: f64,
    /// Also shows the smallest M with this fraction of the fall from 100 % (no sensor) to the smallest error
    #[arg(long, value_name = "PART", default_value_t = Self::default().fall, value_parser = part, help_heading = "Decision on the number of sensors")]
    pub fall: f64,
    /// Price per sensor in % of error: also shows the M with the smallest error + price × M
    #[arg(long, value_name = "PERCENT", value_parser = at_least_zero, help_heading = "Decision on the number of sensors")]
    pub price: Option<f64>,
}

impl Default for DecisionTerms {
    fn default() -> Self {
        Self { within: 0.1, fall: 0.9, price: None }
    }
}

fn at_least_zero(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|x| x.is_finite() && *x >= 0.0);
    number.ok_or_else(|| "must be a number, 0 or more".into())
}

fn part(text: &str) -> Result<f64, String> {
    at_least_zero(text).ok().filter(|x| *x <= 1.0).ok_or_else(|| "must be a number from 0 to 1".into())
}

/// A chosen M.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// M chosen from all trials.
    pub at: f64,
    /// M and share of votes; `None` with too few units.
    pub votes: Option<Vec<(f64, f64)>>,
    /// M chosen from all trials except those with the largest M.
    pub without_largest: f64,
}

impl Decision {
    /// Returns the share of votes for an M.
    pub fn share(&self, m: f64) -> Option<f64> {
        Some(self.votes.as_ref()?.iter().find(|v| v.0 == m)?.1)
    }
}

/// All decisions.
#[derive(Debug, Clone, PartialEq)]
pub struct Decisions {
    /// The smallest M whose error is within δ of the smallest error.
    pub within: Decision,
    /// The smallest M with the required fraction of the fall.
    pub fall: Decision,
    /// M of least cost; `None` without a price per sensor.
    pub priced: Option<Decision>,
    /// Units of the votes, or why there are none.
    pub over: String,
}

/// M and mean error (%).
type Means = [(f64, f64)];

/// Decides on M; `None` with fewer than two values of M.
pub fn decisions(observations: &[Observation], terms: DecisionTerms) -> Option<Decisions> {
    let clusters = clusters(observations);
    let grid = Grid::new(observations, &clusters);
    let at = &grid.places;
    if at.len() < 2 {
        return None;
    }
    let units = Resampling::new(&clusters);
    let means = |weights: &[f64]| -> Vec<(f64, f64)> {
        at.iter().zip(grid.means(weights)).filter_map(|(m, mean)| Some((*m, mean?))).collect()
    };
    let all = means(&units.equal_weights());
    // in an incomplete sweep, a replicate may have no trial with some M: it has no vote
    let replicates = units.replicates(|weights| Some(means(&weights)).filter(|of| of.len() == at.len()));
    let decision = |rule: &dyn Fn(&Means) -> f64| {
        let chosen: Vec<f64> = replicates.iter().map(|means| rule(means)).collect();
        let share = |m: f64| chosen.iter().filter(|c| **c == m).count() as f64 / chosen.len() as f64;
        let votes = (!chosen.is_empty()).then(|| at.iter().map(|m| (*m, share(*m))).collect());
        Decision { at: rule(&all), votes, without_largest: rule(&all[..all.len() - 1]) }
    };
    let min_by_cost = |means: &Means, cost: &dyn Fn(&(f64, f64)) -> f64| {
        means.iter().min_by(|a, b| cost(a).total_cmp(&cost(b))).copied().expect("two M at least")
    };
    let within = |means: &Means| {
        let bar = (1.0 + terms.within) * min_by_cost(means, &|m| m.1).1;
        means.iter().find(|m| m.1 <= bar).expect("the best is within").0
    };
    let fall = |means: &Means| {
        let (best, error) = min_by_cost(means, &|m| m.1);
        let bar = 100.0 - terms.fall * (100.0 - error);
        means.iter().find(|m| m.1 <= bar).map_or(best, |m| m.0)
    };
    let priced = terms.price.map(|price| decision(&|means| min_by_cost(means, &|m| m.1 + price * m.0).0));
    Some(Decisions { within: decision(&within), fall: decision(&fall), priced, over: units.over() })
}

#[cfg(test)]
mod tests;
