//! Derivative of one sample's signals along a direction in design, parameters and forces, to check its adjoint `vjp`.
//!
//! Uses plain dual numbers a + ε b, ε² = 0, without lanes. It shares coefficients of the methods, drift factors, equilibrium
//! and recorded steps with the production code. Geometry, forces and steps are implemented again, so equal signals also verify
//! these parts.

use super::model::driven_mass;
use super::schemes::Drift;
use super::{
    AccelerationFrame, AddedMass, Forces, Integrator, Mount, Parameters, Scene, Simulation, Tape,
    equilibrium, tsit5,
};
use crate::body::{End, FollowRule, Follower, Geometry, Layout, edges};
use std::ops::{Add, Div, Mul, Neg, Sub};

#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Dual(f64, f64);

/// Implements an operator for given operand types.
macro_rules! operator {
    ($operator:ident::$method:ident($left:ty, $right:ty) = |$a:ident, $b:ident| $result:expr) => {
        impl $operator<$right> for $left {
            type Output = Dual;
            fn $method(self, $b: $right) -> Dual {
                let $a = self;
                $result
            }
        }
    };
}
operator!(Add::add(Dual, Dual) = |a, b| Dual(a.0 + b.0, a.1 + b.1));
operator!(Sub::sub(Dual, Dual) = |a, b| Dual(a.0 - b.0, a.1 - b.1));
operator!(Mul::mul(Dual, Dual) = |a, b| Dual(a.0 * b.0, a.0 * b.1 + a.1 * b.0));
operator!(Mul::mul(f64, Dual) = |a, b| Dual(a * b.0, a * b.1));
operator!(
    Div::div(Dual, Dual) = |a, b| {
        let q = a.0 / b.0;
        Dual(q, (a.1 - q * b.1) / b.0)
    }
);

impl Neg for Dual {
    type Output = Self;
    fn neg(self) -> Self {
        Self(-self.0, -self.1)
    }
}

impl Dual {
    fn sin_cos(self) -> (Self, Self) {
        let (s, c) = self.0.sin_cos();
        (Self(s, c * self.1), Self(c, -s * self.1))
    }
    fn sqrt(self) -> Self {
        let r = self.0.sqrt();
        Self(r, 0.5 * self.1 / r)
    }
}

type Pair = [Dual; 2];
/// (u, v, θ) of every unit, or their rates.
type State = Vec<[Dual; 3]>;

fn plus(a: Pair, b: Pair) -> Pair {
    [a[0] + b[0], a[1] + b[1]]
}
fn minus(a: Pair, b: Pair) -> Pair {
    [a[0] - b[0], a[1] - b[1]]
}
fn dot(a: Pair, b: Pair) -> Dual {
    a[0] * b[0] + a[1] * b[1]
}
fn cross(a: Pair, b: Pair) -> Dual {
    a[0] * b[1] - a[1] * b[0]
}
/// The angle from a to b.
fn angle(a: Pair, b: Pair) -> Dual {
    let (y, x) = (cross(a, b), dot(a, b));
    Dual(y.0.atan2(x.0), (x.0 * y.1 - y.0 * x.1) / (x.0 * x.0 + y.0 * y.0))
}
fn scaled(s: f64, a: &State) -> State {
    a.iter().map(|a| a.map(|a| s * a)).collect()
}
fn add(to: &mut State, from: &State) {
    for (t, f) in to.as_flattened_mut().iter_mut().zip(from.as_flattened()) {
        *t = *t + *f;
    }
}

