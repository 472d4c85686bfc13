//! The protocols with a linear decoder, and linear decoders of other memories.

use super::super::protocol::Session;
use super::*;
use crate::brain::linear::{Lags, Sizes};
use crate::brains::{ScaledSamples, Stack, own_reading, readings, solve};
use crate::dynamics::{Precision, planned, run};
use crate::place::placed;
use crate::trial::{Placing, Samples};

const LINEAR: [TrainingProtocol; 4] = [
    TrainingProtocol::Paper(Terms::Implicit),
    TrainingProtocol::Paper(Terms::Direct),
    TrainingProtocol::Joint(GOING),
    TrainingProtocol::Random(GOING),
];

pub(super) fn linear(protocol: TrainingProtocol) -> Problem {
    let small = small(protocol);
    let decoder = Decoder { lags: Lags { before: 12, after: 6 }, ridge: RidgeChoice::Auto };
    Problem {
        decoder_kind: DecoderKind::Linear,
        decoder,
        optimise: OuterLoop { brain: DecoderKind::Linear, ..small.optimise },
        ..small
    }
}

fn errors(body: &BodyEvaluation) -> Vec<u64> {
    let own = &body.networks[0];
    let of = |e: Option<f64>| e.unwrap().to_bits();
    let readings = body.readings.iter().flat_map(|r| [r.error_train, r.error_test, r.error_holdout]);
    [own.error_train, own.error_test, own.error_holdout].into_iter().chain(readings).map(of).collect()
}

/// Resuming after each step, on another number of threads, gives the same bits. Steps report the λ of their fits.
#[test]
fn a_resumed_linear_loop_ends_at_the_same_bits_on_any_number_of_threads() {
    for protocol in LINEAR {
        let mut problem = linear(protocol);
        problem.optimise.iterations = 12;
        quicken(&mut problem);
        let mut whole = Keeper::default();
        let through = optimise(&problem, None, &pool(1), &mut whole).unwrap().unwrap();
        assert!(whole.reports.iter().all(|report| report.trouble.is_none()), "{protocol:?}");
        for stop in [1, 11] {
            let mut first = Keeper { stop_after: Some(stop), ..Default::default() };
            assert!(optimise(&problem, None, &pool(3), &mut first).unwrap().is_none());
            let state = first.states.pop().unwrap();
            assert_eq!(state, whole.states[stop - 1], "{protocol:?}, stopped after {stop}");
            let mut second = Keeper::default();
            let resumed = optimise(&problem, Some(state), &pool(2), &mut second).unwrap().unwrap();
            assert_eq!(resumed.optimised.design, through.optimised.design, "{protocol:?}, {stop}");
            assert_eq!(timeless(&second.reports), timeless(&whole.reports[stop..]), "{protocol:?}, {stop}");
            assert_eq!(errors(&resumed.optimised), errors(&through.optimised), "{protocol:?}, {stop}");
        }
        if matches!(protocol, TrainingProtocol::Joint(_)) {
            // a step reports the λ of its fit, its state has the next one
            for (state, next) in whole.states.iter().zip(&whole.reports[1..]) {
                assert_eq!(next.ridge, state.decoder_state.ridge);
            }
            assert_ne!(whole.reports[0].ridge, whole.reports[1].ridge);
        }
        assert!(whole.fractions.is_sorted() && whole.fractions.last() == Some(&1.0), "{:?}", whole.fractions);
    }
}

