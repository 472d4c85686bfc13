//! Panel forces in lanes, for samples with common equal steps and for samples with separate clocks.

use super::system::{System, Unit};
use super::{Forces, Scene};
use crate::lanes::{LANES, Vector};

/// Forces of samples at equal steps, which end at every kink.
pub struct LockstepForces<'a, V> {
    forces: &'a Forces,
    histories: Vec<&'a [f64]>,
    /// Steps between kinks.
    span: usize,
    /// Kink at which the current ramp starts.
    kink: Option<usize>,
    start: Vec<V>,
    rise: Vec<V>,
    /// Fraction of the current ramp at the last call of `at`.
    part: f64,
    /// Cotangents of the histories (K, R+1), if requested.
    cotangent: Vec<V>,
}

impl<'a, V: Vector> LockstepForces<'a, V> {
    /// Forces of the histories, one per lane, with `substeps` steps per interval of the scene.
    #[inline(always)]
    pub fn new(scene: &Scene, forces: &'a Forces, histories: Vec<&'a [f64]>, substeps: usize) -> Self {
        let zero = vec![V::splat(0.0); forces.panels];
        let span = substeps / forces.kinks(scene);
        let (start, rise) = (zero.clone(), zero);
        Self { forces, histories, span, kink: None, start, rise, part: 0.0, cotangent: Vec::new() }
    }

    /// Overwrites `force` with the forces at the fraction c of step `step`, counted from the start of the sample.
    #[inline(always)]
    pub fn at(&mut self, step: usize, c: f64, force: &mut [V]) {
        let kink = step / self.span;
        if self.kink != Some(kink) {
            self.load(kink);
        }
        let w = ((step - kink * self.span) as f64 + c) / self.span as f64;
        self.part = w;
        for ((f, s), r) in force.iter_mut().zip(&self.start).zip(&self.rise) {
            *f = V::splat(w).mul_add(*r, *s);
        }
    }

    /// Requests cotangents of the histories: `add_vjp` then adds to them.
    #[inline(always)]
    pub fn request_cotangents(&mut self) {
        self.cotangent = vec![V::ZERO; self.forces.panels * (self.forces.instants + 1)];
    }

    /// Adds to the cotangents of the histories for the forces of the last `at`; `w` is the cotangent of the units' forces.
    #[inline(always)]
    pub fn add_vjp(&mut self, system: &System<'_, V>, w: &[Unit<V>]) {
        let (Some(kink), false) = (self.kink, self.cotangent.is_empty()) else { return };
        let part = V::splat(self.part);
        for (k, of) in self.cotangent.chunks_exact_mut(self.forces.instants + 1).enumerate() {
            let bar = system.along_all(k, w);
            let late = part * bar;
            of[kink] = of[kink] + (bar - late);
            of[kink + 1] = of[kink + 1] + late;
        }
    }

    /// As `add_vjp`, for forces at the end of a ramp that shake the base; `bar_a` is the cotangent of the measured accelerations.
    #[inline(always)]
    pub fn add_base_vjp(&mut self, system: &System<'_, V>, bar_a: &[Unit<V>]) {
        let (Some(kink), false) = (self.kink, self.cotangent.is_empty()) else { return };
        for (k, of) in self.cotangent.chunks_exact_mut(self.forces.instants + 1).enumerate() {
            if let Some(bar) = system.base_force_vjp(k, bar_a) {
                of[kink + 1] = of[kink + 1] + bar;
            }
        }
    }

    /// Cotangents of the histories (lanes, K, R+1); empty if not requested.
    #[inline(always)]
    pub fn cotangent(&self) -> Vec<f64> {
        let mut all = Vec::with_capacity(self.histories.len() * self.cotangent.len());
        for lane in 0..self.histories.len() {
            for bar in &self.cotangent {
                all.push(bar.lane(lane));
            }
        }
        all
    }

    #[inline(always)]
    fn load(&mut self, kink: usize) {
        self.kink = Some(kink);
        let Self { forces, histories, .. } = self;
        for k in 0..forces.panels {
            let (mut start, mut end) = (V::ZERO, V::ZERO);
            for (l, history) in histories.iter().enumerate() {
                let f = &history[k * (forces.instants + 1) + kink..][..2];
                start.set_lane(l, f[0]);
                end.set_lane(l, f[1]);
            }
            self.start[k] = start;
            self.rise[k] = end - start;
        }
    }
}

/// Forces of lanes with separate clocks.
pub struct FreeForces {
    /// f_k at both ends of each lane's interval.
    ends: Vec<[[f64; LANES]; 2]>,
}

impl FreeForces {
    /// No forces.
    pub fn new(panels: usize) -> Self {
        Self { ends: vec![[[0.0; LANES]; 2]; panels] }
    }

    /// Loads an interval of a history into a lane.
    pub fn load(&mut self, lane: usize, forces: &Forces, history: &[f64], interval: usize) {
        for (k, [start, end]) in self.ends.iter_mut().enumerate() {
            let f = &history[k * (forces.instants + 1) + interval..][..2];
            (start[lane], end[lane]) = (f[0], f[1]);
        }
    }

    /// Sets the forces of a lane to zero.
    pub fn clear(&mut self, lane: usize) {
        for [start, end] in &mut self.ends {
            (start[lane], end[lane]) = (0.0, 0.0);
        }
    }

    /// Overwrites `force` with the forces at the fractions w of the intervals.
    #[inline(always)]
    pub fn at<V: Vector>(&self, w: V, force: &mut [V]) {
        for (f, [start, end]) in force.iter_mut().zip(&self.ends) {
            *f = (V::splat(1.0) - w) * V::gather(start) + w * V::gather(end);
        }
    }
}
