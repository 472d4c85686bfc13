//! Prediction error: the share of the squared force that a prediction misses.

/// 100·Σ(f − f̂)²/Σf² of each sample, in percent, summed over panels and instants. `None` if the force is zero.
///
/// Both arrays have the shape (N, T, K), in physical units.
///
/// # Panics
/// If the lengths differ or are not multiples of T·K.
pub fn prediction_error(
    force: &[f64],
    predicted: &[f64],
    panels: usize,
    instants: usize,
) -> Vec<Option<f64>> {
    let (one, lengths) = (panels * instants, [force.len(), predicted.len()]);
    assert!(lengths[0] == lengths[1] && lengths[0].is_multiple_of(one), "{} {}", lengths[0], lengths[1]);
    let errors = force.chunks_exact(one).zip(predicted.chunks_exact(one)).map(|(f, p)| {
        let power: f64 = f.iter().map(|f| f * f).sum();
        let missed: f64 = f.iter().zip(p).map(|(f, p)| (f - p) * (f - p)).sum();
        (power > 0.0).then(|| 100.0 * missed / power)
    });
    errors.collect()
}
