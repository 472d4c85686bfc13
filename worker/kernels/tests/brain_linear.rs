//! Linear decoder: the fit is the minimum, gradients are adjoint to predictions, and the sensitivity solves H z = V.

use metasense_kernels::Pool;
use metasense_kernels::brain::linear::{
    FactoredEquations, Lags, Linear, Normal, Order, Singular, Sizes, factor, matrix_mut,
};
use metasense_kernels::random::{Purpose, Stream};
use std::ops::Range;

const SIZES: Sizes = Sizes { instants: 9, channels: 3, outputs: 2 };
/// Long enough for lags with shared weights.
const LONG: Sizes = Sizes { instants: 50, channels: 2, outputs: 1 };
const SAMPLES: usize = 7;
/// Channels for which lags share weights in larger groups while a body is trained.
const MANY: usize = 2000;

struct Set {
    sizes: Sizes,
    x: Vec<f64>,
    f: Vec<f64>,
    w: Vec<f64>,
}

fn set(sizes: Sizes, seed: u64) -> Set {
    let mut stream = Stream::new(Purpose::Design, seed, [0, 0]);
    let mut draw = |n: usize| -> Vec<f64> { (0..n).map(|_| 0.3 + stream.normal()).collect() };
    let x = draw(SAMPLES * sizes.instants * sizes.channels);
    let f = draw(SAMPLES * sizes.instants * sizes.outputs);
    Set { sizes, x, f, w: draw(SAMPLES).into_iter().map(|w| w * w + 0.1).collect() }
}

fn normal(set: &Set, lags: Lags) -> Normal {
    normal_of(set, lags, lags.groups())
}

fn normal_of(set: &Set, lags: Lags, groups: Vec<Range<usize>>) -> Normal {
    Normal::new(set.sizes, [&set.x, &set.f, &set.w], lags, groups, &Pool::new(1).unwrap())
}

/// Σ w Σ f².
fn power(set: &Set) -> f64 {
    let one = set.sizes.instants * set.sizes.outputs;
    set.f.iter().enumerate().map(|(j, f)| set.w[j / one] * f * f).sum()
}

/// The objective, computed instant by instant from its definition.
fn objective(set: &Set, linear: &Linear, ridge: f64) -> f64 {
    let Sizes { instants, channels, outputs } = set.sizes;
    let Lags { before, after } = linear.lags;
    let mut sum = 0.0;
    for i in 0..SAMPLES {
        for (n, k) in (0..instants).flat_map(|n| (0..outputs).map(move |k| (n, k))) {
            let mut said = linear.b[k];
            for l in 0..before + after + 1 {
                if let Some(t) = (n + l).checked_sub(before).filter(|t| *t < instants) {
                    for c in 0..channels {
                        said += linear.w[(k * (before + after + 1) + l) * channels + c]
                            * set.x[(i * instants + t) * channels + c];
                    }
                }
            }
            sum += set.w[i] * (said - set.f[(i * instants + n) * outputs + k]).powi(2);
        }
    }
    sum / power(set) + ridge * linear.w.iter().map(|w| w * w).sum::<f64>()
}

const MEMORIES: [(Sizes, usize, usize); 9] = [
    (SIZES, 0, 0),
    (SIZES, 2, 1),
    (SIZES, 0, 4),
    (SIZES, 8, 0),
    (SIZES, 3, 3),
    (SIZES, 8, 8),
    (LONG, 49, 0),
    (LONG, 44, 49),
    (LONG, 3, 42),
];

