//! The factor of the normal matrix: weights of a memory and of every shorter one that begins alike, and what they follow.
//!
//! A memory whose lags come first has the leading block of G, whose factor is the leading block of G's: one factor serves
//! them all.

use super::moments::{Normal, lagged};
use super::{Lags, Linear, Moments, Sizes, matrix, matrix_mut};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Accum, Par, Spec};

/// The normal matrix is not positive definite to rounding: the ridge is too small for these signals.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Singular;

/// Which lags come first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// From the past on: shorter memories have the whole past and less ahead.
    Ascending,
    /// 0, −1, 1, −2, …: shorter memories reach as far both ways. For a memory that does so itself.
    Outward,
}

/// A factor, with what solutions need beside it.
#[derive(Debug, Clone)]
pub struct Fit {
    sizes: Sizes,
    lags: Lags,
    order: Order,
    unknowns: usize,
    /// L, column-major in its order; lower triangle.
    lower: Vec<f64>,
    /// L⁻¹ Q (D, K).
    half: Vec<f64>,
    /// Of each lagged channel, in its order.
    mean: Vec<f64>,
    mean_force: Vec<f64>,
    weight: f64,
}

impl Fit {
    /// Factors G + λI of this memory.
    ///
    /// # Errors
    /// If it is not positive definite.
    ///
    /// # Panics
    /// If the order is `Outward` and the memory does not reach as far both ways.
    pub fn new(moments: &Moments, lags: Lags, ridge: f64, order: Order) -> Result<Self, Singular> {
        let sizes = moments.sizes;
        let Normal { unknowns, g, mut q, mut mean, mean_force, weight } = moments.normal(lags);
        let mut lower = match order {
            Order::Ascending => g,
            Order::Outward => {
                let from: Vec<usize> = outward(lags, sizes.channels);
                q = q.chunks_exact(unknowns).flat_map(|q| from.iter().map(|&i| q[i])).collect();
                mean = from.iter().map(|&i| mean[i]).collect();
                let mut sorted = Vec::with_capacity(g.len());
                for &j in &from {
                    sorted.extend(from.iter().map(|&i| g[i.min(j) * unknowns + i.max(j)]));
                }
                sorted
            }
        };
        lower.iter_mut().step_by(unknowns + 1).for_each(|d| *d += ridge);
        let mut memory =
            MemBuffer::new(cholesky_in_place_scratch::<f64>(unknowns, Par::Seq, Spec::default()));
        cholesky_in_place(
            matrix_mut(&mut lower, unknowns, unknowns),
            Default::default(),
            Par::Seq,
            MemStack::new(&mut memory),
            Spec::default(),
        )
        .map_err(|_| Singular)?;
        let outputs = sizes.outputs;
        solve_lower_triangular_in_place(
            matrix(&lower, unknowns, unknowns),
            matrix_mut(&mut q, unknowns, outputs),
            Par::Seq,
        );
        if q.iter().all(|x| x.is_finite()) {
            Ok(Self { sizes, lags, order, unknowns, lower, half: q, mean, mean_force, weight })
        } else {
            Err(Singular)
        }
    }

    /// The brain of the whole memory.
    pub fn linear(&self) -> Linear {
        self.shorter(self.lags)
    }

    /// The brain of a memory whose lags come first in this factor's order.
    ///
    /// # Panics
    /// If they do not.
    pub fn shorter(&self, lags: Lags) -> Linear {
        let first = match self.order {
            Order::Ascending => lags.before == self.lags.before && lags.after <= self.lags.after,
            Order::Outward => lags.before == lags.after && lags.before <= self.lags.before,
        };
        assert!(first, "{lags:?} of {:?}", self.lags);
        let unknowns = lags.count() * self.sizes.channels;
        let columns = self.half.chunks_exact(self.unknowns);
        let mut w: Vec<f64> = columns.flat_map(|column| column[..unknowns].iter().copied()).collect();
        self.back(unknowns, &mut w);
        let means = w.chunks_exact(unknowns).map(|w| dot(w, &self.mean));
        let b = self.mean_force.iter().zip(means).map(|(force, seen)| force - seen).collect();
        Linear { sizes: self.sizes, lags, w: self.in_lag_order(lags, w), b }
    }

