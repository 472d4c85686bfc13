//! Cholesky factor of the normal matrix: weights of a memory and of shorter ones, and their sensitivities.
//!
//! The normal matrix of a memory whose lags come first is a leading block of G, and its factor is the leading block of G's
//! factor: one factor serves all such memories.

use super::normal::{Normal, by_group, correlation, series};
use super::{BLOCK, Lags, Linear, Sizes, add_symmetric, matrix, matrix_mut};
use crate::Pool;
use crate::brain::solve::dot;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Par, Spec};
use rayon::prelude::*;
use std::ops::Range;

/// Error: the normal matrix is numerically not positive definite, because the ridge is too small for these signals.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Singular;

/// Order of lags in the factor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// From the past to the future: shorter memories have the whole past and less look-ahead.
    Ascending,
    /// 0, −1, 1, −2, …: shorter memories reach equally far in both directions.
    Outward,
}

/// A factor, with the other data of solutions.
#[derive(Debug, Clone)]
pub struct FactoredEquations {
    sizes: Sizes,
    lags: Lags,
    /// Groups of lags that share a weight, in the factor's order.
    groups: Vec<Range<usize>>,
    unknowns: usize,
    /// L, column-major in the factor's order, lower triangle.
    lower: Vec<f64>,
    /// L⁻¹ Q (D, K).
    half: Vec<f64>,
    /// Mean of each lagged channel, in the factor's order.
    mean: Vec<f64>,
    mean_force: Vec<f64>,
    weight: f64,
}

impl FactoredEquations {
    /// Factorises G + λI.
    ///
    /// # Errors
    /// If the matrix is not positive definite.
    pub fn new(normal: Normal, ridge: f64, order: Order) -> Result<Self, Singular> {
        let normal = normal.eliminated();
        let Normal {
            sizes, lags, pool, unknowns, mut groups, g, mut q, mut mean, mean_force, weight, ..
        } = normal;
        let channels = sizes.channels;
        let mut lower = match order {
            Order::Ascending => g,
            Order::Outward => {
                let mut numbered: Vec<_> = groups.into_iter().enumerate().collect();
                numbered.sort_by_key(|(_, group)| {
                    let nearest = if group.end <= lags.before { group.end - 1 } else { group.start };
                    (nearest.abs_diff(lags.before), nearest)
                });
                let from: Vec<usize> =
                    numbered.iter().flat_map(|(u, _)| u * channels..(u + 1) * channels).collect();
                groups = numbered.into_iter().map(|(_, group)| group).collect();
                q = q.chunks_exact(unknowns).flat_map(|q| from.iter().map(|&i| q[i])).collect();
                mean = from.iter().map(|&i| mean[i]).collect();
                let mut sorted = Vec::with_capacity(g.len());
                for &j in &from {
                    sorted.extend(from.iter().map(|&i| g[i.min(j) * unknowns + i.max(j)]));
                }
                sorted
            }
        };
        // λ|W|²: a shared weight counts once per lag
        for (u, d) in lower.iter_mut().step_by(unknowns + 1).enumerate() {
            *d += ridge * groups[u / channels].len() as f64;
        }
        factor(&pool, &mut lower, unknowns)?;
        pool.heartbeat().beat();
        let right = matrix_mut(&mut q, unknowns, sizes.outputs);
        solve_lower_triangular_in_place(matrix(&lower, unknowns, unknowns), right, Par::Seq);
        if q.iter().all(|x| x.is_finite()) {
            Ok(Self { sizes, lags, groups, unknowns, lower, half: q, mean, mean_force, weight })
        } else {
            Err(Singular)
        }
    }

    /// The decoder of the whole memory.
    pub fn linear(&self) -> Linear {
        self.leading(self.lags, self.groups.len())
    }

    /// The decoder of a memory whose lags come first in this factor's order.
    ///
    /// # Panics
    /// If they do not come first.
    pub fn with_memory(&self, lags: Lags) -> Linear {
        let (groups, later) = (lags.groups(), self.lags.before - lags.before);
        let first = &self.groups[..groups.len()];
        let held = |group: &Range<usize>| first.contains(&(group.start + later..group.end + later));
        assert!(groups.iter().all(held), "{lags:?} do not come first in the memory {:?}", self.lags);
        self.leading(lags, groups.len())
    }

    /// The decoder of a memory that consists of the first groups in this factor's order.
    fn leading(&self, lags: Lags, groups: usize) -> Linear {
        let unknowns = groups * self.sizes.channels;
        let columns = self.half.chunks_exact(self.unknowns);
        let mut w: Vec<f64> = columns.flat_map(|column| column[..unknowns].iter().copied()).collect();
        self.back(unknowns, &mut w);
        let means = w.chunks_exact(unknowns).map(|w| dot(w, &self.mean));
        let b = self.mean_force.iter().zip(means).map(|(force, seen)| force - seen).collect();
        Linear { sizes: self.sizes, lags, w: self.each_lag(lags, &w), b }
    }

