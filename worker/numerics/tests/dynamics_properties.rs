//! Properties that the integrators, their adjoints and the body's layouts have by construction.

mod common;

use common::{dot, norm, pool, relative};
use metasense_numerics::body::{Geometry, Layout};
use metasense_numerics::dynamics::{
    Contact, Forces, Frame, Method, Outcome, Panel, Parameters, Plan, Scene, Solver, Stiffness, choose,
    energy, highest_frequency, pull_back, pull_back_parameters, push_forward, run, run_at, simulate, tune,
};
use metasense_numerics::simd::Width;
use std::f64::consts::TAU;

/// A 3 × 3 lattice read for 0.1 s at 20 instants.
fn small_scene() -> Scene {
    Scene {
        layout: Layout::planar(3, 3, 15.0, 2.25),
        density: 1e-8,
        stiffness: Stiffness { stretch: 3.0, shear: 0.5, bend: 1.0 },
        damping_ratio: 0.02,
        contact: None,
        linearised: false,
        clamped: vec![0, 1, 2],
        panels: vec![Panel { unit: 6, direction: [0.0, -1.0] }, Panel { unit: 8, direction: [0.6, -0.8] }],
        sensors: vec![4, 7],
        frame: Frame::World,
        duration: 0.1,
        instants: 20,
    }
}

/// Smooth pushes of up to `amplitude` N, another for each sample and panel.
fn pushes(scene: &Scene, samples: usize, amplitude: f64) -> Forces {
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
    Forces { samples, panels, instants, values }
}

/// The initial design, shaken.
fn shaken(scene: &Scene) -> Vec<f64> {
    let mut design = scene.layout.initial_design(0.4363);
    design.iter_mut().enumerate().for_each(|(i, a)| *a += 0.3 * (1.7 * i as f64).sin());
    design
}

fn plan(method: Method, steps: usize) -> Plan {
    Plan { method, tolerance: 1e-10, steps, reason: String::new() }
}

const EQUAL_STEPS: [(Method, f64, usize); 3] =
    [(Method::Leapfrog, 2.0, 64), (Method::Nystrom4, 4.0, 36), (Method::Nystrom6, 6.0, 12)];

/// Errors at n and 2n steps against a run far finer, with damping light and heavy: the drift carries it exactly.
#[test]
fn schemes_of_equal_steps_converge_with_their_order() {
    let pool = pool(1);
    for damping_ratio in [0.02, 1.0] {
        let scene = Scene { damping_ratio, ..small_scene() };
        let (design, forces) = (shaken(&scene), pushes(&scene, 2, 0.4));
        let truth = run(&scene, &design, &forces, &plan(Method::Nystrom6, 60), false, &pool).signals;
        for (method, order, steps) in EQUAL_STEPS {
            let error = |steps| {
                relative(&run(&scene, &design, &forces, &plan(method, steps), false, &pool).signals, &truth)
            };
            let (coarse, fine) = (error(steps), error(2 * steps));
            let seen = (coarse / fine).log2();
            assert!(
                (order - 0.4..order + 0.8).contains(&seen),
                "{method:?} at ζ = {damping_ratio}: order {seen:.2} from {coarse:e}, {fine:e}"
            );
        }
    }
}

