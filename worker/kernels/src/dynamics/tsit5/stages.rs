//! Coefficients of Tsit5, and sums over stages whose number of terms is a constant, so that the compiler unrolls them.

use super::super::Tolerance;
use super::super::system::{ForceCotangent, Unit};
use crate::lanes::Vector;
use std::ops::Range;

/// One entry for each of the six stages that a step evaluates.
pub type Stages<V> = [Vec<Unit<V>>; 6];

/// Coefficients a_ij of the seven stages; the last row also contains the weights b.
pub const A: [[f64; 6]; 7] = [
    [0.0; 6],
    [0.161, 0.0, 0.0, 0.0, 0.0, 0.0],
    [-0.008480655492356989, 0.335480655492357, 0.0, 0.0, 0.0, 0.0],
    [2.8971530571054935, -6.359448489975075, 4.3622954328695815, 0.0, 0.0, 0.0],
    [5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525, 0.0, 0.0],
    [5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401, -0.028269050394068383, 0.0],
    [0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742, -3.290069515436081, 2.324710524099774],
];
/// Times c_i of the stages.
pub const C: [f64; 7] = [0.0, 0.161, 0.327, 0.9, 0.9800255409045097, 1.0, 1.0];
/// Weights b − b̂ of the velocity's error.
const E: [f64; 7] = [
    -0.001780011052225777,
    -0.0008164344596567469,
    0.007880878010261995,
    -0.1447110071732629,
    0.5823571654525552,
    -0.45808210592918697,
    0.015151515151515152,
];

/// Σ_j row_j a_jm for each m.
const fn by_a(row: &[f64]) -> [f64; 6] {
    let mut sums = [0.0; 6];
    let mut m = 0;
    while m < 6 {
        let mut j = 0;
        while j < row.len() {
            sums[m] += row[j] * A[j][m];
            j += 1;
        }
        m += 1;
    }
    sums
}
/// ā = a·a.
pub const A2: [[f64; 6]; 7] =
    [by_a(&A[0]), by_a(&A[1]), by_a(&A[2]), by_a(&A[3]), by_a(&A[4]), by_a(&A[5]), by_a(&A[6])];
/// Weights of the displacement's error.
const E2: [f64; 6] = by_a(&E);

/// State of stage i = 1…6 (6: the new state) of the units `within`, from the accelerations of the preceding stages.
#[inline(always)]
pub fn stage<V: Vector>(
    i: usize,
    h: V,
    within: &Range<usize>,
    from: (&[Unit<V>], &[Unit<V>]),
    a: &[Vec<Unit<V>>],
    to: (&mut [Unit<V>], &mut [Unit<V>]),
) {
    match i {
        1 => nth_stage::<V, 1>(h, within, from, a, to),
        2 => nth_stage::<V, 2>(h, within, from, a, to),
        3 => nth_stage::<V, 3>(h, within, from, a, to),
        4 => nth_stage::<V, 4>(h, within, from, a, to),
        5 => nth_stage::<V, 5>(h, within, from, a, to),
        _ => nth_stage::<V, 6>(h, within, from, a, to),
    }
}

/// The coordinates of the units `within`.
#[inline(always)]
fn of<'a, V>(y: &'a [Unit<V>], within: &Range<usize>) -> &'a [V] {
    y[within.clone()].as_flattened()
}

#[inline(always)]
fn nth_stage<V: Vector, const I: usize>(
    h: V,
    within: &Range<usize>,
    (x, v): (&[Unit<V>], &[Unit<V>]),
    a: &[Vec<Unit<V>>],
    (xs, vs): (&mut [Unit<V>], &mut [Unit<V>]),
) {
    let xs = xs[within.clone()].as_flattened_mut();
    let n = xs.len();
    let vs = &mut vs[within.clone()].as_flattened_mut()[..n];
    let (x, v) = (&of(x, within)[..n], &of(v, within)[..n]);
    let a: [&[V]; I] = std::array::from_fn(|j| &of(&a[j], within)[..n]);
    let (h2, hc) = (h * h, h * V::splat(C[I]));
    for k in 0..n {
        let (mut first, mut second) = (V::splat(0.0), V::splat(0.0));
        for j in 0..I {
            first = V::splat(A[I][j]).mul_add(a[j][k], first);
            if j + 1 < I {
                second = V::splat(A2[I][j]).mul_add(a[j][k], second);
            }
        }
        xs[k] = h2.mul_add(second, hc.mul_add(v[k], x[k]));
        vs[k] = h.mul_add(first, v[k]);
    }
}

