//! Implicit term: change of the test loss through the dependence of the trained weights on the training signals.
//!
//! ```text
//! H z = b,  b = ∂L_test/∂β,  H = ∂²L_train/∂β²          (conjugate gradients, at most 20 products)
//! cotangent on x_train = −∂/∂x ⟨∂L_train/∂β, z⟩
//! ```
//! In f64: 20 products with an indefinite H amplify rounding errors.

use super::Implicit;
use crate::brain::{self, Curvature, Data, Workspace};

/// Tolerance ‖r‖ ≤ 1e-7 ‖b‖ and limit of 20 products, as in the paper.
const TOLERANCE: f64 = 1e-7;
const PRODUCTS_MAX: usize = 20;

/// Cotangent on a network's training inputs (N, T, 3M), and the outcome of its linear system.
pub(super) fn implicit_term(
    [train, test]: &[Data<f64>; 2],
    weights: &[f32],
    pool: &crate::Pool,
) -> (Vec<f64>, Implicit) {
    let mut workspace = Workspace::<f64>::new(train.shape(), pool.width());
    let weights: Vec<f64> = weights.iter().copied().map(f64::from).collect();
    let mut b = vec![0.0; weights.len()];
    brain::loss_gradient(&weights, test.all(), &mut b, &mut workspace, pool);
    let curvature = Curvature::new(&weights, train.all(), &mut workspace, pool);
    let solve = brain::solve_implicit(&curvature, &b, 0.0, TOLERANCE, PRODUCTS_MAX, &mut workspace, pool);
    let found = Implicit {
        iterations: solve.iterations,
        residual: solve.residual,
        smallest_curvature: solve.smallest_curvature,
        outcome: solve.outcome,
    };
    (curvature.mixed_product(&solve.z, &mut workspace, pool).into_iter().map(|c| -c).collect(), found)
}
