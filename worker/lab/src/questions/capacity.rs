//! Memory and nonlinearity of a driven body: capacities of linear readouts of its state, and their errors on NARMA sequences.
//!
//! ```text
//! C(y) = 1 − min Σ(y − w·x)²/Σ(y − ȳ)²      y(t) = Π P_d(u(t − k)), P_d: Legendre polynomials      degree of y: Σ d
//! ```
//! x: 1 and the N states. The sum over degree 1 is the linear memory capacity (Jaeger 2001, GMD Report 152); that over all y is at
//! most N (Dambre et al. 2012, doi:10.1038/srep00514). C below twice the 1 − 10⁻⁴ quantile of χ²(N)/T, T holds, counts as 0 (twice:
//! products have long tails). The others become 1 − (1 − C)(T − 1)/(T − N − 1), free of bias.

use nalgebra::DMatrix;
use std::ops::Range;

const NAMES: [&str; 7] = ["memory", "degree 2", "degree 3", "total", "narma-2", "narma-5", "narma-10"];
/// Number of delays of a factor, from 0, in products of degree 1, 2, 3.
const DELAYS: [usize; 3] = [50, 20, 10];
/// Holds at the beginning of a drive that are not evaluated.
pub const WASHOUT: usize = 50;
/// Ridge per hold: the square of the default error of integrators, relative to a state's deviation.
const RIDGE: f64 = 1e-6;
/// Quantile of the standard normal distribution at 1 − 10⁻⁴.
const Z: f64 = 3.719_016;

/// A measure of memory or nonlinearity.
#[derive(Debug, Clone, PartialEq)]
pub struct Measure {
    /// `memory` (degree 1), `degree 2`, `degree 3`, `total`, `narma-2`, `narma-5`, `narma-10`.
    pub name: &'static str,
    /// Capacity, or mean square error divided by the variance.
    pub value: f64,
    /// Upper bound N of a capacity; `None` for errors.
    pub bound: Option<f64>,
}

/// Measures of states (drives, `holds`, N) after each hold's input u (drives, `holds`), uniform in [−1, 1]: capacities over all
/// drives, and errors on the second half of the drives of readouts fitted to the first half.
pub fn measures(inputs: &[f64], states: &[f64], holds: usize) -> Vec<Measure> {
    let products = (1..).zip(DELAYS).flat_map(|(degree, delays)| multisets(degree, delays));
    let products: Vec<Vec<usize>> = products.collect();
    let x = standardised(states, states.len() / inputs.len(), holds);
    let sequences =
        [2, 5, 10].map(|order| inputs.chunks_exact(holds).flat_map(|own| narma(order, own)).collect());
    let sequences: [Vec<f64>; 3] = sequences;
    let y = DMatrix::from_fn(x.nrows(), products.len() + 3, |row, k| {
        let t = row / (holds - WASHOUT) * holds + WASHOUT + row % (holds - WASHOUT);
        products.get(k).map_or_else(|| sequences[k - products.len()][t], |own| polynomial(own, &inputs[..=t]))
    });
    let (t, n) = (x.nrows(), x.ncols() - 1);
    let [all, left] = [t, t - n - 1].map(|count| count as f64);
    let (mut capacities, threshold) = ([0.0; 4], threshold(n as f64, all));
    for (product, error) in products.iter().zip(errors(&x, &y, 0..t, 0..t)) {
        let own = if 1.0 - error < threshold { 0.0 } else { 1.0 - error * (all - 1.0) / left };
        [product.len() - 1, 3].into_iter().for_each(|sum| capacities[sum] += own);
    }
    let half = inputs.len() / holds / 2 * (holds - WASHOUT);
    let narma = errors(&x, &y, 0..half, half..t).split_off(products.len());
    let measure = |(i, value)| Measure { name: NAMES[i], value, bound: (i < 4).then_some(n as f64) };
    capacities.into_iter().chain(narma).enumerate().map(measure).collect()
}

