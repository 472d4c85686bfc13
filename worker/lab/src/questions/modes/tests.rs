use super::*;
use crate::small::{GOING, on_lattices};
use metasense_numerics::body::Layout;
use metasense_numerics::dynamics::{
    AccelerationFrame, Forces, IntegrationPlan, Integrator, LigamentStiffness, Panel, PrescribedMotion,
    highest_frequency, run,
};
use metasense_numerics::trial::TrainingProtocol;
use nalgebra::DMatrix;
use std::f64::consts::PI;

fn scene(layout: Layout, clamped: Vec<usize>) -> Scene {
    let top = layout.units() - 1;
    Scene {
        layout,
        density: 1e-8,
        stiffness: LigamentStiffness { stretch: 3.0, shear: 0.5, bend: 1.0 },
        damping_ratio: 0.02,
        clamped,
        panels: vec![Panel::central(top, [0.6, -0.8]), Panel::central(top - 2, [0.0, -1.0])],
        sensors: vec![4, top],
        duration: 0.1,
        instants: 20,
        ..Scene::default()
    }
}

/// A 3 × 3 lattice with a perturbed initial design, its middle unit guided, struck on a centroid, a node and its base.
fn small() -> (Scene, Vec<f64>) {
    let layout = Layout::planar(3, 3, 15.0, 2.25);
    let mut scene = scene(layout, vec![0, 1, 2]);
    scene.panels[1].node = Some(3);
    scene.guided = vec![(4, [true, false, false])];
    scene.panels.push(Panel { moves: Some(PrescribedMotion::Base(1e-4)), ..Panel::central(0, [0.8, 0.6]) });
    let mut design = scene.layout.initial_design(0.4363);
    design.iter_mut().enumerate().for_each(|(i, a)| *a += 0.3 * (1.7 * i as f64).sin());
    (scene, design)
}

/// The small body and one of every other lattice, with perturbed designs.
fn bodies() -> Vec<(String, Scene, Vec<f64>)> {
    let (scene, design) = small();
    let mut bodies = vec![("squares".into(), scene, design)];
    for (what, problem) in on_lattices(&crate::small::small(TrainingProtocol::Joint(GOING))) {
        let (mut scene, mut design) = (problem.scene, problem.initial);
        (scene.duration, scene.instants) = (0.1, 20);
        scene.sensors.push(scene.panels[0].unit);
        design.iter_mut().enumerate().for_each(|(i, a)| *a += 0.3 * (1.7 * i as f64).sin());
        bodies.push((what, scene, design));
    }
    bodies
}

fn found(scene: &Scene, design: &[f64], count: usize) -> (Rest, Vec<Mode>) {
    let rest = Rest::new(scene, design);
    let modes = modes(&rest, scene.layout.units(), count).unwrap();
    (rest, modes)
}

/// Residual force of a mode relative to its inertia: max |(s² M + s C + K) x| over max |(s² M + s C) x|.
fn off(rest: &Rest, Mode { s, shape }: &Mode) -> f64 {
    let x: Vec<c64> = rest.unknowns.iter().map(|i| shape[i / 3][i % 3]).collect();
    let most = |force: &[c64]| force.iter().map(|f| f.norm()).fold(0.0, f64::max);
    let own = |i: usize| (s * s * rest.mass[i] + s * rest.damping[i]) * x[i];
    let mut force: Vec<c64> = (0..x.len()).map(own).collect();
    let inertia = most(&force);
    rest.stiffness.iter().for_each(|&(i, j, k)| force[i] += k * x[j]);
    most(&force) / inertia
}

/// xᵀ D y of the free units, D diagonal.
fn product(rest: &Rest, x: &[[c64; 3]], diagonal: &[f64], y: &[[c64; 3]]) -> c64 {
    let at = |i: usize| {
        let (unit, d) = (rest.unknowns[i] / 3, rest.unknowns[i] % 3);
        x[unit][d] * y[unit][d] * diagonal[i]
    };
    (0..diagonal.len()).map(at).sum()
}

