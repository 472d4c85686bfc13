//! Twins of known casts.

use super::*;
use crate::body::Layout;
use crate::brain::linear::Lags;
use crate::dynamics::{Accuracy, EdgeContact, Integrator, IntegratorSettings, Panel, Parameters, Scene};
use crate::nested::tests::{GOING, on_lattices, small};
use crate::random::{Purpose, Stream};
use crate::trial::{
    ChipErrors, Decoder, DecoderKind, DesignWithSolver, ForceSets, OuterLoop, PreparedTrial, RidgeChoice,
    Size, TrainingProtocol,
};
use crate::variation::Casts;
use nalgebra::DVector;

mod records;

/// A sheet with two panels, one sensor and `instants` of 5 ms.
fn problem(columns: usize, rows: usize, instants: usize, samples: usize) -> Problem {
    let layout = Layout::planar(columns, rows, 15.0, 2.25);
    let struck = layout.top_panels(2).expect("panels");
    let small = small(TrainingProtocol::Joint(GOING));
    Problem {
        initial: layout.initial_design(25f64.to_radians()),
        scene: Scene {
            clamped: layout.bottom(),
            guided: Vec::new(),
            imposed: Vec::new(),
            panels: struck.into_iter().map(|unit| Panel::central(unit, [0.0, -1.0])).collect(),
            sensors: vec![columns * (rows / 2) + columns / 2],
            duration: 5e-3 * instants as f64,
            instants,
            layout,
            ..small.scene
        },
        solver: IntegratorSettings::new(Integrator::Auto, Accuracy(1e-3)),
        stimuli: ForceSets { instants, samples, ..small.stimuli },
        disturbance: Some(ChipErrors { noise: Size::Relative(0.03), ..ChipErrors::NONE }),
        variation: Some(Deviations::USUAL),
        decoder_kind: DecoderKind::Linear,
        decoder: Decoder { lags: Lags::whole(instants), ridge: RidgeChoice::Auto },
        optimise: OuterLoop { brain: DecoderKind::Linear, coarse: None, ..small.optimise },
        seed: 51,
        ..small
    }
}

/// Records of a cast under the first training forces, as the trial's chips return them.
fn records(trial: &PreparedTrial, cast: &Cast, count: usize) -> (Forces, Vec<f64>) {
    let forces = trial.problem.training_and_test()[0].select(&(0..count).collect::<Vec<_>>());
    let (solver, counters) = (&trial.problem.solver, &mut crate::trial::Counters::default());
    let design = &trial.problem.initial;
    let found = trial.simulate_cast(Some(cast), design, forces.clone(), solver, false, counters);
    let signals = found.expect("a cast that moves").samples.signals;
    (forces, signals)
}

fn twin(trial: &PreparedTrial, forces: &Forces, signals: &[f64]) -> Fit {
    let (design, solver) = (&trial.problem.initial, &trial.problem.solver);
    let found = Fit::of(&DesignWithSolver { trial, design, solver }, (forces, signals), &mut || true);
    found.expect("told to go on")
}

/// True z of a cast with uncorrelated node shifts.
fn truth(cast: &Cast, estimate: &Estimate) -> f64 {
    let moved = match estimate.unknown {
        Unknown::Material(parameter) => cast.material.array()[parameter as usize].ln(),
        Unknown::LigamentLength => cast.ligament_length.ln(),
        Unknown::Sharpness => unreachable!("of measured records"),
        Unknown::Gain(channel) => cast.chips.gain[channel].ln(),
        Unknown::Turn(chip) => cast.chips.turn[chip],
        Unknown::Shift(i) => cast.shifts[i],
        Unknown::Ligament(ligament, k) => cast.parts.ligaments[ligament][k].ln(),
        Unknown::Unit(unit) => cast.parts.units[unit].ln(),
    };
    moved / estimate.scatter
}

/// Fits a random cast with 3 % noise. The residual is that noise, material errors are below three standard errors, node shifts improve on
/// the prior, and errors of all unknowns match their standard deviations.
#[test]
fn a_twin_is_the_cast_that_was_recorded() {
    check_a_twin("squares", problem(4, 4, 60, 34), 30, 0.3);
}

/// The same for hexagons and for a disc of chiral squares, with fewer and shorter records.
#[test]
fn a_twin_of_another_lattice_is_its_cast() {
    for (what, small) in on_lattices(&problem(3, 3, 30, 16)).into_iter().skip(2).step_by(3) {
        // Stretch dominates the bending of hexagons, so bend stays uncertain.
        check_a_twin(&what, small, 12, 0.99);
    }
}

