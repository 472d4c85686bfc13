//! Linearisation about the state at the start of samples: M s̈ + C ṡ + K s = f, with K the Hessian of the energy there.

use super::Scene;
use super::model::Model;
use super::stiffness::{columns, hessian, unknowns};

/// Masses, damping and stiffness of the free coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct Rest {
    /// Index of each unknown among the coordinates of all units: 3·unit + d, d = 0, 1, 2 for u, v, θ; ascending.
    pub unknowns: Vec<usize>,
    /// Diagonal of M: m, m, J per unit (Mg, Mg, Mg·mm²).
    pub mass: Vec<f64>,
    /// Diagonal of C (N·s/mm, N·s/mm, N·mm·s).
    pub damping: Vec<f64>,
    /// Whether the body can move as a whole.
    pub loose: bool,
    /// Nonzero entries (row, column, value) of K by columns, both triangles.
    pub stiffness: Vec<(usize, usize, f64)>,
    /// Nonzero forces on the unknowns per newton on each panel: (unknown, N or N·mm).
    pub pushes: Vec<Vec<(usize, f64)>>,
    /// Acceleration of the base per newton on each panel (mm/s²), which sensors also measure.
    pub shakes: Vec<[f64; 2]>,
    /// Rotation of each unit at the start (rad); empty if not compressed.
    pub turned: Vec<f64>,
}

impl Rest {
    /// Linearises a scene with a design.
    ///
    /// # Panics
    /// If the design's length does not match the scene's layout, or a unit is driven.
    pub fn new(scene: &Scene, design: &[f64]) -> Self {
        assert!(
            scene.panels.iter().all(|panel| panel.unit_acceleration().is_none()),
            "a scene with a driven unit has no linearisation"
        );
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
            shakes: scene.panels.iter().map(|panel| panel.base_acceleration().unwrap_or_default()).collect(),
            turned: model.start().iter().map(|[.., turn]| *turn).collect(),
        }
    }
}

/// Nonzero forces on the unknowns per newton on panel k.
fn pushes(model: &Model, scene: &Scene, unknowns: &[usize], k: usize) -> Vec<(usize, f64)> {
    let panel = &scene.panels[k];
    let strike = model.about_centroid(k, panel.straight());
    let does = |unknown: &usize| {
        let (unit, d) = (unknown / 3, unknown % 3);
        match panel.base_acceleration() {
            Some([x, y]) => [-x * model.mass(unit), -y * model.mass(unit), 0.0][d],
            None if unit == panel.unit => strike[d],
            None => 0.0,
        }
    };
    unknowns.iter().map(does).enumerate().filter(|(_, does)| *does != 0.0).collect()
}