/// Position of a follower relative to the reference point of its unit.
fn followed(layout: &Layout, unit: usize, follower: &Follower, nodes: &[Pair]) -> Pair {
    let constant = |at: [f64; 2]| at.map(|x| Dual(x, 0.0));
    let centre = constant(layout.centres[unit]);
    let [p, a0, b0] = layout.bases(unit, follower).map(constant);
    let [a, b] = follower.of.map(|node| plus(centre, nodes[node]));
    let turned = |[x, y]: Pair| [-y, x];
    let middle = |a: Pair, b: Pair| plus(a, b).map(|x| 0.5 * x);
    let direction = |a: Pair, b: Pair| {
        let away = minus(b, a);
        away.map(|x| x / dot(away, away).sqrt())
    };
    let sum = |a: Pair, s: Dual, b: Pair, t: Dual| plus(a.map(|a| s * a), b.map(|b| t * b));
    let place = match follower.by {
        FollowRule::MeanX => [p[0] + middle(minus(a, a0), minus(b, b0))[0], p[1]],
        FollowRule::Segment => {
            let (t0, t, from) = (direction(a0, b0), direction(a, b), minus(p, middle(a0, b0)));
            plus(middle(a, b), sum(t, dot(from, t0), turned(t), dot(from, turned(t0))))
        }
        FollowRule::Angle => {
            let (sin, cos) = (0.5 * (angle(a0, a) + angle(b0, b))).sin_cos();
            sum(p, cos, turned(p), sin)
        }
    };
    minus(place, centre)
}

/// Direction of a derivative.
#[derive(Debug, Clone, Copy, Default)]
pub struct Tangent<'a> {
    /// Direction in the design; empty: zero.
    pub design: &'a [f64],
    /// Direction in the scene's parameters.
    pub parameters: Parameters,
    /// Direction in the sample's histories, (K, R+1); empty: zero.
    pub forces: &'a [f64],
}

/// A scene and design with their rates.
struct DualBody<'a> {
    scene: &'a Scene,
    arms: Vec<Pair>,
    /// (m, m, J).
    mass: State,
    /// k_l, k_s, k_θ, k_c.
    stiffness: [Dual; 4],
    /// C.
    damping: [Dual; 3],
    history: &'a [f64],
    /// Direction in the history.
    along: &'a [f64],
    forces: &'a Forces,
    tape: &'a Tape,
    sample: usize,
}

impl<'a> DualBody<'a> {
    fn new(tape: &'a Tape, sample: usize, tangent: Tangent<'a>) -> Self {
        let Tape { scene, design, forces, .. } = tape;
        let layout = &scene.layout;
        let (at, along) = (Parameters::of(scene).array(), tangent.parameters.array());
        let [stretch, shear, bend, ratio, density, contact] = std::array::from_fn(|k| Dual(at[k], along[k]));
        let (mut arms, mut mass) = (Vec::new(), Vec::new());
        let kept = scene.inertia.as_ref().map(|design| Geometry::new(layout, design, 1.0));
        for u in 0..layout.units() {
            let mut at = vec![[0.0; 2]; layout.shape[u].len()];
            layout.place(design, u, &mut at);
            let q = layout.groups.of_nodes[u].iter().zip(&at).map(|(group, at)| {
                let moves = |d: usize| group.map_or(0.0, |group| or_zero(tangent.design, 2 * group + d));
                [0, 1].map(|d| Dual(at[d], moves(d)))
            });
            let mut q: Vec<Pair> = q.collect();
            for follower in &layout.followers[u] {
                q[follower.node] = followed(layout, u, follower, &q);
            }
            let edges = edges(q.len());
            let doubled = edges.clone().fold(Dual::default(), |s, (p, n)| s + cross(q[p], q[n]));
            let first = edges.clone().fold([Dual::default(); 2], |s, (p, n)| {
                plus(s, plus(q[p], q[n]).map(|x| cross(q[p], q[n]) * x))
            });
            let r: Vec<Pair> = q.iter().map(|&q| minus(q, first.map(|x| x / (3.0 * doubled)))).collect();
            let polar = edges.fold(Dual::default(), |s, (p, n)| {
                s + cross(r[p], r[n]) * (dot(r[p], r[p]) + dot(r[p], r[n]) + dot(r[n], r[n]))
            });
            let m = 0.5 * density * doubled;
            arms.extend(r);
            let by = scene.parts.units.get(u).copied().unwrap_or(1.0);
            let own = match &kept {
                Some(kept) => [kept.mass[u], kept.mass[u], kept.moment[u]].map(|m| by * (m * density)),
                None => {
                    let by = by * layout.density[u];
                    [by * m, by * m, by / 12.0 * density * polar]
                }
            };
            let chip = AddedMass::mass_on_unit(scene, u);
            mass.push(match scene.is_driven(u) {
                true => driven_mass(scene).map(|m| Dual(m, 0.0)),
                false => [0, 1, 2].map(|d| own[d] + Dual(chip[d], 0.0)),
            });
        }
        let (area, round) = layout.mean_unit();
        let shift = 2.0 * ratio * (area * density * shear).sqrt();
        let turn = 2.0 * ratio * (area.powi(2) / 6.0 * round * density * bend).sqrt();
        let damping = scene.damping.map_or([shift, shift, turn], |given| given.map(|c| c * ratio));
        let (history, along) = (forces.sample(sample), tangent.forces);
        let stiffness = [stretch, shear, bend, contact];
        Self { scene, arms, mass, stiffness, damping, history, along, forces, tape, sample }
    }

