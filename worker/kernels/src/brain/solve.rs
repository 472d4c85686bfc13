//! Solves the linear system H z = b of the implicit term by conjugate gradients. They stop before a direction of negative curvature,
//! because H of an unfinished training is singular and indefinite.

use super::curvature::Curvature;
use super::network::Workspace;

/// Outcome of conjugate gradients.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SolveOutcome {
    /// ‖r‖ ≤ tolerance·‖b‖.
    Converged,
    /// The limit of iterations was reached.
    IterationLimit,
    /// A direction p has pᵀHp ≤ 0; z is the iterate before it.
    NegativeCurvature,
    /// A number was NaN or infinite; z is the last finite iterate.
    NonFinite,
}

impl SolveOutcome {
    /// Name in records.
    pub fn name(self) -> &'static str {
        ["converged", "iteration_limit", "negative_curvature", "non_finite"][self as usize]
    }
}

/// Result of conjugate gradients.
#[derive(Debug, Clone)]
pub struct Solve {
    /// The last iterate.
    pub z: Vec<f64>,
    /// Number of products with the matrix.
    pub iterations: usize,
    /// ‖b − Hz‖/‖b‖ from the recurrence; 0 for b = 0.
    pub residual: f64,
    /// Least pᵀHp/pᵀp of all directions, including the shift; infinite if there was none.
    pub smallest_curvature: f64,
    /// Outcome.
    pub outcome: SolveOutcome,
}

/// Solves (A + `shift`·I) z = b from z = 0; `apply(v, out)` computes out = A v.
pub fn conjugate_gradient(
    mut apply: impl FnMut(&[f64], &mut [f64]),
    b: &[f64],
    shift: f64,
    tolerance: f64,
    limit: usize,
) -> Solve {
    let (mut z, mut r, mut p) = (vec![0.0; b.len()], b.to_vec(), b.to_vec());
    let mut ap = vec![0.0; b.len()];
    let norm = dot(b, b).sqrt();
    let mut rr = norm * norm;
    let mut smallest_curvature = f64::INFINITY;
    let mut iterations = 0;
    let outcome = loop {
        if !rr.is_finite() {
            break SolveOutcome::NonFinite;
        }
        if rr.sqrt() <= tolerance * norm {
            break SolveOutcome::Converged;
        }
        if iterations == limit {
            break SolveOutcome::IterationLimit;
        }
        apply(&p, &mut ap);
        iterations += 1;
        ap.iter_mut().zip(&p).for_each(|(ap, p)| *ap += shift * p);
        let (pap, pp) = (dot(&p, &ap), dot(&p, &p));
        if !pap.is_finite() {
            break SolveOutcome::NonFinite;
        }
        smallest_curvature = smallest_curvature.min(pap / pp);
        if pap <= 0.0 {
            break SolveOutcome::NegativeCurvature;
        }
        let alpha = rr / pap;
        z.iter_mut().zip(&p).for_each(|(z, p)| *z += alpha * p);
        r.iter_mut().zip(&ap).for_each(|(r, ap)| *r -= alpha * ap);
        let next = dot(&r, &r);
        p.iter_mut().zip(&r).for_each(|(p, r)| *p = r + next / rr * *p);
        rr = next;
    };
    let residual = if norm > 0.0 { rr.sqrt() / norm } else { 0.0 };
    Solve { z, iterations, residual, smallest_curvature, outcome }
}

/// Solves (H + `shift`·I) z = b of the implicit term: `b` = ∂L_test/∂β, H the Hessian of the training loss.
pub fn solve_implicit(
    curvature: &Curvature<f64>,
    b: &[f64],
    shift: f64,
    tolerance: f64,
    limit: usize,
    ws: &mut Workspace<f64>,
    pool: &crate::Pool,
) -> Solve {
    conjugate_gradient(|v, out| curvature.product(v, out, ws, pool), b, shift, tolerance, limit)
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
