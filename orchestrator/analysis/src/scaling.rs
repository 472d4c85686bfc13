//! Body complexity: error against the number N of design parameters.
//!
//! ```text
//! L(N) = a·(N/N₀)^(−b) + c,   a, b, c ≥ 0,   N₀ the geometric mean of all N
//! ```
//! is a least-squares fit to ln L. Trials farther than five robust standard deviations from the median of their N are moved to
//! that distance, so that one failed training does not change the law. a is eliminated (variable projection, Golub and Pereyra
//! 1973); b and c/a are found on a grid, then by pattern search. The exponent is not identifiable if its interval touches the
//! ends of the search or spans more than a factor of five. The law of the smaller N also predicts the largest N.

use std::collections::BTreeMap;

use super::data::{Grid, Observation, clusters, places};
use super::numbers::{geometric_mean, median};
use super::resample::{Interval, Jackknife, Resampling};
use super::trial::Cluster;

/// Smallest number of values of N for three parameters.
pub const LEAST_VALUES: usize = 4;

/// Range of the exponent.
const EXPONENTS: [f64; 2] = [0.02, 6.0];

/// Largest ratio of the ends of an identifiable exponent's interval.
const WIDEST: f64 = 5.0;

/// Smallest significant fall of ln L over the range of N (standard errors).
const LEAST_FALL: f64 = 2.0;

/// Largest distance of a trial from the median of its N (robust standard deviations).
const FARTHEST: f64 = 5.0;

/// Parameters of the law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Law {
    /// a: scale (%) at N₀.
    pub scale: f64,
    /// N₀.
    pub reference: f64,
    /// b: exponent.
    pub exponent: f64,
    /// c: error (%) in the limit of large N.
    pub floor: f64,
}

impl Law {
    /// L(N) in %.
    pub fn at(&self, n: f64) -> f64 {
        self.scale * (n / self.reference).powf(-self.exponent) + self.floor
    }
}

/// A fitted law with intervals, and whether it is identifiable.
#[derive(Debug, Clone, PartialEq)]
pub struct FittedLaw {
    /// The best fit.
    pub law: Law,
    /// Interval of the exponent.
    pub exponent: Option<Interval>,
    /// Interval of the floor.
    pub floor: Option<Interval>,
    /// Prediction of the largest N from the others; `None` if these are too few for a law.
    pub held_out: Option<HeldOut>,
    /// Units of the intervals, or why there are none.
    pub over: String,
    /// Residual standard deviation of ln L.
    pub residual: f64,
    /// Why the exponent is not identifiable; `None`: it is identifiable.
    pub not_identifiable: Option<String>,
    /// The laws with units left out, for the band of the curve.
    laws: Option<Jackknife<Law>>,
}

/// The largest N, predicted by the law of the smaller ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeldOut {
    /// The largest N.
    pub at: f64,
    /// Error by the law of the smaller N (%).
    pub predicted: f64,
    /// Geometric mean of the errors at this N (%).
    pub observed: f64,
    /// Interval of predicted over observed.
    pub interval: Option<Interval>,
}

impl FittedLaw {
    /// Returns the 95 % interval of L(N) (%); `None` with too few units.
    pub fn band(&self, n: f64) -> Option<Interval> {
        Some(self.laws.as_ref()?.interval(|law| law.at(n).ln())?.map(f64::exp))
    }
}

/// There are too few values of N for a law.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("not identifiable: {0} body sizes; three parameters need at least {LEAST_VALUES}")]
pub struct TooFew(pub usize);

