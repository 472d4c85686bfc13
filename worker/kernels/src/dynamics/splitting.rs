//! Splitting schemes with equal steps for second-order systems, and their discrete adjoints.
//!
//! ```text
//! drift a:  x += (1 − e)/γ v,  v *= e,  e = exp(−γ a h),  γ = C/M,  t += a h      (ẋ = v, v̇ = −γ v, exact)
//! kick  b:  v += b h G,  G = M⁻¹(−∂U(x) + f(t))
//! ```
//! Kicks and drifts alternate, starting and ending with a kick. Consecutive steps share that force, and sensors use it. Damping
//! is part of the drift: G then depends on x and t only and drifts are linear in v, as the Runge–Kutta–Nyström order conditions
//! require (S. Blanes, P. C. Moan, J. Comput. Appl. Math. 142 (2002) 313–330). The reverse sweep recomputes states backwards
//! from the next checkpoint, with the forces that the evaluations of second derivatives also return.

use super::balance::Balance;
use super::choose::fastest_decay;
use super::jobs::{Backward, SampleJob};
use super::ligaments::Place;
use super::loads::LockstepForces;
use super::model::{Model, ModelCotangent};
use super::readings::{load_lanes, read_lane, store_lane};
use super::schemes::{Drift, Scheme};
use super::system::{System, Unit, add_into};
use super::{Forces, Outcome, Scene, SimulationCounts};
use crate::Heartbeat;
use crate::lanes::{MOST, Scalar, Vector};

/// Intervals between checks of the energy balance. Created energy stays in the system, so rare checks suffice; the energy costs
/// as much as a force.
const CHECK_EVERY: usize = 8;

/// Number of checkpoints per interval, chosen so that damping amplifies rounding by at most about e⁶ in the reverse sweep.
pub fn segments(scene: &Scene, model: &Model, substeps: usize) -> usize {
    let delta = scene.duration / scene.instants as f64;
    ((fastest_decay(model) * delta / 6.0).ceil() as usize).clamp(1, substeps)
}

/// Step at which segment `k` of `segments` ends.
fn segment_end(k: usize, segments: usize, substeps: usize) -> usize {
    (k + 1) * substeps / segments
}

/// Coefficients of a scheme for one model and step size.
struct StepCoefficients<S> {
    kicks: Vec<f64>,
    /// For each drift, one entry per unit and coordinate.
    drifts: Vec<Vec<[Drift<S>; 3]>>,
    /// ½ (1 − e²) m and ½ (1 − e²) J, for each drift and unit: kinetic energy lost in the drift per squared velocity.
    losses: Vec<Vec<[S; 2]>>,
    /// Time of each force evaluation (after each drift) as a fraction of the step.
    clock: Vec<f64>,
    gamma: Vec<[S; 3]>,
}

impl<S: Scalar> StepCoefficients<S> {
    fn new(scheme: &Scheme, model: &Model, h: f64) -> Self {
        let gamma: Vec<[f64; 3]> =
            model.inverse_mass.iter().map(|m| std::array::from_fn(|d| m[d] * model.damping[d])).collect();
        let drift = |a: &f64| gamma.iter().map(|g| g.map(|g| Drift::new(g, a * h).rounded())).collect();
        let loss = |a: &f64| {
            let of = |(m, g): (&[f64; 3], &[f64; 3])| {
                [0, 2].map(|d| {
                    let part = -0.5 * (-2.0 * g[d] * a * h).exp_m1();
                    S::from_f64(if m[d] > 0.0 { part / m[d] } else { 0.0 })
                })
            };
            let mut losses: Vec<[S; 2]> = model.inverse_mass.iter().zip(&gamma).map(of).collect();
            // the damping of a driven unit takes no energy from the body
            model.driven.iter().for_each(|u| losses[*u] = [S::from_f64(0.0); 2]);
            losses
        };
        let clock = scheme.drifts.iter().scan(0.0, |t, a| {
            *t += a;
            Some(*t)
        });
        Self {
            kicks: scheme.kicks.iter().map(|b| b * h).collect(),
            drifts: scheme.drifts.iter().map(drift).collect(),
            clock: clock.collect(),
            losses: scheme.drifts.iter().map(loss).collect(),
            gamma: gamma.iter().map(|g| g.map(S::from_f64)).collect(),
        }
    }
}

