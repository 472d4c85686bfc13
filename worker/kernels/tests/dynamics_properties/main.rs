//! Exact properties of the integrators, their adjoints and the body's layouts.

#[path = "../common/mod.rs"]
mod common;
mod driven;
mod forces;
mod guided;
mod helpers;
mod pressed;

use common::{norm, pool, relative, scene};
use helpers::{EQUAL_STEPS, by_too_few_steps, of_every_law, plan, pushes, shaken, small_scene, struck};
use metasense_kernels::body::{Geometry, Layout, Pattern};
use metasense_kernels::dynamics::{
    AccelerationFrame, Accuracy, AddedMass, EdgeContact, Energy, Forces, IntegrationPlan, Integrator,
    IntegratorSettings, LigamentStiffness, Mount, Outcome, Panel, Parameters, PartFactors, Precision, Scene,
    Tolerance, Wrt, choose, energy, energy_gradients, highest_frequency, run, signal_error, simulate, tune,
};
use metasense_kernels::simd::Width;
use metasense_kernels::{Heartbeat, Pool};
use std::f64::consts::TAU;

/// All instruction sets agree up to rounding; each tape is swept by the instruction set that created it.
#[test]
fn every_width_computes_the_same() {
    let contact = EdgeContact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.6 };
    let base = small_scene();
    let mut apart = Vec::new();
    for scene in [
        base.clone(),
        Scene { linearised: true, ..base.clone() },
        Scene { frame: AccelerationFrame::Body, contact: Some(contact), ..base },
    ] {
        let (design, forces) = (shaken(&scene), struck(&scene, pushes(&scene, 11, 0.4)));
        for plan in
            [IntegrationPlan::tsit5(Tolerance::both(1e-6)), IntegrationPlan::equal(Integrator::Nystrom4, 24)]
        {
            let at = |width| {
                let pool = Pool::with(1, width, Heartbeat::default()).expect("threads");
                let run = run(&scene, &design, &forces, &plan, true, &pool);
                assert_eq!(run.width, width);
                let gradient = run.vjp(&run.signals, Wrt::Parameters, &pool);
                let parameters = gradient.parameters.expect("asked for").array();
                let forces = run.vjp(&run.signals, Wrt::Forces, &pool);
                (run.signals, gradient.design, parameters, forces.forces.expect("asked for"))
            };
            let truth = at(Width::Baseline);
            for width in Width::ALL.into_iter().filter(|w| *w <= Width::detect()).skip(1) {
                let of = at(width);
                let off = [
                    relative(&of.0, &truth.0),
                    relative(&of.1, &truth.1),
                    relative(&of.2, &truth.2),
                    relative(&of.3, &truth.3),
                ];
                let off = off.into_iter().fold(0.0, f64::max);
                apart.push((width, plan.method, off));
            }
        }
    }
    assert!(apart.iter().all(|(_, _, off)| *off < 1e-9), "{apart:?}");
}

/// With forces in f32 and positions in f64, signals and gradient equal those in f64 up to rounding, for every instruction set.
#[test]
fn steps_in_single_precision_are_those_in_double() {
    let contact = EdgeContact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.3 };
    let base = small_scene();
    let mut apart = Vec::new();
    for scene in [
        base.clone(),
        Scene { linearised: true, ..base.clone() },
        Scene { frame: AccelerationFrame::Body, contact: Some(contact), ..base },
    ] {
        let (design, forces) = (shaken(&scene), pushes(&scene, 19, 0.4));
        for (method, _, steps) in EQUAL_STEPS {
            for width in Width::ALL.into_iter().filter(|w| *w <= Width::detect()) {
                let at = |precision, steps| {
                    let plan = IntegrationPlan { precision, ..plan(method, steps) };
                    let pool = Pool::with(1, width, Heartbeat::default()).expect("threads");
                    let run = run(&scene, &design, &forces, &plan, true, &pool);
                    assert_eq!(run.outcomes, [Outcome::Ok; 19]);
                    let gradient = run.vjp(&run.signals, Wrt::Forces, &pool);
                    [run.signals, gradient.design, gradient.forces.expect("asked for")]
                };
                let (single, double) = (at(Precision::Single, steps), at(Precision::Double, steps));
                apart.push([0, 1, 2].map(|i| relative(&single[i], &double[i])));
            }
        }
    }
    assert!(apart.iter().flatten().all(|off| (1e-9..3e-5).contains(off)), "{apart:?}");
}

