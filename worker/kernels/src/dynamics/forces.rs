//! Force histories on the panels.

use super::scene::{Panel, Scene};

/// Force histories (N, K, R+1), f_k at t_n = n·duration/R, n = 0…R, linear in between.
///
/// R is `instants`: that of the scene, T, or a whole multiple of it, for histories with more detail than T instants hold
/// (recorded ones). Every method ends a step at each of the R kinks; signals are those of the T instants all the same,
/// every (R/T)-th.
#[derive(Debug, Clone, PartialEq)]
pub struct Forces {
    /// N.
    pub samples: usize,
    /// K.
    pub panels: usize,
    /// R, a multiple of T.
    pub instants: usize,
    /// (N, K, R+1) (N).
    pub values: Vec<f64>,
    /// (N, K): how each force acts. Empty: along its panel's direction on the unit's centroid.
    pub strikes: Vec<Strike>,
}

/// What a force of 1 N does to its unit: (f_u, f_v, moment) (1, 1, mm), whatever way the unit has turned.
pub type Strike = [f64; 3];

impl Panel {
    /// Along the panel's direction on the centroid.
    pub fn central(&self) -> Strike {
        [self.direction[0], self.direction[1], 0.0]
    }

    /// Along the direction turned by `angle` (rad), at `offset` (mm) to its left from the centroid.
    pub fn struck(&self, offset: f64, angle: f64) -> Strike {
        let ([x, y], (s, c)) = (self.direction, angle.sin_cos());
        [c * x - s * y, c * y + s * x, -offset * c]
    }
}

impl Forces {
    /// R/T: kinks an interval of the scene.
    pub fn kinks(&self, scene: &Scene) -> usize {
        self.instants / scene.instants
    }

    /// The histories of sample i, (K, R+1).
    pub fn sample(&self, i: usize) -> &[f64] {
        let len = self.panels * (self.instants + 1);
        &self.values[i * len..][..len]
    }

    /// How the force on a panel acts in sample i.
    pub fn strike(&self, panels: &[Panel], i: usize, panel: usize) -> Strike {
        self.strikes.get(i * self.panels + panel).copied().unwrap_or_else(|| panels[panel].central())
    }

    /// The samples listed, in the order listed.
    #[must_use]
    pub fn select(&self, samples: &[usize]) -> Self {
        let values = samples.iter().flat_map(|&i| self.sample(i)).copied().collect();
        let own = |&i: &usize| self.strikes.iter().skip(i * self.panels).take(self.panels);
        let strikes = samples.iter().flat_map(own).copied().collect();
        Self { samples: samples.len(), values, strikes, ..*self }
    }

    /// The interval of the scene in which a history, (K, R+1), begins to act; T where it never does.
    pub(crate) fn onset(&self, scene: &Scene, history: &[f64]) -> usize {
        let acts = |panel: &[f64]| panel.iter().position(|f| *f != 0.0);
        let first = history.chunks(self.instants + 1).filter_map(acts).min();
        first.map_or(scene.instants, |n| n.saturating_sub(1) / self.kinks(scene))
    }
}
