//! The elbow of error against the number of sensors: where more of them stop to pay.
//!
//! ```text
//! ln e = A_cluster + b·min(M, m) + c·max(M − m, 0)       broken stick, m one of the inner M
//! ```
//! by least squares; the cluster's own level A takes out that one placement is better than another at every M. There is
//! an elbow where the stick beats the straight line by BIC, falls before m and falls at most half as fast after it.
//! Kneedle (Satopää et al. 2011) and the chord's farthest point stand beside it. Votes by bootstrap.

use super::data::{Level, levels, places};
use super::{Cluster, Interval, Observation, Resampling};

/// Values of M below which no elbow is sought: a stick has three parameters and a place.
pub const LEAST_VALUES: usize = 4;

/// The most of its fall before the elbow that the error may keep after it.
const FALL_KEPT: f64 = 0.5;

/// The share of votes that decides.
const MAJORITY: f64 = 0.5;

/// What the votes come to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Verdict {
    /// More than half of the replicates have it here.
    At(f64),
    /// More than half of the replicates have none.
    NoElbow,
    /// No place and no absence has more than half; the most votes went here.
    Undecided(f64),
    /// Too few placements and seeds for votes; the fit itself has it here, or none.
    WithoutVote(Option<f64>),
}

/// The elbow of one curve.
#[derive(Debug, Clone, PartialEq)]
pub struct Elbow {
    /// Error at each M.
    pub levels: Vec<Level>,
    /// Where all the data have the broken stick's elbow; `None`: no elbow.
    pub broken_stick: Option<f64>,
    /// The same without the largest M, where four are left.
    pub without_largest: Option<Option<f64>>,
    /// Kneedle's, on the mean error.
    pub kneedle: Option<f64>,
    /// The point farthest below the chord, on the logarithm of the mean error.
    pub chord: Option<f64>,
    /// Share of the replicates' votes for each M; the rest found no elbow.
    pub votes: Vec<(f64, f64)>,
    /// Error at M over error at the next M, within clusters, with its interval.
    pub gains: Vec<Gain>,
    /// What it comes to.
    pub verdict: Verdict,
    /// The units that votes and intervals are over, or that are too few.
    pub over: String,
}

/// What further sensors bring.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gain {
    /// From this M.
    pub from: f64,
    /// To this one, the next.
    pub to: f64,
    /// Error before over error after; above 1 is better.
    pub ratio: f64,
    /// Its 95 % interval, where there are units enough.
    pub interval: Option<Interval>,
}

/// Too few values of M to look for an elbow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("an elbow needs at least {LEAST_VALUES} values of M, there are {0}")]
pub struct TooFew(pub usize);

/// Finds the elbow of error against M.
///
/// # Errors
/// Where there are fewer than four values of M.
pub fn elbow(observations: &[Observation]) -> Result<Elbow, TooFew> {
    let at = places(observations);
    if at.len() < LEAST_VALUES {
        return Err(TooFew(at.len()));
    }
    let levels = levels(observations);
    let clusters: Vec<Cluster> = observations.iter().map(|o| o.cluster).collect();
    let resampling = Resampling::new(&clusters);
    let curve = Curve::new(observations);
    let broken_stick = curve.broken_stick(&vec![1.0; observations.len()]);
    let replicates = resampling.replicates(|weights| Some(curve.broken_stick(&weights)));
    let share = |place: Option<f64>| {
        replicates.iter().filter(|r| **r == place).count() as f64 / replicates.len().max(1) as f64
    };
    let votes: Vec<(f64, f64)> = at[1..at.len() - 1].iter().map(|&m| (m, share(Some(m)))).collect();
    let verdict = if replicates.is_empty() {
        Verdict::WithoutVote(broken_stick)
    } else if share(None) > MAJORITY {
        Verdict::NoElbow
    } else {
        let first = votes.iter().copied().fold((at[1], 0.0), |a, b| if b.1 > a.1 { b } else { a });
        if first.1 > MAJORITY { Verdict::At(first.0) } else { Verdict::Undecided(first.0) }
    };
    let largest = at[at.len() - 1];
    let without_largest = (at.len() > LEAST_VALUES).then(|| {
        curve.broken_stick(
            &observations.iter().map(|o| f64::from(u8::from(o.at < largest))).collect::<Vec<_>>(),
        )
    });
    Ok(Elbow {
        broken_stick,
        without_largest,
        kneedle: kneedle(&levels),
        chord: chord(&levels),
        votes,
        gains: gains(observations),
        verdict,
        over: resampling.over(),
        levels,
    })
}

/// Sums of a regression without intercept on two columns.
#[derive(Default, Clone, Copy)]
struct Normal {
    aa: f64,
    ab: f64,
    bb: f64,
    ay: f64,
    by: f64,
    yy: f64,
}

