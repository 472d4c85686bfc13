//! Relaxing ligaments, compared with closed formulas and with scenes without relaxation.

mod common;

use common::{pool, relative, scene};
use metasense_kernels::dynamics::{
    EdgeContact, Forces, IntegrationPlan, Integrator, LigamentStiffness, MaxwellBranch, Outcome, Panel,
    Scene, run,
};
use std::f64::consts::TAU;

fn pulses(scene: &Scene, samples: usize) -> Forces {
    let value = |n: usize| {
        let (i, n) = (n / (scene.instants + 1), n % (scene.instants + 1));
        (0.3 + 0.02 * i as f64) * (0.5 * TAU * n as f64 / scene.instants as f64).sin().powi(2)
    };
    let values = (0..samples * (scene.instants + 1)).map(value).collect();
    Forces { samples, panels: 1, instants: scene.instants, values, strikes: Vec::new() }
}

fn signals(scene: &Scene, forces: &Forces, steps: usize) -> Vec<f64> {
    let mut design = scene.layout.initial_design(0.4363);
    design.iter_mut().enumerate().for_each(|(i, a)| *a += 0.3 * (1.7 * i as f64).sin());
    let found =
        run(scene, &design, forces, &IntegrationPlan::equal(Integrator::Nystrom6, steps), false, &pool(2));
    assert!(found.outcomes.iter().all(|o| *o == Outcome::Ok), "{:?}", found.outcomes);
    found.signals
}

fn relaxing(scene: &Scene, share: f64, time: f64) -> Scene {
    Scene { relaxation: Some(MaxwellBranch { share, time }), ..scene.clone() }
}

/// A unit on one ligament under F sin ωt: F/x = k(1 + g iωτ/(1 + iωτ)) − mω² + iωc. The loss (Im(F/x) − ωc)/k is gωτ/(1 + ω²τ²), and
/// the storage (Re(F/x) + mω²)/k is 1 + gω²τ²/(1 + ω²τ²).
#[test]
fn losses_are_those_of_a_maxwell_branch() {
    let mut apart = Vec::new();
    for linearised in [true, false] {
        for of_rate in [0.1, 1.0, 10.0] {
            // so many points per cycle that a piecewise linear force is nearly a sine
            let (omega, share, cycles, points) = (TAU * 150.0, 0.3, 60, 512);
            let base = Scene {
                // the force acts along the only ligament; zero design
                panels: vec![Panel::central(1, [0.0, 1.0])],
                damping_ratio: 0.4,
                linearised,
                duration: cycles as f64 * TAU / omega,
                ..scene(1, 2, cycles * points)
            };
            let scene = relaxing(&base, share, of_rate / omega);
            let small = 1e-4;
            let at = |n: usize| omega * n as f64 * scene.duration / scene.instants as f64;
            let values = (0..=scene.instants).map(|n| small * at(n).sin()).collect();
            let forces = Forces { values, ..pulses(&scene, 1) };
            let design = vec![0.0; scene.layout.design_len()];
            let plan = IntegrationPlan::equal(Integrator::Nystrom6, 1);
            let found = run(&scene, &design, &forces, &plan, false, &pool(1));
            // fits a_y = −ω² x over the second half of the cycles: x = p sin + q cos
            let (mut p, mut q, from) = (0.0, 0.0, scene.instants / 2);
            for n in from..scene.instants {
                let x = -found.signals[3 * n + 1] / omega.powi(2);
                (p, q) = (p + x * at(n + 1).sin(), q + x * at(n + 1).cos());
            }
            let by = 2.0 / (scene.instants - from) as f64;
            // amplitude at ω of the piecewise linear force
            let half = 0.5 * TAU / points as f64;
            let size = small * (half.sin() / half).powi(2);
            let (p, q) = (by * p / size, by * q / size);
            let square = p * p + q * q;
            let (area, _) = scene.layout.mean_unit();
            let (k, m) = (scene.stiffness.stretch, scene.density * area);
            let c = 2.0 * scene.damping_ratio * (m * scene.stiffness.shear).sqrt();
            let loss = (-q / square - omega * c) / k;
            let storage = (p / square + m * omega * omega) / k;
            let rate = of_rate;
            let of_loss = share * rate / (1.0 + rate * rate);
            let of_storage = 1.0 + share * rate * rate / (1.0 + rate * rate);
            apart.push((linearised, of_rate, loss / of_loss - 1.0, storage / of_storage - 1.0));
        }
    }
    let close = |off: f64| off.abs() < 2e-3;
    assert!(apart.iter().all(|(_, _, loss, storage)| close(*loss) && close(*storage)), "{apart:?}");
}

/// A branch that never relaxes is equivalent to the stiffness (1 + g)k; one that relaxes at once, or with g = 0, has no effect. Holds
/// with contact and linear strains too. C is constant, because it depends only on the ligaments' stiffness.
#[test]
fn slow_and_quick_branches_are_springs() {
    let contact = Some(EdgeContact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.9 });
    let base = scene(3, 3, 20);
    for scene in [base.clone(), Scene { contact, ..base.clone() }, Scene { linearised: true, ..base }] {
        let forces = pulses(&scene, 11);
        let share: f64 = 0.44;
        let LigamentStiffness { stretch, shear, bend } = scene.stiffness;
        let [stretch, shear, bend] = [stretch, shear, bend].map(|k| (1.0 + share) * k);
        let damping_ratio = scene.damping_ratio / (1.0 + share).sqrt();
        let stiff =
            Scene { stiffness: LigamentStiffness { stretch, shear, bend }, damping_ratio, ..scene.clone() };
        let (plain, stiff) = (signals(&scene, &forces, 60), signals(&stiff, &forces, 60));
        let off = [(0.0, 0.01, &plain), (share, 1e6, &stiff), (share, 1e-6, &plain), (share, 5e-7, &plain)]
            .map(|(share, time, truth)| {
                relative(&signals(&relaxing(&scene, share, time), &forces, 120), truth)
            });
        let apart = relative(&plain, &stiff);
        let [none, slow, quick, quicker] = off;
        // a fast branch leaves damping in proportion to its time
        let vanishes = quick < 0.1 * apart && (0.4..0.7).contains(&(quicker / quick));
        assert!(none < 1e-5 && slow < 1e-5 && vanishes && apart > 0.1, "{off:?} {apart}");
    }
}

/// Halving the steps reduces the error to a sixteenth.
#[test]
fn the_order_is_four() {
    let base = scene(3, 3, 20);
    let forces = pulses(&base, 3);
    let mut orders = Vec::new();
    for time in [1e-3, 1e-2, 0.1] {
        let scene = relaxing(&base, 0.4, time);
        let truth = signals(&scene, &forces, 384);
        let off = [24, 48, 96].map(|steps| relative(&signals(&scene, &forces, steps), &truth));
        orders.push((time, off, [(off[0] / off[1]).log2(), (off[1] / off[2]).log2()]));
    }
    assert!(orders.iter().all(|(_, _, found)| found.iter().all(|p| (3.7..4.3).contains(p))), "{orders:?}");
}