/// Fits `count` records. `most`: largest posterior standard deviation of the material, relative to the prior.
fn check_a_twin(what: &str, mut problem: Problem, count: usize, most: f64) {
    let usual = Deviations::USUAL;
    problem.variation = Some(Deviations { gain: 0.02, misalignment: 0.02, ..usual });
    let pool = crate::Pool::new(2).expect("threads");
    let trial = PreparedTrial::new(&problem, &pool).expect("a body");
    let cast = trial.cast(Casts::Unseen, 0).expect("a variation");
    let (forces, signals) = records(&trial, &cast, count);
    let Fit { twin, estimates, ending, steps, .. } = twin(&trial, &forces, &signals);
    assert!(ending == Ending::Converged, "{what}: {ending:?} after {steps} steps, {}", twin.misfit);
    assert!((twin.misfit - 1.0).abs() < 0.03, "{what}: {}", twin.misfit);
    let off: Vec<f64> = estimates.iter().map(|e| (e.found - truth(&cast, e)) / e.left).collect();
    for (e, off) in estimates.iter().zip(&off).filter(|(e, _)| matches!(e.unknown, Unknown::Material(_))) {
        assert!(off.abs() < 3.0 && e.left < most, "{what}: {e:?}: {off}");
    }
    let rms = |of: &[f64]| (of.iter().map(|x| x * x).sum::<f64>() / of.len() as f64).sqrt();
    let scaled = rms(&off);
    assert!((0.8..1.25).contains(&scaled), "{what}: {scaled}");
    let apart: Vec<f64> = twin.cast.shifts.iter().zip(&cast.shifts).map(|(a, b)| a - b).collect();
    assert!(
        rms(&apart) < 0.8f64.max(most) * rms(&cast.shifts),
        "{what}: {} of {}",
        rms(&apart),
        rms(&cast.shifts)
    );
}

/// F(z + εd) − F(z − εd) = 2ε ∇F·d + O(ε³) along each kind of unknown, with contact, correlated nodes and chips that filter, have a bias
/// and omit channels. Further cases: free parameters with saturated readings; uncertain clocks.
#[test]
fn the_gradient_of_a_twin_holds_in_every_unknown() {
    let free = [Parameter::Stretch, Parameter::Damping];
    for (range, deviation, free) in
        [(f64::INFINITY, 0.0, &[][..]), (0.8, 0.0, &free[..]), (f64::INFINITY, 1e-3, &[][..])]
    {
        check_the_gradient(range, deviation, free);
    }
}

/// `range`: relative to each channel's RMS; `deviation`: of the clocks (s).
fn check_the_gradient(range: f64, deviation: f64, free: &[Parameter]) {
    let mut problem = problem(3, 3, 24, 8);
    problem.scene.contact = Some(EdgeContact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.9 });
    problem.solver.accuracy = Accuracy(1e-6);
    problem.channels = vec![0, 2];
    problem.disturbance = Some(ChipErrors {
        noise: Size::Relative(0.03),
        bias: Size::Relative(0.1),
        bandwidth: 60.0,
        delay: 2e-3,
        ..ChipErrors::NONE
    });
    let usual = Deviations::USUAL;
    let variation = Deviations {
        material: Parameters { contact: 0.1, ..usual.material },
        ligaments: [0.05; 3],
        units: 0.03,
        ligament_length: 0.02,
        correlation: 20.0,
        gain: 0.02,
        misalignment: 0.03,
        ..usual
    };
    problem.variation = Some(variation);
    let pool = crate::Pool::new(2).expect("threads");
    let rms = PreparedTrial::new(&problem, &pool).expect("a body").scales.channels;
    let chips = problem.disturbance.as_mut().expect("chips");
    chips.range = [range * rms[0], range * rms[1]];
    let trial = PreparedTrial::new(&problem, &pool).expect("a body");
    let cast = trial.cast(Casts::Unseen, 0).expect("a variation");
    let (forces, signals) = records(&trial, &cast, 3);
    let unknowns = Unknowns::of_records(&problem.scene, &variation, free, &pool);
    let (chip, solver) = (trial.chip.as_ref(), &trial.problem.solver);
    let all = (&forces, &signals[..], deviation);
    let mut objective = Misfit::new(&trial.problem, chip, &problem.initial, all, unknowns, solver, &pool);
    objective.look_at(20);
    let mut draw = Stream::new(Purpose::Design, 1, [0, 0]);
    let count = objective.unknowns.all().len();
    // z = 1 is a factor of ten for a free parameter.
    let scale = |k: usize| if k < free.len() { 0.1 } else { 1.0 };
    let z = DVector::from_fn(count, |k, _| 0.5 * scale(k) * draw.normal());
    let point = objective.at(z.clone()).expect("a cast that moves");
    objective.weigh(&point);
    // the clocks' best offsets depend on the weights
    let point = objective.again(point);
    let saturated = chip.map_or(0, |chip| chip.saturated(&signals));
    assert_eq!(saturated > signals.len() / 6, range.is_finite(), "{saturated} of {}", signals.len());
    let gradient = objective.gradient(&point);
    let kinds: Vec<_> = objective.unknowns.all().iter().map(std::mem::discriminant).collect();
    let mut seen = Vec::new();
    for kind in kinds
        .iter()
        .filter(|kind| {
            let new = !seen.contains(*kind);
            seen.push(**kind);
            new
        })
        .copied()
        .collect::<Vec<_>>()
    {
        let along =
            DVector::from_fn(count, |k, _| if kinds[k] == kind { scale(k) * draw.normal() } else { 0.0 });
        let mut at = |by: f64| objective.at(&z + by * &along).expect("a cast that moves").cost;
        let (slope, difference) = (gradient.dot(&along), (at(1e-3) - at(-1e-3)) / 2e-3);
        assert!(slope != 0.0 && (difference / slope - 1.0).abs() < 1e-3, "{kind:?}: {difference} {slope}");
    }
}

