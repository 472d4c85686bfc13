//! An implicit method for scenes whose stiff modes need not be followed, and its discrete adjoint.
//!
//! ```text
//! X_i = x + c_i h v + h² Σ_j≤i ā_ij A_j,  V_i = v + h Σ_j≤i a_ij A_j,  M A_i = −∂U(X_i) − C V_i + f,  ā = a·a
//! ```
//! Hairer and Wanner's SDIRK of order 4 (Solving Ordinary Differential Equations II, table IV.6.5): five stages of one
//! γ, L-stable, the last stage the new state, whose A the sensors read. Each A_i by Newton's method with
//! S = M + γh C + γ²h² ∂²U, a band matrix factored as L D Lᵀ in lanes and kept while a lane converges in few iterations.
//! What an L-stable method forgets cannot be run backwards: the reverse sweep repeats each interval from its checkpoint.

use super::balance::Balance;
use super::system::{Ramp, System, Unit, add_into, load_lanes, read_lane, store_lane};
use super::tsit5::{Slot, Sweep};
use super::vector::Vector;
use super::{Counters, Forces, Outcome};

/// Newton solves a step.
pub const STAGES: usize = 5;
/// γ, on the diagonal of every stage.
pub const GAMMA: f64 = 0.25;
/// a_ij.
pub const A: [[f64; STAGES]; STAGES] = [
    [GAMMA, 0.0, 0.0, 0.0, 0.0],
    [0.5, GAMMA, 0.0, 0.0, 0.0],
    [17.0 / 50.0, -1.0 / 25.0, GAMMA, 0.0, 0.0],
    [371.0 / 1360.0, -137.0 / 2720.0, 15.0 / 544.0, GAMMA, 0.0],
    [25.0 / 24.0, -49.0 / 48.0, 125.0 / 16.0, -85.0 / 12.0, GAMMA],
];
/// Clock of the stages.
pub const C: [f64; STAGES] = [0.25, 0.75, 0.55, 0.5, 1.0];
/// ā = a·a.
pub const A2: [[f64; STAGES]; STAGES] = {
    let mut s = [[0.0; STAGES]; STAGES];
    let mut at = 0;
    while at < STAGES * STAGES * STAGES {
        let (i, j, m) = (at / (STAGES * STAGES), at / STAGES % STAGES, at % STAGES);
        s[i][j] += A[i][m] * A[m][j];
        at += 1;
    }
    s
};
/// Relative change of A that ends Newton's iterations, or `ROUNDED` once changes no longer fall: stiff forces are
/// differences of large numbers.
const CONVERGED: f64 = 1e-12;
const ROUNDED: f64 = 1e-7;
const ITERATIONS: usize = 30;
/// Iterations from which a factorisation no longer serves.
const STALE: usize = 5;
/// Iteration before which it is renewed at once.
const RENEWED: usize = 10;

/// A symmetric band matrix in lanes, over the free degrees of freedom, and its L D Lᵀ.
struct Band<V> {
    /// Place of each degree of freedom (3·unit + d), or none where clamped.
    place: Vec<Option<usize>>,
    size: usize,
    width: usize,
    /// Entry (i, i − k) at i·(width + 1) + k; once factored, 1/D and L.
    entries: Vec<V>,
}

impl<V: Vector> Band<V> {
    #[inline(always)]
    fn new(system: &System<'_, V>) -> Self {
        let model = system.model;
        let mut place = vec![None; 3 * model.units()];
        for (i, &u) in model.free.iter().enumerate() {
            (0..3).for_each(|d| place[3 * u + d] = Some(3 * i + d));
        }
        let reach = |bar: &super::model::Bar| match (place[3 * bar.a], place[3 * bar.b]) {
            (Some(a), Some(b)) => a.abs_diff(b),
            _ => 0,
        };
        let width = model.bars.iter().map(reach).max().unwrap_or(0) + 2;
        let size = 3 * model.free.len();
        Self { place, size, width, entries: vec![V::splat(0.0); size * (width + 1)] }
    }

