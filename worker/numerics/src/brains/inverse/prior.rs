//! Prior of the forces: the sets of panels that can be struck together, and one normal process for all panels.
//!
//! ```text
//! f_k = μ + D z_k, z_k ~ N(0, 1)      μ, D Dᵀ: mean and covariance over time of histories, pooled over struck panels
//! ```
//! D contains the principal directions of all but a small share of the variance.

use crate::definite::solve_with_floor;
use crate::dynamics::Forces;
use faer::{ColRef, Mat, Scale, Side};
use std::collections::BTreeMap;

/// A normal process on some panels.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Prior {
    /// Number of panels K.
    panels: usize,
    /// The struck panels.
    pub(super) struck: Vec<usize>,
    /// μ on the clock of the forces (R + 1) (N).
    mean: Vec<f64>,
    /// D (R + 1, r) (N).
    modes: Mat<f64>,
}

/// Largest number of sets; more are merged into one set of all panels.
const MOST_SETS: usize = 16;
/// Share of the variance outside D.
const LEFT_OUT: f64 = 1e-7;
/// Step of differences (N); forces are some tenths of a newton.
const STEP: f64 = 1e-4;

impl Prior {
    /// One prior per set of panels that these histories strike together, with the logarithm of its share; empty if all histories
    /// are equal. Sets of equal size share μ and D.
    pub(super) fn of(forces: &Forces) -> Vec<(Self, f64)> {
        let (clock, samples) =
            (forces.instants + 1, forces.values.chunks_exact(forces.panels * (forces.instants + 1)));
        let set = |sample: &[f64]| -> Vec<usize> {
            let of = sample.chunks_exact(clock).enumerate();
            of.filter(|(_, history)| history.iter().any(|f| *f != 0.0)).map(|(panel, _)| panel).collect()
        };
        let sets: Vec<Vec<usize>> = samples.clone().map(set).collect();
        let mut counts: BTreeMap<&[usize], usize> = BTreeMap::new();
        sets.iter().filter(|set| !set.is_empty()).for_each(|set| *counts.entry(set).or_default() += 1);
        if counts.len() > MOST_SETS {
            return Self::new(forces).map(|prior| (prior, 0.0)).into_iter().collect();
        }
        let of = |(&struck, &count): (&&[usize], &usize)| {
            let alike = samples.clone().zip(&sets).filter(|(_, set)| set.len() == struck.len());
            let values =
                alike.flat_map(|(sample, set)| set.iter().flat_map(|p| &sample[p * clock..][..clock]));
            let values: Vec<f64> = values.copied().collect();
            let samples = values.len() / clock;
            let histories =
                Forces { samples, panels: 1, instants: forces.instants, values, strikes: Vec::new() };
            let prior = Self::new(&histories)?;
            Some((
                Self { panels: forces.panels, struck: struck.to_vec(), ..prior },
                (count as f64 / sets.len() as f64).ln(),
            ))
        };
        counts.iter().filter_map(of).collect()
    }

    /// Prior in which all panels are struck; `None` if all histories are equal.
    pub(super) fn new(forces: &Forces) -> Option<Self> {
        let clock = forces.instants + 1;
        let count = forces.values.len() / clock;
        let mut mean = vec![0.0; clock];
        for history in forces.values.chunks_exact(clock) {
            mean.iter_mut().zip(history).for_each(|(mean, f)| *mean += f / count as f64);
        }
        let off = |i: usize, j: usize| (forces.values[i * clock + j] - mean[j]) / (count as f64).sqrt();
        let rows = Mat::from_fn(count, clock, off);
        // For few long histories, the Gram matrix is smaller.
        let use_gram = count < clock;
        let square = if use_gram { &rows * rows.transpose() } else { rows.transpose() * &rows };
        let found = square.self_adjoint_eigen(Side::Lower).ok()?;
        let variance = |j: usize| found.S()[j].max(0.0);
        let all: f64 = (0..square.nrows()).map(variance).sum();
        let mut rest = all;
        // Eigenvalues ascend: the last are the largest.
        let kept: Vec<usize> = (0..square.nrows())
            .rev()
            .take_while(|&j| {
                let needed = rest > LEFT_OUT * all;
                rest -= variance(j);
                needed
            })
            .collect();
        let vectors = found.U();
        let modes = Mat::from_fn(clock, kept.len(), |n, k| match use_gram {
            true => (0..count).map(|i| rows[(i, n)] * vectors[(i, kept[k])]).sum(),
            false => vectors[(n, kept[k])] * variance(kept[k]).sqrt(),
        });
        let struck = (0..forces.panels).collect();
        (!kept.is_empty()).then_some(Self { panels: forces.panels, struck, mean, modes })
    }

