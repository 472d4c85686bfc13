//! Checks without a reference: energy balance, Taylor tests of the gradient, agreement between settings.

use metasense_numerics::body::Layout;
use metasense_numerics::dynamics::{
    AccelerationFrame, Accuracy, AddedMass, EdgeContact, Forces, IntegrationPlan, Integrator,
    IntegratorSettings, Mount, Panel, Parameters, PartFactors, Scene, Simulation, Tangent, Tolerance, Wrt,
    choose, damping, energy, run, simulate,
};
use metasense_numerics::random::{Purpose, Stream};
use metasense_worker::reference::{bells, reference};

use super::super::{ComparedQuantity, dot, norm, relative};

/// A small scene on a fine clock, so that the error of integrals over instants is well below the tolerances.
fn fine() -> (Scene, Vec<f64>, Forces) {
    let mut scene = reference();
    scene.layout = Layout::planar(3, 2, 15.0, 2.25);
    scene.clamped = scene.layout.bottom();
    scene.panels = vec![Panel::central(3, [0.0, -1.0]), Panel::central(5, [0.6, -0.8])];
    scene.sensors = vec![4];
    let design = scene.layout.initial_design(25f64.to_radians());
    let forces = bells(&scene, 2);
    (scene, design, forces)
}

/// All checks for each solver.
pub fn rows(solvers: &[IntegratorSettings], pool: &metasense_numerics::Pool) -> Vec<ComparedQuantity> {
    let mut rows = orders(pool);
    rows.push(tape(IntegratorSettings::new(Integrator::Nystrom6, Accuracy(1e-3)), 1e-3, pool));
    rows.extend([1e-6, 1e-12].map(|t| tape(IntegratorSettings::tsit5(Tolerance::both(t)), t, pool)));
    for &solver in solvers {
        rows.push(balance(solver, pool));
        rows.push(taylor(solver, pool));
        rows.push(taylor_parameters(solver, pool));
        rows.extend(transpose(solver, pool));
        rows.push(threads(solver));
    }
    rows
}

/// As `fine`, for 0.1 s with one smooth blow on both panels.
fn short() -> (Scene, Vec<f64>, Forces) {
    let (mut scene, design, _) = fine();
    (scene.duration, scene.instants) = (0.1, 20);
    let push = |n: usize| 0.4 * (std::f64::consts::PI * n as f64 / 20.0).sin().powi(2);
    let values = (0..2).flat_map(|_| (0..=20).map(push)).collect();
    (scene, design, Forces { samples: 1, panels: 2, instants: 20, values, strikes: Vec::new() })
}

/// Order of convergence of each equal-step method, from n and 2n steps per interval against a far finer run, with light and heavy
/// damping (the drift integrates damping exactly); of Tsit5, from the steps at two tolerances.
fn orders(pool: &metasense_numerics::Pool) -> Vec<ComparedQuantity> {
    let (light, design, forces) = short();
    let solve = |scene: &Scene, plan| run(scene, &design, &forces, &plan, false, pool);
    let mut rows = Vec::new();
    for scene in [light.clone(), Scene { damping_ratio: 1.0, ..light.clone() }] {
        let truth = solve(&scene, IntegrationPlan::equal(Integrator::Nystrom6, 120)).signals;
        for (method, order, steps) in [
            (Integrator::Leapfrog, 2.0, 64),
            (Integrator::Nystrom4, 4.0, 36),
            (Integrator::Nystrom6, 6.0, 16),
        ] {
            let [coarse, fine] = [steps, 2 * steps]
                .map(|n| relative(&solve(&scene, IntegrationPlan::equal(method, n)).signals, &truth));
            rows.push(order_row(method, scene.damping_ratio, order, (coarse / fine).log2()));
        }
        if scene == light {
            let [coarse, fine] =
                [1e-8, 1e-11].map(|t| solve(&scene, IntegrationPlan::tsit5(Tolerance::both(t))));
            let ratio = |f: &dyn Fn(&Simulation) -> f64| (f(&coarse) / f(&fine)).ln();
            let steps = -ratio(&|s| s.counters.steps as f64);
            let seen = ratio(&|s| relative(&s.signals, &truth)) / steps;
            rows.push(order_row(Integrator::Tsit5, scene.damping_ratio, 5.0, seen));
        }
    }
    rows
}

fn order_row(method: Integrator, damping: f64, order: f64, seen: f64) -> ComparedQuantity {
    ComparedQuantity::new(
        format!("order {order} of {}, ζ = {damping}", method.name()),
        (seen - order).abs(),
        0.8,
    )
    .noted(format!("{seen:.2}"))
}

