//! Replays, signals and bounds of the small problem.

use super::*;
use crate::small::{GOING, on_lattices, small, with_failing_samples};
use metasense_numerics::Pool;
use metasense_numerics::dynamics::{Accuracy, Forces, Integrator, IntegratorSettings, Scene, simulate};
use metasense_numerics::nested::{self, BodyEvaluation, NoObserver};
use metasense_numerics::random::{Purpose, Stream};
use metasense_numerics::stimuli::{HistorySource, split, targets};
use metasense_numerics::trial::{
    ChipErrors, DecoderKind, Failure, Normalisation, PreparedTrial, Problem, Size, TrainingProtocol,
};
use nalgebra::{DMatrix, DVector};

fn pool(threads: usize) -> Pool {
    Pool::new(threads).unwrap()
}

/// A design other than the initial one.
fn moved(problem: &Problem) -> Vec<f64> {
    let mut stream = Stream::new(Purpose::Design, 2, [0, 0]);
    problem.initial.iter().map(|a| a + 0.4 * stream.normal()).collect()
}

/// Checks that a replay has the mean errors that an evaluation recorded for the sets, within a relative `tolerance`.
fn check_replay(problem: &Problem, body: &BodyEvaluation, tolerance: f64) -> Replay {
    let network = &body.networks[0];
    let replay = replay(problem, &body.design, &network.weights, &pool(2)).unwrap();
    let recorded = [network.error_train, network.error_test, network.error_holdout];
    for (set, recorded) in recorded.into_iter().enumerate() {
        let of_set = replay.split.iter().zip(&replay.errors).filter(|(s, _)| usize::from(**s) == set);
        let errors: Vec<f64> = of_set.filter_map(|(_, e)| *e).collect();
        let (mean, recorded) = (errors.iter().sum::<f64>() / errors.len() as f64, recorded.unwrap());
        assert!(
            (mean / recorded - 1.0).abs() < tolerance,
            "set {set}: replayed {mean} %, {recorded} % before"
        );
    }
    replay
}

/// On the initial body and on others, with both scalings, and with estimates of a stacked network that are out-of-fold.
#[test]
fn a_replay_has_the_errors_of_the_evaluation() {
    let begun_with = small(TrainingProtocol::Joint(GOING));
    let other = moved(&begun_with);
    for (reader, scaling) in [
        (DecoderKind::Network, Normalisation::Rms),
        (DecoderKind::Network, Normalisation::Extremes),
        (DecoderKind::Stacked, Normalisation::Rms),
    ] {
        let mut mine = Problem { decoder_kind: reader, ..begun_with.clone() };
        mine.brain.scaling = scaling;
        let its_own = Problem { initial: other.clone(), ..mine.clone() };
        for problem in [&mine, &its_own] {
            let pool = pool(1);
            let trial = PreparedTrial::new(problem, &pool).unwrap();
            let body =
                nested::evaluate_designs(&trial, std::slice::from_ref(&other), &mut NoObserver).remove(0);
            check_replay(problem, &body, 1e-5);
        }
    }
}

/// A failed sample has 100 % error in a replay, too.
#[test]
fn a_replay_counts_samples_that_fail() {
    // numbers beyond the pilot's samples
    let (train, test) = split(3, 32, 16, false);
    let late = |set: &[usize]| *set.last().expect("not empty");
    let spoilt = [(Purpose::Stimulus, late(&train)), (Purpose::Stimulus, late(&test)), (Purpose::Holdout, 2)];
    let mut wanted = vec![late(&train), late(&test), 32 + 2];
    wanted.sort_unstable();
    for brain in [DecoderKind::Linear, DecoderKind::Network, DecoderKind::Stacked] {
        let (problem, pool) = (with_failing_samples(brain, &spoilt, 1e200), pool(2));
        let trial = PreparedTrial::new(&problem, &pool).unwrap();
        let initial = std::slice::from_ref(&problem.initial);
        let body = nested::evaluate_designs(&trial, initial, &mut NoObserver).remove(0);
        let again = check_replay(&problem, &body, 1e-3);
        let failed: Vec<usize> = (0..48).filter(|&i| again.failed[i]).collect();
        assert_eq!(failed, wanted, "{brain:?}");
        assert!(failed.iter().all(|&i| again.errors[i] == Some(100.0)), "{:?}", again.errors);
    }
}