    /// How the brain of the whole memory answers a force on its weights: H⁻¹ (V, v), H the second derivative of what it
    /// minimises; (V, v) a gradient as of [`Linear::weights_vjp`].
    pub fn sensitivity(&self, gradient: &Linear) -> Linear {
        let unknowns = self.unknowns;
        let from = self.positions(self.lags);
        let mut z = Vec::with_capacity(gradient.w.len());
        for (w, b) in gradient.w.chunks_exact(unknowns).zip(&gradient.b) {
            z.extend(from.iter().zip(&self.mean).map(|(&i, mean)| 0.5 * (w[i] - mean * b)));
        }
        solve_lower_triangular_in_place(
            matrix(&self.lower, unknowns, unknowns),
            matrix_mut(&mut z, unknowns, self.sizes.outputs),
            Par::Seq,
        );
        self.back(unknowns, &mut z);
        let means = z.chunks_exact(unknowns).map(|z| dot(z, &self.mean));
        let b = gradient.b.iter().zip(means).map(|(b, seen)| 0.5 * b / self.weight - seen).collect();
        Linear { sizes: self.sizes, lags: self.lags, w: self.in_lag_order(self.lags, z), b }
    }

    /// L⁻ᵀ of the leading block.
    fn back(&self, unknowns: usize, right: &mut [f64]) {
        let lower = matrix(&self.lower, self.unknowns, self.unknowns);
        solve_upper_triangular_in_place(
            lower.submatrix(0, 0, unknowns, unknowns).transpose(),
            matrix_mut(right, unknowns, self.sizes.outputs),
            Par::Seq,
        );
    }

    /// Where the unknowns of this order stand in that of the lags.
    fn positions(&self, lags: Lags) -> Vec<usize> {
        match self.order {
            Order::Ascending => (0..lags.count() * self.sizes.channels).collect(),
            Order::Outward => outward(lags, self.sizes.channels),
        }
    }

    fn in_lag_order(&self, lags: Lags, solved: Vec<f64>) -> Vec<f64> {
        let (from, unknowns) = (self.positions(lags), lags.count() * self.sizes.channels);
        let mut w = vec![0.0; solved.len()];
        for (to, column) in w.chunks_exact_mut(unknowns).zip(solved.chunks_exact(unknowns)) {
            from.iter().zip(column).for_each(|(&i, x)| to[i] = *x);
        }
        w
    }
}

impl Linear {
    /// Transpose of f̂ in the weights: a cotangent on f̂ (N, T, K) of signals x (N, T, C) as one on W and b.
    ///
    /// # Panics
    /// If the lengths do not belong to one N.
    pub fn weights_vjp(&self, x: &[f64], cotangent: &[f64]) -> Self {
        let Sizes { instants, channels, outputs } = self.sizes;
        let (rows, columns) = (instants * channels, instants * outputs);
        let samples = x.len() / rows;
        assert_eq!(cotangent.len(), samples * columns, "of {samples} samples");
        let mut cross = vec![0.0; rows * columns];
        matmul(
            matrix_mut(&mut cross, rows, columns),
            Accum::Replace,
            matrix(x, rows, samples),
            matrix(cotangent, columns, samples).transpose(),
            1.0,
            Par::Seq,
        );
        let w = lagged(self.sizes, self.lags, outputs, |j| &cross[j * rows..(j + 1) * rows]);
        let b = (0..outputs).map(|k| cotangent[k..].iter().step_by(outputs).sum()).collect();
        Self { w, b, ..*self }
    }
}

/// Unknowns, numbered by lag and channel, in the order of lags 0, −1, 1, −2, ….
fn outward(lags: Lags, channels: usize) -> Vec<usize> {
    assert_eq!(lags.before, lags.after, "reaches as far both ways");
    let lag = |i: usize| if i % 2 == 1 { lags.before - i.div_ceil(2) } else { lags.before + i / 2 };
    (0..lags.count()).flat_map(|i| (0..channels).map(move |c| lag(i) * channels + c)).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
