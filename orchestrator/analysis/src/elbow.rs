//! The elbow of the error against the number of sensors M, beyond which further sensors gain little.
//!
//! ```text
//! y = A_cluster + b·min(M, m) + c·max(M − m, 0)       broken stick, m an inner M; y = e or ln e
//! y = A_cluster + b·ρᴹ                                alternative: a decay without a bend
//! ```
//! Both are least-squares fits. The level A per cluster removes differences between placements that are equal at every M. An
//! elbow exists if the stick has a smaller BIC than straight line and decay, falls before m, and falls at most half as fast
//! after m. Votes are by bootstrap. Kneedle (Satopää et al. 2011) and the point farthest from the chord are also reported.

use super::data::{Grid, Level, Observation, clusters, levels};
use super::paired::Ratio;
use super::resample::{Interval, Resampling};

/// Smallest number of values of M; a stick has three parameters and a place.
pub const LEAST_VALUES: usize = 4;

/// Largest slope after the elbow relative to that before it.
const FALL_KEPT: f64 = 0.5;

/// An answer needs a larger share of votes.
const MAJORITY: f64 = 0.5;

/// Values of ρ.
const DECAYS: [f64; 20] = [
    0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9,
    0.95,
];

/// Index of the first ρ that counts as smooth. Faster decays resemble a stick that bends at the second M.
const SMOOTH: usize = 7;

/// The quantity y. An error that falls by many factors bends early in %, and late in logarithms.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ErrorScale {
    /// The error (%).
    Percent,
    /// Its logarithm: equal factors are equal steps.
    Logarithm,
}

impl ErrorScale {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Percent, Self::Logarithm];

    /// In words.
    pub fn name(self) -> &'static str {
        ["in %", "in logarithms"][self as usize]
    }

    /// Returns y for ln e.
    pub(super) fn of(self, log: f64) -> f64 {
        match self {
            Self::Percent => log.exp(),
            Self::Logarithm => log,
        }
    }
}

/// Result of the votes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Verdict {
    /// More than half of the replicates have the elbow at this M.
    At(f64),
    /// More than half of the replicates have no elbow.
    NoElbow,
    /// No answer has more than half of the votes; this one (`None`: no elbow) has the most.
    Undecided(Option<f64>),
    /// Too few placements and seeds for votes; the elbow of the fit, if any.
    WithoutVote(Option<f64>),
}

/// The elbow of one curve.
#[derive(Debug, Clone, PartialEq)]
pub struct Elbow {
    /// Elbow of the broken stick from all data; `None`: no elbow.
    pub broken_stick: Option<f64>,
    /// The same without the largest M, if four values are left.
    pub without_largest: Option<Option<f64>>,
    /// The same with all M and decays of any speed as alternatives.
    pub any_decay: Option<f64>,
    /// Elbow by Kneedle, from the mean error.
    pub kneedle: Option<f64>,
    /// M of the mean error's point farthest below the chord.
    pub chord: Option<f64>,
    /// M and share of votes; the other replicates have no elbow.
    pub votes: Vec<(f64, f64)>,
    /// Gains from each M to the next.
    pub gains: Vec<Gain>,
    /// The result.
    pub verdict: Verdict,
    /// Units of votes and intervals, or why there are none.
    pub over: String,
}

impl Elbow {
    /// Share of the votes for an elbow at this M (`None`: for no elbow); `None` without votes.
    pub fn share(&self, place: Option<f64>) -> Option<f64> {
        if matches!(self.verdict, Verdict::WithoutVote(_)) {
            return None;
        }
        match place {
            Some(_) => self.votes.iter().find(|v| Some(v.0) == place).map(|v| v.1),
            None => Some(1.0 - self.votes.iter().map(|v| v.1).sum::<f64>()),
        }
    }
}

/// Gain from further sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gain {
    /// M before; after: the next value.
    pub from: f64,
    /// Error before divided by error after, within clusters; above 1: less error with more sensors.
    pub ratio: f64,
    /// Its 95 % interval; `None` with too few units.
    pub interval: Option<Interval>,
}

/// There are too few values of M for an elbow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{0} values of M: an elbow needs at least {LEAST_VALUES}")]
pub struct TooFew(pub usize);

