//! Cross-validated errors of linear decoders for any subset of units, from the Gram matrices of all signals by frequency.
//!
//! ```text
//! X_b = Σ_n x(n) e^(−iπbn/T), b = 0 … B     W_b = argmin Σ_i w_i |X_b W_b − F_b|² + λ|W_b|²
//! ```
//! Samples are padded to 2T, so that weights per frequency equal weights per lag (Parseval). Frequencies above those that hold
//! all but 10⁻⁴ of the force power count as not decoded.

use crate::Pool;
use crate::brain::linear::{Sizes, factor, matrix, matrix_mut};
use crate::stimuli::members;
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Accum, Par};

/// Largest share of the force power in frequencies that are left out.
const MAX_LEFT_OUT: f64 = 1e-4;

/// Gram matrices of the samples per frequency: per fold, then of all folds.
///
/// For z = (x, f) with real and imaginary parts p + iq: A = Σ p pᵀ + q qᵀ, S = Σ q pᵀ − p qᵀ. W = a + ib of signals x
/// and forces f solves [[A, S], [−S, A]]ₓₓ (a, b) = (A, −S)ₓ𝒻.
#[derive(Debug, Clone)]
pub(super) struct Spectra {
    sizes: Sizes,
    folds: usize,
    /// Weight per frequency: 1/(2T), twice that if −b is a different frequency.
    shares: Vec<f64>,
    /// A, S (C + K, C + K), by (frequency, fold); index `folds` is the sum.
    grams: Vec<Gram>,
    /// Weighted power of the forces per fold, the sum last.
    power: Vec<f64>,
    /// Power outside the frequencies, of the sum.
    left_out: f64,
    /// Threads, with counters.
    pool: Pool,
}

#[derive(Debug, Clone)]
struct Gram {
    a: Vec<f64>,
    s: Vec<f64>,
}

