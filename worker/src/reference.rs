//! The reference scene of `MODEL.md` and its forces, for speed measurements, benchmarks and checks.

use metasense_numerics::body::Layout;
use metasense_numerics::dynamics::{Forces, LigamentStiffness, Panel, Scene};
use metasense_numerics::random::Purpose;
use metasense_numerics::stimuli::{self, Bell};

/// The reference scene: two panels, one sensor, 6 × 6 units.
pub fn reference() -> Scene {
    let layout = Layout::planar(6, 6, 15.0, 2.25);
    Scene {
        density: 1e-8,
        stiffness: LigamentStiffness { stretch: 3.0, shear: 0.5, bend: 1.0 },
        damping_ratio: 0.02,
        clamped: layout.bottom(),
        panels: [31, 34].map(|unit| Panel::central(unit, [0.0, -1.0])).to_vec(),
        sensors: vec![21],
        duration: 1.0,
        instants: 200,
        layout,
        ..Scene::default()
    }
}

/// Bell pulses with the default intervals, seed 1.
pub fn bells(scene: &Scene, samples: u64) -> Forces {
    let bell = Bell {
        amplitude: [0.15, 0.5],
        width: [0.06, 0.25],
        onset: [0.0, 0.5],
        peak: [0.35, 0.65],
        power: [1.5, 4.0],
    };
    let (duration, instants) = (scene.duration, scene.instants);
    stimuli::bells(&bell, Purpose::Stimulus, 1, 0..samples, scene.panels.len(), duration, instants)
}