/// Samples in a narrower vector have results identical bit by bit to those among more samples; gradients differ only by the order of a
/// sum.
#[test]
fn a_sample_moves_alike_among_few_and_many() {
    let scene = small_scene();
    let (design, forces) = (shaken(&scene), pushes(&scene, 19, 0.4));
    for width in Width::ALL.into_iter().filter(|width| *width <= Width::detect()) {
        for (method, _, steps) in EQUAL_STEPS {
            let of = |samples: &[usize]| {
                let plan = IntegrationPlan { precision: Precision::Single, ..plan(method, steps) };
                let pool = Pool::with(1, width, Heartbeat::default()).expect("threads");
                let run = run(&scene, &design, &forces.select(samples), &plan, true, &pool);
                let gradient = run.vjp(&run.signals, Wrt::Design, &pool).design;
                (run.signals, gradient)
            };
            let all = of(&(0..19).collect::<Vec<_>>());
            let parts =
                [of(&[0, 1, 2, 3, 4, 5, 6, 7]), of(&[8, 9, 10, 11, 12, 13, 14, 15]), of(&[16, 17, 18])];
            assert!(all.0 == parts.each_ref().map(|part| part.0.clone()).concat(), "{}", width.name());
            let mut sum = vec![0.0; design.len()];
            parts.iter().for_each(|part| sum.iter_mut().zip(&part.1).for_each(|(sum, x)| *sum += x));
            let off = relative(&sum, &all.1);
            assert!(off < 1e-5, "{} {off:e}", width.name());
        }
    }
}

/// The reference scene for one second, with pulses of 60 to 250 ms.
fn second() -> (Scene, Forces) {
    let layout = Layout::planar(6, 6, 15.0, 2.25);
    let scene = Scene { layout, clamped: (0..6).collect(), sensors: vec![14], ..scene(6, 6, 200) };
    let scene = Scene { duration: 1.0, ..scene };
    let mut forces = pushes(&scene, 8, 0.0);
    for (i, history) in forces.values.chunks_exact_mut(201).enumerate() {
        let (onset, width) = (0.05 * i as f64, 0.06 + 0.19 * (i % 4) as f64 / 3.0);
        for (n, f) in history.iter_mut().enumerate() {
            let phase = ((n as f64 / 200.0 - onset) / width).clamp(0.0, 1.0);
            *f = 0.3 * (0.5 * TAU * phase).sin().powi(2);
        }
    }
    (scene, forces)
}

/// Rounding errors of signals and gradients with f32 are below the law of `choose`, for pulses within one second.
#[test]
fn rounding_of_forces_keeps_its_law() {
    let (base, forces) = second();
    let stiffness = LigamentStiffness { stretch: 30.0, ..base.stiffness };
    let mut apart = Vec::new();
    for scene in [base.clone(), Scene { linearised: true, ..base.clone() }, Scene { stiffness, ..base }] {
        let design = shaken(&scene);
        let radians = highest_frequency(&scene, &design) * scene.duration / scene.instants as f64;
        for method in [Integrator::Nystrom4, Integrator::Nystrom6] {
            let double = choose(&scene, &design, &IntegratorSettings::new(method, Accuracy(1e-3)));
            let single = IntegrationPlan { precision: Precision::Single, ..double.clone() };
            let [single, double] = [single, double].map(|plan| {
                let run = run(&scene, &design, &forces, &plan, true, &pool(1));
                let gradient = run.vjp(&run.signals, Wrt::Design, &pool(1)).design;
                (run.signals, gradient)
            });
            let off = [signal_error(&single.0, &double.0, 3), relative(&single.1, &double.1)];
            apart.push(off.map(|off| off / (radians * radians)));
        }
    }
    assert!(apart.iter().all(|[signals, _]| (1e-10..3e-7).contains(signals)), "{apart:?}");
    assert!(apart.iter().all(|[_, gradient]| (1e-10..5e-6).contains(gradient)), "{apart:?}");
}

/// Equal factors on all ligaments or units are equivalent to a scene with that material and the same C: energy, its gradients, signals,
/// and their gradients in design and in the logarithms of the parameters. Factors of 1 give identical results bit by bit.
#[test]
fn parts_that_are_alike_are_the_material() {
    for scene in of_every_law(small_scene()) {
        let (ligaments, units) = (scene.layout.ligaments.len(), scene.layout.units());
        let with = |by: [f64; 4]| {
            let [stretch, shear, bend, density] = by;
            let parts = PartFactors {
                ligaments: vec![[stretch, shear, bend]; ligaments],
                units: vec![density; units],
            };
            Scene { parts, ..scene.clone() }
        };
        let parts = with([1.3, 1.7, 1.7, 1.2]);
        let LigamentStiffness { stretch, shear, bend } = scene.stiffness;
        let material = Scene {
            stiffness: LigamentStiffness { stretch: 1.3 * stretch, shear: 1.7 * shear, bend: 1.7 * bend },
            density: 1.2 * scene.density,
            damping_ratio: scene.damping_ratio / (1.7f64 * 1.2).sqrt(),
            ..scene.clone()
        };
        let (design, forces) = (shaken(&scene), pushes(&scene, 3, 0.4));
        let state: Vec<[f64; 3]> =
            (0..units).map(|u| [0.0, 0.3, 0.6].map(|d| 0.2 * (1.7 * u as f64 + d).sin())).collect();
        let still = |scene: &Scene| {
            let Energy { elastic, contact } = energy(scene, &design, &state);
            let (in_state, in_design) = energy_gradients(scene, &design, &state);
            [vec![elastic, contact], in_state.into_flattened(), in_design]
        };
        let moving = |scene: &Scene| {
            let run = run(scene, &design, &forces, &plan(Integrator::Nystrom6, 24), true, &pool(1));
            let gradient = run.vjp(&run.signals, Wrt::Parameters, &pool(1));
            let (slopes, at) =
                (gradient.parameters.expect("asked for").array(), Parameters::of(scene).array());
            let slopes = slopes.iter().zip(at).map(|(slope, at)| slope * at).collect();
            ([run.signals, gradient.design, slopes], run.counters)
        };
        for (found, truth) in still(&parts).iter().zip(&still(&material)) {
            let off = relative(found, truth);
            assert!(off < 1e-12 && norm(truth) > 0.0, "{off:e}");
        }
        for (found, truth) in moving(&parts).0.iter().zip(&moving(&material).0) {
            let off = relative(found, truth);
            assert!(off < 1e-9 && norm(truth) > 0.0, "{off:e}");
        }
        let same = with([1.0; 4]);
        assert_eq!(still(&same), still(&scene));
        assert_eq!(moving(&same), moving(&scene));
        assert_eq!(highest_frequency(&same, &design), highest_frequency(&scene, &design));
    }
}

