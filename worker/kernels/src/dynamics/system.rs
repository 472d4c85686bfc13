//! The equations of motion in vectors of samples: accelerations, their adjoint, and the sensors, for every integrator.

use super::ligaments::{Place, ShapeCotangent, Turn, turns};
use super::model::{Bar, Model, ModelCotangent};
use super::readings::{Mounted, cos_sin};
use super::{AccelerationFrame, Forces, Scene};
use crate::lanes::{Scalar, Vector};

/// (u, v, θ) of one unit, or their cotangents, in lanes.
pub type Unit<V> = [V; 3];

/// Arguments: (model, ligaments, x, turns, g, margin). Adds ∂U/∂s to `g` and lowers `margin` to the least ψ − ψ_min.
pub type GradientKernel<V> =
    unsafe fn(&Model, &[Bar<<V as Vector>::Scalar>], &[Place<V>], &[Turn<V>], &mut [Unit<V>], &mut V);

/// Arguments: (model, ligaments, x, turns). Returns the energy.
pub type EnergyKernel<V> = unsafe fn(&Model, &[Bar<<V as Vector>::Scalar>], &[Place<V>], &[Turn<V>]) -> V;

/// Arguments: (model, ligaments, x, w, turns, g, h, shape). Adds ∂U/∂s to `g` (optional), subtracts its derivative along w from `h`, and
/// adds the derivative in arms, void angles and stiffnesses to `shape`.
pub type ProductKernel<V> = unsafe fn(
    &Model,
    &[Bar<<V as Vector>::Scalar>],
    &[Place<V>],
    &[Unit<V>],
    &[Turn<V>],
    &mut [Unit<V>],
    &mut [Unit<V>],
    ShapeCotangent<'_, V>,
);

/// Kernels of one instruction set for one kind of scene.
pub struct Kernels<V: Vector> {
    /// Gradient of the energy.
    pub gradient: GradientKernel<V>,
    /// Energy.
    pub energy: EnergyKernel<V>,
    /// Gradient and second derivatives along a direction.
    pub second: ProductKernel<V>,
    /// As `second`; the gradient is optional.
    pub product: ProductKernel<V>,
}

/// Data to compute cotangents w of forces from those of accelerations.
pub struct ForceCotangent<'a, V: Vector> {
    /// 1/(m, m, J).
    pub inverse_mass: &'a [[V::Scalar; 3]],
    /// C.
    pub damping: [f64; 3],
    /// Cotangent of (m, m, J).
    pub mass: &'a mut [Unit<V>],
}

/// A model with scratch memory, for one vector of samples.
pub struct System<'a, V: Vector> {
    /// The scene.
    pub scene: &'a Scene,
    /// The scene with its design.
    pub model: &'a Model,
    kernels: Kernels<V>,
    /// C of the model, or zero if the integrator treats damping separately.
    pub damping: [f64; 3],
    /// Whether to compute the cotangent of `damping`.
    pub damping_asked: bool,
    /// Ligaments in the scalar type of the lanes.
    pub(super) bars: Vec<Bar<V::Scalar>>,
    /// Those of driven units.
    driven_bars: Vec<Bar<V::Scalar>>,
    /// Force and moment on the unit per newton on each panel.
    strikes: Vec<Unit<V>>,
    pub(super) inverse_mass: Vec<[V::Scalar; 3]>,
    pub(super) turn: Vec<Turn<V>>,
    h: Vec<Unit<V>>,
    /// Cotangents of the forces that the last `acceleration_vjp` computed.
    pub(super) w: Vec<Unit<V>>,
    /// Those of arms, void angles and stiffnesses have the opposite sign.
    pub(super) cotangent: ModelCotangent<V>,
}

impl<'a, V: Vector> System<'a, V> {
    /// Allocates memory. With `parameters`, cotangents of stiffnesses and damping are computed too; `kernels` must support that.
    #[inline(always)]
    pub fn new(
        scene: &'a Scene,
        model: &'a Model,
        kernels: Kernels<V>,
        damped: bool,
        parameters: bool,
    ) -> Self {
        let n = model.units();
        let zero = V::splat(0.0);
        let mut strikes = vec![[zero; 3]; scene.panels.len()];
        for (k, (to, panel)) in strikes.iter_mut().zip(&scene.panels).enumerate() {
            *to = model.about_centroid(k, panel.straight()).map(V::splat);
        }
        let driven = |bar: &&Bar| [bar.a, bar.b].iter().any(|u| model.driven.contains(u));
        Self {
            scene,
            model,
            kernels,
            damping: if damped { model.damping } else { [0.0; 3] },
            damping_asked: damped && parameters,
            bars: model.bars.iter().map(Bar::rounded).collect(),
            driven_bars: model.bars.iter().filter(driven).map(Bar::rounded).collect(),
            strikes,
            inverse_mass: model.inverse_mass.iter().map(|m| m.map(Scalar::from_f64)).collect(),
            turn: vec![Turn::NONE; n],
            h: vec![[zero; 3]; n],
            w: vec![[zero; 3]; n],
            cotangent: ModelCotangent::new(model, zero),
        }
    }

