//! Ligaments that bend as hinges: energy and its gradients, motion over the hill between two rests, gradients through it.

use crate::common::{pool, relative, scene};
use crate::helpers::{BISTABLE, plan, pushes, shaken, small_scene};
use metasense_kernels::body::{Geometry, Layout, Pattern};
use metasense_kernels::dynamics::{
    Contact, Forces, Hinge, Method, Outcome, Panel, Scene, Simulation, Wrt, energy, energy_design_gradient,
    energy_gradient, run,
};

/// Some state of every unit, of relative rotations beyond the second rest.
fn bent(units: usize) -> Vec<[f64; 3]> {
    (0..units).map(|u| [0.0, 0.3, 0.6].map(|d| 0.3 * (1.7 * u as f64 + d).sin())).collect()
}

/// Turned as the initial design is, ligaments of lattices have all the energy of their polynomial at +2ε, against it at −2ε.
#[test]
fn the_two_senses_are_those_of_the_initial_design() {
    for layout in [Layout::planar(4, 3, 15.0, 2.25), Layout::circular(&Pattern::square(), 4, 15.0, 2.25)] {
        let plain = Scene { layout, clamped: vec![], panels: vec![], sensors: vec![], ..scene(4, 3, 1) };
        let hinged = Scene { hinge: Some(BISTABLE), ..plain.clone() };
        let design = plain.layout.initial_design(0.4);
        let Hinge { quadratic, cubic } = BISTABLE;
        for epsilon in [0.2, -0.2] {
            let turn =
                |cell: &[i32; 2]| [0.0, 0.0, if (cell[0] + cell[1]) % 2 == 0 { epsilon } else { -epsilon }];
            let state: Vec<[f64; 3]> = plain.layout.grid.iter().map(turn).collect();
            let more = energy(&hinged, &design, &state).elastic - energy(&plain, &design, &state).elastic;
            let delta: f64 = 2.0 * epsilon;
            let one = quadratic / 3.0 * delta.powi(3) + cubic / 4.0 * delta.powi(4);
            let truth = plain.layout.ligaments.len() as f64 * one;
            assert!((more / truth - 1.0).abs() < 1e-9, "{epsilon}: {more} {truth}");
        }
    }
}

/// U(s + εδ) − U(s − εδ) = 2ε ∂U·δ + O(ε³), in the state and in the design, with contact, too.
#[test]
fn forces_of_hinges_are_those_of_their_energy() {
    let base = Scene { hinge: Some(BISTABLE), ..small_scene() };
    let contact = Some(Contact { stiffness: 1.0, min_angle: -0.8, cutoff_angle: 0.9 });
    for scene in [base.clone(), Scene { contact, ..base }] {
        let (design, state) = (shaken(&scene), bent(scene.layout.units()));
        let total = |design: &[f64], state: &[[f64; 3]]| {
            let found = energy(&scene, design, state);
            found.elastic + found.contact
        };
        let wave = |i: usize| (2.3 * i as f64 + 0.4).cos();
        let moved = |by: f64| -> Vec<[f64; 3]> {
            let one = |(u, s): (usize, &[f64; 3])| [0, 1, 2].map(|d| s[d] + by * wave(3 * u + d));
            state.iter().enumerate().map(one).collect()
        };
        let gradient = energy_gradient(&scene, &design, &state).into_flattened();
        let slope: f64 = gradient.iter().enumerate().map(|(i, g)| g * wave(i)).sum();
        let difference = (total(&design, &moved(1e-5)) - total(&design, &moved(-1e-5))) / 2e-5;
        assert!((difference / slope - 1.0).abs() < 1e-7, "{difference} {slope}");
        let shifted =
            |by: f64| -> Vec<f64> { design.iter().enumerate().map(|(i, a)| a + by * wave(i)).collect() };
        let gradient = energy_design_gradient(&scene, &design, &state);
        let slope: f64 = gradient.iter().enumerate().map(|(i, g)| g * wave(i)).sum();
        let difference = (total(&shifted(1e-5), &state) - total(&shifted(-1e-5), &state)) / 2e-5;
        assert!((difference / slope - 1.0).abs() < 1e-7, "{difference} {slope}");
    }
}

/// One unit on one ligament: a couple for the first third of the time, then nothing.
fn unit_on_a_hinge(damping_ratio: f64, moment: f64) -> (Scene, Forces) {
    let scene = Scene {
        hinge: Some(BISTABLE),
        damping_ratio,
        panels: vec![Panel { moment, ..Panel::central(1, [0.0; 2]) }],
        duration: 0.6,
        ..scene(1, 2, 60)
    };
    let values = (0..=60).map(|n| if n < 20 { 0.1 } else { 0.0 }).collect();
    let forces = Forces { samples: 1, panels: 1, instants: 60, values, strikes: Vec::new() };
    (scene, forces)
}

/// The unit's rotation in the sense of the initial design, which it starts with at no shifts.
fn rotation(scene: &Scene, run: &Simulation, instant: usize) -> f64 {
    let (x, _) = run.tape.as_ref().unwrap().state(0, instant);
    scene.layout.sense(&scene.layout.ligaments[0]) * x[1][2]
}

