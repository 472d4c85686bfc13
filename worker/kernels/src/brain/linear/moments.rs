//! Weighted second moments of samples, which determine the normal equations of every memory.
//!
//! ```text
//! R[(s,c), (t,d)] = Σ_i w_i x_ic(s) x_id(t)      P[(t,c), (n,k)] = Σ_i w_i x_ic(t) f_ik(n)
//! G[(l,c), (m,d)] = Σ_n R[(n+l,c), (n+m,d)]      Q[(l,c), k]     = Σ_n P[(n+l,c), (n,k)]
//! ```
//! Rows and columns of lags that share a weight are summed.
//! Along a diagonal, G changes by one entry of R at each end of the window (the covariance method of linear
//! prediction; Makhoul, Proc. IEEE 63, 561, 1975). G therefore costs O(N·D²), not O(N·T·D²).

use super::{BLOCK, Lags, Sizes, add_symmetric, matrix, matrix_mut};
use crate::Pool;
use faer::linalg::matmul::matmul;
use faer::{Accum, Par};
use rayon::prelude::*;
use std::ops::Range;

/// Moments of a set of samples; moments of disjoint sets add up.
#[derive(Debug, Clone)]
pub struct Moments {
    pub(super) sizes: Sizes,
    pub(super) pool: Pool,
    /// R (T·C, T·C), column-major, lower triangle.
    second: Vec<f64>,
    /// P (T·C, T·K), column-major.
    cross: Vec<f64>,
    /// Σ w x (T·C).
    signals: Vec<f64>,
    /// Σ w f (T·K).
    forces: Vec<f64>,
    /// Σ w.
    weight: f64,
    /// Σ w Σ f², by which the loss is divided.
    power: f64,
}

/// Normal equations of one memory; those of disjoint sets of samples add up.
#[derive(Debug, Clone)]
pub struct Normal {
    pub(super) sizes: Sizes,
    pub(super) lags: Lags,
    pub(super) pool: Pool,
    /// Groups of lags that share a weight.
    pub(super) groups: Vec<Range<usize>>,
    /// D = groups of lags · C.
    pub(super) unknowns: usize,
    /// G (D, D), column-major, lower triangle.
    pub(super) g: Vec<f64>,
    /// Q (D, K), column-major.
    pub(super) q: Vec<f64>,
    /// Weighted sum of each lagged channel (D).
    pub(super) mean: Vec<f64>,
    /// Weighted sum of each force (K).
    pub(super) mean_force: Vec<f64>,
    /// s = T Σ w: half the second derivative of the loss in b.
    pub(super) weight: f64,
    /// Σ w Σ f².
    power: f64,
}

impl Moments {
    /// Moments of no samples. `pool` performs all operations on them.
    pub fn new(sizes: Sizes, pool: &Pool) -> Self {
        let (rows, columns) = (sizes.instants * sizes.channels, sizes.instants * sizes.outputs);
        Self {
            sizes,
            pool: pool.clone(),
            second: vec![0.0; rows * rows],
            cross: vec![0.0; rows * columns],
            signals: vec![0.0; rows],
            forces: vec![0.0; columns],
            weight: 0.0,
            power: 0.0,
        }
    }

    /// Removes all samples but keeps the memory: fresh pages (0.1 GB for six sensors) would cost time.
    pub fn clear(&mut self) {
        let Self { second, cross, signals, forces, weight, power, .. } = self;
        [second, cross, signals, forces].into_iter().for_each(|sums| sums.fill(0.0));
        (*weight, *power) = (0.0, 0.0);
    }