/// E(e^{εd} f) − E(e^{−εd} f) = 2ε Σ d f ∂E/∂f + O(ε³) for the factors f of all ligaments and units. Along equal factors, this is the
/// derivative in the material at constant C.
#[test]
fn gradients_in_parts_are_those_of_differences() {
    let base = Scene { chip: Some(AddedMass { mass: 3e-6, moment: 1e-4 }), ..small_scene() };
    for scene in of_every_law(base) {
        let (ligaments, units) = (scene.layout.ligaments.len(), scene.layout.units());
        let direction = |i: usize| (2.3 * i as f64 + 0.7).cos();
        let with = |by: f64| {
            let of = |i: usize| (0.1 * (1.3 * i as f64).sin() + by * direction(i)).exp();
            let parts = PartFactors {
                ligaments: (0..ligaments).map(|q| [0, 1, 2].map(|k| of(3 * q + k))).collect(),
                units: (0..units).map(|u| of(3 * ligaments + u)).collect(),
            };
            Scene { parts, ..scene.clone() }
        };
        let (design, forces, plan) = (shaken(&scene), pushes(&scene, 2, 0.3), plan(Integrator::Nystrom6, 24));
        let here = with(0.0);
        let simulation = run(&here, &design, &forces, &plan, true, &pool(1));
        let found = simulation.vjp(&simulation.signals, Wrt::Parameters, &pool(1));
        let own = found.parts.expect("asked for");
        let flat = |of: &PartFactors| [of.ligaments.as_flattened(), &of.units[..]].concat();
        let slopes = flat(&own).into_iter().zip(flat(&here.parts)).map(|(slope, by)| slope * by);
        let slope: f64 = slopes.enumerate().map(|(i, slope)| slope * direction(i)).sum();
        let energy = |by: f64| {
            let signals = run(&with(by), &design, &forces, &plan, false, &pool(1)).signals;
            0.5 * signals.iter().map(|a| a * a).sum::<f64>()
        };
        let difference = (energy(1e-5) - energy(-1e-5)) / 2e-5;
        assert!((difference / slope - 1.0).abs() < 1e-6 && slope != 0.0, "{difference} {slope}");
        let stretch: f64 = own.ligaments.iter().zip(&here.parts.ligaments).map(|(g, by)| g[0] * by[0]).sum();
        let material = found.parameters.expect("asked for").stretch * scene.stiffness.stretch;
        assert!((stretch / material - 1.0).abs() < 1e-12, "{stretch} {material}");
    }
}

/// One stiff ligament raises the highest frequency, which determines the steps, close to that of an equally stiff body. Halving all
/// densities raises it by √2.
#[test]
fn the_highest_frequency_is_that_of_the_stiffest_ligament() {
    let scene = small_scene();
    let (design, count) = (shaken(&scene), scene.layout.ligaments.len());
    let with = |parts| highest_frequency(&Scene { parts, ..scene.clone() }, &design);
    let ligaments =
        |at: usize| (0..count).map(|q| [if q == at || at == count { 100.0 } else { 1.0 }; 3]).collect();
    let [plain, one, all] = [Vec::new(), ligaments(4), ligaments(count)]
        .map(|ligaments| with(PartFactors { ligaments, units: Vec::new() }));
    assert!(one > 5.0 * plain && one < all && (all / plain - 10.0).abs() < 1e-6, "{plain} {one} {all}");
    let light = with(PartFactors { units: vec![0.5; scene.layout.units()], ..PartFactors::default() });
    assert!((light / plain - 2f64.sqrt()).abs() < 1e-6, "{light} {plain}");
}

/// Lanczos' estimate, compared with the highest mode of the reference scene, 664 Hz.
#[test]
fn the_highest_frequency_is_that_of_the_model() {
    let scene =
        Scene { layout: Layout::planar(6, 6, 15.0, 2.25), clamped: (0..6).collect(), ..small_scene() };
    let design = scene.layout.initial_design(25f64.to_radians());
    let hertz = highest_frequency(&scene, &design) / TAU;
    assert!((hertz - 664.0).abs() < 1.0, "{hertz}");
}