/// Common data of both directions.
struct SweepData<'a, V: Vector> {
    ready: StepCoefficients<V::Scalar>,
    stages: usize,
    /// Kicks at the start and end of a step.
    first: f64,
    last: f64,
    loads: LockstepForces<'a, V>,
    force: Vec<V>,
}

impl<'a, V: Vector> SweepData<'a, V> {
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
        let coefficients = StepCoefficients::new(scheme, system.model, h);
        let stages = scheme.stages();
        Self {
            stages,
            first: coefficients.kicks[0],
            last: coefficients.kicks[stages],
            ready: coefficients,
            loads: LockstepForces::new(scene, forces, histories, substeps),
            force: vec![V::splat(0.0); forces.panels],
        }
    }
}

/// When the samples of a vector start to move.
struct Onsets {
    /// Interval of each lane; T in lanes without a sample.
    lanes: [usize; MOST],
    /// Earliest of these intervals.
    first: usize,
}

impl Onsets {
    /// From the forces of the samples; interval 0 for all with `at_once`.
    fn new(scene: &Scene, model: &Model, forces: &Forces, histories: &[&[f64]], at_once: bool) -> Self {
        let mut lanes = [scene.instants; MOST];
        let at_once = at_once || model.touches();
        for (lane, history) in lanes.iter_mut().zip(histories) {
            *lane = if at_once { 0 } else { forces.onset(scene, history) };
        }
        Self { lanes, first: lanes.into_iter().min().unwrap_or(scene.instants) }
    }

    /// 1 in lanes that move in an interval. The others (0) stay at rest despite rounding of forces.
    #[inline(always)]
    fn awake<V: Vector>(&self, interval: usize) -> V {
        V::gather(&self.lanes.map(|begin| f64::from(u8::from(begin <= interval))))
    }
}

impl<V: Vector> System<'_, V> {
    /// v += b G, G = −M⁻¹ g.
    #[inline(always)]
    fn kick(&self, b: V::Wide, g: &[Unit<V>], v: &mut [Place<V>]) {
        let moving = self.model.moving_range();
        let of_moving = v[moving.clone()].iter_mut().zip(&g[moving.clone()]).zip(&self.inverse_mass[moving]);
        for ((v, g), inverse) in of_moving {
            for d in 0..3 {
                v[d] = b.mul_sub_from((V::from_scalar(inverse[d]) * g[d]).widen(), v[d]);
            }
        }
    }

    /// A kick, a drift, and the preparation of the next force evaluation, in one pass. Returns the energy lost in the drift.
    #[inline(always)]
    fn advance(
        &mut self,
        b: V::Wide,
        drifts: &[[Drift<V::Scalar>; 3]],
        losses: &[[V::Scalar; 2]],
        x: &mut [Place<V>],
        v: &mut [Place<V>],
        g: &mut [Unit<V>],
    ) -> V {
        let moving = self.model.moving_range();
        let n = moving.len();
        let (x, v, g) =
            (&mut x[moving.clone()][..n], &mut v[moving.clone()][..n], &mut g[moving.clone()][..n]);
        let (drifts, turn) = (&drifts[moving.clone()][..n], &mut self.turn[moving.clone()][..n]);
        let losses = &losses[moving.clone()][..n];
        let mut lost = [V::ZERO; 2];
        let inverse = &self.inverse_mass[moving][..n];
        for u in 0..n {
            let mut squares = [V::ZERO; 3];
            for d in 0..3 {
                let kicked = b.mul_sub_from((V::from_scalar(inverse[u][d]) * g[u][d]).widen(), v[u][d]);
                x[u][d] = V::Wide::from_scalar(drifts[u][d].reach).mul_add(kicked, x[u][d]);
                v[u][d] = V::Wide::from_scalar(drifts[u][d].keep) * kicked;
                g[u][d] = V::ZERO;
                let kicked = V::narrow(kicked);
                squares[d] = kicked * kicked;
            }
            lost[0] = V::from_scalar(losses[u][0]).mul_add(squares[0] + squares[1], lost[0]);
            lost[1] = V::from_scalar(losses[u][1]).mul_add(squares[2], lost[1]);
            turn[u].set(x[u][2]);
        }
        lost[0] + lost[1]
    }
}

