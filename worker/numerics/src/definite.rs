//! Symmetric matrices that are positive definite in exact arithmetic, though rounding may have made them less: by a Cholesky factor, and
//! where that fails by eigenvalues, none of them below what it must be.

use crate::brain::linear::matrix;
use faer::linalg::solvers::{SelfAdjointEigen, Solve};
use faer::{Mat, MatRef, Side};
use nalgebra::{DMatrix, DVector};

/// ½ ln |B| of such a B, whose eigenvalues are `least` and more; infinite of numbers that are none.
pub(crate) fn half_log(b: MatRef<'_, f64>, least: f64) -> f64 {
    match b.llt(Side::Lower) {
        Ok(factor) => factor.L().diagonal().column_vector().iter().map(|l| l.ln()).sum(),
        Err(_) => by_eigenvalues(b)
            .map_or(f64::INFINITY, |own| (0..b.nrows()).map(|k| 0.5 * own.S()[k].max(least).ln()).sum()),
    }
}

/// B⁻¹ x; `None` of numbers that are none.
pub(crate) fn solved(b: MatRef<'_, f64>, least: f64, x: MatRef<'_, f64>) -> Option<Mat<f64>> {
    let found = match b.llt(Side::Lower) {
        Ok(factor) => factor.solve(x),
        Err(_) => divided(b, least, x)?,
    };
    found.is_all_finite().then_some(found)
}

/// The same by nalgebra's factor.
pub(crate) fn solved_vector(b: DMatrix<f64>, least: f64, x: &DVector<f64>) -> Option<DVector<f64>> {
    let n = b.nrows();
    let found = match b.clone().cholesky() {
        Some(factor) => factor.solve(x),
        None => {
            let found = divided(matrix(b.as_slice(), n, n), least, matrix(x.as_slice(), n, 1))?;
            DVector::from_fn(n, |i, _| found[(i, 0)])
        }
    };
    found.iter().all(|x| x.is_finite()).then_some(found)
}

/// B⁻¹; `None` of numbers that are none.
pub(crate) fn inverse(b: DMatrix<f64>, least: f64) -> Option<DMatrix<f64>> {
    let n = b.nrows();
    let found = match b.clone().cholesky() {
        Some(factor) => factor.inverse(),
        None => {
            let found = divided(matrix(b.as_slice(), n, n), least, Mat::<f64>::identity(n, n).as_ref())?;
            DMatrix::from_fn(n, n, |i, j| found[(i, j)])
        }
    };
    found.iter().all(|x| x.is_finite()).then_some(found)
}

/// B⁻¹ x by eigenvalues, none below `least`.
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
