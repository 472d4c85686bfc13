//! Projection onto bounds and linear constraints, by one convex program in Clarabel.
//!
//! ```text
//! minimise Σ w (α − target)²   subject to lower ≤ α ≤ upper, least ≤ Σ a α ≤ most
//! ```
//! Bounds hold exactly, constraints within 1e-7 relative to their terms.

use super::project::{Projection, Stage, Status, distance, metric};
use super::{Castable, program::settings};
use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus, ZeroConeT};

/// Bounds and linear constraints of a design.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LinearLimits {
    /// Least value of each number; −∞: none.
    pub lower: Vec<f64>,
    /// Greatest value of each number; ∞: none.
    pub upper: Vec<f64>,
    /// Constraints.
    pub rows: Vec<LinearRow>,
}

/// One linear constraint.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearRow {
    /// Index into the design, coefficient.
    pub terms: Vec<(usize, f64)>,
    /// Least value of the sum; −∞: none.
    pub least: f64,
    /// Greatest value of the sum; ∞: none. Equal to `least`: an equation.
    pub most: f64,
}

/// Tolerance of a constraint, relative to the sum of |terms|.
const ROUNDING: f64 = 1e-7;

impl LinearRow {
    /// Euclidean length of the coefficients.
    fn length(&self) -> f64 {
        self.terms.iter().map(|(_, a)| a * a).sum::<f64>().sqrt()
    }

    fn sum(&self, design: &[f64]) -> f64 {
        self.terms.iter().map(|(i, a)| a * design[*i]).sum()
    }

    fn holds(&self, design: &[f64]) -> bool {
        let terms: f64 = self.terms.iter().map(|(i, a)| (a * design[*i]).abs()).sum();
        let (sum, rounding) = (self.sum(design), ROUNDING * terms.max(f64::MIN_POSITIVE));
        sum >= self.least - rounding && sum <= self.most + rounding
    }
}

impl LinearLimits {
    /// Whether a design satisfies the limits.
    pub fn hold(&self, design: &[f64]) -> bool {
        let bounded = design.iter().zip(&self.lower).zip(&self.upper);
        bounded.into_iter().all(|((x, low), high)| x >= low && x <= high)
            && self.rows.iter().all(|row| row.holds(design))
    }

    fn clipped(&self, design: &[f64]) -> Vec<f64> {
        let bounds = self.lower.iter().zip(&self.upper);
        design.iter().zip(bounds).map(|(x, (low, high))| x.max(*low).min(*high)).collect()
    }

    /// The solution and the number of iterations; unknowns divided by `scale` are of order 1.
    fn nearest(&self, target: &[f64], weights: &[f64], scale: f64) -> Option<(Vec<f64>, u64)> {
        // (coefficients a, right side b) of Σ a d ≤ b and of Σ a d = b
        let (mut below, mut equal) = (Vec::new(), Vec::new());
        for i in 0..target.len() {
            below.push((vec![(i, 1.0)], (self.upper[i] - target[i]) / scale));
            below.push((vec![(i, -1.0)], (target[i] - self.lower[i]) / scale));
        }
        for row in &self.rows {
            let length = row.length();
            let side = |sign: f64, limit: f64| {
                let terms: Vec<_> = row.terms.iter().map(|(i, a)| (*i, sign * a / length)).collect();
                (terms, sign * (limit - row.sum(target)) / (scale * length))
            };
            match row.least == row.most {
                true => equal.push(side(1.0, row.most)),
                false => below.extend([side(1.0, row.most), side(-1.0, row.least)]),
            }
        }
        below.retain(|(_, right)| right.is_finite());
        let cones = [ZeroConeT(equal.len()), NonnegativeConeT(below.len())];
        let rows: Vec<_> = equal.into_iter().chain(below).collect();
        let n = target.len();
        let terms = rows.iter().enumerate().flat_map(|(r, (of, _))| of.iter().map(move |(i, a)| (r, *i, *a)));
        let (places, columns, values) = terms.collect();
        let matrix = CscMatrix::new_from_triplets(rows.len(), n, places, columns, values);
        let quadratic = CscMatrix::new(n, n, (0..=n).collect(), (0..n).collect(), weights.to_vec());
        let right: Vec<f64> = rows.iter().map(|(_, right)| *right).collect();
        let mut solver =
            DefaultSolver::new(&quadratic, &vec![0.0; n], &matrix, &right, &cones, settings()).ok()?;
        solver.solve();
        let solution = &solver.solution;
        let solved = matches!(solution.status, SolverStatus::Solved | SolverStatus::AlmostSolved);
        let design: Vec<f64> = target.iter().zip(&solution.x).map(|(t, d)| t + scale * d).collect();
        let design = self.clipped(&design);
        (solved && self.hold(&design)).then_some((design, u64::from(solution.iterations)))
    }
}

