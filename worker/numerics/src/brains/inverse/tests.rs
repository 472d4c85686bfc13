//! Inversions with known answers.

use super::descent::Evaluator;
use super::*;
use crate::brain::linear::Lags;
use crate::nested::tests::{GOING, small};
use crate::random::Draw;
use crate::stimuli::{HistorySource, Irregular};
use crate::trial::{ChipErrors, Decoder, ForceSets, Size, TrainingProtocol};

fn problem() -> Problem {
    let noise = Size::Relative(0.03);
    let disturbance = Some(ChipErrors { noise, ..ChipErrors::NONE });
    Problem { disturbance, ..small(TrainingProtocol::Joint(GOING)) }
}

/// The decoder of the initial body, with a prior from this many histories.
fn brain<'a>(trial: &'a PreparedTrial<'a>, histories: usize) -> Inverse<'a> {
    let problem = &trial.problem;
    let brain =
        Inverse::new(trial, &problem.initial, &problem.solver, None, &trial.initial).expect("a brain");
    Inverse { guesses: guesses(problem, &problem.forces(Purpose::Fresh, 0, histories)), ..brain }
}

fn normal(draw: &mut Draw, count: usize) -> Vec<f64> {
    (0..count).map(|_| draw.normal()).collect()
}

/// Φ(z + h d) = Φ(z) − h s·d + O(h²), with low-pass, delay, bias and missing channels, also for the first part of a sample.
#[test]
fn slopes_are_those_of_phi() {
    let plain = problem();
    let chips = ChipErrors {
        bias: Size::Relative(0.1),
        bandwidth: 60.0,
        delay: 0.007,
        ..plain.disturbance.expect("noise")
    };
    let filtered = Problem { disturbance: Some(chips), channels: vec![0, 2], ..plain.clone() };
    let pool = crate::Pool::new(2).expect("threads");
    for (problem, n) in [(plain, 40), (filtered.clone(), 40), (filtered, 13)] {
        let trial = PreparedTrial::new(&problem, &pool).expect("a trial");
        let brain = brain(&trial, 20);
        let readings =
            trial.initial.signals.chunks_exact(40 * brain.noise.channels()).next().expect("a sample");
        let mut draw = Draw::numbered(5, n as u64);
        let all = brain.guesses[0].prior.unknowns() + brain.noise.no_bias().len();
        let (z, along) = (normal(&mut draw, all), normal(&mut draw, all));
        let steps = [0.0, 1e-3, 5e-4, 2.5e-4];
        let at = steps.map(|h| (0, z.iter().zip(&along).map(|(z, d)| z + h * d).collect()));
        let counters = &mut Counters::default();
        let mut looks = Evaluator {
            model: &brain.model,
            prior: &brain.guesses[0].prior,
            noise: &brain.noise,
            readings: &[readings],
            n,
            counters,
        };
        let found = looks.at(at.into());
        let slope: f64 = found[0].slope.iter().zip(&along).map(|(s, d)| s * d).sum();
        assert!(slope.abs() > 1.0, "{slope}");
        let left: Vec<f64> = (1..4).map(|i| (found[i].phi - found[0].phi + steps[i] * slope).abs()).collect();
        let orders: Vec<f64> = left.windows(2).map(|pair| (pair[0] / pair[1]).log2()).collect();
        assert!(orders.iter().all(|order| (1.9..2.1).contains(order)), "n = {n}: {orders:?} of {left:?}");
    }
}

/// For forces drawn from the prior, 95 % bands cover 95 %, the model explains the readings, and errors match the posterior.
#[test]
fn bands_cover_what_is_drawn_from_the_prior() {
    let pool = crate::Pool::new(2).expect("threads");
    let trial = PreparedTrial::new(&problem(), &pool).expect("a trial");
    let problem = &trial.problem;
    let mut brain = brain(&trial, 40);
    let mut draw = Draw::numbered(5, 1);
    let drawn: Vec<Vec<f64>> =
        (0..24).map(|_| normal(&mut draw, brain.guesses[0].prior.unknowns())).collect();
    let forces = brain.guesses[0].prior.forces(drawn.iter().map(Vec::as_slice));
    let (solver, counters) = (&problem.solver, &mut Counters::default());
    let samples = trial.simulate(&problem.initial, &forces, solver, false, counters).expect("samples");
    let (samples, found) = (&samples.samples, brain.read(&samples.samples.signals));
    let off = |i: usize, estimate: &Estimate| -> Vec<f64> {
        let truth = samples.targets.chunks_exact(80).nth(i).expect("one a sample");
        let all = estimate.forces.iter().zip(truth).zip(&estimate.deviations);
        all.map(|((said, f), deviation)| (said - f) / deviation.max(1e-9)).collect()
    };
    let off: Vec<f64> = found.iter().enumerate().flat_map(|(i, estimate)| off(i, estimate)).collect();
    let covered = off.iter().filter(|off| off.abs() <= 1.96).count() as f64 / off.len() as f64;
    let square = off.iter().map(|off| off * off).sum::<f64>() / off.len() as f64;
    assert!((0.92..0.98).contains(&covered) && (0.75..1.3).contains(&square), "{covered}, {square}");
    for estimate in &found {
        assert!(estimate.ending == Ending::Converged && estimate.is_explained(), "{estimate:?}");
    }
}

