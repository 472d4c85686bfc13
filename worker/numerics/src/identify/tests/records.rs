//! Fits of free parameters to records of known bodies.

use super::*;
use crate::body::Pattern;
use crate::dynamics::{LigamentStiffness, MaxwellBranch, simulate};
use crate::stimuli::{self, Bell};

fn pool(threads: usize) -> crate::Pool {
    crate::Pool::new(threads).expect("a pool")
}

/// A sheet with one or two panels and 60 instants in 0.3 s.
fn scene(columns: usize, rows: usize, panels: usize) -> Scene {
    let layout = Layout::planar(columns, rows, 15.0, 2.25);
    let struck = layout.top_panels(panels).expect("panels");
    let panels = struck.into_iter().map(|unit| (unit, [0.0, -1.0])).collect();
    body(layout.bottom(), panels, columns * (rows - 1), layout)
}

fn body(clamped: Vec<usize>, panels: Vec<(usize, [f64; 2])>, sensor: usize, layout: Layout) -> Scene {
    Scene {
        density: 1e-8,
        stiffness: LigamentStiffness { stretch: 3.0, shear: 0.5, bend: 1.0 },
        damping_ratio: 0.03,
        clamped,
        panels: panels.into_iter().map(|(unit, direction)| Panel::central(unit, direction)).collect(),
        sensors: vec![sensor],
        duration: 0.3,
        instants: 60,
        layout,
        ..Scene::default()
    }
}

fn blows(scene: &Scene, samples: u64) -> Forces {
    let bell = Bell {
        amplitude: [0.15, 0.5],
        width: [0.04, 0.1],
        onset: [0.0, 0.05],
        peak: [0.35, 0.65],
        power: [1.5, 4.0],
    };
    let (panels, duration, instants) = (scene.panels.len(), scene.duration, scene.instants);
    stimuli::bells(&bell, Purpose::Stimulus, 1, 0..samples, panels, duration, instants)
}

/// Signals with noise relative to each kind's RMS; `memory` is its correlation between successive instants.
fn records(scene: &Scene, design: &[f64], forces: &Forces, noise: f64, memory: f64, seed: u64) -> Vec<f64> {
    let solver = IntegratorSettings::new(Integrator::Nystrom6, Accuracy(1e-5));
    let mut signals = simulate(scene, design, forces, &solver, false, &pool(1)).signals;
    let rms = |kind: bool| {
        let of: Vec<f64> =
            signals.iter().enumerate().filter(|(i, _)| (i % 3 == 2) == kind).map(|(_, s)| s * s).collect();
        (of.iter().sum::<f64>() / of.len() as f64).sqrt()
    };
    let size = [rms(false), rms(false), rms(true)];
    for c in 0..3 {
        let mut stream = Stream::new(Purpose::Chip, seed, [c as u64, 0]);
        let mut last = stream.normal();
        for s in signals.iter_mut().skip(c).step_by(3) {
            *s += noise * size[c] * last;
            last = memory * last + (1.0 - memory * memory).sqrt() * stream.normal();
        }
    }
    signals
}

/// Fits a body whose design is exact.
fn fit_on(
    threads: usize,
    (start, design): (&Scene, &[f64]),
    records: Records<'_>,
    free: &[Parameter],
    known: &[FitIteration],
    watch: &mut dyn FnMut(&FitIteration),
) -> Fit {
    fit_of(Deviations::default(), threads, (start, design), records, free, known, watch)
}

fn fit_of(
    variation: Deviations,
    threads: usize,
    (start, design): (&Scene, &[f64]),
    records: Records<'_>,
    free: &[Parameter],
    known: &[FitIteration],
    watch: &mut dyn FnMut(&FitIteration),
) -> Fit {
    let problem = Problem {
        scene: start.clone(),
        initial: design.to_vec(),
        disturbance: None,
        variation: Some(variation),
        ..problem(2, 2, start.instants, 8)
    };
    Fit::of_records(&problem, design, records, free, &pool(threads), known, watch)
}

fn fit(body: (&Scene, &[f64]), forces: &Forces, signals: &[f64], free: &[Parameter]) -> Fit {
    fit_on(2, body, (forces, signals, 0.0), free, &[], &mut |_| ())
}

const FIVE: &[Parameter] = {
    let [five @ .., _] = &Parameter::ALL;
    five
};

fn off_by(scene: &Scene, factors: [f64; 5]) -> Scene {
    let mut at = Parameters::of(scene).array();
    at.iter_mut().zip(factors).for_each(|(p, f)| *p *= f);
    Parameters::from_array(at).set(scene)
}

fn errors(fit: &Fit, truth: &Scene, start: &Scene) -> Vec<f64> {
    of_free(fit).map(|(k, e)| value(e, k, start, 0.0) / Parameters::of(truth).array()[k] - 1.0).collect()
}