    /// Adds samples x (N, T, C), f (N, T, K) with weights w (N).
    ///
    /// # Panics
    /// If the lengths do not match the same N.
    pub fn add(&mut self, x: &[f64], f: &[f64], w: &[f64]) {
        let Sizes { instants, channels, outputs } = self.sizes;
        let (rows, columns, samples) = (instants * channels, instants * outputs, w.len());
        assert!(x.len() == samples * rows && f.len() == samples * columns, "{} {}", x.len(), f.len());
        let scaled = |values: &[f64], width: usize, sums: &mut [f64]| -> Vec<f64> {
            let mut all = Vec::with_capacity(values.len());
            for (sample, w) in values.chunks_exact(width).zip(w) {
                sums.iter_mut().zip(sample).for_each(|(sum, x)| *sum += w * x);
                all.extend(sample.iter().map(|x| w.sqrt() * x));
            }
            all
        };
        let x = scaled(x, rows, &mut self.signals);
        let f = scaled(f, columns, &mut self.forces);
        self.weight += w.iter().sum::<f64>();
        self.power += f.iter().map(|f| f * f).sum::<f64>();
        let x = matrix(&x, rows, samples);
        self.pool.install(|| add_symmetric(&mut self.second, rows, x, 1.0));
        self.pool.heartbeat().beat();
        let f = matrix(&f, columns, samples);
        self.pool.install(|| {
            self.cross.par_chunks_mut(BLOCK * rows).enumerate().for_each(|(block, cross)| {
                let width = cross.len() / rows;
                let f = f.subrows(block * BLOCK, width);
                matmul(matrix_mut(cross, rows, width), Accum::Add, x, f.transpose(), 1.0, Par::Seq);
            });
        });
    }

    /// Normal equations of a memory.
    pub fn normal(&self, lags: Lags) -> Normal {
        self.normal_of(lags, lags.groups())
    }

    /// Normal equations of a memory with these groups of lags that share a weight, in ascending order.
    pub fn normal_of(&self, lags: Lags, groups: Vec<Range<usize>>) -> Normal {
        let Sizes { instants, channels, outputs } = self.sizes;
        let (rows, all) = (instants * channels, lags.count() * channels);
        let first = instants - lags.before;
        let unknowns = groups.len() * channels;

        // below the diagonal, a column equals the previous lag's column shifted down by C, except for one instant at
        // each end of the window
        let mut g = vec![0.0; unknowns * unknowns];
        let mut columns: Vec<_> = (0..channels).map(|_| Vec::with_capacity(groups.len())).collect();
        for (j, below) in g.chunks_exact_mut(unknowns).enumerate() {
            columns[j % channels].push(below);
        }
        let of_channel = |(c, columns): (usize, Vec<&mut [f64]>)| {
            let (mut column, mut within) = (vec![0.0; all], Vec::new());
            for ((b, group), below) in groups.iter().enumerate().zip(columns) {
                for l in group.clone() {
                    let j = l * channels + c;
                    let mut ends: Vec<(usize, f64)> = (0..first).map(|t| (t, 1.0)).collect();
                    if l > 0 {
                        column.copy_within(j - channels..all - channels, j);
                        ends = vec![(first - 1 + l, 1.0), ((l - 1).wrapping_sub(lags.before), -1.0)];
                    }
                    for (t, sign) in ends.into_iter().filter(|(t, _)| *t < instants) {
                        let at = t * channels + c;
                        accumulate(&mut column[j..], &self.second[at * rows + at..(at + 1) * rows], sign);
                    }
                    within.extend_from_slice(&column[j..group.end * channels]);
                    for (a, group) in groups.iter().enumerate().skip(b + 1) {
                        for m in group.clone() {
                            let seen = &column[m * channels..(m + 1) * channels];
                            accumulate(&mut below[a * channels..], seen, 1.0);
                        }
                    }
                }
            }
            within.into_iter()
        };
        let mut within: Vec<_> =
            self.pool.install(|| columns.into_par_iter().enumerate().map(of_channel).collect());
        // within a group, (l, c) and (m, d) occur twice: as they are and mirrored
        for (b, group) in groups.iter().enumerate() {
            for (l, c) in group.clone().flat_map(|l| (0..channels).map(move |c| (l, c))) {
                let j = l * channels + c;
                for (i, x) in (j..group.end * channels).zip(&mut within[c]) {
                    let d = i % channels;
                    let twice = if d == c && i != j { 2.0 } else { 1.0 };
                    g[(b * channels + c.min(d)) * unknowns + b * channels + c.max(d)] += twice * x;
                }
            }
        }
        let q = lagged(self.sizes, lags, outputs, |j| &self.cross[j * rows..(j + 1) * rows]);
        let q = by_group(&groups, channels, &q);
        let mean = by_group(&groups, channels, &lagged(self.sizes, lags, 1, |_| &self.signals));
        let force = |k: usize| self.forces[k..].iter().step_by(outputs).sum();
        let mean_force = (0..outputs).map(force).collect();
        let (sizes, pool) = (self.sizes, self.pool.clone());
        let (weight, power) = (self.weight * instants as f64, self.power);
        Normal { sizes, lags, pool, groups, unknowns, g, q, mean, mean_force, weight, power }
    }
}

