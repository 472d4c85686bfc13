//! Forces: position and time of action, through panels and the base, and gradients in them.

use crate::common::{norm, pool, relative};
use crate::helpers::{EQUAL_STEPS, plan, pushes, shaken, small_scene, struck};
use metasense_kernels::body::{Geometry, Layout};
use metasense_kernels::dynamics::{
    AccelerationFrame, Accuracy, EdgeContact, Forces, IntegrationPlan, Integrator, IntegratorSettings,
    Outcome, Panel, Precision, PrescribedMotion, Scene, Simulation, Wrt, run, tune,
};

/// Before its first force, a sample's signals are zero. Later signals and the gradient do not depend on the other samples in its
/// vector.
#[test]
fn samples_begin_with_their_forces() {
    for frame in [AccelerationFrame::World, AccelerationFrame::Body] {
        let scene = Scene { frame, ..small_scene() };
        let (design, mut forces) = (shaken(&scene), pushes(&scene, 21, 0.4));
        let (instants, width) = (scene.instants, 3 * scene.sensors.len());
        // the last sample has no force
        let onset = |i: usize| (7 * i) % (instants + 1);
        for i in 0..forces.samples {
            let begin = if i + 1 == forces.samples { instants + 1 } else { onset(i) };
            for k in 0..forces.panels {
                let history = &mut forces.values[(i * forces.panels + k) * (instants + 1)..][..instants + 1];
                history
                    .iter_mut()
                    .enumerate()
                    .for_each(|(n, f)| *f = if n <= begin { 0.0 } else { *f + 0.1 });
            }
        }
        for precision in [Precision::Double, Precision::Single] {
            let plan = IntegrationPlan { precision, ..plan(Integrator::Nystrom4, 24) };
            let all = run(&scene, &design, &forces, &plan, true, &pool(2));
            let of = |run: &Simulation| run.vjp(&run.signals, Wrt::Design, &pool(1)).design;
            let together = of(&all);
            let mut sum = vec![0.0; together.len()];
            for i in 0..forces.samples {
                let own = forces.select(&[i]);
                let alone = run(&scene, &design, &own, &plan, true, &pool(1));
                let signals = &all.signals[i * instants * width..][..instants * width];
                assert_eq!(signals, alone.signals, "sample {i}");
                let still = if i + 1 == forces.samples { instants } else { onset(i) };
                assert!(signals[..still * width].iter().all(|a| *a == 0.0), "sample {i}");
                assert_eq!(signals.iter().all(|a| *a == 0.0), still >= instants, "sample {i}");
                let gradient = of(&alone);
                sum.iter_mut().zip(gradient).for_each(|(sum, g)| *sum += g);
            }
            let off = relative(&together, &sum);
            assert!(off < 1e-12 && norm(&sum) > 0.0, "{frame:?} {precision:?}: {off:e}");
        }
    }
}

