//! Questions, and their answers from some units at a given error probability.
//!
//! An answer is given if confidence bounds of contrasts exclude all others. A wrong answer requires that one of a few bounds
//! fails; the comments name them, and the error probability is divided among them.

use std::fmt;

use metasense_schemas::spec::Until;

use super::super::elbow::Normal;
use super::looks::Looks;

/// A question.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum UntilQuestion {
    /// Ratio of the initial to the trained body's error, until the width of its interval is at most this fraction of it.
    Paired(f64),
    /// Smallest M whose error on the trained body exceeds that of the best M by at most this fraction.
    Within(f64),
    /// Bend of the broken stick of ln e against M on the trained body, if the slope after it is at most half as steep.
    Elbow,
    /// Fewest sensors on the trained body that beat the most sensors on the initial body.
    Fewer,
    /// Whether the error of the trained body falls with the number of design parameters.
    Complexity,
}

/// An answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum UntilAnswer {
    /// A ratio and the ends of its interval.
    Ratio([f64; 3]),
    /// A number of sensors; `None`: there is none.
    Sensors(Option<f64>),
    /// Whether the error falls.
    Falls(bool),
}

impl fmt::Display for UntilQuestion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Paired(width) => write!(f, "gain to a relative width of {width}"),
            Self::Within(part) => write!(f, "smallest M within {part} of the best"),
            Self::Elbow => f.write_str("elbow"),
            Self::Fewer => f.write_str("fewer"),
            Self::Complexity => f.write_str("complexity"),
        }
    }
}

impl fmt::Display for UntilAnswer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ratio([ratio, low, high]) => write!(f, "{ratio:.3} ({low:.3} … {high:.3})"),
            Self::Sensors(Some(m)) => write!(f, "M = {m}"),
            Self::Sensors(None) => f.write_str("none"),
            Self::Falls(true) => f.write_str("error decreases with complexity"),
            Self::Falls(false) => f.write_str("error increases with complexity"),
        }
    }
}

/// Per unit, ln e by place: first of the trained body, then of the initial one.
pub(super) struct Curves<'a> {
    pub(super) places: &'a [f64],
    pub(super) units: &'a [&'a [f64]],
    /// Number of units of the grid so far, including those without a result.
    pub(super) passed: usize,
}

/// A mean over units, and the distance of its bounds.
#[derive(Debug, Clone, Copy)]
struct MeanBound {
    mean: f64,
    half: f64,
}

impl MeanBound {
    fn is_above(self, limit: f64) -> bool {
        self.mean - self.half > limit
    }

    fn is_below(self, limit: f64) -> bool {
        self.mean + self.half < limit
    }
}

impl UntilQuestion {
    /// Returns the questions of a spec, in order.
    pub(super) fn all(until: &Until) -> Vec<Self> {
        let asked = [
            until.paired.map(Self::Paired),
            until.within.map(Self::Within),
            until.elbow.then_some(Self::Elbow),
            until.fewer.then_some(Self::Fewer),
            until.complexity.then_some(Self::Complexity),
        ];
        asked.into_iter().flatten().collect()
    }

    /// Key in `[until]`.
    pub fn key(&self) -> &'static str {
        match self {
            Self::Paired(_) => "until.paired",
            Self::Within(_) => "until.within",
            Self::Elbow => "until.elbow",
            Self::Fewer => "until.fewer",
            Self::Complexity => "until.complexity",
        }
    }

    /// Smallest number of values of M, or of sizes.
    pub fn least_places(&self) -> usize {
        match self {
            Self::Paired(_) => 1,
            Self::Within(_) | Self::Fewer | Self::Complexity => 2,
            Self::Elbow => 4,
        }
    }

    /// Returns the answer of one look, which is wrong with probability `chance` at most over all looks; `None` if it is still
    /// open.
    pub(super) fn answer(&self, look: &Curves, chance: f64, looks: &mut Looks) -> Option<UntilAnswer> {
        let count = look.places.len();
        match *self {
            Self::Paired(width) => {
                let ratio = |unit: &[f64]| {
                    let sum = |half: &[f64]| half.iter().sum::<f64>() / count as f64;
                    sum(&unit[count..]) - sum(&unit[..count])
                };
                let MeanBound { mean, half } = look.contrast(ratio, 0.5 * chance, looks);
                let settled = half.exp() - (-half).exp() <= width;
                settled.then(|| UntilAnswer::Ratio([mean, mean - half, mean + half].map(f64::exp)))
            }
            Self::Within(part) => {
                look.within(part.ln_1p(), chance, looks).map(|m| UntilAnswer::Sensors(Some(m)))
            }
            Self::Elbow => look.elbow(chance, looks).map(UntilAnswer::Sensors),
            Self::Fewer => look.fewer(chance, looks).map(UntilAnswer::Sensors),
            Self::Complexity => {
                let logs: Vec<f64> = look.places.iter().map(|n| n.ln()).collect();
                let middle = logs.iter().sum::<f64>() / count as f64;
                let slope = |unit: &[f64]| unit.iter().zip(&logs).map(|(y, x)| y * (x - middle)).sum();
                let slope = look.contrast(slope, 0.5 * chance, looks);
                let told = slope.is_above(0.0) || slope.is_below(0.0);
                told.then_some(UntilAnswer::Falls(slope.mean < 0.0))
            }
        }
    }
}

