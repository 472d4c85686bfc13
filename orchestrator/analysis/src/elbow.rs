//! The elbow of error against the number of sensors: where more of them stop to pay.
//!
//! ```text
//! y = A_cluster + b·min(M, m) + c·max(M − m, 0)       broken stick, m one of the inner M; y = e or ln e
//! y = A_cluster + b·ρᴹ                                its rival, a decay without a bend
//! ```
//! by least squares; the cluster's own level A takes out that one placement is better than another at every M. There is
//! an elbow where the stick beats straight line and decay by BIC, falls before m and falls at most half as fast after it.
//! Kneedle (Satopää et al. 2011) and the chord's farthest point stand beside it. Votes by bootstrap.

use super::data::{Grid, Level, Observation, clusters, levels};
use super::paired::Ratio;
use super::resample::{Interval, Resampling};

/// Values of M below which no elbow is sought: a stick has three parameters and a place.
pub const LEAST_VALUES: usize = 4;

/// The most of its fall before the elbow that the error may keep after it.
const FALL_KEPT: f64 = 0.5;

/// The share of votes that decides.
const MAJORITY: f64 = 0.5;

/// What remains of the rest by a further sensor, of a decay.
const DECAYS: [f64; 20] = [
    0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9,
    0.95,
];

/// The first of them that counts as smooth: a faster one takes most of the rest at once, as a stick does that bends at the second M.
const SMOOTH: usize = 7;

/// The height over M of which an elbow is sought: a fall of many factors bends early in per cent, and late in logarithms.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Height {
    /// The error (%), as it is mostly drawn.
    Percent,
    /// Its logarithm: equal factors are equal steps.
    Logarithm,
}

impl Height {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Percent, Self::Logarithm];

    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Percent => "in %",
            Self::Logarithm => "in logarithms",
        }
    }

    /// Of an error whose logarithm this is.
    pub(super) fn of(self, log: f64) -> f64 {
        match self {
            Self::Percent => log.exp(),
            Self::Logarithm => log,
        }
    }
}

/// What the votes come to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Verdict {
    /// More than half of the replicates have it here.
    At(f64),
    /// More than half of the replicates have none.
    NoElbow,
    /// Neither an M nor `None`, no elbow, has more than half of the votes; this one has the most.
    Undecided(Option<f64>),
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
    /// The same of all M where decays of any speed are rivals.
    pub any_decay: Option<f64>,
    /// Kneedle's, on the mean error.
    pub kneedle: Option<f64>,
    /// The point farthest below the chord, on the height of the mean error.
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

impl Elbow {
    /// Share of the votes for an elbow at this M, or for none; `None` where nothing has voted.
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
pub fn elbow(observations: &[Observation], height: Height) -> Result<Elbow, TooFew> {
    let clusters = clusters(observations);
    let grid = Grid::new(observations, &clusters);
    let at = &grid.places;
    if at.len() < LEAST_VALUES {
        return Err(TooFew(at.len()));
    }
    let levels = levels(observations);
    let resampling = Resampling::new(&clusters);
    let curve = Curve::new(&grid, clusters.len(), height);
    let even = resampling.even();
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
        Curve::new(&Grid::new(&rest, &clusters), clusters.len(), height).broken_stick(&even, SMOOTH)
    });
    Ok(Elbow {
        broken_stick,
        without_largest,
        any_decay: curve.broken_stick(&even, 0),
        kneedle: kneedle(&levels),
        chord: chord(&levels, height),
        votes,
        gains: gains(observations),
        verdict,
        over: resampling.over(),
        levels,
    })
}

/// What has the most votes: one of these M, each with its share, or no elbow. Between equals: no elbow, then the least M.
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
    /// Of rows (a, b, y), each column less its mean.
    pub(super) fn centred(rows: impl Iterator<Item = [f64; 3]> + Clone) -> Self {
        let [n, a, b, y] =
            rows.clone().fold([0.0; 4], |[n, a, b, y], r| [n + 1.0, a + r[0], b + r[1], y + r[2]]);
        rows.fold(Self::default(), |sums, row| {
            let [a, b, y] = [row[0] - a / n, row[1] - b / n, row[2] - y / n];
            sums.plus(1.0, &Self([a * a, a * b, b * b, a * y, b * y, y * y]))
        })
    }

    fn plus(self, w: f64, other: &Self) -> Self {
        // written out: in tests, which are not optimised, an iterator here is half of what an analysis costs
        let ([aa, ab, bb, ay, by, yy], o) = (self.0, &other.0);
        Self([aa + w * o[0], ab + w * o[1], bb + w * o[2], ay + w * o[3], by + w * o[4], yy + w * o[5]])
    }

    /// Slopes and residual sum of squares; the second column may be absent (all zero).
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

/// The normal equations of every fit, cluster by cluster, so that weights of clusters need no look at the observations.
struct Curve {
    places: Vec<f64>,
    clusters: Vec<ByCluster>,
}

/// A cluster's part of them, each column centred within it.
struct ByCluster {
    observations: f64,
    /// Which places it has.
    has: Vec<bool>,
    /// Of y on M.
    line: Normal,
    /// On ρᴹ, by the number of ρ.
    decays: Vec<Normal>,
    /// On min(M, m) and max(M − m, 0), by the number of m.
    sticks: Vec<Normal>,
}

impl Curve {
    fn new(grid: &Grid, clusters: usize, height: Height) -> Self {
        let mut points = vec![Vec::new(); clusters];
        grid.points.iter().for_each(|&(cluster, place, log)| points[cluster].push((place, height.of(log))));
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

    /// The broken stick's elbow by weights of clusters, if there is one; decays from the fastest named on are its rivals.
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
        // Residuals below rounding are the same residual.
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
        let peaks = i + 1 < levels.len() && below[i] > below[i - 1] && below[i] >= below[i + 1];
        if peaks && candidate.is_none_or(|c| below[i] > below[c]) {
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

/// The inner point farthest below the straight line from the first point to the last.
fn chord(levels: &[Level], height: Height) -> Option<f64> {
    let (first, last) = (levels.first()?, levels.last()?);
    let y = |level: &Level| height.of(level.mean.ln());
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

/// What each further sensor brings.
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
        Gain {
            from: grid.places[from],
            to: grid.places[from + 1],
            ratio: found.as_ref().map_or(f64::NAN, |found| found.ratio),
            interval: found.and_then(|found| found.interval),
        }
    };
    (0..grid.places.len().saturating_sub(1)).map(gain).collect()
}

#[cfg(test)]
mod tests;
