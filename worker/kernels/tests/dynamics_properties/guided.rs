//! Guided units.

use crate::common::{pool, relative};
use crate::helpers::{plan, pushes, small_scene};
use metasense_kernels::body::Layout;
use metasense_kernels::dynamics::{
    EdgeContact, Integrator, Outcome, Panel, Precision, PrescribedMotion, Scene, Wrt, highest_frequency, run,
};

/// Unrotated squares in three columns, with a force and base motion along the middle column. By mirror symmetry, units of this column
/// neither move sideways nor rotate, so guides that prevent both change nothing.
fn mirrored(guided: bool) -> Scene {
    let layout = Layout::planar(3, 4, 15.0, 2.25);
    let guides = if guided { vec![1, 4, 7, 10] } else { Vec::new() };
    let shaken = Panel { moves: Some(PrescribedMotion::Base(1e-4)), ..Panel::central(0, [0.0, 1.0]) };
    Scene {
        clamped: vec![0, 2],
        guided: guides.into_iter().map(|unit| (unit, [true, false, true])).collect(),
        panels: vec![Panel::central(10, [0.0, -1.0]), shaken],
        sensors: vec![3, 4, 8],
        contact: Some(EdgeContact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 1.6 }),
        layout,
        ..small_scene()
    }
}

/// Signals and gradients in the forces equal those without guides, for every kind of steps.
#[test]
fn guides_on_a_mirror_change_nothing() {
    let scenes = [mirrored(false), mirrored(true)];
    let forces = pushes(&scenes[0], 2, 0.3);
    let design = scenes[0].layout.initial_design(0.0);
    let highest = [&scenes[0], &scenes[1]].map(|scene| highest_frequency(scene, &design));
    assert!(highest[1] <= highest[0] * (1.0 + 1e-9), "{highest:?}");
    for (method, steps) in [(Integrator::Leapfrog, 60), (Integrator::Nystrom6, 24), (Integrator::Tsit5, 0)] {
        for precision in [Precision::Double, Precision::Single] {
            if method == Integrator::Tsit5 && precision == Precision::Single {
                continue;
            }
            let [free, held] = [&scenes[0], &scenes[1]].map(|scene| {
                let plan = metasense_kernels::dynamics::IntegrationPlan { precision, ..plan(method, steps) };
                let run = run(scene, &design, &forces, &plan, true, &pool(1));
                assert_eq!(run.outcomes, [Outcome::Ok; 2]);
                let gradient = run.vjp(&run.signals, Wrt::Forces, &pool(1));
                let (x, v) = run.tape.as_ref().unwrap().state(1, 20);
                (run.signals, gradient.forces.expect("asked for"), x, v)
            });
            // each f32 run has its own rounding, 1.4e-4 of the signals (MODEL.md)
            let near = if precision == Precision::Single { 2e-4 } else { 1e-7 };
            let off = [relative(&held.0, &free.0), relative(&held.1, &free.1)];
            assert!(off.iter().all(|off| *off < near), "{method:?} {precision:?}: {off:?}");
            for unit in [1, 4, 7, 10] {
                assert!([0, 2].iter().all(|d| held.2[unit][*d] == 0.0 && held.3[unit][*d] == 0.0));
                assert!(held.2[unit][1] != 0.0);
            }
        }
    }
}