/// What the kernels of one instruction set compute, those of another do, to rounding; their tapes are swept back by their own.
#[test]
fn every_width_computes_the_same() {
    let pool = pool(1);
    let contact = Contact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.6 };
    let base = small_scene();
    let mut apart = Vec::new();
    for scene in [
        base.clone(),
        Scene { linearised: true, ..base.clone() },
        Scene { frame: Frame::Body, contact: Some(contact), ..base },
    ] {
        let (design, forces) = (shaken(&scene), pushes(&scene, 11, 0.4));
        let samples: Vec<usize> = (0..forces.samples).collect();
        for (method, steps) in [(Method::Tsit5, 0), (Method::Nystrom4, 24)] {
            let plan = Plan { tolerance: 1e-6, ..plan(method, steps) };
            let at = |width| {
                let run = run_at(width, &scene, &design, &forces, &plan, true, &pool);
                assert_eq!(run.width, width);
                let gradient =
                    pull_back_parameters(&scene, &design, &forces, &run, &samples, &run.signals, &pool);
                (run.signals, gradient.design, gradient.parameters.expect("asked for").array())
            };
            let truth = at(Width::Baseline);
            for width in Width::ALL.into_iter().filter(|w| *w <= Width::detect()).skip(1) {
                let of = at(width);
                let off =
                    relative(&of.0, &truth.0).max(relative(&of.1, &truth.1)).max(relative(&of.2, &truth.2));
                apart.push((width, method, off));
            }
        }
    }
    assert!(apart.iter().all(|(_, _, off)| *off < 1e-9), "{apart:?}");
}

/// ⟨c, signals(α + εδ)⟩ = … + ε ⟨gradient, δ⟩ + O(ε²) with the same steps: a central difference, extrapolated.
#[test]
fn gradients_are_those_of_the_discrete_scheme() {
    let pool = pool(1);
    let contact = Contact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.6 };
    let base = small_scene();
    for (what, scene) in [
        ("plain", base.clone()),
        ("linearised, body frame", Scene { linearised: true, frame: Frame::Body, ..base.clone() }),
        ("body frame, contact", Scene { frame: Frame::Body, contact: Some(contact), ..base.clone() }),
        ("undamped", Scene { damping_ratio: 0.0, ..base.clone() }),
        ("heavily damped", Scene { damping_ratio: 2.0, ..base }),
    ] {
        let (design, forces) = (shaken(&scene), pushes(&scene, 3, 0.4));
        let len = 3 * scene.instants * 3 * scene.sensors.len();
        let cotangent: Vec<f64> = (0..len).map(|i| (0.7 * i as f64).sin()).collect();
        let delta: Vec<f64> = (0..design.len()).map(|i| (2.3 * i as f64).cos()).collect();
        for (method, _, steps) in EQUAL_STEPS {
            let plan = plan(method, steps);
            let value = |eps: f64| {
                let moved: Vec<f64> = design.iter().zip(&delta).map(|(a, d)| a + eps * d).collect();
                dot(&run(&scene, &moved, &forces, &plan, false, &pool).signals, &cotangent)
            };
            let central = |eps: f64| (value(eps) - value(-eps)) / (2.0 * eps);
            // Where contact sets in, the second derivative jumps.
            let (eps, least) = if scene.contact.is_some() { (1.5e-7, 2e-5) } else { (1e-4, 2e-7) };
            let differences = (4.0 * central(eps) - central(2.0 * eps)) / 3.0;
            let simulation = run(&scene, &design, &forces, &plan, true, &pool);
            assert_eq!(simulation.outcomes, [Outcome::Ok; 3], "{what}");
            let gradient =
                pull_back(&scene, &design, &forces, &simulation, &[0, 1, 2], &cotangent, &pool).design;
            let ours = dot(&gradient, &delta);
            let scale = norm(&gradient) * norm(&delta);
            assert!(norm(&gradient) > 0.0, "{what}");
            let error = (ours - differences).abs() / scale;
            assert!(error < least, "{what}, {method:?}: {ours} against {differences}: {error:e}");
        }
    }
}

/// The same bits alone, among others, in any order and with any number of threads.
#[test]
fn a_sample_does_not_depend_on_its_lane_mates() {
    let scene = small_scene();
    let (design, forces) = (shaken(&scene), pushes(&scene, 11, 0.4));
    let len = scene.instants * 3 * scene.sensors.len();
    for method in [Method::Tsit5, Method::Nystrom6] {
        let solver = Solver { method, tolerance: 1e-5 };
        let together = simulate(&scene, &design, &forces, &solver, true, &pool(2));
        for i in [0, 4, 10] {
            let alone = Forces { samples: 1, values: forces.sample(i).to_vec(), ..forces.clone() };
            let alone = simulate(&scene, &design, &alone, &solver, false, &pool(1));
            assert!(alone.signals == together.signals[i * len..][..len], "{method:?}, sample {i}");
        }
        let cotangent = vec![1.0; 11 * len];
        let all: Vec<usize> = (0..11).collect();
        let gradient = |threads| {
            let pool = pool(threads);
            pull_back(&scene, &design, &forces, &together, &all, &cotangent, &pool).design
        };
        assert!(gradient(1) == gradient(3), "{method:?}");
    }
}