/// Fits the error against the number of design parameters.
///
/// # Errors
/// If there are fewer than four values of N.
pub fn scaling(observations: &[Observation]) -> Result<FittedLaw, TooFew> {
    let at = places(observations);
    if at.len() < LEAST_VALUES {
        return Err(TooFew(at.len()));
    }
    let observations = &pulled_in(observations)[..];
    let reference = geometric_mean(&at);
    let clusters = clusters(observations);
    let sums = Sums::new(&Grid::new(observations, &clusters));
    let units = Resampling::new(&clusters);
    let all = units.equal_weights();
    let (law, squares) = fit(&sums, &all, reference, None).expect("as many values of N as it takes");
    let laws = units.jackknife(|weights| Some(fit(&sums, weights, reference, Some(&law))?.0));
    let of = |pick: fn(&Law) -> f64| laws.as_ref().and_then(|laws| laws.interval(pick));
    let freedom = observations.len().saturating_sub(3).max(1);
    let exponent = of(|l| l.exponent.ln()).map(|i| i.map(f64::exp));
    let floor = of(|l| l.floor).map(|i| i.map(|c| c.max(0.0)));
    let held_out = held_out(observations, &clusters, &units, &law);
    let (over, residual, not_identifiable) = (units.over(), (squares / freedom as f64).sqrt(), None);
    let mut scaling = FittedLaw { law, exponent, floor, held_out, over, residual, not_identifiable, laws };
    scaling.not_identifiable = doubt(&scaling, observations);
    Ok(scaling)
}

/// Moves errors that are farther than [`FARTHEST`] from the median of their N to that distance. The standard deviation is
/// estimated from the median of all distances.
fn pulled_in(observations: &[Observation]) -> Vec<Observation> {
    let places = places(observations);
    let at = |at: f64| median(observations.iter().filter(|o| o.at == at).map(|o| o.error.ln()).collect());
    let middles: Vec<f64> = places.iter().map(|place| at(*place)).collect();
    let middle = |at: f64| middles[places.partition_point(|place| *place < at)];
    let off: Vec<f64> = observations.iter().map(|o| o.error.ln() - middle(o.at)).collect();
    // median distance of a normal distribution: 0.6745 standard deviations
    let most = FARTHEST * median(off.iter().map(|x| x.abs()).collect()) / 0.6745;
    let pull = |(o, off): (&Observation, &f64)| match off.abs() > most && most > 0.0 {
        true => Observation { error: (middle(o.at) + most.copysign(*off)).exp(), ..*o },
        false => *o,
    };
    observations.iter().zip(&off).map(pull).collect()
}

fn held_out(
    observations: &[Observation],
    clusters: &[Cluster],
    units: &Resampling,
    all: &Law,
) -> Option<HeldOut> {
    let most = *places(observations).last()?;
    let (at_largest, smaller): (Vec<Observation>, Vec<Observation>) =
        observations.iter().partition(|o| o.at == most);
    let [at_largest, smaller] = [at_largest, smaller].map(|part| Grid::new(&part, clusters));
    let smaller = Sums::new(&smaller);
    let logs = |weights: &[f64]| {
        let law = fit(&smaller, weights, all.reference, Some(all))?.0;
        Some([law.at(most).ln(), at_largest.means(weights)[0]?.ln()])
    };
    let [predicted, observed] = logs(&units.equal_weights())?.map(f64::exp);
    let interval = units.jackknife(logs).and_then(|j| j.interval(|[p, o]| p - o));
    Some(HeldOut { at: most, predicted, observed, interval: interval.map(|i| i.map(f64::exp)) })
}

fn doubt(found: &FittedLaw, observations: &[Observation]) -> Option<String> {
    let at = places(observations);
    let fall = (found.law.at(at[0]) / found.law.at(at[at.len() - 1])).ln();
    let error = found.residual / ((observations.len() as f64) / at.len() as f64).sqrt();
    if fall < LEAST_FALL * error + 1e-9 {
        return Some("the error does not fall significantly with N".into());
    }
    let Some(interval) = found.exponent else { return Some(found.over.clone()) };
    let [least, most] = EXPONENTS;
    if interval.low <= 1.05 * least || interval.high >= 0.95 * most {
        return Some(format!(
            "the exponent's interval reaches the end of the searched range ({least} to {most})"
        ));
    }
    (interval.high / interval.low > WIDEST)
        .then(|| format!("the exponent's interval spans a factor of {:.1}", interval.high / interval.low))
}

/// Sums over the trials of each cluster and N: count, y and y², where y is ln L minus its mean over all trials.
struct Sums {
    mean: f64,
    places: Vec<f64>,
    cells: Vec<(usize, usize, [f64; 3])>,
}