/// Upright squares in a column, clamped at one end, move as masses on springs: ω = 2√(k_l/m) sin((2j − 1)π/(4n + 2)), s² + (c/m)
/// s + ω² = 0. With this damping the slowest modes are overdamped.
#[test]
fn a_column_of_squares_has_the_modes_of_a_chain() {
    let n = 6;
    let column = Scene {
        damping_ratio: 0.6,
        panels: Vec::new(),
        sensors: Vec::new(),
        chip: None,
        mount: None,
        ..scene(Layout::planar(1, n + 1, 15.0, 2.25), vec![0])
    };
    let design = column.layout.initial_design(0.0);
    let (rest, modes) = found(&column, &design, 6 * n);
    let (m, c) = (rest.mass[0], rest.damping[0]);
    let mut ringing = [0, 0];
    for j in 1..=n {
        let omega = 2.0 * (3.0 / m).sqrt() * ((2 * j - 1) as f64 * PI / (4 * n + 2) as f64).sin();
        let half = 0.5 * c / m;
        let under = omega * omega - half * half;
        let roots = match under > 0.0 {
            true => vec![c64::new(-half, under.sqrt())],
            false => [-1.0, 1.0].map(|sign| c64::new(-half + sign * (-under).sqrt(), 0.0)).to_vec(),
        };
        ringing[usize::from(under > 0.0)] += 1;
        for root in roots {
            let off = modes.iter().map(|mode| (mode.s - root).norm()).fold(f64::INFINITY, f64::min);
            assert!(
                off < 1e-9 * root.norm(),
                "{j}: {root} is {off} from any of {:?}",
                modes.iter().map(|m| m.s).collect::<Vec<_>>()
            );
        }
    }
    assert!(ringing[0] > 0 && ringing[1] > 0, "{ringing:?}");
}

/// (s² M + s C + K) x = 0, and (s + s′) xᵀMx′ + xᵀCx′ = 0 for two modes.
#[test]
fn modes_solve_the_damped_equation_and_are_orthogonal_in_its_sense() {
    let (scene, design) = small();
    let (rest, modes) = found(&scene, &design, 18);
    assert_eq!(modes.len(), 17);
    let (mut worst, mut across) = (0.0f64, 0.0f64);
    for (i, Mode { s, shape }) in modes.iter().enumerate() {
        worst = worst.max(off(&rest, &modes[i]));
        assert!((product(&rest, shape, &rest.mass, shape) - 1.0).norm() < 1e-12);
        for other in &modes[..i] {
            for conjugate in [false, true] {
                let y: Vec<[c64; 3]> =
                    other.shape.iter().map(|y| if conjugate { y.map(|y| y.conj()) } else { *y }).collect();
                let both = *s + if conjugate { other.s.conj() } else { other.s };
                let [mass, damping] = [&rest.mass, &rest.damping].map(|d| product(&rest, shape, d, &y));
                across = across.max((both * mass + damping).norm() / s.norm());
            }
        }
    }
    assert!(worst < 1e-8 && across < 1e-8, "{worst:e} {across:e}");
}

/// A square body held at its corners has double modes. All are found, in agreement with a dense undamped solver, and the highest
/// frequency is the one that sets the steps.
#[test]
fn modes_that_come_twice_are_found_twice() {
    let layout = Layout::planar(5, 5, 15.0, 2.25);
    let square = Scene { damping_ratio: 0.0, ..scene(layout, vec![0, 4, 20, 24]) };
    let design = square.layout.initial_design(0.0);
    let rest = Rest::new(&square, &design);
    let n = rest.mass.len();
    let mut dense = DMatrix::zeros(n, n);
    rest.stiffness.iter().for_each(|&(i, j, k)| dense[(i, j)] = k / (rest.mass[i] * rest.mass[j]).sqrt());
    let mut known: Vec<f64> = dense.symmetric_eigenvalues().iter().map(|l| l.sqrt() / TAU).collect();
    known.sort_by(f64::total_cmp);
    let twice = known.windows(2).filter(|f| f[1] / f[0] < 1.0 + 1e-9).count();
    assert!(twice > 5, "{twice} of {known:?}");
    for count in [10, 30, n] {
        let (rest, modes) = found(&square, &design, count);
        for mode in &modes {
            let off = off(&rest, mode);
            assert!(off < 1e-8, "{count}: {} {off:e}", mode.s);
        }
        let frequencies: Vec<f64> = modes.iter().map(Mode::frequency).collect();
        assert_eq!(modes.len(), count);
        let off = frequencies.iter().zip(&known).map(|(f, k)| (f / k - 1.0).abs()).fold(0.0, f64::max);
        assert!(off < 1e-7, "{count}: {off:e}, {frequencies:?} {known:?}");
    }
    let highest = highest_frequency(&square, &design) / TAU;
    assert!((highest / known[n - 1] - 1.0).abs() < 1e-3, "{highest} {}", known[n - 1]);
}