    fn zero_state(&self) -> State {
        vec![[Dual::default(); 3]; self.mass.len()]
    }

    /// State at the start of the sample, with its derivative in design and parameters.
    fn start(&self) -> State {
        let Tape { scene, forces, .. } = self.tape;
        let mut x = self.zero_state();
        if scene.imposed.is_empty() {
            return x;
        }
        let model = self.tape.model();
        x.iter_mut().zip(model.start()).for_each(|(x, start)| *x = start.map(|start| Dual(start, 0.0)));
        let unforced = vec![0.0; forces.sample(self.sample).len()];
        let (arms, mass) = (self.arms.clone(), self.mass.clone());
        let still = DualBody { history: &unforced, along: &[], arms, mass, ..*self };
        let unforced_acceleration =
            still.acceleration(&x, &self.zero_state(), [Dual::default(); 3], (0, 0.0));
        // minus the derivative of the forces; the forces are zero, so the derivative of the masses has no effect
        let rate = |(a, m): (&[Dual; 3], &[Dual; 3])| std::array::from_fn(|d| -(m[d].0 * a[d].1));
        let rate: Vec<[f64; 3]> = unforced_acceleration.iter().zip(&self.mass).map(rate).collect();
        for (x, moved) in x.iter_mut().zip(equilibrium::follow(scene, &model, &rate)) {
            (0..3).for_each(|d| x[d].1 = moved[d]);
        }
        x
    }

    /// Sets the state at instant n to the tape's values, from which `vjp` starts: rounding, amplified in accelerations, would
    /// otherwise let both runs diverge.
    fn match_tape(&self, n: usize, x: &mut State, v: &mut State) {
        let (at, speed) = self.tape.state(self.sample, n);
        for (own, kept) in [(x, at), (v, speed)] {
            for (own, kept) in own.as_flattened_mut().iter_mut().zip(kept.as_flattened()) {
                own.0 = *kept;
            }
        }
    }

    /// f_k at the fraction w of an interval of the forces.
    fn force(&self, panel: usize, interval: usize, w: f64) -> Dual {
        let at = panel * (self.forces.instants + 1) + interval;
        let [start, end] = [at, at + 1].map(|at| Dual(self.history[at], or_zero(self.along, at)));
        start + w * (end - start)
    }