    /// Zeros, one entry per unit.
    #[inline(always)]
    pub fn zeros(&self) -> Vec<Unit<V>> {
        vec![[V::ZERO; 3]; self.model.units()]
    }

    /// Zero positions or velocities, one per unit.
    #[inline(always)]
    pub fn places(&self) -> Vec<Place<V>> {
        vec![[V::Wide::ZERO; 3]; self.model.units()]
    }

    /// Positions at the start of a sample.
    #[inline(always)]
    pub fn start(&self) -> Vec<Place<V>> {
        let mut x = self.places();
        for (x, start) in x.iter_mut().zip(self.model.start()) {
            for d in 0..3 {
                x[d] = V::Wide::splat(start[d]);
            }
        }
        x
    }

    /// Overwrites `a` with M⁻¹(−∂U/∂s − C v + f) and lowers `margin` to the least ψ − ψ_min.
    #[inline(always)]
    pub fn acceleration(
        &mut self,
        x: &[Place<V>],
        v: &[Place<V>],
        force: &[V],
        a: &mut [Unit<V>],
        margin: &mut V,
    ) {
        self.prepare(x, a);
        self.add_forces(x, force, a, margin);
        self.finish(v, a);
    }

    /// Overwrites `g` with ∂U/∂s.
    #[inline(always)]
    pub fn gradient(&mut self, x: &[Place<V>], g: &mut [Unit<V>]) {
        self.prepare(x, g);
        self.add_forces(x, &[], g, &mut { V::splat(0.0) });
    }

    /// Prepares the kernels for `x`: computes its rotations and clears `g`.
    #[inline(always)]
    pub fn prepare(&mut self, x: &[Place<V>], g: &mut [Unit<V>]) {
        g.fill([V::splat(0.0); 3]);
        turns::<V>(x, &mut self.turn);
    }

    /// U at the prepared `x`.
    #[inline(always)]
    pub fn energy(&self, x: &[Place<V>]) -> V {
        // SAFETY: as in `add_forces`.
        unsafe { (self.kernels.energy)(self.model, &self.bars, x, &self.turn) }
    }

    /// Overwrites `reaction` with ∂U/∂s of each driven unit at the prepared `x`.
    #[inline(always)]
    pub fn driving_forces(&mut self, x: &[Place<V>], reaction: &mut [Unit<V>]) {
        for bar in &self.driven_bars {
            (self.h[bar.a], self.h[bar.b]) = ([V::ZERO; 3], [V::ZERO; 3]);
        }
        // SAFETY: as in `add_forces`.
        unsafe {
            (self.kernels.gradient)(self.model, &self.driven_bars, x, &self.turn, &mut self.h, &mut {
                V::splat(1.0)
            })
        };
        for (to, &u) in reaction.iter_mut().zip(&self.model.driven) {
            *to = self.h[u];
        }
    }

    /// Adds ∂U/∂s − f at the prepared `x` to `g` and lowers `margin` to the least ψ − ψ_min.
    #[inline(always)]
    pub fn add_forces(&mut self, x: &[Place<V>], force: &[V], g: &mut [Unit<V>], margin: &mut V) {
        // SAFETY: the entry points of `dispatch` choose kernels whose instructions this machine has.
        unsafe { (self.kernels.gradient)(self.model, &self.bars, x, &self.turn, g, margin) };
        self.subtract_forces(force, g);
    }

    /// `add_forces` and its adjoint: for the cotangent `w` of the forces, adds to `bar_x` and to the model's cotangents.
    #[inline(always)]
    pub fn add_forces_vjp(
        &mut self,
        x: &[Place<V>],
        force: &[V],
        w: &[Unit<V>],
        g: &mut [Unit<V>],
        bar_x: &mut [Unit<V>],
    ) {
        let shape = self.cotangent.shape();
        // SAFETY: as in `add_forces`.
        unsafe { (self.kernels.second)(self.model, &self.bars, x, w, &self.turn, g, bar_x, shape) };
        self.subtract_forces(force, g);
        self.push_vjp(force, w);
    }

