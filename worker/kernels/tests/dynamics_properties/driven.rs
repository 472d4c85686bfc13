//! Driven units: their motion is prescribed, and the body follows.

use crate::common::{norm, pool, relative};
use crate::helpers::{by_too_few_steps, plan, pushes, shaken, small_scene};
use metasense_kernels::dynamics::{
    AccelerationFrame, EdgeContact, Forces, IntegrationPlan, Integrator, LigamentStiffness, Outcome, Panel,
    Precision, PrescribedMotion, Scene, Tangent, Wrt, highest_frequency, run,
};

/// Mass (Mg) for which 0.4 N move the unit by about 1 mm in 0.1 s.
const MASS: f64 = 1e-3;

fn drives(unit: usize) -> Panel {
    Panel { moves: Some(PrescribedMotion::Unit(MASS)), ..Panel::central(unit, [0.6, 0.8]) }
}

/// Unit 6 is driven; a force acts on a node of another. Sensors are on unit 6 and on a free unit.
fn scene() -> Scene {
    let base = small_scene();
    Scene { panels: vec![drives(6), base.panels[1]], sensors: vec![6, 4], ..base }
}

/// For every method x = d ∬ f/M, a = d f/M, and the unit does not rotate. The highest frequency is that with the unit held.
#[test]
fn a_driven_unit_moves_as_its_history_says() {
    let scene = scene();
    let (design, forces) = (shaken(&scene), pushes(&scene, 3, 0.4));
    let (row, delta) = (scene.instants + 1, scene.duration / scene.instants as f64);
    let single = |plan: IntegrationPlan| IntegrationPlan { precision: Precision::Single, ..plan };
    for (plan, off) in [
        (plan(Integrator::Tsit5, 0), 1e-8),
        (plan(Integrator::Leapfrog, 120), 1e-4), // order 2
        (plan(Integrator::Nystrom6, 12), 1e-8),
        (single(plan(Integrator::Nystrom6, 12)), 1e-6),
    ] {
        let run = run(&scene, &design, &forces, &plan, true, &pool(1));
        let (mut found, mut truth, mut places) = (Vec::new(), Vec::new(), [Vec::new(), Vec::new()]);
        let mut turned = 0.0f64;
        for i in 0..3 {
            let f = &forces.values[2 * i * row..][..row];
            let (mut x, mut v) = (0.0, 0.0);
            for n in 1..row {
                let read = &run.signals[6 * (i * scene.instants + n - 1)..][..6];
                found.extend([read[0], read[1]]);
                truth.extend([0.6 * f[n] / MASS, 0.8 * f[n] / MASS]);
                turned = turned.max((read[2] / read[5]).abs());
                x += delta * v + delta * delta * (f[n - 1] / 3.0 + f[n] / 6.0) / MASS;
                v += delta * 0.5 * (f[n - 1] + f[n]) / MASS;
                let (at, speed) = run.tape.as_ref().expect("kept").state(i, n);
                places[0].extend([at[6][0], at[6][1], speed[6][0], speed[6][1]]);
                places[1].extend([0.6 * x, 0.8 * x, 0.6 * v, 0.8 * v]);
            }
        }
        let by = [relative(&found, &truth), relative(&places[0], &places[1])];
        assert!(by[0] < off && by[1] < off && turned < 1e-6, "{plan:?}: {by:?}, {turned:e}");
    }
    let [held, driven] = [vec![0, 1, 2, 6], vec![0, 1, 2]].map(|clamped| {
        let panels = if clamped.len() == 4 { vec![] } else { scene.panels.clone() };
        highest_frequency(&Scene { clamped, panels, ..scene.clone() }, &design)
    });
    assert!((driven / held - 1.0).abs() < 1e-6, "{driven} {held}");
}

/// Driving all held units is equivalent to a shaken base without damping: signals and gradients in design and forces are equal.
#[test]
fn driving_all_held_units_is_shaking_the_base() {
    let base = small_scene();
    let shakes = Panel { moves: Some(PrescribedMotion::Base(MASS)), ..drives(0) };
    let shaken_base =
        Scene { panels: vec![shakes, base.panels[1]], damping_ratio: 0.0, sensors: vec![4, 7], ..base };
    let each = shaken_base.clamped.iter().map(|u| drives(*u)).chain([shaken_base.panels[1]]);
    let driven = Scene { panels: each.collect(), clamped: Vec::new(), ..shaken_base.clone() };
    let (design, forces) = (shaken(&driven), pushes(&shaken_base, 3, 0.4));
    let row = driven.instants + 1;
    let same = |own: &[f64]| [&own[..row], &own[..row], own].concat();
    let values: Vec<f64> = forces.values.chunks(2 * row).flat_map(same).collect();
    let all = Forces { panels: 4, values, ..forces.clone() };
    for plan in [plan(Integrator::Tsit5, 0), plan(Integrator::Leapfrog, 60), plan(Integrator::Nystrom6, 12)] {
        let one = run(&shaken_base, &design, &forces, &plan, true, &pool(1));
        let other = run(&driven, &design, &all, &plan, true, &pool(1));
        let least = if plan.method == Integrator::Tsit5 { 1e-5 } else { 1e-8 };
        let off = relative(&other.signals, &one.signals);
        assert!(off < least, "{:?}: {off:e}", plan.method);
        let [mut ours, theirs] = [&other, &one].map(|run| run.vjp(&one.signals, Wrt::Forces, &pool(1)));
        let off = relative(&ours.design, &theirs.design);
        assert!(off < 1e3 * least && norm(&theirs.design) > 0.0, "{:?}, design: {off:e}", plan.method);
        let sums = ours.forces.take().expect("asked for");
        let sum = |own: &[f64]| -> Vec<f64> {
            let of_three = (0..row).map(|n| own[n] + own[row + n] + own[2 * row + n]);
            of_three.chain(own[3 * row..].iter().copied()).collect()
        };
        let sums: Vec<f64> = sums.chunks(4 * row).flat_map(sum).collect();
        let off = relative(&sums, &theirs.forces.expect("asked for"));
        assert!(off < 1e3 * least, "{:?}, forces: {off:e}", plan.method);
    }
}