/// Signals have the requested error at the tuned steps, for every method that a spec may contain and one scene of each kind. With the
/// tuned accuracy, the law gives these steps.
#[test]
fn a_pilot_keeps_the_accuracy_asked() {
    let base = small_scene();
    let contact = Some(EdgeContact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.3 });
    for (what, scene) in [
        ("plain", base.clone()),
        (
            "stiff",
            Scene { stiffness: LigamentStiffness { stretch: 300.0, ..base.stiffness }, ..base.clone() },
        ),
        ("damped", Scene { damping_ratio: 0.5, ..base.clone() }),
        ("contact", Scene { contact, ..base.clone() }),
        ("body frame", Scene { frame: AccelerationFrame::Body, ..base.clone() }),
        ("linearised", Scene { linearised: true, ..base }),
    ] {
        let (design, forces) = (shaken(&scene), pushes(&scene, 3, 0.4));
        let tight = IntegratorSettings::new(Integrator::Nystrom6, Accuracy(1e-8));
        let truth = simulate(&scene, &design, &forces, &tight, false, &pool(1));
        let named = [Integrator::Tsit5, Integrator::Leapfrog, Integrator::Nystrom4, Integrator::Nystrom6]
            .map(|m| (m, 1e-3));
        let auto = [3e-2, 1e-3, 1e-4].map(|asked| (Integrator::Auto, asked));
        for (method, asked) in auto.into_iter().chain(named) {
            let solver = IntegratorSettings::new(method, Accuracy(asked));
            let tuned = tune(&scene, &design, &forces, &solver, &pool(1));
            assert_eq!(tuned, tune(&scene, &design, &forces, &solver, &pool(2)), "{what}: threads");
            let reason = &tuned.plan.reason;
            let run = simulate(&scene, &design, &forces, &tuned.solver, false, &pool(1));
            assert_eq!(run.plan.steps, tuned.plan.steps, "{what}: the law with the tuned accuracy; {reason}");
            let error = signal_error(&run.signals, &truth.signals, 3 * scene.sensors.len());
            assert!(error <= asked, "{what}: error {error:e}, requested {asked:e}; {reason}");
            assert!(tuned.error.is_some_and(|e| e <= asked), "{what}: {:?}; {reason}", tuned.error);
        }
    }
}

/// Forces are f32 if a pilot finds the error small enough: for 1e-3 on the reference scene, but not for 1e-4, for stiff ligaments, or
/// for slow forces with accelerations below rounding.
#[test]
fn a_pilot_takes_single_precision_where_it_keeps_the_error() {
    let (scene, pulses) = second();
    let stiff = Scene { stiffness: LigamentStiffness { stretch: 300.0, ..scene.stiffness }, ..scene.clone() };
    let design = shaken(&scene);
    let single = |scene: &Scene, forces: &Forces, error| {
        let solver = IntegratorSettings::new(Integrator::Auto, Accuracy(error));
        let tuned = tune(scene, &design, forces, &solver, &pool(1));
        let plan = choose(scene, &design, &tuned.solver);
        assert_eq!(plan.precision, tuned.plan.precision, "{}", tuned.plan.reason);
        assert_eq!(plan.precision == Precision::Single, tuned.plan.reason.contains("f32"));
        let strict = choose(scene, &design, &tuned.solver.at_most(Accuracy(1e-9)));
        assert_eq!(strict.precision, Precision::Double);
        plan.precision == Precision::Single
    };
    assert_eq!([3e-2, 1e-3, 1e-4].map(|error| single(&scene, &pulses, error)), [true, true, false]);
    assert!(!single(&stiff, &pulses, 1e-3));
    let slow = pushes(&scene, 8, 0.3);
    assert!(!single(&scene, &slow, 1e-3));
}

/// All channels have equal weight: a missing gyroscope counts as much as a missing accelerometer.
#[test]
fn the_error_of_signals_is_by_channel() {
    let truth: Vec<f64> = (0..60).map(|i| [1e4, 2e4, 3.0][i % 3] * (0.3 * i as f64).sin()).collect();
    for silent in 0..3 {
        let without: Vec<f64> =
            truth.iter().enumerate().map(|(i, a)| if i % 3 == silent { 0.0 } else { *a }).collect();
        let error = signal_error(&without, &truth, 3);
        assert!((error - (1f64 / 3.0).sqrt()).abs() < 1e-12, "channel {silent}: {error}");
    }
    // a channel that contains only rounding is omitted
    let still: Vec<f64> = truth.iter().enumerate().map(|(i, a)| if i % 3 == 2 { 1e-9 } else { *a }).collect();
    let off: Vec<f64> =
        still.iter().enumerate().map(|(i, a)| if i % 3 == 2 { 0.0 } else { 1.01 * a }).collect();
    assert!((signal_error(&off, &still, 3) - 0.01).abs() < 1e-9);
}