    /// Whether the effect of forces depends on the design: forces on nodes, or inertial forces of a shaken base.
    #[inline(always)]
    pub fn forces_follow_design(&self) -> bool {
        self.model.struck.iter().any(Option::is_some)
            || self.scene.panels.iter().any(|p| p.base_acceleration().is_some())
    }

    /// For the cotangent `w` of the units' forces, adds the cotangents of the arms of struck nodes, and of the masses on a shaken base.
    #[inline(always)]
    pub fn push_vjp(&mut self, force: &[V], w: &[Unit<V>]) {
        if let Some(base) = self.base(force) {
            for &u in &self.model.free {
                for d in 0..2 {
                    let mass = &mut self.cotangent.mass[u][d];
                    *mass = w[u][d].mul_sub_from(base[d], *mass);
                }
            }
        }
        for (k, node) in self.model.struck.iter().enumerate() {
            let Some(node) = *node else { continue };
            let ([x, y, _], moment) = (self.strikes[k], w[self.scene.panels[k].unit][2] * force[k]);
            let [p, q] = self.cotangent.arms[node];
            // with the sign of the cotangents of ∂U/∂s
            self.cotangent.arms[node] = [moment.mul_sub_from(y, p), moment.mul_add(x, q)];
        }
    }

    #[inline(always)]
    fn subtract_forces(&self, force: &[V], g: &mut [Unit<V>]) {
        for (k, &f) in force.iter().enumerate() {
            for &u in self.units_of_panel(k) {
                let force_per_newton = self.does(k, u);
                for d in 0..3 {
                    g[u][d] = g[u][d] - force_per_newton[d] * f;
                }
            }
        }
    }

    /// Units on which a panel's force acts: its own unit, or all free units if it shakes the base.
    #[inline(always)]
    pub fn units_of_panel(&self, panel: usize) -> &[usize] {
        let at = &self.scene.panels[panel];
        if at.base_acceleration().is_some() { &self.model.free } else { std::slice::from_ref(&at.unit) }
    }

    /// Force and moment on `unit` per newton on `panel`.
    #[inline(always)]
    fn does(&self, panel: usize, unit: usize) -> Unit<V> {
        match self.scene.panels[panel].base_acceleration() {
            None => self.strikes[panel],
            Some([x, y]) => {
                let mass = self.model.mass(unit);
                [V::splat(-mass * x), V::splat(-mass * y), V::ZERO]
            }
        }
    }

    /// Scalar product of `y` with force and moment on the unit per newton on the panel. `y` is a displacement, or the cotangent of the
    /// unit's force.
    #[inline(always)]
    pub fn along(&self, panel: usize, unit: usize, y: Unit<V>) -> V {
        let [p, q, r] = self.does(panel, unit);
        p * y[0] + q * y[1] + r * y[2]
    }

    /// Sum of `along` over all units on which the panel acts.
    #[inline(always)]
    pub fn along_all(&self, panel: usize, y: &[Unit<V>]) -> V {
        let mut sum = V::ZERO;
        for &u in self.units_of_panel(panel) {
            sum = sum + self.along(panel, u, y[u]);
        }
        sum
    }

    /// Acceleration of the base; `None` if no panel shakes it.
    #[inline(always)]
    pub fn base(&self, force: &[V]) -> Option<[V; 2]> {
        let mut base = None;
        for (panel, &f) in self.scene.panels.iter().zip(force) {
            let Some([x, y]) = panel.base_acceleration() else { continue };
            let [p, q] = base.unwrap_or([V::ZERO; 2]);
            base = Some([V::splat(x).mul_add(f, p), V::splat(y).mul_add(f, q)]);
        }
        base
    }

    /// Adds the acceleration of the base to those of the units with sensors.
    #[inline(always)]
    pub fn add_base_acceleration(&self, force: &[V], a: &mut [Unit<V>]) {
        let Some(base) = self.base(force) else { return };
        for &u in &self.scene.sensors {
            (0..2).for_each(|d| a[u][d] = a[u][d] + base[d]);
        }
    }