/// Finds the elbow of the error against M.
///
/// # Errors
/// If there are fewer than four values of M.
pub fn elbow(observations: &[Observation], scale: ErrorScale) -> Result<Elbow, TooFew> {
    let clusters = clusters(observations);
    let grid = Grid::new(observations, &clusters);
    let at = &grid.places;
    if at.len() < LEAST_VALUES {
        return Err(TooFew(at.len()));
    }
    let levels = levels(observations);
    let resampling = Resampling::new(&clusters);
    let curve = Curve::new(&grid, clusters.len(), scale);
    let even = resampling.equal_weights();
    let broken_stick = curve.broken_stick(&even, SMOOTH);
    let replicates = resampling.replicates(|weights| Some(curve.broken_stick(&weights, SMOOTH)));
    let share = |place: Option<f64>| {
        replicates.iter().filter(|r| **r == place).count() as f64 / replicates.len().max(1) as f64
    };
    let votes: Vec<(f64, f64)> = at[1..at.len() - 1].iter().map(|&m| (m, share(Some(m)))).collect();
    let verdict = match replicates.is_empty() {
        true => Verdict::WithoutVote(broken_stick),
        false => verdict_of(&votes, share(None)),
    };
    let largest = at[at.len() - 1];
    let without_largest = (at.len() > LEAST_VALUES).then(|| {
        let rest: Vec<Observation> = observations.iter().filter(|o| o.at < largest).copied().collect();
        Curve::new(&Grid::new(&rest, &clusters), clusters.len(), scale).broken_stick(&even, SMOOTH)
    });
    let (any_decay, kneedle) = (curve.broken_stick(&even, 0), kneedle(&levels));
    let (chord, gains, over) = (chord(&levels, scale), gains(observations), resampling.over());
    Ok(Elbow { broken_stick, without_largest, any_decay, kneedle, chord, votes, gains, verdict, over })
}

/// Returns the answer with the most votes. Ties: no elbow first, then the smallest M. `votes`: M and share; `none`: share for
/// no elbow.
fn verdict_of(votes: &[(f64, f64)], none: f64) -> Verdict {
    let places = votes.iter().map(|&(m, share)| (Some(m), share));
    match places.fold((None, none), |a, b| if b.1 > a.1 { b } else { a }) {
        (place, share) if share <= MAJORITY => Verdict::Undecided(place),
        (Some(m), _) => Verdict::At(m),
        (None, _) => Verdict::NoElbow,
    }
}

/// Sums of a regression without intercept of y on two columns a and b: aa, ab, bb, ay, by, yy.
#[derive(Default, Clone, Copy)]
pub(super) struct Normal([f64; 6]);

impl Normal {
    /// Sums over rows (a, b, y) after subtracting the column means.
    pub(super) fn centred(rows: impl Iterator<Item = [f64; 3]> + Clone) -> Self {
        let [n, a, b, y] =
            rows.clone().fold([0.0; 4], |[n, a, b, y], r| [n + 1.0, a + r[0], b + r[1], y + r[2]]);
        rows.fold(Self::default(), |sums, row| {
            let [a, b, y] = [row[0] - a / n, row[1] - b / n, row[2] - y / n];
            sums.plus(1.0, &Self([a * a, a * b, b * b, a * y, b * y, y * y]))
        })
    }

    fn plus(self, w: f64, other: &Self) -> Self {
        // written out, because an iterator is much slower in unoptimised builds
        let ([aa, ab, bb, ay, by, yy], o) = (self.0, &other.0);
        Self([aa + w * o[0], ab + w * o[1], bb + w * o[2], ay + w * o[3], by + w * o[4], yy + w * o[5]])
    }

    /// Returns slopes and residual sum of squares. The second column may be all zero.
    pub(super) fn solve(&self) -> ([f64; 2], f64) {
        let [aa, ab, bb, ay, by, yy] = self.0;
        let determinant = aa * bb - ab * ab;
        let slopes = if determinant > 1e-12 * aa * bb && bb > 0.0 {
            [(bb * ay - ab * by) / determinant, (aa * by - ab * ay) / determinant]
        } else if aa > 0.0 {
            [ay / aa, 0.0]
        } else {
            [0.0, 0.0]
        };
        (slopes, yy - slopes[0] * ay - slopes[1] * by)
    }
}

/// Normal equations of every fit per cluster, so that other weights need no pass over the observations.
struct Curve {
    places: Vec<f64>,
    clusters: Vec<ByCluster>,
}

/// The sums of one cluster, columns centred within it.
struct ByCluster {
    observations: f64,
    /// Whether it has an observation at each place.
    has: Vec<bool>,
    /// y on M.
    line: Normal,
    /// y on ρᴹ, per ρ.
    decays: Vec<Normal>,
    /// y on min(M, m) and max(M − m, 0), per m.
    sticks: Vec<Normal>,
}

impl Curve {
    fn new(grid: &Grid, clusters: usize, scale: ErrorScale) -> Self {
        let mut points = vec![Vec::new(); clusters];
        grid.points.iter().for_each(|&(cluster, place, log)| points[cluster].push((place, scale.of(log))));
        let places = &grid.places;
        let column = |points: &[(usize, f64)], x: &dyn Fn(f64) -> f64| {
            Normal::centred(points.iter().map(|&(place, y)| [x(places[place]), 0.0, y]))
        };
        let stick = |points: &[(usize, f64)], m: f64| {
            let row = |&(place, y): &(usize, f64)| [places[place].min(m), (places[place] - m).max(0.0), y];
            Normal::centred(points.iter().map(row))
        };
        let of = |points: &Vec<(usize, f64)>| ByCluster {
            observations: points.len() as f64,
            has: (0..places.len()).map(|place| points.iter().any(|p| p.0 == place)).collect(),
            line: column(points, &|m| m),
            decays: DECAYS.iter().map(|rho| column(points, &|m| rho.powf(m))).collect(),
            sticks: places.iter().map(|m| stick(points, *m)).collect(),
        };
        Self { places: places.clone(), clusters: points.iter().map(of).collect() }
    }

