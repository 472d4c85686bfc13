//! Share of a fit's residual that is model error, not noise.
//!
//! ```text
//! r_c(n) ≈ Σ_c′ Σ_k w a_c′(n − k)      k = −AHEAD … BEHIND, r the residual of a channel, a the fitted signals of all
//! ```
//! Model errors of a body depend on its motion in the same way in all records; noise does not, even if correlated in time. Filters w are
//! therefore fitted to some records (ridge regression) and tested on others.

use nalgebra::{DMatrix, DVector};

/// Instants of the fitted signals that a filter uses.
const AHEAD: usize = 4;
const BEHIND: usize = 11;
/// Folds of the cross-validation.
const FOLDS: usize = 5;
/// Ridge per row, for features of unit RMS.
const RIDGE: f64 = 1e-2;

/// Share of the squared residual (each channel in units of its RMS) that filters explain on left-out records, at least 0. `None` for a
/// single record. `fitted` and `residual` are (records, T, channels).
///
/// # Panics
/// If lengths do not match.
pub fn explained(fitted: &[f64], residual: &[f64], records: usize, channels: usize) -> Option<f64> {
    assert_eq!(fitted.len(), residual.len(), "signals and residual");
    if records < 2 || fitted.is_empty() {
        return None;
    }
    let instants = fitted.len() / (records * channels);
    let rms = |of: &[f64], channel: usize| {
        let squares: f64 = of.iter().skip(channel).step_by(channels).map(|x| x * x).sum();
        (squares / (records * instants) as f64).sqrt()
    };
    // A channel of zeros has scale 0.
    let scale = |of: &[f64]| -> Vec<f64> {
        (0..channels).map(|c| rms(of, c)).map(|rms| if rms > 0.0 { 1.0 / rms } else { 0.0 }).collect()
    };
    let (of_fitted, of_residual) = (scale(fitted), scale(residual));
    let taps = AHEAD + BEHIND + 1;
    let rows = |own: &[usize]| {
        let place = |row: usize| (own[row / instants], row % instants);
        let seen = DMatrix::from_fn(own.len() * instants, channels * taps, |row, column| {
            let ((record, n), (c, k)) = (place(row), (column / taps, column % taps));
            let at = (n + AHEAD).checked_sub(k).filter(|at| *at < instants);
            at.map_or(0.0, |at| of_fitted[c] * fitted[(record * instants + at) * channels + c])
        });
        let left = DMatrix::from_fn(own.len() * instants, channels, |row, c| {
            let (record, n) = place(row);
            of_residual[c] * residual[(record * instants + n) * channels + c]
        });
        (seen, left)
    };
    let (mut unexplained, mut all) = (0.0, 0.0);
    let folds = FOLDS.min(records);
    for fold in 0..folds {
        let (out, kept): (Vec<usize>, Vec<usize>) = (0..records).partition(|record| record % folds == fold);
        let ((seen, left), (unseen, judged)) = (rows(&kept), rows(&out));
        let mut square = seen.tr_mul(&seen);
        let ridge = DVector::from_element(square.nrows(), RIDGE * seen.nrows() as f64);
        square += DMatrix::from_diagonal(&ridge);
        let filters = square.cholesky().expect("a ridge").solve(&seen.tr_mul(&left));
        unexplained += (&judged - unseen * filters).norm_squared();
        all += judged.norm_squared();
    }
    (all > 0.0).then(|| (1.0 - unexplained / all).max(0.0))
}
