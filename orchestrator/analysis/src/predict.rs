//! Predicts results of trials from earlier observations, with a Gaussian process over settings and levels.
//!
//! ```text
//! y(i, l) = a + b_l + f_l(x_i) + p_l(i) + u_l(i) + ε       ln error of trial i at level l: the rungs, then the result
//! cov(f_l(x), f_m(x')) = σ_f² ρ^|l−m| exp(−½ Σ_d (x_d − x'_d)²/ℓ_d²)     cov(u_l(i), u_m(i)) = σ_u² ρ^|l−m|
//! cov(p_l(i), p_m(j)) = σ_p² ρ^|l−m| if i and j have the same sensors
//! ```
//! (Rasmussen and Williams 2006, eq. 2.25 f. and 5.8; levels as in freeze–thaw, arXiv:1406.3896.) ρ is the correlation of
//! neighbouring levels: a small ρ gives rungs little weight. Each kind of error on the rungs, such as that as designed or over
//! casts, has its own b_l. Hyperparameters are those of largest posterior density on a small grid.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use metasense_numerics::random::Draw;

/// Levels of a trial: two rungs (parts of the outer steps) and the result.
pub const LEVELS: usize = 3;

/// An observation: trial, level, ln of an error in %.
pub type ObservedError = (usize, usize, f64);

/// Properties of a trial that are known before it runs.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Setting {
    /// Coordinates of the setting, about 0 to 1.
    pub place: Vec<f64>,
    /// Kind of error on its rungs: equal numbers, equal kinds. Results are always of the same kind.
    pub rung_kind: usize,
    /// Sensor placement: equal numbers, equal placements.
    pub sensors: usize,
}

/// Grids of the hyperparameters σ_f, ℓ, σ_u and σ_p, ρ, noise; index of the first and a priori most likely values, and position
/// of the noise among the hyperparameters.
const AMPLITUDE: [f64; 5] = [0.2, 0.4, 0.8, 1.3, 2.0];
const LENGTH: [f64; 5] = [0.35, 0.7, 1.4, 3.0, 8.0];
const OWN: [f64; 5] = [0.05, 0.1, 0.2, 0.4, 0.7];
const KINSHIP: [f64; 5] = [0.2, 0.5, 0.75, 0.9, 0.97];
const NOISE: [f64; 4] = [0.03, 0.07, 0.15, 0.3];
const MIDDLE: usize = 2;
const OF_NOISE: usize = 4;
/// Prior variances of a and b_l.
const OF_ALL: f64 = 4.0;
const OF_LEVEL: f64 = 1.0;
/// Prior penalty per hyperparameter (nats per squared grid step from the middle).
const PRIOR_PENALTY: f64 = 0.6;
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

/// Looks up hyperparameters by grid indices: amplitude, own, placed, kinship, noise, then one length per coordinate.
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
    /// Prior covariance of two trials at two levels, without observation noise.
    fn covariance(&self, x: &[&Setting], (i, l): (usize, usize), (j, m): (usize, usize)) -> f64 {
        let apart = x[i].place.iter().zip(&x[j].place).map(|(a, b)| a - b);
        let distance: f64 = apart.zip(&self.lengths).map(|(apart, length)| (apart / length).powi(2)).sum();
        let setting = self.amplitude.powi(2) * (-0.5 * distance).exp();
        let own = if i == j { self.own.powi(2) } else { 0.0 };
        let placed = if x[i].sensors == x[j].sensors { self.placed.powi(2) } else { 0.0 };
        let alike = l == LEVELS - 1 || x[i].rung_kind == x[j].rung_kind;
        let level = if l == m && alike { OF_LEVEL } else { 0.0 };
        OF_ALL + level + self.kinship.powi(l.abs_diff(m) as i32) * (setting + placed + own)
    }

    fn factor(&self, x: &[&Setting], seen: &[ObservedError]) -> Option<Cholesky<f64, Dyn>> {
        let of = |a: usize, b: usize| {
            let ((i, l, _), (j, m, _)) = (seen[a], seen[b]);
            self.covariance(x, (i, l), (j, m)) + if a == b { self.noise.powi(2) } else { 0.0 }
        };
        DMatrix::from_fn(seen.len(), seen.len(), of).cholesky()
    }

    /// Returns the log marginal likelihood of y, up to a constant.
    fn log_likelihood(&self, x: &[&Setting], seen: &[ObservedError], y: &DVector<f64>) -> f64 {
        let Some(factor) = self.factor(x, seen) else { return f64::NEG_INFINITY };
        let logs: f64 = factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum();
        -0.5 * y.dot(&factor.solve(y)) - logs
    }
}

/// Joint prediction of the results of trials. Draws include observation noise.
#[derive(Debug, Clone)]
pub struct Prediction {
    /// Expected ln error of each trial's result.
    pub mean: Vec<f64>,
    /// Its standard deviation, without observation noise.
    pub deviation: Vec<f64>,
    /// ln errors: one row per trial, one column per draw.
    draws: DMatrix<f64>,
    /// Correlation of first rung and result: ρ^(levels between them).
    pub kinship: f64,
}