/// Samples repeated with finer steps because of contact are identical in two runs of the pilot, so their difference does not measure
/// the error.
#[test]
fn a_pilot_is_not_blind_to_steps_that_contact_halves() {
    let contact = Some(EdgeContact { stiffness: 0.02, min_angle: 0.3, cutoff_angle: 0.62 });
    let scene = Scene { contact, ..small_scene() };
    let design = scene.layout.initial_design(25f64.to_radians());
    let solver = IntegratorSettings::new(Integrator::Auto, Accuracy(1e-3));
    let mut halved = 0;
    for amplitude in [0.2, 0.4, 0.6, 0.8, 1.0, 1.2] {
        let forces = pushes(&scene, 2, amplitude);
        let law = simulate(&scene, &design, &forces, &solver, false, &pool(1));
        if law.counters.rejected == 0 || law.outcomes.iter().any(|o| *o != Outcome::Ok) {
            continue;
        }
        halved += 1;
        let tight = IntegratorSettings::tsit5(Tolerance::both(1e-10));
        let truth = simulate(&scene, &design, &forces, &tight, false, &pool(1));
        let tuned = tune(&scene, &design, &forces, &solver, &pool(1));
        let run = run(&scene, &design, &forces, &tuned.plan, false, &pool(1));
        let error = signal_error(&run.signals, &truth.signals, 3 * scene.sensors.len());
        let asked = if tuned.error.is_some() { 1.2e-3 } else { 5e-3 };
        assert!(error <= asked, "{amplitude}: {error:e}; {}", tuned.plan.reason);
    }
    assert!(halved > 0, "no steps were halved");
}

/// Without forces, nothing is measured. An unreachable accuracy is reported; the steps are those of least error, or the law's if none
/// is better.
#[test]
fn a_pilot_says_what_it_cannot_measure() {
    // with an offset force, motion would be chaotic at the smaller factor too
    let scene = Scene {
        panels: vec![Panel::central(6, [0.0, -1.0]), Panel::central(8, [0.6, -0.8])],
        ..small_scene()
    };
    let (design, mut forces) = (shaken(&scene), pushes(&scene, 1, 0.4));
    let auto = IntegratorSettings::new(Integrator::Auto, Accuracy(1e-3));
    let law = choose(&scene, &design, &auto).steps.count();
    // forces for which errors decrease but not to 1e-3, and forces with chaotic motion
    for (factor, refined) in [(300.0, 8), (10_000.0, 1)] {
        let values = forces.values.iter().map(|f| factor * f).collect();
        let forces = Forces { values, ..forces.clone() };
        let wild = tune(&scene, &design, &forces, &auto, &pool(1));
        assert!(
            wild.error.is_none() && wild.plan.reason.contains("no number of steps of the pilot"),
            "{wild:?}"
        );
        assert_eq!(wild.plan.steps.count(), refined * law, "{factor}: {}", wild.plan.reason);
    }
    // one successful sample of eight does not represent the seven that fail
    let mut eight = pushes(&scene, 8, 0.4);
    let one = eight.values.len() / 8;
    eight.values[one..].iter_mut().for_each(|f| *f *= 1e200);
    let alone = tune(&scene, &design, &eight, &auto, &pool(2));
    assert!(
        alone.error.is_none() && alone.plan.reason.contains("no number of steps of the pilot"),
        "{alone:?}"
    );
    forces.values.fill(0.0);
    let still = tune(&scene, &design, &forces, &auto, &pool(1));
    assert!(still.error.is_none() && still.counters.steps == 0, "{still:?}");
}

/// A sensor on a held unit reads zero for every design: its cotangent changes no gradient.
#[test]
fn a_sensor_on_a_held_unit_asks_for_no_gradient() {
    let base = small_scene();
    let scene = Scene { sensors: vec![base.sensors[0], base.clamped[0]], ..base };
    let (design, forces) = (shaken(&scene), pushes(&scene, 2, 0.4));
    for (method, steps) in [
        (Integrator::Tsit5, 0),
        (Integrator::Leapfrog, 60),
        (Integrator::Nystrom4, 30),
        (Integrator::Nystrom6, 15),
    ] {
        let run = run(&scene, &design, &forces, &plan(method, steps), true, &pool(1));
        let gradient = |held: f64| {
            let of = |i: usize| if i % 6 < 3 { (0.7 * i as f64).sin() } else { held };
            let cotangent: Vec<f64> = (0..run.signals.len()).map(of).collect();
            run.vjp(&cotangent, Wrt::Design, &pool(1)).design
        };
        assert!(run.signals.chunks_exact(6).all(|s| s[3..] == [0.0; 3]), "{method:?}");
        assert_eq!(gradient(0.0), gradient(1e3), "{method:?}");
    }
}

