//! Functions shared by the property tests.

use metasense_kernels::body::Layout;
use metasense_kernels::dynamics::{LigamentStiffness, Panel, Scene};

/// A square lattice of the reference material, clamped below, with panel and sensor on its last unit, for 0.1 s.
pub fn scene(columns: usize, rows: usize, instants: usize) -> Scene {
    Scene {
        layout: Layout::planar(columns, rows, 15.0, 2.25),
        density: 1e-8,
        stiffness: LigamentStiffness { stretch: 3.0, shear: 0.5, bend: 1.0 },
        damping_ratio: 0.02,
        clamped: (0..columns).collect(),
        panels: vec![Panel::central(columns * rows - 1, [0.6, -0.8])],
        sensors: vec![columns * rows - 1],
        duration: 0.1,
        instants,
        ..Scene::default()
    }
}

pub fn norm(a: &[f64]) -> f64 {
    a.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// ‖a − b‖/‖b‖.
pub fn relative(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len(), "lengths");
    let difference: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    let scale = norm(b);
    norm(&difference) / if scale > 0.0 { scale } else { 1.0 }
}

pub fn pool(threads: usize) -> metasense_kernels::Pool {
    metasense_kernels::Pool::new(threads).expect("threads")
}
