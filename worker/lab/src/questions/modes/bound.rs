//! Error of the best linear decoder around a sample's motion, which uses mean and covariance of the forces: the posterior given
//! the signals, to first order and with a Gaussian prior.
//!
//! ```text
//! f = μ + D z, z ~ N(0, 1)      s(f + D δz) = s(f) + J D δz + noise, N(0, R)
//! posterior of z: N(·, Q),  Q = (1 + (J D)ᵀ R⁻¹ J D)⁻¹      Σ E(f̂ − f)² = tr(D Q Dᵀ)
//! ```
//! D contains the principal directions of the stimuli, R white noise and a constant per channel. J D comes from central
//! differences with fixed steps, all in lanes.

use metasense_numerics::definite::inverse;
use metasense_numerics::dynamics::{Forces, IntegrationPlan, Outcome, Scene, run};
use nalgebra::{DMatrix, SymmetricEigen};

/// Prior of the forces.
#[derive(Debug, Clone, PartialEq)]
pub struct ForcePrior {
    /// D: per direction a history of all panels on the clock of the forces (N).
    pub directions: Forces,
    /// Σ over targets of each direction squared (N²): the variance along it.
    pub variance: Vec<f64>,
    /// Variance along all other directions (N²), which count as known.
    pub rest: f64,
}

/// Share of the variance outside D.
const LEFT_OUT: f64 = 1e-6;

impl ForcePrior {
    /// Prior from samples with weights w_i: mean and covariance are Σ w (·)/Σ w. `targets` converts histories to decoder targets
    /// (N, ·).
    ///
    /// # Panics
    /// If the number of weights differs from that of the samples.
    pub fn new(forces: &Forces, weights: &[f64], targets: impl Fn(&Forces) -> Vec<f64>) -> Self {
        let (n, total) = (forces.samples, weights.iter().sum::<f64>());
        assert_eq!(weights.len(), n, "weights");
        let rows = DMatrix::from_row_slice(n, forces.values.len() / n.max(1), &forces.values);
        let mut mean = rows.row(0) * 0.0;
        weights.iter().enumerate().for_each(|(i, w)| mean += rows.row(i) * (w / total));
        let deviation = |i: usize, j: usize| (weights[i] / total).sqrt() * (rows[(i, j)] - mean[j]);
        let factor = DMatrix::from_fn(n, rows.ncols(), deviation);
        let as_forces = |rows: &DMatrix<f64>| Forces {
            samples: rows.nrows(),
            values: rows.transpose().as_slice().to_vec(),
            strikes: Vec::new(),
            ..*forces
        };
        let seen = targets(&as_forces(&factor));
        let seen = DMatrix::from_row_slice(n, seen.len() / n.max(1), &seen);
        let SymmetricEigen { eigenvectors, eigenvalues } = SymmetricEigen::new(&seen * seen.transpose());
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by(|a, b| eigenvalues[*b].total_cmp(&eigenvalues[*a]));
        let all: f64 = eigenvalues.sum();
        let mut rest = all;
        let kept = order.iter().take_while(|j| {
            let needed = rest > LEFT_OUT * all;
            rest -= if needed { eigenvalues[**j] } else { 0.0 };
            needed
        });
        let kept: Vec<usize> = kept.copied().collect();
        let directions = DMatrix::from_fn(kept.len(), n, |k, i| eigenvectors[(i, kept[k])]) * &factor;
        Self {
            directions: as_forces(&directions),
            variance: kept.iter().map(|j| eigenvalues[*j]).collect(),
            rest: rest.max(0.0),
        }
    }
}

/// Noise of each channel: standard deviation of each reading, and of a constant.
#[derive(Debug, Clone, PartialEq)]
pub struct Noise {
    /// White noise, above 0.
    pub white: Vec<f64>,
    /// A constant per sample.
    pub bias: Vec<f64>,
}

impl Noise {
    /// R^(−½) times samples (N, T, channels) of `readings` readings each: the constant part has variance σ² + T b², the rest σ².
    pub fn whitened(&self, mut signals: Vec<f64>, readings: usize) -> Vec<f64> {
        let channels = self.white.len();
        let instants = (readings / channels) as f64;
        for sample in signals.chunks_exact_mut(readings.max(1)) {
            for (c, (white, bias)) in self.white.iter().zip(&self.bias).enumerate() {
                let mean = sample.iter().skip(c).step_by(channels).sum::<f64>() / instants;
                let constant = mean / white.hypot(bias * instants.sqrt());
                let whiten = |x: &mut f64| *x = (*x - mean) / white + constant;
                sample.iter_mut().skip(c).step_by(channels).for_each(whiten);
            }
        }
        signals
    }
}

/// Largest force of a difference along a direction (N); stimuli are some tenths of a newton.
const STEP: f64 = 1e-4;

/// J D of one sample, (r, T · 3M), with the steps of `plan`.
///
/// # Errors
/// The outcome of a failed simulation.
pub fn jacobian_times(
    scene: &Scene,
    design: &[f64],
    forces: &Forces,
    sample: usize,
    prior: &ForcePrior,
    plan: &IntegrationPlan,
    pool: &metasense_numerics::Pool,
) -> Result<Vec<f64>, Outcome> {
    let own = forces.sample(sample);
    let steps: Vec<f64> = (0..prior.directions.samples)
        .map(|k| {
            STEP / prior.directions.sample(k).iter().fold(f64::MIN_POSITIVE, |most, d| most.max(d.abs()))
        })
        .collect();
    let mut both = forces.select(&vec![sample; 2 * steps.len()]);
    for (i, f) in both.values.iter_mut().enumerate() {
        let (k, sign) = (i / (2 * own.len()), [1.0, -1.0][i / own.len() % 2]);
        *f += sign * steps[k] * prior.directions.sample(k)[i % own.len()];
    }
    let found = run(scene, design, &both.refined_for(scene), plan, false, pool);
    match found.outcomes.iter().find(|outcome| **outcome != Outcome::Ok) {
        Some(outcome) => Err(*outcome),
        None => {
            let one = found.signals.len() / both.samples.max(1);
            let pairs = found.signals.chunks_exact(2 * one).zip(&steps);
            Ok(pairs
                .flat_map(|(pair, h)| (0..one).map(move |i| (pair[i] - pair[one + i]) / (2.0 * h)))
                .collect())
        }
    }
}

/// 1 + (J D)ᵀ R⁻¹ J D for the derivatives `along` (r, T · channels) of the signals along the prior's directions.
///
/// # Panics
/// If lengths do not match.
pub fn information(prior: &ForcePrior, along: &[f64], noise: &Noise) -> DMatrix<f64> {
    let r = prior.variance.len();
    let readings = along.len() / r.max(1);
    let white = noise.whitened(along.to_vec(), readings);
    let rows = DMatrix::from_row_slice(r, readings, &white);
    DMatrix::identity(r, r) + &rows * rows.transpose()
}

/// tr(D Q Dᵀ) over targets (N²), Q the inverse of this information; `None` if the information is not finite.
pub fn posterior_variance(prior: &ForcePrior, information: DMatrix<f64>) -> Option<f64> {
    let known = inverse(information, 1.0)?;
    Some(prior.variance.iter().enumerate().map(|(k, variance)| variance * known[(k, k)]).sum())
}
