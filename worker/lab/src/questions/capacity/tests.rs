//! Measures of synthetic states with known capacities.

use super::*;
use metasense_numerics::random::{Purpose, Stream};

const DRIVES: usize = 8;
const HOLDS: usize = 350;

fn inputs(seed: u64) -> Vec<f64> {
    let mut stream = Stream::new(Purpose::Drive, seed, [0, 0]);
    (0..DRIVES * HOLDS).map(|_| stream.between([-1.0, 1.0])).collect()
}

/// Measures by name, of states that are functions of the inputs up to the present and of random numbers.
fn of(seed: u64, state: impl Fn(&[f64], &mut Stream) -> Vec<f64>) -> impl Fn(&str) -> Measure {
    let (inputs, mut noise) = (inputs(seed), Stream::new(Purpose::Chip, seed, [0, 0]));
    let mut states = Vec::new();
    for drive in inputs.chunks_exact(HOLDS) {
        // zero inputs before the drive
        let padded = [vec![0.0; WASHOUT], drive.to_vec()].concat();
        (1..=HOLDS).for_each(|t| states.extend(state(&padded[..WASHOUT + t], &mut noise)));
    }
    let found = measures(&inputs, &states, HOLDS);
    move |name| found.iter().find(|measure| measure.name == name).expect("a measure").clone()
}

fn ago(inputs: &[f64], delay: usize) -> f64 {
    inputs[inputs.len() - 1 - delay]
}

/// N delays in any basis have the memory N and no other capacity; the order of the inputs decides how well a NARMA sequence is read.
#[test]
fn a_delay_line_remembers_its_length() {
    for n in [1, 4, 12] {
        let line = of(1, |inputs, _| {
            let sum = |i: usize| (0..=i).map(|delay| (1.0 + delay as f64) * ago(inputs, delay)).sum();
            (0..n).map(sum).collect()
        });
        let (memory, total) = (line("memory"), line("total"));
        assert!((memory.value - n as f64).abs() < 1e-3, "{n}: {memory:?}");
        assert_eq!((line("degree 2").value, line("degree 3").value, total.bound), (0.0, 0.0, Some(n as f64)));
        assert!(total.value <= n as f64 && total.value == memory.value, "{total:?}");
    }
    let late = of(1, |inputs, _| (0..60).map(|d| if d < 50 { 0.0 } else { ago(inputs, d - 10) }).collect());
    assert!((late("memory").value - 10.0).abs() < 1e-3);
}

/// Polynomials of a known degree have exactly the capacity of their degree, and a sum of two the parts of its variance.
#[test]
fn polynomials_have_the_capacity_of_their_degree() {
    let found = of(2, |inputs, _| {
        let [a, b, c] = [0, 1, 7].map(|delay| ago(inputs, delay));
        vec![a * b, 1.5 * c * c, a * b * c, a.powi(3) - 0.6 * a, c + 1e4]
    });
    let expected = [("memory", 1.0), ("degree 2", 2.0), ("degree 3", 2.0), ("total", 5.0)];
    for (name, value) in expected {
        assert!((found(name).value - value).abs() < 1e-3, "{:?}", found(name));
    }
    // variances 1/3 and 1/5
    let mixed = of(3, |inputs, _| vec![ago(inputs, 2) + 0.5 * (3.0 * ago(inputs, 4).powi(2) - 1.0)]);
    for (name, part) in [("memory", 5.0 / 8.0), ("degree 2", 3.0 / 8.0), ("total", 1.0)] {
        assert!((mixed(name).value - part).abs() < 0.03, "{:?}", mixed(name));
    }
}

/// The capacities of a network that forgets add up to nearly its number of units, whatever its nonlinearity; an odd network has none of
/// even degree. Values from an independent program (numpy).
#[test]
fn a_network_uses_all_its_units() {
    for (gain, memory, third) in [(0.1, 5.92, 0.0), (1.0, 5.0, 0.83)] {
        let network = of(7, |inputs, _| {
            let weights = [1.0, -0.6, 0.8, 0.3, -0.9, 0.5].map(|weight| gain * weight);
            inputs[inputs.len() - WASHOUT..].iter().fold(vec![0.0; 6], |x, u| {
                (0..6).map(|i| (0.7 * x[(i + 5) % 6] + weights[i] * u).tanh()).collect()
            })
        });
        assert!((network("memory").value - memory).abs() < 0.1, "{:?}", network("memory"));
        assert!((network("degree 3").value - third).abs() < 0.2, "{:?}", network("degree 3"));
        let total = network("total").value;
        assert!(network("degree 2").value == 0.0 && 5.7 < total && total < 6.0, "{total}");
    }
}

