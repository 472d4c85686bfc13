//! Trigonometry in lanes, by polynomials on the range that bodies move in; a lane outside it takes the standard
//! library's function, so that a result never depends on the other lanes.

use super::vector::{LANES, Vector};

/// |angle| up to which `sin_cos` is polynomial, with the coefficients of Sun's fdlibm (k_sin.c, k_cos.c): below 2⁻⁵⁸.
const TURN_LIMIT: f64 = std::f64::consts::FRAC_PI_4;
/// |tan(angle/2)| up to which `angle` is polynomial (29°).
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
            1.589_690_995_211_55e-10,
            -2.505_076_025_340_686_3e-8,
            2.755_731_370_707_006_8e-6,
            -0.000_198_412_698_298_579_5,
            0.008_333_333_333_322_49,
            -0.166_666_666_666_666_32,
        ],
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

/// The angle of the vector (x, y), in (−π, π], given the tangent t = y/(|(x, y)| + x) of half of it.
#[inline(always)]
pub fn angle<V: Vector>(t: V, [x, y]: [V; 2]) -> V {
    let near = half_arctangent_series(t * t) * t;
    if t.all_within(HALF_TANGENT_LIMIT) {
        near
    } else {
        far_angle(y.array(), x.array(), t.array(), near.array())
    }
}

/// 2 atan(t)/t, z = t² ≤ 1/16: the polynomial that is exact at the nine Chebyshev nodes, off by 5e-18 elsewhere.
///
/// Summed by pairs: a ligament's longest chain of dependent operations is this sum, and Horner's would be twice as long.
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
    let pair = |k: usize| V::splat(C[k + 1]).mul_add(z, V::splat(C[k]));
    let z2 = z * z;
    let z4 = z2 * z2;
    let high = z4.mul_add(V::splat(C[8]), z2.mul_add(pair(6), pair(4)));
    z4.mul_add(high, z2.mul_add(pair(2), pair(0)))
}

#[cold]
#[inline(never)]
fn far_angle<V: Vector>(y: [f64; LANES], x: [f64; LANES], t: [f64; LANES], near: [f64; LANES]) -> V {
    V::new(std::array::from_fn(|i| if t[i].abs() <= HALF_TANGENT_LIMIT { near[i] } else { y[i].atan2(x[i]) }))
}