impl Normal {
    /// Slopes and residual sum of squares; the second column may be absent (all zero).
    fn solve(&self) -> ([f64; 2], f64) {
        let determinant = self.aa * self.bb - self.ab * self.ab;
        let slopes = if determinant > 1e-12 * self.aa * self.bb && self.bb > 0.0 {
            [
                (self.bb * self.ay - self.ab * self.by) / determinant,
                (self.aa * self.by - self.ab * self.ay) / determinant,
            ]
        } else if self.aa > 0.0 {
            [self.ay / self.aa, 0.0]
        } else {
            [0.0, 0.0]
        };
        let residual = self.yy - slopes[0] * self.ay - slopes[1] * self.by;
        (slopes, residual)
    }
}

/// What the fit needs of the observations: cluster, M and ln e of each.
struct Curve {
    clusters: usize,
    points: Vec<(usize, f64, f64)>,
}

impl Curve {
    fn new(observations: &[Observation]) -> Self {
        let mut clusters: Vec<Cluster> = observations.iter().map(|o| o.cluster).collect();
        clusters.sort_unstable();
        clusters.dedup();
        let find = |c: &Cluster| clusters.binary_search(c).expect("collected above");
        let points = observations.iter().map(|o| (find(&o.cluster), o.at, o.error.ln())).collect();
        Self { clusters: clusters.len(), points }
    }

    /// Weighted normal equations of ln e on two columns, each centred within its cluster.
    fn normal(&self, weights: &[f64], columns: impl Fn(f64) -> [f64; 2]) -> Normal {
        let mut means = vec![[0.0; 4]; self.clusters];
        for (&(cluster, at, y), &w) in self.points.iter().zip(weights) {
            let [a, b] = columns(at);
            for (m, v) in means[cluster].iter_mut().zip([1.0, a, b, y]) {
                *m += w * v;
            }
        }
        let mut sums = Normal::default();
        for (&(cluster, at, y), &w) in self.points.iter().zip(weights).filter(|(_, w)| **w > 0.0) {
            let [n, a, b, mean] = means[cluster];
            let [ca, cb] = columns(at);
            let (a, b, y) = (ca - a / n, cb - b / n, y - mean / n);
            sums.aa += w * a * a;
            sums.ab += w * a * b;
            sums.bb += w * b * b;
            sums.ay += w * a * y;
            sums.by += w * b * y;
            sums.yy += w * y * y;
        }
        sums
    }

    /// The broken stick's elbow, if there is one.
    fn broken_stick(&self, weights: &[f64]) -> Option<f64> {
        let mut at: Vec<f64> =
            self.points.iter().zip(weights).filter(|(_, w)| **w > 0.0).map(|(p, _)| p.1).collect();
        at.sort_by(f64::total_cmp);
        at.dedup();
        if at.len() < LEAST_VALUES {
            return None;
        }
        let n: f64 = weights.iter().sum();
        let line = self.normal(weights, |m| [m, 0.0]);
        let (_, line_residual) = line.solve();
        let mut best: Option<(f64, [f64; 2], f64)> = None;
        for &place in &at[1..at.len() - 1] {
            let (slopes, residual) = self.normal(weights, |m| [m.min(place), (m - place).max(0.0)]).solve();
            if best.is_none_or(|(_, _, least)| residual < least) {
                best = Some((place, slopes, residual));
            }
        }
        let (place, [before, after], residual) = best?;
        // Residuals below rounding are the same residual.
        let floor = 1e-12 * line.yy + f64::MIN_POSITIVE;
        let information =
            |residual: f64, parameters: f64| n * (residual.max(floor) / n).ln() + parameters * n.ln();
        let bends = information(residual, 3.0) < information(line_residual, 1.0);
        (bends && before < 0.0 && after >= FALL_KEPT * before).then_some(place)
    }
}

/// Kneedle for a falling, convex curve, sensitivity 1: the first local maximum of how far the normalised curve lies
/// below its diagonal that is not surpassed before the distance has dropped by a mean step.
fn kneedle(levels: &[Level]) -> Option<f64> {
    let (first, last) = (levels.first()?, levels.last()?);
    let most = levels.iter().map(|l| l.mean).fold(f64::NEG_INFINITY, f64::max);
    let least = levels.iter().map(|l| l.mean).fold(f64::INFINITY, f64::min);
    if most <= least {
        return None;
    }
    let below: Vec<f64> = levels
        .iter()
        .map(|l| (most - l.mean) / (most - least) - (l.at - first.at) / (last.at - first.at))
        .collect();
    let step = 1.0 / (levels.len() - 1) as f64;
    let mut candidate: Option<usize> = None;
    for i in 1..levels.len() {
        let rises_to = below[i] > below[i - 1] && (i + 1 == levels.len() || below[i] >= below[i + 1]);
        if rises_to && i + 1 < levels.len() && candidate.is_none_or(|c| below[i] > below[c]) {
            candidate = Some(i);
        }
        if let Some(c) = candidate
            && i > c
            && below[i] < below[c] - step
        {
            return Some(levels[c].at);
        }
    }
    None
}

