//! Compressed bodies: their starting state, and its derivative in the design.

use crate::common::{pool, relative};
use crate::helpers::{EQUAL_STEPS, plan, pushes, shaken, small_scene};
use metasense_kernels::body::Layout;
use metasense_kernels::dynamics::{
    AccelerationFrame, EdgeContact, Forces, IntegrationPlan, Integrator, MaxwellBranch, Mount, Outcome,
    Panel, Parameters, Precision, PrescribedMotion, Rest, Scene, Tangent, Wrt, energy_gradients, run, start,
};

/// Clamped below and at one unit of the top row, which moves down by the fraction `strain` of the distance.
fn pressed(strain: f64) -> Scene {
    let base = small_scene();
    let clamped = vec![0, 1, 2, 7];
    let panels = vec![Panel::central(6, [0.0, -1.0]), Panel { node: Some(3), ..base.panels[1] }];
    let pressed = vec![[0.0; 2], [0.0; 2], [0.0; 2], [0.3, -30.0 * strain]];
    Scene { clamped, imposed: pressed, panels, sensors: vec![4, 8], ..base }
}

/// As `pressed`, with two guided units, one of which is displaced.
fn guided(strain: f64) -> Scene {
    let base = pressed(strain);
    let guided = vec![(5, [true, false, true]), (6, [false, true, false])];
    Scene { imposed: [&base.imposed[..], &[[-20.0 * strain, 0.0], [0.0, 0.0]]].concat(), guided, ..base }
}

fn half_sum_of_squares(signals: &[f64]) -> f64 {
    0.5 * signals.iter().map(|a| a * a).sum::<f64>()
}

/// Derivative at 0 by differences of order 4.
fn slope_at_zero(f: impl Fn(f64) -> f64) -> f64 {
    let h = 1e-4;
    (8.0 * (f(h) - f(-h)) - (f(2.0 * h) - f(-2.0 * h))) / (12.0 * h)
}

/// At the start, free units are in equilibrium and held units have their imposed displacements. Signals are zero until the first force.
#[test]
fn a_sample_begins_at_rest() {
    for scene in [pressed(0.08), pressed(-0.08), Scene { linearised: true, ..pressed(0.08) }, guided(0.05)] {
        let design = shaken(&scene);
        let start = start(&scene, &design).unwrap();
        let (pull, _) = energy_gradients(&scene, &design, &start);
        let [free, reaction] = [false, true].map(|of_held| {
            let own = (0..27).filter(|i| scene.holds(i / 3)[i % 3] == of_held);
            own.map(|i| pull[i / 3][i % 3]).fold(0.0, |most: f64, g| most.max(g.abs()))
        });
        assert!(free < 1e-12 * reaction && reaction > 0.1, "{free:e} of {reaction}");
        let held = scene.clamped.iter().chain(scene.guided.iter().map(|(unit, _)| unit));
        for (&unit, by) in held.zip(&scene.imposed) {
            for d in (0..3).filter(|d| scene.holds(unit)[*d]) {
                assert_eq!(start[unit][d], [by[0], by[1], 0.0][d]);
            }
        }
        let mut forces = pushes(&scene, 1, 0.3);
        forces.values.chunks_exact_mut(21).for_each(|history| history[..9].fill(0.0));
        for (method, steps) in
            [(Integrator::Tsit5, 0), (Integrator::Nystrom6, 24), (Integrator::Leapfrog, 60)]
        {
            let run = run(&scene, &design, &forces, &plan(method, steps), true, &pool(1));
            assert_eq!(run.outcomes, [Outcome::Ok]);
            let (before, after) = run.signals.split_at(8 * 6);
            let most = |signals: &[f64]| signals.iter().fold(0.0, |most: f64, s| most.max(s.abs()));
            assert!(most(before) < 1e-6 * most(after), "{method:?}: {:e} {:e}", most(before), most(after));
            let (x, _) = run.tape.unwrap().state(0, 1);
            for (x, at) in x.as_flattened().iter().zip(start.as_flattened()) {
                assert!((x - at).abs() < 1e-9, "{method:?}: {x} {at}");
            }
        }
    }
}