    fn sum(&self, weights: &[f64], of: impl Fn(&ByCluster) -> &Normal) -> Normal {
        let weighed = self.clusters.iter().zip(weights).filter(|(_, w)| **w > 0.0);
        weighed.fold(Normal::default(), |sum, (cluster, w)| sum.plus(*w, of(cluster)))
    }

    /// Returns the elbow of the broken stick with weighted clusters. Decays from index `fastest` on are alternatives.
    fn broken_stick(&self, weights: &[f64], fastest: usize) -> Option<f64> {
        let drawn = |place: &usize| self.clusters.iter().zip(weights).any(|(c, w)| *w > 0.0 && c.has[*place]);
        let at: Vec<usize> = (0..self.places.len()).filter(drawn).collect();
        if at.len() < LEAST_VALUES {
            return None;
        }
        let n: f64 = self.clusters.iter().zip(weights).map(|(cluster, w)| w * cluster.observations).sum();
        let line = self.sum(weights, |cluster| &cluster.line);
        let (_, line_residual) = line.solve();
        let mut best: Option<(f64, [f64; 2], f64)> = None;
        for &place in &at[1..at.len() - 1] {
            let (slopes, residual) = self.sum(weights, |cluster| &cluster.sticks[place]).solve();
            if best.is_none_or(|(_, _, least)| residual < least) {
                best = Some((self.places[place], slopes, residual));
            }
        }
        let (place, [before, after], residual) = best?;
        // Residuals below the rounding error count as equal.
        let floor = 1e-12 * line.0[5] + f64::MIN_POSITIVE;
        let information =
            |residual: f64, parameters: f64| n * (residual.max(floor) / n).ln() + parameters * n.ln();
        let decays =
            (fastest..DECAYS.len()).map(|rho| self.sum(weights, |cluster| &cluster.decays[rho]).solve().1);
        let smooth = information(decays.fold(f64::INFINITY, f64::min), 2.0);
        let bends = information(residual, 3.0) < smooth.min(information(line_residual, 1.0));
        (bends && before < 0.0 && after >= FALL_KEPT * before).then_some(place)
    }
}

/// Kneedle for a falling, convex curve, sensitivity 1. Returns the first local maximum of the distance below the diagonal of
/// the normalised curve that is not exceeded before the distance has dropped by a mean step.
fn kneedle(levels: &[Level]) -> Option<f64> {
    let (first, last) = (levels.first()?, levels.last()?);
    let most = levels.iter().map(|l| l.mean).fold(f64::NEG_INFINITY, f64::max);
    let least = levels.iter().map(|l| l.mean).fold(f64::INFINITY, f64::min);
    if most <= least {
        return None;
    }
    let distance = |l: &Level| (most - l.mean) / (most - least) - (l.at - first.at) / (last.at - first.at);
    let distances: Vec<f64> = levels.iter().map(distance).collect();
    let step = 1.0 / (levels.len() - 1) as f64;
    let mut candidate: Option<usize> = None;
    for i in 1..levels.len() {
        let peaks =
            i + 1 < levels.len() && distances[i] > distances[i - 1] && distances[i] >= distances[i + 1];
        if peaks && candidate.is_none_or(|c| distances[i] > distances[c]) {
            candidate = Some(i);
        }
        if let Some(c) = candidate
            && i > c
            && distances[i] < distances[c] - step
        {
            return Some(levels[c].at);
        }
    }
    None
}

/// Returns the inner point farthest below the straight line from the first point to the last.
fn chord(levels: &[Level], scale: ErrorScale) -> Option<f64> {
    let (first, last) = (levels.first()?, levels.last()?);
    let y = |level: &Level| scale.of(level.mean.ln());
    let slope = (y(last) - y(first)) / (last.at - first.at);
    let mut best = (None, 1e-9);
    for level in &levels[1..levels.len() - 1] {
        let below = y(first) + slope * (level.at - first.at) - y(level);
        if below > best.1 {
            best = (Some(level.at), below);
        }
    }
    best.0
}

/// Returns the gain from each M to the next.
pub(super) fn gains(observations: &[Observation]) -> Vec<Gain> {
    let clusters = clusters(observations);
    let (grid, resampling) = (Grid::new(observations, &clusters), Resampling::new(&clusters));
    let mut cells = vec![vec![None; grid.places.len()]; clusters.len()];
    for &(cluster, place, log) in &grid.points {
        cells[cluster][place].get_or_insert(log);
    }
    let gain = |from: usize| {
        let pair = |cell: &Vec<Option<f64>>| Some(cell[from]? - cell[from + 1]?);
        let logs: Vec<[f64; 2]> =
            cells.iter().map(|cell| pair(cell).map_or([0.0; 2], |l| [1.0, l])).collect();
        let found = Ratio::weighed(&resampling, &logs, 0);
        let (ratio, interval) = found.map_or((f64::NAN, None), |found| (found.ratio, found.interval));
        Gain { from: grid.places[from], ratio, interval }
    };
    (0..grid.places.len().saturating_sub(1)).map(gain).collect()
}

#[cfg(test)]
mod tests;
