//! What trials will come to, by what trials have shown so far: a Gaussian process over settings and levels.
//!
//! ```text
//! y(i, l) = a + b_l + f_l(x_i) + p_l(i) + u_l(i) + ε       ln error of trial i at level l: the rungs, then the result
//! cov(f_l(x), f_m(x')) = σ_f² ρ^|l−m| exp(−½ Σ_d (x_d − x'_d)²/ℓ_d²)     cov(u_l(i), u_m(i)) = σ_u² ρ^|l−m|
//! cov(p_l(i), p_m(j)) = σ_p² ρ^|l−m| where i and j have the same sensors
//! ```
//! (Rasmussen and Williams 2006, eq. 2.25 f. and 5.8; levels after freeze–thaw, arXiv:1406.3896.) ρ is how far a look at a trial
//! tells its result: where it is small, cheap looks count for little. Looks of unlike kinds, at a body as designed or at its casts,
//! have b_l of their own. Hyperparameters are the most likely ones of a small grid.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use metasense_numerics::random::Draw;

/// Levels of a trial: two rungs and the result.
pub const LEVELS: usize = 3;

/// An observation: trial, level, ln of an error in %.
pub type Seen = (usize, usize, f64);

/// What is known of a trial before it is seen.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Setting {
    /// Coordinates of about 0 … 1.
    pub place: Vec<f64>,
    /// What its rungs tell: the same number where it is the same quantity. Results always are.
    pub looks: usize,
    /// Where its sensors are: the same number where they are the same.
    pub sensors: usize,
}

/// Values that hyperparameters may have, and the one that they begin with and are drawn to.
const AMPLITUDE: [f64; 5] = [0.2, 0.4, 0.8, 1.3, 2.0];
const LENGTH: [f64; 5] = [0.35, 0.7, 1.4, 3.0, 8.0];
const OWN: [f64; 5] = [0.05, 0.1, 0.2, 0.4, 0.7];
const KINSHIP: [f64; 5] = [0.2, 0.5, 0.75, 0.9, 0.97];
const NOISE: [f64; 4] = [0.03, 0.07, 0.15, 0.3];
const MIDDLE: usize = 2;
const OF_NOISE: usize = 4;
/// Variance of a, b_l in advance.
const OF_ALL: f64 = 4.0;
const OF_LEVEL: f64 = 1.0;
/// How much a value away from the middle must make the data likelier (nats a step of the grid, squared).
const PULL: f64 = 0.6;
/// Passes over the hyperparameters.
const PASSES: usize = 2;

#[derive(Debug, Clone, PartialEq)]
struct Hyper {
    amplitude: f64,
    lengths: Vec<f64>,
    own: f64,
    placed: f64,
    kinship: f64,
    noise: f64,
}

/// Grid indices: amplitude, own, placed, kinship, noise, then a length each coordinate.
fn hyper(at: &[usize]) -> Hyper {
    Hyper {
        amplitude: AMPLITUDE[at[0]],
        own: OWN[at[1]],
        placed: OWN[at[2]],
        kinship: KINSHIP[at[3]],
        noise: NOISE[at[OF_NOISE].min(NOISE.len() - 1)],
        lengths: at[OF_NOISE + 1..].iter().map(|i| LENGTH[*i]).collect(),
    }
}

impl Hyper {
    /// Of two trials at two levels, without the noise of an observation.
    fn covariance(&self, x: &[&Setting], (i, l): (usize, usize), (j, m): (usize, usize)) -> f64 {
        let distance: f64 = x[i]
            .place
            .iter()
            .zip(&x[j].place)
            .zip(&self.lengths)
            .map(|((a, b), length)| ((a - b) / length).powi(2))
            .sum();
        let setting = self.amplitude.powi(2) * (-0.5 * distance).exp();
        let own = if i == j { self.own.powi(2) } else { 0.0 };
        let placed = if x[i].sensors == x[j].sensors { self.placed.powi(2) } else { 0.0 };
        let alike = l == LEVELS - 1 || x[i].looks == x[j].looks;
        let level = if l == m && alike { OF_LEVEL } else { 0.0 };
        OF_ALL + level + self.kinship.powi(l.abs_diff(m) as i32) * (setting + placed + own)
    }

