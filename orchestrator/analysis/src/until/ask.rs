//! The questions, and what one look at some units answers with a given chance of being wrong.
//!
//! An answer is given where bounds of the contrasts that it hangs on leave no other. Of all wrong ones each needs a bound to
//! fail that is named here; the level is shared out among as many as may.

use std::fmt;

use metasense_schemas::spec::Until;

use super::super::elbow::Normal;
use super::looks::Looks;

/// What is asked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Question {
    /// Error of the initial over that of the optimised body, its interval no wider than this part of it.
    Paired(f64),
    /// The smallest M whose error on the optimised body is within this part of the best M's.
    Within(f64),
    /// Where the broken stick of ln e against M on the optimised body bends, if it falls at most half as fast beyond.
    Elbow,
    /// The fewest sensors on the optimised body that beat the most on the initial one.
    Fewer,
    /// Whether the optimised body's error falls with the number of design parameters.
    Complexity,
}

/// What is answered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Answer {
    /// A ratio with its interval.
    Ratio([f64; 3]),
    /// A number of sensors, or none.
    Sensors(Option<f64>),
    /// Whether the error falls.
    Falls(bool),
}

impl fmt::Display for Question {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Paired(width) => write!(f, "paired to {width}"),
            Self::Within(part) => write!(f, "within {part}"),
            Self::Elbow => f.write_str("elbow"),
            Self::Fewer => f.write_str("fewer"),
            Self::Complexity => f.write_str("complexity"),
        }
    }
}

impl fmt::Display for Answer {
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

/// Units with a number each by place: ln e of the optimised body, then of the initial one.
pub(super) struct Curves<'a> {
    pub(super) places: &'a [f64],
    pub(super) units: &'a [&'a [f64]],
    /// Units of the grid that were passed, those without a result among them.
    pub(super) passed: usize,
}

/// A mean over units and how far its bounds are.
#[derive(Debug, Clone, Copy)]
struct Bounded {
    mean: f64,
    half: f64,
}

impl Bounded {
    fn is_above(self, limit: f64) -> bool {
        self.mean - self.half > limit
    }

    fn is_below(self, limit: f64) -> bool {
        self.mean + self.half < limit
    }
}

impl Question {
    /// Those that are asked, in order.
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

    /// Its key in `[until]`.
    pub fn key(&self) -> &'static str {
        match self {
            Self::Paired(_) => "until.paired",
            Self::Within(_) => "until.within",
            Self::Elbow => "until.elbow",
            Self::Fewer => "until.fewer",
            Self::Complexity => "until.complexity",
        }
    }

    /// Values of M, or sizes, that it needs.
    pub fn least_places(&self) -> usize {
        match self {
            Self::Paired(_) => 1,
            Self::Within(_) | Self::Fewer | Self::Complexity => 2,
            Self::Elbow => 4,
        }
    }

    /// The answer of one look, wrong with at most this chance over all looks; `None` as long as the units leave several.
    pub(super) fn answer(&self, look: &Curves, chance: f64, looks: &mut Looks) -> Option<Answer> {
        let count = look.places.len();
        match *self {
            Self::Paired(width) => {
                let ratio = |unit: &[f64]| {
                    let sum = |half: &[f64]| half.iter().sum::<f64>() / count as f64;
                    sum(&unit[count..]) - sum(&unit[..count])
                };
                let Bounded { mean, half } = look.contrast(ratio, 0.5 * chance, looks);
                let settled = half.exp() - (-half).exp() <= width;
                settled.then(|| Answer::Ratio([mean, mean - half, mean + half].map(f64::exp)))
            }
            Self::Within(part) => look.within(part.ln_1p(), chance, looks).map(|m| Answer::Sensors(Some(m))),
            Self::Elbow => look.elbow(chance, looks).map(Answer::Sensors),
            Self::Fewer => look.fewer(chance, looks).map(Answer::Sensors),
            Self::Complexity => {
                let logs: Vec<f64> = look.places.iter().map(|n| n.ln()).collect();
                let middle = logs.iter().sum::<f64>() / count as f64;
                let slope = |unit: &[f64]| unit.iter().zip(&logs).map(|(y, x)| y * (x - middle)).sum();
                let slope = look.contrast(slope, 0.5 * chance, looks);
                let told = slope.is_above(0.0) || slope.is_below(0.0);
                told.then_some(Answer::Falls(slope.mean < 0.0))
            }
        }
    }
}

impl Curves<'_> {
    /// The mean of a number a unit, each bound wrong with this chance.
    fn contrast(&self, of: impl Fn(&[f64]) -> f64, chance: f64, looks: &mut Looks) -> Bounded {
        let values: Vec<f64> = self.units.iter().map(|unit| of(unit)).collect();
        self.bounded(&values, chance, looks)
    }

    /// The same of a number had from the mean curve of all units, by its jackknife's pseudo-values.
    fn of_mean(&self, of: impl Fn(&[f64]) -> f64, chance: f64, looks: &mut Looks) -> Bounded {
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

    /// Mean of values and how far a bound is that is wrong with this chance.
    fn bounded(&self, values: &[f64], chance: f64, looks: &mut Looks) -> Bounded {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
        Bounded { mean, half: looks.bound(self.passed, values.len(), chance) * (variance / n).sqrt() }
    }

    fn mean(&self, place: usize) -> f64 {
        self.units.iter().map(|unit| unit[place]).sum::<f64>() / self.units.len() as f64
    }

    /// A smaller M than the true one needs one of J − 1 differences to be bounded wrongly, a greater one another of J − 1.
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

    /// Fewer than the true ones need one of J − 1 bounds to be wrong, more of them another one.
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

    /// Another place than the true one needs its residual to be bounded wrongly against that, and the true one a wrong slope.
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
            let more = self.of_mean(|y| residual(y, other) - residual(y, chosen), chance, looks);
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

/// Slopes before and after the place of number `at`, and the residual sum of squares, of the stick that bends there.
fn stick(places: &[f64], y: &[f64], at: usize) -> (f64, f64, f64) {
    let knee = places[at];
    let rows = places.iter().zip(y).map(|(x, y)| [x.min(knee), (x - knee).max(0.0), *y]);
    let ([before, after], residual) = Normal::centred(rows).solve();
    (before, after, residual)
}
