use super::*;
use crate::brain::{self, Data, TrainOutcome, Workspace};
use crate::dynamics::{Accuracy, Integrator, IntegratorSettings};
use crate::feasible::FeasibleSet;
use crate::random::{Purpose, Stream};
use crate::stimuli::{Bell, HistorySource};
use crate::trial::{
    ChipErrors, Counters, Decoder, DecoderKind, DesignWithSolver, ForceSets, Normalisation, OuterLoop,
    Problem, RateSchedule, RidgeChoice, Size, StepTraining, Terms, TrainingProtocol, Trouble,
};

mod casts;
mod failing;
mod known;
mod linear;
pub(crate) mod small;
mod tasks;

pub(crate) use small::{GOING, on_lattices, small};

const PROTOCOLS: [TrainingProtocol; 3] = [
    TrainingProtocol::Paper(Terms::Implicit),
    TrainingProtocol::Joint(GOING),
    TrainingProtocol::Random(GOING),
];

/// Optimises the body of a problem, after the sensor search if there is one.
fn optimise(
    problem: &Problem,
    resume: Option<State>,
    pool: &crate::Pool,
    observer: &mut dyn Observe,
) -> Result<Option<Optimised>, Failure> {
    super::optimise(&PreparedTrial::new(&crate::place::placed(problem, pool)?.0, pool)?, resume, observer)
}

/// A whole trial.
fn carried_out(problem: &Problem, threads: usize) -> Optimised {
    optimise(problem, None, &pool(threads), &mut Keeper::default()).unwrap().unwrap()
}

/// Reduces the number of steps, for tests that do not depend on accuracy.
fn quicken(problem: &mut Problem) {
    (problem.solver.accuracy, problem.scene.density) = (Accuracy(3e-2), 4.0 * problem.scene.density);
}

fn pool(threads: usize) -> crate::Pool {
    crate::Pool::new(threads).unwrap()
}

/// Keeps everything it receives, and stops after `stop_after` steps. Its clock counts its own reads, or stands still.
#[derive(Default)]
struct Keeper {
    reads: f64,
    clock_stands: bool,
    saved: Vec<State>,
    reports: Vec<Report>,
    states: Vec<State>,
    fractions: Vec<f64>,
    stop_after: Option<usize>,
}

impl Observe for Keeper {
    fn seconds(&mut self) -> f64 {
        self.reads += if self.clock_stands { 0.0 } else { 1.0 };
        self.reads
    }
    fn progress(&mut self, fraction: f64) -> LoopControl {
        self.fractions.push(fraction);
        LoopControl::Continue
    }
    fn save(&mut self, state: &State) {
        self.saved.push(state.clone());
    }
    fn step(&mut self, report: &Report, state: &State) -> LoopControl {
        self.reports.push(report.clone());
        self.states.push(state.clone());
        if Some(self.reports.len()) == self.stop_after { LoopControl::Stop } else { LoopControl::Continue }
    }
}

/// The reports without their times.
fn timeless(reports: &[Report]) -> Vec<Report> {
    reports.iter().map(|report| Report { seconds: Seconds::default(), ..report.clone() }).collect()
}

fn figures(body: &BodyEvaluation) -> Vec<u64> {
    let network =
        |n: &NetworkEvaluation| [n.error_train, n.error_test, n.error_holdout].map(|e| e.unwrap().to_bits());
    let on_the_way = |n: &NetworkEvaluation| n.errors.iter().map(|e| e.1.to_bits()).collect::<Vec<_>>();
    body.networks.iter().flat_map(|n| [network(n).to_vec(), on_the_way(n)].concat()).collect()
}

/// A network trained for 7 iterations has the error that a longer training recorded at this point.
#[test]
fn errors_on_the_way_are_those_of_a_training_that_ends_there() {
    let mut problem = small(PROTOCOLS[0]);
    (problem.evaluation.schedule, problem.brain.iterations) = (RateSchedule::Constant, 12);
    let evaluated = |problem: &Problem| carried_out(problem, 1).initial.networks;
    let long = evaluated(&problem);
    problem.brain.iterations = 7;
    let short = evaluated(&problem);
    for (long, short) in long.iter().zip(&short) {
        let iterations: Vec<u32> = long.errors.iter().map(|e| e.0).collect();
        assert_eq!(iterations, (1..=12).collect::<Vec<_>>());
        assert_eq!(Some(long.errors[7].1), short.error_holdout);
        assert_eq!(long.errors[..7], short.errors);
    }
}