/// Index and estimate of each free parameter.
fn of_free(fit: &Fit) -> impl Iterator<Item = (usize, &Estimate)> {
    fit.estimates.iter().filter_map(|e| match e.unknown {
        Unknown::Material(parameter) => Some((parameter as usize, e)),
        _ => None,
    })
}

/// Value of a parameter, `by` half widths of its interval from the estimate.
fn value(e: &Estimate, k: usize, start: &Scene, by: f64) -> f64 {
    Parameters::of(start).array()[k] * (e.scatter * (e.found + by * e.half.unwrap_or(0.0))).exp()
}

/// Counts the intervals that contain the true value.
fn count_held(held: &mut [usize; 5], fit: &Fit, truth: &Scene, start: &Scene) {
    for (held, (k, e)) in held.iter_mut().zip(of_free(fit)) {
        assert!(e.half.is_some(), "{e:?}");
        let [low, high] = [-1.0, 1.0].map(|way| value(e, k, start, way));
        *held += usize::from((low..=high).contains(&Parameters::of(truth).array()[k]));
    }
}

/// Fits five parameters from starts wrong by factors of two, with 3 % noise.
#[test]
fn starts_off_by_a_factor_of_two_come_back() {
    let squares = [[2.0; 5], [0.5; 5], [2.0, 2.0, 0.5, 0.5, 0.5], [0.5, 0.5, 2.0, 2.0, 2.0]];
    squares.into_iter().for_each(|factors| check_a_start(&scene(3, 2, 2), factors));
    let other = [0.5, 2.0, 2.0, 0.5, 0.5];
    check_a_start(&scene(3, 2, 2), other);
    for pattern in [Pattern::kagome(), Pattern::triangular(0.4363), Pattern::chiral(0.4363)] {
        let sheet = Layout::sheet(&pattern, 3, 2, 15.0, 2.25);
        let top = sheet.top();
        let down = top.iter().map(|unit| (*unit, [0.0, -1.0])).take(2).collect();
        check_a_start(&body(sheet.bottom(), down, top[0], sheet), other);
    }
    let disc = Layout::circular(&Pattern::kagome(), 4, 15.0, 2.25);
    let inward = disc.circular_panels(2).expect("panels");
    check_a_start(&body(disc.hub(), inward.clone(), inward[0].0, disc), other);
}

fn check_a_start(scene: &Scene, factors: [f64; 5]) {
    let design = scene.layout.initial_design(0.4363);
    let forces = blows(scene, 4);
    let signals = records(scene, &design, &forces, 0.03, 0.0, 1);
    let start = off_by(scene, factors);
    let found = fit((&start, &design), &forces, &signals, FIVE);
    let errors = errors(&found, scene, &start);
    let units = scene.layout.units();
    let what =
        format!("{units} units, {factors:?}: {:?}, {errors:?}, {:?}", found.ending, found.measured.misfit);
    assert_eq!(found.ending, Ending::Converged, "{what}");
    assert!(
        errors.iter().take(3).chain(&errors[4..]).all(|e| e.abs() < 0.02) && errors[3].abs() < 0.1,
        "{what}"
    );
    assert!(found.measured.misfit[1].iter().all(|m| (2.0..4.0).contains(m)), "{what}");
}

/// If ligaments relax, filters of the motion explain much of the residual on left-out records; they explain no white or correlated noise.
#[test]
fn what_the_model_lacks_is_told_from_noise() {
    let scene = scene(3, 2, 2);
    let design = scene.layout.initial_design(0.4363);
    let forces = blows(&scene, 8);
    let relaxing = Scene { relaxation: Some(MaxwellBranch { share: 0.3, time: 3e-3 }), ..scene.clone() };
    let of = |truth: &Scene, memory: f64| {
        let signals = records(truth, &design, &forces, 0.02, memory, 5);
        let found = fit((&scene, &design), &forces, &signals, FIVE);
        (found.unmodelled.expect("eight records"), found.measured.misfit[1])
    };
    let [known, remembered, lacking] = [of(&scene, 0.0), of(&scene, 0.7), of(&relaxing, 0.0)];
    let said = format!("{known:?} {remembered:?} {lacking:?}");
    assert!(known.0 < 0.05 && remembered.0 < 0.05 && lacking.0 > 0.3, "{said}");
}