/// Kinetic and elastic energy at the end equal the work done, without damping, once the force is over.
#[test]
fn energy_is_conserved_without_damping() {
    let scene = Scene { damping_ratio: 0.0, ..small_scene() };
    let design = shaken(&scene);
    let mut forces = pushes(&scene, 1, 0.4);
    forces.values.chunks_mut(scene.instants + 1).for_each(|f| f[8..].fill(0.0));
    let geometry = Geometry::new(&scene.layout, &design, scene.density);
    for (method, steps) in [(Method::Tsit5, 0), (Method::Nystrom4, 30), (Method::Nystrom6, 15)] {
        let run = run(&scene, &design, &forces, &plan(method, steps), true, &pool(1));
        let total = |n: usize| {
            let (x, v) = run.tape.as_ref().expect("kept").state(&scene, 0, n);
            let kinetic = |u: usize| {
                let (m, j) = (geometry.mass[u], geometry.moment[u]);
                0.5 * (m * (v[u][0].powi(2) + v[u][1].powi(2)) + j * v[u][2].powi(2))
            };
            (0..x.len()).map(kinetic).sum::<f64>() + energy(&scene, &design, &x).elastic
        };
        let (after, end) = (total(9), total(20));
        assert!(after > 1e-3, "{method:?}: something moves: {after}");
        assert!((end / after - 1.0).abs() < 1e-6, "{method:?}: {after} became {end}");
    }
}

/// Lanczos' estimate against the reference scene's highest mode, 664 Hz.
#[test]
fn the_highest_frequency_is_that_of_the_model() {
    let scene =
        Scene { layout: Layout::planar(6, 6, 15.0, 2.25), clamped: (0..6).collect(), ..small_scene() };
    let design = scene.layout.initial_design(25f64.to_radians());
    let hertz = highest_frequency(&scene, &design) / TAU;
    assert!((hertz - 664.0).abs() < 1.0, "{hertz}");
}

/// Signals at the tuned steps are as good as asked, for one scene of each kind, and the tuned tolerance
/// makes the law give these steps.
#[test]
fn a_pilot_keeps_the_accuracy_asked() {
    let base = small_scene();
    let contact = Some(Contact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.3 });
    for (what, scene) in [
        ("plain", base.clone()),
        ("stiff", Scene { stiffness: Stiffness { stretch: 300.0, ..base.stiffness }, ..base.clone() }),
        ("damped", Scene { damping_ratio: 0.5, ..base.clone() }),
        ("contact", Scene { contact, ..base.clone() }),
        ("body frame", Scene { frame: Frame::Body, ..base.clone() }),
        ("linearised", Scene { linearised: true, ..base }),
    ] {
        let (design, forces) = (shaken(&scene), pushes(&scene, 3, 0.4));
        let tight = Solver { method: Method::Nystrom6, tolerance: 1e-8 };
        let truth = simulate(&scene, &design, &forces, &tight, false, &pool(1));
        for tolerance in [3e-2, 1e-3, 1e-4] {
            let solver = Solver { method: Method::Auto, tolerance };
            let tuned = tune(&scene, &design, &forces, &solver, &pool(1));
            assert_eq!(tuned, tune(&scene, &design, &forces, &solver, &pool(2)), "{what}: threads");
            let reason = &tuned.plan.reason;
            let run = simulate(&scene, &design, &forces, &tuned.solver, false, &pool(1));
            assert_eq!(
                run.plan.steps, tuned.plan.steps,
                "{what}: the law with the tuned tolerance; {reason}"
            );
            let error = relative(&run.signals, &truth.signals);
            assert!(error <= tolerance, "{what}: {error:e} where {tolerance:e} was asked; {reason}");
            assert!(tuned.error.is_some_and(|e| e <= tolerance), "{what}: {:?}; {reason}", tuned.error);
        }
    }
}