/// A free unit without damping: a = d f/m and ω = (r × d)∫f/J, independent of earlier samples in the lane. A force on the centroid
/// causes no rotation; the effect of a force on a node follows the design; a couple only rotates.
#[test]
fn a_blow_off_the_centroid_turns_the_unit() {
    let layout = Layout::planar(1, 1, 15.0, 2.25);
    let scene = Scene { layout, damping_ratio: 0.0, clamped: Vec::new(), sensors: vec![0], ..small_scene() };
    let centre = Panel::central(0, [0.6, -0.8]);
    let scene = Scene { panels: vec![centre], ..scene };
    let design = scene.layout.initial_design(0.4363);
    let central = pushes(&scene, 21, 0.4);
    let blows = struck(&scene, central.clone());
    let Geometry { mass, moment, arms, .. } = Geometry::new(&scene.layout, &design, scene.density);
    let (m, j, delta) = (mass[0], moment[0], scene.duration / scene.instants as f64);
    for plan in [plan(Integrator::Tsit5, 0), plan(Integrator::Leapfrog, 2), plan(Integrator::Nystrom6, 2)] {
        for forces in [&central, &blows] {
            let run = run(&scene, &design, forces, &plan, false, &pool(1));
            let mut truth = Vec::new();
            for (i, f) in forces.values.chunks(scene.instants + 1).enumerate() {
                let [x, y, arm] = forces.strike(&scene.panels, i, 0);
                let mut impulse = 0.0;
                for pair in f.windows(2) {
                    impulse += 0.5 * delta * (pair[0] + pair[1]);
                    truth.extend([x * pair[1] / m, y * pair[1] / m, arm * impulse / j]);
                }
            }
            let turns = |s: &[f64]| -> Vec<f64> { s.iter().skip(2).step_by(3).copied().collect() };
            let (off, omega) = (relative(&run.signals, &truth), turns(&run.signals));
            assert!(off < 1e-12 && relative(&omega, &turns(&truth)) < 1e-12, "{:?}: {off:e}", plan.method);
            assert_eq!(norm(&omega) > 0.0, !forces.strikes.is_empty());
        }
    }
    let [x, y] = arms[1];
    for (panel, turns) in [
        (Panel { node: Some(1), moment: 0.5, ..centre }, 0.5 - 0.8 * x - 0.6 * y),
        (Panel { moment: 3.0, ..Panel::central(0, [0.0; 2]) }, 3.0),
    ] {
        let scene = Scene { panels: vec![panel], ..scene.clone() };
        let off_centre = Panel { node: None, moment: turns, ..panel };
        let same = Scene { panels: vec![off_centre], ..scene.clone() };
        for plan in [plan(Integrator::Tsit5, 0), plan(Integrator::Leapfrog, 2)] {
            let [one, other] =
                [&scene, &same].map(|scene| run(scene, &design, &central, &plan, false, &pool(1)).signals);
            assert!(relative(&one, &other) < 1e-14 && norm(&one) > 0.0, "{panel:?}");
        }
        let [px, py] = panel.foot([0.0; 2], &arms);
        assert!(panel.is_couple() || (px * -0.8 - py * 0.6 - turns).abs() < 1e-12, "{panel:?}");
    }
    // 2 mm to the left of a blow to the right is above the centroid: clockwise rotation
    assert_eq!(Panel::central(0, [1.0, 0.0]).deviated_strike(2.0, 0.0), [1.0, 0.0, -2.0]);
}