/// For each parameter, at least 16 of 20 intervals contain the true value, under white and correlated noise, with groups from segments of
/// two records and from ten records.
#[test]
fn intervals_of_95_percent_hold_the_truth() {
    for (samples, memory) in [(2, 0.0), (2, 0.7), (10, 0.7)] {
        let scene = Scene { duration: 0.2, instants: 40, ..scene(2, 2, 1) };
        let design = scene.layout.initial_design(0.4363);
        let forces = blows(&scene, samples);
        let start = off_by(&scene, [1.05, 0.95, 1.05, 1.1, 1.02]);
        let mut held = [0; 5];
        for seed in 0..20 {
            let signals = records(&scene, &design, &forces, 0.05, memory, 10 + seed);
            let found = fit((&start, &design), &forces, &signals, FIVE);
            assert_eq!(found.ending, Ending::Converged, "seed {seed}");
            count_held(&mut held, &found, &scene, &start);
        }
        assert!(held.iter().all(|h| *h >= 16), "{samples} records, memory {memory}: {held:?} of 20");
    }
}

/// Clocks late by up to 5 ms, a different offset per record: the fit recovers material and offsets, and intervals contain them. Assuming
/// exact clocks biases the material.
#[test]
fn clocks_that_are_off_are_fitted_with_the_material() {
    const RECORDS: usize = 6;
    const FINE: usize = 50;
    let scene = scene(3, 2, 2);
    let design = scene.layout.initial_design(0.4363);
    let forces = blows(&scene, RECORDS as u64);
    let moving = Scene { instants: FINE * scene.instants, ..scene.clone() };
    let (mut held, mut clocks) = ([0; 5], 0);
    for seed in 0..4 {
        let signals = records(&moving, &design, &forces.refined_for(&moving), 0.03, 0.0, 50 + seed);
        let mut stream = Stream::new(Purpose::Search, seed, [7, 0]);
        let late: Vec<usize> = (0..RECORDS).map(|_| stream.below(FINE)).collect();
        let read = |(signals, late): (&[f64], &usize)| {
            let at = |n: usize| (FINE * n + late).min(moving.instants) - 1;
            (1..=scene.instants).flat_map(|n| signals[3 * at(n)..][..3].to_vec()).collect::<Vec<f64>>()
        };
        let readings: Vec<f64> = signals.chunks(3 * moving.instants).zip(&late).flat_map(read).collect();
        let start = off_by(&scene, std::array::from_fn(|_| (0.2 * stream.normal()).exp()));
        let of =
            |offset: f64| fit_on(2, (&start, &design), (&forces, &readings, offset), FIVE, &[], &mut |_| ());
        let found = of(4e-3);
        let right = errors(&found, &scene, &start);
        assert!(found.ending == Ending::Converged && right.iter().all(|e| e.abs() < 0.02), "{right:?}");
        if seed == 0 {
            let exact = of(0.0);
            let wrong = errors(&exact, &scene, &start)[0].abs() > 0.02;
            assert!(exact.offsets.is_empty() && (exact.ending != Ending::Converged || wrong), "{exact:?}");
        }
        count_held(&mut held, &found, &scene, &start);
        let interval = moving.duration / moving.instants as f64;
        for (offset, late) in found.offsets.iter().flatten().zip(&late) {
            let off = (offset.value - *late as f64 * interval).abs();
            assert!(off < 5e-5, "{offset:?} {late}");
            clocks += usize::from(off < offset.half.expect("within the bound"));
        }
    }
    assert!(held.iter().all(|held| *held >= 3) && clocks >= 20, "{held:?} of 4, {clocks} of 24");
}

/// One unit on one ligament, pushed along it: the records determine stretch and density, not shear and bend. (With damping they would,
/// since damping depends on them.)
fn pushed() -> (Scene, Vec<f64>, Forces, Vec<f64>) {
    // About 50 Hz, which a clock of 200 Hz resolves.
    let stiffness = LigamentStiffness { stretch: 0.1, shear: 0.5, bend: 1.0 };
    let scene = Scene { linearised: true, damping_ratio: 0.0, stiffness, ..scene(1, 2, 1) };
    let design = scene.layout.initial_design(0.0);
    let forces = blows(&scene, 3);
    let signals = records(&scene, &design, &forces, 0.02, 0.0, 3);
    (scene, design, forces, signals)
}

#[test]
fn what_records_do_not_tell_is_said_to_be_not_identifiable() {
    let (scene, design, forces, signals) = pushed();
    let start = off_by(&scene, [1.2, 1.2, 1.2, 1.0, 0.9]);
    let free = [Parameter::Stretch, Parameter::Shear, Parameter::Bend, Parameter::Density];
    let found = fit((&start, &design), &forces, &signals, &free);
    assert_eq!(found.ending, Ending::NotIdentifiable, "{:?}", found.estimates);
    let known: Vec<bool> = of_free(&found).map(|(_, e)| e.half.is_some()).collect();
    assert_eq!(known, [true, false, false, true], "{:?}", found.estimates);
    let [_, shear, bend, _] = found.undetermined.iter().fold([0.0; 4], |mut sum, d| {
        sum.iter_mut().zip(&d.exponents).for_each(|(s, e)| *s += e * e);
        sum
    });
    assert!(shear > 0.9 && bend > 0.9, "{:?}", found.undetermined);
    assert!(errors(&found, &scene, &start)[0].abs() < 0.02, "{:?}", found.estimates);
}

