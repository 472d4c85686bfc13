//! The headline figure: how much of the force's square a prediction misses.

/// 100·Σ(f − f̂)²/Σf² of each sample, in percent, over panels and time; `None` where the force is zero throughout.
///
/// Both arrays are (N, T, K), in physical units.
///
/// # Panics
/// If the lengths differ or are no multiple of T·K.
pub fn prediction_error(
    force: &[f64],
    predicted: &[f64],
    panels: usize,
    instants: usize,
) -> Vec<Option<f64>> {
    let one = panels * instants;
    assert!(
        force.len() == predicted.len() && force.len().is_multiple_of(one),
        "{} {}",
        force.len(),
        predicted.len()
    );
    let errors = force.chunks_exact(one).zip(predicted.chunks_exact(one)).map(|(f, p)| {
        let power: f64 = f.iter().map(|f| f * f).sum();
        let missed: f64 = f.iter().zip(p).map(|(f, p)| (f - p) * (f - p)).sum();
        (power > 0.0).then(|| 100.0 * missed / power)
    });
    errors.collect()
}