/// A shaken base is equivalent to a force −m a_B on every free unit plus a_B in the readings; a body without supports reads zero.
/// Gradients in design and forces equal differences.
#[test]
fn a_shaken_base_is_felt() {
    let mass_of_base = 3e-5;
    let shakes = Panel { moves: Some(PrescribedMotion::Base(mass_of_base)), ..Panel::central(0, [0.6, 0.8]) };
    for frame in [AccelerationFrame::World, AccelerationFrame::Body] {
        for plan in
            [plan(Integrator::Tsit5, 0), plan(Integrator::Leapfrog, 120), plan(Integrator::Nystrom6, 12)]
        {
            let base = small_scene();
            let scene = Scene { frame, panels: vec![shakes, base.panels[0]], ..base };
            let (design, forces) = (shaken(&scene), pushes(&scene, 9, 0.15));
            let here = run(&scene, &design, &forces, &plan, true, &pool(1));

            // the same motion by a force on each unit
            let mass = scene.geometry(&design).mass;
            let free: Vec<usize> = (0..mass.len()).filter(|u| !scene.clamped.contains(u)).collect();
            let each = free.iter().map(|u| Panel::central(*u, [-0.6, -0.8])).chain([scene.panels[1]]);
            let forced = Scene { panels: each.collect(), frame: AccelerationFrame::World, ..scene.clone() };
            let row = scene.instants + 1;
            let values = forces.values.chunks(2 * row).flat_map(|own| {
                let by = free.iter().map(|u| mass[*u] / mass_of_base);
                let shaken = by.flat_map(|by| own[..row].iter().map(move |f| by * f));
                shaken.chain(own[row..].iter().copied()).collect::<Vec<_>>()
            });
            let values = values.collect();
            let all = Forces { panels: free.len() + 1, values, ..forces.clone() };
            if frame == AccelerationFrame::World {
                let mut other = run(&forced, &design, &all, &plan, false, &pool(1)).signals;
                for (i, own) in other.chunks_mut(6).enumerate() {
                    let f = forces.values[i / scene.instants * 2 * row + i % scene.instants + 1];
                    for sensor in 0..2 {
                        own[3 * sensor] += 0.6 * f / mass_of_base;
                        own[3 * sensor + 1] += 0.8 * f / mass_of_base;
                    }
                }
                let off = relative(&here.signals, &other);
                let least = if plan.method == Integrator::Tsit5 { 1e-4 } else { 1e-10 };
                assert!(off < least, "{:?}: {off:e}", plan.method);
            }

            let size = norm(&here.signals).powi(2);
            let cotangent: Vec<f64> = here.signals.iter().map(|s| s / size).collect();
            let energy = |design: &[f64], forces: &Forces| {
                0.5 * norm(&run(&scene, design, forces, &plan, true, &pool(1)).signals).powi(2) / size
            };
            let along = |n: usize| (0..n).map(|i| (2.3 * i as f64).cos()).collect::<Vec<f64>>();
            let moved = |at: &[f64], along: &[f64], by: f64| -> Vec<f64> {
                at.iter().zip(along).map(|(a, d)| a + by * d).collect()
            };
            let slope =
                |gradient: &[f64], along: &[f64]| gradient.iter().zip(along).map(|(g, d)| g * d).sum::<f64>();
            let found = here.vjp(&cotangent, Wrt::Forces, &pool(1));
            let (shape, push) = (along(design.len()), along(forces.values.len()));
            let by_shape = |by| energy(&moved(&design, &shape, by), &forces);
            let by_force =
                |by| energy(&design, &Forces { values: moved(&forces.values, &push, by), ..forces.clone() });
            let steps = if plan.method == Integrator::Tsit5 { 1e-3 } else { 1e-6 };
            for (what, difference, slope) in [
                ("design", (by_shape(1e-4) - by_shape(-1e-4)) / 2e-4, slope(&found.design, &shape)),
                (
                    "forces",
                    (by_force(1e-5) - by_force(-1e-5)) / 2e-5,
                    slope(&found.forces.expect("asked for"), &push),
                ),
            ] {
                assert!(
                    (difference / slope - 1.0).abs() < steps,
                    "{what}, {frame:?}, {:?}: {difference} {slope}",
                    plan.method
                );
            }
        }
    }
    let layout = Layout::planar(1, 1, 15.0, 2.25);
    let loose = Scene {
        layout,
        clamped: Vec::new(),
        sensors: vec![0],
        panels: vec![shakes],
        damping_ratio: 0.0,
        ..small_scene()
    };
    let forces = pushes(&loose, 3, 0.4);
    let run = run(
        &loose,
        &loose.layout.initial_design(0.3),
        &forces,
        &plan(Integrator::Nystrom6, 4),
        false,
        &pool(1),
    );
    assert!(norm(&run.signals) < 1e-9 * 0.4 / mass_of_base, "{:e}", norm(&run.signals));
}

