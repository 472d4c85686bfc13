//! Energy balance that detects unstable equal steps.
//!
//! ```text
//! ½ v·M v + U + dissipated = W,   W = U(rest) + ∫ f·dx     (contact may act at rest)
//! ```
//! In compressed bodies, U counts from its value at the start; only snapping releases energy stored there. Driven units are not
//! part of the balance: the forces ∂U/∂x that move them do work on the body. Steps that are too long for the highest mode create
//! energy; signals may then be finite and huge.

use super::energy::contact_energy;
use super::ligaments::Place;
use super::system::{System, Unit};
use crate::lanes::Vector;

/// Tolerated excess of the left side, as a fraction of the largest W so far. Steps that resolve the motion need 0.001, chaotic
/// motion 0.03.
const LEEWAY: f64 = 0.05;

/// Energy balance of the samples in one vector.
pub struct Balance<V> {
    /// (m, m, J) of each unit; zero if held or driven.
    mass: Vec<[f64; 3]>,
    /// For each panel, displacement along the force, and the force, at the previous instant.
    before: Vec<[V; 2]>,
    /// For each driven unit, position and driving force at the previous instant; `needs`: its present driving force.
    driven: Vec<[Unit<V>; 2]>,
    needs: Vec<Unit<V>>,
    /// W, the largest W so far, and the dissipated energy.
    work: V,
    most: V,
    dissipated: V,
    /// Energy of ligaments and contacts at the start of samples of a compressed body.
    pressed: V,
    /// Bound on changes due to rounding.
    floor: f64,
}

impl<V: Vector> Balance<V> {
    /// Starts at the state `x`, for which the system is prepared, under the initial forces.
    #[inline(always)]
    pub fn new(system: &mut System<'_, V>, x: &[Place<V>], force: &[V]) -> Self {
        let (model, zero) = (system.model, V::splat(0.0));
        let inverse = |m: &[f64; 3]| m.map(|m| if m > 0.0 { 1.0 / m } else { 0.0 });
        let mut mass: Vec<[f64; 3]> = model.inverse_mass.iter().map(inverse).collect();
        model.driven.iter().for_each(|u| mass[*u] = [0.0; 3]);
        let mut before = Vec::with_capacity(force.len());
        for (k, f) in force.iter().enumerate() {
            before.push([displacement_along(system, k, x), *f]);
        }
        let mut needs = vec![[zero; 3]; model.driven.len()];
        if !needs.is_empty() {
            system.driving_forces(x, &mut needs);
        }
        let mut driven = Vec::with_capacity(needs.len());
        for (own, &u) in needs.iter().zip(&model.driven) {
            let [p, q, r] = x[u];
            driven.push([[V::narrow(p), V::narrow(q), V::narrow(r)], *own]);
        }
        let touching =
            |c| model.bars.iter().flat_map(|bar| bar.voids).map(|psi| contact_energy(c, psi)).sum();
        let (work, pressed) = match model.start().is_empty() {
            true => (V::splat(model.contact.map_or(0.0, touching)), zero),
            false => (zero, system.energy(x)),
        };
        let epsilon = if V::SINGLE { f64::from(f32::EPSILON) } else { f64::EPSILON };
        let floors = model.bars.iter().map(|bar| epsilon * bar.stiffness[0] * bar.length * bar.length);
        let floor = floors.fold(epsilon * pressed.lane(0), f64::max);
        Self { mass, before, driven, needs, work, most: work, dissipated: zero, pressed, floor }
    }

    /// Adds the work done up to the positions `x` and the forces `force`, and the energy `lost` since the previous call.
    #[inline(always)]
    pub fn add(&mut self, system: &mut System<'_, V>, x: &[Place<V>], force: &[V], lost: V) {
        self.dissipated = self.dissipated + lost;
        for (k, (before, f)) in self.before.iter_mut().zip(force).enumerate() {
            let at = displacement_along(system, k, x);
            self.work = (V::splat(0.5) * (before[1] + *f)).mul_add(at - before[0], self.work);
            *before = [at, *f];
        }
        if !self.driven.is_empty() {
            system.driving_forces(x, &mut self.needs);
        }
        for ((before, needs), &u) in self.driven.iter_mut().zip(&self.needs).zip(&system.model.driven) {
            let [p, q, r] = x[u];
            let at = [V::narrow(p), V::narrow(q), V::narrow(r)];
            for d in 0..3 {
                let mean = V::splat(0.5) * (before[1][d] + needs[d]);
                self.work = mean.mul_add(at[d] - before[0][d], self.work);
            }
            *before = [at, *needs];
        }
        self.most = self.most.max(self.work);
    }

    /// Energy (with `elastic` that of ligaments and contacts) minus the largest possible energy: positive in lanes that create
    /// energy.
    #[inline(always)]
    pub fn excess(&self, elastic: V, v: &[Place<V>]) -> V {
        let mut kinetic = V::splat(0.0);
        for (v, mass) in v.iter().zip(&self.mass) {
            for d in 0..3 {
                let v = V::narrow(v[d]);
                kinetic = (V::splat(0.5 * mass[d]) * v).mul_add(v, kinetic);
            }
        }
        let elastic = elastic - self.pressed;
        // A compressed body that snaps below its energy at rest releases energy, which counts like work.
        let max_work = self.most + (-elastic).max(V::splat(0.0));
        kinetic + elastic + self.dissipated
            - self.work
            - V::splat(LEEWAY).mul_add(max_work, V::splat(self.floor))
    }
}

/// Displacement along a panel's force of the units on which it acts, except driven units.
#[inline(always)]
fn displacement_along<V: Vector>(system: &System<'_, V>, panel: usize, x: &[Place<V>]) -> V {
    let mut at = V::ZERO;
    for &u in system.units_of_panel(panel) {
        if system.model.driven.contains(&u) {
            continue;
        }
        let [p, q, r] = x[u];
        at = at + system.along(panel, u, [V::narrow(p), V::narrow(q), V::narrow(r)]);
    }
    at
}