    /// Becomes M + γh C + γ²h² ∂²U(x), factored, in the lanes where `mask` > 0.
    #[inline(always)]
    fn factor(&mut self, system: &mut System<'_, V>, x: &[Unit<V>], h: f64, scratch: &mut Vec<V>, mask: V) {
        let (zero, stride) = (V::splat(0.0), self.width + 1);
        scratch.clear();
        scratch.resize(self.entries.len(), zero);
        let model = system.model;
        for (dof, place) in self.place.iter().enumerate() {
            if let Some(i) = place {
                let mass = 1.0 / model.inverse_mass[dof / 3][dof % 3];
                scratch[i * stride] = V::splat(mass + GAMMA * h * model.damping[dof % 3]);
            }
        }
        system.hessian(x, (GAMMA * h).powi(2), &self.place, stride, scratch);
        for i in 0..self.size {
            let reach = self.width.min(i);
            for k in (1..=reach).rev() {
                let j = i - k;
                let mut sum = scratch[i * stride + k];
                // L_jp of those p that row i reaches, times L_ip D_p, which stands there until the row is done
                for m in 1..=(reach - k).min(self.width) {
                    sum = scratch[i * stride + k + m].mul_sub_from(scratch[j * stride + m], sum);
                }
                scratch[i * stride + k] = sum;
            }
            let mut pivot = scratch[i * stride];
            for k in 1..=reach {
                let full = scratch[i * stride + k];
                let l = full * scratch[(i - k) * stride];
                pivot = full.mul_sub_from(l, pivot);
                scratch[i * stride + k] = l;
            }
            scratch[i * stride] = V::splat(1.0).over(pivot);
        }
        for (kept, new) in self.entries.iter_mut().zip(scratch.iter()) {
            *kept = new.where_less(zero, mask, *kept);
        }
    }

    /// b ← S⁻¹ b, zero where clamped.
    #[inline(always)]
    fn solve(&self, b: &mut [Unit<V>], scratch: &mut Vec<V>) {
        let stride = self.width + 1;
        scratch.clear();
        scratch.resize(self.size, V::splat(0.0));
        for (dof, b) in b.as_flattened().iter().enumerate() {
            if let Some(i) = self.place[dof] {
                scratch[i] = *b;
            }
        }
        for i in 0..self.size {
            let mut sum = scratch[i];
            for k in 1..=self.width.min(i) {
                sum = self.entries[i * stride + k].mul_sub_from(scratch[i - k], sum);
            }
            scratch[i] = sum;
        }
        for i in 0..self.size {
            scratch[i] = scratch[i] * self.entries[i * stride];
        }
        for i in (0..self.size).rev() {
            let y = scratch[i];
            for k in 1..=self.width.min(i) {
                scratch[i - k] = self.entries[i * stride + k].mul_sub_from(y, scratch[i - k]);
            }
        }
        for (dof, b) in b.as_flattened_mut().iter_mut().enumerate() {
            *b = match self.place[dof] {
                Some(i) => scratch[i],
                None => V::ZERO,
            };
        }
    }
}

/// Scratch of the stages.
struct Stage<V> {
    band: Band<V>,
    /// > 0 in lanes whose factorisation has served its time.
    stale: V,
    /// x̃ and ṽ: the stage's state but for its own A.
    from: (Vec<Unit<V>>, Vec<Unit<V>>),
    x: Vec<Unit<V>>,
    v: Vec<Unit<V>>,
    residual: Vec<Unit<V>>,
    mass: Vec<[f64; 3]>,
    entries: Vec<V>,
    column: Vec<V>,
    /// Σ M ΔA² of what rounding alone does to the forces.
    floor: f64,
    /// > 0 in lanes where an iteration did not converge.
    failed: V,
    margin: V,
    evaluations: u64,
}

impl<V: Vector> Stage<V> {
    #[inline(always)]
    fn new(system: &System<'_, V>) -> Self {
        let model = system.model;
        let length = model.bars.first().map_or(1.0, |bar| bar.length);
        let force = 1e-14 * model.stiffness.stretch * length;
        let floor = force * force * model.inverse_mass.iter().map(|m| m[0]).sum::<f64>();
        let mass = model.inverse_mass.iter().map(|m| m.map(|m| if m > 0.0 { 1.0 / m } else { 0.0 }));
        Self {
            band: Band::new(system),
            stale: V::splat(1.0),
            from: (system.zeros(), system.zeros()),
            x: system.zeros(),
            v: system.zeros(),
            residual: system.zeros(),
            mass: mass.collect(),
            entries: Vec::new(),
            column: Vec::new(),
            floor,
            failed: V::splat(0.0),
            margin: V::splat(1.0),
            evaluations: 0,
        }
    }