/// |J(f + εδ) − J(f) − ε g·δ| has slope 2 in ε, with J half the squared norm of the signals and two kinks per interval.
#[test]
fn gradients_in_the_forces_pass_a_taylor_test() {
    let contact = Some(EdgeContact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.9 });
    let base = small_scene();
    let mut slopes = Vec::new();
    for scene in [base.clone(), Scene { frame: AccelerationFrame::Body, contact, ..base }] {
        let fine = Scene { instants: 2 * scene.instants, ..scene.clone() };
        let (design, forces) = (shaken(&scene), struck(&scene, pushes(&fine, 9, 0.15)));
        for (method, steps) in
            [(Integrator::Tsit5, 0), (Integrator::Leapfrog, 120), (Integrator::Nystrom6, 12)]
        {
            let plan = plan(method, steps);
            let at = |forces: &Forces| run(&scene, &design, forces, &plan, true, &pool(1));
            let here = at(&forces);
            let size = norm(&here.signals).powi(2);
            let cotangent: Vec<f64> = here.signals.iter().map(|s| s / size).collect();
            let gradient = here.vjp(&cotangent, Wrt::Forces, &pool(1));
            let gradient = gradient.forces.expect("asked for");
            let wave = |i: usize| 0.5 * (0.13 * i as f64).sin() + 0.2 * (2.1 * i as f64).sin();
            let along: Vec<f64> = (0..gradient.len()).map(wave).collect();
            let slope: f64 = gradient.iter().zip(&along).map(|(g, a)| g * a).sum();
            assert!(slope != 0.0);
            let r = [0.01, 0.005, 0.0025].map(|epsilon| {
                let values = forces.values.iter().zip(&along).map(|(f, a)| f + epsilon * a).collect();
                let there = norm(&at(&Forces { values, ..forces.clone() }).signals).powi(2) / size;
                (0.5 * (there - 1.0) - epsilon * slope).abs()
            });
            slopes.push((method, (r[0] / r[1]).log2(), (r[1] / r[2]).log2()));
        }
    }
    assert!(slopes.iter().all(|(_, a, b)| [a, b].iter().all(|s| (1.9..2.1).contains(*s))), "{slopes:?}");
}

/// Zero forces have a gradient too: before a sample's first force, and in samples without force. Failed samples have none. With
/// `Wrt::Design`, sweeps start at the first force; dα is the same.
#[test]
fn forces_of_zero_have_a_gradient() {
    let scene = small_scene();
    let (design, mut forces) = (shaken(&scene), pushes(&scene, 4, 0.4));
    let row = scene.instants + 1;
    for (i, history) in forces.values.chunks_mut(2 * row).enumerate() {
        for (n, f) in history.iter_mut().enumerate() {
            *f *= [f64::from(u8::from(n % row > 9)), 1.0, 0.0, 1e300][i];
        }
    }
    for (method, steps) in [(Integrator::Tsit5, 0), (Integrator::Leapfrog, 60), (Integrator::Nystrom4, 24)] {
        let plan = plan(method, steps);
        let at = |forces: &Forces| run(&scene, &design, forces, &plan, true, &pool(1));
        let here = at(&forces);
        assert!(
            here.outcomes[..3] == [Outcome::Ok; 3] && here.outcomes[3] != Outcome::Ok,
            "{:?}",
            here.outcomes
        );
        let cotangent: Vec<f64> = (0..here.signals.len()).map(|i| (0.7 * i as f64).sin()).collect();
        let [plain, gradient] = [Wrt::Design, Wrt::Forces].map(|wrt| here.vjp(&cotangent, wrt, &pool(1)));
        let off = relative(&gradient.design, &plain.design);
        assert!(off < 1e-11 && plain.forces.is_none(), "{method:?}: {off:e}");
        let first = at(&forces.select(&[0]));
        let [less, more] = [Wrt::Design, Wrt::Forces].map(|wrt| {
            first.vjp(&cotangent[..cotangent.len() / 4], wrt, &pool(1)).counters.force_evaluations
        });
        assert_eq!(less < more, method != Integrator::Tsit5, "{method:?}: {less} {more}");
        let found = gradient.forces.expect("asked for");
        assert!(found[3 * 2 * row..].iter().all(|g| *g == 0.0));
        // Where nothing moves, adaptive steps are too long for an accurate gradient: differences use other steps.
        let entries = [10, 2 * row + 7, 3 * row, 5, row + 3, 4 * row, 5 * row + 12];
        for at_entry in &entries[..if method == Integrator::Tsit5 { 3 } else { 7 }] {
            let value = |step: f64| {
                let mut moved = forces.clone();
                moved.values[*at_entry] += step;
                at(&moved).signals.iter().zip(&cotangent).map(|(s, c)| s * c).sum::<f64>()
            };
            let slope = (value(1e-3) - value(-1e-3)) / 2e-3;
            let apart = (found[*at_entry] / slope - 1.0).abs();
            assert!(
                apart < 1e-4 && slope != 0.0,
                "{method:?}, entry {at_entry}: {} {slope}",
                found[*at_entry]
            );
        }
    }
}