/// |Work − energy − dissipation|, relative to the greatest energy; integrals by Simpson's rule over the instants.
fn balance(solver: IntegratorSettings, pool: &metasense_numerics::Pool) -> ComparedQuantity {
    let (mut scene, design, _) = fine();
    (scene.duration, scene.instants) = (0.25, 20_000);
    // A smooth blow from 0 to 0.2 s on both panels; kinks between instants would lower the order of Simpson's rule.
    let blow = |n: usize| 0.4 * (std::f64::consts::PI * (n as f64 / 16_000.0).min(1.0)).sin().powi(4);
    let values = (0..2).flat_map(|_| (0..=20_000).map(blow)).collect();
    let forces = Forces { samples: 1, panels: 2, instants: 20_000, values, strikes: Vec::new() };
    let run = simulate(&scene, &design, &forces, &solver, true, pool);
    let name = format!("energy balance, {}", solver.method.name());
    let Some(tape) = run.tape else { return ComparedQuantity::failed(name) };
    let geometry = scene.geometry(&design);
    let c = damping(&scene);
    let dt = scene.duration / scene.instants as f64;
    let (mut powers, mut last) = (vec![0.0], 0.0);
    let mut greatest = 0.0f64;
    for n in 1..=scene.instants {
        let (x, v) = tape.state(0, n);
        let kinetic = |u: usize| {
            let m = [geometry.mass[u], geometry.mass[u], geometry.moment[u]];
            (0..3).map(|d| 0.5 * m[d] * v[u][d].powi(2)).sum::<f64>()
        };
        let lost: f64 = v.iter().flat_map(|v| (0..3).map(|d| c[d] * v[d] * v[d])).sum();
        let gained: f64 = (scene.panels.iter().enumerate())
            .map(|(k, p)| {
                forces.values[k * 20_001 + n]
                    * (p.direction[0] * v[p.unit][0] + p.direction[1] * v[p.unit][1])
            })
            .sum();
        powers.push(gained - lost);
        last = (0..scene.layout.units()).map(kinetic).sum::<f64>() + energy(&scene, &design, &x).elastic;
        greatest = greatest.max(last);
    }
    let simpson = |n: usize| match n {
        0 | 20_000 => 1.0,
        n if n % 2 == 1 => 4.0,
        _ => 2.0,
    };
    let work: f64 = powers.iter().enumerate().map(|(n, p)| simpson(n) * p).sum::<f64>() * dt / 3.0;
    ComparedQuantity::new(name, (work - last).abs() / greatest, 1e-6)
}

/// |J(α + εδ) − J(α) − ε g·δ| must decrease with slope 2; the row shows the deviation of the slope.
fn taylor(solver: IntegratorSettings, pool: &metasense_numerics::Pool) -> ComparedQuantity {
    let (scene, design, forces) = fine();
    let name = format!("Taylor test of dα, slope 2, {}", solver.method.name());
    let mut stream = Stream::new(Purpose::Design, 5, [0, 0]);
    let run = simulate(&scene, &design, &forces, &solver, true, pool);
    let scale = norm(&run.signals);
    let cotangent: Vec<f64> = run.signals.iter().map(|_| stream.normal() / scale).collect();
    let direction: Vec<f64> = design.iter().map(|_| 0.1 * stream.normal()).collect();
    let gradient = run.vjp(&cotangent, Wrt::Design, pool);
    let (value, slope) = (dot(&run.signals, &cotangent), dot(&gradient.design, &direction));
    let remainder = |epsilon: f64| {
        let moved: Vec<f64> = design.iter().zip(&direction).map(|(a, d)| a + epsilon * d).collect();
        let there = simulate(&scene, &moved, &forces, &solver, false, pool);
        (dot(&there.signals, &cotangent) - value - epsilon * slope).abs()
    };
    let r = [0.04, 0.02, 0.01].map(remainder);
    let slopes = [(r[0] / r[1]).log2(), (r[1] / r[2]).log2()];
    let off = (slopes[0] - 2.0).abs().max((slopes[1] - 2.0).abs());
    ComparedQuantity::new(name, if slope == 0.0 { f64::NAN } else { off }, 0.1)
        .noted(format!("slopes {:.3} {:.3}", slopes[0], slopes[1]))
}

