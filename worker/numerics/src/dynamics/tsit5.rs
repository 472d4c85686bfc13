//! Tsitouras 5(4) with error control a sample, and its discrete adjoint.
//!
//! Ch. Tsitouras, Comput. Math. Appl. 62 (2011) 770–775. As ẋ = v, a step needs the stages' accelerations A alone:
//!
//! ```text
//! V_i = v + h Σ a_ij A_j,   X_i = x + c_i h v + h² Σ ā_ij A_j,   ā = a·a,   A_i = M⁻¹(−∂U(X_i) − C V_i + f)
//! ```
//! Lanes step on their own clocks and take up the next sample when one is done. Every instant is hit exactly.

mod stages;

use super::system::{System, Unit, add_into, force_at, load_lanes, read_lane, store_lane};
use super::vector::{LANES, Vector};
use super::{Counters, Forces, Outcome, SampleTape};
pub use stages::{A, A2, C};
use stages::{E, E2, Stages, stage, stage_vjp, step_vjp};

/// Attempted steps after which a sample is given up.
const STEP_LIMIT: u64 = 4_000_000;
/// A step below this part of an interval is no step.
const LEAST_STEP: f64 = 1e-11;

/// One sample's results.
pub struct Slot<'a> {
    /// (T, 3M).
    pub signals: &'a mut [f64],
    /// How it ended.
    pub outcome: &'a mut Outcome,
    /// For the reverse sweep.
    pub tape: Option<&'a mut SampleTape>,
    /// Its forces.
    pub index: usize,
}

/// Where a lane is.
struct Lane {
    slot: Option<usize>,
    interval: usize,
    /// Time since the interval's beginning.
    tau: f64,
    /// Proposed step.
    proposed: f64,
    /// This step, and whether it lands on the instant.
    h: f64,
    lands: bool,
    count: u32,
    attempts: u64,
    last_error: f64,
}

