//! Ridge regression of labels on the signals of records, with leave-one-out errors.
//!
//! ```text
//! K = X Xᵀ, X centred     α = (K + λ)⁻¹ (y − mean y)     ŷ(x) = mean y + (x − mean x) Xᵀ α
//! e = λα / (λ diag (K + λ)⁻¹ − 1/N)                      λ = 10² … 10⁻⁸ times the mean eigenvalue of K, with the least Σ e²
//! ```
//! e are the residuals of records that were left out of the fit (Hastie, Tibshirani and Friedman, The Elements of Statistical
//! Learning, eq. 7.64, with an intercept). A common factor on all signals changes no e.

use nalgebra::{DMatrix, DVector, RowDVector, SymmetricEigen};

/// Exponents of λ = 10² … 10⁻⁸ times the mean eigenvalue.
const RIDGES: std::ops::RangeInclusive<i32> = -2..=8;
/// Eigenvalues below this share of the greatest count as 0; centring leaves one of this size by rounding.
const ROUNDING: f64 = 1e-12;

/// Signals of the records to which outputs are fitted, and the eigenvectors of their inner products.
#[derive(Debug, Clone)]
pub(super) struct Basis {
    x: DMatrix<f64>,
    mean: RowDVector<f64>,
    own: SymmetricEigen<f64, nalgebra::Dyn>,
}

/// A regression on a basis.
#[derive(Debug, Clone)]
pub(super) struct Output {
    /// α.
    weights: DVector<f64>,
    /// Mean of the targets.
    mean: f64,
    /// λ relative to the mean eigenvalue.
    pub(super) share: f64,
    /// e.
    pub(super) residuals: DVector<f64>,
}

impl Output {
    /// Σ e².
    pub(super) fn squares(&self) -> f64 {
        self.residuals.norm_squared()
    }
}

impl Basis {
    /// From the signals (N, p) of N records.
    pub(super) fn new(signals: &[f64], records: usize) -> Self {
        let mut x = DMatrix::from_row_slice(records, signals.len() / records, signals);
        let mean = x.row_mean();
        x.row_iter_mut().for_each(|mut row| row -= &mean);
        let mut own = SymmetricEigen::new(&x * x.transpose());
        let least = ROUNDING * own.eigenvalues.max();
        own.eigenvalues.apply(|value| *value = if *value < least { 0.0 } else { *value });
        Self { x, mean, own }
    }

    /// N.
    pub(super) fn records(&self) -> usize {
        self.x.nrows()
    }

    /// Fits an output to the targets of the records.
    pub(super) fn fit(&self, targets: Vec<f64>) -> Output {
        let SymmetricEigen { eigenvectors: q, .. } = &self.own;
        let (y, n) = (DVector::from_vec(targets), self.x.nrows());
        let mean = y.mean();
        let turned = q.tr_mul(&y.add_scalar(-mean));
        let solved = RIDGES.map(|decade| {
            let share = 10f64.powi(-decade);
            let (ridge, inverse) = self.inverse(share);
            let weights = q * inverse.component_mul(&turned);
            let residual = |i: usize| {
                let own: f64 = (0..n).map(|j| q[(i, j)].powi(2) * inverse[j]).sum();
                ridge * weights[i] / (ridge * own - 1.0 / n as f64)
            };
            let residuals = DVector::from_fn(n, |i, _| residual(i));
            Output { weights, mean, share, residuals }
        });
        solved.min_by(|a, b| a.squares().total_cmp(&b.squares())).expect("there is a λ")
    }

    /// λ, and the eigenvalues of (K + λ)⁻¹.
    fn inverse(&self, share: f64) -> (f64, DVector<f64>) {
        let values = &self.own.eigenvalues;
        let ridge = values.mean().max(f64::MIN_POSITIVE) * share;
        (ridge, values.map(|value| 1.0 / (value + ridge)))
    }

    /// Estimates of outputs (n × outputs) from the signals (n, p) of any records.
    pub(super) fn predict(&self, outputs: &[Output], signals: &[f64]) -> DMatrix<f64> {
        let len = self.x.ncols();
        let mut x = DMatrix::from_row_slice(signals.len() / len, len, signals);
        x.row_iter_mut().for_each(|mut row| row -= &self.mean);
        let products = x * self.x.transpose();
        let columns: Vec<DVector<f64>> =
            outputs.iter().map(|output| (&products * &output.weights).add_scalar(output.mean)).collect();
        DMatrix::from_columns(&columns)
    }

    /// Weights (p) and constant of an output: ŷ = constant + Σ weight · signal.
    pub(super) fn weights(&self, output: &Output) -> (Vec<f64>, f64) {
        let weights = self.x.tr_mul(&output.weights);
        let constant = output.mean - self.mean.transpose().dot(&weights);
        (weights.as_slice().to_vec(), constant)
    }

    /// Cotangent of Σ factor Σ e² on the signals (N, p). λ moves with the mean eigenvalue.
    ///
    /// With A = (K + λ)⁻¹, d = λ diag A − 1/N and v = 2λe/d: dΣe² = ⟨v (y − mean y)ᵀ − diag(v e), dA⟩ at fixed λ, dA = −A dK A.
    pub(super) fn squares_vjp<'a>(&self, outputs: impl Iterator<Item = (f64, &'a Output)>) -> Vec<f64> {
        let (q, n) = (&self.own.eigenvectors, self.x.nrows());
        let mut products = DMatrix::zeros(n, n);
        for (factor, Output { weights, share, residuals: e, .. }) in outputs {
            let (ridge, inverse) = self.inverse(*share);
            let a = q * DMatrix::from_diagonal(&inverse) * q.transpose();
            let d = a.diagonal().map(|own| ridge * own - 1.0 / n as f64);
            let v = (2.0 * ridge * e).component_div(&d);
            let mut own = &a * DMatrix::from_diagonal(&v.component_mul(e)) * &a;
            own -= (&a * &v) * weights.transpose();
            // λ/N per eigenvalue: de/dλ = (α − λAα − e diag(A − λA²))/d
            let square = DVector::from_fn(n, |i, _| a.row(i).norm_squared());
            let leverage = (a.diagonal() - ridge * square).component_mul(e);
            let by_ridge = weights - ridge * (&a * weights) - leverage;
            let slope = v.dot(&by_ridge) / ridge * share / n as f64;
            (0..n).for_each(|i| own[(i, i)] += slope);
            products += factor * own;
        }
        let mut x = (&products + products.transpose()) * &self.x;
        let mean = x.row_mean();
        x.row_iter_mut().for_each(|mut row| row -= &mean);
        x.transpose().as_slice().to_vec()
    }
}
