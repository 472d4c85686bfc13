//! The numbers that the ligament kernel computes with: lanes, or dual numbers of lanes.
//!
//! One kernel serves both. With duals x + ε w it yields, beside the gradient of the energy at x, the product of its
//! Hessian with w. Trigonometry is by polynomials on the range that bodies move in; a lane outside it takes the
//! standard library's function, so that a result never depends on the other lanes.

use super::vector::{LANES, Vector};
use std::ops::{Add, Mul, Sub};

/// A number of the kernel, over lanes `V`.
pub trait Real<V: Vector>: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// Unit i of a state and of a direction.
    fn load(value: &[[V; 3]], direction: &[[V; 3]], i: usize) -> [Self; 3];
    /// Adds to unit i.
    fn scatter(numbers: [Self; 3], value: &mut [[V; 3]], direction: &mut [[V; 3]], i: usize);
    /// The value.
    fn value(self) -> V;
    /// The derivative along the direction; of plain lanes the value.
    fn last(self) -> V;
    /// A number with this value and, where there is one, this derivative.
    fn from_parts(value: V, derivative: impl FnOnce() -> V) -> Self;
    /// A constant.
    fn constant(x: f64) -> Self;
    /// c·self.
    fn scale(self, c: f64) -> Self;
    /// self·a + b.
    fn mul_add(self, a: Self, b: Self) -> Self;
    /// b − self·a.
    fn mul_sub_from(self, a: Self, b: Self) -> Self;
    /// c·self + b.
    fn scale_add(self, c: f64, b: Self) -> Self;
    /// 1/√self.
    fn rsqrt(self) -> Self;
}

/// |angle| up to which `sin_cos` is polynomial; the Taylor remainders are below 5e-17.
const TURN_LIMIT: f64 = std::f64::consts::FRAC_PI_4;
/// |tan(angle/2)| up to which `angle` is polynomial (29°); remainder below 1e-17.
const HALF_TANGENT_LIMIT: f64 = 0.25;

#[inline(always)]
fn horner<V: Vector, const N: usize>(z: V, coefficients: [f64; N]) -> V {
    let mut p = V::splat(coefficients[0]);
    for k in 1..N {
        p = p.mul_add(z, V::splat(coefficients[k]));
    }
    p
}

/// (sin x, cos x).
#[inline(always)]
pub fn sin_cos<V: Vector>(x: V) -> (V, V) {
    let z = x * x;
    let sin = horner(
        z,
        [
            -1.0 / 1_307_674_368_000.0,
            1.0 / 6_227_020_800.0,
            -1.0 / 39_916_800.0,
            1.0 / 362_880.0,
            -1.0 / 5_040.0,
            1.0 / 120.0,
            -1.0 / 6.0,
        ],
    );
    let cos = horner(
        z,
        [
            1.0 / 20_922_789_888_000.0,
            -1.0 / 87_178_291_200.0,
            1.0 / 479_001_600.0,
            -1.0 / 3_628_800.0,
            1.0 / 40_320.0,
            -1.0 / 720.0,
            1.0 / 24.0,
            -0.5,
            1.0,
        ],
    );
    let near = ((sin * z).mul_add(x, x), cos);
    if x.all_within(TURN_LIMIT) { near } else { far_sin_cos(x.array(), near.0.array(), near.1.array()) }
}

#[cold]
#[inline(never)]
fn far_sin_cos<V: Vector>(x: [f64; LANES], mut sin: [f64; LANES], mut cos: [f64; LANES]) -> (V, V) {
    for i in 0..LANES {
        // A NaN goes this way too.
        if x[i].abs() <= TURN_LIMIT {
            continue;
        }
        (sin[i], cos[i]) = x[i].sin_cos();
    }
    (V::new(sin), V::new(cos))
}

/// The angle of the vector (x, y), in (−π, π], given its length.
#[inline(always)]
pub fn angle<V: Vector>(y: V, x: V, length: V) -> V {
    let t = y.over(length + x);
    let z = t * t;
    let near = half_arctangent_series(z) * t;
    if t.all_within(HALF_TANGENT_LIMIT) {
        near
    } else {
        far_angle(y.array(), x.array(), t.array(), near.array())
    }
}

/// 2 atan(t)/t, z = t², by pairs: a ligament's longest chain of dependent operations is this sum, and Horner's would
/// be three times as long.
#[inline(always)]
fn half_arctangent_series<V: Vector>(z: V) -> V {
    let pair = |k: usize| {
        let term = |k: usize| V::splat(if k.is_multiple_of(2) { 2.0 } else { -2.0 } / (2 * k + 1) as f64);
        term(k + 1).mul_add(z, term(k))
    };
    let z2 = z * z;
    let z4 = z2 * z2;
    let low = z4.mul_add(z2.mul_add(pair(6), pair(4)), z2.mul_add(pair(2), pair(0)));
    let high = z4.mul_add(V::splat(2.0 / 25.0), z2.mul_add(pair(10), pair(8)));
    (z4 * z4).mul_add(high, low)
}