/// A trial with a sensor search has the bits of a trial with the chosen unit. Impossible searches are an error.
#[test]
fn a_searched_placement_is_a_given_one() {
    let mut problem = linear(LINEAR[2]);
    let candidates = vec![4, 5, 6, 7];
    let alone = |unit: usize| {
        let mut problem = problem.clone();
        problem.scene.sensors = vec![unit];
        let found = carried_out(&problem, 1);
        (errors(&found.initial), found)
    };
    let each: Vec<_> = candidates.iter().map(|&unit| alone(unit)).collect();
    let search = Placing { candidates: candidates.clone(), sensors: 1, turn: 0, spacing: 0.0 };
    problem.scene.sensors.clear();
    problem.search = Some(search.clone());
    let found = carried_out(&problem, 2);
    let placed = placed(&problem, &pool(2)).unwrap().1.unwrap();
    let chosen = candidates.iter().position(|unit| [*unit] == placed.units[..]).unwrap();
    assert_eq!(errors(&found.initial), each[chosen].0);
    assert_eq!(found.optimised.design, each[chosen].1.optimised.design);
    // the search uses twelve training samples only; its unit is not the worst on the held-out set
    let holdout = |i: usize| each[i].1.initial.readings[0].error_holdout.unwrap();
    assert!((0..4).any(|i| holdout(i) > holdout(chosen)), "{placed:?}");
    problem.search = Some(Placing { sensors: 5, ..search });
    let nowhere = optimise(&problem, None, &pool(1), &mut Keeper::default()).unwrap_err();
    assert_eq!(nowhere, Failure::Initial(Trouble::Nowhere));
}

/// On every lattice, the first unit chosen has the least error of all single units; two units keep the given spacing.
#[test]
fn the_first_unit_is_the_best_alone_on_every_lattice() {
    for (what, mut problem) in on_lattices(&linear(LINEAR[2])) {
        let layout = problem.scene.layout.clone();
        let candidates = layout.placement(0, &problem.scene.clamped);
        problem.scene.sensors.clear();
        let mut searched = |candidates: &[usize], sensors: usize, spacing: f64| {
            let candidates = candidates.to_vec();
            problem.search = Some(Placing { candidates, sensors, turn: 0, spacing });
            placed(&problem, &pool(2)).map(|found| found.1.expect("searched"))
        };
        let alone = |&unit: &usize| searched(&[unit], 1, 0.0).expect("a place");
        let alone: Vec<_> = candidates.iter().map(alone).collect();
        let first = searched(&candidates, 1, 0.0).expect("a place");
        let own = alone.iter().find(|one| one.units == first.units).expect("a candidate");
        let least = alone.iter().map(|one| one.errors[0]).fold(f64::INFINITY, f64::min);
        assert!(own.errors[0] == least, "{what}: {first:?} {alone:?}");
        // each single-unit search decides by itself whether to use energies
        let off = (first.errors[0] / own.errors[0] - 1.0).abs();
        assert!(off < 1e-3 || first.energies != own.energies, "{what}: {first:?} {own:?}");
        if let Ok(two) = searched(&candidates, 2, 20.0) {
            assert!(layout.are_apart(two.units[0], two.units[1], 20.0), "{what}: {two:?}");
        }
    }
}

/// Each protocol lowers the held-out error of the trial's decoder; `joint` also that of the whole-sample decoder.
#[test]
fn every_protocol_lowers_the_holdout_error() {
    let errors = LINEAR.map(|protocol| {
        let mut problem = linear(protocol);
        (problem.optimise.iterations, problem.optimise.rate) = (15, 0.2);
        problem.stimuli = ForceSets { samples: 48, test: 8, holdout: 16, ..problem.stimuli };
        if let TrainingProtocol::Joint(going) = &mut problem.optimise.protocol {
            going.batch = 16;
        }
        let found = carried_out(&problem, 2);
        [&found.initial, &found.optimised]
            .map(|body| [body.networks[0].error_holdout, body.readings[0].error_holdout].map(Option::unwrap))
    });
    assert!(errors.iter().all(|[before, after]| after[0] < 0.9 * before[0]), "{errors:?}");
    assert!(errors[2..3].iter().all(|[before, after]| after[1] < before[1]), "{errors:?}");
}

/// L(α + εδ) = L(α) + ε g·δ + O(ε²) through simulation and fit: the remainder has order 2 for the test error with the implicit
/// term, and not without this term.
#[test]
fn the_whole_gradient_holds_through_simulator_and_solve() {
    for (protocol, exact) in [(LINEAR[0], true), (LINEAR[1], false)] {
        let mut problem = linear(protocol);
        problem.scene.density *= 4.0; // fewer steps
        check_the_whole_gradient(problem, exact);
    }
}