/// Resuming after each step, on another number of threads, gives the same bits.
#[test]
fn a_resumed_loop_ends_at_the_same_bits_on_any_number_of_threads() {
    let tied = |problem: Problem| Problem { tie: [2, 2], frozen: vec![6], ..problem };
    let problems = PROTOCOLS.map(|protocol| [small(protocol), tied(small(protocol))]);
    for mut problem in problems.into_iter().flatten() {
        let protocol = problem.optimise.protocol;
        quicken(&mut problem);
        let mut whole = Keeper::default();
        let through = optimise(&problem, None, &pool(1), &mut whole).unwrap().unwrap();
        assert_eq!(whole.reports.len(), 4, "{protocol:?}");
        for stop in [1, 3] {
            let mut first = Keeper { stop_after: Some(stop), ..Default::default() };
            assert!(optimise(&problem, None, &pool(3), &mut first).unwrap().is_none());
            let state = first.states.pop().unwrap();
            assert_eq!(state, whole.states[stop - 1], "{protocol:?}, stopped after {stop}");
            let mut second = Keeper::default();
            let resumed = optimise(&problem, Some(state), &pool(2), &mut second).unwrap().unwrap();
            assert_eq!(
                resumed.optimised.design, through.optimised.design,
                "{protocol:?}, stopped after {stop}"
            );
            assert_eq!(
                figures(&resumed.optimised),
                figures(&through.optimised),
                "{protocol:?}, stopped after {stop}"
            );
            assert_eq!(timeless(&second.reports), timeless(&whole.reports[stop..]), "{protocol:?}");
        }
        assert!(whole.fractions.is_sorted() && whole.fractions.last() == Some(&1.0), "{:?}", whole.fractions);
    }
}

/// Training in one piece, in pieces of two iterations, or resumed from a saved state on another number of threads gives the same
/// bits and the same counts.
#[test]
fn a_comparison_goes_on_from_each_saved_state_to_the_same_bits() {
    for reader in [DecoderKind::Network, DecoderKind::Linear, DecoderKind::Stacked] {
        let mut problem = Problem { decoder_kind: reader, ..small(PROTOCOLS[2]) };
        (problem.optimise.iterations, problem.brain.iterations, problem.evaluation.long) = (2, 4, Some(6));
        quicken(&mut problem);
        let run = |state, threads, clock_stands| {
            let mut keeper = Keeper { clock_stands, ..Keeper::default() };
            let found = optimise(&problem, state, &pool(threads), &mut keeper).unwrap().unwrap();
            ((found.initial, found.optimised, found.counters), keeper)
        };
        let (whole, keeper) = run(None, 1, true);
        assert_eq!(keeper.saved, [], "{reader:?}");
        let (in_pieces, keeper) = run(None, 1, false);
        assert_eq!(in_pieces, whole, "{reader:?}");
        let least = if reader == DecoderKind::Linear { 1 } else { 2 * 2 * (4 + 6) / 3 };
        assert!(keeper.saved.len() >= least, "{reader:?}: saved {} times", keeper.saved.len());
        let within = keeper.saved.iter().filter(|state| state.comparison.training.is_some()).count();
        assert!(reader == DecoderKind::Linear || within > 6, "{reader:?}: {within} within a training");
        // every third state within a training
        let every = |(n, state): &(usize, State)| n % 3 == 0 || state.comparison.training.is_none();
        for (n, state) in keeper.saved.into_iter().enumerate().filter(every) {
            let (found, again) = run(Some(state), 1 + n % 3, true);
            assert_eq!(found, whole, "{reader:?}, saved as number {n}");
            assert_eq!(again.reports, [], "{reader:?}");
        }
    }
}

