//! Reverse sweep of Tsit5: repeats each interval from its checkpoint, then sweeps its steps backwards.
//!
//! Every sample has its own steps, but the lanes of a vector run through an interval together, and an idle lane costs as much as
//! a busy one. Each interval therefore groups samples with similar numbers of steps.

use super::super::jobs::Backward;
use super::super::loads::FreeForces;
use super::super::readings::{load_lanes, store_lane};
use super::super::system::{System, Unit, add_into, damping_cotangent};
use super::super::{Forces, SimulationCounts};
use super::stages::{C, Stages, stage, stage_vjp, step_vjp};
use super::steps;
use crate::Heartbeat;
use crate::lanes::{LANES, MOST, Vector};

/// Stored data of one step.
struct Step<V> {
    /// Positions of the stages.
    x: Stages<V>,
    /// Velocity at the start.
    v: Vec<Unit<V>>,
    /// Accelerations of the stages.
    a: Stages<V>,
    h: V,
    /// Times of the stages' forces, as fractions of the intervals that start at `kinks`.
    parts: [V; 6],
    kinks: [usize; LANES],
}

/// Position of a lane in its steps.
#[derive(Clone, Copy, Default)]
struct Cursor {
    /// Index of the next step's code; steps left in the interval; steps left before the next kink.
    code: usize,
    left: usize,
    until: usize,
    /// Index of the kink in the forces.
    kink: usize,
    tau: f64,
}