/// Integrates samples, at most one per lane, with `substeps` steps per interval and a checkpoint after each of `parts` parts.
/// `system` must be undamped.
///
/// Starts at the first force of any sample; a lane stays at rest until its own first force.
#[inline(always)]
pub fn forward<V: Vector>(
    system: &mut System<'_, V>,
    scheme: &Scheme,
    substeps: usize,
    checkpoints_per_interval: usize,
    forces: &Forces,
    jobs: &mut [SampleJob<'_>],
    heartbeat: &Heartbeat,
) -> SimulationCounts {
    let scene = system.scene;
    let model = system.model;
    let free = &model.free;
    let width = 3 * scene.sensors.len();
    let instants = scene.instants;
    let histories: Vec<&[f64]> = jobs.iter().map(|s| forces.sample(s.index)).collect();
    jobs.iter().enumerate().for_each(|(lane, job)| system.set_strike(lane, forces, job.index));
    let begin = Onsets::new(scene, model, forces, &histories, false);
    let SweepData { ready, stages, first, last, mut loads, mut force } =
        SweepData::new(system, scheme, substeps, forces, histories);
    let (mut x, mut v, mut g, mut a) = (system.start(), system.places(), system.zeros(), system.zeros());
    let mut margin = V::splat(1.0);
    if begin.first == instants {
        return SimulationCounts::default();
    }

    loads.at(begin.first * substeps, 0.0, &mut force);
    system.prepare(&x, &mut g);
    let mut balance = Balance::new(system, &x, &force);
    system.add_forces(&x, &force, &mut g, &mut margin);
    for interval in begin.first..instants {
        heartbeat.beat();
        let awake: V::Wide = begin.awake(interval);
        let mut part = 0;
        let mut b = first;
        for step in 0..substeps {
            for j in 0..stages {
                let kick = awake * V::Wide::splat(b);
                let lost = system.advance(kick, &ready.drifts[j], &ready.losses[j], &mut x, &mut v, &mut g);
                loads.at(interval * substeps + step, ready.clock[j], &mut force);
                balance.add(system, &x, &force, lost);
                system.add_forces(&x, &force, &mut g, &mut margin);
                b = if j + 1 == stages { last + first } else { ready.kicks[j + 1] };
            }
            if step + 1 == segment_end(part, checkpoints_per_interval, substeps) {
                system.kick(awake * V::Wide::splat(last), &g, &mut v);
                b = first;
                for (l, job) in jobs.iter_mut().enumerate() {
                    if let Some(tape) = &mut job.tape {
                        let len = 6 * free.len();
                        let at = (interval * checkpoints_per_interval + part) * len;
                        store_lane(free, &x, &v, l, &mut tape.states[at..][..len]);
                    }
                }
                part += 1;
            }
        }
        // a = G − γ v at the instant
        for &u in &scene.sensors {
            for d in 0..3 {
                let pull = V::from_scalar(system.inverse_mass[u][d]) * g[u][d];
                a[u][d] = V::from_scalar(ready.gamma[u][d]).mul_sub_from(V::narrow(v[u][d]), -pull);
            }
        }
        let mut size = V::Wide::ZERO;
        for (x, v) in x.as_flattened().iter().zip(v.as_flattened()) {
            size = size + x.abs() + v.abs();
        }
        let is_looked_at = (interval + 1).is_multiple_of(CHECK_EVERY) || interval + 1 == instants;
        let excess = if is_looked_at { balance.excess(system.energy(&x), &v) } else { V::ZERO };
        for (l, job) in jobs.iter_mut().enumerate() {
            if *job.outcome != Outcome::Ok || interval < begin.lanes[l] {
                continue;
            }
            if margin.lane(l) < 0.0 {
                *job.outcome = Outcome::ForbiddenContact;
            } else if !size.lane(l).is_finite() || excess.lane(l).is_nan() {
                *job.outcome = Outcome::NonFinite;
            } else if excess.lane(l) > 0.0 {
                *job.outcome = Outcome::Unstable;
            } else {
                let base = scene.base_at(forces.sample(job.index), (interval + 1) * forces.kinks(scene));
                read_lane(scene, (&x, &v), &a, base, l, &mut job.signals[interval * width..][..width]);
            }
        }
        if jobs.iter().all(|s| *s.outcome != Outcome::Ok) {
            break;
        }
    }
    let lanes = jobs.len() as u64;
    let steps = ((instants - begin.first) * substeps) as u64;
    let force_evaluations = lanes * (1 + steps * stages as u64);
    SimulationCounts { force_evaluations, steps: lanes * steps, rejected: 0 }
}

/// Cotangents of the states and of the next force evaluation.
struct StateCotangents<V> {
    x: Vec<Unit<V>>,
    v: Vec<Unit<V>>,
    /// Cotangents of the forces.
    w: Vec<Unit<V>>,
}

impl<V: Vector> System<'_, V> {
    /// Reverses `advance` in one pass: undoes the kick b with the forces just evaluated, then the preceding drift; propagates
    /// the cotangents; and prepares the next evaluation, for the kick `next`.
    #[inline(always)]
    fn retreat(
        &mut self,
        b: V::Wide,
        drifts: &[[Drift<V::Scalar>; 3]],
        gamma: &[[V::Scalar; 3]],
        next: V,
        x: &mut [Place<V>],
        v: &mut [Place<V>],
        g: &mut [Unit<V>],
        bars: &mut StateCotangents<V>,
    ) {
        let moving = self.model.moving_range();
        let n = moving.len();
        let (x, v, g) =
            (&mut x[moving.clone()][..n], &mut v[moving.clone()][..n], &mut g[moving.clone()][..n]);
        let StateCotangents { x: bar_x, v: bar_v, w } = bars;
        let (bar_x, bar_v, w) =
            (&bar_x[moving.clone()][..n], &mut bar_v[moving.clone()][..n], &mut w[moving.clone()][..n]);
        let (drifts, gamma) = (&drifts[moving.clone()][..n], &gamma[moving.clone()][..n]);
        let (turn, mass) =
            (&mut self.turn[moving.clone()][..n], &mut self.cotangent.mass[moving.clone()][..n]);
        let inverse = &self.inverse_mass[moving][..n];
        let mut damping = self.cotangent.damping;
        for u in 0..n {
            for d in 0..3 {
                let (drift, inverse) = (&drifts[u][d], inverse[u][d]);
                let pull = V::from_scalar(inverse) * g[u][d];
                let before = V::Wide::from_scalar(drift.restore) * b.mul_add(pull.widen(), v[u][d]);
                x[u][d] = V::Wide::from_scalar(drift.reach).mul_sub_from(before, x[u][d]);
                v[u][d] = before;
                g[u][d] = V::ZERO;
                let (to_x, to_v) = (bar_x[u][d], bar_v[u][d]);
                let slope =
                    V::from_scalar(drift.reach_slope).mul_add(to_x, V::from_scalar(drift.keep_slope) * to_v);
                // cotangent of γ = C/m
                let rate = V::from_scalar(inverse) * (slope * V::narrow(before));
                damping[d] = damping[d] + rate;
                mass[u][d] =
                    V::from_scalar(gamma[u][d]).mul_sub_from(rate, w[u][d].mul_add(pull, mass[u][d]));
                bar_v[u][d] = V::splat(drift.reach).mul_add(to_x, V::splat(drift.keep) * to_v);
                w[u][d] = V::from_scalar(inverse) * (next * bar_v[u][d]);
            }
            turn[u].set(x[u][2]);
        }
        self.cotangent.damping = damping;
    }
}