/// A diverging training ends with the same weights and the same error name wherever it is paused.
#[test]
fn a_training_that_goes_wrong_does_so_in_pieces_too() {
    let mut problem = small(PROTOCOLS[2]);
    (problem.optimise.iterations, problem.evaluation.seeds) = (0, 1);
    let mut names = Vec::new();
    for rate in [1e4, 1e18] {
        problem.brain.rate = rate;
        let run = |clock_stands| {
            let mut keeper = Keeper { clock_stands, ..Keeper::default() };
            optimise(&problem, None, &pool(1), &mut keeper).unwrap().unwrap().initial
        };
        let (whole, in_pieces) = (run(true), run(false));
        names.push(whole.networks[0].trouble.expect("trouble").name());
        assert_eq!(whole, in_pieces, "{rate}");
    }
    assert!(
        names.iter().all(|name| ["diverged", "loss_non_finite", "dead_layer"].contains(name)),
        "{names:?}"
    );
}

/// Names of failures can be parsed back.
#[test]
fn troubles_are_known_by_their_names() {
    let outcomes = [TrainOutcome::NonFinite, TrainOutcome::Diverged, TrainOutcome::DeadLayer(2)];
    let trainings = outcomes.map(Trouble::Training);
    let others = [
        Trouble::LossJump(3.0),
        Trouble::GradientNonFinite,
        Trouble::Singular,
        Trouble::Nowhere,
        Trouble::Saturated,
    ];
    let simulations = crate::dynamics::Outcome::ALL.map(Trouble::Simulation);
    for trouble in trainings.into_iter().chain(others).chain(simulations) {
        assert_eq!(Trouble::named(trouble.name()).map(Trouble::name), Some(trouble.name()));
    }
    assert_eq!(Trouble::named("no such thing"), None);
}

/// Another held-out set changes only the held-out errors.
#[test]
fn the_holdout_steers_nothing() {
    let mut problem = small(TrainingProtocol::Paper(Terms::Direct));
    let mut keepers = [Keeper::default(), Keeper::default()];
    let mut results = Vec::new();
    for (holdout, keeper) in [4, 7].into_iter().zip(&mut keepers) {
        problem.stimuli.holdout = holdout;
        results.push(optimise(&problem, None, &pool(1), keeper).unwrap().unwrap());
    }
    assert_eq!(keepers[0].states, keepers[1].states);
    let (a, b) = (&results[0].optimised.networks[0], &results[1].optimised.networks[0]);
    assert_eq!((a.error_test, &a.losses), (b.error_test, &b.losses));
    assert_ne!(a.error_holdout, b.error_holdout);
}

/// All bodies get networks of the same initial weights, one set per seed. Without outer steps the one body is evaluated once.
#[test]
fn bodies_are_compared_with_the_same_networks() {
    let mut problem = small(TrainingProtocol::Paper(Terms::Direct));
    problem.optimise.iterations = 0;
    let pool = pool(1);
    let trial = PreparedTrial::new(&problem, &pool).unwrap();
    let twice = vec![problem.initial.clone(); 2];
    let [first, second] = evaluate_designs(&trial, &twice, &mut Keeper::default()).try_into().unwrap();
    assert_eq!(first, second);
    let losses: Vec<_> = first.networks.iter().map(|n| &n.losses).collect();
    assert_eq!((losses[0].len(), losses[1].len()), (30, 30));
    assert_ne!(losses[0], losses[1]);
    assert_eq!(first.zero_samples, [0; 3]);
    let result = optimise(&problem, None, &pool, &mut Keeper::default()).unwrap().unwrap();
    assert_eq!([&result.initial, &result.optimised], [&first; 2]);
    assert_eq!(result.counters.brain_iterations, 2 * 30);
}

/// The evaluation of a body depends neither on the trial's initial body nor on its signal scale.
#[test]
fn a_body_is_read_on_its_own_scale() {
    let begun_with = small(TrainingProtocol::Joint(GOING));
    let mut stream = Stream::new(Purpose::Design, 2, [0, 0]);
    let other: Vec<f64> = begun_with.initial.iter().map(|a| a + 0.4 * stream.normal()).collect();
    for reader in [DecoderKind::Network, DecoderKind::Stacked] {
        let mine = Problem { decoder_kind: reader, ..begun_with.clone() };
        let its_own = Problem { initial: other.clone(), ..mine.clone() };
        let [here, there] = [&mine, &its_own].map(|problem| {
            let pool = pool(1);
            let trial = PreparedTrial::new(problem, &pool).unwrap();
            evaluate_designs(&trial, std::slice::from_ref(&other), &mut Keeper::default()).remove(0)
        });
        assert_ne!(here.networks[0].weights, there.networks[0].weights);
        // a stacked network also uses linear estimates, whose λ depends on the trial's scale
        if reader == DecoderKind::Network {
            assert_eq!(figures(&here), figures(&there));
        }
    }
}