    /// Cotangent of the force on `panel` through the base acceleration in the signals; `bar_a` is the cotangent of the units'
    /// accelerations.
    #[inline(always)]
    pub fn base_force_vjp(&self, panel: usize, bar_a: &[Unit<V>]) -> Option<V> {
        let [x, y] = self.scene.panels[panel].base_acceleration()?;
        let mut sum = V::ZERO;
        for &u in &self.scene.sensors {
            sum = V::splat(x).mul_add(bar_a[u][0], V::splat(y).mul_add(bar_a[u][1], sum));
        }
        Some(sum)
    }

    /// Sets how forces act in `lane` to how they act in `sample`.
    #[inline(always)]
    pub fn set_strike(&mut self, lane: usize, forces: &Forces, sample: usize) {
        if forces.strikes.is_empty() {
            return;
        }
        for (k, strike) in self.strikes.iter_mut().enumerate() {
            let own = self.model.about_centroid(k, forces.strike(&self.scene.panels, sample, k));
            for d in 0..3 {
                strike[d].set_lane(lane, own[d]);
            }
        }
    }

    /// Converts ∂U/∂s − f into accelerations.
    #[inline(always)]
    fn finish(&self, v: &[Place<V>], a: &mut [Unit<V>]) {
        let moving = self.model.moving_range();
        a[..moving.start].fill([V::splat(0.0); 3]);
        a[moving.end..].fill([V::splat(0.0); 3]);
        let of_moving = a[moving.clone()].iter_mut().zip(&v[moving.clone()]).zip(&self.inverse_mass[moving]);
        for ((a, v), inverse) in of_moving {
            for d in 0..3 {
                let net = V::splat(self.damping[d]).mul_add(V::narrow(v[d]), a[d]);
                a[d] = -(V::from_scalar(inverse[d]) * net);
            }
        }
    }

    /// Adjoint of `acceleration`: overwrites `bar_x` and `bar_v`, adds to the model's cotangents, and stores the acceleration at (x, v)
    /// in `a`.
    #[inline(always)]
    pub fn acceleration_vjp(
        &mut self,
        x: &[Place<V>],
        v: &[Place<V>],
        force: &[V],
        bar_a: &[Unit<V>],
        bar_x: &mut [Unit<V>],
        bar_v: &mut [Unit<V>],
        a: &mut [Unit<V>],
    ) {
        for ((w, bar), inverse) in self.w.iter_mut().zip(bar_a).zip(&self.inverse_mass) {
            for d in 0..3 {
                w[d] = V::from_scalar(inverse[d]) * bar[d];
            }
        }
        self.prepare(x, a);
        let (mut h, w) = (std::mem::take(&mut self.h), std::mem::take(&mut self.w));
        h.fill([V::splat(0.0); 3]);
        self.add_forces_vjp(x, force, &w, a, &mut h);
        (self.h, self.w) = (h, w);
        self.finish(v, a);
        let zero = V::splat(0.0);
        for u in 0..self.model.units() {
            for d in 0..3 {
                let w = self.w[u][d];
                bar_x[u][d] = self.h[u][d];
                bar_v[u][d] = zero - V::splat(self.damping[d]) * w;
                self.cotangent.mass[u][d] = w.mul_sub_from(a[u][d], self.cotangent.mass[u][d]);
            }
        }
        if self.damping_asked {
            damping_cotangent(&mut self.cotangent.damping, &self.w, v);
        }
    }

