//! Splitting schemes of equal steps for second-order systems, and their discrete adjoints.
//!
//! ```text
//! drift a:  x += (1 − e)/γ v,  v *= e,  e = exp(−γ a h),  γ = C/M,  t += a h      (ẋ = v, v̇ = −γ v, exact)
//! kick  b:  v += b h G,  G = M⁻¹(−∂U(x) + f(t))
//! ```
//! Kicks and drifts alternate, a kick at either end; steps share the force there, and sensors read from it. Damping
//! sits in the drift: then G depends on x and t alone and drifts are linear in v, which is all that the
//! Runge–Kutta–Nyström order conditions ask. S. Blanes, P. C. Moan, J. Comput. Appl. Math. 142 (2002) 313–330.
//!
//! The schemes run backwards too: the reverse sweep rebuilds states from the next checkpoint, with the forces that
//! its evaluations of second derivatives yield on the way.

use super::balance::Balance;
use super::system::{Ramp, System, Unit, add_into, load_lanes, read_lane, store_lane};
use super::tsit5::{Slot, Sweep};
use super::vector::Vector;
use super::{Counters, Forces, Frame, Outcome, Scene};

/// Coefficients of one step, first half; both lists are symmetric.
#[derive(Debug, Clone, PartialEq)]
pub struct Scheme {
    /// b: one more than drifts.
    pub kicks: Vec<f64>,
    /// a.
    pub drifts: Vec<f64>,
}

impl Scheme {
    /// Störmer, Verlet: order 2, 1 force a step.
    pub fn leapfrog() -> Self {
        Self { kicks: vec![0.5, 0.5], drifts: vec![1.0] }
    }

    /// Blanes and Moan's SRKN₆ᵇ: order 4, 6 forces a step.
    pub fn fourth() -> Self {
        let (b, a) = (
            [0.0829844064174052, 0.396309801498368, -0.0390563049223486],
            [0.245298957184271, 0.60487266571108],
        );
        let middle = 1.0 - 2.0 * b.iter().sum::<f64>();
        let inner = 0.5 - a.iter().sum::<f64>();
        Self {
            kicks: vec![b[0], b[1], b[2], middle, b[2], b[1], b[0]],
            drifts: vec![a[0], a[1], inner, inner, a[1], a[0]],
        }
    }

    /// Blanes and Moan's SRKN₁₁ᵇ: order 6, 11 forces a step.
    pub fn sixth() -> Self {
        let b = [
            0.0414649985182624,
            0.198128671918067,
            -0.0400061921041533,
            0.0752539843015807,
            -0.0115113874206879,
        ];
        let a =
            [0.123229775946271, 0.290553797799558, -0.127049212625417, -0.246331761062075, 0.357208872795928];
        let inner = 0.5 - b.iter().sum::<f64>();
        let middle = 1.0 - 2.0 * a.iter().sum::<f64>();
        let mut kicks = b.to_vec();
        kicks.extend([inner, inner]);
        kicks.extend(b.iter().rev());
        let mut drifts = a.to_vec();
        drifts.push(middle);
        drifts.extend(a.iter().rev());
        Self { kicks, drifts }
    }

    /// Forces a step.
    pub fn stages(&self) -> usize {
        self.drifts.len()
    }
}

/// e and (1 − e)/γ of a drift over τ, and the derivatives of both in γ.
#[derive(Clone, Copy)]
pub struct Drift {
    /// e.
    pub keep: f64,
    /// (1 − e)/γ.
    pub reach: f64,
    /// de/dγ.
    pub keep_slope: f64,
    /// d((1 − e)/γ)/dγ.
    pub reach_slope: f64,
}

impl Drift {
    /// For τ = `tau`.
    pub fn new(gamma: f64, tau: f64) -> Self {
        let z = gamma * tau;
        let keep = (-z).exp();
        // (1 − e⁻ᶻ)/z and (z e⁻ᶻ − 1 + e⁻ᶻ)/z², by series where they cancel
        let (reach, slope) = if z.abs() < 0.3 {
            let (mut reach, mut slope, mut term) = (0.0, 0.0, 1.0);
            for k in 1..16 {
                // term = (−z)^(k−1)/k!
                term *= if k == 1 { 1.0 } else { -z } / k as f64;
                reach += term;
                slope -= term * k as f64 / (k + 1) as f64;
            }
            (reach, slope)
        } else {
            (-(-z).exp_m1() / z, (z * keep + (-z).exp_m1()) / (z * z))
        };
        Self { keep, reach: tau * reach, keep_slope: -tau * keep, reach_slope: tau * tau * slope }
    }
}