/// 1 and the states of zero mean and unit variance, after the wash-out of each drive (T, N + 1).
fn standardised(states: &[f64], variables: usize, holds: usize) -> DMatrix<f64> {
    let drives = states.chunks_exact(holds * variables);
    let kept: Vec<f64> = drives.flat_map(|own| &own[WASHOUT * variables..]).copied().collect();
    let mut x = DMatrix::from_row_slice(kept.len() / variables, variables, &kept);
    for mut column in x.column_iter_mut() {
        column.add_scalar_mut(-column.mean());
        let deviation = column.norm() / (column.len() as f64).sqrt();
        column.unscale_mut(if deviation > 0.0 { deviation } else { 1.0 });
    }
    x.insert_column(0, 1.0)
}

/// Mean square errors, divided by the targets' variances, in the rows `judge`, of readouts fitted to the rows `fit`.
fn errors(x: &DMatrix<f64>, y: &DMatrix<f64>, fit: Range<usize>, judge: Range<usize>) -> Vec<f64> {
    let own = x.rows_range(fit.clone());
    let mut gram = own.tr_mul(&own);
    (1..gram.nrows()).for_each(|i| gram[(i, i)] += RIDGE * fit.len() as f64);
    let weights = gram.cholesky().expect("the ridge is positive").solve(&own.tr_mul(&y.rows_range(fit)));
    let known = y.rows_range(judge.clone());
    let error = known - x.rows_range(judge) * weights;
    let of = |k: usize| error.column(k).norm_squared() / (known.nrows() as f64 * known.column(k).variance());
    (0..y.ncols()).map(of).collect()
}

/// C below which a target counts as unrelated to the states. Quantile of χ²: Wilson and Hilferty (1931).
fn threshold(variables: f64, holds: f64) -> f64 {
    let spread = 2.0 / (9.0 * variables);
    2.0 * variables * (1.0 - spread + Z * spread.sqrt()).powi(3) / holds
}

/// All ascending lists of `size` numbers below `end`, with repetition.
fn multisets(size: usize, end: usize) -> Vec<Vec<usize>> {
    if size == 0 {
        return vec![Vec::new()];
    }
    let up_to =
        |last: usize| multisets(size - 1, last + 1).into_iter().map(move |rest| [rest, vec![last]].concat());
    (0..end).flat_map(up_to).collect()
}

/// Product of the Legendre polynomials of the newest inputs but `delays`, which ascend; a delay that occurs d times has degree d ≤ 3.
fn polynomial(delays: &[usize], inputs: &[f64]) -> f64 {
    let factor = |same: &[usize]| {
        let u = inputs[inputs.len() - 1 - same[0]];
        match same.len() {
            1 => u,
            2 => 0.5 * (3.0 * u * u - 1.0),
            _ => 0.5 * u * (5.0 * u * u - 3.0),
        }
    };
    delays.chunk_by(|a, b| a == b).map(factor).product()
}

/// The NARMA sequence y(t + 1) of an order for inputs in [−1, 1], which are mapped to v in [0, ½]; zero before.
///
/// ```text
/// order 2: y(t+1) = 0.4 y(t) + 0.4 y(t) y(t−1) + 0.6 v(t)³ + 0.1
/// order n: y(t+1) = 0.3 y(t) + 0.05 y(t) Σ_{i<n} y(t−i) + 1.5 v(t−n+1) v(t) + 0.1
/// ```
/// Atiya and Parlos 2000, doi:10.1109/72.846741. y is limited to 1: order 10 otherwise diverges in one of 500 drives of 500 holds.
fn narma(order: usize, inputs: &[f64]) -> Vec<f64> {
    let mut y = vec![0.0; order];
    let v = |t: usize| 0.25 * (inputs[t] + 1.0);
    for t in 0..inputs.len() {
        let past = &y[t..];
        let (now, first) = (past[order - 1], (t + 1).checked_sub(order).map_or(0.0, v));
        let next = match order {
            2 => 0.4 * now + 0.4 * now * past[0] + 0.6 * v(t).powi(3) + 0.1,
            _ => 0.3 * now + 0.05 * now * past.iter().sum::<f64>() + 1.5 * first * v(t) + 0.1,
        };
        y.push(next.min(1.0));
    }
    y.split_off(order)
}

#[cfg(test)]
mod tests;
