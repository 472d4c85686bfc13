//! CMA-ES, asked for candidates and told how good they were: Hansen's tutorial (arXiv:1604.00772) with its defaults.
//!
//! ```text
//! x = m + σ y,  y ~ N(0, C)        m ← m + σ Σ wᵢ yᵢ  over the best half of λ = 4 + ⌊3 ln n⌋
//! ```
//! Draws are addressed by seed and candidate, so that what was told is all there is to keep: told again, it ends at the same
//! bits.

use crate::random::{Purpose, Stream};
use nalgebra::{DMatrix, DVector, SymmetricEigen};

/// The search distribution, and the candidates told since it was last moved.
#[derive(Debug, Clone)]
pub(super) struct Evolution {
    seed: u64,
    /// Candidates told so far.
    told: u64,
    /// m, from the start of the search.
    mean: DVector<f64>,
    sigma: f64,
    c: DMatrix<f64>,
    /// C^½ and C^−½, of the last C that was taken apart.
    root: DMatrix<f64>,
    inverse_root: DMatrix<f64>,
    /// The generation in which that was.
    taken_apart: u64,
    path_sigma: DVector<f64>,
    path_c: DVector<f64>,
    /// y and fitness.
    present: Vec<(DVector<f64>, f64)>,
    rates: Rates,
}

/// Weights and rates, by n alone.
#[derive(Debug, Clone)]
struct Rates {
    lambda: usize,
    weights: Vec<f64>,
    mu_eff: f64,
    c_sigma: f64,
    d_sigma: f64,
    c_c: f64,
    c_1: f64,
    c_mu: f64,
    /// E‖N(0, I)‖.
    chi: f64,
}

impl Rates {
    fn new(parameters: usize) -> Self {
        let n = parameters as f64;
        let lambda = 4 + (3.0 * n.ln()) as usize;
        let raw: Vec<f64> =
            (1..=lambda / 2).map(|i| (0.5 * (lambda as f64 + 1.0)).ln() - (i as f64).ln()).collect();
        let sum: f64 = raw.iter().sum();
        let weights: Vec<f64> = raw.iter().map(|w| w / sum).collect();
        let mu_eff = weights.iter().map(|w| w * w).sum::<f64>().recip();
        let c_sigma = (mu_eff + 2.0) / (n + mu_eff + 5.0);
        let c_1 = 2.0 / ((n + 1.3).powi(2) + mu_eff);
        Self {
            lambda,
            weights,
            mu_eff,
            c_sigma,
            d_sigma: 1.0 + 2.0 * (((mu_eff - 1.0) / (n + 1.0)).sqrt() - 1.0).max(0.0) + c_sigma,
            c_c: (4.0 + mu_eff / n) / (n + 4.0 + 2.0 * mu_eff / n),
            c_1,
            c_mu: (2.0 * (mu_eff - 2.0 + mu_eff.recip()) / ((n + 2.0).powi(2) + mu_eff)).min(1.0 - c_1),
            chi: n.sqrt() * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n)),
        }
    }
}

impl Evolution {
    /// A search for `parameters` numbers from 0 on, with standard deviation `sigma`.
    pub(super) fn new(parameters: usize, sigma: f64, seed: u64) -> Self {
        let (zero, one) = (DVector::zeros(parameters), DMatrix::identity(parameters, parameters));
        Self {
            seed,
            told: 0,
            mean: zero.clone(),
            sigma,
            c: one.clone(),
            root: one.clone(),
            inverse_root: one,
            taken_apart: 0,
            path_sigma: zero.clone(),
            path_c: zero,
            present: Vec::new(),
            rates: Rates::new(parameters),
        }
    }

    /// Candidates told so far.
    pub(super) fn told(&self) -> u64 {
        self.told
    }

    fn y(&self) -> DVector<f64> {
        let mut stream = Stream::new(Purpose::Search, self.seed, [self.told, 0]);
        &self.root * DVector::from_fn(self.mean.len(), |_, _| stream.normal())
    }

    /// The next candidate.
    pub(super) fn ask(&self) -> Vec<f64> {
        (&self.mean + self.sigma * self.y()).as_slice().to_vec()
    }

    /// How bad it was: less is better, infinite where it came to nothing.
    pub(super) fn tell(&mut self, fitness: f64) {
        self.present.push((self.y(), fitness));
        self.told += 1;
        if self.present.len() == self.rates.lambda {
            self.advance();
        }
    }

    fn advance(&mut self) {
        let rates = self.rates.clone();
        let mut present = std::mem::take(&mut self.present);
        present.sort_by(|a, b| a.1.total_cmp(&b.1));
        let best = || present.iter().map(|(y, _)| y).zip(&rates.weights);
        let (n, generation) = (self.mean.len() as f64, self.told / rates.lambda as u64);
        let step = best().fold(DVector::zeros(self.mean.len()), |sum: DVector<f64>, (y, w)| sum + *w * y);
        self.mean += self.sigma * &step;

        let keep = 1.0 - rates.c_sigma;
        self.path_sigma = keep * &self.path_sigma
            + (rates.c_sigma * (2.0 - rates.c_sigma) * rates.mu_eff).sqrt() * (&self.inverse_root * &step);
        let length = self.path_sigma.norm();
        let expected = (1.0 - keep.powi(2 * generation as i32)).sqrt() * rates.chi;
        let stalled = length / expected >= 1.4 + 2.0 / (n + 1.0);
        let grown = if stalled { 0.0 } else { (rates.c_c * (2.0 - rates.c_c) * rates.mu_eff).sqrt() };
        self.path_c = (1.0 - rates.c_c) * &self.path_c + grown * &step;
        // what a stalled path does not bring in is left in C
        let left = if stalled { rates.c_c * (2.0 - rates.c_c) } else { 0.0 };
        self.c *= 1.0 + rates.c_1 * left - rates.c_1 - rates.c_mu;
        self.c.ger(rates.c_1, &self.path_c, &self.path_c, 1.0);
        best().for_each(|(y, w)| self.c.ger(rates.c_mu * w, y, y, 1.0));
        self.sigma *= ((rates.c_sigma / rates.d_sigma) * (length / rates.chi - 1.0)).exp();

        // as often as it costs no more than the draws
        if (generation - self.taken_apart) as f64 * (rates.c_1 + rates.c_mu) * n * 10.0 >= 1.0 {
            self.taken_apart = generation;
            let SymmetricEigen { eigenvectors, eigenvalues } = self.c.clone().symmetric_eigen();
            let of = |f: &dyn Fn(f64) -> f64| {
                let scaled = DMatrix::from_diagonal(&eigenvalues.map(|v| f(v.max(1e-20).sqrt())));
                &eigenvectors * scaled * eigenvectors.transpose()
            };
            (self.root, self.inverse_root) = (of(&|s| s), of(&f64::recip));
        }
    }
}

#[cfg(test)]
mod tests;