    /// x̃ and ṽ of stage i.
    #[inline(always)]
    fn explicit(&mut self, i: usize, h: f64, x: &[Unit<V>], v: &[Unit<V>], a: &[Vec<Unit<V>>; STAGES]) {
        let (h1, h2, hc) = (V::splat(h), V::splat(h * h), V::splat(C[i] * h));
        for u in 0..x.len() {
            for d in 0..3 {
                let (mut first, mut second) = (V::splat(0.0), V::splat(0.0));
                for j in 0..i {
                    first = V::splat(A[i][j]).mul_add(a[j][u][d], first);
                    second = V::splat(A2[i][j]).mul_add(a[j][u][d], second);
                }
                self.from.0[u][d] = h2.mul_add(second, hc.mul_add(v[u][d], x[u][d]));
                self.from.1[u][d] = h1.mul_add(first, v[u][d]);
            }
        }
    }

    /// The stage's state with its A.
    #[inline(always)]
    fn complete(&mut self, h: f64, a: &[Unit<V>]) {
        let (first, second) = (V::splat(GAMMA * h), V::splat((GAMMA * h).powi(2)));
        for u in 0..a.len() {
            for d in 0..3 {
                self.x[u][d] = second.mul_add(a[u][d], self.from.0[u][d]);
                self.v[u][d] = first.mul_add(a[u][d], self.from.1[u][d]);
            }
        }
    }

    /// Solves for A of the stage whose x̃ and ṽ stand in `from`, starting from what `a` holds; leaves its state in `x`, `v`.
    #[inline(always)]
    fn newton(&mut self, system: &mut System<'_, V>, h: f64, force: &[V], a: &mut [Unit<V>]) {
        let (zero, one) = (V::splat(0.0), V::splat(1.0));
        let (mut going, mut last) = (one, V::splat(f64::MAX));
        for iteration in 0..ITERATIONS {
            self.complete(h, a);
            let renew = if iteration == 0 { self.stale } else { going };
            if (iteration == 0 || iteration == RENEWED) && zero.any_less(renew) {
                self.band.factor(system, &self.x, h, &mut self.entries, renew);
                self.stale = zero.where_less(zero, renew, self.stale);
            }
            let mut margin = one;
            system.acceleration(&self.x, &self.v, force, &mut self.residual, &mut margin);
            self.evaluations += 1;
            let mut size = zero;
            for u in 0..a.len() {
                for d in 0..3 {
                    let mass = V::splat(self.mass[u][d]);
                    size = (mass * a[u][d]).mul_add(a[u][d], size);
                    self.residual[u][d] = mass * (self.residual[u][d] - a[u][d]);
                }
            }
            self.band.solve(&mut self.residual, &mut self.column);
            let mut change = zero;
            for u in 0..a.len() {
                for d in 0..3 {
                    let delta = self.residual[u][d];
                    change = (V::splat(self.mass[u][d]) * delta).mul_add(delta, change);
                    // A lane that has converged stays as it is.
                    a[u][d] = (a[u][d] + delta).where_less(zero, going, a[u][d]);
                }
            }
            self.margin = -(-self.margin).max(-margin);
            let done = V::splat(CONVERGED * CONVERGED).mul_add(size, V::splat(self.floor));
            going = going.where_less(done, change, zero);
            let near = zero.where_less(change, V::splat(ROUNDED * ROUNDED) * size, going);
            going = near.where_less(V::splat(0.5) * last, change, going);
            last = change;
            if iteration + 1 == STALE {
                self.stale = one.where_less(zero, going, self.stale);
            }
            if !zero.any_less(going) {
                break;
            }
        }
        self.failed = one.where_less(zero, going, self.failed);
        self.complete(h, a);
    }