/// Every lag is in exactly one group, in order. Memories that end at a group have all their groups in common with longer memories.
#[test]
fn groups_hold_every_lag_once() {
    for (_, before, after) in MEMORIES {
        let lags = Lags { before, after };
        for groups in [lags.groups(), lags.training_groups(MANY)] {
            assert!(groups.into_iter().flatten().eq(0..lags.count()), "{lags:?}");
        }
    }
    let whole = Lags::whole(200);
    assert_eq!([whole.groups().len(), whole.training_groups(9).len()], [161, 161]);
    assert_eq!(whole.training_groups(18).len(), 67);
    assert_eq!(Lags { before: 46, after: 41 }.groups().len(), 2 + 81 + 1);
    assert_eq!([0, 40, 41, 42, 47, 80].map(Lags::nearest_group_end), [0, 40, 40, 44, 48, 80]);
}

/// No change of a weight or bias, up or down, lowers the objective, for all kinds of memory. Predictions equal the sum in the
/// definition.
#[test]
fn weights_are_the_minimum_of_the_weighted_squares_on_the_window() {
    let ridge = 0.05;
    for (sizes, before, after) in MEMORIES {
        let (set, lags) = (set(sizes, 1), Lags { before, after });
        for groups in [lags.groups(), lags.training_groups(MANY)] {
            let normal = normal_of(&set, lags, groups.clone());
            let linear = FactoredEquations::new(normal, ridge, Order::Ascending).unwrap().linear();
            let least = objective(&set, &linear, ridge);
            let rises = |change: &dyn Fn(&mut Linear, f64)| {
                for step in [1e-4, -1e-4] {
                    let mut moved = linear.clone();
                    change(&mut moved, step);
                    let rise = objective(&set, &moved, ridge) - least;
                    assert!(rise > 0.0 && rise < 1e-5, "{sizes:?} {lags:?}: {rise}");
                }
            };
            for k in 0..sizes.outputs {
                rises(&|moved, step| moved.b[k] += step);
                for (group, c) in groups.iter().flat_map(|g| (0..sizes.channels).map(move |c| (g, c))) {
                    let at = |lag| (k * lags.count() + lag) * sizes.channels + c;
                    rises(&|moved, step| group.clone().for_each(|lag| moved.w[at(lag)] += step));
                    assert!(
                        group.clone().all(|lag| linear.w[at(lag)] == linear.w[at(group.start)]),
                        "{group:?}"
                    );
                }
            }
            let said = linear.predict(&set.x);
            let total = power(&set);
            let one = sizes.instants * sizes.outputs;
            let by_prediction: f64 =
                (0..said.len()).map(|j| set.w[j / one] / total * (said[j] - set.f[j]).powi(2)).sum::<f64>()
                    + ridge * linear.w.iter().map(|w| w * w).sum::<f64>();
            assert!((by_prediction / least - 1.0).abs() < 1e-12, "{before} {after}: {by_prediction} {least}");
        }
    }
}

/// Blocks of one factor are the factors of shorter memories. Normal equations of disjoint sets add up.
#[test]
fn one_factor_serves_every_shorter_memory() {
    let ridge = 0.03;
    let close = |a: &Linear, b: &Linear| {
        let far = a.w.iter().chain(&a.b).zip(b.w.iter().chain(&b.b)).map(|(a, b)| (a - b).abs());
        let far = far.fold(0.0, f64::max);
        assert!(a.lags == b.lags && far < 1e-9, "{:?}: {far:e}", a.lags);
    };
    for (sizes, order, before, after) in [
        (SIZES, Order::Ascending, 8, 3),
        (SIZES, Order::Ascending, 8, 0),
        (SIZES, Order::Outward, 0, 0),
        (SIZES, Order::Outward, 5, 5),
        (SIZES, Order::Outward, 8, 8),
        (LONG, Order::Ascending, 49, 44),
        (LONG, Order::Ascending, 49, 7),
        (LONG, Order::Outward, 48, 48),
        (LONG, Order::Outward, 12, 12),
    ] {
        let (set, lags) = (set(sizes, 2), Lags { before, after });
        let alone = FactoredEquations::new(normal(&set, lags), ridge, Order::Ascending).unwrap().linear();
        let whole = FactoredEquations::new(normal(&set, Lags::whole(sizes.instants)), ridge, order).unwrap();
        close(&whole.with_memory(lags), &alone);
    }
    let all = set(SIZES, 2);
    let (one_x, one_f) = (SIZES.instants * SIZES.channels, SIZES.instants * SIZES.outputs);
    let [part, rest] = [2..SAMPLES, 0..2].map(|own: Range<usize>| Set {
        sizes: SIZES,
        x: all.x[own.start * one_x..own.end * one_x].to_vec(),
        f: all.f[own.start * one_f..own.end * one_f].to_vec(),
        w: all.w[own].to_vec(),
    });
    let lags = Lags { before: 2, after: 1 };
    let fit = |normal| FactoredEquations::new(normal, ridge, Order::Ascending).unwrap().linear();
    let [all, part, rest] = [all, part, rest].map(|set| normal(&set, lags));
    close(&fit(all.plus(-1.0, &part)), &fit(rest));
}