/// Gradients in design and forces equal differences, also for the driven unit's own nodes; jvp and vjp are adjoint.
#[test]
fn gradients_beside_a_driven_unit_are_those_of_differences() {
    let contact = Some(EdgeContact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.9 });
    for scene in [scene(), Scene { frame: AccelerationFrame::Body, contact, ..scene() }] {
        for plan in [plan(Integrator::Leapfrog, 120), plan(Integrator::Nystrom6, 12)] {
            let (design, forces) = (shaken(&scene), pushes(&scene, 3, 0.2));
            let at = |design: &[f64], forces: &Forces| run(&scene, design, forces, &plan, true, &pool(1));
            let here = at(&design, &forces);
            let size = norm(&here.signals).powi(2);
            let cotangent: Vec<f64> = here.signals.iter().map(|s| s / size).collect();
            let found = here.vjp(&cotangent, Wrt::Forces, &pool(1));
            let pushed = found.forces.expect("asked for");
            let wave = |n: usize| (0..n).map(|i| (0.3 + 2.3 * i as f64).cos()).collect::<Vec<f64>>();
            let own = |groups: &[Option<usize>]| {
                let mut along = vec![0.0; design.len()];
                groups.iter().flatten().for_each(|g| (along[2 * g], along[2 * g + 1]) = (0.6, -0.8));
                along
            };
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let moved = |at: &[f64], along: &[f64], by: f64| -> Vec<f64> {
                at.iter().zip(along).map(|(a, d)| a + by * d).collect()
            };
            for (what, along) in
                [("design", wave(design.len())), ("own nodes", own(&scene.layout.groups.of_nodes[6]))]
            {
                let energy =
                    |by: f64| 0.5 * norm(&at(&moved(&design, &along, by), &forces).signals).powi(2) / size;
                let (difference, slope) = ((energy(1e-6) - energy(-1e-6)) / 2e-6, dot(&found.design, &along));
                assert!((difference / slope - 1.0).abs() < 1e-5, "{what}: {difference} {slope}");
                let readings = here.signals.len() / forces.samples;
                let forward: f64 = (0..forces.samples)
                    .map(|sample| {
                        let tangent = Tangent { design: &along, ..Tangent::default() };
                        dot(&here.jvp(sample, tangent).1, &cotangent[sample * readings..][..readings])
                    })
                    .sum();
                assert!((forward / slope - 1.0).abs() < 1e-6, "{what}: {forward} {slope}");
            }
            let along = wave(forces.values.len());
            let energy = |by: f64| {
                let values = moved(&forces.values, &along, by);
                0.5 * norm(&at(&design, &Forces { values, ..forces.clone() }).signals).powi(2) / size
            };
            let (difference, slope) = ((energy(1e-5) - energy(-1e-5)) / 2e-5, dot(&pushed, &along));
            assert!((difference / slope - 1.0).abs() < 1e-5, "forces: {difference} {slope}");
        }
    }
}

/// The forces of a driven unit's ligaments do work on the body: unstable steps are detected, and stable ones are not rejected. Vibrations
/// with the tolerated 1/20 of the work are many times the signals here, because most work bends ligaments.
#[test]
fn a_driven_unit_hides_no_instability() {
    let (mut named, mut refined, mut worst) = (0, 0, 0.0f64);
    let quick = Panel { moves: Some(PrescribedMotion::Unit(0.01 * MASS)), ..drives(6) };
    let base = Scene {
        sensors: vec![4, 7],
        panels: vec![quick, small_scene().panels[1]],
        duration: 0.02,
        ..scene()
    };
    for stretch in [3.0, 300.0, 3e5] {
        let scene = Scene { stiffness: LigamentStiffness { stretch, ..base.stiffness }, ..base.clone() };
        let scene = Scene { panels: vec![scene.panels[0]], ..scene };
        let found = by_too_few_steps(&scene);
        worst = worst.max(found.worst);
        named += found.unstable;
        refined += found.refined;
    }
    assert!(
        named > 0 && refined > 0 && worst < 100.0,
        "{named} unstable, {refined} refined, {worst} times the truth"
    );
    let contact = Some(EdgeContact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.9 });
    let base_too = Panel { moves: Some(PrescribedMotion::Base(MASS)), ..Panel::central(0, [0.6, 0.8]) };
    let both = Scene { panels: vec![base.panels[0], base_too], ..base.clone() };
    for (scene, amplitude) in
        [(both, 0.4), (base.clone(), 4.0), (Scene { contact, ..base.clone() }, 0.4), (base, 0.04)]
    {
        for precision in [Precision::Double, Precision::Single] {
            let (design, forces) = (shaken(&scene), pushes(&scene, 3, amplitude));
            let plan = IntegrationPlan { precision, ..plan(Integrator::Nystrom4, 200) };
            let run = run(&scene, &design, &forces, &plan, false, &pool(2));
            let well = (&[Outcome::Ok; 3][..], 0);
            assert_eq!((&run.outcomes[..], run.counters.rejected), well, "{amplitude} N, {precision:?}");
        }
    }
}
