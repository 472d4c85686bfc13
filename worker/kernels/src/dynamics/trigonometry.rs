//! Trigonometry in lanes, by polynomials for typical angles. A lane outside their range calls the standard library, so
//! the result of a lane never depends on other lanes.

use crate::lanes::{Scalar, Vector};
use std::f64::consts::TAU;

/// |angle| up to which `sin_cos1` uses polynomials: the coefficients of Sun's fdlibm (k_sin.c, k_cos.c), with errors below 2⁻⁵⁸.
const TURN_LIMIT: f64 = std::f64::consts::FRAC_PI_4;
/// |tan(angle/2)| up to which `angle` uses a polynomial (29°).
const HALF_TANGENT_LIMIT: f64 = 0.25;
/// |mean| up to which such an angle minus `mean` lies in (−π, π].
const MEAN_LIMIT: f64 = 2.5;

/// Horner's scheme, highest power first. In f32, omits the first `spare` coefficients, which are below rounding.
#[inline(always)]
fn horner<V: Vector, const N: usize>(z: V, coefficients: [f64; N], spare: usize) -> V {
    let first = if V::SINGLE { spare } else { 0 };
    let mut p = V::splat(coefficients[first]);
    for k in first + 1..N {
        p = p.mul_add(z, V::splat(coefficients[k]));
    }
    p
}

/// [sin x, cos x − 1].
#[inline(always)]
pub fn sin_cos1<V: Vector>(x: V) -> [V; 2] {
    let z = x * x;
    let sin = horner(
        z,
        [
            1.589_690_995_211_55e-10,
            -2.505_076_025_340_686_3e-8,
            2.755_731_370_707_006_8e-6,
            -0.000_198_412_698_298_579_5,
            0.008_333_333_333_322_49,
            -0.166_666_666_666_666_32,
        ],
        2,
    );
    let cos = horner(
        z,
        [
            -1.135_964_755_778_819_5e-11,
            2.087_572_321_298_175e-9,
            -2.755_731_435_139_066_3e-7,
            2.480_158_728_947_673e-5,
            -0.001_388_888_888_887_411,
            0.041_666_666_666_666_6,
            -0.5,
        ],
        2,
    );
    let near = [(sin * z).mul_add(x, x), cos * z];
    if x.all_within(TURN_LIMIT) {
        return near;
    }
    let mut all = near;
    far_sin_cos1(x, &mut all);
    all
}

#[cold]
#[inline(never)]
fn far_sin_cos1<V: Vector>(x: V, [sin, cos1]: &mut [V; 2]) {
    for i in 0..V::LANES {
        let x = x.lane(i);
        // true for NaN, too, which then reaches the standard library
        if x.abs() <= limit::<V>(TURN_LIMIT) {
            continue;
        }
        sin.set_lane(i, x.sin());
        cos1.set_lane(i, -2.0 * (0.5 * x).sin().powi(2));
    }
}

/// `limit` as rounded in the comparison of lanes.
fn limit<V: Vector>(limit: f64) -> f64 {
    V::Scalar::from_f64(limit).to_f64()
}

/// The angle of the vector (x, y) minus `mean`, in (−π, π], given the tangent t = y/(|(x, y)| + x) of half the angle.
#[inline(always)]
pub fn angle<V: Vector>(t: V, [x, y]: [V; 2], mean: V) -> V {
    let near = half_arctangent_series(t * t).mul_add(t, -mean);
    if t.all_within(HALF_TANGENT_LIMIT) && mean.all_within(MEAN_LIMIT) {
        near
    } else {
        let mut all = near;
        far_angle([x, y], t, mean, &mut all);
        all
    }
}

/// 2 atan(t)/t with z = t² ≤ 1/16, interpolated at nine Chebyshev nodes; largest error 5e-18.
///
/// Summed in pairs: this sum is the longest chain of dependent operations of a ligament, and Horner's scheme would
/// double it.
#[inline(always)]
fn half_arctangent_series<V: Vector>(z: V) -> V {
    const C: [f64; 9] = [
        2.0,
        -0.666_666_666_666_643_1,
        0.399_999_999_989_902_16,
        -0.285_714_284_049_933_7,
        0.222_222_084_517_416_9,
        -0.181_811_761_925_484_95,
        0.153_669_423_174_523_42,
        -0.130_468_852_765_130_82,
        0.091_978_112_630_262_11,
    ];
    let z2 = z * z;
    if V::SINGLE {
        // further terms are below rounding
        let high = z2.mul_add(line(z, [C[4], C[5]]), line(z, [C[2], C[3]]));
        return z2.mul_add(high, line(z, [C[0], C[1]]));
    }
    let z4 = z2 * z2;
    let high = z4.mul_add(V::splat(C[8]), z2.mul_add(line(z, [C[6], C[7]]), line(z, [C[4], C[5]])));
    z4.mul_add(high, z2.mul_add(line(z, [C[2], C[3]]), line(z, [C[0], C[1]])))
}

/// c₀ + c₁ z.
#[inline(always)]
fn line<V: Vector>(z: V, c: [f64; 2]) -> V {
    V::splat(c[1]).mul_add(z, V::splat(c[0]))
}

#[cold]
#[inline(never)]
fn far_angle<V: Vector>([x, y]: [V; 2], t: V, mean: V, angle: &mut V) {
    for i in 0..V::LANES {
        if t.lane(i).abs() <= HALF_TANGENT_LIMIT && mean.lane(i).abs() <= MEAN_LIMIT {
            continue;
        }
        let gamma = y.lane(i).atan2(x.lane(i)) - mean.lane(i);
        angle.set_lane(i, gamma - TAU * (gamma / TAU).round());
    }
}

#[path = "trigonometry/tests.rs"]
#[cfg(test)]
mod tests;
