//! Whether equal steps still integrate anything: no motion has energy that no force has put in.
//!
//! ```text
//! ½ v·M v + U + dissipated = W,   W = U(rest) + ∫ f·dx     (contact may act at rest)
//! ```
//! Where held units have been moved U is what it exceeds that at the beginning by: nothing of that comes back but by a snap.
//! A driven unit is outside: what it does to the body is the work of the forces ∂U/∂x that it needs against its ligaments.
//! Steps too long for the highest mode feed energy into it that nobody has put in; signals can then be finite and huge.

use super::energy::contact_energy;
use super::ligaments::Place;
use super::system::{System, Unit};
use crate::lanes::Vector;

/// Part of the most work done so far by which the left side may exceed the right: 0.001 by steps that follow the motion, 0.03 where
/// that is chaotic (MODEL.md).
const LEEWAY: f64 = 0.05;

/// Work done by the panels' forces on up to eight samples.
pub struct Balance<V> {
    /// (m, m, J), zero where held or driven.
    mass: Vec<[f64; 3]>,
    /// Of each panel: how far its units are along the force, and the force.
    before: Vec<[V; 2]>,
    /// Of each driven unit: where it is and what it needs; and what it needs now.
    driven: Vec<[Unit<V>; 2]>,
    needs: Vec<Unit<V>>,
    /// W, its largest value so far, and what has been dissipated.
    work: V,
    most: V,
    lost: V,
    /// Energy of ligaments and contacts at the beginning, where held units have been moved.
    pressed: V,
    /// What rounding alone may move.
    floor: f64,
}

impl<V: Vector> Balance<V> {
    /// At the beginning `x`, which the system is prepared for, under the forces there.
    #[inline(always)]
    pub fn new(system: &mut System<'_, V>, x: &[Place<V>], force: &[V]) -> Self {
        let (model, zero) = (system.model, V::splat(0.0));
        let inverse = |m: &[f64; 3]| m.map(|m| if m > 0.0 { 1.0 / m } else { 0.0 });
        let mut mass: Vec<[f64; 3]> = model.inverse_mass.iter().map(inverse).collect();
        model.driven.iter().for_each(|u| mass[*u] = [0.0; 3]);
        let mut before = Vec::with_capacity(force.len());
        for (k, f) in force.iter().enumerate() {
            before.push([way(system, k, x), *f]);
        }
        let mut needs = vec![[zero; 3]; model.driven.len()];
        if !needs.is_empty() {
            system.react(x, &mut needs);
        }
        let mut driven = Vec::with_capacity(needs.len());
        for (needs, &u) in needs.iter().zip(&model.driven) {
            let [p, q, r] = x[u];
            driven.push([[V::narrow(p), V::narrow(q), V::narrow(r)], *needs]);
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
        Self { mass, before, driven, needs, work, most: work, lost: zero, pressed, floor }
    }

    /// Adds the work on the way to the places `x`, where `force` acts, and the energy that was `lost` on it.
    #[inline(always)]
    pub fn add(&mut self, system: &mut System<'_, V>, x: &[Place<V>], force: &[V], lost: V) {
        self.lost = self.lost + lost;
        for (k, (before, f)) in self.before.iter_mut().zip(force).enumerate() {
            let at = way(system, k, x);
            self.work = (V::splat(0.5) * (before[1] + *f)).mul_add(at - before[0], self.work);
            *before = [at, *f];
        }
        if !self.driven.is_empty() {
            system.react(x, &mut self.needs);
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

    /// Energy, `elastic` that of ligaments and contacts, less all that there can be: positive in a lane that makes energy out of
    /// nothing.
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
        // A pressed body that has snapped to an energy below that at rest has put in as much as work has.
        let most = self.most + (-elastic).max(V::splat(0.0));
        kinetic + elastic + self.lost - self.work - V::splat(LEEWAY).mul_add(most, V::splat(self.floor))
    }
}

/// How far the units that a panel's force acts on are along it, but for driven ones, which are outside.
#[inline(always)]
fn way<V: Vector>(system: &System<'_, V>, panel: usize, x: &[Place<V>]) -> V {
    let mut at = V::ZERO;
    for &u in system.pushed(panel) {
        if system.model.driven.contains(&u) {
            continue;
        }
        let [p, q, r] = x[u];
        at = at + system.along(panel, u, [V::narrow(p), V::narrow(q), V::narrow(r)]);
    }
    at
}
