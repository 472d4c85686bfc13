//! Nonlinear share of a body's signals, and the error bound of linear decoders.

use super::*;
use crate::dynamics::{Forces, simulate, tune};
use crate::stimuli::{split, targets};
use nalgebra::{DMatrix, DVector};

/// The small problem with forces of `times` the usual amplitude.
fn with_amplitude(times: f64) -> Problem {
    of_amplitude(small(PROTOCOLS[2]), times)
}

fn of_amplitude(mut problem: Problem, times: f64) -> Problem {
    if let Source::Bell(bell) = &mut problem.stimuli.source {
        bell.amplitude = bell.amplitude.map(|a| times * a);
    }
    problem.solver = Solver::new(Method::Nystrom6, Accuracy(1e-6));
    problem
}

/// The nonlinear share quadruples when small forces double.
#[test]
fn the_nonlinear_part_goes_with_the_square_of_small_forces() {
    let share = |times: f64| {
        let problem = with_amplitude(times);
        let pool = pool(1);
        let trial = Trial::new(&problem, &pool).unwrap();
        let mould = DesignWithSolver { trial: &trial, design: &problem.initial, solver: &problem.solver };
        nonlinear(&mould, &mut Counters::default()).unwrap()
    };
    let [whole, first, second] = [1.0, 0.005, 0.01].map(share);
    for kind in 0..2 {
        let ratio = second[kind] / first[kind];
        assert!((ratio - 4.0).abs() < 0.1, "{kind}: {first:?} {second:?}");
        assert!(second[kind] < 0.1 && (1.0..300.0).contains(&whole[kind]), "{whole:?} {second:?}");
    }
}

/// The nonlinear share agrees between Tsit5 and equal steps: the tolerance scales with the small forces.
#[test]
fn the_nonlinear_part_does_not_depend_on_the_integrator() {
    for times in [0.1, 1.0] {
        let (problem, pool) = (with_amplitude(times), pool(1));
        let trial = Trial::new(&problem, &pool).unwrap();
        let share = |solver| {
            let mould = DesignWithSolver { trial: &trial, design: &problem.initial, solver };
            nonlinear(&mould, &mut Counters::default()).unwrap()
        };
        let asked = Solver::new(Method::Tsit5, Accuracy(1e-4));
        let tsit5 = tune(&problem.scene, &problem.initial, &trial.train, &asked, &pool).solver;
        let (adaptive, equal) = (share(&tsit5), share(&problem.solver));
        for kind in 0..2 {
            let off = (adaptive[kind] / equal[kind] - 1.0).abs();
            assert!(off < 0.02, "× {times}: {adaptive:?} by Tsit5, {equal:?} by equal steps");
        }
    }
}

/// Under forces of some µN a body is linear: the bound equals the error of the best linear decoder on the training samples, from
/// normal equations of simulated signals and from random noise.
#[test]
fn of_a_linear_body_the_bound_is_met_by_the_best_linear_decoder() {
    let problem = small(PROTOCOLS[2]);
    check_the_bound(problem.clone(), 400);
    // a disc of triangles and a sheet of hexagons
    on_lattices(&problem).into_iter().skip(1).take(2).for_each(|(_, problem)| check_the_bound(problem, 0));
}