    /// H⁻¹ (V, v) for the decoder of the whole memory, with H the second derivative of its objective and (V, v) a gradient as of
    /// [`Linear::weights_vjp`].
    pub fn sensitivity(&self, gradient: &Linear) -> Linear {
        let unknowns = self.unknowns;
        let mut z = by_group(&self.groups, self.sizes.channels, &gradient.w);
        for (z, b) in z.chunks_exact_mut(unknowns).zip(&gradient.b) {
            z.iter_mut().zip(&self.mean).for_each(|(z, mean)| *z = 0.5 * (*z - mean * b));
        }
        let right = matrix_mut(&mut z, unknowns, self.sizes.outputs);
        solve_lower_triangular_in_place(matrix(&self.lower, unknowns, unknowns), right, Par::Seq);
        self.back(unknowns, &mut z);
        let means = z.chunks_exact(unknowns).map(|z| dot(z, &self.mean));
        let b = gradient.b.iter().zip(means).map(|(b, seen)| 0.5 * b / self.weight - seen).collect();
        Linear { sizes: self.sizes, lags: self.lags, w: self.each_lag(self.lags, &z), b }
    }

    /// Applies L⁻ᵀ of the leading block.
    fn back(&self, unknowns: usize, right: &mut [f64]) {
        let lower = matrix(&self.lower, self.unknowns, self.unknowns).submatrix(0, 0, unknowns, unknowns);
        let right = matrix_mut(right, unknowns, self.sizes.outputs);
        solve_upper_triangular_in_place(lower.transpose(), right, Par::Seq);
    }

    /// Weights of all lags, in ascending order, from the weights of the groups.
    fn each_lag(&self, lags: Lags, solved: &[f64]) -> Vec<f64> {
        let Sizes { channels, outputs, .. } = self.sizes;
        let (unknowns, later) = (solved.len() / outputs, self.lags.before - lags.before);
        let mut w = vec![0.0; lags.count() * channels * outputs];
        for (to, from) in w.chunks_exact_mut(lags.count() * channels).zip(solved.chunks_exact(unknowns)) {
            for (group, weights) in self.groups.iter().zip(from.chunks_exact(channels)) {
                for lag in group.clone() {
                    to[(lag - later) * channels..][..channels].copy_from_slice(weights);
                }
            }
        }
        w
    }
}

impl Linear {
    /// Adjoint of f̂ in the weights: converts a cotangent on f̂ (N, T, K) for signals x (N, T, C) to one on W and b.
    ///
    /// # Panics
    /// If the lengths do not match the same N.
    pub fn weights_vjp(&self, x: &[f64], cotangent: &[f64]) -> Self {
        let Sizes { instants, channels, outputs } = self.sizes;
        let samples = x.len() / (instants * channels);
        assert!(x.len() == samples * instants * channels, "{} signals of {:?}", x.len(), self.sizes);
        let len = samples * instants * outputs;
        assert_eq!(cotangent.len(), len, "cotangent does not match {samples} samples");
        let ones = vec![1.0; samples];
        let [x, by_force] = [(x, channels), (cotangent, outputs)].map(|(of, width)| series(of, width, &ones));
        let mut w = vec![0.0; self.w.len()];
        for (to, force) in w.chunks_exact_mut(self.lags.count() * channels).zip(&by_force) {
            for (c, x) in x.iter().enumerate() {
                let by_lag = correlation(x, force, instants, self.lags);
                to[c..].iter_mut().step_by(channels).zip(by_lag).for_each(|(to, sum)| *to = sum);
            }
        }
        let b = (0..outputs).map(|k| cotangent[k..].iter().step_by(outputs).sum()).collect();
        Self { w, b, ..*self }
    }
}

/// Overwrites a symmetric matrix (n, n), given by its lower triangle, with its Cholesky factor. Processes blocks of columns, each
/// of which updates the following ones (Golub and Van Loan, Matrix Computations, 4.2.9).
///
/// # Errors
/// If the matrix is not positive definite.
pub fn factor(pool: &Pool, lower: &mut [f64], n: usize) -> Result<(), Singular> {
    pool.install(|| {
        let mut memory = MemBuffer::new(cholesky_in_place_scratch::<f64>(BLOCK, Par::Seq, Spec::default()));
        for at in (0..n).step_by(BLOCK) {
            let width = BLOCK.min(n - at);
            let (done, behind) = lower.split_at_mut((at + width) * n);
            let block = matrix_mut(&mut done[at * n..], n, width).split_at_row_mut(at).1;
            let (mut diagonal, mut below) = block.split_at_row_mut(width);
            let (stack, spec) = (MemStack::new(&mut memory), Spec::default());
            cholesky_in_place(diagonal.as_mut(), Default::default(), Par::Seq, stack, spec)
                .map_err(|_| Singular)?;
            let mut parts = Vec::new();
            while below.nrows() > 0 {
                let rows = BLOCK.min(below.nrows());
                let (part, rest) = below.split_at_row_mut(rows);
                parts.push(part.transpose_mut());
                below = rest;
            }
            let diagonal = diagonal.as_ref();
            parts.into_par_iter().for_each(|part| solve_lower_triangular_in_place(diagonal, part, Par::Seq));
            let below = matrix(&done[at * n..], n, width).split_at_row(at + width).1;
            add_symmetric(behind, n, below, -1.0);
        }
        Ok(())
    })
}