/// Reverse sweep of samples, at most one per lane. Adds to the cotangents of `system`, which must be undamped. With
/// `forces_asked`, returns the cotangents of the histories (samples, K, R+1).
#[inline(always)]
pub fn reverse<V: Vector>(
    system: &mut System<'_, V>,
    scheme: &Scheme,
    substeps: usize,
    checkpoints_per_interval: usize,
    forces: &Forces,
    sweeps: &[Backward<'_>],
    forces_asked: bool,
    heartbeat: &Heartbeat,
) -> (Vec<f64>, SimulationCounts) {
    let scene = system.scene;
    let model = system.model;
    let free = &model.free;
    let moving = model.moving_range();
    let width = 3 * scene.sensors.len();
    let instants = scene.instants;
    let zero = V::splat(0.0);
    let histories: Vec<&[f64]> = sweeps.iter().map(|s| s.history).collect();
    sweeps.iter().enumerate().for_each(|(lane, sweep)| system.set_strike(lane, forces, sweep.at));
    // a sample that moves from its first force on would move earlier under an earlier force
    let begin = Onsets::new(scene, model, forces, &histories, forces_asked);
    let SweepData { ready, stages, first, last, mut loads, mut force } =
        SweepData::new(system, scheme, substeps, forces, histories);
    if forces_asked {
        loads.request_cotangents();
    }
    let (mut x, mut v, mut g, mut a) = (system.start(), system.places(), system.zeros(), system.zeros());
    let mut bars = StateCotangents { x: system.zeros(), v: system.zeros(), w: system.zeros() };
    let mut bar_a = system.zeros();
    let mut bar = vec![zero; width];
    let mut margin = zero;
    let mut evaluations = 1;
    if begin.first == instants {
        return (Vec::new(), SimulationCounts::default());
    }

    for interval in (begin.first..instants).rev() {
        heartbeat.beat();
        let awake: V::Wide = begin.awake(interval);
        let mut step = substeps;
        for part in (0..checkpoints_per_interval).rev() {
            // the checkpoint: the state after the last kick of a step
            let len = 6 * free.len();
            let states = std::array::from_fn(|l| {
                sweeps
                    .get(l)
                    .map(|s| &s.tape.states[(interval * checkpoints_per_interval + part) * len..][..len])
            });
            load_lanes(free, model.start(), &states, &mut x, &mut v);
            loads.at(interval * substeps + step - 1, 1.0, &mut force);
            let instant = part + 1 == checkpoints_per_interval;
            let follows: V = match instant {
                true if interval + 1 == instants => zero,
                true => begin.awake::<V>(interval + 1) * V::splat(first),
                false => V::narrow(awake) * V::splat(first),
            };
            for (w, v) in bars.w.as_flattened_mut().iter_mut().zip(bars.v.as_flattened()) {
                *w = follows * *v;
            }
            if instant {
                for (k, b) in bar.iter_mut().enumerate() {
                    *b = zero;
                    for (l, sweep) in sweeps.iter().enumerate().filter(|(l, _)| begin.lanes[*l] <= interval) {
                        b.set_lane(l, sweep.cotangent[interval * width + k]);
                    }
                }
                if scene.reads_turns() {
                    system.acceleration(&x, &v, &force, &mut g, &mut margin);
                    evaluations += 1;
                    for u in 0..x.len() {
                        for d in 0..3 {
                            a[u][d] =
                                V::from_scalar(ready.gamma[u][d]).mul_sub_from(V::narrow(v[u][d]), g[u][d]);
                        }
                    }
                    system.add_base_acceleration(&force, &mut a);
                }
                bar_a.fill([zero; 3]);
                system.read_vjp(&x, &v, &a, &bar, &mut bars.x, &mut bars.v, &mut bar_a);
                loads.add_base_vjp(system, &bar_a);
                // a = G − γ v
                for u in moving.clone() {
                    for d in 0..3 {
                        let (bar_a, gamma) = (bar_a[u][d], V::from_scalar(ready.gamma[u][d]));
                        bars.w[u][d] = bars.w[u][d] + bar_a;
                        bars.v[u][d] = gamma.mul_sub_from(bar_a, bars.v[u][d]);
                        let rate = V::from_scalar(system.inverse_mass[u][d]) * (bar_a * V::narrow(v[u][d]));
                        let ModelCotangent { mass, damping, .. } = &mut system.cotangent;
                        mass[u][d] = gamma.mul_add(rate, mass[u][d]);
                        damping[d] = damping[d] - rate;
                    }
                }
            }
            let mut b = awake * V::Wide::splat(last);
            for u in moving.clone() {
                for d in 0..3 {
                    let kicked = V::narrow(b).mul_add(bars.v[u][d], bars.w[u][d]);
                    bars.w[u][d] = V::from_scalar(system.inverse_mass[u][d]) * kicked;
                }
            }
            system.prepare(&x, &mut g);
            system.add_forces_vjp(&x, &force, &bars.w, &mut g, &mut bars.x);
            loads.add_vjp(system, &bars.w);
            evaluations += 1;

            let begins =
                if part == 0 { 0 } else { segment_end(part - 1, checkpoints_per_interval, substeps) };
            while step > begins {
                step -= 1;
                for j in (0..stages).rev() {
                    let kick = if j == 0 { last + first } else { ready.kicks[j] };
                    let next = awake * V::Wide::splat(kick);
                    let (drifts, gamma) = (&ready.drifts[j], &ready.gamma);
                    system.retreat(b, drifts, gamma, V::narrow(next), &mut x, &mut v, &mut g, &mut bars);
                    // the first kick of a segment belongs to the preceding checkpoint
                    if j == 0 && step == begins {
                        continue;
                    }
                    b = next;
                    let clock = if j == 0 { 0.0 } else { ready.clock[j - 1] };
                    loads.at(interval * substeps + step, clock, &mut force);
                    system.add_forces_vjp(&x, &force, &bars.w, &mut g, &mut bars.x);
                    loads.add_vjp(system, &bars.w);
                    evaluations += 1;
                }
            }
        }
    }
    // the first kick, from rest
    x = system.start();
    loads.at(begin.first * substeps, 0.0, &mut force);
    let b = begin.awake::<V>(begin.first) * V::splat(first);
    for u in moving.clone() {
        for d in 0..3 {
            bars.w[u][d] = V::from_scalar(system.inverse_mass[u][d]) * (b * bars.v[u][d]);
        }
    }
    system.prepare(&x, &mut g);
    system.add_forces_vjp(&x, &force, &bars.w, &mut g, &mut bars.x);
    loads.add_vjp(system, &bars.w);
    for u in moving {
        for d in 0..3 {
            let pull = V::from_scalar(system.inverse_mass[u][d]) * g[u][d];
            let mass = &mut system.cotangent.mass[u][d];
            *mass = bars.w[u][d].mul_add(pull, *mass);
        }
    }
    add_into(&mut system.cotangent.start, &bars.x);
    let (lanes, steps) = (sweeps.len() as u64, ((instants - begin.first) * substeps) as u64);
    let (force_evaluations, steps) = (lanes * evaluations, lanes * steps);
    let counters = SimulationCounts { force_evaluations, steps, rejected: 0 };
    (loads.cotangent(), counters)
}