/// As `taylor`, along each parameter relative to its value, with fixed steps; the row shows the slope farthest from 2.
fn taylor_parameters(solver: IntegratorSettings, pool: &metasense_numerics::Pool) -> ComparedQuantity {
    let (scene, design, forces) = short();
    let name = format!("Taylor tests of the parameters, slope 2, {}", solver.method.name());
    // Changes of adaptive steps between values would mask the remainder.
    let plan = match solver.method {
        Integrator::Tsit5 => IntegrationPlan::tsit5(Tolerance::both(1e-11)),
        _ => choose(&scene, &design, &solver),
    };
    let simulation = run(&scene, &design, &forces, &plan, true, pool);
    let mut stream = Stream::new(Purpose::Design, 7, [0, 0]);
    let scale = norm(&simulation.signals);
    let cotangent: Vec<f64> = simulation.signals.iter().map(|_| stream.normal() / scale).collect();
    let value = dot(&simulation.signals, &cotangent);
    let gradient = simulation.vjp(&cotangent, Wrt::Parameters, pool);
    let at = Parameters::of(&scene).array();
    let Some(gradient) = gradient.parameters.map(Parameters::array) else {
        return ComparedQuantity::failed(name);
    };
    let slopes: Vec<f64> = (0..5)
        .flat_map(|k| {
            let slope = gradient[k] * at[k];
            let r = [1e-3, 5e-4, 2.5e-4].map(|epsilon| {
                let mut moved = at;
                moved[k] *= 1.0 + epsilon;
                let moved = Parameters::from_array(moved).set(&scene);
                let there = run(&moved, &design, &forces, &plan, false, pool);
                (dot(&there.signals, &cotangent) - value - epsilon * slope).abs()
            });
            let found = [(r[0] / r[1]).log2(), (r[1] / r[2]).log2()];
            if slope == 0.0 { [f64::NAN; 2] } else { found }
        })
        .collect();
    let farthest = |far: f64, s: &f64| if (s - 2.0).abs() <= (far - 2.0).abs() { far } else { *s };
    let farthest = slopes.iter().fold(2.0, farthest);
    ComparedQuantity::new(name, (farthest - 2.0).abs(), 0.1)
        .noted(format!("{farthest:.3} of stretch … density"))
}

/// The scene without clamps, with given damping, the masses of one design, and units of another density.
fn loose(base: &Scene) -> Scene {
    let mut scene = Scene {
        clamped: Vec::new(),
        damping: Some([2e-4, 3e-4, 1e-3]),
        damping_ratio: 1.0,
        inertia: Some(base.layout.initial_design(0.3)),
        ..base.clone()
    };
    scene.layout.density.iter_mut().step_by(3).for_each(|density| *density = 2.0);
    scene
}

/// ⟨w, J v⟩ = ⟨Jᵀ w, v⟩ with J v from a simple program with dual numbers, and the signals of that program; the worst over scenes
/// of every kind.
fn transpose(solver: IntegratorSettings, pool: &metasense_numerics::Pool) -> Vec<ComparedQuantity> {
    let (base, design, blow) = short();
    let contact = Some(EdgeContact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.9 });
    let scenes = [
        ("plain", base.clone(), 1),
        ("forces twice as fine", base.clone(), 2),
        ("contact, body frame", Scene { frame: AccelerationFrame::Body, contact, ..base.clone() }, 1),
        (
            "linearised, body frame",
            Scene { linearised: true, frame: AccelerationFrame::Body, ..base.clone() },
            1,
        ),
        ("undamped", Scene { damping_ratio: 0.0, ..base.clone() }, 1),
        ("heavily damped", Scene { damping_ratio: 0.5, ..base.clone() }, 1),
        ("with a chip", Scene { chip: Some(AddedMass { mass: 3e-6, moment: 1e-4 }), ..base.clone() }, 1),
        (
            "chips off the centroid",
            Scene {
                mount: Some(Mount { offset: [1.5, -2.0], tilt: 0.4 }),
                frame: AccelerationFrame::Body,
                ..base.clone()
            },
            1,
        ),
        ("struck off the centroids", base.clone(), 1),
        ("nothing held, damping, masses and densities given", loose(&base), 1),
        ("each ligament and unit its own", Scene { parts: scattered(&base.layout), ..base.clone() }, 1),
    ];
    let count = scenes.len();
    let mut stream = Stream::new(Purpose::Design, 6, [0, 0]);
    let solver = match solver.method {
        Integrator::Tsit5 => IntegratorSettings::tsit5(Tolerance::both(1e-7)),
        method => IntegratorSettings::new(method, Accuracy(solver.accuracy.0.max(1e-7))),
    };
    let mut worst = [("", 0.0); 4];
    for (name, scene, kinks) in scenes {
        let instants = kinks * blow.instants;
        // Rapidly varying forces: accelerations of slow motion are small differences of large forces, dominated by rounding at
        // 1e-12.
        let values = (0..2 * (instants + 1)).map(|_| 0.4 * stream.normal()).collect();
        let strike = |panel: &Panel| panel.deviated_strike(-2.5, 0.3);
        let strikes = match name {
            "struck off the centroids" => scene.panels.iter().map(strike).collect(),
            _ => Vec::new(),
        };
        let forces = Forces { instants, values, strikes, ..blow };
        let simulation = simulate(&scene, &design, &forces, &solver, true, pool);
        let v: Vec<f64> = design.iter().map(|_| stream.normal()).collect();
        let turned = Parameters::of(&scene).array().map(|p| p * stream.normal());
        let pushed: Vec<f64> = forces.values.iter().map(|_| 0.1 * stream.normal()).collect();
        let mut apart = |v: Tangent<'_>| {
            let (signals, along) = simulation.jvp(0, v);
            // Same sign as J v, so that the sum does not cancel.
            let w: Vec<f64> = along.iter().map(|a| a * stream.normal().abs()).collect();
            let wrt = if v.forces.is_empty() { Wrt::Parameters } else { Wrt::Forces };
            let gradient = simulation.vjp(&w, wrt, pool);
            let slopes = gradient.parameters.unwrap_or_default().array();
            let ours = dot(&gradient.design, v.design)
                + dot(&slopes, &v.parameters.array())
                + dot(&gradient.forces.unwrap_or_default(), v.forces);
            let theirs = dot(&w, &along);
            ((ours - theirs).abs() / theirs.abs(), relative(&simulation.signals, &signals))
        };
        let held = Tangent::default();
        let (design_apart, signals_apart) = apart(Tangent { design: &v, ..held });
        let (parameters_apart, _) = apart(Tangent { parameters: Parameters::from_array(turned), ..held });
        let (forces_apart, _) = apart(Tangent { forces: &pushed, ..held });
        for (worst, apart) in
            worst.iter_mut().zip([design_apart, parameters_apart, forces_apart, signals_apart])
        {
            if apart > worst.1 || apart.is_nan() {
                *worst = (name, apart);
            }
        }
    }
    let whats = ["", " in the parameters", " in the forces"].map(|at| format!("⟨w, J v⟩ = ⟨Jᵀ w, v⟩{at}"));
    let whats = whats.into_iter().chain(["signals by a plain program".into()]);
    let row = |(what, (scene, apart))| {
        ComparedQuantity::new(format!("{what}, {}", solver.method.name()), apart, 1e-11)
            .noted(format!("at most, in {count} scenes: {scene}"))
    };
    whats.zip(worst).map(row).collect()
}