/// Random states have no capacity, although hundreds of raw capacities of N/T each add up to several. Beside a noisy memory of known
/// quality they do not increase it.
#[test]
fn chance_is_not_counted() {
    let random = |noise: &mut Stream| (0..20).map(|_| noise.normal()).collect::<Vec<f64>>();
    let none = of(4, |_, noise| random(noise));
    assert_eq!(none("total").value, 0.0);
    assert!((none("narma-10").value - 1.0).abs() < 0.1 && none("narma-10").bound.is_none());
    let inputs = inputs(4);
    let mut noise = Stream::new(Purpose::Chip, 4, [0, 0]);
    let states: Vec<f64> = (0..inputs.len()).flat_map(|_| random(&mut noise)).collect();
    let x = standardised(&states, 20, HOLDS);
    let products = multisets(3, 10);
    let y = DMatrix::from_fn(x.nrows(), products.len(), |row, k| {
        polynomial(&products[k], &inputs[row..row + 10])
    });
    let raw = errors(&x, &y, 0..x.nrows(), 0..x.nrows()).into_iter().map(|error| 1.0 - error);
    assert!(raw.sum::<f64>() > 1.0);

    // noise of the input's variance: capacity ½
    let noisy = |seed: u64| {
        let memory = |inputs: &[f64], noise: &mut Stream| {
            let own = ago(inputs, 3) + noise.normal() / 3f64.sqrt();
            [vec![own], (0..200).map(|_| noise.normal()).collect()].concat()
        };
        of(seed, memory)("memory").value
    };
    let values: Vec<f64> = (10..16).map(noisy).collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    // raw: ½ + ½ · 200/2400
    assert!((mean - 0.5).abs() < 0.015, "{values:?}");
}

/// Thresholds from quantiles of χ² at 1 − 10⁻⁴ (scipy 1.x, `chi2.isf`).
#[test]
fn the_threshold_is_that_of_chi_square() {
    for (freedom, quantile, off) in [(3, 21.1075, 0.04), (21, 53.9620, 0.01), (100, 161.3187, 0.003)] {
        let found = threshold(f64::from(freedom), 1000.0);
        assert!((found / (2.0 * quantile / 1000.0) - 1.0).abs() < off, "{freedom}: {found}");
    }
}

/// Values from an independent program (numpy) for u(t) = sin t², t = 0 … 59.
#[test]
fn narma_sequences_are_the_usual_ones() {
    let inputs: Vec<f64> = (0..60).map(|t| f64::from(t * t).sin()).collect();
    let expected = [
        (2, [0.109375, 0.20229177917970648, 0.28009502502557104, 0.25344077062964965]),
        (5, [0.1, 0.1305, 0.17463727358420508, 0.4576427837780739]),
        (10, [0.1, 0.1305, 0.2432123806188842, 0.4014782795730718]),
    ];
    for (order, values) in expected {
        let found = narma(order, &inputs);
        for (t, value) in [0, 1, 11, 59].into_iter().zip(values) {
            assert!((found[t] - value).abs() < 1e-12, "order {order}, t = {t}: {}", found[t]);
        }
    }
    // largest inputs for ever
    assert!(narma(10, &[1.0; 200]).iter().all(|y| *y <= 1.0));
}

/// A state that contains a sequence reads it without error on drives that were not fitted; a short delay line reads order 2 better
/// than order 10, whose product spans ten holds.
#[test]
fn errors_are_those_of_drives_that_were_not_fitted() {
    let all = inputs(5);
    let sequence: Vec<f64> = all.chunks_exact(HOLDS).flat_map(|drive| narma(5, drive)).collect();
    let exact = measures(&all, &sequence, HOLDS);
    assert!(exact[5].name == "narma-5" && exact[5].value < 1e-5 && exact[4].value > 0.1, "{exact:?}");
    assert_eq!(measures(&all, &sequence, HOLDS), exact);
    let short = of(5, |inputs, _| (0..4).map(|delay| ago(inputs, delay)).collect());
    let [two, ten] = ["narma-2", "narma-10"].map(|name| short(name).value);
    assert!(two < 0.3 && two < ten && ten < 1.0, "{two} {ten}");
    // overfitting shows only on other drives
    let many = of(6, |_, noise| (0..300).map(|_| noise.normal()).collect());
    assert!(many("narma-2").value > 1.1, "{:?}", many("narma-2"));
}