/// Samples whose steps contact halves have the same bits in two runs of the pilot: no measure of their error.
#[test]
fn a_pilot_is_not_blind_to_steps_that_contact_halves() {
    let contact = Some(Contact { stiffness: 0.02, min_angle: 0.3, cutoff_angle: 0.62 });
    let scene = Scene { contact, ..small_scene() };
    let design = scene.layout.initial_design(25f64.to_radians());
    let solver = Solver { method: Method::Auto, tolerance: 1e-3 };
    let mut halved = 0;
    for amplitude in [0.2, 0.4, 0.6, 0.8, 1.0, 1.2] {
        let forces = pushes(&scene, 2, amplitude);
        let law = simulate(&scene, &design, &forces, &solver, false, &pool(1));
        if law.counters.rejected == 0 || law.outcomes.iter().any(|o| *o != Outcome::Ok) {
            continue;
        }
        halved += 1;
        let tight = Solver { method: Method::Tsit5, tolerance: 1e-10 };
        let truth = simulate(&scene, &design, &forces, &tight, false, &pool(1));
        let tuned = tune(&scene, &design, &forces, &solver, &pool(1));
        let run = run(&scene, &design, &forces, &tuned.plan, false, &pool(1));
        let error = relative(&run.signals, &truth.signals);
        let asked = if tuned.error.is_some() { 1.2e-3 } else { 5e-3 };
        assert!(error <= asked, "{amplitude}: {error:e}; {}", tuned.plan.reason);
    }
    assert!(halved > 0, "no steps were halved");
}

/// Tsit5 stays as it is; without forces there is nothing to measure; what is out of reach is said to be, at the steps of
/// least error, or at the law's where none is better.
#[test]
fn a_pilot_says_what_it_cannot_measure() {
    let scene = small_scene();
    let (design, mut forces) = (shaken(&scene), pushes(&scene, 1, 0.4));
    let tsit5 = Solver { method: Method::Tsit5, tolerance: 1e-5 };
    assert_eq!(tune(&scene, &design, &forces, &tsit5, &pool(1)).solver, tsit5);
    let auto = Solver { method: Method::Auto, tolerance: 1e-3 };
    let law = choose(&scene, &design, &auto).steps;
    // So hard that errors fall but not to 1e-3, and so hard that motion is chaotic
    for (factor, refined) in [(300.0, 8), (10_000.0, 1)] {
        let forces = Forces { values: forces.values.iter().map(|f| factor * f).collect(), ..forces };
        let wild = tune(&scene, &design, &forces, &auto, &pool(1));
        assert!(wild.error.is_none() && wild.plan.reason.contains("no steps of the pilot"), "{wild:?}");
        assert_eq!(wild.plan.steps, refined * law, "{factor}: {}", wild.plan.reason);
    }
    forces.values.fill(0.0);
    let still = tune(&scene, &design, &forces, &auto, &pool(1));
    assert!(still.error.is_none() && still.counters.steps == 0, "{still:?}");
}

