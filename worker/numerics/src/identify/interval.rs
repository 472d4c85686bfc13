//! How well records tell parameters.
//!
//! ```text
//! covariance = (1 + u (G − 1)) (G − 1)/G Σ_g (δ_g − δ̄)(δ_g − δ̄)ᵀ,   δ_g = −(H − H_g)⁻¹ (∇F − ∇F_g),   H = JᵀJ
//! ```
//! The jackknife of one step (Efron, The Jackknife, the Bootstrap and Other Resampling Plans, 1982): each group of residuals
//! left out once. A group is a record, or, of fewer than ten records, a part of one in time, so that noise may be
//! correlated within it. The share u of the residual that the model lacks is alike in all of them. 95 % by Student's t with
//! G − 1 degrees of freedom.

use super::objective::{Objective, Point};
use super::{BOX, Offset, Parameter};
use crate::student::student;
use nalgebra::{DMatrix, DVector};

/// Records from which each is a group, and groups at least where they are parts of records.
const ENOUGH: usize = 10;
const PARTS: usize = 20;
/// A direction in which 95 % reach farther than this factor is not told by the records.
const KNOWN: f64 = 3.0;
/// Part of an eigenvalue of the largest that is rounding.
const ROUNDED: f64 = 1e-12;
/// Part of a parameter's direction that may be unknown.
const SHARE: f64 = 0.05;

/// A fitted parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Which.
    pub parameter: Parameter,
    /// Where it started.
    pub start: f64,
    /// What was found; of one that is not identifiable, where it happens to stand.
    pub value: f64,
    /// 95 %; none where it is not identifiable, or at the bound.
    pub interval: Option<[f64; 2]>,
    /// Whether records that tell it ask for a value farther from its start than a fit may lead.
    pub at_the_bound: bool,
}

/// A combination Π pᵏ of the fitted parameters that the records do not tell.
#[derive(Debug, Clone, PartialEq)]
pub struct Direction {
    /// The exponents, of length 1, in the order of the estimates.
    pub exponents: Vec<f64>,
    /// By what factor it may be larger or smaller, 95 %; infinite where nothing depends on it.
    pub factor: f64,
}

/// What is known about a point.
pub struct Spread {
    pub undetermined: Vec<Direction>,
    pub correlation: Vec<Vec<f64>>,
    pub condition: f64,
    pub offsets: Vec<Offset>,
    /// Half the 95 % interval of each logarithm.
    half: Vec<Option<f64>>,
}

impl Spread {
    pub fn estimates(&self, free: &[Parameter], start: &[f64; 6], found: &[f64; 6]) -> Vec<Estimate> {
        let of = |(&parameter, half): (&Parameter, &Option<f64>)| {
            let (start, value) = (start[parameter as usize], found[parameter as usize]);
            let at_the_bound = half.is_some() && (value / start).ln().abs() > BOX.ln() - 1e-9;
            let within = half.filter(|_| !at_the_bound);
            let interval = within.map(|h| [value * (-h).exp(), value * h.exp()]);
            Estimate { parameter, start, value, interval, at_the_bound }
        };
        free.iter().zip(&self.half).map(of).collect()
    }
}