/// `draws`: number of noise draws, possibly 0.
fn check_the_bound(problem: Problem, draws: usize) {
    let disturbance = Disturbance {
        noise: Size::Relative(0.2),
        bias: Size::Relative(0.3),
        delay: 0.0075,
        ..Disturbance::NONE
    };
    let problem = Problem { disturbance: Some(disturbance), ..of_amplitude(problem, 1e-5) };
    let samples = if draws > 0 { 4 } else { 1 };
    let found = bound(&problem, &problem.initial, samples, &pool(2)).unwrap().unwrap();

    let all = problem.forces(Purpose::Stimulus, 0, 16);
    let train = all.select(&split(problem.seed, 16, 4, false).0);
    let f = targets(&train, 40, false);
    let (n, t, fine) = (train.samples, 40, 8);
    let scene = Scene { instants: fine * t, ..problem.scene.clone() };
    let solver = &problem.solver;
    let clean =
        simulate(&scene, &problem.initial, &train.refined_for(&scene), solver, false, &pool(1)).signals;
    // one and a half readings late: twelve instants of the motion, whose first is number 1
    let late = DMatrix::from_fn(n, 3 * t, |i, at| {
        let instant = (fine * (at / 3 + 1)).checked_sub(13);
        instant.map_or(0.0, |m| clean[(i * fine * t + m) * 3 + at % 3])
    });
    let squares = |c: usize| (0..t).map(|k| late.column(3 * k + c).norm_squared()).sum::<f64>();
    let rms: Vec<f64> = (0..3).map(|c| (squares(c) / (n * t) as f64).sqrt()).collect();
    let f = DMatrix::from_row_slice(n, 2 * t, &f);
    let w: Vec<f64> = (0..n).map(|i| f.row(i).norm_squared().recip()).collect();
    let total: f64 = w.iter().sum();
    let centred = |x: &DMatrix<f64>| {
        let mean: DVector<f64> = x.transpose() * DVector::from_iterator(n, w.iter().map(|w| w / total));
        let centred = DMatrix::from_fn(n, x.ncols(), |i, j| (w[i] / total).sqrt() * (x[(i, j)] - mean[j]));
        (centred, mean)
    };
    let ((fc, f_mean), (sc, s_mean)) = (centred(&f), centred(&late));
    let noise = DMatrix::from_fn(3 * t, 3 * t, |a, b| match (a == b, a % 3 == b % 3) {
        (true, _) => rms[a % 3].powi(2) * (0.04 + 0.09),
        (_, true) => rms[a % 3].powi(2) * 0.09,
        _ => 0.0,
    });
    let cross = sc.transpose() * &fc;
    let decoder = (sc.transpose() * &sc + noise).cholesky().unwrap().solve(&cross);
    let left = (fc.transpose() * &fc).trace() - decoder.dot(&cross);
    let least = 100.0 * total / n as f64 * left;
    assert!((found.mean / least - 1.0).abs() < 1e-3, "{} {least}", found.mean);
    assert!(found.mean < 0.9 * found.prior_only && found.mean > 0.1, "{found:?}");

    let mut stream = Stream::new(Purpose::Chip, 5, [7, 7]);
    let mut sum = 0.0;
    for _ in 0..draws {
        let mut heard = late.clone();
        for i in 0..n {
            for c in 0..3 {
                let bias = 0.3 * stream.normal();
                (0..t).for_each(|k| heard[(i, 3 * k + c)] += rms[c] * (bias + 0.2 * stream.normal()));
            }
            let said = decoder.transpose() * (heard.row(i).transpose() - &s_mean) + &f_mean;
            sum += 100.0 * w[i] * (said - f.row(i).transpose()).norm_squared();
        }
    }
    let drawn = sum / (draws * n) as f64;
    assert!(draws == 0 || (drawn / found.mean - 1.0).abs() < 0.03, "{drawn} {}", found.mean);

    // the remaining variance of a linear body is the same for every sample
    let unseen = problem.forces(Purpose::Holdout, 0, 4);
    let power = |unseen: &Forces| -> Vec<f64> {
        targets(unseen, 40, false).chunks_exact(80).map(|f| f.iter().map(|f| f * f).sum()).collect()
    };
    let left: Vec<f64> =
        power(&unseen).iter().zip(&found.samples).map(|(p, error)| p * error.unwrap()).collect();
    // softer bodies are slightly less linear
    assert!(left.iter().all(|l| (l / left[0] - 1.0).abs() < 1e-3), "{left:?}");
    let silent = Problem { disturbance: None, ..problem };
    assert_eq!(bound(&silent, &silent.initial, 4, &pool(1)).unwrap(), None);
}