    /// Data to compute cotangents of forces.
    #[inline(always)]
    pub fn force_cotangent(&mut self) -> ForceCotangent<'_, V> {
        let Self { inverse_mass, damping, cotangent, .. } = self;
        ForceCotangent { inverse_mass, damping: *damping, mass: &mut cotangent.mass }
    }

    /// Overwrites `curved` with −∂²U w at x, and adds to the model's cotangents except those of masses and damping.
    #[inline(always)]
    pub fn product(&mut self, x: &[Place<V>], w: &[Unit<V>], curved: &mut [Unit<V>]) {
        self.prepare(x, curved);
        let shape = self.cotangent.shape();
        let unread = &mut self.h;
        // SAFETY: as in `add_forces`.
        unsafe { (self.kernels.product)(self.model, &self.bars, x, w, &self.turn, unread, curved, shape) };
    }

    /// Adds the cotangents of state and acceleration for the cotangent `bar`[3m + channel] of the signals.
    #[inline(always)]
    pub fn read_vjp(
        &self,
        x: &[Place<V>],
        v: &[Place<V>],
        a: &[Unit<V>],
        bar: &[V],
        bar_x: &mut [Unit<V>],
        bar_v: &mut [Unit<V>],
        bar_a: &mut [Unit<V>],
    ) {
        // Signals of held units are zero; the sweeps keep no cotangents of their state.
        let moves = |u: usize| self.model.inverse_mass[u] != [0.0; 3];
        for (m, &u) in self.scene.sensors.iter().enumerate().filter(|(_, u)| moves(**u)) {
            let (p, q, o) = (bar[3 * m], bar[3 * m + 1], bar[3 * m + 2]);
            bar_v[u][2] = bar_v[u][2] + o;
            let (mut bx, mut by) = (p, q);
            if let Some(mount) = self.scene.mount {
                let (at, omega) =
                    (Mounted::new(mount, self.scene.frame, V::narrow(x[u][2])), V::narrow(v[u][2]));
                let (read, [bx, by]) = (at.read(omega, a[u]), at.back([p, q]));
                if self.scene.frame == AccelerationFrame::Body {
                    bar_x[u][2] = bar_x[u][2] + read[1] * p - read[0] * q;
                }
                let ([px, py], alpha) = (at.arm, a[u][2]);
                let (along, across) = (bx * px + by * py, by * px - bx * py);
                bar_a[u][0] = bar_a[u][0] + bx;
                bar_a[u][1] = bar_a[u][1] + by;
                bar_a[u][2] = bar_a[u][2] + across;
                bar_v[u][2] = bar_v[u][2] - (omega + omega) * along;
                bar_x[u][2] = bar_x[u][2] - alpha * along - omega * omega * across;
                continue;
            }
            if self.scene.frame == AccelerationFrame::Body {
                let (c, s) = cos_sin(V::narrow(x[u][2]));
                let read = [c * a[u][0] + s * a[u][1], c * a[u][1] - s * a[u][0]];
                bar_x[u][2] = bar_x[u][2] + read[1] * p - read[0] * q;
                (bx, by) = (c * p - s * q, s * p + c * q);
            }
            bar_a[u][0] = bar_a[u][0] + bx;
            bar_a[u][1] = bar_a[u][1] + by;
        }
    }

    /// Sums the cotangents over the lanes, in order, and clears them.
    #[inline(always)]
    pub fn take_cotangent(&mut self) -> ModelCotangent {
        let mut sum = ModelCotangent::new(self.model, 0.0);
        for (to, from) in sum.arms.iter_mut().zip(&mut self.cotangent.arms) {
            *to = [-total(&mut from[0]), -total(&mut from[1])];
        }
        for (to, from) in sum.voids.iter_mut().zip(&mut self.cotangent.voids) {
            *to = [-total(&mut from[0]), -total(&mut from[1])];
        }
        for (to, from) in sum.mass.iter_mut().zip(&mut self.cotangent.mass) {
            *to = std::array::from_fn(|d| total(&mut from[d]));
        }
        // the prescribed motion of a driven unit does not depend on its mass
        self.model.driven.iter().for_each(|u| sum.mass[*u] = [0.0; 3]);
        for (to, from) in sum.stiffness.iter_mut().zip(&mut self.cotangent.stiffness) {
            *to = std::array::from_fn(|k| -total(&mut from[k]));
        }
        for (to, from) in sum.start.iter_mut().zip(&mut self.cotangent.start) {
            *to = std::array::from_fn(|d| total(&mut from[d]));
        }
        sum.contact = -total(&mut self.cotangent.contact);
        sum.damping = std::array::from_fn(|d| total(&mut self.cotangent.damping[d]));
        sum
    }
}

/// The sum of the lanes, in order; clears them.
fn total<V: Vector>(lanes: &mut V) -> f64 {
    let lanes = std::mem::replace(lanes, V::ZERO);
    lanes.lanes().iter().map(|x| x.to_f64()).sum()
}

/// Adds the cotangent of C for forces with the cotangents `w` at velocities `v`.
#[inline(always)]
pub fn damping_cotangent<V: Vector>(damping: &mut [V; 3], w: &[Unit<V>], v: &[Place<V>]) {
    for (w, v) in w.iter().zip(v) {
        for d in 0..3 {
            damping[d] = w[d].mul_sub_from(V::narrow(v[d]), damping[d]);
        }
    }
}

/// Adds `from` to `to`.
#[inline(always)]
pub fn add_into<V: Vector>(to: &mut [Unit<V>], from: &[Unit<V>]) {
    for (t, f) in to.as_flattened_mut().iter_mut().zip(from.as_flattened()) {
        *t = *t + *f;
    }
}