/// The new state, as `stage(6)`, and the part of the error estimate that the first six accelerations determine.
///
/// Errors are relative to the tolerance. Returns the sum of squares of the displacements' errors. The error of a velocity
/// is p + q a with the new acceleration a; p and q overwrite the accelerations of stages 1 and 2, which are no longer
/// needed.
#[inline(always)]
pub fn finish_step<V: Vector>(
    h: V,
    tolerance: Tolerance,
    within: &Range<usize>,
    (x, v): (&[Unit<V>], &[Unit<V>]),
    a: &mut [Vec<Unit<V>>; 7],
    (xs, vs): (&mut [Unit<V>], &mut [Unit<V>]),
) -> V {
    let xs = xs[within.clone()].as_flattened_mut();
    let n = xs.len();
    let vs = &mut vs[within.clone()].as_flattened_mut()[..n];
    let (x, v) = (&of(x, within)[..n], &of(v, within)[..n]);
    let [a0, a1, a2, a3, a4, a5, _] = a;
    let (p, q) =
        (&mut a1[within.clone()].as_flattened_mut()[..n], &mut a2[within.clone()].as_flattened_mut()[..n]);
    let (a0, a3, a4, a5) =
        (&of(a0, within)[..n], &of(a3, within)[..n], &of(a4, within)[..n], &of(a5, within)[..n]);
    let (zero, one) = (V::splat(0.0), V::splat(1.0));
    let (relative, absolute) = (V::splat(tolerance.relative), V::splat(tolerance.absolute));
    let (h2, he) = (h * h, h * V::splat(E[6]));
    let mut square = zero;
    for k in 0..n {
        let a = [a0[k], p[k], q[k], a3[k], a4[k], a5[k]];
        let (mut first, mut second, mut ev, mut ex) = (zero, zero, zero, zero);
        for j in 0..6 {
            first = V::splat(A[6][j]).mul_add(a[j], first);
            ev = V::splat(E[j]).mul_add(a[j], ev);
            ex = V::splat(E2[j]).mul_add(a[j], ex);
            if j < 5 {
                second = V::splat(A2[6][j]).mul_add(a[j], second);
            }
        }
        xs[k] = h2.mul_add(second, h.mul_add(v[k], x[k]));
        vs[k] = h.mul_add(first, v[k]);
        let sx = x[k].abs().max(xs[k].abs()).mul_add(relative, absolute);
        let sv = v[k].abs().max(vs[k].abs()).mul_add(relative, absolute);
        // one division for both quotients
        let inverse = one.over(sx * sv);
        let (ix, iv) = (sv * inverse, sx * inverse);
        let rx = (h2 * ex) * ix;
        square = rx.mul_add(rx, square);
        (p[k], q[k]) = ((h * ev) * iv, he * iv);
    }
    square
}

/// Adds the squares of the velocities' errors to `square`.
#[inline(always)]
pub fn total_error<V: Vector>(
    mut square: V,
    within: &Range<usize>,
    [_, p, q, .., end]: &[Vec<Unit<V>>; 7],
) -> V {
    let (p, q, end) = (of(p, within), of(q, within), of(end, within));
    for ((p, q), a) in p.iter().zip(q).zip(end) {
        let r = q.mul_add(*a, *p);
        square = r.mul_add(r, square);
    }
    square
}

