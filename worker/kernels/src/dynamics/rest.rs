//! The body's linearisation where samples begin: M s̈ + C ṡ + K s = f, K the Hessian of the energy there.

use super::Scene;
use super::model::Model;
use super::stiffness::{columns, hessian, unknowns};

/// Masses, damping and stiffness of what moves.
#[derive(Debug, Clone, PartialEq)]
pub struct Rest {
    /// Of each unknown its number among the displacements of all units, 3·unit + d, d = u, v, θ; in order.
    pub unknowns: Vec<usize>,
    /// Diagonal of M: m, m, J of each (Mg, Mg, Mg·mm²).
    pub mass: Vec<f64>,
    /// Diagonal of C (N·s/mm, N·s/mm, N·mm·s).
    pub damping: Vec<f64>,
    /// Whether some motion of the body as a whole meets no stiffness.
    pub loose: bool,
    /// (row, column, value) of K by columns, both triangles, without zeros.
    pub stiffness: Vec<(usize, usize, f64)>,
    /// What 1 N on each panel does to the unknowns: (unknown, N or N·mm), without zeros.
    pub pushes: Vec<Vec<(usize, f64)>>,
    /// The acceleration of the base under 1 N on each (mm/s²), which sensors feel beside their own.
    pub shakes: Vec<[f64; 2]>,
    /// By how much each unit is turned there (rad); empty where none is.
    pub turned: Vec<f64>,
}

impl Rest {
    /// Of a scene with a design.
    ///
    /// # Panics
    /// If the design's length is not that of the scene's layout, or a unit is driven, which is no part of such a system.
    pub fn new(scene: &Scene, design: &[f64]) -> Self {
        assert!(scene.panels.iter().all(|panel| panel.drives().is_none()), "a driven unit");
        assert_eq!(design.len(), scene.layout.design_len(), "length of the design");
        let model = Model::new(scene, design);
        let unknowns = unknowns(&model);
        let stiffness = columns(&unknowns, model.units(), |w| hessian(&model, scene, model.start(), w));
        Self {
            mass: unknowns.iter().map(|u| model.inverse_mass[u / 3][u % 3].recip()).collect(),
            damping: unknowns.iter().map(|u| model.damping[u % 3]).collect(),
            loose: scene.is_loose(),
            stiffness,
            pushes: (0..scene.panels.len()).map(|k| pushes(&model, scene, &unknowns, k)).collect(),
            unknowns,
            shakes: scene.panels.iter().map(|panel| panel.shakes().unwrap_or_default()).collect(),
            turned: model.start().iter().map(|[.., turn]| *turn).collect(),
        }
    }
}

/// What 1 N on a panel does to the unknowns.
fn pushes(model: &Model, scene: &Scene, unknowns: &[usize], k: usize) -> Vec<(usize, f64)> {
    let panel = &scene.panels[k];
    let strike = model.about_centroid(k, panel.straight());
    let does = |unknown: &usize| {
        let (unit, d) = (unknown / 3, unknown % 3);
        match panel.shakes() {
            Some([x, y]) => [-x * model.mass(unit), -y * model.mass(unit), 0.0][d],
            None if unit == panel.unit => strike[d],
            None => 0.0,
        }
    };
    unknowns.iter().map(does).enumerate().filter(|(_, does)| *does != 0.0).collect()
}
