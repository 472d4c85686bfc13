//! Tests of `lanes`: on every processor, an operation of the baseline is that of scalars on each lane, bit by bit.

use super::*;

const NUMBERS: [f64; 13] = [
    0.0,
    -0.0,
    1.5,
    -2.25,
    1.0 / 3.0,
    -7e20,
    1e-30,
    f64::MIN_POSITIVE / 3.0,
    1e-40,
    3.000_000_1,
    f64::INFINITY,
    f64::NEG_INFINITY,
    f64::NAN,
];

/// Equal bits, or both NaN.
fn same(found: f64, expected: f64) -> bool {
    found.to_bits() == expected.to_bits() || found.is_nan() && expected.is_nan()
}

fn operations<V: Vector>(sum: fn(&[V::Scalar]) -> V::Scalar) {
    let number = |n: usize| V::Scalar::from_f64(NUMBERS[n % NUMBERS.len()]);
    let vector = |n: usize| V::gather(&(0..V::LANES).map(|i| number(n + i).to_f64()).collect::<Vec<_>>());
    let one = V::Scalar::from_f64(1.0);
    for n in 0..NUMBERS.len().pow(3) {
        let [i, j, k] = [n, n / NUMBERS.len(), n / NUMBERS.len().pow(2)];
        let [a, b, c] = [i, j, k].map(vector);
        type Of<S> = (&'static str, fn(S, S, S) -> S);
        let expected: [Of<V::Scalar>; 10] = [
            ("+", |a, b, _| a + b),
            ("−", |a, b, _| a - b),
            ("·", |a, b, _| a * b),
            ("mul_add", |a, b, c| a * b + c),
            ("mul_sub_from", |a, b, c| c - a * b),
            ("over", |a, b, _| a / b),
            ("abs", |a, _, _| V::Scalar::from_f64(a.to_f64().abs())),
            ("max", |a, b, _| if a > b { a } else { b }),
            ("where_less", |a, b, c| if a < b { c } else { a }),
            ("rsqrt", |a, _, _| a.sqrt()),
        ];
        let found = [
            a + b,
            a - b,
            a * b,
            a.mul_add(b, c),
            a.mul_sub_from(b, c),
            a.over(b),
            a.abs(),
            a.max(b),
            c.where_less(a, b, a),
            a.rsqrt(),
        ];
        for (found, (name, of)) in found.iter().zip(expected) {
            for lane in 0..V::LANES {
                let [a, b, c] = [i, j, k].map(|n| number(n + lane));
                let expected = of(a, b, c);
                let expected = if name == "rsqrt" { one / expected } else { expected };
                let (found, expected) = (found.lane(lane), expected.to_f64());
                assert!(same(found, expected), "{name} of {a:?}, {b:?}, {c:?}: {found}, expected {expected}");
            }
        }
        let lanes = || (0..V::LANES).map(|lane| (number(i + lane), number(j + lane)));
        assert_eq!(a.any_less(b), lanes().any(|(a, b)| a < b), "{:?} < {:?}", a.lanes(), b.lanes());
        let limit = 2.5f64;
        let within = lanes().all(|(a, _)| a.to_f64().abs() <= limit);
        assert_eq!(a.all_within(limit), within, "{:?}", a.lanes());
        assert!(same(a.sum().to_f64(), sum(a.lanes()).to_f64()), "{:?}", a.lanes());
        let wide = V::narrow(a.widen());
        assert!((0..V::LANES).all(|lane| same(wide.lane(lane), a.lane(lane))), "{:?}", a.lanes());
    }
}

#[test]
fn the_baseline_computes_as_scalars_do() {
    operations::<Base>(|x| x[0] + x[1]);
    operations::<Pair<Base>>(|x| (x[0] + x[2]) + (x[1] + x[3]));
    operations::<SingleBase>(|x| (x[0] + x[2]) + (x[1] + x[3]));
}