/// There are as many long trainings as ordinary ones, from the same initial weights; the ordinary ones do not change.
#[test]
fn long_trainings_stand_beside_the_ordinary_ones() {
    let mut problem = small(TrainingProtocol::Paper(Terms::Direct));
    problem.optimise.iterations = 0;
    let plain = carried_out(&problem, 1);
    problem.evaluation.long = Some(70);
    let mut keeper = Keeper::default();
    let long = optimise(&problem, None, &pool(1), &mut keeper).unwrap().unwrap();
    assert_eq!(long.optimised.networks, plain.optimised.networks);
    assert!(plain.optimised.long.is_empty());
    for (long, ordinary) in long.optimised.long.iter().zip(&long.optimised.networks) {
        assert_eq!((long.losses.len(), long.losses[0]), (70, ordinary.losses[0]));
        assert!(long.losses[69] < ordinary.losses[29], "{:?} {:?}", long.losses, ordinary.losses);
        assert!(long.error_holdout.is_some() && long.weights.is_empty());
    }
    assert_eq!(long.counters.brain_iterations, 2 * (30 + 70));
    assert!(keeper.fractions.is_sorted() && keeper.fractions.last() == Some(&1.0), "{:?}", keeper.fractions);
}

/// Every design of a tied loop is α₀ + P z and feasible, for any protocol and rate. Frozen units stay, others move.
#[test]
fn tied_shifts_stay_tied_and_castable() {
    let squares = PROTOCOLS.map(|protocol| (format!("{protocol:?}"), small(protocol)));
    let others = on_lattices(&small(TrainingProtocol::Joint(GOING)));
    for (what, problem) in squares.into_iter().chain(others) {
        let (protocol, last) = (problem.optimise.protocol, problem.scene.panels[0].unit);
        let other = (0..last).rev().find(|unit| !problem.scene.clamped.contains(unit)).expect("a unit");
        let mut problem = Problem { tie: [2, 1], frozen: vec![other, last], ..problem };
        let search = protocol.is_search();
        (problem.optimise.rate, problem.optimise.iterations) = (if search { 5.0 } else { 2.0 }, 6);
        (problem.evaluation.seeds, problem.brain.iterations) = (1, 3);
        quicken(&mut problem);
        let mut keeper = Keeper::default();
        optimise(&problem, None, &pool(2), &mut keeper).unwrap().unwrap();
        let (freedom, layout) = (problem.body.freedom(&problem), &problem.scene.layout);
        let limits = FeasibleSet::new(layout, problem.limits, &[]);
        let mut projected = 0;
        for (state, report) in keeper.states.iter().zip(&keeper.reports) {
            let design = &state.design;
            assert_eq!(&freedom.snap(&problem.initial, design.clone()), design, "{what}");
            assert_eq!(limits.violations(design), [], "{what}, step {}", state.step);
            let moved =
                |unit: usize| layout.vertices(design)[unit] != layout.vertices(&problem.initial)[unit];
            assert!(!moved(other) && !moved(last), "{what}");
            projected += usize::from(report.projection == Some(crate::feasible::Status::Projected));
        }
        let statuses: Vec<_> = keeper.reports.iter().map(|r| (r.projection, r.projection_distance)).collect();
        assert!(projected > 0 && keeper.states[5].design != problem.initial, "{what} {statuses:?}");
    }
}

/// A search evaluates the initial body, then its candidates, and keeps the best.
#[test]
fn a_search_keeps_the_best_of_its_candidates() {
    let protocol = TrainingProtocol::Random(GOING);
    let mut problem = small(protocol);
    (problem.optimise.iterations, problem.optimise.brain, problem.decoder_kind) =
        (25, DecoderKind::Linear, DecoderKind::Linear);
    problem.optimise.rate = 1.0;
    let mut keeper = Keeper::default();
    let found = optimise(&problem, None, &pool(2), &mut keeper).unwrap().unwrap();
    let errors: Vec<f64> = keeper.reports.iter().map(|r| r.error_test.unwrap()).collect();
    let least = errors.iter().copied().fold(f64::INFINITY, f64::min);
    let at = errors.iter().position(|e| *e == least).unwrap();
    assert_eq!(found.best_step as usize, at, "{errors:?}");
    assert!(at > 0 && least < errors[0], "{errors:?}");
    let last = keeper.states.last().unwrap();
    assert_eq!(last.best.as_ref().unwrap().design, keeper.states[at - 1].design);
    assert_eq!(last.fitness.len(), 24, "the first step reads the initial body");
    let worse = last.fitness.iter().zip(&errors[1..]).all(|(fitness, error)| fitness >= error);
    assert!(worse, "{:?} {errors:?}", last.fitness);
}

