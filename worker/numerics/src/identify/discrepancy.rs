//! Whether what a fit leaves is noise, or something that the model lacks.
//!
//! ```text
//! r_c(n) ≈ Σ_c′ Σ_k w a_c′(n − k)      k = −AHEAD … BEHIND, r the residual of a channel, a the fitted signals of all
//! ```
//! What a model lacks in a body follows from how the body moves, alike in all records; noise, of whatever memory, does not. So
//! filters w are fitted to some records (ridge regression) and judged on others.

use nalgebra::{DMatrix, DVector};

/// Instants of the fitted signals that a filter sees.
const AHEAD: usize = 4;
const BEHIND: usize = 11;
/// Parts of the records, each of which is left out once.
const FOLDS: usize = 5;
/// Ridge, of the features' squares.
const RIDGE: f64 = 1e-2;

/// Share of the residual's squares, accelerations and rotation rates each in units of theirs, that filters explain on records which they
/// have not seen, at least 0; none of a single record. `fitted` and `residual` are (records, T, channels).
///
/// # Panics
/// If lengths do not fit together.
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
    // a channel that says nothing is no feature and has no residual
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