/// The inner point farthest below the straight line from the first point to the last, in ln e.
fn chord(levels: &[Level]) -> Option<f64> {
    let (first, last) = (levels.first()?, levels.last()?);
    let slope = (last.mean.ln() - first.mean.ln()) / (last.at - first.at);
    let mut best = (None, 1e-9);
    for level in &levels[1..levels.len() - 1] {
        let below = first.mean.ln() + slope * (level.at - first.at) - level.mean.ln();
        if below > best.1 {
            best = (Some(level.at), below);
        }
    }
    best.0
}

/// What each further sensor brings.
pub(super) fn gains(observations: &[Observation]) -> Vec<Gain> {
    let clusters: Vec<Cluster> = observations.iter().map(|o| o.cluster).collect();
    let resampling = Resampling::new(&clusters);
    places(observations).windows(2).map(|w| gain(observations, w[0], w[1], &resampling)).collect()
}

fn gain(observations: &[Observation], from: f64, to: f64, resampling: &Resampling) -> Gain {
    let mean = |weights: &[f64]| {
        let (mut sum, mut n) = (0.0, 0.0);
        for (i, o) in observations.iter().enumerate().filter(|(_, o)| o.at == from) {
            let after = observations.iter().find(|p| p.at == to && p.cluster == o.cluster);
            if let Some(after) = after {
                sum += weights[i] * (o.error / after.error).ln();
                n += weights[i];
            }
        }
        (n > 0.0).then_some(sum / n)
    };
    Gain {
        from,
        to,
        ratio: mean(&vec![1.0; observations.len()]).map_or(f64::NAN, f64::exp),
        interval: resampling.interval(|weights| mean(weights)).map(|i| i.map(f64::exp)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::resample::Draw;

    /// Observations of a curve at M = 1…6 for five placements and two seeds, each with a level of its own and noise.
    fn curve(error: impl Fn(f64) -> f64, noise: f64) -> Vec<Observation> {
        let mut draw = Draw::new(11, 0);
        let mut all = Vec::new();
        for placement in 0..5 {
            for seed in 0..2 {
                let level = (0.2 * draw.normal()).exp();
                for m in 1..=6 {
                    let error = error(f64::from(m)) * level * (noise * draw.normal()).exp();
                    all.push(Observation { at: f64::from(m), cluster: Cluster { placement, seed }, error });
                }
            }
        }
        all
    }

    #[test]
    fn a_curve_that_bends_at_two_has_its_elbow_there() {
        let found = elbow(&curve(|m| 20.0 * (-1.2 * m.min(2.0) - 0.05 * m).exp(), 0.05)).unwrap();
        assert_eq!(found.verdict, Verdict::At(2.0), "{found:?}");
        assert_eq!((found.broken_stick, found.kneedle, found.chord), (Some(2.0), Some(2.0), Some(2.0)));
        assert_eq!(found.without_largest, Some(Some(2.0)));
        let total: f64 = found.votes.iter().map(|v| v.1).sum();
        assert!(found.votes[0].1 > 0.95 && total <= 1.0, "{:?}", found.votes);
    }

    #[test]
    fn a_curve_that_bends_at_four_has_its_elbow_there() {
        let found = elbow(&curve(|m| 30.0 * (-0.6 * m.min(4.0)).exp(), 0.08)).unwrap();
        assert_eq!(found.verdict, Verdict::At(4.0), "{found:?}");
    }

    #[test]
    fn a_straight_fall_and_a_flat_curve_have_no_elbow() {
        for (slope, noise) in [(0.3, 0.05), (0.0, 0.05), (0.3, 0.0)] {
            let found = elbow(&curve(|m| 20.0 * (-slope * m).exp(), noise)).unwrap();
            assert_eq!(found.verdict, Verdict::NoElbow, "slope {slope}, noise {noise}: {found:?}");
        }
    }

    /// The true gain is e^0.5 before the elbow and 1 after it.
    #[test]
    fn gains_are_paired_within_clusters() {
        let found = elbow(&curve(|m| 20.0 * (-0.5 * m.min(3.0)).exp(), 0.02)).unwrap();
        for gain in &found.gains {
            let truth = if gain.from < 3.0 { 0.5f64.exp() } else { 1.0 };
            let interval = gain.interval.unwrap();
            assert!((gain.ratio / truth - 1.0).abs() < 0.03, "{gain:?}");
            assert!(interval.high / interval.low < 1.1, "{gain:?}");
        }
    }

    #[test]
    fn three_values_of_m_are_too_few() {
        let few: Vec<Observation> = curve(|m| 20.0 / m, 0.0).into_iter().filter(|o| o.at < 3.5).collect();
        assert_eq!(elbow(&few), Err(TooFew(3)));
    }

    #[test]
    fn one_placement_and_seed_gives_a_fit_without_votes() {
        let one: Vec<Observation> = curve(|m| 20.0 * (-m.min(2.0)).exp(), 0.0)
            .into_iter()
            .filter(|o| o.cluster == Cluster::default())
            .collect();
        let found = elbow(&one).unwrap();
        assert_eq!(found.verdict, Verdict::WithoutVote(Some(2.0)), "{found:?}");
        assert!(found.gains.iter().all(|g| g.interval.is_none()));
    }
}