#[cold]
#[inline(never)]
fn far_angle<V: Vector>(y: [f64; LANES], x: [f64; LANES], t: [f64; LANES], near: [f64; LANES]) -> V {
    V::new(std::array::from_fn(|i| if t[i].abs() <= HALF_TANGENT_LIMIT { near[i] } else { y[i].atan2(x[i]) }))
}

impl<V: Vector> Real<V> for V {
    #[inline(always)]
    fn load(value: &[[V; 3]], _: &[[V; 3]], i: usize) -> [Self; 3] {
        value[i]
    }
    #[inline(always)]
    fn scatter(numbers: [Self; 3], value: &mut [[V; 3]], _: &mut [[V; 3]], i: usize) {
        let [x, y, t] = value[i];
        value[i] = [x + numbers[0], y + numbers[1], t + numbers[2]];
    }
    #[inline(always)]
    fn value(self) -> V {
        self
    }
    #[inline(always)]
    fn last(self) -> V {
        self
    }
    #[inline(always)]
    fn from_parts(value: V, _: impl FnOnce() -> V) -> Self {
        value
    }
    #[inline(always)]
    fn constant(x: f64) -> Self {
        V::splat(x)
    }
    #[inline(always)]
    fn scale(self, c: f64) -> Self {
        V::splat(c) * self
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        Vector::mul_add(self, a, b)
    }
    #[inline(always)]
    fn mul_sub_from(self, a: Self, b: Self) -> Self {
        Vector::mul_sub_from(self, a, b)
    }
    #[inline(always)]
    fn scale_add(self, c: f64, b: Self) -> Self {
        Vector::mul_add(V::splat(c), self, b)
    }
    #[inline(always)]
    fn rsqrt(self) -> Self {
        Vector::rsqrt(self)
    }
}

/// value + ε derivative, ε² = 0.
#[derive(Clone, Copy)]
pub struct Dual<V>(V, V);

impl<V: Vector> Add for Dual<V> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self(self.0 + o.0, self.1 + o.1)
    }
}
impl<V: Vector> Sub for Dual<V> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        Self(self.0 - o.0, self.1 - o.1)
    }
}
impl<V: Vector> Mul for Dual<V> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        Self(self.0 * o.0, Vector::mul_add(self.0, o.1, self.1 * o.0))
    }
}

impl<V: Vector> Real<V> for Dual<V> {
    #[inline(always)]
    fn load(value: &[[V; 3]], direction: &[[V; 3]], i: usize) -> [Self; 3] {
        let ([a, b, c], [d, e, f]) = (value[i], direction[i]);
        [Self(a, d), Self(b, e), Self(c, f)]
    }
    #[inline(always)]
    fn scatter(numbers: [Self; 3], value: &mut [[V; 3]], direction: &mut [[V; 3]], i: usize) {
        let [a, b, c] = numbers;
        let ([x, y, t], [dx, dy, dt]) = (value[i], direction[i]);
        value[i] = [x + a.0, y + b.0, t + c.0];
        direction[i] = [dx + a.1, dy + b.1, dt + c.1];
    }
    #[inline(always)]
    fn value(self) -> V {
        self.0
    }
    #[inline(always)]
    fn last(self) -> V {
        self.1
    }
    #[inline(always)]
    fn from_parts(value: V, derivative: impl FnOnce() -> V) -> Self {
        Self(value, derivative())
    }
    #[inline(always)]
    fn constant(x: f64) -> Self {
        Self(V::splat(x), V::splat(0.0))
    }
    #[inline(always)]
    fn scale(self, c: f64) -> Self {
        let c = V::splat(c);
        Self(c * self.0, c * self.1)
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        let derivative = Vector::mul_add(self.1, a.0, b.1);
        Self(Vector::mul_add(self.0, a.0, b.0), Vector::mul_add(self.0, a.1, derivative))
    }
    #[inline(always)]
    fn mul_sub_from(self, a: Self, b: Self) -> Self {
        let derivative = Vector::mul_sub_from(self.1, a.0, b.1);
        Self(Vector::mul_sub_from(self.0, a.0, b.0), Vector::mul_sub_from(self.0, a.1, derivative))
    }
    #[inline(always)]
    fn scale_add(self, c: f64, b: Self) -> Self {
        let c = V::splat(c);
        Self(Vector::mul_add(c, self.0, b.0), Vector::mul_add(c, self.1, b.1))
    }
    #[inline(always)]
    fn rsqrt(self) -> Self {
        let r = Vector::rsqrt(self.0);
        Self(r, V::splat(-0.5) * (r * r) * (r * self.1))
    }
}
