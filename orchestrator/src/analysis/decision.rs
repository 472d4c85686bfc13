//! How many sensors to build: a decision, where the elbow only describes the curve.
//!
//! ```text
//! within:  the smallest M with e(M) ≤ (1 + δ)·min e          price p:  argmin e(M) + p·M
//! ```
//! e(M) is the geometric mean of the error (%). Votes are shares of the bootstrap's replicates over placements and seeds. The
//! decision without the largest M shows whether it depends on how far M was tried.

use super::data::{Grid, Observation, clusters};
use super::resample::Resampling;

/// What a decision weighs.
#[derive(Debug, Clone, Copy, PartialEq, clap::Args)]
pub struct Terms {
    /// Shows the smallest M whose error is at most this part above the least, beside the elbow
    #[arg(long, value_name = "PART", default_value_t = Self::default().within, value_parser = at_least_zero)]
    pub within: f64,
    /// Price of a sensor in % of error: shows the M of least error + price × M beside the elbow
    #[arg(long, value_name = "PERCENT", value_parser = at_least_zero)]
    pub price: Option<f64>,
}

impl Default for Terms {
    fn default() -> Self {
        Self { within: 0.1, price: None }
    }
}

fn at_least_zero(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|x| x.is_finite() && *x >= 0.0);
    number.ok_or_else(|| "must be a number, 0 or more".into())
}

/// An M that is decided for.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// By all trials.
    pub at: f64,
    /// Share of votes for each M; `None` where there are too few units.
    pub votes: Option<Vec<(f64, f64)>>,
    /// By all trials but those with the largest M.
    pub without_largest: f64,
}

impl Decision {
    /// The share of votes for an M.
    #[must_use]
    pub fn share(&self, m: f64) -> Option<f64> {
        Some(self.votes.as_ref()?.iter().find(|v| v.0 == m)?.1)
    }
}

/// Both decisions.
#[derive(Debug, Clone, PartialEq)]
pub struct Decisions {
    /// The smallest M within δ of the best.
    pub within: Decision,
    /// Where a sensor has a price.
    pub priced: Option<Decision>,
    /// The units that votes are over, or that are too few.
    pub over: String,
}

/// M with the mean error there (%).
type Means = [(f64, f64)];

/// Decides on M; `None` of fewer than two.
#[must_use]
pub fn decide(observations: &[Observation], terms: Terms) -> Option<Decisions> {
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
    let all = means(&vec![1.0; clusters.len()]);
    let replicates = units.replicates(|weights| Some(means(&weights)));
    let decision = |rule: &dyn Fn(&Means) -> f64| {
        let chosen: Vec<f64> = replicates.iter().map(|means| rule(means)).collect();
        let share = |m: f64| chosen.iter().filter(|c| **c == m).count() as f64 / chosen.len() as f64;
        Decision {
            at: rule(&all),
            votes: (!chosen.is_empty()).then(|| at.iter().map(|m| (*m, share(*m))).collect()),
            without_largest: rule(&all[..all.len() - 1]),
        }
    };
    let least = |means: &Means, cost: &dyn Fn(&(f64, f64)) -> f64| {
        means.iter().min_by(|a, b| cost(a).total_cmp(&cost(b))).copied().expect("two M at least")
    };
    let within = |means: &Means| {
        let bar = (1.0 + terms.within) * least(means, &|m| m.1).1;
        means.iter().find(|m| m.1 <= bar).expect("the best is within").0
    };
    Some(Decisions {
        within: decision(&within),
        priced: terms.price.map(|price| decision(&|means| least(means, &|m| m.1 + price * m.0).0)),
        over: units.over(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::Cluster;

    fn curve(errors: &[f64], placements: u64) -> Vec<Observation> {
        let of = |placement: u64| {
            // a level of its own a placement, and one that decides nothing
            let level = 1.0 + 0.02 * placement as f64;
            let at = move |(i, e): (usize, &f64)| Observation {
                at: (i + 1) as f64,
                cluster: Cluster { placement, seed: 1 },
                error: e * level,
            };
            errors.iter().enumerate().map(at).collect::<Vec<_>>()
        };
        (0..placements).flat_map(of).collect()
    }

    /// 10.9 is within 10 % of 10, 12 is not; without the last the best is 10.9, of which 12 is just not 10 % off.
    #[test]
    fn the_smallest_within_ten_percent_and_what_it_hangs_on() {
        let errors = [30.0, 20.0, 12.0, 10.9, 10.0];
        let found = decide(&curve(&errors, 5), Terms::default()).unwrap();
        assert_eq!((found.within.at, found.within.without_largest), (4.0, 4.0), "{found:?}");
        assert_eq!((found.within.share(4.0), found.priced.clone()), (Some(1.0), None), "{found:?}");
        let falling = decide(&curve(&[16.0, 8.0, 4.0, 2.0], 5), Terms::default()).unwrap();
        assert_eq!((falling.within.at, falling.within.without_largest), (4.0, 3.0), "{falling:?}");
        let wide = decide(&curve(&errors, 5), Terms { within: 0.25, ..Terms::default() }).unwrap();
        assert_eq!(wide.within.at, 3.0, "{wide:?}");
    }

    /// Levels are 1 … 1.08, 1.04 in the mean. Falls of 10.4, 8.3, 1.1, 0.9: a sensor worth 1 % stops at the fourth, one worth
    /// 9 % at the second.
    #[test]
    fn a_sensor_has_its_price() {
        let of = |price| {
            let terms = Terms { price: Some(price), ..Terms::default() };
            decide(&curve(&[30.0, 20.0, 12.0, 10.9, 10.0], 5), terms).unwrap().priced.unwrap().at
        };
        assert_eq!([0.0, 1.0, 2.0, 9.0, 99.0].map(of), [5.0, 4.0, 3.0, 2.0, 1.0]);
    }

    /// Two of five placements need the fourth sensor, three do not: votes are split, and few placements have none.
    #[test]
    fn votes_are_split_where_placements_disagree() {
        let mut observations = curve(&[30.0, 20.0, 10.0, 10.0], 5);
        for o in observations.iter_mut().filter(|o| o.cluster.placement < 2 && o.at == 4.0) {
            o.error *= 0.8;
        }
        let found = decide(&observations, Terms::default()).unwrap();
        let [three, four] = [3.0, 4.0].map(|m| found.within.share(m).unwrap());
        assert!(three > 0.3 && four > 0.2 && (three + four - 1.0).abs() < 1e-12, "{found:?}");
        let few = decide(&curve(&[30.0, 20.0], 3), Terms::default()).unwrap();
        assert_eq!((few.within.votes, &few.over[..]), (None, "too few to tell: 3 placements"));
    }
}