/// Sensor noise does not depend on the body: it is relative to the signals of the initial body, or of `relative_to`.
#[test]
fn chips_are_as_noisy_on_every_body() {
    let pool = pool(1);
    let disturbance =
        ChipErrors { noise: Size::Relative(0.2), bias: Size::Relative(0.1), delay: 0.0, ..ChipErrors::NONE };
    let quiet = small(TrainingProtocol::Joint(GOING));
    let noisy = Problem { disturbance: Some(disturbance), ..quiet.clone() };
    let forces = quiet.forces(Purpose::Holdout, 0, 3);
    let other = moved(&quiet);
    let from_other = Problem { initial: other.clone(), ..noisy.clone() };
    let named = Problem { relative_to: Some(quiet.initial.clone()), ..from_other.clone() };
    let cases = [(&noisy, &quiet.initial), (&noisy, &other), (&from_other, &other), (&named, &other)];
    let [first, second, its_own, said] = cases.map(|(noisy, design)| {
        let quiet = &Problem { disturbance: None, ..noisy.clone() };
        let [clean, heard] = [quiet, noisy].map(|of| sense(of, design, &forces, &pool).unwrap());
        let added: Vec<f64> = heard.iter().zip(&clean).map(|(heard, clean)| heard - clean).collect();
        (clean, added)
    });
    assert_ne!(first.0, second.0);
    let most = first.1.iter().fold(0.0f64, |most, x| most.max(x.abs()));
    let apart =
        |other: &[f64]| first.1.iter().zip(other).fold(0.0f64, |most, (a, b)| most.max((a - b).abs()));
    let [second, its_own, said] = [second, its_own, said].map(|(_, added)| apart(&added));
    assert!(most > 0.0 && second.max(said) < 1e-9 * most, "{second}, {said} of {most}");
    assert!(its_own > 1e-3 * most, "{its_own} of {most}");
    // a reference body without signals is an error
    let torn = Problem { relative_to: Some(vec![f64::NAN; other.len()]), ..noisy };
    let failure = sense(&torn, &other, &forces, &pool).map(drop).unwrap_err();
    assert!(matches!(failure, Failure::Reference(_)), "{failure:?}");
}

/// A problem with forces of `times` the usual amplitude.
fn of_amplitude(mut problem: Problem, times: f64) -> Problem {
    if let HistorySource::Bell(bell) = &mut problem.stimuli.source {
        bell.amplitude = bell.amplitude.map(|a| times * a);
    }
    problem.solver = IntegratorSettings::new(Integrator::Nystrom6, Accuracy(1e-6));
    problem
}

/// Under forces of some µN a body is linear: the bound equals the error of the best linear decoder on the training samples, from
/// normal equations of simulated signals and from random noise.
#[test]
fn of_a_linear_body_the_bound_is_met_by_the_best_linear_decoder() {
    let problem = small(TrainingProtocol::Random(GOING));
    check_the_bound(problem.clone(), 400);
    // a disc of triangles and a sheet of hexagons
    on_lattices(&problem).into_iter().skip(1).take(2).for_each(|(_, problem)| check_the_bound(problem, 0));
}

/// `draws`: number of noise draws, possibly 0.
fn check_the_bound(problem: Problem, draws: usize) {
    let disturbance = ChipErrors {
        noise: Size::Relative(0.2),
        bias: Size::Relative(0.3),
        delay: 0.0075,
        ..ChipErrors::NONE
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