impl Spectra {
    /// From signals x (N, T, C) and forces f (N, T, K); sample i has weight w_i and is in fold `dealt[i]`.
    ///
    /// # Panics
    /// If lengths do not match one N.
    pub(super) fn new(sizes: Sizes, [x, f, w]: [&[f64]; 3], dealt: &[usize], pool: &Pool) -> Self {
        let Sizes { instants, channels, outputs } = sizes;
        let own = members(dealt);
        let folds = own.len();
        assert!(x.len() == w.len() * instants * channels && f.len() == w.len() * instants * outputs);
        let scaled = |values: &[f64]| -> Vec<f64> {
            let one = values.len() / w.len();
            values.iter().enumerate().map(|(j, x)| w[j / one].sqrt() * x).collect()
        };
        let (x, f) = (scaled(x), scaled(f));
        let mut power = vec![0.0; folds + 1];
        for (sample, fold) in f.chunks_exact(instants * outputs).zip(dealt) {
            let all: f64 = sample.iter().map(|f| f * f).sum();
            [*fold, folds].into_iter().for_each(|at| power[at] += all);
        }
        let share = |b| if b == 0 || b == instants { 0.5 } else { 1.0 } / instants as f64;
        let f = transform(&f, instants, outputs, instants + 1);
        let mut left_out = power[folds];
        let mut shares = Vec::new();
        while left_out > MAX_LEFT_OUT * power[folds] && shares.len() <= instants {
            let b = shares.len();
            let rows = f.iter().flat_map(|part| part.chunks_exact(outputs).skip(b).step_by(instants + 1));
            left_out -= share(b) * rows.flatten().map(|f| f * f).sum::<f64>();
            shares.push(share(b));
        }
        let x = transform(&x, instants, channels, shares.len());
        let mut grams = Vec::with_capacity(shares.len() * (folds + 1));
        for b in 0..shares.len() {
            pool.heartbeat().beat();
            let of = |samples: &Vec<usize>| {
                let row = |part: usize, i: usize| {
                    let pick = |values: &'_ [f64], width: usize| {
                        let bins = values.len() / w.len() / width;
                        values[(i * bins + b) * width..][..width].to_vec()
                    };
                    [pick(&x[part], channels), pick(&f[part], outputs)].concat()
                };
                let [p, q] =
                    [0, 1].map(|part| samples.iter().flat_map(|&i| row(part, i)).collect::<Vec<_>>());
                Gram::new([&p, &q], channels + outputs)
            };
            let parts: Vec<Gram> = own.iter().map(of).collect();
            let sum = parts[1..].iter().fold(parts[0].clone(), Gram::plus);
            grams.extend(parts);
            grams.push(sum);
        }
        let pool = pool.clone();
        Self { sizes, folds, shares, grams, power, left_out: left_out.max(0.0), pool }
    }

    /// Cross-validated error (%) of a linear decoder of these channels, averaged over samples; `None` if λ is too small for a
    /// factorisation.
    pub(super) fn error(&self, chosen: &[usize], ridge: f64) -> Option<f64> {
        let errors = self.errors(chosen, ridge)?;
        let of_fold = |(error, power): (&Option<f64>, &f64)| error.map_or(0.0, |error| error * power);
        let sum: f64 = errors.iter().zip(&self.power).map(of_fold).sum();
        Some(sum / self.power[self.folds])
    }

    /// As `error`, per fold.
    pub(super) fn errors(&self, chosen: &[usize], ridge: f64) -> Option<Vec<Option<f64>>> {
        self.pool.heartbeat().beat();
        let (outputs, n) = (self.sizes.outputs, 2 * chosen.len());
        let forces = self.forces();
        let [mut lower, mut own, mut total] = [(); 3].map(|()| vec![0.0; n * n]);
        let [mut right, mut judged, mut total_right] = [(); 3].map(|()| vec![0.0; n * outputs]);
        let left_out = self.left_out / self.power[self.folds];
        let mut errors: Vec<f64> = self.power[..self.folds].iter().map(|power| left_out * power).collect();
        for (grams, share) in self.grams.chunks_exact(self.folds + 1).zip(&self.shares) {
            let (all, parts) = grams.split_last().expect("of all folds");
            all.write_submatrix(chosen, &mut total);
            all.cut_right(chosen, &forces, &mut total_right);
            for ((part, power), error) in parts.iter().zip(&self.power).zip(&mut errors) {
                let scale = (self.power[self.folds] - power).recip();
                part.write_submatrix(chosen, &mut own);
                let rest = total.iter().zip(&own);
                lower.iter_mut().zip(rest).for_each(|(m, (all, own))| *m = scale * (all - own));
                lower.iter_mut().step_by(n + 1).for_each(|d| *d += ridge);
                part.cut_right(chosen, &forces, &mut judged);
                let rest = total_right.iter().zip(&judged);
                right.iter_mut().zip(rest).for_each(|(r, (all, judged))| *r = scale * (all - judged));
                factor(&self.pool, &mut lower, n).ok()?;
                let mut weights = matrix_mut(&mut right, n, outputs);
                let lower = matrix(&lower, n, n);
                solve_lower_triangular_in_place(lower, weights.as_mut(), Par::Seq);
                solve_upper_triangular_in_place(lower.transpose(), weights, Par::Seq);
                *error += share * (part.power(&forces) + quadratic(&own, &right, &judged));
            }
        }
        let percent = |(error, power): (&f64, &f64)| (*power > 0.0).then(|| 100.0 * error / power);
        let finite = errors.iter().all(|error| error.is_finite());
        finite.then(|| errors.iter().zip(&self.power).map(percent).collect())
    }

    /// Indices of the forces, after the signals.
    fn forces(&self) -> Vec<usize> {
        let Sizes { channels, outputs, .. } = self.sizes;
        (channels..channels + outputs).collect()
    }
}