/// ⟨w, J v⟩ = ⟨Jᵀ w, v⟩ to rounding for every method on scenes of every kind, J v by dual numbers in a plain
/// program of its own, whose signals are those of the lanes.
#[test]
fn pull_back_is_the_transpose_of_push_forward() {
    let contact = Some(Contact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.6 });
    let base = small_scene();
    for (what, scene, kinks) in [
        ("plain", base.clone(), 1),
        ("finer forces", base.clone(), 2),
        ("body frame, contact", Scene { frame: Frame::Body, contact, ..base.clone() }, 1),
        ("linearised, body frame", Scene { linearised: true, frame: Frame::Body, ..base.clone() }, 1),
        ("undamped", Scene { damping_ratio: 0.0, ..base.clone() }, 1),
        ("damped", Scene { damping_ratio: 0.5, ..base }, 1),
    ] {
        let design = shaken(&scene);
        let forces = pushes(&Scene { instants: kinks * scene.instants, ..scene.clone() }, 2, 0.4);
        let v: Vec<f64> = (0..design.len()).map(|i| (2.3 * i as f64).cos()).collect();
        let still = vec![0.0; design.len()];
        let equal = EQUAL_STEPS.map(|(method, _, n)| (method, 2 * n));
        for (method, steps) in equal.into_iter().chain([(Method::Tsit5, 0)]) {
            let plan = Plan { tolerance: 1e-7, ..plan(method, steps) };
            let simulation = run(&scene, &design, &forces, &plan, true, &pool(1));
            // The design, then each parameter alone, relative to its value
            let at = Parameters::of(&scene).array();
            for k in 0..=at.len() {
                let of = |i: usize| if i + 1 == k { at[i] } else { 0.0 };
                let parameters = Parameters::from_array(std::array::from_fn(of));
                let v = if k == 0 { &v } else { &still };
                let (signals, along) = push_forward(&scene, &design, v, parameters, &forces, &simulation, 1);
                // Of one sign with J v, lest the sum cancel
                let w: Vec<f64> =
                    along.iter().enumerate().map(|(i, a)| a * (1.2 + (0.7 * i as f64).sin())).collect();
                let gradient =
                    pull_back_parameters(&scene, &design, &forces, &simulation, &[1], &w, &pool(1));
                let slopes = gradient.parameters.expect("asked for").array();
                let ours = dot(&gradient.design, v) + dot(&slopes, &parameters.array());
                let theirs = dot(&w, &along);
                let same = relative(&simulation.signals[along.len()..], &signals);
                let absent = k > 0 && at[k - 1] == 0.0;
                let error = (ours - theirs).abs() / if absent { 1.0 } else { theirs.abs() };
                let what = format!("{what}, {method:?}, direction {k}");
                // No closer than the two programs' signals are
                let what = format!("{what}: {error:e}, signals {same:e}");
                assert!(error < 1e-12 + 4.0 * same.min(1e-11) && same < 1e-11, "{what}");
            }
        }
    }
}

/// A sensor on a held unit reads zeros whatever the design: its cotangent changes no gradient.
#[test]
fn a_sensor_on_a_held_unit_asks_for_no_gradient() {
    let base = small_scene();
    let scene = Scene { sensors: vec![base.sensors[0], base.clamped[0]], ..base };
    let (design, forces) = (shaken(&scene), pushes(&scene, 2, 0.4));
    for (method, steps) in
        [(Method::Tsit5, 0), (Method::Leapfrog, 60), (Method::Nystrom4, 30), (Method::Nystrom6, 15)]
    {
        let run = run(&scene, &design, &forces, &plan(method, steps), true, &pool(1));
        let gradient = |held: f64| {
            let of = |i: usize| if i % 6 < 3 { (0.7 * i as f64).sin() } else { held };
            let cotangent: Vec<f64> = (0..run.signals.len()).map(of).collect();
            pull_back(&scene, &design, &forces, &run, &[0, 1], &cotangent, &pool(1)).design
        };
        assert!(run.signals.chunks_exact(6).all(|s| s[3..] == [0.0; 3]), "{method:?}");
        assert_eq!(gradient(0.0), gradient(1e3), "{method:?}");
    }
}

