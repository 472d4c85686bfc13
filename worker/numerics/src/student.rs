//! Student's t, by which few observations have honest intervals.

/// 97.5 % quantile of Student's t.
#[must_use]
pub fn student(freedom: usize) -> f64 {
    const TABLE: [f64; 10] = [12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228];
    if freedom <= TABLE.len() {
        return TABLE[freedom.max(1) - 1];
    }
    // Cornish–Fisher in 1/freedom to third order (Abramowitz and Stegun 26.7.5): off by less than 1e-3 here.
    let (z, n) = (1.959_964f64, freedom as f64);
    z + (z.powi(3) + z) / (4.0 * n)
        + (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / (96.0 * n * n)
        + (3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z) / (384.0 * n.powi(3))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of a printed table.
    #[test]
    fn student_s_quantiles() {
        for (freedom, quantile) in [(1, 12.706), (10, 2.228), (11, 2.201), (30, 2.042), (120, 1.980)] {
            assert!((student(freedom) - quantile).abs() < 2e-3, "{freedom}: {}", student(freedom));
        }
    }

    /// Values of the tables.
    #[test]
    fn quantiles_are_those_of_the_tables() {
        for (degrees, value) in [(9, 2.2622), (19, 2.0930), (100, 1.9840)] {
            let ours = student(degrees);
            assert!((ours - value).abs() < 1e-3, "{degrees}: {ours} against {value}");
        }
    }
}