impl Sums {
    fn new(grid: &Grid) -> Self {
        let mean = grid.points.iter().map(|p| p.2).sum::<f64>() / grid.points.len().max(1) as f64;
        let mut cells: BTreeMap<(usize, usize), [f64; 3]> = BTreeMap::new();
        for &(cluster, place, log) in &grid.points {
            let y = log - mean;
            let sum = cells.entry((cluster, place)).or_default();
            *sum = [sum[0] + 1.0, sum[1] + y, sum[2] + y * y];
        }
        let cells = cells.into_iter().map(|((cluster, place), sum)| (cluster, place, sum)).collect();
        Self { mean, places: grid.places.clone(), cells }
    }
}

/// N/N₀, mean ln L and weight at one N.
struct Point {
    x: f64,
    y: f64,
    weight: f64,
}

/// Returns the law with weighted clusters, and its sum of squares; `None` with fewer than four N.
fn fit(sums: &Sums, weights: &[f64], reference: f64, start: Option<&Law>) -> Option<(Law, f64)> {
    let mut totals = vec![[0.0; 3]; sums.places.len()];
    for &(cluster, place, sum) in &sums.cells {
        let w = weights[cluster];
        totals[place].iter_mut().zip(sum).for_each(|(total, part)| *total += w * part);
    }
    let mut scatter = 0.0;
    let mut points: Vec<Point> = Vec::with_capacity(totals.len());
    for (at, [weight, y, squares]) in sums.places.iter().zip(totals).filter(|(_, total)| total[0] > 0.0) {
        let y = y / weight;
        scatter += (squares - weight * y * y).max(0.0);
        points.push(Point { x: at / reference, y: sums.mean + y, weight });
    }
    if points.len() < LEAST_VALUES {
        return None;
    }
    // Search in ln b and s = r/(1 + r), r = c/a: s from 0 (no floor) towards 1 (only a floor).
    let [least, most] = EXPONENTS.map(f64::ln);
    let cost = |u: f64, s: f64| residual(&points, u.exp(), s).1;
    let starts: Vec<[f64; 2]> = match start {
        Some(law) => vec![[law.exponent.ln(), law.floor / (law.floor + law.scale)]],
        None => (0..17 * 17)
            .map(|i| [least + (most - least) * f64::from(i / 17) / 16.0, 0.98 * f64::from(i % 17) / 16.0])
            .collect(),
    };
    let (mut u, mut s, mut best) = (0.0, 0.0, f64::INFINITY);
    for [tu, ts] in starts {
        let c = cost(tu, ts);
        if c < best {
            (u, s, best) = (tu, ts, c);
        }
    }
    let (mut du, mut ds) = ((most - least) / 16.0, 0.98 / 16.0);
    for _ in 0..300 {
        let mut better = false;
        for (mu, ms) in [(1., 0.), (-1., 0.), (0., 1.), (0., -1.), (1., 1.), (-1., -1.), (1., -1.), (-1., 1.)]
        {
            let (tu, ts) = ((u + mu * du).clamp(least, most), (s + ms * ds).clamp(0.0, 0.98));
            let c = cost(tu, ts);
            if c < best {
                (u, s, best, better) = (tu, ts, c, true);
            }
        }
        if !better {
            du *= 0.5;
            ds *= 0.5;
            if du < 1e-4 {
                break;
            }
        }
    }
    let (scale, squares) = residual(&points, u.exp(), s);
    // The search has reached the edge s = 0.
    let floor = if s < 1e-4 { 0.0 } else { scale * s / (1.0 - s) };
    Some((Law { scale, reference, exponent: u.exp(), floor }, squares + scatter))
}

/// Returns the best scale for (b, s) and its weighted sum of squares.
fn residual(points: &[Point], exponent: f64, s: f64) -> (f64, f64) {
    let floor = s / (1.0 - s);
    let above: Vec<f64> = points.iter().map(|p| p.y - (p.x.powf(-exponent) + floor).ln()).collect();
    let [sum, weight] =
        points.iter().zip(&above).fold([0.0; 2], |[s, w], (p, a)| [s + p.weight * a, w + p.weight]);
    let scale = sum / weight;
    let squares = points.iter().zip(&above).map(|(p, a)| p.weight * (a - scale).powi(2)).sum();
    (scale.exp(), squares)
}

#[cfg(test)]
mod tests;