#[test]
fn the_direct_term_is_the_derivative_of_the_test_loss_at_fixed_weights() {
    check_the_direct_term(None, small(TrainingProtocol::Paper(Terms::Direct)));
}

/// The same along z, with tied and frozen shifts.
#[test]
fn the_direct_term_holds_where_shifts_are_tied() {
    let plain = small(TrainingProtocol::Paper(Terms::Direct));
    check_the_direct_term(None, Problem { tie: [2, 2], frozen: vec![6], ..plain });
}

/// The same with delayed, noisy and biased sensors.
#[test]
fn the_direct_term_holds_through_disturbed_sensors() {
    let (noise, bias) = (Size::Relative(0.05), Size::Physical([10.0, 0.1]));
    let disturbance = ChipErrors { noise, bias, delay: 0.0123, ..ChipErrors::NONE };
    check_the_direct_term(Some(disturbance), small(TrainingProtocol::Paper(Terms::Direct)));
}

/// The same with extremes of the initial body's training samples as scales.
#[test]
fn the_direct_term_holds_at_scales_by_extremes() {
    let mut problem = small(TrainingProtocol::Paper(Terms::Direct));
    problem.brain.scaling = Normalisation::Extremes;
    check_the_direct_term(None, problem);
}

/// Signals of the initial body span [−1, 1] and forces [0, 1]. The comparison uses these scales for every body.
#[test]
fn scales_by_extremes_serve_every_body() {
    let mut problem = small(TrainingProtocol::Joint(GOING));
    problem.brain.scaling = Normalisation::Extremes;
    let pool = pool(1);
    let trial = PreparedTrial::new(&problem, &pool).unwrap();
    let scales = &trial.network_scales;
    let within = |values: Vec<f64>, width: usize, ends: [f64; 2]| {
        for column in 0..width {
            let column = values.iter().skip(column).step_by(width);
            let [least, most] = column.fold([f64::MAX, f64::MIN], |[a, b], x| [a.min(*x), b.max(*x)]);
            assert!((least - ends[0]).abs() < 1e-12 && (most - ends[1]).abs() < 1e-12, "{least} {most}");
        }
    };
    within(scales.inputs(&trial.initial.signals), 3, [-1.0, 1.0]);
    within(scales.targets(&trial.initial.targets), 2, [0.0, 1.0]);
    let [_, network] = trial.scales_of(&[1.0; 3]);
    assert_eq!(network, *scales);
}

/// The same with a low-pass, whose clock is finer than that of the forces.
#[test]
fn the_direct_term_holds_behind_a_low_pass() {
    for (bandwidth, delay) in [(60.0, 0.0), (90.0, 0.0041)] {
        let disturbance = ChipErrors { bandwidth, delay, ..ChipErrors::NONE };
        check_the_direct_term(Some(disturbance), small(TrainingProtocol::Paper(Terms::Direct)));
    }
}

/// The same with a subset of the channels.
#[test]
fn the_direct_term_holds_through_some_channels() {
    let noise = Size::Relative(0.05);
    for channels in [vec![0, 1], vec![2]] {
        let disturbance = ChipErrors { noise, delay: 0.0123, ..ChipErrors::NONE };
        let problem = Problem { channels, ..small(TrainingProtocol::Paper(Terms::Direct)) };
        check_the_direct_term(Some(disturbance), problem);
    }
}

/// The same with signals that often exceed the sensors' range; these readings have no gradient.
#[test]
fn the_direct_term_holds_where_sensors_saturate() {
    let plain = small(TrainingProtocol::Paper(Terms::Direct));
    let pool = pool(1);
    let trial = PreparedTrial::new(&plain, &pool).unwrap();
    let range = [trial.scales.channels[0], trial.scales.channels[2]];
    let beyond = |(i, x): (usize, &f64)| x.abs() > range[usize::from(i % 3 == 2)];
    assert!(trial.initial.signals.iter().enumerate().filter(|&(i, x)| beyond((i, x))).count() > 10);
    let disturbance = ChipErrors { range, ..ChipErrors::NONE };
    check_the_direct_term(Some(disturbance), small(TrainingProtocol::Paper(Terms::Direct)));
}

