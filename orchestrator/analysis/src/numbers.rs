//! Means, correlations, quantiles, distinct values.

use std::collections::BTreeSet;

use metasense_schemas::record::NetworkRecord;

/// Arithmetic mean; `None` without values.
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Returns the distinct values in order of appearance. Takes quadratic time.
pub fn in_order<T: PartialEq>(values: impl IntoIterator<Item = T>) -> Vec<T> {
    let mut found = Vec::new();
    for value in values {
        if !found.contains(&value) {
            found.push(value);
        }
    }
    found
}

/// Exponential of the mean logarithm.
pub fn geometric_mean(values: &[f64]) -> f64 {
    (values.iter().map(|v| v.ln()).sum::<f64>() / values.len() as f64).exp()
}

/// Sum of the squared deviations of ln v from its mean.
pub fn log_squares(values: &[f64]) -> f64 {
    let mean = geometric_mean(values).ln();
    values.iter().map(|v| (v.ln() - mean).powi(2)).sum()
}

/// Sample standard deviation; `None` with fewer than two values.
pub fn deviation(values: &[f64]) -> Option<f64> {
    let mean = mean(values)?;
    let squares = values.iter().map(|x| (x - mean).powi(2)).sum::<f64>();
    (values.len() > 1).then(|| (squares / (values.len() - 1) as f64).sqrt())
}

/// Ranks from 1; equal numbers share their mean rank.
pub fn ranks(values: &[f64]) -> Vec<f64> {
    let below = |x: f64| values.iter().filter(|y| **y < x).count() as f64;
    let equal = |x: f64| values.iter().filter(|y| **y == x).count() as f64;
    values.iter().map(|x| below(*x) + 0.5 * (equal(*x) + 1.0)).collect()
}

/// Pearson correlation; `None` if either list is constant.
pub fn correlation(x: &[f64], y: &[f64]) -> Option<f64> {
    let (at_x, at_y) = (mean(x)?, mean(y)?);
    let product = |a: &[f64], at: f64, b: &[f64], bt: f64| -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - at) * (b - bt)).sum()
    };
    let size = (product(x, at_x, x, at_x) * product(y, at_y, y, at_y)).sqrt();
    (size > 0.0).then(|| product(x, at_x, y, at_y) / size)
}

/// Returns a quantile of sorted values, by linear interpolation between order statistics.
///
/// # Panics
/// Without values.
pub fn quantile(sorted: &[f64], q: f64) -> f64 {
    assert!(!sorted.is_empty(), "a quantile needs at least one value");
    let at = q * (sorted.len() - 1) as f64;
    let [low, high] = [at.floor(), at.ceil()].map(|at| sorted[at as usize]);
    // the difference of equal infinities is NaN
    if low == high { low } else { low + at.fract() * (high - low) }
}

/// Returns the median; of an even number of values, the mean of the two middle ones.
///
/// # Panics
/// Without values.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    quantile(&values, 0.5)
}

/// Returns the distinct values, sorted.
pub fn distinct<T: Ord>(values: impl IntoIterator<Item = T>) -> Vec<T> {
    values.into_iter().collect::<BTreeSet<T>>().into_iter().collect()
}

/// The same for floating-point numbers.
pub fn distinct_numbers(values: impl IntoIterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    values
}

/// Returns the mean of an error over the networks that have it.
pub fn network_mean(
    networks: &[NetworkRecord],
    error: impl Fn(&NetworkRecord) -> Option<f64>,
) -> Option<f64> {
    let errors: Vec<f64> = networks.iter().filter_map(error).filter(|e| e.is_finite()).collect();
    mean(&errors)
}

/// Returns the largest number of samples above 100 % of any network; `None` if unknown.
pub fn most_above(networks: &[NetworkRecord]) -> Option<u32> {
    networks.iter().filter_map(|network| Some(network.spread?.above)).max()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_infinite_values_are_infinite() {
        let values = [1.0, f64::INFINITY, f64::INFINITY];
        assert_eq!([0.0, 0.25, 0.75].map(|q| quantile(&values, q)), values);
    }
}
