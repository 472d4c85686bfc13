//! Symmetric matrices that are positive definite up to rounding errors. Uses a Cholesky factor or, if that fails, eigenvalues
//! raised to a lower bound.

use crate::brain::linear::matrix;
use faer::linalg::solvers::{SelfAdjointEigen, Solve};
use faer::{Mat, MatRef, Side};
use nalgebra::allocator::Allocator;
use nalgebra::{DMatrix, DefaultAllocator, Dim, Dyn, OMatrix};

/// ½ ln |B| for B with eigenvalues of at least `least`; infinite if B is not finite.
pub(crate) fn half_log(b: MatRef<'_, f64>, least: f64) -> f64 {
    match b.llt(Side::Lower) {
        Ok(factor) => factor.L().diagonal().column_vector().iter().map(|l| l.ln()).sum(),
        Err(_) => by_eigenvalues(b)
            .map_or(f64::INFINITY, |own| (0..b.nrows()).map(|k| 0.5 * own.S()[k].max(least).ln()).sum()),
    }
}

/// B⁻¹ x; `None` if it is not finite.
pub(crate) fn solve_with_floor(b: MatRef<'_, f64>, least: f64, x: MatRef<'_, f64>) -> Option<Mat<f64>> {
    let found = match b.llt(Side::Lower) {
        Ok(factor) => factor.solve(x),
        Err(_) => divided(b, least, x)?,
    };
    found.is_all_finite().then_some(found)
}

/// As [`solve_with_floor`], with nalgebra's factor.
pub(crate) fn solved_dense<C: Dim>(
    b: DMatrix<f64>,
    least: f64,
    x: &OMatrix<f64, Dyn, C>,
) -> Option<OMatrix<f64, Dyn, C>>
where
    DefaultAllocator: Allocator<Dyn, C>,
{
    let n = b.nrows();
    let found = match b.clone().cholesky() {
        Some(factor) => factor.solve(x),
        None => {
            let found = divided(matrix(b.as_slice(), n, n), least, matrix(x.as_slice(), n, x.ncols()))?;
            OMatrix::from_fn_generic(Dyn(n), x.shape_generic().1, |i, j| found[(i, j)])
        }
    };
    found.iter().all(|x| x.is_finite()).then_some(found)
}

/// B⁻¹; `None` if it is not finite.
pub fn inverse(b: DMatrix<f64>, least: f64) -> Option<DMatrix<f64>> {
    let n = b.nrows();
    solved_dense(b, least, &DMatrix::identity(n, n))
}

/// B⁻¹ x by eigenvalues, raised to `least`.
fn divided(b: MatRef<'_, f64>, least: f64, x: MatRef<'_, f64>) -> Option<Mat<f64>> {
    let own = by_eigenvalues(b)?;
    let mut along = own.U().transpose() * x;
    for k in 0..b.nrows() {
        along.row_mut(k).iter_mut().for_each(|x| *x /= own.S()[k].max(least));
    }
    Some(own.U() * &along)
}

fn by_eigenvalues(b: MatRef<'_, f64>) -> Option<SelfAdjointEigen<f64>> {
    if b.is_all_finite() { b.self_adjoint_eigen(Side::Lower).ok() } else { None }
}

#[cfg(test)]
mod tests;