pub(super) fn check_the_whole_gradient(mut problem: Problem, exact: bool) {
    let ridge = 1e-3;
    problem.solver.accuracy = Accuracy(1e-11);
    problem.decoder.ridge = RidgeChoice::Given(ridge);
    problem.optimise.coarse = None;
    let pool = pool(2);
    let trial = PreparedTrial::new(&problem, &pool).unwrap();
    let mut keeper = Keeper::default();
    let mut log = Log::new(0, &mut keeper);
    let mut state = State::new(&problem);
    let gradient = Session::new(&trial).train_and_differentiate(&mut state, &mut log).unwrap().gradient;

    let loss = |design: &[f64]| {
        let set = |forces| {
            let counters = &mut Counters::default();
            let found = trial.simulate(design, forces, &problem.solver, false, counters).unwrap();
            ScaledSamples::of(&found.samples, &trial.scales, &pool)
        };
        let train = set(&trial.train);
        let linear = solve(train.normal(problem.decoder.lags), ridge).unwrap().linear();
        let test = set(&trial.test);
        0.01 * test.error(&linear.predict(&test.x)).unwrap()
    };
    let mut stream = Stream::new(Purpose::Design, 1, [0, 0]);
    let direction: Vec<f64> = gradient.iter().map(|_| stream.normal()).collect();
    let slope: f64 = gradient.iter().zip(&direction).map(|(g, d)| g * d).sum();
    let at = |step: f64| {
        loss(&problem.initial.iter().zip(&direction).map(|(a, d)| a + step * d).collect::<Vec<_>>())
    };
    let (start, steps) = (at(0.0), [4e-3, 2e-3, 1e-3]);
    let remainders = steps.map(|step| (at(step) - start - step * slope).abs());
    let orders = [0, 1].map(|i| (remainders[i] / remainders[i + 1]).log2());
    let second = orders.iter().all(|order| (1.8..2.2).contains(order));
    assert!(second == exact && slope.abs() > 1e-4, "{slope:e} {orders:?} {remainders:?}");
}

/// λ = 0 with fewer samples than weights is an error of the initial body.
#[test]
fn a_singular_solve_is_named() {
    let mut problem = linear(LINEAR[0]);
    problem.decoder = Decoder { lags: Lags::whole(40), ridge: RidgeChoice::Given(0.0) };
    problem.stimuli.samples = 6;
    let failure = optimise(&problem, None, &pool(1), &mut Keeper::default()).unwrap_err();
    assert_eq!(failure, Failure::Initial(Trouble::Singular));
}

/// `readings` lists the whole-sample decoder first, and each entry has the error of a separate fit. It agrees with the trial's own
/// whole-sample decoder.
#[test]
fn readings_are_those_of_their_own_fits() {
    let mut problem = small(PROTOCOLS[2]);
    problem.optimise.iterations = 0;
    let found = carried_out(&problem, 1).initial;
    let lags: Vec<Lags> = found.readings.iter().map(|reading| reading.lags).collect();
    assert!(lags[0] == Lags::whole(40) && lags.len() > 6, "{lags:?}");
    assert!(lags.contains(&Lags { before: 39, after: 0 }) && lags.contains(&Lags { before: 2, after: 2 }));

    let pool = pool(1);
    let mut trial = PreparedTrial::new(&problem, &pool).unwrap();
    let holdout = problem.holdout();
    let sets: [Samples; 3] = [&trial.train, &trial.test, &holdout].map(|forces| {
        let (counters, solver) = (&mut Counters::default(), &trial.problem.solver);
        trial.simulate(&problem.initial, forces, solver, false, counters).unwrap().samples
    });
    for reading in &found.readings {
        trial.problem.decoder = Decoder { lags: reading.lags, ridge: RidgeChoice::Given(reading.ridge) };
        let alone = own_reading(&trial, &sets, &mut Vec::new()).unwrap();
        let (a, b) = (reading.error_holdout.unwrap(), alone.error_holdout.unwrap());
        assert!((a / b - 1.0).abs() < 1e-6, "{reading:?} {alone:?}");
    }

    problem.decoder_kind = DecoderKind::Linear;
    let own = optimise(&problem, None, &pool, &mut Keeper::default()).unwrap().unwrap().initial;
    assert_eq!(own.networks.len(), 1);
    assert_eq!(own.networks[0].error_holdout, own.readings[0].error_holdout);
    assert_eq!(own.readings, found.readings);
}

