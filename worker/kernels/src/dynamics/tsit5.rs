//! Tsitouras 5(4) with error control per sample, and its discrete adjoint.
//!
//! Ch. Tsitouras, Comput. Math. Appl. 62 (2011) 770–775. Because ẋ = v, a step only needs the accelerations A of the
//! stages:
//!
//! ```text
//! V_i = v + h Σ a_ij A_j,   X_i = x + c_i h v + h² Σ ā_ij A_j,   ā = a·a,   A_i = M⁻¹(−∂U(X_i) − C V_i + f)
//! ```
//! Each lane has its own clock and takes the next sample when one is done. Steps end exactly at every instant.

mod reverse;
mod stages;
mod steps;

use super::jobs::{SampleJob, SampleQueue, take};
use super::loads::FreeForces;
use super::readings::{read_lane, store_lane};
use super::system::{System, Unit};
use super::{Forces, Outcome, SimulationCounts, Tolerance};
use crate::Heartbeat;
use crate::lanes::{LANES, Vector};
pub use reverse::reverse;
pub use stages::{A, A2, C};
use stages::{finish_step, stage, total_error};
pub use steps::sizes;

/// Attempted steps after which a sample fails.
const STEP_LIMIT: u64 = 4_000_000;
/// Smallest step, as a fraction of an interval.
const LEAST_STEP: f64 = 1e-11;

/// State of a lane.
#[derive(Default)]
struct Lane<'s, 'a> {
    job: Option<&'s mut SampleJob<'a>>,
    interval: usize,
    /// Time since the start of the interval.
    tau: f64,
    /// Proposed step.
    proposed: f64,
    /// Current step: 1/`parts` of the time left in the interval.
    h: f64,
    parts: f64,
    count: u32,
    attempts: u64,
    last_error: f64,
}