    /// M⁻¹(−∂U/∂s − C v + f), zero in held coordinates.
    fn acceleration(&self, x: &State, v: &State, damping: [Dual; 3], (interval, w): (usize, f64)) -> State {
        let Self { scene, arms, stiffness: [stretch, shearing, bending, touch], .. } = self;
        let (stretch, shearing, bending, touch) = (*stretch, *shearing, *bending, *touch);
        let layout = &scene.layout;
        let mut net: State = v.iter().map(|v| [0, 1, 2].map(|d| -(damping[d] * v[d]))).collect();
        for (k, panel) in scene.panels.iter().enumerate() {
            if let Some(drives) = panel.unit_acceleration() {
                for d in 0..2 {
                    let pull = self.mass[panel.unit][d] * (drives[d] * self.force(k, interval, w));
                    net[panel.unit][d] = net[panel.unit][d] + pull;
                }
                continue;
            }
            if let Some(shakes) = panel.base_acceleration() {
                for (net, mass) in net.iter_mut().zip(&self.mass) {
                    for d in 0..2 {
                        net[d] = net[d] - mass[d] * (shakes[d] * self.force(k, interval, w));
                    }
                }
                continue;
            }
            let strike = self.forces.strike(&scene.panels, self.sample, k);
            let lever = panel.node.map_or([Dual::default(); 2], |node| {
                self.arms[scene.layout.number(End { unit: panel.unit, node })]
            });
            let [x, y, moment] = strike.map(|s| Dual(s, 0.0));
            for (d, does) in [x, y, moment + cross(lever, [x, y])].into_iter().enumerate() {
                net[panel.unit][d] = net[panel.unit][d] + does * self.force(k, interval, w);
            }
        }
        for (index, ligament) in layout.ligaments.iter().enumerate() {
            let own = scene.parts.ligaments.get(index).copied().unwrap_or([1.0; 3]);
            let (stretch, shearing, bending) = (own[0] * stretch, own[1] * shearing, own[2] * bending);
            let (a, b) = (ligament.a.unit, ligament.b.unit);
            let (ra, rb) = (arms[layout.number(ligament.a)], arms[layout.number(ligament.b)]);
            let length = ligament.reference[0].hypot(ligament.reference[1]);
            let e = ligament.reference.map(|d| Dual(d / length, 0.0));
            let mean = 0.5 * (x[a][2] + x[b][2]);
            let bend = x[b][2] - x[a][2];
            // displacement of an end, and its derivative in θ
            let end = |x: [Dual; 3], r: Pair| -> (Pair, Pair) {
                let (s, c) = x[2].sin_cos();
                let at = [c * r[0] - s * r[1], s * r[0] + c * r[1]];
                (plus([x[0], x[1]], minus(at, r)), [-at[1], at[0]])
            };
            let ((ua, ta), (ub, tb)) = (end(x[a], ra), end(x[b], rb));
            let du = minus(ub, ua);
            // force on end b, and k_s l₀² γ
            let (pull, shear) = if scene.linearised {
                let slide = cross(e, du) - length * mean;
                let along = stretch * dot(du, e);
                let pull = plus(e.map(|e| along * e), [-e[1], e[0]].map(|n| shearing * (slide * n)));
                (pull, length * shearing * slide)
            } else {
                let d = plus(du, e.map(|e| length * e));
                let (s, c) = mean.sin_cos();
                let shear = length.powi(2) * shearing * angle([c * e[0] - s * e[1], s * e[0] + c * e[1]], d);
                let size = dot(d, d).sqrt();
                let along = stretch * (Dual(1.0, 0.0) - Dual(length, 0.0) / size);
                let across = shear / (size * size);
                (plus(d.map(|d| along * d), [-d[1], d[0]].map(|n| across * n)), shear)
            };
            let mut moment = bending * bend;
            if let Some(contact) = scene.contact {
                let edge = |from, to| minus(arms[layout.number(to)], arms[layout.number(from)]);
                let (next, previous) = (|e| edge(e, layout.next(e)), |e| edge(e, layout.previous(e)));
                let (i, j) = (ligament.a, ligament.b);
                for (void, sign) in [(angle(previous(j), next(i)), -1.0), (angle(previous(i), next(j)), 1.0)]
                {
                    let branch =
                        if void.0 < -std::f64::consts::FRAC_PI_2 { std::f64::consts::TAU } else { 0.0 };
                    let width = contact.cutoff_angle - contact.min_angle;
                    let psi = void + sign * bend + Dual(branch - contact.cutoff_angle, 0.0);
                    let z = (1.0 / width) * psi;
                    if z.0 > -1.0 && z.0 < 0.0 {
                        let rest = Dual(1.0, 0.0) - z * z;
                        moment = moment + sign * width * touch * (z / (rest * rest));
                    }
                }
            }
            for d in 0..2 {
                net[a][d] = net[a][d] + pull[d];
                net[b][d] = net[b][d] - pull[d];
            }
            net[a][2] = net[a][2] + dot(pull, ta) + 0.5 * shear + moment;
            net[b][2] = net[b][2] - dot(pull, tb) + 0.5 * shear - moment;
        }
        for (u, net) in net.iter_mut().enumerate() {
            for (net, m) in net.iter_mut().zip(self.mass[u]) {
                *net = *net / m;
            }
            let held = scene.holds(u);
            (0..3).filter(|d| held[*d]).for_each(|d| net[d] = Dual::default());
        }
        net
    }