impl Castable for LinearLimits {
    fn project(&mut self, previous: &[f64], target: &[f64], weights: Option<&[f64]>) -> Projection {
        let finish = |design: Vec<f64>, status: Status, iterations: u64| {
            let distance = distance(&design, target);
            let (stage, programs) = (Stage::None, u64::from(iterations > 0));
            Projection { design, status, stage, distance, active: Vec::new(), iterations, programs }
        };
        let finite = target.iter().all(|x| x.is_finite());
        let Some(weights) = metric(target.len(), weights).filter(|_| finite) else {
            return finish(previous.to_vec(), Status::NotFinite, 0);
        };
        if self.hold(target) {
            return finish(target.to_vec(), Status::Untouched, 0);
        }
        let clipped = self.clipped(target);
        if self.hold(&clipped) && self.rows.is_empty() {
            return finish(clipped, Status::Projected, 0);
        }
        let off = |row: &LinearRow| {
            let sum = row.sum(target);
            (row.least - sum).max(sum - row.most).max(0.0) / row.length()
        };
        let moved = clipped.iter().zip(target).map(|(a, b)| (a - b).abs());
        let scale = moved.chain(self.rows.iter().map(off)).fold(0.0, f64::max);
        match self.nearest(target, &weights, scale) {
            Some((design, iterations)) => finish(design, Status::Projected, iterations),
            None if self.hold(previous) => finish(previous.to_vec(), Status::Kept, 0),
            None => finish(previous.to_vec(), Status::Infeasible, 0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits(rows: Vec<LinearRow>) -> LinearLimits {
        LinearLimits { lower: vec![0.0; 3], upper: vec![1.0, 1.0, f64::INFINITY], rows }
    }

    /// Solutions of the Karush-Kuhn-Tucker conditions.
    #[test]
    fn the_nearest_design_is_found() {
        let found = limits(Vec::new()).project(&[0.5; 3], &[2.0, -1.0, 7.0], None);
        assert_eq!((found.design, found.status), (vec![1.0, 0.0, 7.0], Status::Projected));
        // mean 0.5 in the metric (1, 1, 4): α = target − λ/w
        let mean = LinearRow { terms: vec![(0, 1.0), (1, 1.0), (2, 1.0)], least: 1.5, most: 1.5 };
        let found = limits(vec![mean.clone()]).project(&[0.5; 3], &[0.9, 0.9, 0.6], Some(&[1.0, 1.0, 4.0]));
        let by = 0.9 / 2.25;
        for (x, wanted) in found.design.iter().zip([0.9 - by, 0.9 - by, 0.6 - by / 4.0]) {
            assert!((x - wanted).abs() < 1e-7, "{:?}", found.design);
        }
        let scaled: Vec<f64> = [0.9, 0.9, 0.6].map(|x| 1e-4 * x).into();
        let small = LinearRow { least: 1.5e-4, most: 1.5e-4, ..mean };
        let found = limits(vec![small.clone()]).project(&[5e-5; 3], &scaled, None);
        assert_eq!(found.status, Status::Projected);
        assert!(small.holds(&found.design));
    }

    #[test]
    fn designs_that_cannot_be_are_named() {
        let never = LinearRow { terms: vec![(0, 1.0), (1, 1.0)], least: 3.0, most: f64::INFINITY };
        let mut contradictory = limits(vec![never]);
        assert_eq!(contradictory.project(&[0.5; 3], &[0.6; 3], None).status, Status::Infeasible);
        let found = limits(Vec::new()).project(&[0.5; 3], &[f64::NAN, 0.0, 0.0], None);
        assert_eq!((found.design, found.status), (vec![0.5; 3], Status::NotFinite));
        assert_eq!(limits(Vec::new()).project(&[0.5; 3], &[0.1; 3], None).status, Status::Untouched);
    }
}