impl Normal {
    /// The memory.
    pub fn lags(&self) -> Lags {
        self.lags
    }

    /// Adds `times` times the normal equations of `others`; −1 removes samples that both contain.
    ///
    /// # Panics
    /// If sizes, memories or groups differ.
    pub fn plus(mut self, times: f64, others: &Self) -> Self {
        assert_eq!((self.sizes, self.lags, &self.groups), (others.sizes, others.lags, &others.groups));
        accumulate(&mut self.g, &others.g, times);
        accumulate(&mut self.q, &others.q, times);
        accumulate(&mut self.mean, &others.mean, times);
        accumulate(&mut self.mean_force, &others.mean_force, times);
        self.weight += times * others.weight;
        self.power += times * others.power;
        self
    }

    /// Eliminates the bias and divides by the weighted power: G − g gᵀ/s, Q − g hᵀ/s, means g/s and h/s.
    pub(super) fn eliminated(mut self) -> Self {
        let Self { unknowns, g, q, mean, mean_force, weight, power, .. } = &mut self;
        let s = *weight;
        mean.iter_mut().chain(mean_force.iter_mut()).for_each(|x| *x /= s);
        for (j, column) in g.chunks_exact_mut(*unknowns).enumerate() {
            accumulate(&mut column[j..], &mean[j..], -s * mean[j]);
        }
        for (column, force) in q.chunks_exact_mut(*unknowns).zip(mean_force) {
            accumulate(column, mean, -s * *force);
        }
        let scale = power.recip();
        g.iter_mut().chain(q).for_each(|x| *x *= scale);
        *weight = s * scale;
        self
    }
}

/// Σ_n P[(n+l,c), (n,k)], (D, K) column-major; `column` returns the columns of P (T·C, T·K).
pub(super) fn lagged<'a>(
    sizes: Sizes,
    lags: Lags,
    outputs: usize,
    column: impl Fn(usize) -> &'a [f64],
) -> Vec<f64> {
    let Sizes { instants, channels, .. } = sizes;
    let unknowns = lags.count() * channels;
    let mut sums = vec![0.0; unknowns * outputs];
    for n in 0..instants {
        let (from, to) = (n.saturating_sub(lags.before), (n + lags.after).min(instants - 1) + 1);
        let at = (from + lags.before - n) * channels;
        for k in 0..outputs {
            let seen = &column(n * outputs + k)[from * channels..to * channels];
            accumulate(&mut sums[k * unknowns + at..(k + 1) * unknowns], seen, 1.0);
        }
    }
    sums
}

/// Sums the rows of each group of lags: from (lags · C, K) to (D, K).
pub(super) fn by_group(groups: &[Range<usize>], channels: usize, columns: &[f64]) -> Vec<f64> {
    let all = groups.iter().map(|group| group.len()).sum::<usize>() * channels;
    let mut sums = Vec::with_capacity(columns.len());
    for (column, group) in
        columns.chunks_exact(all).flat_map(|column| groups.iter().map(move |g| (column, g)))
    {
        let rows = column[group.start * channels..group.end * channels].chunks_exact(channels);
        let at = sums.len();
        sums.resize(at + channels, 0.0);
        rows.for_each(|row| accumulate(&mut sums[at..], row, 1.0));
    }
    sums
}

/// a += s·b, over the shorter length.
fn accumulate(a: &mut [f64], b: &[f64], s: f64) {
    a.iter_mut().zip(b).for_each(|(a, b)| *a += s * b);
}