    /// Length of z: r per struck panel.
    pub(super) fn unknowns(&self) -> usize {
        self.struck.len() * self.modes.ncols()
    }

    /// Histories (N, K, R + 1) of several z; ignores entries after those of the forces.
    pub(super) fn forces<'z>(&self, unknown_vectors: impl Iterator<Item = &'z [f64]>) -> Forces {
        let (clock, r) = (self.mean.len(), self.modes.ncols());
        let mut values = Vec::new();
        for z in unknown_vectors {
            let begin = values.len();
            values.resize(begin + self.panels * clock, 0.0);
            for (panel, z) in self.struck.iter().zip(z.chunks_exact(r)) {
                let history = &mut values[begin + panel * clock..][..clock];
                history.copy_from_slice(&self.mean);
                for (k, z) in z.iter().enumerate() {
                    history.iter_mut().zip(self.modes.col(k).iter()).for_each(|(f, d)| *f += z * d);
                }
            }
        }
        self.histories(values)
    }

    /// Histories at z and after one step along each unknown, and these steps; the largest force change is equal for all.
    pub(super) fn around(&self, z: &[f64]) -> (Forces, Vec<f64>) {
        let (clock, r) = (self.mean.len(), self.modes.ncols());
        let largest = |k: usize| self.modes.col(k).iter().fold(0.0_f64, |most, d| most.max(d.abs()));
        let steps: Vec<f64> = (0..self.unknowns()).map(|k| STEP / largest(k % r)).collect();
        let base = self.forces([z].into_iter()).values;
        let mut values = base.repeat(1 + self.unknowns());
        for (k, history) in values.chunks_exact_mut(base.len()).skip(1).enumerate() {
            let panel = &mut history[self.struck[k / r] * clock..][..clock];
            panel.iter_mut().zip(self.modes.col(k % r).iter()).for_each(|(f, d)| *f += steps[k] * d);
        }
        (self.histories(values), steps)
    }

    fn histories(&self, values: Vec<f64>) -> Forces {
        let instants = self.mean.len() - 1;
        let samples = values.len() / (self.panels * (instants + 1));
        Forces { samples, panels: self.panels, instants, values, strikes: Vec::new() }
    }

    /// Transpose of [`Prior::forces`]: maps a cotangent on the first part of histories (K, ·), on a clock `finer` times theirs,
    /// to z.
    pub(super) fn forces_vjp(&self, cotangent: &[f64], finer: usize) -> Vec<f64> {
        let mut along = Vec::with_capacity(self.unknowns());
        let one = cotangent.len() / self.panels;
        for bar in self.struck.iter().map(|panel| &cotangent[panel * one..][..one]) {
            let mut own = vec![0.0; self.mean.len() + 1];
            for (n, bar) in bar.iter().enumerate() {
                // Histories are linear between instants.
                let (at, part) = (n / finer, (n % finer) as f64 / finer as f64);
                own[at] += (1.0 - part) * bar;
                own[at + 1] += part * bar;
            }
            let along_mode = |mode: ColRef<f64>| mode.iter().zip(&own).map(|(d, f)| d * f).sum::<f64>();
            along.extend(self.modes.col_iter().map(along_mode));
        }
        along
    }

    /// The columns of D as histories (r, 1, R + 1) (N).
    pub(super) fn directions(&self) -> Forces {
        let values =
            self.modes.col_iter().flat_map(|mode| mode.iter().copied().collect::<Vec<_>>()).collect();
        let (samples, instants) = (self.modes.ncols(), self.mean.len() - 1);
        Forces { samples, panels: 1, instants, values, strikes: Vec::new() }
    }

    /// z from estimates (T, K) (N) of the forces at every (R/T)-th instant with white errors of deviation `error` (N). NaN if the
    /// estimates are not finite.
    pub(super) fn estimate_unknowns(&self, estimates: &[f64], error: f64) -> Vec<f64> {
        let (panels, instants) = (self.panels, estimates.len() / self.panels);
        let (every, r) = ((self.mean.len() - 1) / instants, self.modes.ncols());
        let seen = Mat::from_fn(instants, r, |n, k| self.modes[((n + 1) * every, k)]);
        let normal_matrix = seen.transpose() * &seen + Mat::<f64>::identity(r, r) * Scale(error * error);
        let off = Mat::from_fn(instants, self.struck.len(), |n, k| {
            estimates[n * panels + self.struck[k]] - self.mean[(n + 1) * every]
        });
        let z = solve_with_floor(normal_matrix.as_ref(), error * error, (seen.transpose() * off).as_ref());
        // NaN marks an invalid start.
        let z = z.unwrap_or_else(|| Mat::from_fn(r, self.struck.len(), |_, _| f64::NAN));
        z.col_iter().flat_map(|z| z.iter().copied().collect::<Vec<_>>()).collect()
    }
}