/// Steps that a 40 times stronger force makes unstable are refined for that sample only.
#[test]
fn a_sample_that_fails_is_tried_again_with_smaller_steps() {
    let scene = Scene {
        contact: Some(EdgeContact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.3 }),
        ..small_scene()
    };
    let design = scene.layout.initial_design(0.4363);
    let mut forces = pushes(&scene, 2, 0.3);
    let half = forces.values.len() / 2;
    forces.values[half..].iter_mut().for_each(|f| *f *= 40.0);
    let run = run(&scene, &design, &forces, &plan(Integrator::Nystrom6, 6), true, &pool(1));
    assert_eq!(run.outcomes[0], Outcome::Ok);
    assert!(run.counters.rejected > 0 || run.outcomes[1] == Outcome::Ok, "{:?}", run.counters);
    assert!(run.signals.iter().all(|s| s.is_finite()));
}

/// Equal steps near and beyond the limit of stability: successful samples have signals of the right size, the others are refined or
/// reported, some as unstable. Large motion with sufficient steps is not rejected.
#[test]
fn steps_that_make_energy_of_nothing_are_unstable() {
    let (mut named, mut refined) = (0, 0);
    for stretch in [3.0, 300.0, 3e5] {
        let base = small_scene();
        let scene = Scene { stiffness: LigamentStiffness { stretch, ..base.stiffness }, ..base };
        let found = by_too_few_steps(&scene);
        assert!(found.worst < 3.0, "{stretch}: {:.1} times the truth", found.worst);
        named += found.unstable;
        refined += found.refined;
    }
    assert!(named > 0 && refined > 0, "{named} unstable, {refined} refined");

    let contact = Some(EdgeContact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.9 });
    for (scene, amplitude) in
        [(small_scene(), 400.0), (Scene { contact, ..small_scene() }, 0.4), (small_scene(), 0.0)]
    {
        let (design, forces) = (shaken(&scene), pushes(&scene, 3, amplitude));
        let run = run(&scene, &design, &forces, &plan(Integrator::Nystrom4, 400), false, &pool(2));
        assert_eq!((&run.outcomes[..], run.counters.rejected), (&[Outcome::Ok; 3][..], 0), "{amplitude} N");
    }
}

/// With a cutoff above the voids at rest, contact pushes the body apart from the first instant on, also without forces.
#[test]
fn contact_that_acts_at_rest_moves_the_body_from_the_start() {
    let scene = Scene {
        contact: Some(EdgeContact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.9 }),
        ..small_scene()
    };
    let design = shaken(&scene);
    let mut forces = pushes(&scene, 3, 0.3);
    let per_sample = forces.values.len() / 3;
    forces.values[2 * per_sample..].fill(0.0);
    let tight = IntegratorSettings::tsit5(Tolerance::both(1e-12));
    let adaptive = simulate(&scene, &design, &forces, &tight, false, &pool(1));
    assert_eq!(adaptive.outcomes, [Outcome::Ok; 3]);
    let equal = run(&scene, &design, &forces, &plan(Integrator::Nystrom6, 96), false, &pool(1));
    let (still, off) = (
        norm(&adaptive.signals[2 * adaptive.signals.len() / 3..]),
        relative(&adaptive.signals, &equal.signals),
    );
    assert!(still > 1.0 && off < 1e-8, "norm {still:.1e} without force, {off:.1e} apart");
}

/// Discs: units inside the radius, a group for every node, and areas, hub and panels as defined.
#[test]
fn circular_bodies_are_bodies() {
    for across in 3..12 {
        let layout = Layout::circular(&Pattern::square(), across, 15.0, 2.25);
        let radius = 0.5 * across as f64 * 15.0;
        assert!(layout.centres.iter().all(|c| c[0].hypot(c[1]) <= radius));
        let ends: usize = layout
            .groups
            .of_nodes
            .iter()
            .map(|g| g.iter().flatten().filter(|g| **g < layout.groups.count()).count())
            .sum();
        assert_eq!(ends, 4 * layout.units());
        assert_eq!(layout.groups.count(), 4 * layout.units() - layout.ligaments.len(), "{across}");
        assert_eq!(layout.hub().len(), if across % 2 == 0 { 4 } else { 1 });
        let design = layout.initial_design(0.4);
        let geometry = Geometry::new(&layout, &design, 1.0);
        let area = 2.0 * (layout.half() / 0.4f64.cos()).powi(2);
        assert!(geometry.area.iter().all(|a| (a - area).abs() < 1e-9 * area), "{across}");
        if across >= 5 {
            let (panels, boundary) = (layout.circular_panels(8).expect("eight panels"), layout.boundary());
            assert!(panels.iter().all(|(u, d)| {
                let c = layout.centres[*u];
                boundary[*u] && c[0] * d[0] + c[1] * d[1] < 0.0
            }));
        }
    }
}