/// 1 if the conjugate is another mode, 0 for an overdamped mode, such as the soft modes of Kagome lattices.
fn pair(mode: &Mode) -> f64 {
    f64::from(u8::from(mode.s.im != 0.0))
}

/// Weights b in q̇ = s q + b f: xᵀf / (2s xᵀMx + xᵀCx).
fn weights(rest: &Rest, mode: &Mode) -> Vec<c64> {
    let below = 2.0 * mode.s + product(rest, &mode.shape, &rest.damping, &mode.shape);
    let part = |(i, does): &(usize, f64)| mode.shape[rest.unknowns[*i] / 3][rest.unknowns[*i] % 3] * *does;
    rest.pushes.iter().map(|of| of.iter().map(part).sum::<c64>() / below).collect()
}

/// Compression rotates units, and with them the axes of their chips.
#[test]
fn responses_of_a_pressed_body_are_along_its_chips() {
    let (scene, design) = small();
    let (last, held) = (scene.layout.units() - 1, scene.clamped.len());
    let clamped = [&scene.clamped[..], &[last]].concat();
    let pressed = [vec![[0.0; 2]; held], vec![[0.0, -2.0], [0.5, 0.0]]].concat();
    let panels = vec![Panel::central(last - 1, [0.0, -1.0])];
    let world = Scene { clamped, imposed: pressed, panels, sensors: vec![last - 1], ..scene };
    let body = Scene { frame: AccelerationFrame::Body, ..world.clone() };
    let rest = Rest::new(&world, &design);
    let turn = rest.turned[last - 1];
    let [a, b] = [&world, &body].map(|scene| responses(scene, &rest, &scene.sensors, &[40.0])[0][0][0]);
    let along = [a[0] * turn.cos() + a[1] * turn.sin(), a[1] * turn.cos() - a[0] * turn.sin(), a[2]];
    assert!(
        turn.abs() > 1e-3 && along.iter().zip(b).all(|(x, y)| (x - y).norm() < 1e-12 * y.norm()),
        "{turn}"
    );
}

/// The sum over all modes is the response, except for the acceleration of a shaken base.
#[test]
fn responses_are_the_sum_over_all_modes() {
    bodies().into_iter().for_each(|(what, scene, design)| check_responses(&what, &scene, &design));
}

fn check_responses(what: &str, scene: &Scene, design: &[f64]) {
    let rest = Rest::new(scene, design);
    let modes = modes(&rest, scene.layout.units(), 2 * rest.mass.len()).unwrap();
    let (frequencies, sensors) = ([0.5, 40.0, 333.0], &scene.sensors);
    let direct = responses(scene, &rest, sensors, &frequencies);
    let parts: Vec<_> = modes.iter().map(|m| part_of(m, scene, &rest, sensors, &frequencies)).collect();
    for (f, hertz) in frequencies.into_iter().enumerate() {
        for (k, shaken) in rest.shakes.iter().enumerate() {
            for (i, unit) in sensors.iter().enumerate() {
                let read = direct[f][k][i];
                for (d, shaken) in shaken.iter().copied().chain([0.0]).enumerate() {
                    let sum = parts.iter().map(|part| part[f][k][i][d]).sum::<c64>() + shaken;
                    let size = if d < 2 { read[0].norm().max(read[1].norm()) } else { read[2].norm() };
                    let off = (read[d] - sum).norm();
                    assert!(off < 1e-7 * size, "{what}: {hertz} Hz, {k}, {unit}, {d}: {} {sum}", read[d]);
                }
            }
        }
    }
    let quick = modes[modes.len() / 2].frequency();
    let slow = modes_to(&rest, scene.layout.units(), quick).unwrap();
    assert_eq!(slow.len(), modes.iter().filter(|mode| mode.frequency() <= quick * (1.0 + 1e-9)).count());
}