/// Reverse sweep of samples. Adds to the cotangents of `system`. With `forces_asked`, returns the cotangents of the histories
/// (samples, K, R+1).
#[inline(always)]
pub fn reverse<V: Vector<Wide = V>>(
    system: &mut System<'_, V>,
    forces: &Forces,
    sweeps: &[Backward<'_>],
    forces_asked: bool,
    heartbeat: &Heartbeat,
) -> (Vec<f64>, SimulationCounts) {
    let scene = system.scene;
    let free = &system.model.free;
    let within = system.model.moving_range();
    let (instants, kinks) = (scene.instants, forces.kinks(scene));
    let (width, len) = (3 * scene.sensors.len(), 6 * free.len());
    let delta = scene.duration / forces.instants as f64;
    let (zero, one) = (V::splat(0.0), V::splat(1.0));
    let mut counters = SimulationCounts::default();
    let (mut bar_x, mut bar_v) = (system.zeros(), system.zeros());
    let (mut xs, mut vs) = (system.start(), system.zeros());
    let start = system.model.start();
    let (mut w, mut acceleration) = (system.zeros(), system.zeros());
    // −∂²U w and w of each stage
    let mut curved: Stages<V> = std::array::from_fn(|_| system.zeros());
    let mut weights: Stages<V> = std::array::from_fn(|_| system.zeros());
    let mut kept: Vec<Step<V>> = Vec::new();
    let mut loads = FreeForces::new(scene.panels.len());
    let mut force = vec![zero; scene.panels.len()];
    let mut bar = vec![zero; width];
    // for each sample: the cotangents of its state, and where the codes of the interval's steps end
    let mut bars = vec![vec![0.0; len]; sweeps.len()];
    let mut ends: Vec<usize> = sweeps.iter().map(|s| s.tape.steps.len()).collect();
    let mut order: Vec<usize> = (0..sweeps.len()).collect();
    let row = forces.instants + 1;
    let mut pushed = vec![0.0; if forces_asked { sweeps.len() * forces.panels * row } else { 0 }];

    for interval in (0..instants).rev() {
        heartbeat.beat();
        let count = |s: usize, kink: usize| sweeps[s].tape.counts[interval * kinks + kink] as usize;
        let total = |s: usize| (0..kinks).map(|kink| count(s, kink)).sum::<usize>();
        order.sort_by_key(|&s| (total(s), s));
        for lanes in order.chunks(V::LANES) {
            let state = |n: usize| -> [Option<&[f64]>; MOST] {
                std::array::from_fn(|l| {
                    let sweep = &sweeps[*lanes.get(l)?];
                    n.checked_sub(1).map(|n| &sweep.tape.states[n * len..][..len])
                })
            };
            let given = std::array::from_fn(|l| lanes.get(l).map(|&s| bars[s].as_slice()));
            load_lanes(free, &[], &given, &mut bar_x, &mut bar_v);

            // sensors at the end of the interval
            load_lanes(free, start, &state(interval + 1), &mut xs, &mut vs);
            for (k, b) in bar.iter_mut().enumerate() {
                let at = |l: usize| lanes.get(l).map_or(0.0, |&s| sweeps[s].cotangent[interval * width + k]);
                *b = V::gather(&std::array::from_fn::<f64, LANES, _>(at));
            }
            let last = (interval + 1) * kinks - 1;
            for l in 0..V::LANES {
                match lanes.get(l) {
                    Some(&s) => {
                        system.set_strike(l, forces, sweeps[s].at);
                        loads.load(l, forces, sweeps[s].history, last);
                    }
                    None => loads.clear(l),
                }
            }
            loads.at(one, &mut force);
            let to = (&mut *curved[0], &mut *weights[0]);
            sensors_vjp(system, (&xs, &vs), &force, &bar, &mut w, &mut acceleration, to);
            add_into(&mut bar_x, &curved[0]);
            add_into(&mut bar_v, &weights[0]);
            if forces_asked {
                push_vjp(system, &system.w, one, &[last; LANES], lanes, (row, &mut pushed));
                for k in 0..forces.panels {
                    let Some(felt) = system.base_force_vjp(k, &w) else { continue };
                    for (l, &s) in lanes.iter().enumerate() {
                        pushed[(s * forces.panels + k) * row + last + 1] += felt.lane(l);
                    }
                }
            }

            // repeat the interval, storing the stages of every step
            let mut places = [Cursor::default(); LANES];
            for (place, &s) in places.iter_mut().zip(lanes) {
                let left = total(s);
                ends[s] = steps::back(&sweeps[s].tape.steps, ends[s], left);
                *place = Cursor { code: ends[s], left, until: count(s, 0), kink: interval * kinks, tau: 0.0 };
                counters.steps += left as u64;
                counters.force_evaluations += 2 + 12 * left as u64;
            }
            let longest = places.iter().map(|p| p.left).max().unwrap_or(0);
            load_lanes(free, start, &state(interval), &mut xs, &mut vs);
            for n in 0..longest {
                if kept.len() == n {
                    let (x, v) = (std::array::from_fn(|_| system.start()), system.zeros());
                    let a = std::array::from_fn(|_| system.zeros());
                    kept.push(Step { x, v, a, h: zero, parts: [zero; 6], kinks: [0; LANES] });
                }
                let step = &mut kept[n];
                let (mut sizes, mut tau) = ([0.0; LANES], [0.0; LANES]);
                for (l, &s) in lanes.iter().enumerate() {
                    let place = &mut places[l];
                    if place.left == 0 {
                        continue;
                    }
                    while place.until == 0 {
                        (place.kink, place.tau) = (place.kink + 1, 0.0);
                        place.until = sweeps[s].tape.counts[place.kink] as usize;
                    }
                    let parts = steps::next(&sweeps[s].tape.steps, &mut place.code);
                    (sizes[l], tau[l]) = ((delta - place.tau) / parts as f64, place.tau);
                    loads.load(l, forces, sweeps[s].history, place.kink);
                    step.kinks[l] = place.kink;
                }
                step.h = V::gather(&sizes);
                let tau = V::gather(&tau);
                step.x[0].copy_from_slice(&xs);
                step.v.copy_from_slice(&vs);
                for i in 0..6 {
                    if i > 0 {
                        let (before, at) = step.x.split_at_mut(i);
                        stage(i, step.h, &within, (&before[0], &step.v), &step.a, (&mut at[0], &mut vs));
                    }
                    let part = (tau + V::splat(C[i]) * step.h).over(V::splat(delta));
                    step.parts[i] = -(-part).max(-one);
                    loads.at(step.parts[i], &mut force);
                    system.acceleration(&step.x[i], &vs, &force, &mut step.a[i], &mut { zero });
                }
                stage(6, step.h, &within, (&step.x[0], &step.v), &step.a, (&mut xs, &mut vs));
                for (place, size) in places.iter_mut().zip(sizes).filter(|(p, _)| p.left > 0) {
                    place.tau += size;
                    (place.left, place.until) = (place.left - 1, place.until - 1);
                }
            }

            // sweep backwards
            for step in kept[..longest].iter().rev() {
                for (l, &s) in lanes.iter().enumerate().filter(|_| system.forces_follow_design()) {
                    loads.load(l, forces, sweeps[s].history, step.kinks[l]);
                }
                for i in (0..6).rev() {
                    let (bar, later) = ((&bar_x[..], &bar_v[..]), (&curved, &weights));
                    let by = system.force_cotangent();
                    stage_vjp(i, step.h, &within, bar, later, by, &step.a[i], &mut w);
                    std::mem::swap(&mut w, &mut weights[i]);
                    system.product(&step.x[i], &weights[i], &mut curved[i]);
                    if system.forces_follow_design() {
                        loads.at(step.parts[i], &mut force);
                        system.push_vjp(&force, &weights[i]);
                    }
                    if forces_asked {
                        let (w, part) = (&weights[i], step.parts[i]);
                        push_vjp(system, w, part, &step.kinks, lanes, (row, &mut pushed));
                    }
                    if system.damping_asked {
                        if i == 0 {
                            vs.copy_from_slice(&step.v);
                        } else {
                            stage(i, step.h, &within, (&step.x[0], &step.v), &step.a, (&mut xs, &mut vs));
                        }
                        damping_cotangent(&mut system.cotangent.damping, &weights[i], &vs);
                    }
                }
                step_vjp(step.h, &within, (&mut bar_x, &mut bar_v), (&curved, &weights), system.damping);
            }
            for (l, &s) in lanes.iter().enumerate() {
                store_lane(free, &bar_x, &bar_v, l, &mut bars[s]);
            }
        }
    }
    for (i, &u) in free.iter().enumerate() {
        for d in 0..3 {
            system.cotangent.start[u][d].set_lane(0, bars.iter().map(|bar| bar[6 * i + d]).sum());
        }
    }
    (pushed, counters)
}

/// Adds the cotangents of the histories (samples, K, R+1) for the samples in `lanes`. The forces act at `part` of the interval
/// that starts at the lane's kink; `w` is the cotangent of the units' forces.
#[inline(always)]
fn push_vjp<V: Vector<Wide = V>>(
    system: &System<'_, V>,
    w: &[Unit<V>],
    part: V,
    kinks: &[usize; LANES],
    lanes: &[usize],
    (row, pushed): (usize, &mut [f64]),
) {
    let panels = system.scene.panels.len();
    for k in 0..panels {
        let bar = system.along_all(k, w);
        let late = part * bar;
        let early = bar - late;
        for (l, &s) in lanes.iter().enumerate() {
            let at = (s * panels + k) * row + kinks[l];
            pushed[at] += early.lane(l);
            pushed[at + 1] += late.lane(l);
        }
    }
}

/// Adjoint of the signals at a state: overwrites `to_x` and `to_v`.
#[inline(always)]
fn sensors_vjp<V: Vector<Wide = V>>(
    system: &mut System<'_, V>,
    (x, v): (&[Unit<V>], &[Unit<V>]),
    force: &[V],
    bar: &[V],
    bar_a: &mut [Unit<V>],
    a: &mut [Unit<V>],
    (to_x, to_v): (&mut [Unit<V>], &mut [Unit<V>]),
) {
    let zero = [V::splat(0.0); 3];
    if system.scene.reads_turns() {
        system.acceleration(x, v, force, a, &mut { zero[0] });
        system.add_base_acceleration(force, a);
    }
    let (mut direct_x, mut direct_v) = (system.zeros(), system.zeros());
    bar_a.fill(zero);
    system.read_vjp(x, v, a, bar, &mut direct_x, &mut direct_v, bar_a);
    system.acceleration_vjp(x, v, force, bar_a, to_x, to_v, a);
    add_into(to_x, &direct_x);
    add_into(to_v, &direct_v);
}