    fn factor(&self, x: &[&Setting], seen: &[Seen]) -> Option<Cholesky<f64, Dyn>> {
        let of = |a: usize, b: usize| {
            let ((i, l, _), (j, m, _)) = (seen[a], seen[b]);
            self.covariance(x, (i, l), (j, m)) + if a == b { self.noise.powi(2) } else { 0.0 }
        };
        DMatrix::from_fn(seen.len(), seen.len(), of).cholesky()
    }

    /// ln p(y) and what draws the values to the middle of their grids.
    fn evidence(&self, x: &[&Setting], seen: &[Seen], y: &DVector<f64>) -> f64 {
        let Some(factor) = self.factor(x, seen) else { return f64::NEG_INFINITY };
        let logs: f64 = factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum();
        -0.5 * y.dot(&factor.solve(y)) - logs
    }
}

/// What the results of trials may be, together: so many draws each, the noise of an observation in them.
#[derive(Debug, Clone)]
pub struct Prediction {
    /// Expected ln error of each trial's result.
    pub mean: Vec<f64>,
    /// Its standard deviation, without that noise.
    pub deviation: Vec<f64>,
    /// ln errors, a column each draw.
    draws: DMatrix<f64>,
    /// How far the first rung tells the result: ρ^(levels between them).
    pub kinship: f64,
}

/// Draws of a prediction.
const DRAWS: usize = 500;

impl Prediction {
    /// Of trials of these settings, of which this was seen.
    pub fn new(x: &[&Setting], seen: &[Seen]) -> Self {
        let last = LEVELS - 1;
        let middle = seen.iter().map(|s| s.2).sum::<f64>() / seen.len().max(1) as f64;
        let y = DVector::from_iterator(seen.len(), seen.iter().map(|s| s.2 - middle));
        let hyper = fitted(x, seen, &y);
        let prior = |i: usize, j: usize| hyper.covariance(x, (i, last), (j, last));
        let (mut mean, mut covariance) =
            (DVector::from_element(x.len(), middle), DMatrix::from_fn(x.len(), x.len(), prior));
        if let Some(factor) = hyper.factor(x, seen).filter(|_| !seen.is_empty()) {
            let cross = DMatrix::from_fn(seen.len(), x.len(), |a, i| {
                hyper.covariance(x, (seen[a].0, seen[a].1), (i, last))
            });
            mean += cross.transpose() * factor.solve(&y);
            covariance -= cross.transpose() * factor.solve(&cross);
        }
        let deviation: Vec<f64> = covariance.diagonal().iter().map(|v| v.max(0.0).sqrt()).collect();
        for i in 0..x.len() {
            covariance[(i, i)] += 1e-9 * OF_ALL;
        }
        let mut draw = Draw::numbered(7, 0);
        let z = DMatrix::from_fn(x.len(), DRAWS, |_, _| draw.normal());
        // without a factor, which rounding may take, each by itself
        let root = covariance.cholesky().map_or_else(
            || DMatrix::from_diagonal(&DVector::from_column_slice(&deviation)),
            |factor| factor.unpack(),
        );
        let mut draws = root * z;
        for mut one in draws.column_iter_mut() {
            one += &mean;
            one.iter_mut().for_each(|y| *y += hyper.noise * draw.normal());
        }
        Self {
            draws,
            mean: mean.iter().copied().collect(),
            deviation,
            kinship: hyper.kinship.powi(last as i32),
        }
    }

    /// The mean of a chance that hangs on the ln errors of all results.
    pub fn chance(&self, of: impl Fn(&[f64]) -> f64) -> f64 {
        self.draws.as_slice().chunks_exact(self.mean.len()).map(of).sum::<f64>() / DRAWS as f64
    }
}