/// The gradient in every parameter against central differences with the same steps, for every method; asking for it changes
/// nothing in that of the design.
#[test]
fn gradients_in_the_parameters_are_those_of_the_signals() {
    let base = small_scene();
    let contact = Some(Contact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.6 });
    for scene in [
        base.clone(),
        Scene { contact, frame: Frame::Body, ..base.clone() },
        Scene { linearised: true, ..base },
    ] {
        let (design, forces) = (shaken(&scene), pushes(&scene, 3, 0.4));
        for (method, steps) in EQUAL_STEPS.map(|(method, _, steps)| (method, steps)) {
            let solve = |scene: &Scene| run(scene, &design, &forces, &plan(method, steps), true, &pool(1));
            let simulation = solve(&scene);
            let w: Vec<f64> = (0..simulation.signals.len()).map(|i| (0.7 * i as f64).sin()).collect();
            let all = [0, 1, 2];
            let gradient = pull_back_parameters(&scene, &design, &forces, &simulation, &all, &w, &pool(1));
            let plain = pull_back(&scene, &design, &forces, &simulation, &all, &w, &pool(1));
            assert_eq!((plain.design, plain.parameters), (gradient.design.clone(), None), "{method:?}");
            let at = Parameters::of(&scene).array();
            let ours = gradient.parameters.expect("asked for").array();
            for k in (0..at.len()).filter(|&k| at[k] != 0.0) {
                let value = |step: f64| {
                    let mut moved = at;
                    moved[k] *= 1.0 + step;
                    dot(&solve(&Parameters::from_array(moved).set(&scene)).signals, &w)
                };
                let central = |step: f64| (value(step) - value(-step)) / (2.0 * step);
                // Where contact sets in, the second derivative jumps.
                let touches = scene.contact.is_some();
                let step = if touches { 1e-7 } else { 1e-5 };
                let (ours, theirs) = (ours[k] * at[k], (4.0 * central(step) - central(2.0 * step)) / 3.0);
                let error = (ours - theirs).abs() / theirs.abs();
                let least = if touches { 1e-3 } else { 1e-5 };
                assert!(error < least, "{method:?}, parameter {k}: {ours} against {theirs}: {error:e}");
            }
        }
    }
}

/// A tape holds the states of the free units at the instants: not the steps in between, but for a byte or two of adaptive ones.
#[test]
fn a_tape_grows_with_units_and_instants_not_with_steps() {
    let kept = |columns, instants, method, steps, tolerance| {
        let layout = Layout::planar(columns, 3, 15.0, 2.25);
        let clamped = layout.bottom();
        let scene = Scene { layout, clamped, instants, ..small_scene() };
        let plan = Plan { tolerance, ..plan(method, steps) };
        let run = run(&scene, &shaken(&scene), &pushes(&scene, 3, 0.4), &plan, true, &pool(1));
        (run.tape.expect("asked for").bytes(), run.counters.steps as usize)
    };
    let states = |columns, instants| 3 * instants * 2 * columns * 6 * 8;
    for method in EQUAL_STEPS.map(|m| m.0) {
        for (columns, instants, steps) in [(3, 20, 8), (3, 20, 32), (6, 20, 8), (3, 40, 8)] {
            let found = kept(columns, instants, method, steps, 0.0).0;
            assert_eq!(found, states(columns, instants), "{method:?} {columns} {instants} {steps}");
        }
    }
    for tolerance in [1e-6, 1e-9, 1e-12] {
        let (bytes, steps) = kept(6, 20, Method::Tsit5, 0, tolerance);
        let rest = bytes - states(6, 20) - 3 * 20 * 4;
        assert!(steps <= rest && rest <= 2 * steps, "{tolerance:.0e}: {rest} bytes for {steps} steps");
    }
}