impl Curves<'_> {
    /// Returns the mean of a number per unit; each bound fails with probability `chance`.
    fn contrast(&self, of: impl Fn(&[f64]) -> f64, chance: f64, looks: &mut Looks) -> MeanBound {
        let values: Vec<f64> = self.units.iter().map(|unit| of(unit)).collect();
        self.bounded(&values, chance, looks)
    }

    /// The same for a function of the mean curve, by jackknife pseudo-values.
    fn jackknife_bound(&self, of: impl Fn(&[f64]) -> f64, chance: f64, looks: &mut Looks) -> MeanBound {
        let n = self.units.len() as f64;
        let sums: Vec<f64> =
            (0..self.units[0].len()).map(|i| self.units.iter().map(|unit| unit[i]).sum()).collect();
        let mean: Vec<f64> = sums.iter().map(|sum| sum / n).collect();
        let whole = of(&mean);
        let pseudo = |unit: &&[f64]| {
            let without: Vec<f64> = sums.iter().zip(*unit).map(|(sum, y)| (sum - y) / (n - 1.0)).collect();
            n * whole - (n - 1.0) * of(&without)
        };
        let values: Vec<f64> = self.units.iter().map(pseudo).collect();
        self.bounded(&values, chance, looks)
    }

    /// Returns the mean of values and the distance of a bound that fails with probability `chance`.
    fn bounded(&self, values: &[f64], chance: f64, looks: &mut Looks) -> MeanBound {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
        MeanBound { mean, half: looks.bound(self.passed, values.len(), chance) * (variance / n).sqrt() }
    }

    fn mean(&self, place: usize) -> f64 {
        self.units.iter().map(|unit| unit[place]).sum::<f64>() / self.units.len() as f64
    }

    /// A too small M requires that one of J − 1 bounds fails, a too large M one of J − 1 others.
    fn within(&self, limit: f64, chance: f64, looks: &mut Looks) -> Option<f64> {
        let count = self.places.len();
        let chance = chance / (2 * (count - 1)) as f64;
        let mut above = |m: usize, other: usize| self.contrast(|unit| unit[m] - unit[other], chance, looks);
        let best = (0..count).map(|m| self.mean(m)).fold(f64::INFINITY, f64::min);
        let chosen = (0..count).find(|&m| self.mean(m) <= best + limit)?;
        let is_within = (0..count).filter(|&m| m != chosen).all(|m| above(chosen, m).is_below(limit));
        let mut is_worse = |m: usize| (0..count).any(|other| other != m && above(m, other).is_above(limit));
        (is_within && (0..chosen).all(&mut is_worse)).then(|| self.places[chosen])
    }

    /// Too few sensors require that one of J − 1 bounds fails, too many that another one fails.
    fn fewer(&self, chance: f64, looks: &mut Looks) -> Option<Option<f64>> {
        let (count, most) = (self.places.len(), 2 * self.places.len() - 1);
        let mut beats = |m: usize| -> Option<bool> {
            let bound = self.contrast(|unit| unit[m] - unit[most], chance / count as f64, looks);
            (bound.is_below(0.0) || bound.is_above(0.0)).then_some(bound.mean < 0.0)
        };
        for m in 0..count {
            if beats(m)? {
                return Some(Some(self.places[m]));
            }
        }
        Some(None)
    }

    /// A wrong place requires that the bound of its residual fails, a wrong verdict at the true place that the bound of the
    /// slope fails.
    fn elbow(&self, chance: f64, looks: &mut Looks) -> Option<Option<f64>> {
        let count = self.places.len();
        let mean: Vec<f64> = (0..count).map(|m| self.mean(m)).collect();
        let inner = 1..count - 1;
        let residual = |y: &[f64], m: usize| stick(self.places, &y[..count], m).2;
        let chosen = inner.clone().min_by(|a, b| residual(&mean, *a).total_cmp(&residual(&mean, *b)))?;
        if stick(self.places, &mean[..count], chosen).0 >= 0.0 {
            return None;
        }
        let chance = chance / inner.len() as f64;
        for other in inner.filter(|m| *m != chosen) {
            let more = self.jackknife_bound(|y| residual(y, other) - residual(y, chosen), chance, looks);
            if !more.is_above(0.0) {
                return None;
            }
        }
        let flatter = |unit: &[f64]| {
            let (before, after, _) = stick(self.places, &unit[..count], chosen);
            after - 0.5 * before
        };
        let flatter = self.contrast(flatter, chance, looks);
        let bends = flatter.is_above(0.0);
        (bends || flatter.is_below(0.0)).then(|| bends.then(|| self.places[chosen]))
    }
}

/// Returns the slopes before and after place number `at`, and the residual sum of squares, of the stick that bends there.
fn stick(places: &[f64], y: &[f64], at: usize) -> (f64, f64, f64) {
    let knee = places[at];
    let rows = places.iter().zip(y).map(|(x, y)| [x.min(knee), (x - knee).max(0.0), *y]);
    let ([before, after], residual) = Normal::centred(rows).solve();
    (before, after, residual)
}
