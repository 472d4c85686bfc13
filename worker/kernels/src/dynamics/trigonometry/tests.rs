use super::*;
use crate::lanes::{Base, LANES, SingleBase};

/// Largest errors of `angle` and `sin_cos1` against the standard library, from zero to many rotations, with different
/// ranges per lane.
fn worst<V: Vector>() -> [f64; 2] {
    let mut worst = [0.0f64; 2];
    for k in 0..4000 {
        let of = |l: usize| 1e-3 * f64::from(k) * [1e-3, 0.1, 0.3, 1.0, -1.0, -0.3, 2.9, -2.9][l];
        let rounded = |l: usize| V::Scalar::from_f64(of(l)).to_f64();
        let (delta, mean): ([f64; LANES], [f64; LANES]) =
            (std::array::from_fn(of), std::array::from_fn(|l| rounded((3 * l + 1) % LANES)));
        for (delta, mean) in delta.chunks(V::LANES).zip(mean.chunks(V::LANES)) {
            let [x, y] = [f64::cos, f64::sin]
                .map(|of| V::gather(&delta.iter().map(|d| 2.0 * of(*d)).collect::<Vec<f64>>()));
            let t = y.over(V::splat(2.0) + x);
            let gamma = angle(t, [x, y], V::gather(mean));
            let [s, c1] = sin_cos1(V::gather(mean));
            for (l, (delta, mean)) in delta.iter().zip(mean).enumerate() {
                assert!(gamma.lane(l).abs() <= 3.15, "{k} {l}: {}", gamma.lane(l));
                // the sign of half a rotation is arbitrary
                worst[0] = worst[0].max((0.5 * (gamma.lane(l) - (delta - mean))).sin().abs());
                worst[1] = worst[1].max((s.lane(l) - mean.sin()).abs());
                worst[1] = worst[1].max((c1.lane(l) + 2.0 * (0.5 * mean).sin().powi(2)).abs());
            }
        }
    }
    worst
}

#[test]
fn near_and_far_lanes_are_the_standard_librarys() {
    let (double, single) = (worst::<Base>(), worst::<SingleBase>());
    assert!(double[0] < 1e-14 && double[1] < 3e-16, "{double:?}");
    assert!(single[0] < 2e-6 && single[1] < 2e-7, "{single:?}");
}
