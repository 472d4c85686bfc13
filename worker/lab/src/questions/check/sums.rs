//! Correlations of measured with simulated channels.

use super::search::MatchedSignal;

/// Sums over readings: squares of measured and of simulated channels, and products.
#[derive(Debug, Clone, Default)]
pub(super) struct ProductSums {
    pub measured: Vec<f64>,
    pub simulated: Vec<f64>,
    pub products: Vec<f64>,
}

impl ProductSums {
    pub fn zeros(rows: usize, columns: usize) -> Self {
        let [measured, simulated, products] = [rows, columns, rows * columns].map(|n| vec![0.0; n]);
        Self { measured, simulated, products }
    }

    pub fn add(&mut self, other: &Self) {
        if self.measured.is_empty() {
            self.clone_from(other);
            return;
        }
        let pairs = [
            (&mut self.measured, &other.measured),
            (&mut self.simulated, &other.simulated),
            (&mut self.products, &other.products),
        ];
        for (sum, part) in pairs {
            sum.iter_mut().zip(part).for_each(|(a, b)| *a += b);
        }
    }

    pub fn correlation(&self, c: usize, d: usize) -> f64 {
        let size = (self.measured[c] * self.simulated[d]).sqrt();
        if size > 0.0 { self.products[c * self.simulated.len() + d] / size } else { 0.0 }
    }

    /// Correlation over the channels that are not silent, each scaled by its RMS over all records.
    pub fn agreement(&self, all: &Self, source: &[MatchedSignal], silent: &[bool]) -> f64 {
        let mut sums = [0.0; 3];
        for (c, &(d, sign)) in source.iter().enumerate() {
            let (y, s) = (all.measured[c], all.simulated[d]);
            if silent[c] || y == 0.0 || s == 0.0 {
                continue;
            }
            sums[0] += sign * self.products[c * self.simulated.len() + d] / (y * s).sqrt();
            sums[1] += self.measured[c] / y;
            sums[2] += self.simulated[d] / s;
        }
        if sums[1] * sums[2] > 0.0 { sums[0] / (sums[1] * sums[2]).sqrt() } else { 0.0 }
    }
}