/// Integrates the samples of `slots`. Allocates its scratch once.
#[inline(always)]
pub fn forward<V: Vector>(
    mut system: System<'_, V>,
    forces: &Forces,
    tolerance: f64,
    slots: &mut [Slot<'_>],
) -> Counters {
    let scene = system.scene;
    // Intervals of the forces, each `kinks`-th of which ends at an instant of the scene
    let (instants, kinks, panels) = (forces.instants, forces.kinks(scene), scene.panels.len());
    let delta = scene.duration / instants as f64;
    let free = &system.model.free;
    let width = 3 * scene.sensors.len();
    let scale = 1.0 / (6 * free.len().max(1)) as f64;
    let zero = V::splat(0.0);
    let one = V::splat(1.0);
    let (mut x, mut v, mut xs, mut vs) = (system.zeros(), system.zeros(), system.zeros(), system.zeros());
    let mut a: [Vec<Unit<V>>; 7] = std::array::from_fn(|_| system.zeros());
    let mut force = vec![zero; panels];
    let mut counters = Counters::default();
    let mut next = 0;
    let mut lanes: [Lane; LANES] = std::array::from_fn(|_| Lane {
        slot: None,
        interval: 0,
        tau: 0.0,
        proposed: 0.0,
        h: 0.0,
        lands: false,
        count: 0,
        attempts: 0,
        last_error: 1.0,
    });
    loop {
        // Idle lanes take up the next samples, at rest.
        for (l, lane) in lanes.iter_mut().enumerate() {
            if lane.slot.is_none() {
                clear_lane(&mut x, l);
                clear_lane(&mut v, l);
                lane.h = 0.0;
                if next < slots.len() {
                    // Not the push alone: contact may act at rest.
                    let history = forces.sample(slots[next].index);
                    for (k, f) in force.iter_mut().enumerate() {
                        *f = V::splat(force_at(forces, history, k, 0, 0.0));
                    }
                    xs.fill([zero; 3]);
                    vs.fill([zero; 3]);
                    system.acceleration(&xs, &vs, &force, &mut a[1], &mut { one });
                    copy_lane(&mut a, l);
                    counters.force_evaluations += 1;
                    *lane = Lane {
                        slot: Some(next),
                        proposed: delta / 16.0,
                        interval: 0,
                        tau: 0.0,
                        h: 0.0,
                        lands: false,
                        count: 0,
                        attempts: 0,
                        last_error: 1.0,
                    };
                    next += 1;
                }
            }
            if lane.slot.is_some() {
                let left = delta - lane.tau;
                let parts = (left / lane.proposed * (1.0 - 1e-9)).ceil().max(1.0);
                lane.h = left / parts;
                lane.lands = parts == 1.0;
            }
        }
        if lanes.iter().all(|l| l.slot.is_none()) {
            return counters;
        }

        // Six stages, the last of which is the new state's acceleration
        let h = V::new(std::array::from_fn(|l| lanes[l].h));
        let mut margin = one;
        for i in 1..7 {
            stage(i, h, &x, &v, &a, &mut xs, &mut vs);
            for (k, f) in force.iter_mut().enumerate() {
                *f = V::new(std::array::from_fn(|l| {
                    let lane = &lanes[l];
                    lane.slot.map_or(0.0, |s| {
                        let w =
                            if lane.lands && C[i] == 1.0 { 1.0 } else { (lane.tau + C[i] * lane.h) / delta };
                        force_at(forces, forces.sample(slots[s].index), k, lane.interval, w)
                    })
                }));
            }
            system.acceleration(&xs, &vs, &force, &mut a[i], &mut margin);
        }

        // Error relative to the tolerance, a lane
        let mut square = zero;
        let tol = V::splat(tolerance);
        let h2 = h * h;
        for &u in free {
            for d in 0..3 {
                let mut ex = zero;
                let mut ev = zero;
                for j in 0..7 {
                    ev = V::splat(E[j]).mul_add(a[j][u][d], ev);
                    if j < 6 {
                        ex = V::splat(E2[j]).mul_add(a[j][u][d], ex);
                    }
                }
                let sx = x[u][d].abs().max(xs[u][d].abs()).mul_add(tol, tol);
                let sv = v[u][d].abs().max(vs[u][d].abs()).mul_add(tol, tol);
                let (rx, rv) = ((h2 * ex).over(sx), (h * ev).over(sv));
                square = rx.mul_add(rx, rv.mul_add(rv, square));
            }
        }
        let square = square.array();
        let margins = margin.array();
        let mut accepted = [0.0; LANES];
        for l in 0..LANES {
            let lane = &mut lanes[l];
            let Some(s) = lane.slot else { continue };
            let forbidden = margins[l] < 0.0;
            let error = (square[l] * scale).sqrt();
            counters.force_evaluations += 6;
            lane.attempts += 1;
            if error <= 1.0 && !forbidden {
                accepted[l] = 1.0;
                let growth = 0.9 * error.max(1e-10).powf(-0.7 / 5.0) * lane.last_error.powf(0.4 / 5.0);
                lane.proposed = (lane.h * growth.clamp(0.2, 5.0)).min(delta);
                lane.last_error = error.max(1e-4);
                lane.count += 1;
                counters.steps += 1;
            } else {
                let shrink = 0.9 * error.powf(-0.2);
                lane.proposed = lane.h * if shrink > 0.2 && !forbidden { shrink.min(0.9) } else { 0.2 };
                counters.rejected += 1;
                let end = if lane.proposed >= LEAST_STEP * delta {
                    (lane.attempts >= STEP_LIMIT).then_some(Outcome::StepLimit)
                } else if forbidden {
                    Some(Outcome::ForbiddenContact)
                } else if error.is_finite() {
                    Some(Outcome::StepTooSmall)
                } else {
                    Some(Outcome::NonFinite)
                };
                if let Some(outcome) = end {
                    *slots[s].outcome = outcome;
                    lane.slot = None;
                }
            }
        }

        // Accepted lanes move on
        let accept = V::new(accepted);
        let (start, end) = a.split_at_mut(6);
        for u in 0..x.len() {
            for d in 0..3 {
                x[u][d] = xs[u][d].where_less(zero, accept, x[u][d]);
                v[u][d] = vs[u][d].where_less(zero, accept, v[u][d]);
                start[0][u][d] = end[0][u][d].where_less(zero, accept, start[0][u][d]);
            }
        }
        for l in 0..LANES {
            let lane = &mut lanes[l];
            let Some(s) = lane.slot else { continue };
            if accepted[l] == 0.0 {
                continue;
            }
            let slot = &mut slots[s];
            lane.tau += lane.h;
            if let Some(tape) = &mut slot.tape {
                tape.steps.push(lane.h);
            }
            if !lane.lands {
                if lane.attempts >= STEP_LIMIT {
                    *slot.outcome = Outcome::StepLimit;
                    lane.slot = None;
                }
                continue;
            }
            if (lane.interval + 1).is_multiple_of(kinks) {
                let (n, len) = (lane.interval / kinks, 6 * free.len());
                read_lane(scene, &x, &v, &a[0], l, &mut slot.signals[n * width..][..width]);
                if let Some(tape) = &mut slot.tape {
                    store_lane(free, &x, &v, l, &mut tape.states[n * len..][..len]);
                }
            }
            if let Some(tape) = &mut slot.tape {
                tape.counts.push(lane.count);
            }
            lane.tau = 0.0;
            lane.count = 0;
            lane.interval += 1;
            if lane.interval == instants {
                if let Some(tape) = &mut slot.tape {
                    tape.steps.shrink_to_fit();
                    tape.counts.shrink_to_fit();
                }
                *slot.outcome = Outcome::Ok;
                lane.slot = None;
            }
        }
    }
}

fn clear_lane<V: Vector>(x: &mut [Unit<V>], lane: usize) {
    for v in x.as_flattened_mut() {
        let mut array = v.array();
        array[lane] = 0.0;
        *v = V::new(array);
    }
}

/// A lane of the second stage's accelerations to the first's.
fn copy_lane<V: Vector>(a: &mut [Vec<Unit<V>>; 7], lane: usize) {
    let [to, from, ..] = a;
    for (to, from) in to.as_flattened_mut().iter_mut().zip(from.as_flattened()) {
        let mut array = to.array();
        array[lane] = from.array()[lane];
        *to = V::new(array);
    }
}

/// What the reverse sweep keeps of one step.
struct Step<V> {
    x: Vec<Unit<V>>,
    v: Vec<Unit<V>>,
    a: Stages<V>,
    h: V,
    tau: [f64; LANES],
    /// Of the forces.
    interval: usize,
}

/// One sample's part in a reverse sweep.
#[derive(Clone, Copy)]
pub struct Sweep<'a> {
    /// Its tape.
    pub tape: &'a SampleTape,
    /// Its forces.
    pub history: &'a [f64],
    /// (T, 3M).
    pub cotangent: &'a [f64],
}