/// Histories with four kinks an interval: signals and gradients are those of a clock four times as fine, read at every
/// fourth instant; steps that do not hit the kinks are rounded up; a pilot takes them into account.
#[test]
fn forces_may_have_a_finer_clock_than_the_signals() {
    let coarse = Scene { frame: Frame::Body, ..small_scene() };
    let fine = Scene { instants: 4 * coarse.instants, ..coarse.clone() };
    let (design, mut forces) = (shaken(&coarse), pushes(&fine, 2, 0.4));
    forces.values.iter_mut().enumerate().for_each(|(i, f)| *f += 0.1 * (1.9 * i as f64).sin());
    let width = 3 * coarse.sensors.len();
    let methods = EQUAL_STEPS.map(|(method, _, steps)| (method, steps)).into_iter();
    for (method, steps) in methods.chain([(Method::Tsit5, 0)]) {
        let solve = |scene: &Scene, steps| run(scene, &design, &forces, &plan(method, steps), true, &pool(1));
        let (ours, theirs) = (solve(&coarse, 4 * steps), solve(&fine, steps));
        let every_fourth: Vec<f64> =
            theirs.signals.chunks(4 * width).flat_map(|c| &c[3 * width..]).copied().collect();
        let cotangent: Vec<f64> = (0..ours.signals.len()).map(|i| (0.7 * i as f64).sin()).collect();
        let mut spread = vec![0.0; theirs.signals.len()];
        for (to, from) in spread.chunks_mut(4 * width).zip(cotangent.chunks(width)) {
            to[3 * width..].copy_from_slice(from);
        }
        let gradient = |scene: &Scene, simulation: &_, cotangent: &[f64]| {
            pull_back(scene, &design, &forces, simulation, &[0, 1], cotangent, &pool(1)).design
        };
        let (g, h) = (gradient(&coarse, &ours, &cotangent), gradient(&fine, &theirs, &spread));
        let errors = [relative(&ours.signals, &every_fourth), relative(&g, &h)];
        assert!(errors.iter().all(|e| *e < 1e-11) && norm(&g) > 0.0, "{method:?}: {errors:?}");
        if steps > 0 {
            assert_eq!(solve(&coarse, 4 * steps - 1).signals, ours.signals, "{method:?}");
        }
    }
    let solver = Solver { method: Method::Auto, tolerance: 1e-3 };
    let tuned = tune(&coarse, &design, &forces, &solver, &pool(1));
    assert!(tuned.plan.steps.is_multiple_of(4) && tuned.error.is_some_and(|e| e < 1e-3), "{tuned:?}");
}

/// Steps that a blow a hundred times as hard makes unstable are refined for that sample alone.
#[test]
fn a_sample_that_fails_is_tried_again_with_smaller_steps() {
    let scene = Scene {
        contact: Some(Contact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.3 }),
        ..small_scene()
    };
    let design = scene.layout.initial_design(0.4363);
    let mut forces = pushes(&scene, 2, 0.3);
    let half = forces.values.len() / 2;
    forces.values[half..].iter_mut().for_each(|f| *f *= 40.0);
    let run = run(&scene, &design, &forces, &plan(Method::Nystrom6, 6), true, &pool(1));
    assert_eq!(run.outcomes[0], Outcome::Ok);
    assert!(run.counters.rejected > 0 || run.outcomes[1] == Outcome::Ok, "{:?}", run.counters);
    assert!(run.signals.iter().all(|s| s.is_finite()));
}

/// Equal steps at and beyond the limit of stability: what ends well has signals as large as the truth's, the rest is
/// refined or named, some of it as unstable. Wild motion with steps that follow it is not taken for it.
#[test]
fn steps_that_make_energy_of_nothing_are_unstable() {
    let (mut named, mut refined) = (0, 0);
    for stretch in [3.0, 300.0, 3e5] {
        let base = small_scene();
        let scene = Scene { stiffness: Stiffness { stretch, ..base.stiffness }, ..base };
        let (design, forces) = (shaken(&scene), pushes(&scene, 3, 0.4));
        let tight = Solver { method: Method::Nystrom6, tolerance: 1e-4 };
        let truth = norm(&simulate(&scene, &design, &forces, &tight, false, &pool(2)).signals);
        for method in [Method::Leapfrog, Method::Nystrom4, Method::Nystrom6] {
            for steps in [1, 2, 3, 5, 8, 13, 21] {
                let run = run(&scene, &design, &forces, &plan(method, steps), false, &pool(1));
                let size = norm(&run.signals);
                assert!(size < 3.0 * truth, "{method:?} {steps} {stretch}: {size:.1e} for {truth:.1e}");
                named += run.outcomes.iter().filter(|o| **o == Outcome::Unstable).count();
                refined += run.counters.rejected;
            }
        }
    }
    assert!(named > 0 && refined > 0, "{named} unstable, {refined} refined");

    let contact = Some(Contact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.9 });
    for (scene, amplitude) in
        [(small_scene(), 400.0), (Scene { contact, ..small_scene() }, 0.4), (small_scene(), 0.0)]
    {
        let (design, forces) = (shaken(&scene), pushes(&scene, 3, amplitude));
        let run = run(&scene, &design, &forces, &plan(Method::Nystrom4, 400), false, &pool(2));
        assert_eq!((&run.outcomes[..], run.counters.rejected), (&[Outcome::Ok; 3][..], 0), "{amplitude} N");
    }
}