/// ⟨c, W ∗ x⟩ = ⟨vjp(c), x⟩ = ⟨weights_vjp(c), W⟩, with zero bias.
#[test]
fn predictions_and_pull_backs_are_transposes() {
    for (sizes, before, after) in MEMORIES {
        let (set, other) = (set(sizes, 3), set(sizes, 4));
        let mut linear = FactoredEquations::new(normal(&set, Lags { before, after }), 0.1, Order::Ascending)
            .unwrap()
            .linear();
        linear.b.fill(0.0);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let left = dot(&other.f, &linear.predict(&set.x));
        let right = dot(&linear.predict_vjp(&other.f), &set.x);
        let weights = dot(&linear.weights_vjp(&set.x, &other.f).w, &linear.w);
        let scale = left.abs() + 1.0;
        assert!((left - right).abs() < 1e-12 * scale, "{before} {after}: {left} {right}");
        assert!((left - weights).abs() < 1e-12 * scale, "{before} {after}: {left} {weights}");
    }
}

/// The minimum of the objective minus ε(V·W + v·b) is W + ε z to first order, with z the sensitivity. Tests H z = V by differences
/// of the gradient.
#[test]
fn the_sensitivity_solves_the_second_derivative() {
    let ridge = 0.02;
    for (sizes, order, before, after) in [
        (SIZES, Order::Ascending, 3, 1),
        (SIZES, Order::Outward, 2, 2),
        (LONG, Order::Ascending, 47, 43),
        (LONG, Order::Outward, 42, 49),
    ] {
        let (set, other, lags) = (set(sizes, 5), set(sizes, 6), Lags { before, after });
        let fit = FactoredEquations::new(normal(&set, lags), ridge, order).unwrap();
        let linear = fit.linear();
        let force = linear.weights_vjp(&other.x, &other.f);
        let z = fit.sensitivity(&force);
        // the objective is quadratic, so H z is the gradient at W + z minus that at W, which is 0
        let mut moved = linear.clone();
        moved.w.iter_mut().zip(&z.w).for_each(|(w, z)| *w += z);
        moved.b.iter_mut().zip(&z.b).for_each(|(b, z)| *b += z);
        let total = power(&set);
        let one = sizes.instants * sizes.outputs;
        let said = moved.predict(&set.x);
        let residual: Vec<f64> =
            (0..said.len()).map(|j| 2.0 * set.w[j / one] / total * (said[j] - set.f[j])).collect();
        let mut gradient = moved.weights_vjp(&set.x, &residual);
        gradient.w.iter_mut().zip(&moved.w).for_each(|(g, w)| *g += 2.0 * ridge * w);
        let summed = |w: &[f64]| -> Vec<f64> {
            let rows: Vec<&[f64]> = w.chunks(sizes.channels).collect();
            let of_group =
                |rows: &[&[f64]]| (0..sizes.channels).map(|c| rows.iter().map(|r| r[c]).sum()).collect();
            rows.chunks(lags.count())
                .flat_map(|rows| {
                    lags.groups().into_iter().flat_map(|group| -> Vec<f64> { of_group(&rows[group]) })
                })
                .collect()
        };
        let far = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let (w, b) = (far(&summed(&gradient.w), &summed(&force.w)), far(&gradient.b, &force.b));
        assert!(w < 1e-9 && b < 1e-9 && force.w.iter().any(|v| v.abs() > 0.1), "{order:?}: {w:e} {b:e}");
    }
}