/// Integrates the samples of `queue` until it is empty. Allocates scratch memory once.
#[inline(always)]
pub fn forward<V: Vector<Wide = V>>(
    mut system: System<'_, V>,
    forces: &Forces,
    tolerance: Tolerance,
    queue: &SampleQueue<'_, '_>,
    heartbeat: &Heartbeat,
) -> SimulationCounts {
    let scene = system.scene;
    // intervals of the forces; every `kinks`-th ends at an instant of the scene
    let (instants, kinks) = (forces.instants, forces.kinks(scene));
    let delta = scene.duration / instants as f64;
    let free = &system.model.free;
    let moving_units = system.model.moving_range();
    let width = 3 * scene.sensors.len();
    let scale = 1.0 / (6 * free.len().max(1)) as f64;
    let zero = V::splat(0.0);
    let one = V::splat(1.0);
    let (mut x, mut v, mut xs, mut vs) = (system.start(), system.zeros(), system.start(), system.zeros());
    let start = system.start();
    let mut a: [Vec<Unit<V>>; 7] = std::array::from_fn(|_| system.zeros());
    let mut force = vec![zero; scene.panels.len()];
    let mut loads = FreeForces::new(scene.panels.len());
    let mut counters = SimulationCounts::default();
    let mut lanes: [Lane<'_, '_>; LANES] = Default::default();
    let lanes = &mut lanes[..V::LANES];
    loop {
        // idle lanes take the next samples, at rest
        for (l, lane) in lanes.iter_mut().enumerate() {
            if lane.job.is_none() {
                copy_lane(&mut x, &start, l);
                v.as_flattened_mut().iter_mut().for_each(|v| v.set_lane(l, 0.0));
                lane.h = 0.0;
                if let Some(job) = take(queue, 1).first_mut() {
                    system.set_strike(l, forces, job.index);
                    // includes contact, which may act at rest
                    let history = forces.sample(job.index);
                    for (f, history) in force.iter_mut().zip(history.chunks(instants + 1)) {
                        *f = V::splat(history[0]);
                    }
                    xs.copy_from_slice(&start);
                    vs.fill([zero; 3]);
                    system.acceleration(&xs, &vs, &force, &mut a[1], &mut { one });
                    let [to, from, ..] = &mut a;
                    copy_lane(to, from, l);
                    counters.force_evaluations += 1;
                    let (job, proposed) = (Some(job), delta / 16.0);
                    *lane = Lane { job, proposed, last_error: 1.0, ..Lane::default() };
                }
            }
            if lane.job.is_some() {
                let time_left = delta - lane.tau;
                lane.parts = (time_left / lane.proposed * (1.0 - 1e-9)).ceil().max(1.0);
                lane.h = time_left / lane.parts;
            }
        }
        if lanes.iter().all(|l| l.job.is_none()) {
            return counters;
        }

        // six stages; the last is the acceleration of the new state
        let (mut h, mut tau, mut lands) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        for (l, lane) in lanes.iter().enumerate() {
            (h[l], tau[l], lands[l]) = (lane.h, lane.tau, f64::from(u8::from(lane.parts == 1.0)));
            match &lane.job {
                Some(job) => loads.load(l, forces, forces.sample(job.index), lane.interval),
                None => loads.clear(l),
            }
        }
        let (h, tau, lands) = (V::gather(&h), V::gather(&tau), V::gather(&lands));
        let (mut margin, mut square) = (one, zero);
        for i in 1..7 {
            if i < 6 {
                stage(i, h, &moving_units, (&x, &v), &a, (&mut xs, &mut vs));
            } else {
                square = finish_step(h, tolerance, &moving_units, (&x, &v), &mut a, (&mut xs, &mut vs));
            }
            let mut part = (tau + V::splat(C[i]) * h).over(V::splat(delta));
            if C[i] == 1.0 {
                part = one.where_less(zero, lands, part);
            }
            loads.at(part, &mut force);
            system.acceleration(&xs, &vs, &force, &mut a[i], &mut margin);
        }

        // error of each lane relative to the tolerance
        let square = total_error(square, &moving_units, &a);
        let mut accepted = [0.0; LANES];
        for l in 0..V::LANES {
            let lane = &mut lanes[l];
            let Some(job) = &mut lane.job else {
                accepted[l] = 1.0;
                continue;
            };
            let forbidden = margin.lane(l) < 0.0;
            let error = (square.lane(l) * scale).sqrt();
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
                    *job.outcome = outcome;
                    lane.job = None;
                }
            }
        }

        // accepted lanes advance, usually all
        if accepted[..V::LANES].iter().all(|a| *a == 1.0) {
            std::mem::swap(&mut x, &mut xs);
            std::mem::swap(&mut v, &mut vs);
            a.swap(0, 6);
        } else {
            let accept = V::gather(&accepted);
            let (first, end) = a.split_at_mut(6);
            for u in moving_units.clone() {
                for d in 0..3 {
                    x[u][d] = xs[u][d].where_less(zero, accept, x[u][d]);
                    v[u][d] = vs[u][d].where_less(zero, accept, v[u][d]);
                    first[0][u][d] = end[0][u][d].where_less(zero, accept, first[0][u][d]);
                }
            }
        }
        for l in 0..V::LANES {
            let lane = &mut lanes[l];
            let Some(job) = lane.job.as_mut().filter(|_| accepted[l] != 0.0) else { continue };
            lane.tau += lane.h;
            if let Some(tape) = &mut job.tape {
                steps::push(&mut tape.steps, lane.parts as u64);
            }
            if lane.parts > 1.0 {
                if lane.attempts >= STEP_LIMIT {
                    *job.outcome = Outcome::StepLimit;
                    lane.job = None;
                }
                continue;
            }
            if (lane.interval + 1).is_multiple_of(kinks) {
                let (n, len) = (lane.interval / kinks, 6 * free.len());
                let base = scene.base_at(forces.sample(job.index), lane.interval + 1);
                read_lane(scene, (&x, &v), &a[0], base, l, &mut job.signals[n * width..][..width]);
                if let Some(tape) = &mut job.tape {
                    store_lane(free, &x, &v, l, &mut tape.states[n * len..][..len]);
                }
            }
            if let Some(tape) = &mut job.tape {
                tape.counts.push(lane.count);
            }
            lane.tau = 0.0;
            lane.count = 0;
            lane.interval += 1;
            heartbeat.beat();
            if lane.interval == instants {
                if let Some(tape) = &mut job.tape {
                    tape.steps.shrink_to_fit();
                    tape.counts.shrink_to_fit();
                }
                *job.outcome = Outcome::Ok;
                lane.job = None;
            }
        }
    }
}

fn copy_lane<V: Vector>(to: &mut [Unit<V>], from: &[Unit<V>], lane: usize) {
    for (to, from) in to.as_flattened_mut().iter_mut().zip(from.as_flattened()) {
        to.set_lane(lane, from.lane(lane));
    }
}