/// Number of draws of a prediction.
const DRAWS: usize = 500;

impl Prediction {
    /// Predicts the results of trials with settings `x` from the observations `seen`.
    pub fn new(x: &[&Setting], seen: &[ObservedError]) -> Self {
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
        // if rounding makes the covariance indefinite, trials are drawn independently
        let apart = || DMatrix::from_diagonal(&DVector::from_column_slice(&deviation));
        let root = covariance.cholesky().map_or_else(apart, |factor| factor.unpack());
        let mut draws = root * z;
        for mut one in draws.column_iter_mut() {
            one += &mean;
            one.iter_mut().for_each(|y| *y += hyper.noise * draw.normal());
        }
        let kinship = hyper.kinship.powi(last as i32);
        Self { draws, mean: mean.iter().copied().collect(), deviation, kinship }
    }

    /// Mean over the draws of a function of the ln errors of all results.
    pub fn chance(&self, of: impl Fn(&[f64]) -> f64) -> f64 {
        self.draws.as_slice().chunks_exact(self.mean.len()).map(of).sum::<f64>() / DRAWS as f64
    }
}

/// Maximises the posterior density by coordinate search on the grid.
fn fitted(x: &[&Setting], seen: &[ObservedError], y: &DVector<f64>) -> Hyper {
    let mut grid_index = vec![MIDDLE; OF_NOISE + 1 + x.first().map_or(0, |trial| trial.place.len())];
    let worth = |grid_index: &[usize]| {
        let far: f64 = grid_index.iter().map(|i| (*i as f64 - MIDDLE as f64).powi(2)).sum();
        hyper(grid_index).log_likelihood(x, seen, y) - PRIOR_PENALTY * far
    };
    let mut best = worth(&grid_index);
    for turn in 0..PASSES * grid_index.len() {
        let which = turn % grid_index.len();
        let count = if which == OF_NOISE { NOISE.len() } else { AMPLITUDE.len() };
        for value in 0..count {
            let before = std::mem::replace(&mut grid_index[which], value);
            let here = if before == value { best } else { worth(&grid_index) };
            if here > best {
                best = here;
            } else {
                grid_index[which] = before;
            }
        }
    }
    hyper(&grid_index)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Settings with one coordinate, a kind of rungs and a placement each.
    fn settings(known: impl Iterator<Item = (f64, usize, usize)>) -> Vec<Setting> {
        known.map(|(x, looks, sensors)| Setting { place: vec![x], rung_kind: looks, sensors }).collect()
    }

    fn predicted(x: &[Setting], seen: &[ObservedError]) -> Prediction {
        Prediction::new(&x.iter().collect::<Vec<_>>(), seen)
    }

    /// Without noise, y = 1 + x as result and 0.5 more on the first rung. Results between observed trials are predicted, with a
    /// larger deviation than observed ones; an observed rung lowers the deviation of its trial's result.
    #[test]
    fn results_are_predicted_from_looks() {
        let x = settings((0..9).map(|i| (i as f64 / 8.0, 0, i)));
        let truth = |i: usize| 1.0 + x[i].place[0];
        let mut seen: Vec<ObservedError> =
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

    /// Rungs that are independent of the results hardly change predictions.
    #[test]
    fn looks_that_tell_nothing_count_for_little() {
        let mut draw = Draw::numbered(3, 1);
        let x = settings((0..60).map(|i| (0.0, 0, i)));
        let seen: Vec<ObservedError> =
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

    /// One kind of rungs is far below the results, another above, in one setting: results of both kinds are predicted.
    #[test]
    fn looks_of_two_kinds_are_told_apart() {
        let x = settings((0..10).map(|i| (0.0, i % 2, i)));
        let mut draw = Draw::numbered(3, 2);
        let result: Vec<f64> = (0..10).map(|_| 3.0 + 0.3 * draw.normal()).collect();
        let look = |i: usize| result[i] + if i.is_multiple_of(2) { -1.0 } else { 0.6 };
        let mut seen: Vec<ObservedError> = (0..10).map(|i| (i, 0, look(i))).collect();
        seen.extend((0..6).map(|i| (i, 2, result[i])));
        let found = predicted(&x, &seen);
        for i in 6..10 {
            assert!((found.mean[i] - result[i]).abs() < 0.25, "{i}: {} {}", found.mean[i], result[i]);
        }
    }

    /// One of two placements has larger errors in three settings; this is predicted for a distant fourth setting without
    /// observations.
    #[test]
    fn a_placement_is_worth_the_same_in_other_settings() {
        let x = settings((0..8).map(|i| (3.0 * (i / 2) as f64, 0, i % 2)));
        let truth = |i: usize| [2.0, 3.0, 1.5, 2.5][i / 2] + if i.is_multiple_of(2) { 0.0 } else { 0.8 };
        let seen: Vec<ObservedError> =
            (0..6).flat_map(|i| [(i, 0, truth(i) + 0.2), (i, 2, truth(i))]).collect();
        let found = predicted(&x, &seen);
        assert!((0.5..1.0).contains(&(found.mean[7] - found.mean[6])), "{:?}", found.mean);
    }
}