/// Gradients in design and parameters equal differences, for every method, with contact, body-fixed readings, a shaken base and a
/// driven unit.
#[test]
fn gradients_follow_the_start() {
    let contact = Some(EdgeContact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.9 });
    let base = pressed(0.08);
    let moving = |moves, unit, way| Panel { moves: Some(moves), ..Panel::central(unit, way) };
    let (shaken_base, driven) = (
        moving(PrescribedMotion::Base(1e-4), 0, [0.6, 0.8]),
        moving(PrescribedMotion::Unit(1e-4), 6, [1.0, 0.0]),
    );
    let scenes = [
        Scene {
            frame: AccelerationFrame::Body,
            mount: Some(Mount { offset: [1.5, -2.0], tilt: 0.4 }),
            ..base.clone()
        },
        Scene { contact, ..base.clone() },
        Scene { linearised: true, ..base.clone() },
        Scene { panels: vec![driven, base.panels[1]], ..base.clone() },
        Scene { panels: vec![base.panels[0], shaken_base], ..base },
        Scene { panels: vec![Panel { node: Some(1), ..base.panels[0] }, shaken_base], ..guided(0.05) },
    ];
    for (i, scene) in scenes.iter().enumerate() {
        let (design, mut forces) = (shaken(scene), pushes(scene, 3, 0.3));
        // the second sample's forces start later
        forces.values[42..84].chunks_exact_mut(21).for_each(|history| history[..9].fill(0.0));
        let methods =
            EQUAL_STEPS.map(|(method, ..)| (method, if method == Integrator::Nystrom6 { 12 } else { 24 }));
        for (method, steps) in methods.into_iter().chain([(Integrator::Tsit5, 0)]) {
            let plan = plan(method, steps);
            let simulation = run(scene, &design, &forces, &plan, true, &pool(2));
            assert!(simulation.outcomes.iter().all(|o| *o == Outcome::Ok), "{i} {:?}", simulation.outcomes);
            let gradient = simulation.vjp(&simulation.signals, Wrt::Parameters, &pool(2));
            let direction: Vec<f64> = (0..design.len()).map(|i| (2.3 * i as f64).cos()).collect();
            let energy = |by: f64| {
                let moved: Vec<f64> = design.iter().zip(&direction).map(|(a, d)| a + by * d).collect();
                half_sum_of_squares(&run(scene, &moved, &forces, &plan, false, &pool(2)).signals)
            };
            let difference = slope_at_zero(energy);
            let slope: f64 = gradient.design.iter().zip(&direction).map(|(g, d)| g * d).sum();
            // differences of Tsit5 have different steps
            let near = if method == Integrator::Tsit5 { 1e-4 } else { 1e-5 };
            assert!((difference / slope - 1.0).abs() < near, "{i} {method:?}: {difference} {slope}");

            let at = Parameters::of(scene).array();
            for (k, own) in gradient.parameters.unwrap().array().into_iter().enumerate() {
                if at[k] == 0.0 {
                    continue;
                }
                let energy = |by: f64| {
                    let mut moved = at;
                    moved[k] *= 1.0 + by;
                    let scene = Parameters::from_array(moved).set(scene);
                    half_sum_of_squares(&run(&scene, &design, &forces, &plan, false, &pool(2)).signals)
                };
                let difference = slope_at_zero(energy);
                let slope = own * at[k];
                let scale = slope.abs().max(1e-3 * half_sum_of_squares(&simulation.signals));
                assert!(
                    (difference - slope).abs()
                        < if method == Integrator::Tsit5 { 3e-4 } else { 1e-4 } * scale,
                    "{i} {method:?} {k}: {difference} {slope}"
                );
            }
        }
    }
}

/// The derivative of signals along a direction (`jvp`) is adjoint to the gradient.
#[test]
fn the_two_derivatives_are_transposes() {
    let scene = guided(0.05);
    let (design, forces) = (shaken(&scene), pushes(&scene, 2, 0.3));
    let direction: Vec<f64> = (0..design.len()).map(|i| (2.3 * i as f64).cos()).collect();
    let parameters = Parameters { stretch: 0.7, shear: -0.1, bend: 0.4, ..Parameters::default() };
    for (method, steps) in [(Integrator::Tsit5, 0), (Integrator::Nystrom6, 24)] {
        let run = run(&scene, &design, &forces, &plan(method, steps), true, &pool(1));
        let cotangent: Vec<f64> = (0..run.signals.len()).map(|i| (0.7 * i as f64).sin()).collect();
        let gradient = run.vjp(&cotangent, Wrt::Parameters, &pool(1));
        let back: f64 = gradient.design.iter().zip(&direction).map(|(g, d)| g * d).sum::<f64>()
            + gradient
                .parameters
                .unwrap()
                .array()
                .iter()
                .zip(parameters.array())
                .map(|(g, d)| g * d)
                .sum::<f64>();
        let along = Tangent { design: &direction, parameters, forces: &[] };
        let of = |sample: usize| {
            let (signals, tangent) = run.jvp(sample, along);
            let own = &run.signals[sample * signals.len()..][..signals.len()];
            for (a, b) in signals.iter().zip(own) {
                assert!((a - b).abs() < 1e-6 * (1.0 + b.abs()), "{method:?}: {a} {b}");
            }
            let cotangent = &cotangent[sample * signals.len()..][..signals.len()];
            tangent.iter().zip(cotangent).map(|(t, c)| t * c).sum::<f64>()
        };
        let forth = of(0) + of(1);
        assert!((forth / back - 1.0).abs() < 1e-7, "{method:?}: {forth} {back}");
    }
}

