//! Force histories on the panels.

use super::scene::{Panel, Scene};
use std::borrow::Cow;

/// Force histories (N, K, R+1): f_k at t_n = n·duration/R, n = 0…R, linear in between.
///
/// R is the number T of instants of the scene or a multiple of it, as for recorded forces with more detail. Every method ends a
/// step at each of the R kinks. Signals always have T instants.
#[derive(Debug, Clone, PartialEq)]
pub struct Forces {
    /// N.
    pub samples: usize,
    /// K.
    pub panels: usize,
    /// R, a multiple of T.
    pub instants: usize,
    /// Forces (N), shape (N, K, R+1).
    pub values: Vec<f64>,
    /// How each force acts, shape (N, K). Empty: as the panels define.
    pub strikes: Vec<Strike>,
}

/// Force and moment on the unit per newton: (f_u, f_v, moment about the panel's point) (1, 1, mm), independent of the unit's
/// rotation.
pub type Strike = [f64; 3];

impl Panel {
    /// Force and moment without deviation.
    pub fn straight(&self) -> Strike {
        [self.direction[0], self.direction[1], self.moment]
    }

    /// Force and moment of a blow whose direction is rotated by `angle` (rad) and whose point is shifted by `offset` (mm) to the
    /// left. Couples do not change.
    pub fn deviated_strike(&self, offset: f64, angle: f64) -> Strike {
        let ([x, y], (s, c)) = (self.direction, angle.sin_cos());
        let missed = if self.is_couple() { 0.0 } else { -offset * c };
        [c * x - s * y, c * y + s * x, self.moment + missed]
    }

    /// Whether the panel exerts a moment and no force.
    pub fn is_couple(&self) -> bool {
        self.direction == [0.0; 2]
    }
}

impl Forces {
    /// R/T: kinks per interval of the scene.
    pub fn kinks(&self, scene: &Scene) -> usize {
        self.instants / scene.instants
    }

    /// The histories of sample i, (K, R+1).
    pub fn sample(&self, i: usize) -> &[f64] {
        let len = self.panels * (self.instants + 1);
        &self.values[i * len..][..len]
    }

    /// Force and moment per newton on a panel in sample i.
    pub fn strike(&self, panels: &[Panel], i: usize, panel: usize) -> Strike {
        self.strikes.get(i * self.panels + panel).copied().unwrap_or_else(|| panels[panel].straight())
    }

    /// The same forces with a number of instants that is a multiple of the scene's T; borrowed if it already is.
    pub fn refined_for(&self, scene: &Scene) -> Cow<'_, Self> {
        let (mut by, own) = (1, self.instants);
        while !(by * own).is_multiple_of(scene.instants) {
            by += 1;
        }
        if by == 1 {
            return Cow::Borrowed(self);
        }
        let mut values = Vec::with_capacity(self.samples * self.panels * (by * own + 1));
        for history in self.values.chunks_exact(own + 1) {
            for ends in history.windows(2) {
                values.extend((0..by).map(|j| ends[0] + (ends[1] - ends[0]) * (j as f64 / by as f64)));
            }
            values.push(history[own]);
        }
        Cow::Owned(Self { instants: by * own, values, strikes: self.strikes.clone(), ..*self })
    }

    /// The first `n` instants of a scene and its forces.
    pub fn beginning(&self, scene: &Scene, n: usize) -> (Scene, Self) {
        let instants = n * self.kinks(scene);
        let values = self.values.chunks_exact(self.instants + 1).flat_map(|f| &f[..=instants]).copied();
        let forces = Self { instants, values: values.collect(), strikes: self.strikes.clone(), ..*self };
        let duration = scene.duration * n as f64 / scene.instants as f64;
        (Scene { duration, instants: n, ..scene.clone() }, forces)
    }

    /// The given samples, in the given order.
    pub fn select(&self, samples: &[usize]) -> Self {
        let values = samples.iter().flat_map(|&i| self.sample(i)).copied().collect();
        let own = |&i: &usize| self.strikes.iter().skip(i * self.panels).take(self.panels);
        let strikes = samples.iter().flat_map(own).copied().collect();
        Self { samples: samples.len(), values, strikes, ..*self }
    }

    /// Index of the scene's interval in which a history (K, R+1) starts to act; T if all forces are zero.
    pub(crate) fn onset(&self, scene: &Scene, history: &[f64]) -> usize {
        let acts = |panel: &[f64]| panel.iter().position(|f| *f != 0.0);
        let first = history.chunks(self.instants + 1).filter_map(acts).min();
        first.map_or(scene.instants, |n| n.saturating_sub(1) / self.kinks(scene))
    }
}