/// The likeliest hyperparameters of the grid, one after the other.
fn fitted(x: &[&Setting], seen: &[Seen], y: &DVector<f64>) -> Hyper {
    let mut at = vec![MIDDLE; OF_NOISE + 1 + x.first().map_or(0, |trial| trial.place.len())];
    let worth = |at: &[usize]| {
        let far: f64 = at.iter().map(|i| (*i as f64 - MIDDLE as f64).powi(2)).sum();
        hyper(at).evidence(x, seen, y) - PULL * far
    };
    let mut best = worth(&at);
    for turn in 0..PASSES * at.len() {
        let which = turn % at.len();
        let count = if which == OF_NOISE { NOISE.len() } else { AMPLITUDE.len() };
        for value in 0..count {
            let before = std::mem::replace(&mut at[which], value);
            let here = if before == value { best } else { worth(&at) };
            if here > best {
                best = here;
            } else {
                at[which] = before;
            }
        }
    }
    hyper(&at)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of one coordinate, with looks and sensors.
    fn settings(known: impl Iterator<Item = (f64, usize, usize)>) -> Vec<Setting> {
        known.map(|(x, looks, sensors)| Setting { place: vec![x], looks, sensors }).collect()
    }

    fn predicted(x: &[Setting], seen: &[Seen]) -> Prediction {
        Prediction::new(&x.iter().collect::<Vec<_>>(), seen)
    }

    /// y = 1 + x at the last level, half of it above at the first one, and no noise: predicted between the places that were
    /// seen, and surer there than far from them; a look at the first rung makes a trial's result surer.
    #[test]
    fn results_are_predicted_from_looks() {
        let x = settings((0..9).map(|i| (i as f64 / 8.0, 0, i)));
        let truth = |i: usize| 1.0 + x[i].place[0];
        let mut seen: Vec<Seen> =
            [0, 2, 6, 8].iter().flat_map(|&i| [(i, 0, truth(i) + 0.5), (i, 2, truth(i))]).collect();
        let before = predicted(&x, &seen);
        for i in 0..9 {
            let off = before.mean[i] - truth(i);
            assert!(off.abs() < 0.15 && off.abs() < 3.0 * before.deviation[i] + 0.05, "{i}: {off}");
        }
        assert!(before.deviation[4] > before.deviation[2]);
        seen.push((4, 0, truth(4) + 0.5));
        let after = predicted(&x, &seen);
        assert!(after.deviation[4] < before.deviation[4], "{:?}", after.deviation);
        let chance = after.chance(|draw| f64::from(u8::from(draw[0] < draw[8])));
        assert!(chance > 0.95, "{chance}");
    }

    /// Looks that say nothing of the results are found out: what they say moves no prediction.
    #[test]
    fn looks_that_tell_nothing_count_for_little() {
        let mut draw = Draw::numbered(3, 1);
        let x = settings((0..60).map(|i| (0.0, 0, i)));
        let seen: Vec<Seen> =
            (0..59).flat_map(|i| [(i, 0, draw.normal()), (i, 2, 0.5 * draw.normal())]).collect();
        let shown = |first: f64| {
            let mut seen = seen.clone();
            seen.push((59, 0, first));
            predicted(&x, &seen)
        };
        let (low, high) = (shown(-2.0), shown(2.0));
        assert!((low.mean[59] - high.mean[59]).abs() < 0.8, "{} {}", low.mean[59], high.mean[59]);
        assert!(low.kinship < 0.6, "{}", low.kinship);
    }

    /// Looks of one kind lie far below the results, those of another above, in one setting: both are predicted as they come out.
    #[test]
    fn looks_of_two_kinds_are_told_apart() {
        let x = settings((0..10).map(|i| (0.0, i % 2, i)));
        let mut draw = Draw::numbered(3, 2);
        let result: Vec<f64> = (0..10).map(|_| 3.0 + 0.3 * draw.normal()).collect();
        let look = |i: usize| result[i] + if i.is_multiple_of(2) { -1.0 } else { 0.6 };
        let mut seen: Vec<Seen> = (0..10).map(|i| (i, 0, look(i))).collect();
        seen.extend((0..6).map(|i| (i, 2, result[i])));
        let found = predicted(&x, &seen);
        for i in 6..10 {
            assert!((found.mean[i] - result[i]).abs() < 0.25, "{i}: {} {}", found.mean[i], result[i]);
        }
    }

    /// One of two placements reads worse in three settings: so it will in a fourth, far from them, where nobody has looked.
    #[test]
    fn a_placement_is_worth_the_same_in_other_settings() {
        let x = settings((0..8).map(|i| (3.0 * (i / 2) as f64, 0, i % 2)));
        let truth = |i: usize| [2.0, 3.0, 1.5, 2.5][i / 2] + if i.is_multiple_of(2) { 0.0 } else { 0.8 };
        let seen: Vec<Seen> = (0..6).flat_map(|i| [(i, 0, truth(i) + 0.2), (i, 2, truth(i))]).collect();
        let found = predicted(&x, &seen);
        assert!((0.5..1.0).contains(&(found.mean[7] - found.mean[6])), "{:?}", found.mean);
    }
}