/// Into how many parts an interval is cut by checkpoints, so that running backwards loses at most some e⁶ to damping.
pub fn segments(scene: &Scene, model: &super::model::Model, substeps: usize) -> usize {
    let delta = scene.duration / scene.instants as f64;
    let rates = model.inverse_mass.iter().flat_map(|m| (0..3).map(|d| m[d] * model.damping[d]));
    let fastest = rates.fold(0.0, f64::max);
    ((fastest * delta / 6.0).ceil() as usize).clamp(1, substeps)
}

/// Where segment `k` of `segments` ends, in steps.
fn segment_end(k: usize, segments: usize, substeps: usize) -> usize {
    (k + 1) * substeps / segments
}

/// A scheme made ready for one model and step.
struct Ready {
    kicks: Vec<f64>,
    /// Drift by drift, one entry a unit and degree of freedom.
    drifts: Vec<Vec<[Drift; 3]>>,
    /// Where in the step each force is taken, as a part of it: after each drift.
    clock: Vec<f64>,
    gamma: Vec<[f64; 3]>,
}

impl Ready {
    fn new(scheme: &Scheme, model: &super::model::Model, h: f64) -> Self {
        let gamma: Vec<[f64; 3]> =
            model.inverse_mass.iter().map(|m| std::array::from_fn(|d| m[d] * model.damping[d])).collect();
        let drift = |a: &f64| gamma.iter().map(|g| g.map(|g| Drift::new(g, a * h))).collect();
        let clock = scheme.drifts.iter().scan(0.0, |t, a| {
            *t += a;
            Some(*t)
        });
        Self {
            kicks: scheme.kicks.iter().map(|b| b * h).collect(),
            drifts: scheme.drifts.iter().map(drift).collect(),
            clock: clock.collect(),
            gamma,
        }
    }
}

/// What both directions start from.
struct Course<'a, V> {
    ready: Ready,
    stages: usize,
    /// The kicks at either end of a step.
    first: f64,
    last: f64,
    ramp: Ramp<'a, V>,
    force: Vec<V>,
}

impl<'a, V: Vector> Course<'a, V> {
    #[inline(always)]
    fn new(
        system: &System<'_, V>,
        scheme: &Scheme,
        substeps: usize,
        forces: &'a Forces,
        histories: Vec<&'a [f64]>,
    ) -> Self {
        let scene = system.scene;
        let h = scene.duration / (scene.instants * substeps) as f64;
        let ready = Ready::new(scheme, system.model, h);
        let stages = scheme.stages();
        Self {
            stages,
            first: ready.kicks[0],
            last: ready.kicks[stages],
            ready,
            ramp: Ramp::new(scene, forces, histories, substeps),
            force: vec![V::splat(0.0); forces.panels],
        }
    }
}

#[inline(always)]
fn kick<V: Vector>(v: &mut [Unit<V>], b: f64, g: &[Unit<V>]) {
    let b = V::splat(b);
    for (v, g) in v.as_flattened_mut().iter_mut().zip(g.as_flattened()) {
        *v = b.mul_add(*g, *v);
    }
}