/// Random factors with σ = 5 % for each ligament's stiffnesses and each unit's density.
fn scattered(layout: &Layout) -> PartFactors {
    let mut stream = Stream::new(Purpose::Design, 7, [0, 0]);
    let mut factor = || (0.05 * stream.normal()).exp();
    PartFactors {
        ligaments: layout.ligaments.iter().map(|_| [(); 3].map(|()| factor())).collect(),
        units: (0..layout.units()).map(|_| factor()).collect(),
    }
}

/// Memory of the gradient of 300 samples of the reference scene (MB): states at the instants and, for adaptive steps, a count per
/// interval and one or two bytes per step.
fn tape(solver: IntegratorSettings, asked: f64, pool: &metasense_numerics::Pool) -> ComparedQuantity {
    let scene = reference();
    let design = scene.layout.initial_design(25f64.to_radians());
    let run = simulate(&scene, &design, &bells(&scene, 2), &solver, true, pool);
    let bytes = run.tape.map_or(0, |tape| tape.bytes());
    let (states, steps) = (scene.instants * 6 * 30 * 8 * 2, run.counters.steps as usize);
    let rest = bytes.wrapping_sub(states);
    let as_it_should = match solver.method {
        Integrator::Tsit5 => (steps..=2 * steps).contains(&rest.wrapping_sub(2 * 4 * scene.instants)),
        _ => rest == 0,
    };
    let name = format!("MB of tape for 300 samples, {} at {asked:.0e}", solver.method.name());
    let megabytes = if as_it_should { bytes as f64 * 150e-6 } else { f64::NAN };
    ComparedQuantity::new(name, megabytes, 200.0).noted(format!("{rest} of {bytes} bytes for {steps} steps"))
}

/// One and three threads give the same bits of signals and dα; a sample alone gives the same bits of its signals.
fn threads(solver: IntegratorSettings) -> ComparedQuantity {
    let mut scene = reference();
    let design = scene.layout.initial_design(25f64.to_radians());
    let forces = bells(&scene, 10);
    scene.duration = 0.25; // the same blows, four times as fast
    let run = |forces: &Forces, threads: usize| {
        let pool = metasense_numerics::Pool::new(threads).expect("threads");
        let run = simulate(&scene, &design, forces, &solver, true, &pool);
        let gradient = run.vjp(&run.signals, Wrt::Design, &pool).design;
        (run.signals, gradient)
    };
    let (one, three) = (run(&forces, 1), run(&forces, 3));
    let alone = run(&forces.select(&[7]), 1).0;
    let per_sample = one.0.len() / 10;
    let same = one == three && alone == one.0[7 * per_sample..8 * per_sample];
    let error = if same { 0.0 } else { relative(&three.0, &one.0).max(f64::MIN_POSITIVE) };
    ComparedQuantity::new(
        format!("bits on 1 and 3 threads and of a sample alone, {}", solver.method.name()),
        error,
        0.0,
    )
}
