//! A small scene, forces and plans.

use crate::common::{norm, pool, scene};
use metasense_kernels::dynamics::{
    Accuracy, EdgeContact, Forces, IntegrationPlan, Integrator, IntegratorSettings, Outcome, Panel, Scene,
    Tolerance, run, simulate,
};
use std::f64::consts::TAU;

/// A 3 × 3 lattice, 0.1 s with 20 instants.
pub fn small_scene() -> Scene {
    Scene {
        panels: vec![
            Panel::central(6, [0.0, -1.0]),
            Panel { node: Some(3), moment: -1.2, ..Panel::central(8, [0.6, -0.8]) },
        ],
        sensors: vec![4, 7],
        ..scene(3, 3, 20)
    }
}

/// Smooth forces of up to `amplitude` N, different for each sample and panel.
pub fn pushes(scene: &Scene, samples: usize, amplitude: f64) -> Forces {
    let (panels, instants) = (scene.panels.len(), scene.instants);
    let mut values = Vec::new();
    for i in 0..samples {
        for k in 0..panels {
            for n in 0..=instants {
                let phase = n as f64 / instants as f64 * (1.0 + 0.3 * i as f64 + 0.5 * k as f64);
                values.push(amplitude * (0.5 * TAU * phase).sin().powi(2));
            }
        }
    }
    Forces { samples, panels, instants, values, strikes: Vec::new() }
}

/// The same forces with deviating points and directions, different for each sample and panel.
pub fn struck(scene: &Scene, forces: Forces) -> Forces {
    let strike = |n: usize| {
        let (offset, angle) = (3.0 * (1.1 * n as f64).cos(), 0.4 * (2.3 * n as f64).sin());
        scene.panels[n % forces.panels].deviated_strike(offset, angle)
    };
    Forces { strikes: (0..forces.samples * forces.panels).map(strike).collect(), ..forces }
}

/// The initial design with a perturbation.
pub fn shaken(scene: &Scene) -> Vec<f64> {
    let mut design = scene.layout.initial_design(0.4363);
    design.iter_mut().enumerate().for_each(|(i, a)| *a += 0.3 * (1.7 * i as f64).sin());
    design
}

pub fn plan(method: Integrator, steps: usize) -> IntegrationPlan {
    match method {
        Integrator::Tsit5 => IntegrationPlan::tsit5(Tolerance::both(1e-10)),
        method => IntegrationPlan::equal(method, steps),
    }
}

pub const EQUAL_STEPS: [(Integrator, f64, usize); 3] =
    [(Integrator::Leapfrog, 2.0, 64), (Integrator::Nystrom4, 4.0, 36), (Integrator::Nystrom6, 6.0, 12)];

/// The scene without contact, with contact, and with linear strains.
pub fn of_every_law(base: Scene) -> [Scene; 3] {
    let contact = Some(EdgeContact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.9 });
    [base.clone(), Scene { contact, ..base.clone() }, Scene { linearised: true, ..base }]
}

/// Results of runs near and beyond the limit of stability.
pub struct UnstableRuns {
    /// Number of samples with the outcome `unstable`.
    pub unstable: usize,
    /// Number of repeated samples.
    pub refined: u64,
    /// Largest norm of the signals divided by that of the reference solution.
    pub worst: f64,
}

/// Runs three samples with every method of equal steps, with 1 to 21 steps per interval.
pub fn by_too_few_steps(scene: &Scene) -> UnstableRuns {
    let (design, forces) = (shaken(scene), pushes(scene, 3, 0.4));
    let tight = IntegratorSettings::new(Integrator::Nystrom6, Accuracy(1e-4));
    let truth = norm(&simulate(scene, &design, &forces, &tight, false, &pool(2)).signals);
    let mut found = UnstableRuns { unstable: 0, refined: 0, worst: 0.0 };
    for method in [Integrator::Leapfrog, Integrator::Nystrom4, Integrator::Nystrom6] {
        for steps in [1, 2, 3, 5, 8, 13, 21] {
            let run = run(scene, &design, &forces, &plan(method, steps), false, &pool(1));
            let size = norm(&run.signals) / truth;
            assert!(size.is_finite(), "{method:?} {steps}: {size}");
            found.worst = found.worst.max(size);
            found.unstable += run.outcomes.iter().filter(|o| **o == Outcome::Unstable).count();
            found.refined += run.counters.rejected;
        }
    }
    found
}
