//! Tsit5's coefficients, and its sums over stages with the number of terms known to the compiler: written as loops
//! they took as long as half the forces.

use super::super::system::Unit;
use super::super::vector::Vector;

/// What belongs to each of the six stages that a step evaluates.
pub type Stages<V> = [Vec<Unit<V>>; 6];

/// a_ij of the seven stages; the last row is also the weights b.
pub const A: [[f64; 6]; 7] = [
    [0.0; 6],
    [0.161, 0.0, 0.0, 0.0, 0.0, 0.0],
    [-0.008480655492356989, 0.335480655492357, 0.0, 0.0, 0.0, 0.0],
    [2.8971530571054935, -6.359448489975075, 4.3622954328695815, 0.0, 0.0, 0.0],
    [5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525, 0.0, 0.0],
    [5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401, -0.028269050394068383, 0.0],
    [0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742, -3.290069515436081, 2.324710524099774],
];
/// Clock of the stages.
pub const C: [f64; 7] = [0.0, 0.161, 0.327, 0.9, 0.9800255409045097, 1.0, 1.0];
/// b − b̂.
pub const E: [f64; 7] = [
    -0.001780011052225777,
    -0.0008164344596567469,
    0.007880878010261995,
    -0.1447110071732629,
    0.5823571654525552,
    -0.45808210592918697,
    0.015151515151515152,
];

/// ā = a·a; row i of stage i.
const fn squared() -> [[f64; 6]; 7] {
    let mut s = [[0.0; 6]; 7];
    let mut i = 0;
    while i < 7 {
        let mut m = 0;
        while m < 6 {
            let mut j = 0;
            while j < i {
                s[i][m] += A[i][j] * A[j][m];
                j += 1;
            }
            m += 1;
        }
        i += 1;
    }
    s
}
/// ā.
pub const A2: [[f64; 6]; 7] = squared();

/// Σ_j e_j a_jm: the weights of the displacement's error.
const fn error_squared() -> [f64; 7] {
    let mut s = [0.0; 7];
    let mut m = 0;
    while m < 6 {
        let mut j = 0;
        while j < 7 {
            s[m] += E[j] * A[j][m];
            j += 1;
        }
        m += 1;
    }
    s
}
/// Weights of the displacement's error.
pub const E2: [f64; 7] = error_squared();

/// State of stage i = 1…6 (the last: the new state) from the accelerations of those before.
#[inline(always)]
pub fn stage<V: Vector>(
    i: usize,
    h: V,
    x: &[Unit<V>],
    v: &[Unit<V>],
    a: &[Vec<Unit<V>>],
    xs: &mut [Unit<V>],
    vs: &mut [Unit<V>],
) {
    match i {
        1 => nth_stage::<V, 1>(h, x, v, a, xs, vs),
        2 => nth_stage::<V, 2>(h, x, v, a, xs, vs),
        3 => nth_stage::<V, 3>(h, x, v, a, xs, vs),
        4 => nth_stage::<V, 4>(h, x, v, a, xs, vs),
        5 => nth_stage::<V, 5>(h, x, v, a, xs, vs),
        _ => nth_stage::<V, 6>(h, x, v, a, xs, vs),
    }
}

#[inline(always)]
fn nth_stage<V: Vector, const I: usize>(
    h: V,
    x: &[Unit<V>],
    v: &[Unit<V>],
    a: &[Vec<Unit<V>>],
    xs: &mut [Unit<V>],
    vs: &mut [Unit<V>],
) {
    let (xs, vs) = (xs.as_flattened_mut(), vs.as_flattened_mut());
    let n = xs.len();
    let (x, v, vs) = (&x.as_flattened()[..n], &v.as_flattened()[..n], &mut vs[..n]);
    let a: [&[V]; I] = std::array::from_fn(|j| &a[j].as_flattened()[..n]);
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

/// Transpose of a step in the accelerations of stage i = 0…5, given what later stages pass on.
#[inline(always)]
pub fn stage_vjp<V: Vector>(
    i: usize,
    h: V,
    bar: (&[Unit<V>], &[Unit<V>]),
    later: (&Stages<V>, &Stages<V>),
    bar_a: &mut [Unit<V>],
) {
    match i {
        0 => nth_stage_vjp::<V, 0>(h, bar, later, bar_a),
        1 => nth_stage_vjp::<V, 1>(h, bar, later, bar_a),
        2 => nth_stage_vjp::<V, 2>(h, bar, later, bar_a),
        3 => nth_stage_vjp::<V, 3>(h, bar, later, bar_a),
        4 => nth_stage_vjp::<V, 4>(h, bar, later, bar_a),
        _ => nth_stage_vjp::<V, 5>(h, bar, later, bar_a),
    }
}

#[inline(always)]
fn nth_stage_vjp<V: Vector, const I: usize>(
    h: V,
    (bar_x, bar_v): (&[Unit<V>], &[Unit<V>]),
    (to_x, to_v): (&Stages<V>, &Stages<V>),
    bar_a: &mut [Unit<V>],
) {
    let bar_a = bar_a.as_flattened_mut();
    let n = bar_a.len();
    let (bar_x, bar_v) = (&bar_x.as_flattened()[..n], &bar_v.as_flattened()[..n]);
    let to_x: [&[V]; 6] = std::array::from_fn(|j| &to_x[j].as_flattened()[..n]);
    let to_v: [&[V]; 6] = std::array::from_fn(|j| &to_v[j].as_flattened()[..n]);
    let h2 = h * h;
    for k in 0..n {
        let (mut first, mut second) = (V::splat(A[6][I]) * bar_v[k], V::splat(A2[6][I]) * bar_x[k]);
        for j in I + 1..6 {
            first = V::splat(A[j][I]).mul_add(to_v[j][k], first);
            second = V::splat(A2[j][I]).mul_add(to_x[j][k], second);
        }
        bar_a[k] = h2.mul_add(second, h * first);
    }
}

/// Passes a step's cotangents from its end to its beginning.
#[inline(always)]
pub fn step_vjp<V: Vector>(
    h: V,
    bar_x: &mut [Unit<V>],
    bar_v: &mut [Unit<V>],
    (to_x, to_v): (&Stages<V>, &Stages<V>),
) {
    let (bar_x, bar_v) = (bar_x.as_flattened_mut(), bar_v.as_flattened_mut());
    let n = bar_x.len();
    let bar_v = &mut bar_v[..n];
    let to_x: [&[V]; 6] = std::array::from_fn(|j| &to_x[j].as_flattened()[..n]);
    let to_v: [&[V]; 6] = std::array::from_fn(|j| &to_v[j].as_flattened()[..n]);
    for k in 0..n {
        let (mut x, mut v) = (bar_x[k], h.mul_add(bar_x[k], bar_v[k]));
        for i in 0..6 {
            v = (h * V::splat(C[i])).mul_add(to_x[i][k], v) + to_v[i][k];
            x = x + to_x[i][k];
        }
        (bar_x[k], bar_v[k]) = (x, v);
    }
}