/// For the trial's pulses the error is a fraction of the linear decoder's, with equal bits on any number of threads.
#[test]
fn it_reads_better_than_where_it_begins_and_alike_on_any_threads() {
    let found = [1, 3].map(|threads| {
        let pool = crate::Pool::new(threads).expect("threads");
        let trial = PreparedTrial::new(&problem(), &pool).expect("a trial");
        let problem = &trial.problem;
        let mut brain =
            Inverse::new(&trial, &problem.initial, &problem.solver, None, &trial.initial).expect("a brain");
        let forces = problem.forces(Purpose::Holdout, 0, 4);
        let (solver, counters) = (&problem.solver, &mut Counters::default());
        let unseen = trial.simulate(&problem.initial, &forces, solver, false, counters).expect("some");
        let unseen = unseen.samples;
        let found = brain.read(&unseen.signals);
        let said: Vec<f64> = found.iter().flat_map(|estimate| &estimate.forces).copied().collect();
        let errors = [unseen.error(&said), unseen.error(&brain.linear.predict(&unseen.signals))]
            .map(|error| error.expect("forces"));
        assert!(errors[0] < 0.2 * errors[1], "{errors:?}");
        found
    });
    assert!(found[0] == found[1]);
}

/// For blows on one panel, the decoder identifies the panel and has less error than a prior in which all panels are struck; so
/// does a decoder without look-ahead, after the blow.
#[test]
fn blows_are_read_on_the_panel_that_they_strike() {
    let plain = problem();
    let HistorySource::Bell(bell) = plain.stimuli.source.clone() else { panic!("pulses") };
    let kind = Irregular { bell, roughness: [0.1, 0.2], double: 0.3, gap: [0.01, 0.02], rebound: [0.2, 0.5] };
    let stimuli = ForceSets { source: HistorySource::Irregular(kind), ..plain.stimuli.clone() };
    let pool = crate::Pool::new(2).expect("threads");
    for after in [39, 4] {
        let decoder = Decoder { lags: Lags { before: 39, after }, ..plain.decoder };
        let problem = Problem { stimuli: stimuli.clone(), decoder, ..plain.clone() };
        let trial = PreparedTrial::new(&problem, &pool).expect("a trial");
        let brain = || Inverse::of(&trial, &problem.initial, None).expect("a brain");
        let [mut own, mut all] = [brain(), brain()];
        assert_eq!(own.guesses.iter().map(|guess| &guess.prior.struck[..]).collect::<Vec<_>>(), [[0], [1]]);
        let prior =
            Prior::new(&problem.forces(Purpose::Fresh, KNOWN_FIRST, KNOWN)).expect("forces that differ");
        all.guesses = vec![Hypothesis::of(&problem, prior, 0.0)];
        let blows = problem.forces(Purpose::Holdout, 0, 8);
        let unseen = trial.samples(&problem.initial, None, blows).expect("samples");
        let found = own.read(&unseen.signals);
        let sums = |of: &[f64]| [0, 1].map(|panel| of[panel..].iter().step_by(2).sum::<f64>());
        for (estimate, truth) in found.iter().zip(unseen.targets.chunks_exact(80)) {
            let (said, truth) = (sums(&estimate.forces), sums(truth));
            assert_eq!(said[0].abs() > said[1].abs(), truth[0] > truth[1], "{said:?} {truth:?}");
        }
        let error = |found: &[Estimate]| {
            let said: Vec<f64> = found.iter().flat_map(|estimate| &estimate.forces).copied().collect();
            unseen.error(&said).expect("forces")
        };
        let errors = [error(&found), error(&all.read(&unseen.signals))];
        assert!(errors[0] < 0.8 * errors[1], "{errors:?}");
    }
}