/// At the end of a fit whose model lacks the share `unmodelled` of the residual.
pub fn spread(objective: &Objective<'_>, point: &Point, jacobian: &DMatrix<f64>, unmodelled: f64) -> Spread {
    let free = jacobian.ncols();
    let residual = objective.residual_before(point);
    let (group, count) = groups(objective);
    let alike = 1.0 + unmodelled * (count - 1) as f64;
    let h = jacobian.tr_mul(jacobian);
    let eigen = h.clone().symmetric_eigen();
    let largest = eigen.eigenvalues.max();
    let (mut known, mut undetermined) = (Vec::new(), Vec::new());
    for (k, &value) in eigen.eigenvalues.iter().enumerate() {
        let factor = (1.96 / value.max(0.0).sqrt()).exp();
        if factor < KNOWN && value > ROUNDED * largest {
            known.push(k);
            continue;
        }
        let column = eigen.eigenvectors.column(k);
        // The largest exponent is positive
        let sign = column[column.iamax()].signum();
        let factor = if value > ROUNDED * largest { factor } else { f64::INFINITY };
        undetermined.push(Direction { exponents: column.iter().map(|c| sign * c).collect(), factor });
    }
    undetermined.sort_by(|a, b| b.factor.total_cmp(&a.factor));
    let covariance = match known.is_empty() {
        true => DMatrix::zeros(free, free),
        false => {
            let known: Vec<_> = known.iter().map(|&k| eigen.eigenvectors.column(k)).collect();
            let basis = DMatrix::from_columns(&known);
            let within = jackknife((&group, count), &(jacobian * &basis), &residual);
            &basis * (alike * within) * basis.transpose()
        }
    };
    let unknown = |k: usize| undetermined.iter().map(|d| d.exponents[k].powi(2)).sum::<f64>() > SHARE;
    let t = student(count - 1);
    let deviation: Vec<f64> = (0..free).map(|k| covariance[(k, k)].max(0.0).sqrt()).collect();
    let correlation = |i: usize, j: usize| match (unknown(i) || unknown(j), deviation[i] * deviation[j]) {
        (false, scale) if scale > 0.0 => covariance[(i, j)] / scale,
        _ => {
            if i == j {
                1.0
            } else {
                0.0
            }
        }
    };
    let least = eigen.eigenvalues.min().max(0.0);
    Spread {
        half: (0..free).map(|k| (!unknown(k)).then(|| t * deviation[k])).collect(),
        correlation: (0..free).map(|i| (0..free).map(|j| correlation(i, j)).collect()).collect(),
        condition: if least > 0.0 { (largest / least).sqrt() } else { f64::INFINITY },
        offsets: objective.offsets(point, jacobian, &(t * t * covariance), unmodelled),
        undetermined,
    }
}

/// The group of every entry of the signals, and how many groups there are.
fn groups(objective: &Objective<'_>) -> (Vec<usize>, usize) {
    grouped([objective.records(), objective.length(), objective.width()])
}

/// The same of signals (records, length, width).
pub fn grouped([records, length, width]: [usize; 3]) -> (Vec<usize>, usize) {
    let parts = if records >= ENOUGH { 1 } else { PARTS.div_ceil(records).min(length) };
    let of = |entry: usize| {
        let (record, n) = (entry / (length * width), entry / width % length);
        record * parts + n * parts / length
    };
    ((0..records * length * width).map(of).collect(), records * parts)
}

/// Covariance in the columns of `jacobian`.
fn jackknife((group, count): (&[usize], usize), jacobian: &DMatrix<f64>, residual: &[f64]) -> DMatrix<f64> {
    let free = jacobian.ncols();
    let mut h = vec![DMatrix::<f64>::zeros(free, free); count];
    let mut g = vec![DVector::<f64>::zeros(free); count];
    for (i, (&at, r)) in group.iter().zip(residual).enumerate() {
        for k in 0..free {
            g[at][k] -= jacobian[(i, k)] * r;
            for l in 0..free {
                h[at][(k, l)] += jacobian[(i, k)] * jacobian[(i, l)];
            }
        }
    }
    let (whole, slope) = (h.iter().sum::<DMatrix<f64>>(), g.iter().sum::<DVector<f64>>());
    // Where nothing is left to tell without a group, the whole stands in.
    let step = |at: usize| {
        let left = (&whole - &h[at]).cholesky().or_else(|| whole.clone().cholesky());
        left.map_or_else(|| DVector::zeros(free), |left| -left.solve(&(&slope - &g[at])))
    };
    let steps: Vec<DVector<f64>> = (0..count).map(step).collect();
    let mean = steps.iter().sum::<DVector<f64>>() / count as f64;
    let spread = |s: &DVector<f64>| (s - &mean) * (s - &mean).transpose();
    steps.iter().map(spread).sum::<DMatrix<f64>>() * ((count - 1) as f64 / count as f64)
}
