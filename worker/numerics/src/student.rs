//! Statistics of few observations: Student's t, and the median.

/// The median; for an even count the greater of the two middle values.
///
/// # Panics
/// If there are no values.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    *sorted.select_nth_unstable_by(values.len() / 2, f64::total_cmp).1
}

/// 97.5 % quantile of Student's t.
pub fn student(freedom: usize) -> f64 {
    student_above(freedom.max(1), 0.025)
}

/// Probability that Student's t exceeds `t`.
///
/// Finite sums for integer degrees of freedom (Abramowitz and Stegun 26.7.3 and 4), θ = atan(t/√ν).
///
/// # Panics
/// If `freedom` is 0.
pub fn chance_above(freedom: usize, t: f64) -> f64 {
    assert!(freedom > 0, "no degree of freedom");
    let odd = freedom % 2 == 1;
    let theta = (t / (freedom as f64).sqrt()).atan();
    let (sine, cosine) = theta.sin_cos();
    let (mut term, mut sum) = if odd { (cosine, 0.0) } else { (1.0, 0.0) };
    for n in (if odd { 1 } else { 0 }..freedom - 1).step_by(2) {
        sum += term;
        term *= cosine * cosine * (n + 1) as f64 / (n + 2) as f64;
    }
    let within = if odd { (theta + sine * sum) / std::f64::consts::FRAC_PI_2 } else { sine * sum };
    0.5 * (1.0 - within)
}

/// The value that Student's t exceeds with probability `chance`, by bisection.
///
/// # Panics
/// If `freedom` is 0, or `chance` is not between 0 and ½.
pub fn student_above(freedom: usize, chance: f64) -> f64 {
    assert!(chance > 0.0 && chance < 0.5, "{chance}");
    let root = (freedom as f64).sqrt();
    let (mut low, mut high) = (0.0, std::f64::consts::FRAC_PI_2);
    for _ in 0..60 {
        let middle: f64 = 0.5 * (low + high);
        if chance_above(freedom, root * middle.tan()) > chance { low = middle } else { high = middle }
    }
    low.tan() * root
}

#[cfg(test)]
mod tests;
