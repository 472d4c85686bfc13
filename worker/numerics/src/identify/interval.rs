//! Intervals of the fit, and directions that the records do not determine.
//!
//! ```text
//! covariance = H⁻¹ ((1 + u (G − 1)) G/(G − 1) Σ_g s_g s_gᵀ + 1) H⁻¹,   H = JᵀJ + 1,   s_g = J_gᵀ r_g
//! ```
//! A group g is a record, or with fewer than ten records a time segment of one. Noise may be correlated within a group. The share u of the
//! residual that is not noise, or that filters of the motion explain, does not average out. Intervals (95 %) use Student's t with G − 1
//! degrees of freedom. They are at least those of white noise, H⁻¹, since scores of few groups are often too small (Angrist and Pischke,
//! Mostly Harmless Econometrics, 2009, 8.1). They are marginal over all other unknowns.

use super::descent::covariance;
use super::discrepancy::explained;
use super::objective::{Columns, FitPoint, Misfit};
use super::unknowns::TRUST;
use super::{BOX, Fit};
use crate::student::student;
use nalgebra::DMatrix;

/// Records from which each is a group; least number of groups from segments.
const ENOUGH: usize = 10;
const PARTS: usize = 20;
/// Factor that the 95 % interval of a determined direction must not exceed.
const KNOWN: f64 = 3.0;
/// 97.5 % quantile of the normal distribution.
const NORMAL: f64 = 1.96;
/// Eigenvalues below this fraction of the largest are rounding errors.
const ROUNDED: f64 = 1e-12;
/// Largest undetermined share of a determined parameter.
const SHARE: f64 = 0.05;

/// Combination Π pᵏ of free parameters that the records do not determine.
#[derive(Debug, Clone, PartialEq)]
pub struct Direction {
    /// Exponents (unit vector), in the order of the estimates.
    pub exponents: Vec<f64>,
    /// Factor of its 95 % interval; infinite if the records do not depend on it.
    pub factor: f64,
}

/// Sets a fit's intervals from the columns of all records that count.
pub fn bound(fit: &mut Fit, objective: &Misfit<'_>, point: &FitPoint, columns: &Columns) {
    let (records, jacobian) = (columns.records.len(), objective.jacobian(point, columns));
    let [read, left, residual] = objective.parts(point, &columns.records);
    let width = fit.twin.noise.len();
    fit.unmodelled = explained(&read, &left, records, width);
    let (group, count) = grouped([records, residual.len() / (records * width), width]);
    let mut scores = DMatrix::zeros(count, jacobian.ncols());
    for (k, column) in jacobian.column_iter().enumerate() {
        for ((&group, r), j) in group.iter().zip(&residual).zip(column.iter()) {
            scores[(group, k)] += r * j;
        }
    }
    let inverse = covariance(jacobian.tr_mul(&jacobian) + DMatrix::identity(scores.ncols(), scores.ncols()));
    let beyond = 1.0 - fit.twin.misfit.max(1.0).powi(-2);
    let alike = 1.0 + fit.unmodelled.unwrap_or(0.0).max(beyond) * (count - 1) as f64;
    let few = count as f64 / (count - 1).max(1) as f64;
    let (moved, t) = (scores * &inverse, student(count - 1));
    let covariance = t * t * (alike * few * moved.tr_mul(&moved) + &inverse * &inverse);
    let shared = (alike - 1.0) / (count - 1).max(1) as f64;
    fit.offsets = objective.offsets(point, columns, &jacobian, &covariance, shared);
    for (k, estimate) in fit.estimates.iter_mut().enumerate() {
        estimate.left = inverse[(k, k)].sqrt();
        estimate.half = Some(covariance[(k, k)].sqrt().max(NORMAL * estimate.left));
    }
    let free = objective.unknowns.free();
    if free == 0 {
        return;
    }
    fit.undetermined = undetermined(&inverse.view((0, 0), (free, free)).into_owned());
    let undetermined = &fit.undetermined;
    let unknown = |k: usize| undetermined.iter().map(|d| d.exponents[k].powi(2)).sum::<f64>() > SHARE;
    for (k, estimate) in fit.estimates[..free].iter_mut().enumerate() {
        let determined = !unknown(k);
        estimate.at_the_bound = determined && (estimate.scatter * estimate.found).abs() > BOX.ln() - 1e-9;
        estimate.half = estimate.half.filter(|_| determined && !estimate.at_the_bound);
    }
    let correlation = |i: usize, j: usize| match unknown(i) || unknown(j) {
        _ if i == j => 1.0,
        true => 0.0,
        false => covariance[(i, j)] / (covariance[(i, i)] * covariance[(j, j)]).sqrt(),
    };
    fit.correlation = (0..free).map(|i| (0..free).map(|j| correlation(i, j)).collect()).collect();
}

/// Undetermined directions of free parameters, from their posterior covariance in units of `TRUST`.
fn undetermined(inverse: &DMatrix<f64>) -> Vec<Direction> {
    let eigen = information(inverse).symmetric_eigen();
    let largest = eigen.eigenvalues.max();
    let mut undetermined = Vec::new();
    for (k, &value) in eigen.eigenvalues.iter().enumerate() {
        let factor = (NORMAL * TRUST / value.max(0.0).sqrt()).exp();
        if factor < KNOWN && value > ROUNDED * largest {
            continue;
        }
        let column = eigen.eigenvectors.column(k);
        // Make the largest exponent positive.
        let sign = column[column.iamax()].signum();
        let factor = if value > ROUNDED * largest { factor } else { f64::INFINITY };
        undetermined.push(Direction { exponents: column.iter().map(|c| sign * c).collect(), factor });
    }
    undetermined.sort_by(|a, b| b.factor.total_cmp(&a.factor));
    undetermined
}

/// Information of the records alone: inverse covariance minus the prior's identity.
fn information(inverse: &DMatrix<f64>) -> DMatrix<f64> {
    let free = inverse.nrows();
    let whole = inverse.clone().try_inverse().unwrap_or_else(|| DMatrix::identity(free, free));
    0.5 * (&whole + whole.transpose()) - DMatrix::identity(free, free)
}

/// Group of every entry of signals (records, length, width), and the number of groups.
fn grouped([records, length, width]: [usize; 3]) -> (Vec<usize>, usize) {
    let parts = if records >= ENOUGH { 1 } else { PARTS.div_ceil(records).min(length) };
    let of = |entry: usize| {
        let (record, n) = (entry / (length * width), entry / width % length);
        record * parts + n * parts / length
    };
    ((0..records * length * width).map(of).collect(), records * parts)
}