/// Linearly dependent signals have no factor without a ridge, and one with it.
#[test]
fn a_singular_matrix_is_named() {
    let mut set = set(SIZES, 7);
    set.x.chunks_exact_mut(3).for_each(|row| row[2] = row[1]);
    let lags = Lags { before: 1, after: 1 };
    let fit = |ridge| FactoredEquations::new(normal(&set, lags), ridge, Order::Ascending);
    assert_eq!(fit(0.0).err(), Some(Singular));
    assert!(fit(1e-6).is_ok());
}

/// The factor is identical bit by bit to that of `faer` on one thread, for any number of threads. A matrix that is not positive
/// definite is reported from any block.
#[test]
fn a_factor_is_the_same_on_any_number_of_threads() {
    use faer::linalg::cholesky::llt::factor::{cholesky_in_place, cholesky_in_place_scratch};
    for n in [1, 127, 128, 129, 400, 517] {
        let mut stream = Stream::new(Purpose::Design, n as u64, [0, 0]);
        let x: Vec<f64> = (0..n * n).map(|_| stream.normal()).collect();
        let mut symmetric = vec![0.0; n * n];
        for (j, i) in (0..n).flat_map(|j| (j..n).map(move |i| (j, i))) {
            let sum: f64 = (0..n).map(|k| x[k * n + i] * x[k * n + j]).sum();
            symmetric[j * n + i] = sum + if i == j { 1.0 } else { 0.0 };
        }
        let lower = |of: &[f64]| -> Vec<u64> {
            (0..n).flat_map(|j| of[j * n + j..(j + 1) * n].iter().map(|x| x.to_bits())).collect()
        };
        let mut alone = symmetric.clone();
        let spec = faer::Spec::default();
        let scratch = cholesky_in_place_scratch::<f64>(n, faer::Par::Seq, spec);
        cholesky_in_place(
            matrix_mut(&mut alone, n, n),
            Default::default(),
            faer::Par::Seq,
            faer::dyn_stack::MemStack::new(&mut faer::dyn_stack::MemBuffer::new(scratch)),
            spec,
        )
        .unwrap();
        for threads in [1, 2, 3, 5] {
            let pool = Pool::new(threads).unwrap();
            let mut dealt = symmetric.clone();
            factor(&pool, &mut dealt, n).unwrap();
            assert!(lower(&dealt) == lower(&alone), "{n} unknowns on {threads} threads");
            let mut worse = symmetric.clone();
            worse[n * n - 1] = -1.0;
            assert_eq!(factor(&pool, &mut worse, n), Err(Singular), "{n} unknowns");
        }
    }
}

/// Normal equations and decoders do not depend on the number of threads.
#[test]
fn a_brain_is_the_same_on_any_number_of_threads() {
    let sizes = Sizes { instants: 60, channels: 6, outputs: 2 };
    let set = set(sizes, 5);
    let fitted = |threads: usize| {
        let (lags, pool) = (Lags::whole(sizes.instants), Pool::new(threads).unwrap());
        let normal = Normal::new(sizes, [&set.x, &set.f, &set.w], lags, lags.groups(), &pool);
        FactoredEquations::new(normal, 1e-3, Order::Outward).unwrap().linear()
    };
    let alone = fitted(1);
    assert!(alone.w.len() / sizes.outputs > 128);
    for threads in [2, 4] {
        assert_eq!(fitted(threads), alone, "{threads} threads");
    }
}