/// A cutoff above the voids of the body at rest: it is pushed apart from the first instant on, also where no force acts.
#[test]
fn contact_that_acts_at_rest_moves_the_body_from_the_start() {
    let scene = Scene {
        contact: Some(Contact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.9 }),
        ..small_scene()
    };
    let design = shaken(&scene);
    let mut forces = pushes(&scene, 3, 0.3);
    let per_sample = forces.values.len() / 3;
    forces.values[2 * per_sample..].fill(0.0);
    let tight = Solver { method: Method::Tsit5, tolerance: 1e-12 };
    let adaptive = simulate(&scene, &design, &forces, &tight, false, &pool(1));
    assert_eq!(adaptive.outcomes, [Outcome::Ok; 3]);
    let equal = run(&scene, &design, &forces, &plan(Method::Nystrom6, 96), false, &pool(1));
    let (still, off) = (
        norm(&adaptive.signals[2 * adaptive.signals.len() / 3..]),
        relative(&adaptive.signals, &equal.signals),
    );
    assert!(still > 1.0 && off < 1e-8, "norm {still:.1e} without force, {off:.1e} apart");
}

/// Units in the disc, four neighbours inside, and the group order of a planar body with absent groups left out.
#[test]
fn circular_bodies_are_bodies() {
    for across in 3..12 {
        let layout = Layout::circular(across, 15.0, 2.25);
        let radius = 0.5 * across as f64 * 15.0;
        assert!(layout.centres.iter().all(|c| c[0].hypot(c[1]) <= radius));
        let ends: usize =
            layout.groups.iter().map(|g| g.iter().filter(|g| **g < layout.group_count).count()).sum();
        assert_eq!(ends, 4 * layout.units());
        assert_eq!(layout.group_count, 4 * layout.units() - layout.ligaments.len(), "{across}");
        assert_eq!(layout.hub().len(), if across % 2 == 0 { 4 } else { 1 });
        let design = layout.initial_design(0.4);
        let geometry = Geometry::new(&layout, &design, 1.0);
        let area = 2.0 * (layout.half / 0.4f64.cos()).powi(2);
        assert!(geometry.area.iter().all(|a| (a - area).abs() < 1e-9 * area), "{across}");
        if across >= 5 {
            let panels = layout.circular_panels(8).expect("eight panels");
            assert!(panels.iter().all(|(u, d)| {
                let c = layout.centres[*u];
                layout.boundary[*u] && c[0] * d[0] + c[1] * d[1] < 0.0
            }));
        }
    }
}

/// The rule of MODEL.md and the examples it names.
#[test]
fn planar_panels_follow_the_rule() {
    let panels = |columns, rows, k| Layout::planar_panels(columns, rows, k);
    assert_eq!(panels(6, 6, 2), Some(vec![31, 34]));
    assert_eq!(panels(8, 1, 4), Some(vec![1, 3, 4, 6]));
    assert_eq!(panels(8, 4, 3), Some(vec![25, 28, 30]));
    assert_eq!(panels(4, 4, 5), None);
    assert_eq!(panels(5, 3, 1), Some(vec![12]));
    assert_eq!(panels(6, 6, 6), Some(vec![30, 31, 32, 33, 34, 35]));
}
