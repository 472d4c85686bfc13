//! Body complexity: error against the number N of design parameters.
//!
//! ```text
//! L(N) = a·(N/N₀)^(−b) + c,   a, b, c ≥ 0,   N₀ the geometric mean of all N
//! ```
//! fitted by least squares on ln L. With r = c/a the scale a has a closed form, and (b, r) is searched on a grid, then
//! by a shrinking pattern search. Intervals by bootstrap over placements and seeds. An exponent whose interval touches
//! the ends of the search, or spans more than a factor of five, is not identifiable, and the verdict says so.

use super::data::{geometric_mean, places};
use super::{Cluster, Interval, Observation, Resampling};

/// Values of N below which three parameters are not fitted.
pub const LEAST_VALUES: usize = 4;

/// Exponents searched.
const EXPONENTS: [f64; 2] = [0.02, 6.0];

/// The greatest ratio of the ends of an exponent's interval that still counts as known.
const WIDEST: f64 = 5.0;

/// The least fall of ln L over the whole range, in standard errors, that counts as one.
const LEAST_FALL: f64 = 2.0;

/// The law's parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Law {
    /// Scale (%), at N₀.
    pub scale: f64,
    /// N₀.
    pub reference: f64,
    /// b.
    pub exponent: f64,
    /// c: what no body of this kind undercuts (%).
    pub floor: f64,
}

impl Law {
    /// L(N) in %.
    #[must_use]
    pub fn at(&self, n: f64) -> f64 {
        self.scale * (n / self.reference).powf(-self.exponent) + self.floor
    }
}

/// A fitted law with intervals, and whether it means anything.
#[derive(Debug, Clone, PartialEq)]
pub struct Scaling {
    /// The best fit.
    pub law: Law,
    /// Of the scale.
    pub scale: Option<Interval>,
    /// Of the exponent.
    pub exponent: Option<Interval>,
    /// Of the floor.
    pub floor: Option<Interval>,
    /// Standard deviation of ln L about the fit.
    pub residual: f64,
    /// Why the exponent is not identifiable; `None`: it is.
    pub not_identifiable: Option<String>,
    /// The law of every replicate, for a band about the curve.
    pub replicates: Vec<Law>,
}

impl Scaling {
    /// The 95 % interval of L(N), where there are replicates.
    #[must_use]
    pub fn band(&self, n: f64) -> Option<Interval> {
        Interval::of(self.replicates.iter().map(|law| law.at(n)).collect())
    }
}

/// Too few values of N to fit a law.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "not identifiable: the law has three parameters and needs at least {LEAST_VALUES} body sizes, there are {0}"
)]
pub struct TooFew(pub usize);

/// Fits error against the number of design parameters.
///
/// # Errors
/// Where there are fewer than four values of N.
pub fn scaling(observations: &[Observation]) -> Result<Scaling, TooFew> {
    let at = places(observations);
    if at.len() < LEAST_VALUES {
        return Err(TooFew(at.len()));
    }
    let reference = geometric_mean(&at);
    let (law, squares) = fit(observations, &vec![1.0; observations.len()], reference, None);
    let clusters: Vec<Cluster> = observations.iter().map(|o| o.cluster).collect();
    let replicates = Resampling::new(&clusters).replicates(|weights| {
        let counted: Vec<Observation> =
            observations.iter().zip(&weights).filter(|(_, w)| **w > 0.0).map(|(o, _)| *o).collect();
        (places(&counted).len() >= LEAST_VALUES).then(|| fit(observations, &weights, reference, Some(&law)).0)
    });
    let of = |pick: fn(&Law) -> f64| Interval::of(replicates.iter().map(pick).collect());
    let freedom = observations.len().saturating_sub(3).max(1);
    let mut scaling = Scaling {
        law,
        scale: of(|l| l.scale),
        exponent: of(|l| l.exponent),
        floor: of(|l| l.floor),
        residual: (squares / freedom as f64).sqrt(),
        not_identifiable: None,
        replicates,
    };
    scaling.not_identifiable = doubt(&scaling, observations);
    Ok(scaling)
}

fn doubt(found: &Scaling, observations: &[Observation]) -> Option<String> {
    let at = places(observations);
    let fall = (found.law.at(at[0]) / found.law.at(at[at.len() - 1])).ln();
    let error = found.residual / ((observations.len() as f64) / at.len() as f64).sqrt();
    if fall < LEAST_FALL * error + 1e-9 {
        return Some("error does not fall with N beyond its scatter".into());
    }
    let Some(interval) = found.exponent else {
        return Some("one placement and seed give no interval".into());
    };
    let [least, most] = EXPONENTS;
    if interval.low <= 1.05 * least || interval.high >= 0.95 * most {
        return Some(format!("the exponent's interval reaches the end of the search ({least} to {most})"));
    }
    (interval.high / interval.low > WIDEST)
        .then(|| format!("the exponent's interval spans a factor of {:.1}", interval.high / interval.low))
}