/// A range below most signals, as from m/s² instead of mm/s², is an error before training; a range above most signals is not.
#[test]
fn a_range_below_the_signals_is_named() {
    let (plain, pool) = (small(TrainingProtocol::Paper(Terms::Direct)), pool(1));
    let with = |part: f64| {
        let trial = PreparedTrial::new(&plain, &pool).unwrap();
        let range = [0, 2].map(|c: usize| part * trial.scales.channels[c]);
        let disturbance = Some(ChipErrors { range, ..ChipErrors::NONE });
        PreparedTrial::new(&Problem { disturbance, ..plain.clone() }, &pool).map(|_| ())
    };
    assert_eq!(with(1e-3), Err(Failure::Initial(Trouble::Saturated)));
    assert_eq!(with(1.0), Ok(()));
}

/// Compares the gradient with central differences of L_test(α + εδ) (N²) at fixed weights, along a random direction.
fn check_the_direct_term(disturbance: Option<ChipErrors>, problem: Problem) {
    let mut problem = Problem { disturbance, ..problem };
    problem.solver.accuracy = Accuracy(1e-10);
    let pool = pool(2);
    let trial = PreparedTrial::new(&problem, &pool).unwrap();
    let shape = problem.shape();
    let weights: Vec<f64> =
        brain::initial_weights(shape, 1, 0).into_iter().map(|w| f64::from(w as f32)).collect();
    let variances: Vec<f64> = trial.network_scales.deviation.iter().map(|d| d * d).collect();
    let mut workspace = Workspace::<f64>::new(shape, pool.width());
    let mut loss = |design: &[f64]| {
        let counters = &mut Counters::default();
        let response = trial.simulate(design, &trial.test, &problem.solver, true, counters).unwrap();
        let (x, y) = (
            trial.network_scales.inputs(&response.samples.signals),
            trial.network_scales.targets(&response.samples.targets),
        );
        let data = Data::<f64>::new(shape, &x, &y).with_output_weights(&variances);
        let (loss, inputs) = brain::input_gradient(&weights, data.all(), &mut workspace, &pool);
        (loss, inputs, response)
    };
    let (_, inputs, response) = loss(&problem.initial);
    let cotangent = trial.network_scales.inputs_vjp(&inputs);
    let gradient = trial.vjp(&response, cotangent, &mut Counters::default()).unwrap();

    let mut stream = Stream::new(Purpose::Design, 1, [0, 0]);
    let freedom = problem.body.freedom(&problem);
    let mut z = vec![0.0; gradient.len()];
    freedom.coordinates().into_iter().for_each(|i| z[i] = stream.normal());
    let slope: f64 = freedom.vjp(&gradient).iter().zip(&z).map(|(g, d)| g * d).sum();
    let direction = freedom.spread(&z);
    let mut at = |step: f64| {
        let design: Vec<f64> = problem.initial.iter().zip(&direction).map(|(a, d)| a + step * d).collect();
        loss(&design).0
    };
    // the network has kinks: small steps cross fewer of them, large steps have less rounding error
    let differences = [1e-4, 2e-5, 4e-6].map(|step| (at(step) - at(-step)) / (2.0 * step));
    let close = differences.iter().any(|difference| (slope / difference - 1.0).abs() < 1e-3);
    assert!(slope.abs() > 1e-9 && close, "{slope} against {differences:?}");
}

/// With an extreme learning rate, training fails on the initial body, which has no predecessor.
#[test]
fn a_training_that_diverges_on_the_initial_body_is_named() {
    let mut problem = small(TrainingProtocol::Paper(Terms::Direct));
    problem.brain.rate = 1e4;
    let failure = optimise(&problem, None, &pool(1), &mut Keeper::default()).unwrap_err();
    let Failure::Initial(Trouble::Training(outcome)) = failure else { panic!("{failure:?}") };
    assert_ne!(outcome, TrainOutcome::Ok);
}

