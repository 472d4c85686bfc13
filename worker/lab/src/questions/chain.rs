//! Lower bound on the error of every decoder that uses the distribution of the stimuli: walks on the posterior that start at the
//! truth.
//!
//! ```text
//! x = s(u) + noise     least E w |ĝ(x) − g(u)|² = E w(u₀) ½ |g(u₀) − g(u′)|²,  u′ ~ π ∝ w(u) p(u|x)
//! the truth u₀ is a draw from p(u|x); for an even number n of steps of a kernel K that is reversible with respect to π
//!     E_π ½ |g(u₀) − g(uₙ)|² = Var g − |K^(n/2) (g − ḡ)|² ≤ Var g
//! ```
//! Short walks give a smaller bound, but a valid one (even lags: Geyer 1992, doi:10.1214/ss/1177011137, §3.3). Steps are
//! Metropolis–Hastings with Newton proposals (Martin et al. 2012, doi:10.1137/110845598). u = ln(p/(1 − p)), p uniform in (0, 1).

use metasense_numerics::random::Stream;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Outputs of a model for some parameters.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ModelOutput {
    /// s in units of the noise, which is white.
    pub(crate) readings: Vec<f64>,
    /// g, the quantity to estimate.
    pub(crate) targets: Vec<f64>,
    /// ln w.
    pub(crate) weight: f64,
}

/// Curvature of −ln of a parameter's prior: that of a Gaussian with the same variance, π²/3.
const PRIOR: f64 = 0.304;
/// Evaluates several sets of parameters; `None` for failed ones.
pub(crate) type Model<'a> = dyn FnMut(&[Vec<f64>]) -> Vec<Option<ModelOutput>> + 'a;

/// Step of one-sided differences; proposals need no better ones.
const STEP: f64 = 1e-3;
/// Weight of the current point in the mean of a proposal.
const PERSISTENCE: f64 = 0.5;
/// Number of steps of a walk; even.
const STEPS: usize = 4;

/// A walk: g of the truth, noisy readings of the truth, the current point.
struct Walk {
    first: Vec<f64>,
    x: DVector<f64>,
    state: WalkState,
}

/// Current point of a walk, and the Gaussian of its proposals.
struct WalkState {
    u: DVector<f64>,
    seen: ModelOutput,
    mean: DVector<f64>,
    factor: Cholesky<f64, Dyn>,
    /// ln of w p(u|x), up to a constant.
    density: f64,
}

impl WalkState {
    /// From the model at u and with each parameter displaced; `None` if one fails.
    fn new(u: DVector<f64>, mut seen: Vec<Option<ModelOutput>>, x: &DVector<f64>) -> Option<Self> {
        let moved: Option<Vec<ModelOutput>> = seen.split_off(1).into_iter().collect();
        let (moved, seen) = (moved?, seen.pop()??);
        let s = DVector::from_column_slice(&seen.readings);
        let columns: Vec<DVector<f64>> =
            moved.iter().map(|m| (DVector::from_column_slice(&m.readings) - &s) / STEP).collect();
        let j = DMatrix::from_columns(&columns);
        let factor = (j.tr_mul(&j) + PRIOR * DMatrix::identity(u.len(), u.len())).cholesky()?;
        let residual = x - &s;
        let slope = j.tr_mul(&residual) - u.map(|u| (0.5 * u).tanh());
        let mean = &u + (1.0 - PERSISTENCE) * factor.solve(&slope);
        let prior: f64 = u.iter().map(|u| -u - 2.0 * (-u).exp().ln_1p()).sum();
        let density = seen.weight + prior - 0.5 * residual.norm_squared();
        density.is_finite().then_some(Self { u, seen, mean, factor, density })
    }

    fn proposed(&self, stream: &mut Stream) -> DVector<f64> {
        let z = DVector::from_fn(self.u.len(), |_, _| stream.normal());
        let spread = self.factor.l().tr_solve_lower_triangular(&z).expect("a factor");
        &self.mean + (1.0 - PERSISTENCE * PERSISTENCE).sqrt() * spread
    }

    /// ln of the density of proposing u, up to a constant.
    fn log_proposal_density(&self, u: &DVector<f64>) -> f64 {
        let l = self.factor.l_dirty();
        let determinant: f64 = (0..u.len()).map(|i| l[(i, i)].ln()).sum();
        let whitened_offset = self.factor.l().tr_mul(&(u - &self.mean));
        determinant - 0.5 * whitened_offset.norm_squared() / (1.0 - PERSISTENCE * PERSISTENCE)
    }
}

/// ½ |g(u₀) − g(uₙ)|² of walks from each of the truths; `stream` supplies noise and proposals. `None` if the model fails at the
/// truth.
pub(crate) fn walks(truths: Vec<Vec<f64>>, model: &mut Model, stream: &mut Stream) -> Vec<Option<f64>> {
    let mut evaluate_stencils = |at: &[DVector<f64>]| -> Vec<Vec<Option<ModelOutput>>> {
        let around = |u: &DVector<f64>| {
            let moved = (0..u.len()).map(|k| {
                let mut u = u.clone();
                u[k] += STEP;
                u
            });
            std::iter::once(u.clone()).chain(moved).map(|u| u.as_slice().to_vec()).collect::<Vec<_>>()
        };
        let all: Vec<Vec<f64>> = at.iter().flat_map(around).collect();
        let each = all.len() / at.len().max(1);
        let mut seen = model(&all).into_iter();
        at.iter().map(|_| seen.by_ref().take(each).collect()).collect()
    };
    let truths: Vec<DVector<f64>> = truths.into_iter().map(DVector::from_vec).collect();
    let initial_walks = evaluate_stencils(&truths).into_iter().zip(&truths).map(|(seen, u)| {
        let truth = seen[0].as_ref()?;
        let readings = truth.readings.iter().map(|s| s + stream.normal()).collect();
        let (first, x) = (truth.targets.clone(), DVector::from_vec(readings));
        Some(Walk { first, state: WalkState::new(u.clone(), seen, &x)?, x })
    });
    let mut all: Vec<Option<Walk>> = initial_walks.collect();
    for _ in 0..STEPS {
        let proposed: Vec<DVector<f64>> =
            all.iter().flatten().map(|walk| walk.state.proposed(stream)).collect();
        let found = evaluate_stencils(&proposed);
        for ((Walk { state: stand, x, .. }, u), seen) in all.iter_mut().flatten().zip(proposed).zip(found) {
            let chance = stream.uniform().ln();
            let Some(next) = WalkState::new(u, seen, x) else { continue };
            let ratio = next.density + next.log_proposal_density(&stand.u)
                - stand.density
                - stand.log_proposal_density(&next.u);
            if chance < ratio {
                *stand = next;
            }
        }
    }
    let square = |Walk { first, state: stand, .. }: &Walk| {
        first.iter().zip(&stand.seen.targets).map(|(a, b)| (a - b).powi(2)).sum::<f64>()
    };
    all.iter().map(|walk| walk.as_ref().map(|walk| 0.5 * square(walk))).collect()
}

#[cfg(test)]
mod tests;