/// Pushed over the hill a unit stays at ½ rad, where nothing acts on it; pushed less, or the other way, it comes back. No method
/// takes the energy that it gains by snapping for one that steps have made.
#[test]
fn a_bistable_unit_snaps_and_stays() {
    for (moment, rest) in [(1.0, 0.5), (0.2, 0.0), (-1.0, 0.0)] {
        for (method, steps) in [(Method::Tsit5, 0), (Method::Leapfrog, 200), (Method::Nystrom6, 40)] {
            let (base, _) = unit_on_a_hinge(0.2, 0.0);
            let sense = base.layout.sense(&base.layout.ligaments[0]);
            let (scene, forces) = unit_on_a_hinge(0.2, sense * moment);
            let design = scene.layout.initial_design(0.0);
            let run = run(&scene, &design, &forces, &plan(method, steps), true, &pool(1));
            assert_eq!(run.outcomes, [Outcome::Ok], "{moment} N·mm, {method:?}");
            let end = rotation(&scene, &run, 60);
            assert!((end - rest).abs() < 2e-3, "{moment} N·mm, {method:?}: {end} rad");
            assert!(method == Method::Tsit5 || run.counters.rejected == 0, "{:?}", run.counters);
        }
    }
}

/// Without damping kinetic energy and U, that of hinges with it, stay what they are once the force has gone: on the way to the second
/// rest and back.
#[test]
fn hinges_neither_make_nor_take_energy() {
    let (base, _) = unit_on_a_hinge(0.0, 0.0);
    let sense = base.layout.sense(&base.layout.ligaments[0]);
    let (scene, forces) = unit_on_a_hinge(0.0, 1.2 * sense);
    let design = scene.layout.initial_design(0.0);
    let run = run(&scene, &design, &forces, &plan(Method::Nystrom6, 200), true, &pool(1));
    let Geometry { mass, moment, .. } = scene.geometry(&design);
    let at = |n: usize| {
        let (x, v) = run.tape.as_ref().unwrap().state(0, n);
        let kinetic = mass[1] * (v[1][0].powi(2) + v[1][1].powi(2)) + moment[1] * v[1][2].powi(2);
        0.5 * kinetic + energy(&scene, &design, &x).elastic
    };
    let energies: Vec<f64> = (21..=60).map(at).collect();
    let turns: Vec<f64> = (21..=60).map(|n| rotation(&scene, &run, n)).collect();
    let wide = turns.iter().fold(0.0f64, |far, turn| far.max(*turn));
    let off = energies.iter().map(|e| (e / energies[0] - 1.0).abs()).fold(0.0, f64::max);
    assert!(off < 1e-6 && wide > 0.5, "{off:e}, as far as {wide} rad");
}

/// E(e^{ε}) − E(e^{−ε}) = 2ε g + O(ε³) of half the square of the signals' norm, along the design and in k_θ (C held by ζ), where
/// the motion crosses hills; polynomials of no terms are no hinges.
#[test]
fn gradients_hold_with_hinges() {
    let scene = Scene { hinge: Some(BISTABLE), ..small_scene() };
    let (design, forces, plan) = (shaken(&scene), pushes(&scene, 3, 0.3), plan(Method::Nystrom6, 24));
    let simulate = |scene: &Scene, design: &[f64], keep| run(scene, design, &forces, &plan, keep, &pool(1));
    let here = simulate(&scene, &design, true);
    let gradient = here.vjp(&here.signals, Wrt::Parameters, &pool(1));
    let square = |scene: &Scene, design: &[f64]| {
        0.5 * simulate(scene, design, false).signals.iter().map(|a| a * a).sum::<f64>()
    };
    let along: Vec<f64> = (0..design.len()).map(|i| (2.3 * i as f64).cos()).collect();
    let moved = |by: f64| -> Vec<f64> { design.iter().zip(&along).map(|(a, d)| a + by * d).collect() };
    let slope: f64 = gradient.design.iter().zip(&along).map(|(g, d)| g * d).sum();
    let difference = (square(&scene, &moved(1e-6)) - square(&scene, &moved(-1e-6))) / 2e-6;
    assert!((difference / slope - 1.0).abs() < 1e-5 && slope != 0.0, "{difference} {slope}");

    let slope = gradient.parameters.unwrap().bend * scene.stiffness.bend;
    let stiffer = |by: f64| {
        let mut scene = scene.clone();
        scene.stiffness.bend *= f64::exp(by);
        square(&scene, &design)
    };
    let difference = (stiffer(1e-6) - stiffer(-1e-6)) / 2e-6;
    assert!((difference / slope - 1.0).abs() < 1e-5 && slope != 0.0, "{difference} {slope}");

    let none = Scene { hinge: Some(Hinge { quadratic: 0.0, cubic: 0.0 }), ..scene.clone() };
    let plain = simulate(&Scene { hinge: None, ..scene }, &design, false).signals;
    let apart = relative(&simulate(&none, &design, false).signals, &plain);
    assert!(apart < 1e-12 && relative(&here.signals, &plain) > 0.1, "{apart:e}");
}
