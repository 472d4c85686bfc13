//! Linear decoder: least-squares regression of the forces on the signals around each instant, exact at the ends of a sample.
//!
//! ```text
//! f̂_k(n) = b_k + Σ_c Σ_l W_kcl x_c(n + l),  l = −before … after,  x = 0 outside the sample
//! W_kcl equal for all l of a group: one lag each near 0, several lags each beyond
//! W, b = argmin Σ_i w_i Σ_kn (f̂ − f)² / Σ_i w_i Σ_kn f² + λ|W|²
//! w_i = 1/Σ f² of a sample: the loss is then the mean error as a fraction
//! ```
//! The problem is convex and solved exactly by a Cholesky factor of the normal matrix (`faer`), in f64.

mod moments;
mod solve;

pub use moments::{Moments, Normal};
pub use solve::factor;
pub use solve::{Fit, Order, Singular};

use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::{Accum, MatMut, MatRef, Par};
use rayon::prelude::*;
use std::ops::Range;

/// Numbers of instants, signal channels and forces of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sizes {
    /// T.
    pub instants: usize,
    /// C = 3M.
    pub channels: usize,
    /// K.
    pub outputs: usize,
}

/// The memory: lags l = −before … after of x(n + l), in instants.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Lags {
    /// Past instants.
    pub before: usize,
    /// Future instants (look-ahead); 0 is causal.
    pub after: usize,
}

/// Numbers of neighbouring lags that share a weight, each up to a distance (MODEL.md).
const FINE: [(usize, usize); 2] = [(40, 1), (usize::MAX, 4)];
/// The same while a body is trained, if there would be more than `MANY` unknowns.
const COARSE: [(usize, usize); 4] = [(8, 1), (24, 2), (56, 4), (usize::MAX, 16)];
const MANY: usize = 1500;

impl Lags {
    /// All lags in a sample of T instants.
    pub fn whole(instants: usize) -> Self {
        Self { before: instants - 1, after: instants - 1 }
    }

    /// Number of lags.
    pub fn count(self) -> usize {
        self.before + self.after + 1
    }

    /// Number of weights per force of a decoder of this number of channels.
    pub fn unknowns(self, channels: usize) -> usize {
        self.groups().len() * channels
    }

    /// Groups of lags that share a weight, in ascending order of lags.
    pub fn groups(self) -> Vec<Range<usize>> {
        self.grouped(&FINE)
    }

    /// Groups while a body is trained on this number of channels: fewer than `groups` if these had many unknowns.
    pub fn training_groups(self, channels: usize) -> Vec<Range<usize>> {
        let fine = self.groups();
        if fine.len() * channels > MANY { self.grouped(&COARSE) } else { fine }
    }

    fn grouped(self, widths: &[(usize, usize)]) -> Vec<Range<usize>> {
        let side = |reach: usize| {
            let mut groups = Vec::new();
            let mut from = 1;
            for &(to, width) in widths {
                let to = to.min(reach);
                while from <= to {
                    let end = (from + width).min(to + 1);
                    groups.push(from..end);
                    from = end;
                }
            }
            groups
        };
        let zero = self.before;
        let past =
            side(self.before).into_iter().rev().map(|group| zero + 1 - group.end..zero + 1 - group.start);
        let future = side(self.after).into_iter().map(|group| zero + group.start..zero + group.end);
        past.chain(std::iter::once(zero..zero + 1)).chain(future).collect()
    }

    /// The reach nearest to `reach` at which a group ends. All groups are then also groups of longer memories.
    pub fn nearest_group_end(reach: usize) -> usize {
        let [(single, _), (_, shared)] = FINE;
        let beyond = reach.saturating_sub(single);
        reach.min(single) + (beyond + shared / 2) / shared * shared
    }

    /// Without the lags that always lie outside a sample of T instants.
    pub fn within(self, instants: usize) -> Self {
        Self { before: self.before.min(instants - 1), after: self.after.min(instants - 1) }
    }
}

/// Weights of a linear decoder.
#[derive(Debug, Clone, PartialEq)]
pub struct Linear {
    /// T, C, K.
    pub sizes: Sizes,
    /// Memory.
    pub lags: Lags,
    /// W (K, lags, C).
    pub w: Vec<f64>,
    /// b (K).
    pub b: Vec<f64>,
}

/// A column-major (rows, columns) view.
pub fn matrix(values: &[f64], rows: usize, columns: usize) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(values, rows, columns)
}

