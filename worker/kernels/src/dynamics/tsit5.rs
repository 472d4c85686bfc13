//! Tsitouras 5(4) with error control a sample, and its discrete adjoint.
//!
//! Ch. Tsitouras, Comput. Math. Appl. 62 (2011) 770–775. As ẋ = v, a step needs the stages' accelerations A alone:
//!
//! ```text
//! V_i = v + h Σ a_ij A_j,   X_i = x + c_i h v + h² Σ ā_ij A_j,   ā = a·a,   A_i = M⁻¹(−∂U(X_i) − C V_i + f)
//! ```
//! Lanes step on their own clocks and take up the next sample when one is done. Every instant is hit exactly.

mod reverse;
mod stages;
mod steps;

use super::system::{System, Unit, read_lane, store_lane};
use super::{Counters, Forces, Outcome, SampleTape, Tolerance};
use crate::Heartbeat;
use crate::lanes::{LANES, Vector};
pub use reverse::reverse;
pub use stages::{A, A2, C};
use stages::{land, landed, stage};
use std::sync::{Mutex, PoisonError};
pub use steps::sizes;

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

/// Samples that nobody has taken up yet, in order.
pub type Queue<'s, 'a> = Mutex<&'s mut [Slot<'a>]>;

/// The next samples of a queue, up to `most`.
pub fn take<'s, 'a>(queue: &Queue<'s, 'a>, most: usize) -> &'s mut [Slot<'a>] {
    let mut queue = queue.lock().unwrap_or_else(PoisonError::into_inner);
    let all = std::mem::take(&mut *queue);
    let (taken, left) = all.split_at_mut(most.min(all.len()));
    *queue = left;
    taken
}

/// Where a lane is.
struct Lane<'s, 'a> {
    slot: Option<&'s mut Slot<'a>>,
    interval: usize,
    /// Time since the interval's beginning.
    tau: f64,
    /// Proposed step.
    proposed: f64,
    /// This step: one of so many equal ones that would end on the instant.
    h: f64,
    parts: f64,
    count: u32,
    attempts: u64,
    last_error: f64,
}