/// Histories with four kinks per interval give the signals and gradients of a clock four times as fine, at every fourth instant.
/// Steps that miss kinks are rounded up; a pilot respects the kinks.
#[test]
fn forces_may_have_a_finer_clock_than_the_signals() {
    let coarse = Scene { frame: AccelerationFrame::Body, ..small_scene() };
    let fine = Scene { instants: 4 * coarse.instants, ..coarse.clone() };
    let (design, mut forces) = (shaken(&coarse), pushes(&fine, 2, 0.4));
    forces.values.iter_mut().enumerate().for_each(|(i, f)| *f += 0.1 * (1.9 * i as f64).sin());
    let width = 3 * coarse.sensors.len();
    let methods = EQUAL_STEPS.map(|(method, _, steps)| (method, steps)).into_iter();
    for (method, steps) in methods.chain([(Integrator::Tsit5, 0)]) {
        let solve = |scene: &Scene, steps| run(scene, &design, &forces, &plan(method, steps), true, &pool(1));
        let (ours, theirs) = (solve(&coarse, 4 * steps), solve(&fine, steps));
        let every_fourth: Vec<f64> =
            theirs.signals.chunks(4 * width).flat_map(|c| &c[3 * width..]).copied().collect();
        let cotangent: Vec<f64> = (0..ours.signals.len()).map(|i| (0.7 * i as f64).sin()).collect();
        let mut spread = vec![0.0; theirs.signals.len()];
        for (to, from) in spread.chunks_mut(4 * width).zip(cotangent.chunks(width)) {
            to[3 * width..].copy_from_slice(from);
        }
        let gradient = |run: &Simulation, cotangent: &[f64]| run.vjp(cotangent, Wrt::Design, &pool(1)).design;
        let (g, h) = (gradient(&ours, &cotangent), gradient(&theirs, &spread));
        let errors = [relative(&ours.signals, &every_fourth), relative(&g, &h)];
        assert!(errors.iter().all(|e| *e < 1e-11) && norm(&g) > 0.0, "{method:?}: {errors:?}");
        if steps > 0 {
            assert_eq!(solve(&coarse, 4 * steps - 1).signals, ours.signals, "{method:?}");
        }
    }
    let solver = IntegratorSettings::new(Integrator::Auto, Accuracy(1e-3));
    let tuned = tune(&coarse, &design, &forces, &solver, &pool(1));
    assert!(tuned.plan.steps.count().is_multiple_of(4) && tuned.error.is_some_and(|e| e < 1e-3), "{tuned:?}");
}

/// The rule and the examples in MODEL.md.
#[test]
fn planar_panels_follow_the_rule() {
    let panels = |columns, rows, k| Layout::planar(columns, rows, 15.0, 2.25).top_panels(k);
    assert_eq!(panels(6, 6, 2), Some(vec![31, 34]));
    assert_eq!(panels(8, 1, 4), Some(vec![1, 3, 4, 6]));
    assert_eq!(panels(8, 4, 3), Some(vec![25, 28, 30]));
    assert_eq!(panels(4, 4, 5), None);
    assert_eq!(panels(5, 3, 1), Some(vec![12]));
    assert_eq!(panels(6, 6, 6), Some(vec![30, 31, 32, 33, 34, 35]));
}