/// A failed step restores the previous design and halves the rate; too many failures in a row end the trial.
#[test]
fn a_step_in_trouble_is_taken_back_at_half_the_rate() {
    let problem = small(TrainingProtocol::Paper(Terms::Direct));
    let mut state = State::new(&problem);
    state.recent_designs = vec![PastDesign { step: 0, design: vec![7.0; state.design.len()] }];
    let mut keeper = Keeper::default();
    let mut log = Log::new(1, &mut keeper);
    let back = state.clone().undo_step(Trouble::GradientNonFinite, &mut log.report).unwrap();
    assert_eq!((back.design[0], back.rate_factor, back.consecutive_undone), (7.0, 0.5, 1));
    assert_eq!(log.report.trouble, Some(Trouble::GradientNonFinite));
    let stuck = Failure::Stuck(2, Trouble::GradientNonFinite);
    assert_eq!(back.undo_step(Trouble::GradientNonFinite, &mut log.report), Err(stuck));
    state.recent_designs.clear();
    let initial = Failure::Initial(Trouble::GradientNonFinite);
    assert_eq!(state.undo_step(Trouble::GradientNonFinite, &mut log.report), Err(initial));
}

/// The state after two steps is corrupted: the third step reports why and is undone, the fourth continues from the body before at
/// half the rate.
#[test]
fn a_loop_in_trouble_names_it_and_goes_on_from_the_body_before() {
    let problem = Problem {
        optimise: OuterLoop { iterations: 5, ..small(TrainingProtocol::Joint(GOING)).optimise },
        ..small(TrainingProtocol::Joint(GOING))
    };
    let mut keeper = Keeper { stop_after: Some(2), ..Keeper::default() };
    optimise(&problem, None, &pool(1), &mut keeper).unwrap();
    let (good, shape) = (keeper.states[1].clone(), problem.shape());
    type Spoil = fn(&mut State, brain::Shape);
    let spoilt: [(&[&str], Spoil); 4] = [
        (&["loss_jump"], |state, _| state.decoder_state.weights.iter_mut().for_each(|w| *w *= 30.0)),
        (&["loss_non_finite"], |state, _| state.decoder_state.weights[0] = f32::NAN),
        (&["dead_layer"], |state, shape| state.decoder_state.weights[shape.range(0)].fill(-1e3)),
        (&["non_finite", "step_too_small", "step_limit"], |state, _| state.design[0] = f64::NAN),
    ];
    for (names, spoil) in spoilt {
        let mut state = good.clone();
        spoil(&mut state, shape);
        let mut keeper = Keeper { stop_after: Some(3), ..Keeper::default() };
        let ended = optimise(&problem, Some(state), &pool(1), &mut keeper);
        let [third, fourth, ..] = &keeper.reports[..] else { panic!("{names:?}: {ended:?}") };
        let name = third.trouble.expect("trouble").name();
        assert!(names.contains(&name) && third.step_length.is_none(), "{names:?}: {third:?}");
        assert_eq!(keeper.states[0].design, good.recent_designs.last().unwrap().design, "{names:?}");
        assert_eq!(keeper.states[0].rate_factor, 0.5 * good.rate_factor, "{names:?}");
        if names[0] != "loss_jump" {
            assert!(fourth.trouble.is_none() && fourth.step_length > Some(0.0), "{names:?}: {fourth:?}");
        }
    }
}

/// The error of a body does not depend on when a search evaluates it: every candidate's network is trained equally long, after a
/// resumption too.
#[test]
fn a_search_s_yardstick_does_not_move() {
    let protocol = TrainingProtocol::Random(GOING);
    let mut problem = small(protocol);
    problem.optimise.iterations = 20;
    let mut keeper = Keeper { stop_after: Some(12), ..Keeper::default() };
    optimise(&problem, None, &pool(1), &mut keeper).unwrap();
    let mut late = keeper.states[11].clone();
    late.design.clone_from(&problem.initial);
    let mut again = Keeper { stop_after: Some(1), ..Keeper::default() };
    optimise(&problem, Some(late), &pool(1), &mut again).unwrap();
    let (first, last) = (&keeper.reports[0], &again.reports[0]);
    assert_eq!((last.step, first.error_test), (12, last.error_test), "{protocol:?}");
    assert!(keeper.reports.iter().all(|report| report.counters.brain_iterations == 103), "{protocol:?}");
}