/// Unknowns that the records do not determine stay at the prior. Fits do not depend on threads. A fit fails if its start cannot be
/// simulated.
#[test]
fn what_records_do_not_tell_is_left_as_it_was() {
    let mut problem = problem(3, 3, 24, 12);
    problem.channels = vec![0, 1];
    problem.variation = Some(Deviations { nodes: 0.0, gain: 0.02, ..Deviations::USUAL });
    let of = |threads: usize| {
        let pool = crate::Pool::new(threads).expect("threads");
        let trial = PreparedTrial::new(&problem, &pool).expect("a body");
        let cast = trial.cast(Casts::Unseen, 1).expect("a variation");
        let (forces, signals) = records(&trial, &cast, 6);
        twin(&trial, &forces, &signals)
    };
    let one = of(1);
    assert_eq!(one, of(3));
    let unread = one.estimates.iter().find(|e| e.unknown == Unknown::Gain(2)).expect("a gain of ω");
    assert!(unread.left > 0.999 && unread.found.abs() < 1e-6, "{unread:?}");
    let told = one.estimates.iter().filter(|e| matches!(e.unknown, Unknown::Material(_)) && e.left < 0.5);
    assert!(told.count() > 0, "{:?}", one.estimates);

    let forbidden = EdgeContact { stiffness: 1.0, min_angle: 3.0, cutoff_angle: 3.1 };
    let scene = Scene { contact: Some(forbidden), ..problem.scene.clone() };
    let pool = crate::Pool::new(1).expect("threads");
    let (forces, signals) = (problem.training_and_test()[0].select(&[0]), vec![0.0; 2 * 24]);
    let problem = Problem { scene, ..problem };
    let all = (&forces, &signals[..], 0.0);
    let twin = Fit::of_records(&problem, &problem.initial, all, &[], &pool, &[], &mut |_| ());
    assert_eq!((twin.ending, twin.steps), (Ending::StartFailed, 0));
}

/// One record of twelve has forces ten times as large: four records give about the curvature of all, wherever it is.
#[test]
fn a_metric_of_few_records_has_those_that_outweigh_the_others() {
    let problem = problem(3, 3, 24, 16);
    let pool = crate::Pool::new(2).expect("threads");
    let trial = PreparedTrial::new(&problem, &pool).expect("a body");
    let cast = trial.cast(Casts::Unseen, 0).expect("a variation");
    let (mut forces, signals) = records(&trial, &cast, 12);
    for hard in [1, 6, 11] {
        let record = forces.values.len() / 12;
        let own = hard * record..(hard + 1) * record;
        forces.values[own.clone()].iter_mut().for_each(|f| *f *= 10.0);
        let unknowns = Unknowns::new(&problem.scene, &Deviations::USUAL, &pool);
        let (chip, solver) = (trial.chip.as_ref(), &trial.problem.solver);
        let all = (&forces, &signals[..], 0.0);
        let mut objective = Misfit::new(&trial.problem, chip, &problem.initial, all, unknowns, solver, &pool);
        let point = objective.at(DVector::zeros(objective.unknowns.all().len())).expect("a body that moves");
        let traces = [4, usize::MAX].map(|most| {
            let columns = objective.columns(&point, most);
            assert!(columns.records.contains(&hard), "{:?}", columns.records);
            objective.curvature(&point, &columns).trace()
        });
        assert!((0.8..1.25).contains(&(traces[0] / traces[1])), "{hard}: {traces:?}");
        forces.values[own].iter_mut().for_each(|f| *f /= 10.0);
    }
}
