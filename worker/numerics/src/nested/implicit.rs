//! The implicit term: how the test loss changes because the trained weights follow the training signals.
//!
//! ```text
//! H z = b,  b = ∂L_test/∂β,  H = ∂²L_train/∂β²          (conjugate gradients, at most 20 products)
//! cotangent on x_train = −∂/∂x ⟨∂L_train/∂β, z⟩
//! ```
//! In f64 throughout: 20 products of an indefinite H amplify every rounding.

use super::report::{Implicit, Log};
use super::setting::Setting;
use crate::brain::{self, Curvature, Policy, Workspace};

/// Tolerance ‖r‖ ≤ 1e-7 ‖b‖ and limit of 20, the paper's.
const TOLERANCE: f64 = 1e-7;
const PRODUCTS_MAX: usize = 20;

/// Cotangent on the network's training inputs (N, T, 3M), from the training and the test signals.
pub(super) fn implicit_term(
    setting: &Setting,
    weights: &[f32],
    train: &[f64],
    test: &[f64],
    policy: Policy,
    log: &mut Log,
) -> Vec<f64> {
    let pool = setting.pool;
    log.timed(
        |s| &mut s.implicit,
        |report| {
            let mut workspace = Workspace::<f64>::new(setting.shape, pool.width());
            let weights: Vec<f64> = weights.iter().copied().map(f64::from).collect();
            let train = setting.data::<f64>(train, &setting.train);
            let test = setting.physical_data::<f64>(test, &setting.test);

            let mut b = vec![0.0; weights.len()];
            brain::loss_gradient(&weights, test.all(), &mut b, &mut workspace, pool);
            let curvature = Curvature::new(&weights, train.all(), &mut workspace, pool);
            let solve =
                brain::solve_implicit(&curvature, &b, policy, TOLERANCE, PRODUCTS_MAX, &mut workspace, pool);
            report.counters.hessian_products += solve.iterations as u64;
            report.implicit = Some(Implicit {
                policy,
                iterations: solve.iterations,
                residual: solve.residual,
                smallest_curvature: solve.smallest_curvature,
                outcome: solve.outcome,
            });
            curvature.mixed_product(&solve.z, &mut workspace, pool).into_iter().map(|c| -c).collect()
        },
    )
}