/// Mean ln L and weight at each N: the fit needs no more.
struct Point {
    x: f64,
    y: f64,
    weight: f64,
}

fn fit(observations: &[Observation], weights: &[f64], reference: f64, start: Option<&Law>) -> (Law, f64) {
    let mut scatter = 0.0;
    let points: Vec<Point> = places(observations)
        .into_iter()
        .filter_map(|at| {
            let here = || observations.iter().zip(weights).filter(move |(o, _)| o.at == at);
            let weight: f64 = here().map(|(_, w)| w).sum();
            let y = here().map(|(o, w)| w * o.error.ln()).sum::<f64>() / weight;
            if weight > 0.0 {
                scatter += here().map(|(o, w)| w * (o.error.ln() - y).powi(2)).sum::<f64>();
            }
            (weight > 0.0).then_some(Point { x: at / reference, y, weight })
        })
        .collect();
    // Search in ln b and s = r/(1 + r), which holds every floor from none (0) to nothing but it (1).
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
            if du < 1e-5 {
                break;
            }
        }
    }
    let (scale, squares) = residual(&points, u.exp(), s);
    // Below this the search has gone to the edge.
    let floor = if s < 1e-4 { 0.0 } else { scale * s / (1.0 - s) };
    (Law { scale, reference, exponent: u.exp(), floor }, squares + scatter)
}

/// The best scale for (b, s), and the weighted sum of squares that it leaves.
fn residual(points: &[Point], exponent: f64, s: f64) -> (f64, f64) {
    let floor = s / (1.0 - s);
    let shape = |p: &Point| (p.x.powf(-exponent) + floor).ln();
    let weight: f64 = points.iter().map(|p| p.weight).sum();
    let scale = points.iter().map(|p| p.weight * (p.y - shape(p))).sum::<f64>() / weight;
    let squares = points.iter().map(|p| p.weight * (p.y - shape(p) - scale).powi(2)).sum();
    (scale.exp(), squares)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::resample::Draw;

    fn law(exponent: f64, floor: f64, noise: f64, sizes: &[f64]) -> Vec<Observation> {
        let mut draw = Draw::new(5, 0);
        let mut all = Vec::new();
        for placement in 0..6 {
            for &n in sizes {
                let error = (30.0 * (n / 150.0).powf(-exponent) + floor) * (noise * draw.normal()).exp();
                all.push(Observation { at: n, cluster: Cluster { placement, seed: 1 }, error });
            }
        }
        all
    }

    const SIZES: &[f64] = &[40.0, 84.0, 144.0, 220.0, 312.0, 420.0, 612.0];

    #[test]
    fn an_exact_law_is_found() {
        let found = scaling(&law(0.8, 4.0, 0.0, SIZES)).unwrap();
        let exact = Law { scale: 0.0, reference: 150.0, exponent: 0.8, floor: 4.0 };
        assert!((found.law.exponent / exact.exponent - 1.0).abs() < 1e-3, "{:?}", found.law);
        assert!((found.law.floor / exact.floor - 1.0).abs() < 1e-2, "{:?}", found.law);
        assert!((found.law.at(150.0) - 34.0).abs() < 1e-2, "{:?}", found.law);
    }

    #[test]
    fn intervals_hold_the_truth_and_the_law_is_identified() {
        let found = scaling(&law(0.8, 4.0, 0.03, SIZES)).unwrap();
        let interval = found.exponent.unwrap();
        assert!(interval.low < 0.8 && 0.8 < interval.high, "{interval:?}");
        assert_eq!(found.not_identifiable, None, "{interval:?}");
        let band = found.band(100.0).unwrap();
        assert!(band.low < found.law.at(100.0) && found.law.at(100.0) < band.high);
    }

    #[test]
    fn a_flat_curve_is_not_identifiable() {
        let found = scaling(&law(0.0, 4.0, 0.1, SIZES)).unwrap();
        assert!(found.not_identifiable.is_some(), "{:?}", found.law);
    }

    #[test]
    fn noise_over_a_short_range_is_not_identifiable() {
        let found = scaling(&law(0.8, 4.0, 0.25, &[100.0, 110.0, 120.0, 130.0])).unwrap();
        assert!(found.not_identifiable.is_some(), "{:?} {:?}", found.law, found.exponent);
    }

    #[test]
    fn three_sizes_are_too_few() {
        assert_eq!(scaling(&law(0.8, 4.0, 0.0, &SIZES[..3])).err(), Some(TooFew(3)));
    }
}
