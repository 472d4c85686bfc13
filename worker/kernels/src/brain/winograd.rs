//! Convolution with k = 3 by Winograd's F(2, 3): four products per pair of rows instead of six.
//!
//! ```text
//! U = (g₀, (g₀+g₁+g₂)/2, (g₀−g₁+g₂)/2, g₂)     V = (a₀−a₂, a₁+a₂, a₂−a₁, a₁−a₃) of the rows 2h … 2h+3
//! Mᵢ = Vᵢ Uᵢ      c₀ = M₀ + M₁ + M₂            c₁ = M₁ − M₂ − M₃
//! ∂g: Qᵢ = Vᵢᵀ Eᵢ, E = (e₀, e₀+e₁, e₀−e₁, −e₁): g̅₀ = Q₀ + (Q₁+Q₂)/2, g̅₁ = (Q₁−Q₂)/2, g̅₂ = (Q₁+Q₂)/2 + Q₃
//! ```
//! The four forms are stored one after the other. Interleaved rows (4 × 64 apart) would use too few sets of L1.
//! Lavin and Gray, arXiv:1509.09308, in one dimension. U₃ is stored negated.
//!
//! The unsafe functions require the checks of `Kernels`, and a machine that supports the vector's instruction set.

#![expect(unsafe_op_in_unsafe_fn, reason = "each whole body relies on the checks of its caller")]

use super::tiles::{Product, accumulate, close, panel};
use crate::lanes::{Scalar, Vector};

/// Entry of the i-th form of the weights, from the same entry `g(k)` of the taps.
#[inline(always)]
pub fn form<F: Scalar>(i: usize, g: impl Fn(usize) -> F) -> F {
    let half = F::from_f64(0.5);
    match i {
        0 => g(0),
        1 => half * (g(0) + g(1) + g(2)),
        2 => half * (g(0) - g(1) + g(2)),
        _ => F::ZERO - g(2),
    }
}

/// Adds the gradient (3, n) that follows from Q₀, Q₁, Q₂, −Q₃, each of length n.
pub fn add_gradient<F: Scalar>(q: &[F], gradient: &mut [F]) {
    let n = gradient.len() / 3;
    let half = F::from_f64(0.5);
    for j in 0..n {
        let (even, odd) = (half * (q[n + j] + q[2 * n + j]), half * (q[n + j] - q[2 * n + j]));
        gradient[j] += q[j] + even;
        gradient[n + j] += odd;
        gradient[2 * n + j] += even - q[3 * n + j];
    }
}

/// As `Kernels::pairs`.
#[inline(always)]
pub unsafe fn pairs<V: Vector, const R: usize, const R3: usize>(p: &mut Product<V::Scalar>) {
    // Constant lengths save the registers of row addresses.
    match (p.lda, p.depth) {
        (64, 64) => pairs_by_stride::<V, R, R3>(p, 64, 64),
        (stride, depth) => pairs_by_stride::<V, R, R3>(p, stride, depth),
    }
}

#[inline(always)]
unsafe fn pairs_by_stride<V: Vector, const R: usize, const R3: usize>(
    p: &mut Product<V::Scalar>,
    lda: usize,
    depth: usize,
) {
    let mut column = 0;
    while column < p.columns {
        let registers = panel(p.columns - column, V::LANES);
        match registers {
            1 => pairs_panel::<V, R, 1>(p, lda, depth, column),
            3 => pairs_panel::<V, R3, 3>(p, lda, depth, column),
            _ => pairs_panel::<V, R, 2>(p, lda, depth, column),
        }
        column += registers * V::LANES;
    }
}

#[inline(always)]
unsafe fn pairs_panel<V: Vector, const R: usize, const W: usize>(
    p: &mut Product<V::Scalar>,
    lda: usize,
    depth: usize,
    column: usize,
) {
    let u = p.panels.as_ptr().add(column * 4 * depth);
    let mut h = 0;
    while h + R <= p.rows / 2 {
        tile::<V, R, W>(p, lda, depth, u, h, column);
        h += R;
    }
    while h < p.rows / 2 {
        tile::<V, 1, W>(p, lda, depth, u, h, column);
        h += 1;
    }
}

#[inline(always)]
unsafe fn tile<V: Vector, const R: usize, const W: usize>(
    p: &mut Product<V::Scalar>,
    lda: usize,
    depth: usize,
    u: *const V::Scalar,
    h: usize,
    column: usize,
) {
    let (a, form) = (p.a.as_ptr().add(h * lda), p.rows / 2 * lda);
    let block = depth * W * V::LANES;
    let zero = [[V::ZERO; W]; R];
    let (mut first, mut second) = (zero, zero);
    accumulate::<V, R, W>(&mut first, a.add(form), lda, u.add(block), depth);
    accumulate::<V, R, W>(&mut second, a.add(2 * form), lda, u.add(2 * block), depth);
    for r in 0..R {
        for w in 0..W {
            let (m1, m2) = (first[r][w], second[r][w]);
            first[r][w] = m1 + m2;
            second[r][w] = m1 - m2;
        }
    }
    accumulate::<V, R, W>(&mut first, a, lda, u, depth);
    accumulate::<V, R, W>(&mut second, a.add(3 * form), lda, u.add(3 * block), depth);
    let at = 2 * h * p.columns + column;
    close::<V, R, W>(p, first, at, 2 * p.columns, column);
    close::<V, R, W>(p, second, at + p.columns, 2 * p.columns, column);
}

/// As `Kernels::spread`.
#[inline(always)]
pub unsafe fn spread<V: Vector>(a: &[V::Scalar], out: &mut [V::Scalar], columns: usize) {
    let form = out.len() / 4;
    for h in 0..form / columns {
        let (from, to) = (a.as_ptr().add(2 * h * columns), out.as_mut_ptr().add(h * columns));
        for c in (0..columns).step_by(V::LANES) {
            let (a0, a1) = (V::load(from.add(c)), V::load(from.add(columns + c)));
            let (a2, a3) = (V::load(from.add(2 * columns + c)), V::load(from.add(3 * columns + c)));
            (a0 - a2).store(to.add(c));
            (a1 + a2).store(to.add(form + c));
            (a2 - a1).store(to.add(2 * form + c));
            (a1 - a3).store(to.add(3 * form + c));
        }
    }
}

/// As `Kernels::fold`.
#[inline(always)]
pub unsafe fn fold<V: Vector>(a: &[V::Scalar], out: &mut [V::Scalar], columns: usize) {
    let form = out.len() / 4;
    for h in 0..form / columns {
        let (from, to) = (a.as_ptr().add(2 * h * columns), out.as_mut_ptr().add(h * columns));
        for c in (0..columns).step_by(V::LANES) {
            let (a0, a1) = (V::load(from.add(c)), V::load(from.add(columns + c)));
            a0.store(to.add(c));
            (a0 + a1).store(to.add(form + c));
            (a0 - a1).store(to.add(2 * form + c));
            a1.store(to.add(3 * form + c));
        }
    }
}