/// Rounding to f32 hardly matters: the errors of linear decoders agree within 1 % with those from f64 signals.
#[test]
fn readings_of_forces_in_single_precision_are_those_in_double() {
    let mut problem = small(PROTOCOLS[1]);
    (problem.solver.accuracy, problem.optimise.coarse) = (Accuracy(1e-3), None);
    let pool = pool(1);
    let trial = PreparedTrial::new(&problem, &pool).unwrap();
    let found = super::super::optimise(&trial, None, &mut Keeper::default()).unwrap().unwrap();
    let holdout = problem.holdout();
    for body in [&found.initial, &found.optimised] {
        let solver = if body.design == problem.initial {
            trial.problem.solver
        } else {
            trial.tuned(&body.design).solver
        };
        let sets: [Samples; 3] = [&trial.train, &trial.test, &holdout].map(|forces| {
            let plan = planned(&problem.scene, &body.design, forces, &solver);
            assert_eq!(plan.precision, Precision::Single, "or this shows nothing: {}", plan.reason);
            let signals = run(&problem.scene, &body.design, forces, &plan.double(), false, &pool).signals;
            problem.samples(signals, forces)
        });
        for (own, double) in body.readings.iter().zip(readings(&trial, &sets).unwrap()) {
            let off = own.error_holdout.unwrap() / double.error_holdout.unwrap() - 1.0;
            assert!(off.abs() < 0.01 && off != 0.0, "{own:?}: {off:e}");
        }
    }
}

/// A stacked network has additional inputs. Its estimates of training samples are out-of-fold.
#[test]
fn a_stacked_network_sees_no_estimate_of_what_it_was_fitted_on() {
    let mut problem = Problem { decoder_kind: DecoderKind::Stacked, ..linear(LINEAR[2]) };
    problem.stimuli.samples = 30;
    problem.brain.iterations = 60;
    let found = carried_out(&problem, 2);
    let network = &found.optimised.networks[0];
    assert_eq!((found.optimised.networks.len(), problem.reader_shape().inputs), (2, 5));
    assert_eq!(network.weights.len(), problem.reader_shape().weights());
    let pool = pool(1);
    let trial = PreparedTrial::new(&problem, &pool).unwrap();
    let stack =
        Stack::new(&problem.decoder, problem.seed, &trial.initial, trial.scales.clone(), &pool).unwrap();
    let known = ScaledSamples::of(&trial.initial, &trial.scales, &pool);
    let [seen, unseen] =
        [stack.estimates(&trial.initial.signals), stack.cross_fitted()].map(|y| known.error(&y));
    assert!(unseen > seen, "{unseen:?} {seen:?}");
}

/// λ of the linear part of a stacked decoder is that of the reading with the trial's memory, also if that memory is a preset.
#[test]
fn a_reading_has_the_ridge_of_the_stacked_decoder() {
    let mut problem = Problem { decoder_kind: DecoderKind::Stacked, ..linear(LINEAR[2]) };
    (problem.optimise.iterations, problem.brain.iterations) = (0, 2);
    let pool = pool(1);
    for lags in [Lags { before: 12, after: 6 }, Lags { before: 2, after: 2 }, Lags::whole(40)] {
        problem.decoder.lags = lags;
        let readings = carried_out(&problem, 1).initial.readings;
        let trial = PreparedTrial::new(&problem, &pool).unwrap();
        let scales = trial.scales.clone();
        let stack = Stack::new(&problem.decoder, problem.seed, &trial.initial, scales, &pool).unwrap();
        let own: Vec<f64> = readings.iter().filter(|own| own.lags == lags).map(|own| own.ridge).collect();
        assert_eq!(own, [stack.ridge], "{lags:?}");
    }
}