    /// Appends the signals at an instant, counted from 1.
    fn read(&self, x: &State, v: &State, a: &State, instant: usize, signals: &mut Vec<Dual>) {
        let mut a = a.clone();
        for (k, panel) in self.scene.panels.iter().enumerate() {
            let Some(shakes) = panel.base_acceleration() else { continue };
            let force = self.force(k, instant * self.forces.kinks(self.scene) - 1, 1.0);
            for &u in &self.scene.sensors {
                (0..2).for_each(|d| a[u][d] = a[u][d] + shakes[d] * force);
            }
        }
        for &u in &self.scene.sensors {
            let (theta, omega, Mount { offset: r, tilt }) =
                (x[u][2], v[u][2], self.scene.mount.unwrap_or_default());
            // a + α×r − ω²r
            let (s, c) = theta.sin_cos();
            let [px, py] = [r[0] * c - r[1] * s, r[0] * s + r[1] * c];
            let at =
                [a[u][0] - a[u][2] * py - omega * omega * px, a[u][1] + a[u][2] * px - omega * omega * py];
            let (s, c) = match self.scene.frame {
                AccelerationFrame::World => Dual(tilt, 0.0).sin_cos(),
                AccelerationFrame::Body => (theta + Dual(tilt, 0.0)).sin_cos(),
            };
            signals.extend([c * at[0] + s * at[1], c * at[1] - s * at[0], omega]);
        }
    }
}

/// Entry of a direction; zero if the direction is empty.
fn or_zero(tangent: &[f64], at: usize) -> f64 {
    if tangent.is_empty() { 0.0 } else { tangent[at] }
}

impl Simulation {
    /// Signals (T, 3M) of one sample and their derivative along `tangent` at constant steps. Each interval starts from the
    /// tape's state.
    ///
    /// # Panics
    /// If the simulation has no tape, the sample failed, or lengths do not match.
    pub fn jvp(&self, sample: usize, tangent: Tangent<'_>) -> (Vec<f64>, Vec<f64>) {
        let tape = self.tape.as_ref().expect("the simulation kept its tape");
        for (along, of) in [(tangent.design, &tape.design[..]), (tangent.forces, tape.forces.sample(sample))]
        {
            let (len, own) = (along.len(), of.len());
            assert!([0, own].contains(&len), "length of the direction is {len}; must be 0 or {own}");
        }
        let body = DualBody::new(tape, sample, tangent);
        let own = &tape.samples[sample];
        let signals = match self.plan.method {
            Integrator::Tsit5 => {
                let delta = tape.scene.duration / tape.forces.instants as f64;
                adaptive(&body, &tsit5::sizes(&own.steps, &own.counts, delta), &own.counts)
            }
            method => equal(&body, method, self.plan.steps.count() * own.refined),
        };
        signals.into_iter().map(|s| (s.0, s.1)).unzip()
    }
}