/// Small motions are linearised about the starting state.
#[test]
fn the_linearisation_is_about_the_start() {
    let scene = guided(0.05);
    let design = shaken(&scene);
    let (rest, start) = (Rest::new(&scene, &design), start(&scene, &design).unwrap());
    let unknown = |i: usize| (rest.unknowns[i] / 3, rest.unknowns[i] % 3);
    let mut dense = vec![0.0; rest.mass.len().pow(2)];
    rest.stiffness.iter().for_each(|&(i, j, k)| dense[i * rest.mass.len() + j] = k);
    for j in 0..rest.mass.len() {
        let [above, below] = [1e-5, -1e-5].map(|by| {
            let mut moved = start.clone();
            moved[unknown(j).0][unknown(j).1] += by;
            energy_gradients(&scene, &design, &moved).0
        });
        for i in 0..rest.mass.len() {
            let (unit, d) = unknown(i);
            let (own, difference) =
                (dense[i * rest.mass.len() + j], (above[unit][d] - below[unit][d]) / 2e-5);
            assert!((own - difference).abs() < 1e-6, "{i} {j}: {own} {difference}");
        }
    }
}

/// A lattice of squares that are not rotated stays straight under compression until it buckles; then all samples fail. A lattice of
/// rotated squares deforms from the start.
#[test]
fn a_straight_body_buckles() {
    let layout = Layout::planar(3, 5, 15.0, 2.25);
    let clamped: Vec<usize> = [layout.bottom(), layout.top()].concat();
    let with = |strain: f64| Scene {
        imposed: [[[0.0; 2]; 3], [[0.0, -60.0 * strain]; 3]].concat(),
        clamped: clamped.clone(),
        panels: vec![Panel::central(6, [1.0, 0.0])],
        sensors: vec![7],
        layout: layout.clone(),
        ..small_scene()
    };
    let straight = layout.initial_design(0.0);
    assert_eq!(start(&with(0.1), &straight), Err(Outcome::Buckled));
    assert!(start(&with(-0.1), &straight).is_ok());
    assert!(start(&with(0.1), &layout.initial_design(0.4363)).is_ok());
    let scene = with(0.1);
    let forces: Forces = pushes(&scene, 3, 0.3);
    let run = run(&scene, &straight, &forces, &plan(Integrator::Nystrom6, 24), true, &pool(1));
    assert_eq!(run.outcomes, [Outcome::Buckled; 3]);
    assert!(run.signals.iter().all(|s| *s == 0.0));
    let gradient = run.vjp(&vec![1.0; run.signals.len()], Wrt::Design, &pool(1));
    assert!(gradient.design.iter().all(|g| *g == 0.0));
}

/// A body whose voids are narrower than contact permits has no equilibrium.
#[test]
fn a_body_that_may_be_nowhere_comes_to_no_rest() {
    let contact = Some(EdgeContact { stiffness: 1.0, min_angle: 1.4, cutoff_angle: 1.5 });
    let scene = Scene { contact, ..pressed(0.08) };
    assert_eq!(start(&scene, &scene.layout.initial_design(0.4363)), Err(Outcome::NoEquilibrium));
}

/// A weak blow on a strongly compressed body is stable, and signals in f32 are close to those in f64, although the stored energy is a
/// thousand times that of the blow.
#[test]
fn weak_blows_on_a_pressed_body_are_heard() {
    let scene = pressed(0.08);
    let (design, forces) = (shaken(&scene), pushes(&scene, 3, 0.003));
    let [single, double] = [Precision::Single, Precision::Double].map(|precision| {
        let run = run(
            &scene,
            &design,
            &forces,
            &IntegrationPlan { precision, ..plan(Integrator::Nystrom6, 24) },
            true,
            &pool(1),
        );
        assert_eq!((&run.outcomes[..], run.counters.rejected), (&[Outcome::Ok; 3][..], 0), "{precision:?}");
        let gradient = run.vjp(&run.signals, Wrt::Design, &pool(1)).design;
        (run.signals, gradient)
    });
    let off = [relative(&single.0, &double.0), relative(&single.1, &double.1)];
    assert!(off[0] < 3e-2 && off[1] < 3e-2, "{off:?}");
}

/// Relaxing ligaments are relaxed at the start of a sample.
#[test]
fn a_press_is_relaxed_when_a_sample_begins() {
    let scene = Scene { relaxation: Some(MaxwellBranch { share: 0.3, time: 0.01 }), ..pressed(0.08) };
    let (design, mut forces) = (shaken(&scene), pushes(&scene, 1, 0.3));
    forces.values.chunks_exact_mut(21).for_each(|history| history[..9].fill(0.0));
    let run = run(&scene, &design, &forces, &plan(Integrator::Nystrom4, 36), false, &pool(1));
    let (before, after) = run.signals.split_at(8 * 6);
    let most = |signals: &[f64]| signals.iter().fold(0.0, |most: f64, s| most.max(s.abs()));
    assert!(most(before) < 1e-6 * most(after), "{:e} {:e}", most(before), most(after));
}
