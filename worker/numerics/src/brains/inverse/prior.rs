//! What is known of forces before any signal: a normal process, the same on every panel.
//!
//! ```text
//! f_k = μ + D z_k, z_k ~ N(0, 1)      μ, D Dᵀ: mean and covariance over time of histories, all panels in one
//! ```
//! D holds the principal directions in which all but a small part of the variance lies.

use crate::dynamics::Forces;
use faer::linalg::solvers::Solve;
use faer::{ColRef, Mat, Scale, Side};

/// A normal process.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Prior {
    /// K.
    panels: usize,
    /// μ on the forces' clock (R + 1) (N).
    mean: Vec<f64>,
    /// D (R + 1, r) (N).
    modes: Mat<f64>,
}

/// The part of the variance that directions may leave out.
const LEFT_OUT: f64 = 1e-7;
/// Step of a difference (N), beside forces of some tenths.
const STEP: f64 = 1e-4;

impl Prior {
    /// Of histories like these; `None` if they are all alike.
    pub(super) fn new(forces: &Forces) -> Option<Self> {
        let clock = forces.instants + 1;
        let count = forces.values.len() / clock;
        let mut mean = vec![0.0; clock];
        for history in forces.values.chunks_exact(clock) {
            mean.iter_mut().zip(history).for_each(|(mean, f)| *mean += f / count as f64);
        }
        let off = |i: usize, j: usize| (forces.values[i * clock + j] - mean[j]) / (count as f64).sqrt();
        let rows = Mat::from_fn(count, clock, off);
        // of few and long histories by their products with one another
        let few = count < clock;
        let square = if few { &rows * rows.transpose() } else { rows.transpose() * &rows };
        let found = square.self_adjoint_eigen(Side::Lower).ok()?;
        let variance = |j: usize| found.S()[j].max(0.0);
        let all: f64 = (0..square.nrows()).map(variance).sum();
        let mut rest = all;
        // ascending: the last are the largest
        let kept: Vec<usize> = (0..square.nrows())
            .rev()
            .take_while(|&j| {
                let needed = rest > LEFT_OUT * all;
                rest -= variance(j);
                needed
            })
            .collect();
        let vectors = found.U();
        let modes = Mat::from_fn(clock, kept.len(), |n, k| match few {
            true => (0..count).map(|i| rows[(i, n)] * vectors[(i, kept[k])]).sum(),
            false => vectors[(n, kept[k])] * variance(kept[k]).sqrt(),
        });
        (!kept.is_empty()).then_some(Self { panels: forces.panels, mean, modes })
    }

    /// Length of z: K r.
    pub(super) fn unknowns(&self) -> usize {
        self.panels * self.modes.ncols()
    }

    /// Histories (N, K, R + 1) of many z; what follows in each is not the forces'.
    pub(super) fn forces<'z>(&self, many: impl Iterator<Item = &'z [f64]>) -> Forces {
        let r = self.modes.ncols();
        let mut values = Vec::new();
        for z in many.flat_map(|z| z[..self.unknowns()].chunks_exact(r)) {
            let begin = values.len();
            values.extend_from_slice(&self.mean);
            for (k, z) in z.iter().enumerate() {
                let mode = self.modes.col(k);
                values[begin..].iter_mut().zip(mode.iter()).for_each(|(f, d)| *f += z * d);
            }
        }
        self.histories(values)
    }

    /// The histories of z, those a step farther along each unknown, and the steps: of z, all as large in N.
    pub(super) fn around(&self, z: &[f64]) -> (Forces, Vec<f64>) {
        let (clock, r) = (self.mean.len(), self.modes.ncols());
        let largest = |k: usize| self.modes.col(k).iter().fold(0.0_f64, |most, d| most.max(d.abs()));
        let steps: Vec<f64> = (0..self.unknowns()).map(|k| STEP / largest(k % r)).collect();
        let base = self.forces([z].into_iter()).values;
        let mut values = base.repeat(1 + self.unknowns());
        for (k, history) in values.chunks_exact_mut(base.len()).skip(1).enumerate() {
            let panel = &mut history[k / r * clock..][..clock];
            panel.iter_mut().zip(self.modes.col(k % r).iter()).for_each(|(f, d)| *f += steps[k] * d);
        }
        (self.histories(values), steps)
    }

    fn histories(&self, values: Vec<f64>) -> Forces {
        let instants = self.mean.len() - 1;
        let samples = values.len() / (self.panels * (instants + 1));
        Forces { samples, panels: self.panels, instants, values, strikes: Vec::new() }
    }

    /// Transpose of [`Prior::forces`]: a cotangent on the first part of histories (K, ·), on a clock `finer` times theirs, as one
    /// on z.
    pub(super) fn along(&self, cotangent: &[f64], finer: usize) -> Vec<f64> {
        let mut along = Vec::with_capacity(self.unknowns());
        for bar in cotangent.chunks_exact(cotangent.len() / self.panels) {
            let mut own = vec![0.0; self.mean.len() + 1];
            for (n, bar) in bar.iter().enumerate() {
                // between two instants a history is their line
                let (at, part) = (n / finer, (n % finer) as f64 / finer as f64);
                own[at] += (1.0 - part) * bar;
                own[at + 1] += part * bar;
            }
            let along_mode = |mode: ColRef<f64>| mode.iter().zip(&own).map(|(d, f)| d * f).sum::<f64>();
            along.extend(self.modes.col_iter().map(along_mode));
        }
        along
    }

    /// D, its directions (r, 1, R + 1) (N).
    pub(super) fn directions(&self) -> Forces {
        let values =
            self.modes.col_iter().flat_map(|mode| mode.iter().copied().collect::<Vec<_>>()).collect();
        let (samples, instants) = (self.modes.ncols(), self.mean.len() - 1);
        Forces { samples, panels: 1, instants, values, strikes: Vec::new() }
    }

    /// z of estimates (T, K) (N) of the forces at every (R/T)-th instant, off by white noise of deviation `error` (N).
    pub(super) fn near(&self, estimates: &[f64], error: f64) -> Vec<f64> {
        let (panels, instants) = (self.panels, estimates.len() / self.panels);
        let (every, r) = ((self.mean.len() - 1) / instants, self.modes.ncols());
        let seen = Mat::from_fn(instants, r, |n, k| self.modes[((n + 1) * every, k)]);
        let known = seen.transpose() * &seen + Mat::<f64>::identity(r, r) * Scale(error * error);
        let off =
            Mat::from_fn(instants, panels, |n, k| estimates[n * panels + k] - self.mean[(n + 1) * every]);
        let z = known.llt(Side::Lower).expect("positive definite").solve(seen.transpose() * off);
        z.col_iter().flat_map(|z| z.iter().copied().collect::<Vec<_>>()).collect()
    }
}