/// A simulation under forces of some µN (odd part, without quadratic terms) agrees with the exact sum over all modes, for forces
/// linear between instants, within 3e-7.
#[test]
fn small_motions_of_a_simulation_are_those_of_the_modes() {
    bodies().into_iter().for_each(|(what, scene, design)| check_motions(&what, &scene, &design));
}

fn check_motions(what: &str, scene: &Scene, design: &[f64]) {
    let rest = Rest::new(scene, design);
    let (n, panels, channels) = (rest.mass.len(), scene.panels.len(), 3 * scene.sensors.len());
    let modes = modes(&rest, scene.layout.units(), 2 * n).unwrap();
    let force = |k: usize, n: usize| 1e-5 * (0.4 * n as f64 + k as f64).sin().powi(3) * (n as f64 / 20.0);
    let sides = [1.0, -1.0].into_iter().flat_map(|sign| (0..panels).map(move |k| (sign, k)));
    let values = sides.flat_map(|(sign, k)| (0..=20).map(move |n| sign * force(k, n))).collect();
    let forces = Forces { samples: 2, panels, instants: 20, values, strikes: Vec::new() };
    let pool = metasense_numerics::Pool::new(1).unwrap();
    let plan = IntegrationPlan::equal(Integrator::Nystrom6, 64);
    let simulated = run(scene, design, &forces, &plan, false, &pool).signals;
    let h = scene.duration / 20.0;
    let mut q = vec![c64::ZERO; modes.len()];
    let (mut off, mut size) = ([0.0f64; 2], [0.0f64; 2]);
    for t in 1..=20 {
        for (mode, q) in modes.iter().zip(&mut q) {
            let s = mode.s;
            let grown = (s * h).exp();
            // ∫ exp(s(h − t)) (1, t/h) dt
            let [flat, ramp] = [(grown - 1.0) / s, (grown - 1.0 - s * h) / (s * s * h)];
            *q *= grown;
            for (k, b) in weights(&rest, mode).into_iter().enumerate() {
                *q += b * (flat * force(k, t - 1) + ramp * (force(k, t) - force(k, t - 1)));
            }
        }
        // M a = f − C v − K x.
        let of = |i: usize, power: i32| -> f64 {
            let part =
                |(m, q): (&Mode, &c64)| (1.0 + pair(m)) * (m.s.powi(power) * m.shape[i / 3][i % 3] * *q).re;
            modes.iter().zip(&q).map(part).sum()
        };
        let mut net: Vec<f64> =
            rest.unknowns.iter().zip(&rest.damping).map(|(i, c)| -c * of(*i, 1)).collect();
        rest.stiffness.iter().for_each(|&(i, j, k)| net[i] -= k * of(rest.unknowns[j], 0));
        for (k, pushes) in rest.pushes.iter().enumerate() {
            pushes.iter().for_each(|(i, does)| net[*i] += does * force(k, t));
        }
        let base =
            [0, 1].map(|d| (0..scene.panels.len()).map(|k| rest.shakes[k][d] * force(k, t)).sum::<f64>());
        for (m, &unit) in scene.sensors.iter().enumerate() {
            let place = |d: usize| rest.unknowns.iter().position(|i| *i == 3 * unit + d);
            let felt = |d: usize| place(d).map_or(0.0, |i| net[i] / rest.mass[i]) + base[d];
            let exact = [felt(0), felt(1), of(3 * unit + 2, 1)];
            for (c, exact) in exact.into_iter().enumerate() {
                let [up, down] = [0, 20 * channels].map(|of| simulated[of + (t - 1) * channels + 3 * m + c]);
                let read = 0.5 * (up - down);
                off[c / 2] += (read - exact).powi(2);
                size[c / 2] += exact * exact;
            }
        }
    }
    let relative = [0, 1].map(|i| (off[i] / size[i]).sqrt());
    assert!(relative.iter().all(|r| *r < 3e-7), "{what}: {relative:?}");
}