/// A parameter whose true value is beyond the bound ends at the bound; it does not count as undetermined.
#[test]
fn what_lies_beyond_the_bound_is_said_to_be_at_the_bound() {
    let (scene, design, forces, signals) = pushed();
    for (factor, bound) in [(0.1, BOX), (0.12, BOX), (8.5, 1.0 / BOX)] {
        let start = off_by(&scene, [factor, 1.0, 1.0, 1.0, 1.0]);
        let free = [Parameter::Stretch];
        let found = fit((&start, &design), &forces, &signals, &free);
        let (k, stretch) = of_free(&found).next().expect("a free parameter");
        assert_eq!(found.ending, Ending::AtTheBound, "{stretch:?}");
        let by = value(stretch, k, &start, 0.0) / start.stiffness.stretch;
        assert!((by / bound - 1.0).abs() < 1e-9, "{stretch:?}");
        assert!(stretch.half.is_none() && found.undetermined.is_empty(), "{:?}", found.undetermined);
    }
}

/// Results are bit-identical on one and two threads and when resumed from any turn; held parameters stay.
#[test]
fn a_fit_does_not_depend_on_threads_and_goes_on_from_any_turn() {
    let scene = scene(2, 2, 1);
    let design = scene.layout.initial_design(0.4363);
    let forces = blows(&scene, 3);
    let signals = records(&scene, &design, &forces, 0.03, 0.0, 5);
    let start = off_by(&scene, [1.3, 1.0, 0.8, 1.0, 1.0]);
    let free = [Parameter::Stretch, Parameter::Bend];
    let run = |threads, known: &[FitIteration]| {
        let mut turns = known.to_vec();
        let watch = &mut |turn: &FitIteration| turns.push(turn.clone());
        let found = fit_on(threads, (&start, &design), (&forces, &signals, 0.0), &free, known, watch);
        (found, turns)
    };
    let ((one, turns), two) = (run(1, &[]), run(2, &[]));
    assert_eq!((&one, &turns), (&two.0, &two.1));
    let errors = errors(&one, &scene, &start);
    assert!(errors.len() == 2 && errors.iter().all(|e| e.abs() < 0.02), "{errors:?}");
    assert!(turns.len() > 5, "{turns:?}");
    for known in 1..=turns.len() {
        let (found, same) = run(1, &turns[..known]);
        let (less, all) = (found.counters, one.counters);
        assert_eq!((Fit { counters: all, ..found }, &same), (one.clone(), &turns), "from turn {known}");
        assert!(less.force_evaluations <= all.force_evaluations, "{less:?} {all:?}");
        assert!(
            known < turns.len() || 4 * less.force_evaluations < 3 * all.force_evaluations,
            "{less:?} {all:?}"
        );
    }
}

/// Casts with node shifts of 0.1 mm: for each parameter, at least 10 of 16 intervals contain the true value, in total at least ten more
/// than with exact nodes.
#[test]
fn intervals_hold_the_material_of_casts_whose_nodes_are_shifted() {
    const CASTS: u64 = 16;
    let scene = Scene { duration: 0.2, instants: 40, ..scene(3, 2, 2) };
    let design = scene.layout.initial_design(0.4363);
    let forces = blows(&scene, 8);
    let start = off_by(&scene, [1.1, 0.95, 1.05, 1.2, 0.95]);
    let of_nodes = Deviations { nodes: 0.1, ..Deviations::default() };
    let (mut held, mut by_exact) = ([0; 5], [0; 5]);
    for seed in 0..CASTS {
        let mut stream = Stream::new(Purpose::Cast, 400 + seed, [3, 0]);
        let shifted: Vec<f64> = design.iter().map(|a| a + 0.1 * stream.normal()).collect();
        let signals = records(&scene, &shifted, &forces, 0.02, 0.0, 70 + seed);
        for (variation, held) in [(of_nodes, &mut held), (Deviations::default(), &mut by_exact)] {
            let records = (&forces, &signals[..], 0.0);
            let found = fit_of(variation, 2, (&start, &design), records, FIVE, &[], &mut |_| ());
            let is_exact = variation.nodes == 0.0;
            assert!(is_exact || found.ending == Ending::Converged, "cast {seed}: {:?}", found.ending);
            count_held(held, &found, &scene, &start);
        }
    }
    let all = |held: &[usize; 5]| held.iter().sum::<usize>();
    assert!(held.iter().all(|held| *held >= 10), "{held:?} of {CASTS}");
    assert!(all(&held) >= all(&by_exact) + 10, "{held:?}, with exact nodes {by_exact:?}, of {CASTS}");
}