    /// The step of that number from (x, v), overwriting `a` by its accelerations and `x`, `v` by the new state.
    #[inline(always)]
    fn step(
        &mut self,
        system: &mut System<'_, V>,
        h: f64,
        (ramp, number): (&mut Ramp<'_, V>, usize),
        force: &mut [V],
        (x, v): (&mut [Unit<V>], &mut [Unit<V>]),
        a: &mut [Vec<Unit<V>>; STAGES],
    ) {
        for i in 0..STAGES {
            self.explicit(i, h, x, v, a);
            // Each stage starts from the A before it.
            let (before, rest) = a.split_at_mut(i);
            if let Some(before) = before.last() {
                rest[0].copy_from_slice(before);
            }
            ramp.at(number, C[i], force);
            self.newton(system, h, force, &mut rest[0]);
        }
        x.copy_from_slice(&self.x);
        v.copy_from_slice(&self.v);
    }
}

/// Integrates up to eight samples with `substeps` steps an interval, checkpoints at its end.
#[inline(always)]
pub fn forward<V: Vector>(
    system: &mut System<'_, V>,
    substeps: usize,
    forces: &Forces,
    slots: &mut [Slot<'_>],
) -> Counters {
    let scene = system.scene;
    let free = &system.model.free;
    let (width, len) = (3 * scene.sensors.len(), 6 * free.len());
    let h = scene.duration / (scene.instants * substeps) as f64;
    let histories = slots.iter().map(|s| forces.sample(s.index)).collect();
    let mut ramp = Ramp::new(scene, forces, histories, substeps);
    let mut force = vec![V::splat(0.0); scene.panels.len()];
    let (mut x, mut v) = (system.zeros(), system.zeros());
    let mut a: [Vec<Unit<V>>; STAGES] = std::array::from_fn(|_| system.zeros());
    let mut stage = Stage::new(system);
    let mut steps = 0;
    ramp.at(0, 0.0, &mut force);
    // Newton's iterations may settle on a state far off, which is a solution to rounding there.
    let mut balance = Balance::new(scene, system.model, &force);
    for interval in 0..scene.instants {
        for step in 0..substeps {
            // The first guess is the A before; each interval starts from none, as the reverse sweep must.
            let guess = if step == 0 { system.zeros() } else { a[STAGES - 1].clone() };
            a[0].copy_from_slice(&guess);
            if step == 0 {
                stage.stale = V::splat(1.0);
            }
            let at = interval * substeps + step;
            stage.step(system, h, (&mut ramp, at), &mut force, (&mut x, &mut v), &mut a);
            balance.add(&x, &force);
        }
        steps += substeps as u64;
        let (margins, failed) = (stage.margin.array(), stage.failed.array());
        let excess = balance.excess(&v).array();
        for (l, slot) in slots.iter_mut().enumerate() {
            if *slot.outcome != Outcome::Ok {
                continue;
            }
            let finite = x.as_flattened().iter().chain(v.as_flattened()).all(|y| y.array()[l].is_finite());
            if margins[l] < 0.0 {
                *slot.outcome = Outcome::ForbiddenContact;
            } else if !finite {
                *slot.outcome = Outcome::NonFinite;
            } else if failed[l] > 0.0 {
                *slot.outcome = Outcome::NoConvergence;
            } else if excess[l] > 0.0 {
                *slot.outcome = Outcome::Unstable;
            } else {
                let signals = &mut slot.signals[interval * width..][..width];
                read_lane(scene, &x, &v, &a[STAGES - 1], l, signals);
                if let Some(tape) = &mut slot.tape {
                    store_lane(free, &x, &v, l, &mut tape.states[interval * len..][..len]);
                }
            }
        }
        if slots.iter().all(|s| *s.outcome != Outcome::Ok) {
            break;
        }
    }
    let lanes = slots.len() as u64;
    Counters { force_evaluations: lanes * stage.evaluations, steps: lanes * steps, rejected: 0 }
}

/// What the reverse sweep keeps of one step.
struct Step<V> {
    x: Vec<Unit<V>>,
    v: Vec<Unit<V>>,
    a: [Vec<Unit<V>>; STAGES],
}

/// Sweeps up to eight samples backwards, adding to the cotangents of `system`.
#[inline(always)]
pub fn reverse<V: Vector>(
    system: &mut System<'_, V>,
    substeps: usize,
    forces: &Forces,
    sweeps: &[Sweep<'_>],
) -> Counters {
    let scene = system.scene;
    let free = &system.model.free;
    let (width, len) = (3 * scene.sensors.len(), 6 * free.len());
    let h = scene.duration / (scene.instants * substeps) as f64;
    let (zero, one) = (V::splat(0.0), V::splat(1.0));
    let histories = sweeps.iter().map(|s| s.history).collect();
    let mut ramp = Ramp::new(scene, forces, histories, substeps);
    let mut force = vec![zero; scene.panels.len()];
    let (mut x, mut v, mut scratch) = (system.zeros(), system.zeros(), system.zeros());
    let (mut bar_x, mut bar_v, mut read_a) = (system.zeros(), system.zeros(), system.zeros());
    let mut lambda = system.zeros();
    let mut to_x: [Vec<Unit<V>>; STAGES] = std::array::from_fn(|_| system.zeros());
    let mut to_v: [Vec<Unit<V>>; STAGES] = std::array::from_fn(|_| system.zeros());
    let mut bar = vec![zero; width];
    let mut stage = Stage::new(system);
    let mut evaluations = 0;
    let empty = || Step { x: system.zeros(), v: system.zeros(), a: std::array::from_fn(|_| system.zeros()) };
    let mut steps: Vec<Step<V>> = (0..substeps).map(|_| empty()).collect();
    for interval in (0..scene.instants).rev() {
        // The interval again
        let state = |l: usize| {
            let sweep = sweeps.get(l)?;
            interval.checked_sub(1).map(|before| &sweep.tape.states[before * len..][..len])
        };
        load_lanes(free, &std::array::from_fn(state), &mut x, &mut v);
        stage.stale = one;
        for n in 0..substeps {
            let guess = if n == 0 { system.zeros() } else { steps[n - 1].a[STAGES - 1].clone() };
            let step = &mut steps[n];
            step.x.copy_from_slice(&x);
            step.v.copy_from_slice(&v);
            step.a[0].copy_from_slice(&guess);
            let at = interval * substeps + n;
            stage.step(system, h, (&mut ramp, at), &mut force, (&mut x, &mut v), &mut step.a);
        }
        // The sensors at its end
        for (k, b) in bar.iter_mut().enumerate() {
            *b = V::new(std::array::from_fn(|l| {
                sweeps.get(l).map_or(0.0, |s| s.cotangent[interval * width + k])
            }));
        }
        read_a.fill([zero; 3]);
        system.read_vjp(&x, &steps[substeps - 1].a[STAGES - 1], &bar, &mut bar_x, &mut bar_v, &mut read_a);

        for (n, step) in steps.iter().enumerate().rev() {
            let (h1, h2) = (V::splat(h), V::splat(h * h));
            for i in (0..STAGES).rev() {
                // Cotangent of A_i, then λ = S⁻¹ of it, S at the stage itself
                let end = STAGES - 1;
                for u in 0..x.len() {
                    for d in 0..3 {
                        let mut first = V::splat(A[end][i]) * bar_v[u][d];
                        let mut second = V::splat(A2[end][i]) * bar_x[u][d];
                        for j in i + 1..STAGES {
                            first = V::splat(A[j][i]).mul_add(to_v[j][u][d], first);
                            second = V::splat(A2[j][i]).mul_add(to_x[j][u][d], second);
                        }
                        lambda[u][d] = h2.mul_add(second, h1 * first);
                    }
                }
                if n + 1 == substeps && i == end {
                    add_into(&mut lambda, &read_a);
                }
                stage.explicit(i, h, &step.x, &step.v, &step.a);
                stage.complete(h, &step.a[i]);
                stage.band.factor(system, &stage.x, h, &mut stage.entries, one);
                stage.band.solve(&mut lambda, &mut stage.column);
                ramp.at(interval * substeps + n, C[i], &mut force);
                let (x, v) = (&stage.x, &stage.v);
                system.weighted_vjp(x, v, &force, &lambda, &mut to_x[i], &mut to_v[i], &mut scratch);
                evaluations += 1;
            }
            for u in 0..x.len() {
                for d in 0..3 {
                    bar_v[u][d] = h1.mul_add(bar_x[u][d], bar_v[u][d]);
                    for i in 0..STAGES {
                        let hc = V::splat(C[i] * h);
                        bar_v[u][d] = hc.mul_add(to_x[i][u][d], bar_v[u][d]) + to_v[i][u][d];
                        bar_x[u][d] = bar_x[u][d] + to_x[i][u][d];
                    }
                }
            }
        }
    }
    let lanes = sweeps.len() as u64;
    let steps = (scene.instants * substeps) as u64;
    Counters {
        force_evaluations: lanes * (evaluations + stage.evaluations),
        steps: lanes * steps,
        rejected: 0,
    }
}