/// In a slender body, whose slow bending modes have residuals dominated by rounding, a small subspace still finds the modes of a
/// dense solver.
#[test]
fn a_slender_body_has_the_modes_of_a_dense_solver() {
    let slender = Scene { panels: Vec::new(), ..scene(Layout::planar(3, 40, 15.0, 2.25), vec![0, 1, 2]) };
    let design = slender.layout.initial_design(0.4363);
    let (rest, modes) = found(&slender, &design, 12);
    let n = rest.mass.len();
    let mut dense = DMatrix::zeros(2 * n, 2 * n);
    let scale = 1e3;
    for i in 0..n {
        dense[(i, n + i)] = scale;
        dense[(n + i, n + i)] = -rest.damping[i] / rest.mass[i];
    }
    rest.stiffness.iter().for_each(|&(i, j, k)| dense[(n + i, j)] -= k / rest.mass[i] / scale);
    let mut known: Vec<f64> = Mat::from_fn(2 * n, 2 * n, |i, j| dense[(i, j)])
        .eigenvalues()
        .unwrap()
        .into_iter()
        .filter(|s| s.im >= 0.0)
        .map(|s| s.norm() / TAU)
        .collect();
    known.sort_by(f64::total_cmp);
    // Rounding error of the dense solver in the slowest modes.
    let enough = |frequency: f64| 1e-9 * (1.0 + 1e-3 * known[n - 1] / frequency);
    for (mode, known) in modes.iter().zip(&known) {
        let off = (mode.frequency() / known - 1.0).abs();
        assert!(off < enough(*known), "{} {known}: {off:e}", mode.s);
    }
    assert!(modes[0].frequency() < 1e-4 * known[n - 1], "{}", modes[0].s);
}

/// Without damping, damping ratios are 0 and modes do not decay.
#[test]
fn modes_without_damping_are_not_damped() {
    let (scene, design) = small();
    let (_, modes) = found(&Scene { damping_ratio: 0.0, ..scene.clone() }, &design, 17);
    assert!(modes.iter().all(|mode| mode.damping_ratio() == 0.0 && mode.decay_time().is_none()));
    for damping_ratio in [1e-12, 0.02, 3.0, 300.0] {
        let (_, modes) = found(&Scene { damping_ratio, ..scene.clone() }, &design, 17);
        for mode in modes {
            let (ratio, time) = (mode.damping_ratio(), mode.decay_time().expect("it is damped"));
            assert!((0.0..=1.0).contains(&ratio) && ratio > 0.0 && time > 0.0, "{damping_ratio}: {}", mode.s);
            assert!(mode.s.im > 0.0 || ratio == 1.0, "{damping_ratio}: {}", mode.s);
        }
    }
}

/// An unsupported body has three modes at s = 0 without strain, three that decay without stiffness; its other modes solve the
/// same equation.
#[test]
fn a_loose_body_moves_as_a_whole() {
    let (small, design) = small();
    let of = |linearised| Scene {
        clamped: Vec::new(),
        guided: Vec::new(),
        panels: small.panels[..2].to_vec(),
        linearised,
        ..small.clone()
    };
    for scene in [of(false), of(true)] {
        let n = 3 * scene.layout.units();
        let (rest, modes) = found(&scene, &design, 2 * n);
        assert!(
            modes[..3].iter().all(|mode| mode.s == c64::ZERO) && modes[3].s != c64::ZERO,
            "{:?}",
            modes[..4].iter().map(|mode| mode.s).collect::<Vec<_>>()
        );
        let most = rest.stiffness.iter().fold(0.0, |most: f64, (_, _, k)| most.max(k.abs()));
        for mode in &modes[..3] {
            let x = |i: usize| mode.shape[i / 3][i % 3];
            let size: f64 = (0..n).map(|i| x(i).norm_sqr()).sum();
            let strained: f64 = rest.stiffness.iter().map(|&(i, j, k)| (x(i).conj() * k * x(j)).re).sum();
            assert!(strained.abs() < 1e-9 * most * size, "{strained} of {}", most * size);
        }
        assert!(modes[3..].iter().all(|mode| off(&rest, mode) < 1e-6));
        // The trace of −M⁻¹ C is the sum of all s.
        let trace: f64 = rest.damping.iter().zip(&rest.mass).map(|(c, m)| -c / m).sum();
        let pairs = |mode: &Mode| if mode.s.im > 0.0 { 2.0 * mode.s.re } else { mode.s.re };
        let sum: f64 = modes.iter().map(pairs).sum();
        assert!((sum / trace - 1.0).abs() < 1e-6, "{sum} {trace}");
    }
}