/// With limited look-ahead, later readings do not change the estimate of an instant, less look-ahead gives wider posteriors, and
/// errors match them.
#[test]
fn what_comes_too_late_is_not_looked_at() {
    let pool = crate::Pool::new(2).expect("threads");
    let read = |after: usize, cut: Option<usize>| {
        let lags = Lags { before: 39, after };
        let problem = Problem { decoder: Decoder { lags, ..problem().decoder }, ..problem() };
        let trial = PreparedTrial::new(&problem, &pool).expect("a trial");
        let mut brain = brain(&trial, 40);
        let mut draw = Draw::numbered(5, 2);
        let drawn: Vec<Vec<f64>> =
            (0..8).map(|_| normal(&mut draw, brain.guesses[0].prior.unknowns())).collect();
        let forces = brain.guesses[0].prior.forces(drawn.iter().map(Vec::as_slice));
        let (solver, counters) = (&trial.problem.solver, &mut Counters::default());
        let samples = trial.simulate(&trial.problem.initial, &forces, solver, false, counters).expect("some");
        let mut signals = samples.samples.signals;
        let width = brain.noise.channels();
        if let Some(cut) = cut {
            signals.chunks_exact_mut(40 * width).for_each(|one| one[cut * width..].fill(0.0));
        }
        let found = brain.read(&signals);
        let (mut square, mut covered, mut sure) = (0.0, 0, 0.0);
        for (estimate, truth) in found.iter().zip(samples.samples.targets.chunks_exact(80)) {
            for ((said, f), deviation) in estimate.forces.iter().zip(truth).zip(&estimate.deviations) {
                square += (said - f) * (said - f);
                covered += usize::from((said - f).abs() <= 1.96 * deviation);
                sure += deviation * deviation;
            }
        }
        (found, square, covered as f64 / (8.0 * 80.0), sure)
    };
    let known: Vec<_> = [0, 12, 39].map(|after| read(after, None)).into();
    for pair in known.windows(2) {
        assert!(pair[1].3 < pair[0].3, "deviations {} then {}", pair[0].3, pair[1].3);
    }
    let errors: Vec<f64> = known.iter().map(|known| known.1).collect();
    assert!(errors[2] < 0.8 * errors[0] && errors[1] < errors[0], "{errors:?}");
    for (_, square, covered, sure) in &known {
        assert!(
            (0.91..0.98).contains(covered) && (0.6..1.6).contains(&(square / sure)),
            "{covered} {square} {sure}"
        );
    }
    // Changes readings from instant 25 on; estimates that do not use them stay.
    for (i, after) in [0, 12].into_iter().enumerate() {
        let cut = read(after, Some(25)).0;
        for (whole, cut) in known[i].0.iter().zip(&cut) {
            let same = 2 * (25 - after);
            assert_eq!(whole.forces[..same], cut.forces[..same], "ahead {after}");
            assert_eq!(whole.deviations[..same], cut.deviations[..same], "ahead {after}");
            assert_ne!(whole.forces[same..], cut.forces[same..], "ahead {after}");
        }
    }
}

/// A failed simulation at the start is an outcome; equal forces have no prior.
#[test]
fn what_cannot_be_inverted_is_named() {
    let pool = crate::Pool::new(1).expect("a thread");
    let trial = PreparedTrial::new(&problem(), &pool).expect("a trial");
    let mut brain = brain(&trial, 20);
    let forces = trial.problem.forces(Purpose::Fresh, 0, 1);
    assert!(Prior::new(&forces.select(&[0, 0])).is_some_and(|prior| prior.unknowns() > 0));
    let still = crate::dynamics::Forces { values: vec![0.0; forces.values.len()], ..forces };
    assert!(Prior::new(&still).is_none());
    let wild = vec![f64::NAN; 40 * brain.noise.channels()];
    let found = brain.read(&wild);
    assert_eq!(found[0].ending, Ending::StartFailed);
    assert!(!found[0].is_explained());
    // The posterior is the prior.
    let prior = (0..40)
        .map(|n| brain.guesses[0].directions_of_targets.row(n).iter().map(|d| d * d).sum::<f64>().sqrt());
    let own = found[0].deviations.iter().step_by(2);
    assert!(prior.zip(own).all(|(prior, own)| (prior - own).abs() <= 1e-12), "{:?}", found[0].deviations);
}

/// Without noise, the curvature exceeds double precision: its eigenvalues are raised to 1, and no sample causes a panic.
#[test]
fn a_curvature_beyond_rounding_is_solved() {
    let exact = small(TrainingProtocol::Joint(GOING));
    let pool = crate::Pool::new(2).expect("threads");
    let trial = PreparedTrial::new(&exact, &pool).expect("a trial");
    let mut brain = brain(&trial, 20);
    let samples = trial.initial.signals.len() / 4;
    let found = brain.read(&trial.initial.signals[..samples]);
    assert!(found.iter().all(|estimate| estimate.deviations.iter().all(|d| d.is_finite())));
}