/// Under the trial's own forces, the carried decoder is the one of the comparison, and the refitted decoder agrees on the initial
/// body. Under faster forces the errors differ; under forces that break the body there is none.
#[test]
fn a_body_is_read_under_other_forces() {
    let mut own = linear(TrainingProtocol::Joint(GOING));
    own.solver.accuracy = Accuracy(3e-2);
    let HistorySource::Bell(bell) = own.stimuli.source else { panic!("bells") };
    let fast = HistorySource::Bell(Bell { width: [0.005, 0.01], ..bell });
    let noisy = ChipErrors { noise: Size::Relative(0.01), delay: 0.001, ..ChipErrors::NONE };
    for disturbance in [None, Some(noisy)] {
        let mut problem =
            Problem { under: vec![HistorySource::Bell(bell), fast.clone()], disturbance, ..own.clone() };
        problem.optimise.iterations = 3;
        let found = carried_out(&problem, 1);
        let again = carried_out(&problem, 3);
        assert_eq!(found.under, again.under, "the number of threads");
        for (body, under) in [&found.initial, &found.optimised].into_iter().zip(&found.under) {
            let expected = body.networks[0].error_holdout;
            let asked: Vec<(usize, bool)> = under.iter().map(|reading| (reading.kind, reading.own)).collect();
            assert_eq!(asked, [(0, true), (0, false), (1, true), (1, false)]);
            let near = |reading: &UnderReading| {
                let error = reading.error.unwrap().unwrap();
                (error / expected.unwrap() - 1.0).abs() < 1e-9
            };
            let first = usize::from(body.design != problem.initial);
            assert!(under[first..2].iter().all(near), "{expected:?}: {under:?}");
            let [own, carried] = [2, 3].map(|i| under[i].error.unwrap().unwrap());
            assert!(own != carried && own > 0.0 && Some(own) != expected, "{own} {carried}");
        }
    }
    let hard = HistorySource::Bell(Bell { amplitude: [1e6, 2e6], ..bell });
    let problem = Problem { under: vec![hard], ..own };
    let found = carried_out(&problem, 1);
    assert!(found.under[0].iter().all(|reading| reading.error.is_err()), "{:?}", found.under);
}

/// Decoding accelerations alone equals decoding all signals with the columns of ω deleted.
#[test]
fn channels_that_are_not_read_are_columns_that_are_not_there() {
    let mut problem = linear(TrainingProtocol::Joint(GOING));
    (problem.scene.sensors, problem.optimise.iterations) = (vec![6, 7], 0);
    problem.stimuli.holdout = 6;
    let pool = pool(1);
    let some = Problem { channels: vec![0, 1], ..problem.clone() };
    let found = optimise(&some, None, &pool, &mut Keeper::default()).unwrap().unwrap();
    let deleted = |all: &Samples| {
        let columns = all.signals.chunks_exact(6).flat_map(|s| [s[0], s[1], s[3], s[4]]).collect();
        let sizes = Sizes { channels: 4, ..all.sizes };
        Samples::new(sizes, columns, all.targets.clone())
    };
    let trial = PreparedTrial::new(&problem, &pool).unwrap();
    let solver = trial.problem.solver;
    let unseen = trial.problem.forces(Purpose::Holdout, 0, 6);
    let counters = &mut Counters::default();
    let unseen = trial.simulate(&problem.initial, &unseen, &solver, false, counters).unwrap().samples;
    let brain = problem.decoder.fit(problem.seed, &deleted(&trial.initial), None, &pool).unwrap();
    let unseen = deleted(&unseen);
    let (own, wanted) =
        (found.initial.networks[0].error_holdout.unwrap(), unseen.error(&brain.predict(&unseen.signals)));
    assert!((own / wanted.unwrap() - 1.0).abs() < 1e-9, "{own} {wanted:?}");
}
