//! Normal equations of weighted samples.
//!
//! ```text
//! R_cd[s, t] = Σ_i w_i x_ic(s) x_id(t)
//! G[(l,c), (m,d)] = Σ_n R_cd[n+l, n+m]      Q[(l,c), k] = Σ_i w_i Σ_n x_ic(n+l) f_ik(n)
//! ```
//! Rows and columns of lags that share a weight are summed. Each sum over n runs along a diagonal of R_cd, from its first entry
//! if l or m is at most 0, to its last entry if l or m is at least 0. Sums along diagonals, from either end, therefore contain
//! all entries (compare the covariance method of linear prediction; Makhoul, Proc. IEEE 63, 561, 1975).

use super::{Lags, Sizes, matrix, matrix_mut};
use crate::Pool;
use faer::linalg::matmul::matmul;
use faer::{Accum, Par};
use pulp::{Arch, NullaryFnOnce};
use rayon::prelude::*;
use std::ops::Range;

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
    /// Σ w Σ f², by which the loss is divided.
    power: f64,
}

impl Normal {
    /// Normal equations of samples x (N, T, C), f (N, T, K) with weights w (N), for a memory with these groups of lags that share a
    /// weight, in ascending order. `pool` performs all operations on them.
    ///
    /// # Panics
    /// If the lengths do not match the same N.
    pub fn new(
        sizes: Sizes,
        [x, f, w]: [&[f64]; 3],
        lags: Lags,
        groups: Vec<Range<usize>>,
        pool: &Pool,
    ) -> Self {
        let Sizes { instants, channels, outputs } = sizes;
        let unknowns = groups.len() * channels;
        let lengths = [x.len(), f.len()];
        assert_eq!(lengths, [channels, outputs].map(|width| w.len() * instants * width), "{}", w.len());
        let roots: Vec<f64> = w.iter().map(|w| w.sqrt()).collect();
        let [x, f] = [(x, channels), (f, outputs)].map(|(values, width)| series(values, width, &roots));

        let pairs: Vec<[usize; 2]> = (0..channels).flat_map(|c| (0..=c).map(move |d| [c, d])).collect();
        let of_pair = |&[c, d]: &[usize; 2]| {
            pool.heartbeat().beat();
            let products = &products(&x[c], &x[d], instants);
            Arch::new().dispatch(LaggedPairs { products, instants, lags, groups: &groups })
        };
        let of_channel = |x: &Vec<f64>| {
            let of_force = |f: &Vec<f64>| by_group(&groups, 1, &correlation(x, f, instants, lags));
            f.iter().map(of_force).collect::<Vec<_>>()
        };
        let (pairs, crossed): (Vec<_>, Vec<_>) = pool
            .install(|| (pairs.par_iter().map(of_pair).collect(), x.par_iter().map(of_channel).collect()));

        let mut g = vec![0.0; unknowns * unknowns];
        pool.install(|| {
            g.par_chunks_exact_mut(unknowns).enumerate().for_each(|(j, column)| {
                let (a, d) = (j / channels, j % channels);
                for c in 0..channels {
                    let (pair, first, step) = match c >= d {
                        true => (&pairs[c * (c + 1) / 2 + d], a, groups.len()),
                        false => (&pairs[d * (d + 1) / 2 + c], a * groups.len(), 1),
                    };
                    let from = a + usize::from(c < d);
                    for b in from..groups.len() {
                        column[b * channels + c] = pair[first + b * step];
                    }
                }
            });
        });
        let q = |k: usize| {
            let crossed = &crossed;
            (0..unknowns).map(move |i| crossed[i % channels][k][i / channels])
        };
        let q = (0..outputs).flat_map(q).collect();
        let total = |series: &[f64]| -> Vec<f64> {
            let samples = series.chunks_exact(instants).zip(&roots);
            samples.fold(vec![0.0; instants], |mut sum, (series, root)| {
                accumulate(&mut sum, series, *root);
                sum
            })
        };
        let mean_of = |x: &Vec<f64>| by_group(&groups, 1, &window_sums(&total(x), lags));
        let mean: Vec<Vec<f64>> = x.iter().map(mean_of).collect();
        let mean = (0..unknowns).map(|i| mean[i % channels][i / channels]).collect();
        let mean_force = f.iter().map(|f| total(f).iter().sum()).collect();
        let weight = w.iter().sum::<f64>() * instants as f64;
        let power = f.iter().flatten().map(|f| f * f).sum();
        let pool = pool.clone();
        Self { sizes, lags, pool, groups, unknowns, g, q, mean, mean_force, weight, power }
    }

    /// The memory.
    pub fn lags(&self) -> Lags {
        self.lags
    }

