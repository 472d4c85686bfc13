//! A k = 3 convolution in pairs of rows by Winograd's F(2, 3): four products of 64 × 64 where six would be direct.
//!
//! ```text
//! U = (g₀, (g₀+g₁+g₂)/2, (g₀−g₁+g₂)/2, g₂)     V = (a₀−a₂, a₁+a₂, a₂−a₁, a₁−a₃) of the rows 2h … 2h+3
//! Mᵢ = Vᵢ Uᵢ      c₀ = M₀ + M₁ + M₂            c₁ = M₁ − M₂ − M₃
//! ∂g: Qᵢ = Vᵢᵀ Eᵢ, E = (e₀, e₀+e₁, e₀−e₁, −e₁): g̅₀ = Q₀ + (Q₁+Q₂)/2, g̅₁ = (Q₁−Q₂)/2, g̅₂ = (Q₁+Q₂)/2 + Q₃
//! ```
//! The four forms lie one after the other, rows 64 long: rows further apart would share too few sets of L1.
//! Lavin and Gray, arXiv:1509.09308, in one dimension. U₃ is stored negated.

use super::kernels::{Product, accumulate, close};
use super::real::Real;
use super::vector::Vector;

/// Entry of the i-th form of the weights, of which `g(k)` is the same entry.
#[inline(always)]
pub fn form<F: Real>(i: usize, g: impl Fn(usize) -> F) -> F {
    let half = F::from_f64(0.5);
    match i {
        0 => g(0),
        1 => half * (g(0) + g(1) + g(2)),
        2 => half * (g(0) - g(1) + g(2)),
        _ => F::ZERO - g(2),
    }
}

/// Adds the gradient (3, n) that belongs to Q₀, Q₁, Q₂, −Q₃, each n long.
pub fn add_gradient<F: Real>(q: &[F], gradient: &mut [F]) {
    let n = gradient.len() / 3;
    let half = F::from_f64(0.5);
    for j in 0..n {
        let (even, odd) = (half * (q[n + j] + q[2 * n + j]), half * (q[n + j] - q[2 * n + j]));
        gradient[j] += q[j] + even;
        gradient[n + j] += odd;
        gradient[2 * n + j] += even - q[3 * n + j];
    }
}

/// # Safety
/// As `Kernels::pairs` checks it; the machine has the vector's instruction set.
#[inline(always)]
pub unsafe fn pairs<V: Vector, const R: usize>(p: &mut Product<V::Scalar>) {
    // SAFETY: the caller's promise; a known depth spares the row addresses their registers.
    unsafe {
        match p.depth {
            64 => pairs_of_depth::<V, R>(p, 64),
            depth => pairs_of_depth::<V, R>(p, depth),
        }
    }
}

#[inline(always)]
unsafe fn pairs_of_depth<V: Vector, const R: usize>(p: &mut Product<V::Scalar>, depth: usize) {
    // SAFETY: the caller's promise.
    unsafe {
        for column in (0..p.columns).step_by(2 * V::LANES) {
            let u = p.panels.as_ptr().add(column * 4 * depth);
            let mut h = 0;
            while h + R <= p.rows / 2 {
                tile::<V, R>(p, depth, u, h, column);
                h += R;
            }
            while h < p.rows / 2 {
                tile::<V, 1>(p, depth, u, h, column);
                h += 1;
            }
        }
    }
}

#[inline(always)]
unsafe fn tile<V: Vector, const R: usize>(
    p: &mut Product<V::Scalar>,
    depth: usize,
    u: *const V::Scalar,
    h: usize,
    column: usize,
) {
    // SAFETY: the caller's promise.
    unsafe {
        let (a, form) = (p.a.as_ptr().add(h * depth), p.rows / 2 * depth);
        let block = depth * 2 * V::LANES;
        let zero = [[V::splat(V::Scalar::ZERO); 2]; R];
        let (mut first, mut second) = (zero, zero);
        accumulate::<V, R>(&mut first, a.add(form), depth, u.add(block), depth);
        accumulate::<V, R>(&mut second, a.add(2 * form), depth, u.add(2 * block), depth);
        for r in 0..R {
            let (m1, m2) = (first[r], second[r]);
            first[r] = [m1[0].plus(m2[0]), m1[1].plus(m2[1])];
            second[r] = [m1[0].minus(m2[0]), m1[1].minus(m2[1])];
        }
        accumulate::<V, R>(&mut first, a, depth, u, depth);
        accumulate::<V, R>(&mut second, a.add(3 * form), depth, u.add(3 * block), depth);
        let at = 2 * h * p.columns + column;
        close::<V, R>(p, first, at, 2 * p.columns, column);
        close::<V, R>(p, second, at + p.columns, 2 * p.columns, column);
    }
}

/// # Safety
/// As `Kernels::spread` checks it; the machine has the vector's instruction set.
#[inline(always)]
pub unsafe fn spread<V: Vector>(a: &[V::Scalar], out: &mut [V::Scalar], columns: usize) {
    // SAFETY: the caller's promise.
    unsafe {
        let form = out.len() / 4;
        for h in 0..form / columns {
            let (from, to) = (a.as_ptr().add(2 * h * columns), out.as_mut_ptr().add(h * columns));
            for c in (0..columns).step_by(V::LANES) {
                let (a0, a1) = (V::load(from.add(c)), V::load(from.add(columns + c)));
                let (a2, a3) = (V::load(from.add(2 * columns + c)), V::load(from.add(3 * columns + c)));
                a0.minus(a2).store(to.add(c));
                a1.plus(a2).store(to.add(form + c));
                a2.minus(a1).store(to.add(2 * form + c));
                a1.minus(a3).store(to.add(3 * form + c));
            }
        }
    }
}

/// # Safety
/// As `Kernels::fold` checks it; the machine has the vector's instruction set.
#[inline(always)]
pub unsafe fn fold<V: Vector>(a: &[V::Scalar], out: &mut [V::Scalar], columns: usize) {
    // SAFETY: the caller's promise.
    unsafe {
        let form = out.len() / 4;
        for h in 0..form / columns {
            let (from, to) = (a.as_ptr().add(2 * h * columns), out.as_mut_ptr().add(h * columns));
            for c in (0..columns).step_by(V::LANES) {
                let (a0, a1) = (V::load(from.add(c)), V::load(from.add(columns + c)));
                a0.store(to.add(c));
                a0.plus(a1).store(to.add(form + c));
                a0.minus(a1).store(to.add(2 * form + c));
                a1.store(to.add(3 * form + c));
            }
        }
    }
}