/// Just beyond the limit of stability, the highest mode grows slowly. A check of the kinetic energy alone would miss it. Accelerations
/// of that mode are so large that the tolerated 1/20 of the work can double the signals.
#[test]
fn motion_that_steps_have_made_is_found_before_it_drowns_the_signals() {
    let base = small_scene();
    let (mut well, mut worst) = (0, 0.0f64);
    for i in 0..40 {
        let stretch = 3.0 * (1.0 + 0.01 * f64::from(i));
        let scene = Scene { stiffness: LigamentStiffness { stretch, ..base.stiffness }, ..base.clone() };
        let (design, forces) = (shaken(&scene), pushes(&scene, 3, 0.4));
        let tight = IntegratorSettings::new(Integrator::Nystrom6, Accuracy(1e-4));
        let truth = norm(&simulate(&scene, &design, &forces, &tight, false, &pool(2)).signals);
        for steps in [12, 13, 14] {
            let run = run(&scene, &design, &forces, &plan(Integrator::Leapfrog, steps), false, &pool(1));
            if run.counters.rejected == 0 {
                well += 1;
                worst = worst.max(norm(&run.signals) / truth);
            }
        }
    }
    assert!(well > 20 && worst < 3.0, "signals up to {worst} times the reference in {well} runs");
}

/// Chips as heavy as their units are equivalent to twice the density, without damping.
#[test]
fn chips_weigh() {
    let base = Scene { damping_ratio: 0.0, sensors: vec![3, 4, 5, 6, 7, 8], ..small_scene() };
    let design = base.layout.initial_design(0.4363);
    let geometry = Geometry::new(&base.layout, &design, base.density);
    let chip = Some(AddedMass { mass: geometry.mass[4], moment: geometry.moment[4] });
    let forces = pushes(&base, 2, 0.2);
    let signals = |scene: &Scene| {
        run(scene, &design, &forces, &plan(Integrator::Nystrom6, 24), false, &pool(1)).signals
    };
    let heavy = signals(&Scene { chip, ..base.clone() });
    let dense = signals(&Scene { density: 2.0 * base.density, ..base.clone() });
    assert!(relative(&heavy, &dense) < 1e-9, "{:e}", relative(&heavy, &dense));
    assert!(relative(&heavy, &signals(&base)) > 0.1);
}

/// Gradients in design and density equal differences if units carry chips, whose mass does not depend on either.
#[test]
fn gradients_hold_where_chips_weigh() {
    let scene = Scene { chip: Some(AddedMass { mass: 3e-6, moment: 1e-4 }), ..small_scene() };
    let (design, forces, plan) = (shaken(&scene), pushes(&scene, 2, 0.3), plan(Integrator::Nystrom6, 24));
    let simulation = run(&scene, &design, &forces, &plan, true, &pool(1));
    let gradient = simulation.vjp(&simulation.signals, Wrt::Parameters, &pool(1));
    let energy = |scene: &Scene, design: &[f64]| {
        let signals = run(scene, design, &forces, &plan, false, &pool(1)).signals;
        0.5 * signals.iter().map(|a| a * a).sum::<f64>()
    };
    let direction: Vec<f64> = (0..design.len()).map(|i| (2.3 * i as f64).cos()).collect();
    let moved = |by: f64| -> Vec<f64> { design.iter().zip(&direction).map(|(a, d)| a + by * d).collect() };
    let slope: f64 = gradient.design.iter().zip(&direction).map(|(g, d)| g * d).sum();
    let difference = (energy(&scene, &moved(1e-5)) - energy(&scene, &moved(-1e-5))) / 2e-5;
    assert!((difference / slope - 1.0).abs() < 1e-6, "{difference} {slope}");
    let of_density = |by: f64| energy(&Scene { density: by * scene.density, ..scene.clone() }, &design);
    let difference = (of_density(1.0 + 1e-5) - of_density(1.0 - 1e-5)) / 2e-5;
    let slope = gradient.parameters.unwrap().density * scene.density;
    assert!((difference / slope - 1.0).abs() < 1e-6, "{difference} {slope}");
}

/// A chip off the centroid measures a + α×r − ω²r along its axes, compared with values computed from a chip on the centroid and the
/// tape.
#[test]
fn chips_off_the_centroid_read_turning() {
    let mount = Mount { offset: [1.5, -2.0], tilt: 0.4 };
    for frame in [AccelerationFrame::World, AccelerationFrame::Body] {
        let base = Scene { frame: AccelerationFrame::World, ..small_scene() };
        let (design, forces) = (shaken(&base), pushes(&base, 1, 0.5));
        let plan = plan(Integrator::Nystrom6, 24);
        let plain = run(&base, &design, &forces, &plan, true, &pool(1));
        let off = |by: [f64; 2], frame| {
            let scene = Scene { mount: Some(Mount { offset: by, tilt: 0.0 }), frame, ..base.clone() };
            run(&scene, &design, &forces, &plan, false, &pool(1)).signals
        };
        // a mount with zero offset and tilt changes nothing
        assert_eq!(off([0.0; 2], AccelerationFrame::World), plain.signals);
        let read = run(
            &Scene { mount: Some(mount), frame, ..base.clone() },
            &design,
            &forces,
            &plan,
            false,
            &pool(1),
        );
        // α from a chip at (1, 0): a_y + α cos θ − ω² sin θ
        let east = off([1.0, 0.0], AccelerationFrame::World);
        let tape = plain.tape.as_ref().unwrap();
        let width = 3 * base.sensors.len();
        let mut turned: f64 = 0.0;
        for n in 0..base.instants {
            let (x, v) = tape.state(0, n + 1);
            for (m, &unit) in base.sensors.iter().enumerate() {
                let [ax, ay, _] = [0, 1, 2].map(|c| plain.signals[n * width + 3 * m + c]);
                let (theta, omega) = (x[unit][2], v[unit][2]);
                let (s, c) = theta.sin_cos();
                let alpha = (east[n * width + 3 * m + 1] - ay + omega * omega * s) / c;
                let r =
                    [c * mount.offset[0] - s * mount.offset[1], s * mount.offset[0] + c * mount.offset[1]];
                let at = [ax - alpha * r[1] - omega * omega * r[0], ay + alpha * r[0] - omega * omega * r[1]];
                let (s, c) =
                    (mount.tilt + if frame == AccelerationFrame::Body { theta } else { 0.0 }).sin_cos();
                let expected = [c * at[0] + s * at[1], c * at[1] - s * at[0], omega];
                for (k, expected) in expected.into_iter().enumerate() {
                    let got = read.signals[n * width + 3 * m + k];
                    assert!((got - expected).abs() <= 1e-8 * (1.0 + expected.abs()), "{got} {expected}");
                }
                turned = turned.max((at[0] - ax).abs() / (1.0 + ax.abs()));
            }
        }
        assert!(turned > 0.1, "rotation too small for the test: {turned}");
    }
}