/// Integrates the samples of `queue`, until there is none left. Allocates its scratch once.
#[inline(always)]
pub fn forward<V: Vector>(
    mut system: System<'_, V>,
    forces: &Forces,
    tolerance: Tolerance,
    queue: &Queue<'_, '_>,
    heartbeat: &Heartbeat,
) -> Counters {
    let scene = system.scene;
    // Intervals of the forces, each `kinks`-th of which ends at an instant of the scene
    let (instants, kinks) = (forces.instants, forces.kinks(scene));
    let delta = scene.duration / instants as f64;
    let free = &system.model.free;
    let within = system.model.moving_range();
    let width = 3 * scene.sensors.len();
    let scale = 1.0 / (6 * free.len().max(1)) as f64;
    let zero = V::splat(0.0);
    let one = V::splat(1.0);
    let (mut x, mut v, mut xs, mut vs) = (system.zeros(), system.zeros(), system.zeros(), system.zeros());
    let mut a: [Vec<Unit<V>>; 7] = std::array::from_fn(|_| system.zeros());
    let mut force = vec![zero; scene.panels.len()];
    let mut reach = Reach::new(scene.panels.len());
    let mut counters = Counters::default();
    let mut lanes: [Lane<'_, '_>; LANES] = std::array::from_fn(|_| Lane {
        slot: None,
        interval: 0,
        tau: 0.0,
        proposed: 0.0,
        h: 0.0,
        parts: 0.0,
        count: 0,
        attempts: 0,
        last_error: 1.0,
    });
    let lanes = &mut lanes[..V::LANES];
    loop {
        // Idle lanes take up the next samples, at rest.
        for (l, lane) in lanes.iter_mut().enumerate() {
            if lane.slot.is_none() {
                clear_lane(&mut x, l);
                clear_lane(&mut v, l);
                lane.h = 0.0;
                if let Some(slot) = take(queue, 1).first_mut() {
                    // Not the push alone: contact may act at rest.
                    let history = forces.sample(slot.index);
                    for (f, history) in force.iter_mut().zip(history.chunks(instants + 1)) {
                        *f = V::splat(history[0]);
                    }
                    xs.fill([zero; 3]);
                    vs.fill([zero; 3]);
                    system.acceleration(&xs, &vs, &force, &mut a[1], &mut { one });
                    copy_lane(&mut a, l);
                    counters.force_evaluations += 1;
                    *lane = Lane {
                        slot: Some(slot),
                        proposed: delta / 16.0,
                        interval: 0,
                        tau: 0.0,
                        h: 0.0,
                        parts: 0.0,
                        count: 0,
                        attempts: 0,
                        last_error: 1.0,
                    };
                }
            }
            if lane.slot.is_some() {
                let left = delta - lane.tau;
                lane.parts = (left / lane.proposed * (1.0 - 1e-9)).ceil().max(1.0);
                lane.h = left / lane.parts;
            }
        }
        if lanes.iter().all(|l| l.slot.is_none()) {
            return counters;
        }

        // Six stages, the last of which is the new state's acceleration
        let (mut h, mut tau, mut lands) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        for (l, lane) in lanes.iter().enumerate() {
            (h[l], tau[l], lands[l]) = (lane.h, lane.tau, f64::from(u8::from(lane.parts == 1.0)));
            match &lane.slot {
                Some(slot) => reach.load(l, forces, forces.sample(slot.index), lane.interval),
                None => reach.clear(l),
            }
        }
        let (h, tau, lands) = (V::gather(&h), V::gather(&tau), V::gather(&lands));
        let (mut margin, mut square) = (one, zero);
        for i in 1..7 {
            if i < 6 {
                stage(i, h, &within, (&x, &v), &a, (&mut xs, &mut vs));
            } else {
                square = land(h, tolerance, &within, (&x, &v), &mut a, (&mut xs, &mut vs));
            }
            let mut part = (tau + V::splat(C[i]) * h).over(V::splat(delta));
            if C[i] == 1.0 {
                part = one.where_less(zero, lands, part);
            }
            reach.at(part, &mut force);
            system.acceleration(&xs, &vs, &force, &mut a[i], &mut margin);
        }

        // Error relative to the tolerance, a lane
        let square = landed(square, &within, &a);
        let mut accepted = [0.0; LANES];
        for l in 0..V::LANES {
            let lane = &mut lanes[l];
            let Some(slot) = &mut lane.slot else {
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
                    *slot.outcome = outcome;
                    lane.slot = None;
                }
            }
        }

        // Accepted lanes move on, most often all
        if accepted[..V::LANES].iter().all(|a| *a == 1.0) {
            std::mem::swap(&mut x, &mut xs);
            std::mem::swap(&mut v, &mut vs);
            a.swap(0, 6);
        } else {
            let accept = V::gather(&accepted);
            let (start, end) = a.split_at_mut(6);
            for u in within.clone() {
                for d in 0..3 {
                    x[u][d] = xs[u][d].where_less(zero, accept, x[u][d]);
                    v[u][d] = vs[u][d].where_less(zero, accept, v[u][d]);
                    start[0][u][d] = end[0][u][d].where_less(zero, accept, start[0][u][d]);
                }
            }
        }
        for l in 0..V::LANES {
            let lane = &mut lanes[l];
            let Some(slot) = lane.slot.as_mut().filter(|_| accepted[l] != 0.0) else { continue };
            lane.tau += lane.h;
            if let Some(tape) = &mut slot.tape {
                steps::push(&mut tape.steps, lane.parts as u64);
            }
            if lane.parts > 1.0 {
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
            heartbeat.beat();
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
        v.set_lane(lane, 0.0);
    }
}

/// A lane of the second stage's accelerations to the first's.
fn copy_lane<V: Vector>(a: &mut [Vec<Unit<V>>; 7], lane: usize) {
    let [to, from, ..] = a;
    for (to, from) in to.as_flattened_mut().iter_mut().zip(from.as_flattened()) {
        to.set_lane(lane, from.lane(lane));
    }
}

/// One sample's part in a reverse sweep.
#[derive(Clone, Copy)]
pub struct Sweep<'a> {
    /// Its number.
    pub at: usize,
    /// Its tape.
    pub tape: &'a SampleTape,
    /// Its forces.
    pub history: &'a [f64],
    /// (T, 3M).
    pub cotangent: &'a [f64],
}

/// Forces of lanes on clocks of their own, each in an interval of its own.
struct Reach {
    /// f_k at either end of the lane's interval.
    ends: Vec<[[f64; LANES]; 2]>,
}

impl Reach {
    fn new(panels: usize) -> Self {
        Self { ends: vec![[[0.0; LANES]; 2]; panels] }
    }

    /// A lane takes up an interval of a history.
    fn load(&mut self, lane: usize, forces: &Forces, history: &[f64], interval: usize) {
        for (k, [start, end]) in self.ends.iter_mut().enumerate() {
            let f = &history[k * (forces.instants + 1) + interval..][..2];
            (start[lane], end[lane]) = (f[0], f[1]);
        }
    }

    /// No forces on a lane.
    fn clear(&mut self, lane: usize) {
        for [start, end] in &mut self.ends {
            (start[lane], end[lane]) = (0.0, 0.0);
        }
    }

    /// Overwrites `force` by the forces at the fractions w of the intervals.
    #[inline(always)]
    fn at<V: Vector>(&self, w: V, force: &mut [V]) {
        for (f, [start, end]) in force.iter_mut().zip(&self.ends) {
            *f = (V::splat(1.0) - w) * V::gather(start) + w * V::gather(end);
        }
    }
}