/// A writable column-major (rows, columns) view.
pub fn matrix_mut(values: &mut [f64], rows: usize, columns: usize) -> MatMut<'_, f64> {
    MatMut::from_column_major_slice_mut(values, rows, columns)
}

/// Columns of a matrix that one thread processes at once, independent of the number of threads so that sums are
/// reproducible.
const BLOCK: usize = 128;

/// Adds ± X Xᵀ to the lower triangle of the trailing block of a symmetric matrix (n, n); X has the shape (size of the
/// block, k). The threads of the current pool process blocks of columns.
fn add_symmetric(columns: &mut [f64], n: usize, x: MatRef<'_, f64>, sign: f64) {
    let first = n - x.nrows();
    columns.par_chunks_mut(BLOCK * n).enumerate().for_each(|(block, columns)| {
        let (at, width) = (block * BLOCK, columns.len() / n);
        let columns = matrix_mut(columns, n, width).split_at_row_mut(first + at).1;
        let (diagonal, below) = columns.split_at_row_mut(width);
        let (own, further) = x.split_at_row(at).1.split_at_row(width);
        let whole = BlockStructure::Rectangular;
        let lower = BlockStructure::TriangularLower;
        triangular::matmul(diagonal, lower, Accum::Add, own, whole, own.transpose(), whole, sign, Par::Seq);
        matmul(below, Accum::Add, further, own.transpose(), sign, Par::Seq);
    });
}

impl Linear {
    /// f̂ (N, T, K) of signals x (N, T, C).
    ///
    /// # Panics
    /// If the length is not a multiple of T·C.
    pub fn predict(&self, x: &[f64]) -> Vec<f64> {
        let Sizes { instants, outputs, .. } = self.sizes;
        let mut predicted: Vec<f64> =
            self.b.iter().copied().cycle().take(self.samples(x) * instants * outputs).collect();
        self.add_product(x, &mut predicted);
        predicted
    }

    /// Adjoint of [`Linear::predict`] without b: converts a cotangent on f̂ (N, T, K) to one on x (N, T, C).
    ///
    /// # Panics
    /// If the length is not a multiple of T·K.
    pub fn predict_vjp(&self, cotangent: &[f64]) -> Vec<f64> {
        let Sizes { instants, channels, outputs } = self.sizes;
        let (rows, columns) = (instants * channels, instants * outputs);
        let samples = cotangent.len() / columns;
        assert_eq!(cotangent.len(), samples * columns, "cotangent of {:?}", self.sizes);
        let mut x = vec![0.0; samples * rows];
        let toeplitz = self.toeplitz();
        matmul(
            matrix_mut(&mut x, rows, samples),
            Accum::Replace,
            matrix(&toeplitz, rows, columns),
            matrix(cotangent, columns, samples),
            1.0,
            Par::Seq,
        );
        x
    }

    /// f̂ += W ∗ x.
    fn add_product(&self, x: &[f64], predicted: &mut [f64]) {
        let Sizes { instants, channels, outputs } = self.sizes;
        let (rows, columns, samples) = (instants * channels, instants * outputs, self.samples(x));
        let toeplitz = self.toeplitz();
        matmul(
            matrix_mut(predicted, columns, samples),
            Accum::Add,
            matrix(&toeplitz, rows, columns).transpose(),
            matrix(x, rows, samples),
            1.0,
            Par::Seq,
        );
    }

    fn samples(&self, x: &[f64]) -> usize {
        let one = self.sizes.instants * self.sizes.channels;
        assert!(x.len().is_multiple_of(one), "{} signals of {:?}", x.len(), self.sizes);
        x.len() / one
    }

    /// W as a matrix from (t, c) to (n, k), column-major, with entries W_kcl at l = t − n.
    fn toeplitz(&self) -> Vec<f64> {
        let Sizes { instants, channels, outputs } = self.sizes;
        let Lags { before, after } = self.lags;
        let mut columns = vec![0.0; instants * channels * instants * outputs];
        for (j, column) in columns.chunks_exact_mut(instants * channels).enumerate() {
            let (n, k) = (j / outputs, j % outputs);
            let (first, last) = (n.saturating_sub(before), (n + after).min(instants - 1));
            let from = (k * self.lags.count() + first + before - n) * channels;
            let length = (last + 1 - first) * channels;
            column[first * channels..][..length].copy_from_slice(&self.w[from..from + length]);
        }
        columns
    }
}