    /// Groups of lags that share a weight, in ascending order.
    pub fn groups(&self) -> &[Range<usize>] {
        &self.groups
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

/// Each channel's samples (N, T), times a factor per sample, of values (N, T, width).
pub(super) fn series(values: &[f64], width: usize, factors: &[f64]) -> Vec<Vec<f64>> {
    let one = values.len() / factors.len().max(1);
    let of_channel = |c: usize| {
        let samples = values.chunks_exact(one.max(1)).zip(factors);
        samples
            .flat_map(|(sample, factor)| sample[c..].iter().step_by(width).map(move |x| factor * x))
            .collect()
    };
    (0..width).map(of_channel).collect()
}

/// R[s, t] = Σ_i x_i(s) y_i(t) (T, T), row-major, of two series (N, T).
fn products(x: &[f64], y: &[f64], instants: usize) -> Vec<f64> {
    let mut products = vec![0.0; instants * instants];
    let samples = x.len() / instants;
    let [x, y] = [x, y].map(|series| matrix(series, instants, samples));
    let to = matrix_mut(&mut products, instants, instants);
    matmul(to, Accum::Replace, y, x.transpose(), 1.0, Par::Seq);
    products
}

/// Σ_i Σ_n x_i(n + l) y_i(n) of each lag l, of two series (N, T).
pub(super) fn correlation(x: &[f64], y: &[f64], instants: usize, lags: Lags) -> Vec<f64> {
    let Lags { before, after } = lags;
    let mut by_lag = vec![0.0; before + after + 1];
    for (s, row) in products(x, y, instants).chunks_exact(instants).enumerate() {
        // l = s − t
        let (first, end) = (s.saturating_sub(after), (s + before + 1).min(instants));
        let to = &mut by_lag[s + before + 1 - end..=s + before - first];
        to.iter_mut().rev().zip(&row[first..end]).for_each(|(sum, product)| *sum += product);
    }
    by_lag
}

/// Computes Σ_{l∈b} Σ_{m∈a} Σ_n R[n + l, n + m] for each group b (rows) and a (columns), row-major.
struct LaggedPairs<'a> {
    /// R (T, T).
    products: &'a [f64],
    instants: usize,
    lags: Lags,
    groups: &'a [Range<usize>],
}

impl NullaryFnOnce for LaggedPairs<'_> {
    type Output = Vec<f64>;

    #[inline(always)] // into code of each instruction set
    fn call(self) -> Vec<f64> {
        let Self { products, instants, lags, groups } = self;
        let (Lags { before, after }, count, last) = (lags, lags.count(), instants - 1);
        let group_of = |lag: usize| groups.partition_point(|group| group.end <= lag);
        let mut sums = vec![0.0; groups.len() * count];
        // sums of whole diagonals by m − l
        let reach = before + after;
        let mut whole = vec![0.0; 2 * reach + 1];

        // sums along diagonals from each entry of a row to the last entry, for l, m > 0
        let mut row = vec![0.0; instants + 1];
        for s in (0..instants).rev() {
            row.copy_within(1.., 0);
            accumulate(&mut row[..instants], &products[s * instants..], 1.0);
            if s <= reach {
                whole[reach - s] = row[0];
            }
            if (1..=after).contains(&s) {
                accumulate(&mut sums[group_of(before + s) * count..][before + 1..count], &row[1..], 1.0);
            }
        }
        let length = instants.min(reach + 1);
        whole[reach..reach + length].copy_from_slice(&row[..length]);

        // from the first entry to each entry of a row, for l, m < 0
        row.fill(0.0);
        for s in 0..last {
            row.copy_within(..last, 1);
            row[0] = 0.0;
            accumulate(&mut row[..instants], &products[s * instants..], 1.0);
            if let Some(l) = (s + before).checked_sub(last) {
                accumulate(&mut sums[group_of(l) * count..][..before], &row[last - before..], 1.0);
            }
        }

        for l in 0..count {
            let first = if l < before { before } else { 0 };
            let end = if l > before { before + 1 } else { count };
            accumulate(&mut sums[group_of(l) * count..][first..end], &whole[reach + first - l..], 1.0);
        }
        let mut pairs = Vec::with_capacity(groups.len() * groups.len());
        for sums in sums.chunks_exact(count) {
            pairs.extend(groups.iter().map(|group| sums[group.clone()].iter().sum::<f64>()));
        }
        pairs
    }
}

/// Σ_n x(n + l) of each lag l.
fn window_sums(x: &[f64], lags: Lags) -> Vec<f64> {
    let of_lag = |l: usize| match l.checked_sub(lags.before) {
        None => x[..x.len() + l - lags.before].iter().sum::<f64>(),
        Some(l) => x[l..].iter().sum(),
    };
    (0..lags.count()).map(of_lag).collect()
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
#[inline(always)]
fn accumulate(a: &mut [f64], b: &[f64], s: f64) {
    a.iter_mut().zip(b).for_each(|(a, b)| *a += s * b);
}
