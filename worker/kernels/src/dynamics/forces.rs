//! Force histories on the panels.

use super::scene::Scene;

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

    /// The interval of the scene in which a history, (K, R+1), begins to act; T where it never does.
    pub(crate) fn onset(&self, scene: &Scene, history: &[f64]) -> usize {
        let acts = |panel: &[f64]| panel.iter().position(|f| *f != 0.0);
        let first = history.chunks(self.instants + 1).filter_map(acts).min();
        first.map_or(scene.instants, |n| n.saturating_sub(1) / self.kinks(scene))
    }
}