/// Integrates up to eight samples with `substeps` steps an interval, checkpoints after each of `parts` parts. `system` has no damping of its own.
#[inline(always)]
pub fn forward<V: Vector>(
    system: &mut System<'_, V>,
    scheme: &Scheme,
    substeps: usize,
    parts: usize,
    forces: &Forces,
    slots: &mut [Slot<'_>],
) -> Counters {
    let scene = system.scene;
    let model = system.model;
    let free = &model.free;
    let width = 3 * scene.sensors.len();
    let instants = scene.instants;
    let zero = V::splat(0.0);
    let histories = slots.iter().map(|s| forces.sample(s.index)).collect();
    let Course { ready, stages, first, last, mut ramp, mut force } =
        Course::new(system, scheme, substeps, forces, histories);
    let (mut x, mut v, mut g) = (system.zeros(), system.zeros(), system.zeros());
    let mut margin = V::splat(1.0);

    ramp.at(0, 0.0, &mut force);
    let mut balance = Balance::new(scene, model, &force);
    system.acceleration(&x, &v, &force, &mut g, &mut margin);
    for interval in 0..instants {
        crate::pulse::beat();
        let mut part = 0;
        kick(&mut v, first, &g);
        for step in 0..substeps {
            let boundary = step + 1 == segment_end(part, parts, substeps);
            for j in 0..stages {
                for ((x, v), drift) in x.iter_mut().zip(&mut v).zip(&ready.drifts[j]) {
                    for d in 0..3 {
                        x[d] = V::splat(drift[d].reach).mul_add(v[d], x[d]);
                        v[d] = V::splat(drift[d].keep) * v[d];
                    }
                }
                ramp.at(interval * substeps + step, ready.clock[j], &mut force);
                balance.add(&x, &force);
                system.acceleration(&x, &v, &force, &mut g, &mut margin);
                let b = match j + 1 == stages {
                    true if boundary => last,
                    true => last + first,
                    false => ready.kicks[j + 1],
                };
                kick(&mut v, b, &g);
            }
            if boundary {
                for (l, slot) in slots.iter_mut().enumerate() {
                    if let Some(tape) = &mut slot.tape {
                        let len = 6 * free.len();
                        store_lane(
                            free,
                            &x,
                            &v,
                            l,
                            &mut tape.states[(interval * parts + part) * len..][..len],
                        );
                    }
                }
                part += 1;
                if part < parts {
                    kick(&mut v, first, &g);
                }
            }
        }
        // a = G − γ v at the instant
        let margins = margin.array();
        let mut a = g.clone();
        for ((a, v), gamma) in a.iter_mut().zip(&v).zip(&ready.gamma) {
            for d in 0..3 {
                a[d] = V::splat(gamma[d]).mul_sub_from(v[d], a[d]);
            }
        }
        let mut size = zero;
        for (x, v) in x.as_flattened().iter().zip(v.as_flattened()) {
            size = size + x.abs() + v.abs();
        }
        let excess = balance.excess(&v).array();
        for (l, slot) in slots.iter_mut().enumerate() {
            if *slot.outcome != Outcome::Ok {
                continue;
            }
            if margins[l] < 0.0 {
                *slot.outcome = Outcome::ForbiddenContact;
            } else if !size.array()[l].is_finite() {
                *slot.outcome = Outcome::NonFinite;
            } else if excess[l] > 0.0 {
                *slot.outcome = Outcome::Unstable;
            } else {
                read_lane(scene, &x, &v, &a, l, &mut slot.signals[interval * width..][..width]);
            }
        }
        if slots.iter().all(|s| *s.outcome != Outcome::Ok) {
            break;
        }
    }
    let lanes = slots.len() as u64;
    let steps = (instants * substeps) as u64;
    Counters { force_evaluations: lanes * (1 + steps * stages as u64), steps: lanes * steps, rejected: 0 }
}

/// Sweeps up to eight samples backwards, adding to the cotangents of `system`, which has no damping of its own.
#[inline(always)]
pub fn reverse<V: Vector>(
    system: &mut System<'_, V>,
    scheme: &Scheme,
    substeps: usize,
    parts: usize,
    forces: &Forces,
    sweeps: &[Sweep<'_>],
) -> Counters {
    let scene = system.scene;
    let model = system.model;
    let free = &model.free;
    let width = 3 * scene.sensors.len();
    let instants = scene.instants;
    let zero = V::splat(0.0);
    let histories = sweeps.iter().map(|s| s.history).collect();
    let Course { ready, stages, first, last, mut ramp, mut force } =
        Course::new(system, scheme, substeps, forces, histories);
    let (mut x, mut v, mut g, mut a) = (system.zeros(), system.zeros(), system.zeros(), system.zeros());
    let (mut bar_x, mut bar_v, mut bar_g) = (system.zeros(), system.zeros(), system.zeros());
    let (mut bar_a, mut to_x, mut to_v) = (system.zeros(), system.zeros(), system.zeros());
    let mut bar_gamma = system.zeros();
    let mut bar = vec![zero; width];
    let mut margin = zero;
    let mut evaluations = 1;

    for interval in (0..instants).rev() {
        crate::pulse::beat();
        let mut step = substeps;
        for part in (0..parts).rev() {
            // The checkpoint: the state after the last kick of a step
            let len = 6 * free.len();
            let states = std::array::from_fn(|l| {
                sweeps.get(l).map(|s| &s.tape.states[(interval * parts + part) * len..][..len])
            });
            load_lanes(free, &states, &mut x, &mut v);
            ramp.at(interval * substeps + step - 1, 1.0, &mut force);
            let instant = part + 1 == parts;
            let next = if instant && interval + 1 == instants { 0.0 } else { first };
            for (bar_g, bar_v) in bar_g.as_flattened_mut().iter_mut().zip(bar_v.as_flattened()) {
                *bar_g = V::splat(next) * *bar_v;
            }
            if instant {
                for (k, b) in bar.iter_mut().enumerate() {
                    let at = |l: usize| sweeps.get(l).map_or(0.0, |s| s.cotangent[interval * width + k]);
                    *b = V::new(std::array::from_fn(at));
                }
                if scene.frame == Frame::Body {
                    system.acceleration(&x, &v, &force, &mut g, &mut margin);
                    evaluations += 1;
                    for u in 0..x.len() {
                        for d in 0..3 {
                            a[u][d] = V::splat(ready.gamma[u][d]).mul_sub_from(v[u][d], g[u][d]);
                        }
                    }
                }
                bar_a.fill([zero; 3]);
                system.read_vjp(&x, &a, &bar, &mut bar_x, &mut bar_v, &mut bar_a);
                for u in 0..x.len() {
                    for d in 0..3 {
                        let bar_a = bar_a[u][d];
                        bar_g[u][d] = bar_g[u][d] + bar_a;
                        bar_v[u][d] = V::splat(ready.gamma[u][d]).mul_sub_from(bar_a, bar_v[u][d]);
                        bar_gamma[u][d] = bar_a.mul_sub_from(v[u][d], bar_gamma[u][d]);
                    }
                }
            }
            kick(&mut bar_g, last, &bar_v);
            system.acceleration_vjp(&x, &v, &force, &bar_g, &mut to_x, &mut to_v, &mut g);
            add_into(&mut bar_x, &to_x);
            kick(&mut v, -last, &g);
            evaluations += 1;

            let begin = if part == 0 { 0 } else { segment_end(part - 1, parts, substeps) };
            while step > begin {
                step -= 1;
                for j in (0..stages).rev() {
                    for u in 0..x.len() {
                        for d in 0..3 {
                            let drift = ready.drifts[j][u][d];
                            let before = V::splat(1.0 / drift.keep) * v[u][d];
                            x[u][d] = V::splat(drift.reach).mul_sub_from(before, x[u][d]);
                            v[u][d] = before;
                            let slope = V::splat(drift.keep_slope) * bar_v[u][d];
                            let slope = V::splat(drift.reach_slope).mul_add(bar_x[u][d], slope);
                            bar_gamma[u][d] = slope.mul_add(before, bar_gamma[u][d]);
                            bar_v[u][d] = V::splat(drift.reach)
                                .mul_add(bar_x[u][d], V::splat(drift.keep) * bar_v[u][d]);
                        }
                    }
                    // The first kick of a segment belongs to the checkpoint before it.
                    if j == 0 && step == begin {
                        continue;
                    }
                    let b = if j == 0 { last + first } else { ready.kicks[j] };
                    let clock = if j == 0 { 0.0 } else { ready.clock[j - 1] };
                    ramp.at(interval * substeps + step, clock, &mut force);
                    for (bar_g, bar_v) in bar_g.as_flattened_mut().iter_mut().zip(bar_v.as_flattened()) {
                        *bar_g = V::splat(b) * *bar_v;
                    }
                    system.acceleration_vjp(&x, &v, &force, &bar_g, &mut to_x, &mut to_v, &mut g);
                    add_into(&mut bar_x, &to_x);
                    kick(&mut v, -b, &g);
                    evaluations += 1;
                }
            }
        }
    }
    // The first kick, from rest
    x.fill([zero; 3]);
    v.fill([zero; 3]);
    ramp.at(0, 0.0, &mut force);
    for (bar_g, bar_v) in bar_g.as_flattened_mut().iter_mut().zip(bar_v.as_flattened()) {
        *bar_g = V::splat(first) * *bar_v;
    }
    system.acceleration_vjp(&x, &v, &force, &bar_g, &mut to_x, &mut to_v, &mut g);
    system.add_rate_cotangent(&bar_gamma);
    let lanes = sweeps.len() as u64;
    Counters {
        force_evaluations: lanes * evaluations,
        steps: lanes * (instants * substeps) as u64,
        rejected: 0,
    }
}