/// Sweeps up to eight samples backwards, adding to the cotangents of `system`.
#[inline(always)]
pub fn reverse<V: Vector>(system: &mut System<'_, V>, forces: &Forces, sweeps: &[Sweep<'_>]) -> Counters {
    let scene = system.scene;
    let model = system.model;
    let free = &model.free;
    let (instants, kinks, panels) = (scene.instants, forces.kinks(scene), scene.panels.len());
    let delta = scene.duration / forces.instants as f64;
    let width = 3 * scene.sensors.len();
    let zero = V::splat(0.0);
    let mut counters = Counters::default();
    let (mut bar_x, mut bar_v) = (system.zeros(), system.zeros());
    let (mut xs, mut vs) = (system.zeros(), system.zeros());
    let (mut bar_a, mut acceleration) = (system.zeros(), system.zeros());
    let mut bars_x: Stages<V> = std::array::from_fn(|_| system.zeros());
    let mut bars_v: Stages<V> = std::array::from_fn(|_| system.zeros());
    let mut steps: Vec<Step<V>> = Vec::new();
    let mut force = vec![zero; panels];
    let mut bar = vec![zero; width];
    let mut ends: Vec<usize> = sweeps.iter().map(|s| s.tape.steps.len()).collect();

    let forces_at = |force: &mut [V], interval: usize, tau: &[f64; LANES], h: V, c: f64| {
        let h = h.array();
        for (k, f) in force.iter_mut().enumerate() {
            let at = |l: usize| {
                let w = ((tau[l] + c * h[l]) / delta).min(1.0);
                sweeps.get(l).map_or(0.0, |s| force_at(forces, s.history, k, interval, w))
            };
            *f = V::new(std::array::from_fn(at));
        }
    };
    let state = |n: usize| -> [Option<&[f64]>; LANES] {
        std::array::from_fn(|l| {
            let s = sweeps.get(l)?;
            (n > 0).then(|| &s.tape.states[(n - 1) * 6 * free.len()..][..6 * free.len()])
        })
    };
    for interval in (0..instants).rev() {
        // The sensors at the interval's end
        load_lanes(free, &state(interval + 1), &mut xs, &mut vs);
        for (k, b) in bar.iter_mut().enumerate() {
            *b = V::new(std::array::from_fn(|l| {
                sweeps.get(l).map_or(0.0, |s| s.cotangent[interval * width + k])
            }));
        }
        forces_at(&mut force, (interval + 1) * kinks - 1, &[delta; LANES], zero, 0.0);
        sensors_vjp(
            system,
            &xs,
            &vs,
            &force,
            &bar,
            &mut bar_a,
            &mut acceleration,
            &mut bars_x[0],
            &mut bars_v[0],
        );
        add_into(&mut bar_x, &bars_x[0]);
        add_into(&mut bar_v, &bars_v[0]);
        counters.force_evaluations += 2 * sweeps.len() as u64;

        // The interval again, keeping every step's accelerations
        let count = |l: usize, kink: usize| sweeps.get(l).map_or(0, |s| s.tape.counts[kink] as usize);
        for (l, end) in ends.iter_mut().enumerate() {
            let steps: usize = (0..kinks).map(|k| count(l, interval * kinks + k)).sum();
            *end -= steps;
            counters.steps += steps as u64;
            counters.force_evaluations += 12 * steps as u64;
        }
        load_lanes(free, &state(interval), &mut xs, &mut vs);
        let mut begins = ends.clone();
        let mut tau = [0.0; LANES];
        let mut used = 0;
        for kink in interval * kinks..(interval + 1) * kinks {
            tau.fill(0.0);
            let longest = (0..LANES).map(|l| count(l, kink)).max().unwrap_or(0);
            for n in 0..longest {
                if steps.len() == used + n {
                    steps.push(Step {
                        x: system.zeros(),
                        v: system.zeros(),
                        a: std::array::from_fn(|_| system.zeros()),
                        h: zero,
                        tau: [0.0; LANES],
                        interval: 0,
                    });
                }
                let step = &mut steps[used + n];
                let size =
                    |l: usize| if n < count(l, kink) { sweeps[l].tape.steps[begins[l] + n] } else { 0.0 };
                let sizes: [f64; LANES] = std::array::from_fn(size);
                step.h = V::new(sizes);
                (step.tau, step.interval) = (tau, kink);
                step.x.copy_from_slice(&xs);
                step.v.copy_from_slice(&vs);
                let mut margin = zero;
                for i in 0..6 {
                    if i > 0 {
                        stage(i, step.h, &step.x, &step.v, &step.a, &mut xs, &mut vs);
                    }
                    forces_at(&mut force, kink, &tau, step.h, C[i]);
                    system.acceleration(&xs, &vs, &force, &mut step.a[i], &mut margin);
                }
                stage(6, step.h, &step.x, &step.v, &step.a, &mut xs, &mut vs);
                for l in 0..LANES {
                    tau[l] += sizes[l];
                }
            }
            used += longest;
            begins.iter_mut().enumerate().for_each(|(l, b)| *b += count(l, kink));
        }

        // Backwards
        for step in steps[..used].iter().rev() {
            let h = step.h;
            for i in (0..6).rev() {
                stage_vjp(i, h, (&bar_x, &bar_v), (&bars_x, &bars_v), &mut bar_a);
                if i > 0 {
                    stage(i, h, &step.x, &step.v, &step.a, &mut xs, &mut vs);
                } else {
                    xs.copy_from_slice(&step.x);
                    vs.copy_from_slice(&step.v);
                }
                forces_at(&mut force, step.interval, &step.tau, h, C[i]);
                let (to_x, to_v) = (&mut bars_x[i], &mut bars_v[i]);
                system.acceleration_vjp(&xs, &vs, &force, &bar_a, to_x, to_v, &mut acceleration);
            }
            step_vjp(h, &mut bar_x, &mut bar_v, (&bars_x, &bars_v));
        }
    }
    counters
}

/// Transpose of the sensors' readings at a state: overwrites `to_x` and `to_v`.
#[inline(always)]
pub fn sensors_vjp<V: Vector>(
    system: &mut System<'_, V>,
    x: &[Unit<V>],
    v: &[Unit<V>],
    force: &[V],
    bar: &[V],
    bar_a: &mut [Unit<V>],
    a: &mut [Unit<V>],
    to_x: &mut [Unit<V>],
    to_v: &mut [Unit<V>],
) {
    let zero = [V::splat(0.0); 3];
    let mut margin = zero[0];
    if system.scene.frame == super::Frame::Body {
        system.acceleration(x, v, force, a, &mut margin);
    }
    let (mut direct_x, mut direct_v) = (system.zeros(), system.zeros());
    bar_a.fill(zero);
    system.read_vjp(x, a, bar, &mut direct_x, &mut direct_v, bar_a);
    system.acceleration_vjp(x, v, force, bar_a, to_x, to_v, a);
    add_into(to_x, &direct_x);
    add_into(to_v, &direct_v);
}