/// Gradients in the design equal differences if chips are off the centroid and tilted.
#[test]
fn gradients_hold_where_chips_are_mounted() {
    let mount = Some(Mount { offset: [1.5, -2.0], tilt: 0.4 });
    for frame in [AccelerationFrame::World, AccelerationFrame::Body] {
        for method in [Integrator::Nystrom6, Integrator::Leapfrog] {
            let scene = Scene { mount, frame, ..small_scene() };
            let (design, forces, plan) = (shaken(&scene), pushes(&scene, 2, 0.3), plan(method, 24));
            let simulation = run(&scene, &design, &forces, &plan, true, &pool(1));
            let gradient = simulation.vjp(&simulation.signals, Wrt::Design, &pool(1));
            let energy = |design: &[f64]| {
                let signals = run(&scene, design, &forces, &plan, false, &pool(1)).signals;
                0.5 * signals.iter().map(|a| a * a).sum::<f64>()
            };
            let direction: Vec<f64> = (0..design.len()).map(|i| (2.3 * i as f64).cos()).collect();
            let moved =
                |by: f64| -> Vec<f64> { design.iter().zip(&direction).map(|(a, d)| a + by * d).collect() };
            let slope: f64 = gradient.design.iter().zip(&direction).map(|(g, d)| g * d).sum();
            let difference = (energy(&moved(1e-5)) - energy(&moved(-1e-5))) / 2e-5;
            assert!((difference / slope - 1.0).abs() < 1e-6, "{frame:?} {method:?}: {difference} {slope}");
        }
    }
}

/// Strong damping decays faster than the body vibrates: the steps resolve it.
#[test]
fn a_pilot_keeps_its_error_under_strong_damping() {
    for damping_ratio in [2.0, 20.0] {
        let scene = Scene { damping_ratio, ..small_scene() };
        let (design, forces) = (shaken(&scene), pushes(&scene, 2, 0.4));
        let auto = IntegratorSettings::new(Integrator::Auto, Accuracy(1e-3));
        let tuned = tune(&scene, &design, &forces, &auto, &pool(1));
        assert!(tuned.error.is_some(), "{damping_ratio}: {}", tuned.plan.reason);
        let tight = IntegratorSettings::tsit5(Tolerance::both(1e-10));
        let truth = simulate(&scene, &design, &forces, &tight, false, &pool(1));
        let run = run(&scene, &design, &forces, &tuned.plan, false, &pool(1));
        let error = signal_error(&run.signals, &truth.signals, 3 * scene.sensors.len());
        assert!(error <= 1.2e-3, "{damping_ratio}: {error:e}; {}", tuned.plan.reason);
    }
}

/// Samples of a body with an inverted or vanished unit fail by name, at once.
#[test]
fn a_unit_without_mass_ends_all_samples() {
    let base = small_scene();
    let (design, forces) = (shaken(&base), pushes(&base, 2, 0.4));
    let auto = IntegratorSettings::new(Integrator::Auto, Accuracy(1e-3));
    for (mass, outcome) in [(0.1, Outcome::Ok), (1e-5, Outcome::NoMass), (-1.0, Outcome::NoMass)] {
        let mut units = vec![1.0; base.layout.units()];
        units[4] = mass;
        let scene = Scene { parts: PartFactors { units, ..base.parts.clone() }, ..base.clone() };
        let run = simulate(&scene, &design, &forces, &auto, false, &pool(1));
        assert_eq!(run.outcomes, [outcome; 2], "{mass}");
        let pilot = tune(&scene, &design, &forces, &auto, &pool(1));
        assert_eq!(pilot.counters.steps == 0, outcome == Outcome::NoMass, "{mass}");
    }
}