/// Adjoint of a step in the accelerations a of stage i = 0…5: overwrites `w` with M⁻¹ times their cotangent and subtracts
/// w a from the cotangent of (m, m, J).
///
/// `later` contains −∂²U w and w of the later stages: the cotangents of their positions are −∂²U w, those of their
/// velocities −C w.
#[inline(always)]
pub fn stage_vjp<V: Vector>(
    i: usize,
    h: V,
    within: &Range<usize>,
    bar: (&[Unit<V>], &[Unit<V>]),
    later: (&Stages<V>, &Stages<V>),
    by: ForceCotangent<'_, V>,
    a: &[Unit<V>],
    w: &mut [Unit<V>],
) {
    match i {
        0 => nth_stage_vjp::<V, 0>(h, within, bar, later, by, a, w),
        1 => nth_stage_vjp::<V, 1>(h, within, bar, later, by, a, w),
        2 => nth_stage_vjp::<V, 2>(h, within, bar, later, by, a, w),
        3 => nth_stage_vjp::<V, 3>(h, within, bar, later, by, a, w),
        4 => nth_stage_vjp::<V, 4>(h, within, bar, later, by, a, w),
        _ => nth_stage_vjp::<V, 5>(h, within, bar, later, by, a, w),
    }
}

#[inline(always)]
fn nth_stage_vjp<'a, V: Vector, const I: usize>(
    h: V,
    within: &Range<usize>,
    (bar_x, bar_v): (&'a [Unit<V>], &'a [Unit<V>]),
    (curved, weights): (&'a Stages<V>, &'a Stages<V>),
    by: ForceCotangent<'_, V>,
    a: &'a [Unit<V>],
    w: &mut [Unit<V>],
) {
    let n = within.len();
    let cut = |y: &'a [Unit<V>]| -> &'a [Unit<V>] { &y[within.clone()][..n] };
    let (bar_x, bar_v, a) = (cut(bar_x), cut(bar_v), cut(a));
    let curved: [&[Unit<V>]; 6] = std::array::from_fn(|j| cut(&curved[j]));
    let weights: [&[Unit<V>]; 6] = std::array::from_fn(|j| cut(&weights[j]));
    let (w, mass) = (&mut w[within.clone()][..n], &mut by.mass[within.clone()][..n]);
    let inverse = &by.inverse_mass[within.clone()][..n];
    let h2 = h * h;
    for u in 0..n {
        for d in 0..3 {
            let (mut first, mut second) = (V::splat(0.0), V::splat(A2[6][I]) * bar_x[u][d]);
            for j in I + 1..6 {
                first = V::splat(A[j][I]).mul_add(weights[j][u][d], first);
                second = V::splat(A2[j][I]).mul_add(curved[j][u][d], second);
            }
            let first = V::splat(by.damping[d]).mul_sub_from(first, V::splat(A[6][I]) * bar_v[u][d]);
            let bar = h2.mul_add(second, h * first);
            w[u][d] = V::from_scalar(inverse[u][d]) * bar;
            mass[u][d] = w[u][d].mul_sub_from(a[u][d], mass[u][d]);
        }
    }
}

/// Propagates cotangents from the end to the start of a step.
#[inline(always)]
pub fn step_vjp<'a, V: Vector>(
    h: V,
    within: &Range<usize>,
    (bar_x, bar_v): (&mut [Unit<V>], &mut [Unit<V>]),
    (curved, weights): (&'a Stages<V>, &'a Stages<V>),
    damping: [f64; 3],
) {
    let n = within.len();
    let cut = |y: &'a [Unit<V>]| -> &'a [Unit<V>] { &y[within.clone()][..n] };
    let curved: [&[Unit<V>]; 6] = std::array::from_fn(|j| cut(&curved[j]));
    let weights: [&[Unit<V>]; 6] = std::array::from_fn(|j| cut(&weights[j]));
    let (bar_x, bar_v) = (&mut bar_x[within.clone()][..n], &mut bar_v[within.clone()][..n]);
    for u in 0..n {
        for d in 0..3 {
            let (mut x, mut v) = (bar_x[u][d], h.mul_add(bar_x[u][d], bar_v[u][d]));
            let mut damped = V::splat(0.0);
            for i in 0..6 {
                v = (h * V::splat(C[i])).mul_add(curved[i][u][d], v);
                x = x + curved[i][u][d];
                damped = damped + weights[i][u][d];
            }
            (bar_x[u][d], bar_v[u][d]) = (x, V::splat(damping[d]).mul_sub_from(damped, v));
        }
    }
}