fn equal(body: &DualBody<'_>, method: Integrator, substeps: usize) -> Vec<Dual> {
    let DualBody { scene, forces, .. } = body;
    let scheme = method.scheme().expect("a splitting scheme");
    let h = scene.duration / (scene.instants * substeps) as f64;
    let span = substeps / forces.kinks(scene);
    let gamma = |u: usize, d: usize| match scene.holds(u)[d] {
        true => Dual::default(),
        false => body.damping[d] / body.mass[u][d],
    };
    let (mut x, mut v, mut signals) = (body.start(), body.zero_state(), Vec::new());
    let mut g = body.acceleration(&x, &v, [Dual::default(); 3], (0, 0.0));
    for step in 0..scene.instants * substeps {
        add(&mut v, &scaled(scheme.kicks[0] * h, &g));
        let mut clock = 0.0;
        for (a, b) in scheme.drifts.iter().zip(&scheme.kicks[1..]) {
            for u in 0..x.len() {
                for d in 0..3 {
                    let gamma = gamma(u, d);
                    let drift = Drift::new(gamma.0, a * h);
                    let v = &mut v[u][d];
                    x[u][d] = x[u][d] + Dual(drift.reach, drift.reach_slope * gamma.1) * *v;
                    *v = Dual(drift.keep, drift.keep_slope * gamma.1) * *v;
                }
            }
            clock += a;
            let at = (step / span, ((step % span) as f64 + clock) / span as f64);
            g = body.acceleration(&x, &v, [Dual::default(); 3], at);
            add(&mut v, &scaled(b * h, &g));
        }
        if (step + 1).is_multiple_of(substeps) {
            let mut a = g.clone();
            for u in 0..a.len() {
                (0..3).for_each(|d| a[u][d] = a[u][d] - gamma(u, d) * v[u][d]);
            }
            body.read(&x, &v, &a, (step + 1) / substeps, &mut signals);
            body.match_tape((step + 1) / substeps, &mut x, &mut v);
        }
    }
    signals
}

fn adaptive(body: &DualBody<'_>, steps: &[f64], counts: &[u32]) -> Vec<Dual> {
    let (kinks, delta) = (body.forces.kinks(body.scene), body.scene.duration / counts.len() as f64);
    let (mut x, mut v, mut signals) = (body.start(), body.zero_state(), Vec::new());
    let mut a = vec![body.acceleration(&x, &v, body.damping, (0, 0.0))];
    let mut steps = steps.iter();
    for (interval, &count) in counts.iter().enumerate() {
        let mut tau = 0.0;
        for &h in steps.by_ref().take(count as usize) {
            for i in 1..7 {
                let mut xs = scaled(tsit5::C[i] * h, &v);
                let mut vs = v.clone();
                add(&mut xs, &x);
                for j in 0..i {
                    add(&mut vs, &scaled(h * tsit5::A[i][j], &a[j]));
                    add(&mut xs, &scaled(h * h * tsit5::A2[i][j], &a[j]));
                }
                let w = ((tau + tsit5::C[i] * h) / delta).min(1.0);
                a.push(body.acceleration(&xs, &vs, body.damping, (interval, w)));
                if i == 6 {
                    (x, v) = (xs, vs);
                }
            }
            a.drain(..6);
            tau += h;
        }
        if (interval + 1).is_multiple_of(kinks) {
            body.read(&x, &v, &a[0], (interval + 1) / kinks, &mut signals);
            body.match_tape((interval + 1) / kinks, &mut x, &mut v);
            a = vec![body.acceleration(&x, &v, body.damping, (interval, 1.0))];
        }
    }
    signals
}
