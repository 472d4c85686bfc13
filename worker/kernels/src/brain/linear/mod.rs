//! Linear decoder: least-squares regression of the forces on the signals around each instant, exact at the ends of a sample.
//!
//! ```text
//! f̂_k(n) = b_k + Σ_c Σ_l W_kcl x_c(n + l),  l = −before … after,  x = 0 outside the sample
//! W_kcl equal for all l of a group: one lag each near 0, several lags each beyond
//! W, b = argmin Σ_i w_i Σ_kn (f̂ − f)² / Σ_i w_i Σ_kn f² + λ|W|²
//! w_i = 1/Σ f² of a sample: the loss is then the mean error as a fraction
//! ```
//! The problem is convex and solved exactly by a Cholesky factor of the normal matrix (`faer`), in f64.

mod normal;
mod solve;

pub use normal::Normal;
pub use solve::{FactoredEquations, Order, Singular, factor};

use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::{Accum, MatMut, MatRef, Par};
use rayon::prelude::*;
use realfft::{RealFftPlanner, num_complex::Complex};
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

/// From signals to forces, or from cotangents on forces to cotangents on signals.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Direction {
    Forward,
    Adjoint,
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
        let mut predicted = self.filtered(x, Direction::Forward);
        for row in predicted.chunks_exact_mut(self.sizes.outputs) {
            row.iter_mut().zip(&self.b).for_each(|(sum, b)| *sum += b);
        }
        predicted
    }

    /// Adjoint of [`Linear::predict`] without b: converts a cotangent on f̂ (N, T, K) to one on x (N, T, C).
    ///
    /// # Panics
    /// If the length is not a multiple of T·K.
    pub fn predict_vjp(&self, cotangent: &[f64]) -> Vec<f64> {
        self.filtered(cotangent, Direction::Adjoint)
    }

    /// Σ_l W_kcl x_c(n + l) (N, T, K) of x (N, T, C), or its adjoint from (N, T, K) to (N, T, C), by Fourier transforms of samples
    /// with zeros behind them, so that no sum wraps around.
    fn filtered(&self, values: &[f64], direction: Direction) -> Vec<f64> {
        let Sizes { instants, channels, outputs } = self.sizes;
        let Lags { before, after } = self.lags;
        let (from, to) = match direction {
            Direction::Forward => (channels, outputs),
            Direction::Adjoint => (outputs, channels),
        };
        let samples = values.len() / (instants * from);
        assert!(values.len() == samples * instants * from, "{} values of {:?}", values.len(), self.sizes);
        let length = smooth_length(instants + before.max(after));
        let mut planner = RealFftPlanner::<f64>::new();
        let (forwards, backwards) = (planner.plan_fft_forward(length), planner.plan_fft_inverse(length));
        let (mut real, mut scratch) = (forwards.make_input_vec(), forwards.make_scratch_vec());
        let bins = length / 2 + 1;
        let mut transform = |entries: &mut dyn Iterator<Item = (usize, f64)>,
                             spectrum: &mut [Complex<f64>]| {
            real.fill(0.0);
            entries.for_each(|(at, value)| real[at] = value);
            forwards.process_with_scratch(&mut real, spectrum, &mut scratch).expect("lengths match");
        };

        // conj(H) for the sum over n + l, H for its adjoint
        let mut filters = vec![Complex::default(); from * to * bins];
        for (number, filter) in filters.chunks_exact_mut(bins).enumerate() {
            let (input, output) = (number % from, number / from);
            let (k, c) = match direction {
                Direction::Forward => (output, input),
                Direction::Adjoint => (input, output),
            };
            let weights = self.w[k * self.lags.count() * channels + c..].iter().step_by(channels);
            let weights = weights.take(self.lags.count()).enumerate();
            let scaled = |w: &f64| w / length as f64;
            let mut of_lags = weights.map(|(lag, w)| ((length + lag - before) % length, scaled(w)));
            transform(&mut of_lags, filter);
            if direction == Direction::Forward {
                filter.iter_mut().for_each(|h| *h = h.conj());
            }
        }
        let mut spectra = vec![Complex::default(); from * bins];
        let (mut sum, mut result) = (vec![Complex::default(); bins], vec![0.0; samples * instants * to]);
        let (mut real, mut scratch) = (backwards.make_output_vec(), backwards.make_scratch_vec());
        for (sample, found) in
            values.chunks_exact(instants * from).zip(result.chunks_exact_mut(instants * to))
        {
            for (input, spectrum) in spectra.chunks_exact_mut(bins).enumerate() {
                transform(&mut sample[input..].iter().step_by(from).copied().enumerate(), spectrum);
            }
            for (output, filters) in filters.chunks_exact(from * bins).enumerate() {
                sum.fill(Complex::default());
                for (spectrum, filter) in spectra.chunks_exact(bins).zip(filters.chunks_exact(bins)) {
                    sum.iter_mut().zip(spectrum.iter().zip(filter)).for_each(|(sum, (x, h))| *sum += x * h);
                }
                // rounding: the first and last are real
                [0, bins - 1].into_iter().for_each(|end| sum[end].im = 0.0);
                backwards.process_with_scratch(&mut sum, &mut real, &mut scratch).expect("lengths match");
                found[output..].iter_mut().step_by(to).zip(&real).for_each(|(to, x)| *to = *x);
            }
        }
        result
    }
}

/// The smallest even number of at least `least` without a prime factor above 5.
fn smooth_length(least: usize) -> usize {
    let is_smooth = |n: &usize| {
        let rest = [2, 3, 5].iter().fold(*n, |mut n, prime| {
            while n.is_multiple_of(*prime) {
                n /= prime;
            }
            n
        });
        n.is_multiple_of(2) && rest == 1
    };
    (least..).find(is_smooth).expect("a power of two")
}