/// wᵀ G w − 2 wᵀ r, summed over columns.
fn quadratic(gram: &[f64], weights: &[f64], right: &[f64]) -> f64 {
    let n = gram.len().isqrt();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let of = |(w, r): (&[f64], &[f64])| {
        let squares: f64 = gram.chunks_exact(n).zip(w).map(|(column, w_j)| w_j * dot(column, w)).sum();
        squares - 2.0 * dot(w, r)
    };
    weights.chunks_exact(n).zip(right.chunks_exact(n)).map(of).sum()
}

impl Gram {
    /// From real and imaginary parts (n, width).
    fn new([p, q]: [&[f64]; 2], width: usize) -> Self {
        let samples = p.len() / width;
        let product = |terms: [(&[f64], &[f64], f64); 2]| {
            let mut sum = vec![0.0; width * width];
            for (left, right, sign) in terms {
                matmul(
                    matrix_mut(&mut sum, width, width),
                    Accum::Add,
                    matrix(left, width, samples),
                    matrix(right, width, samples).transpose(),
                    sign,
                    Par::Seq,
                );
            }
            sum
        };
        Self { a: product([(p, p, 1.0), (q, q, 1.0)]), s: product([(q, p, 1.0), (p, q, -1.0)]) }
    }

    fn width(&self) -> usize {
        self.a.len().isqrt()
    }

    fn plus(mut self, other: &Self) -> Self {
        let add = |to: &mut [f64], from: &[f64]| to.iter_mut().zip(from).for_each(|(a, b)| *a += b);
        add(&mut self.a, &other.a);
        add(&mut self.s, &other.s);
        self
    }

    /// Σ |z|² of these channels.
    fn power(&self, chosen: &[usize]) -> f64 {
        chosen.iter().map(|c| self.a[c * (self.width() + 1)]).sum()
    }

    /// [[A, S], [−S, A]] of these channels.
    fn write_submatrix(&self, chosen: &[usize], matrix: &mut [f64]) {
        let (c, n, width) = (chosen.len(), 2 * chosen.len(), self.width());
        for (j, &y) in chosen.iter().enumerate() {
            let [a, s] = [&self.a, &self.s].map(|all| &all[y * width..][..width]);
            for (i, &x) in chosen.iter().enumerate() {
                let (a, s) = (a[x], s[x]);
                matrix[j * n + i] = a;
                matrix[j * n + c + i] = -s;
                matrix[(c + j) * n + i] = s;
                matrix[(c + j) * n + c + i] = a;
            }
        }
    }

    /// (A, −S) of these rows and columns.
    fn cut_right(&self, chosen: &[usize], columns: &[usize], right: &mut [f64]) {
        let (c, width) = (chosen.len(), self.width());
        for (to, y) in right.chunks_exact_mut(2 * c).zip(columns) {
            for (i, &x) in chosen.iter().enumerate() {
                (to[i], to[c + i]) = (self.a[y * width + x], -self.s[y * width + x]);
            }
        }
    }
}

/// Real and imaginary parts (N, bins, width) of values (N, T, width) at the first frequencies.
fn transform(values: &[f64], instants: usize, width: usize, bins: usize) -> [Vec<f64>; 2] {
    let angle =
        |b: usize, n: usize| std::f64::consts::PI * ((n * b) % (2 * instants)) as f64 / instants as f64;
    let waves = |part: fn(f64) -> f64| -> Vec<f64> {
        (0..bins).flat_map(|b| (0..instants).map(move |n| part(angle(b, n)))).collect()
    };
    [waves(f64::cos), waves(|x| -x.sin())].map(|waves| {
        let mut out = vec![0.0; values.len() / instants * bins];
        for (sample, out) in values.chunks_exact(instants * width).zip(out.chunks_exact_mut(bins * width)) {
            matmul(
                matrix_mut(out, width, bins),
                Accum::Replace,
                matrix(sample, width, instants),
                matrix(&waves, instants, bins),
                1.0,
                Par::Seq,
            );
        }
        out
    })
}
