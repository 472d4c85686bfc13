//! A scene: body, material, contact, panels and sensors; everything except design and forces.

use crate::body::{Geometry, Layout};
use nalgebra::{MatrixXx3, RowVector3};

/// Stiffnesses of a ligament.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LigamentStiffness {
    /// k_l (N/mm).
    pub stretch: f64,
    /// k_s (N/mm).
    pub shear: f64,
    /// k_θ (N·mm/rad).
    pub bend: f64,
}

/// Contact between the edges that face each other across a ligament.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeContact {
    /// k_c (N·mm/rad²).
    pub stiffness: f64,
    /// ψ_min (rad): smaller void angles are forbidden.
    pub min_angle: f64,
    /// ψ_c (rad): void angle below which contact acts.
    pub cutoff_angle: f64,
}

/// Parameters of the material, factors on them, or a gradient in them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Parameters {
    /// k_l.
    pub stretch: f64,
    /// k_s.
    pub shear: f64,
    /// k_θ.
    pub bend: f64,
    /// ζ.
    pub damping_ratio: f64,
    /// ρ.
    pub density: f64,
    /// k_c.
    pub contact: f64,
}

impl Parameters {
    /// Parameters of a scene; `contact` is 0 without contact.
    pub fn of(scene: &Scene) -> Self {
        let LigamentStiffness { stretch, shear, bend } = scene.stiffness;
        let contact = scene.contact.map_or(0.0, |c| c.stiffness);
        Self { stretch, shear, bend, damping_ratio: scene.damping_ratio, density: scene.density, contact }
    }

    /// `scene` with these parameters.
    pub fn set(self, scene: &Scene) -> Scene {
        let Self { stretch, shear, bend, damping_ratio, density, contact: stiffness } = self;
        let contact = scene.contact.map(|c| EdgeContact { stiffness, ..c });
        let stiffness = LigamentStiffness { stretch, shear, bend };
        Scene { stiffness, damping_ratio, density, contact, ..scene.clone() }
    }

    /// Values in the order of the fields.
    pub fn array(self) -> [f64; 6] {
        let Self { stretch, shear, bend, damping_ratio, density, contact } = self;
        [stretch, shear, bend, damping_ratio, density, contact]
    }

    /// From values in the order of the fields.
    pub fn from_array([stretch, shear, bend, damping_ratio, density, contact]: [f64; 6]) -> Self {
        Self { stretch, shear, bend, damping_ratio, density, contact }
    }
}

/// Factors of single ligaments and units, or a gradient in them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PartFactors {
    /// Factors on k_l, k_s, k_θ of each ligament; empty if all are 1. C does not depend on them.
    pub ligaments: Vec<[f64; 3]>,
    /// Factor on the density of each unit; empty if all are 1.
    pub units: Vec<f64>,
}

/// Maxwell branch: a spring and a dashpot in series, parallel to each stiffness of every ligament.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MaxwellBranch {
    /// g: stiffness of the spring divided by that of the ligament.
    pub share: f64,
    /// τ (s): time in which the branch force falls to 1/e.
    pub time: f64,
}

/// Additional mass on the centroid of a unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AddedMass {
    /// Mass (Mg).
    pub mass: f64,
    /// Moment of inertia about the centroid (Mg·mm²).
    pub moment: f64,
}

impl AddedMass {
    /// (m, m, J) of the chip on a unit; zero without a chip.
    pub(super) fn mass_on_unit(scene: &Scene, unit: usize) -> [f64; 3] {
        match scene.chip {
            Some(Self { mass, moment }) if scene.sensors.contains(&unit) => [mass, mass, moment],
            _ => [0.0; 3],
        }
    }
}

/// Position and orientation of a chip on its unit.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mount {
    /// r from the centroid to the chip, in the unit's frame (mm).
    pub offset: [f64; 2],
    /// Rotation of the chip's axes against the frame (rad).
    pub tilt: f64,
}

/// Frame of measured accelerations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum AccelerationFrame {
    /// Fixed axes.
    #[default]
    World,
    /// Rotates with the unit: the acceleration rotated by −θ.
    Body,
}

/// A force on a unit. Direction and undeformed arm stay constant while the unit rotates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Panel {
    /// The unit.
    pub unit: usize,
    /// Unit vector of a positive force; zero for a couple.
    pub direction: [f64; 2],
    /// Node of the unit on which the force acts; `None`: the centroid.
    pub node: Option<usize>,
    /// Moment of 1 N about that point (mm), for an offset force or a couple.
    pub moment: f64,
    /// Motion prescribed by the history in place of a force, if any.
    pub moves: Option<PrescribedMotion>,
}

/// Prescribed motion: the acceleration is f divided by this mass (Mg).
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PrescribedMotion {
    /// Base to which all held units are fixed, including the panel's unit. Displacements are relative to the base; sensors measure
    /// absolute accelerations.
    Base(f64),
    /// The panel's unit, which then does not rotate. It must not be held, and no other panel may push it.
    Unit(f64),
}

impl Panel {
    /// A force on the centroid of a unit.
    pub fn central(unit: usize, direction: [f64; 2]) -> Self {
        Self { unit, direction, node: None, moment: 0.0, moves: None }
    }

    /// Acceleration of the base per newton (mm/s²), if the panel shakes the base.
    pub fn base_acceleration(&self) -> Option<[f64; 2]> {
        match self.moves {
            Some(PrescribedMotion::Base(mass)) => Some(self.direction.map(|d| d / mass)),
            _ => None,
        }
    }

    /// Acceleration of the unit per newton (mm/s²), if the panel drives its unit.
    pub fn unit_acceleration(&self) -> Option<[f64; 2]> {
        match self.moves {
            Some(PrescribedMotion::Unit(mass)) => Some(self.direction.map(|d| d / mass)),
            _ => None,
        }
    }

    /// Point of application for a unit with this centroid and these corners: the foot of the line of force; for a couple, the
    /// centroid.
    pub fn foot(&self, centroid: [f64; 2], corners: &[[f64; 2]]) -> [f64; 2] {
        let ([x, y], [p, q]) = (self.node.map_or(centroid, |node| corners[node]), self.direction);
        [x + self.moment * q, y - self.moment * p]
    }
}

/// All inputs of a simulation except design and forces. The default has no units.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Scene {
    /// Units and ligaments.
    pub layout: Layout,
    /// Plane density (Mg/mm²).
    pub density: f64,
    /// Stiffnesses of the ligaments.
    pub stiffness: LigamentStiffness,
    /// Factors of single ligaments and units.
    pub parts: PartFactors,
    /// Relaxation of ligaments, only for evaluation: such a scene has no gradient.
    pub relaxation: Option<MaxwellBranch>,
    /// ζ; a factor on C if `damping` is given.
    pub damping_ratio: f64,
    /// C of every unit (N·s/mm, N·s/mm, N·mm·s) at ζ = 1. `None`: computed from the mean unit.
    pub damping: Option<[f64; 3]>,
    /// Design α (mm) that sets the masses and moments of inertia of all designs. `None`: each design sets its own.
    pub inertia: Option<Vec<f64>>,
    /// Contact, if any; scenes without contact use faster kernels.
    pub contact: Option<EdgeContact>,
    /// Whether strains are linear in the displacements.
    pub linearised: bool,
    /// Clamped units.
    pub clamped: Vec<usize>,
    /// Guided units, each with whether u, v, θ is held.
    pub guided: Vec<(usize, [bool; 3])>,
    /// Displacement imposed on the clamped units, then on the guided units, before each sample (mm). Empty: none. Samples start in
    /// the resulting equilibrium.
    pub imposed: Vec<[f64; 2]>,
    /// The K panels.
    pub panels: Vec<Panel>,
    /// Units of the M sensors.
    pub sensors: Vec<usize>,
    /// Mass and inertia that each chip adds to its unit, if any.
    pub chip: Option<AddedMass>,
    /// Position and orientation of all chips; `None`: on the centroid, not tilted.
    pub mount: Option<Mount>,
    /// Frame of measured accelerations.
    pub frame: AccelerationFrame,
    /// Length of a sample (s).
    pub duration: f64,
    /// T, number of instants.
    pub instants: usize,
}

impl Scene {
    /// Geometry, masses and moments of inertia of `design`.
    ///
    /// # Panics
    /// If the length of the design or of a list of factors does not match the layout.
    pub fn geometry(&self, design: &[f64]) -> Geometry {
        let PartFactors { ligaments, units } = &self.parts;
        let counts = [ligaments.len(), units.len()];
        for (given, parts) in counts.into_iter().zip([self.layout.ligaments.len(), self.layout.units()]) {
            assert!(given == 0 || given == parts, "{given} factors given for {parts} ligaments or units");
        }
        let mut geometry = Geometry::new(&self.layout, design, self.density);
        if let Some(kept) = &self.inertia {
            let Geometry { mass, moment, .. } = Geometry::new(&self.layout, kept, self.density);
            (geometry.mass, geometry.moment) = (mass, moment);
        }
        let Geometry { mass, moment, .. } = &mut geometry;
        mass.iter_mut().zip(units).for_each(|(m, by)| *m *= by);
        moment.iter_mut().zip(units).for_each(|(j, by)| *j *= by);
        geometry
    }

    /// Whether u, v, θ of a unit are held.
    pub fn holds(&self, unit: usize) -> [bool; 3] {
        let guided = self.guided.iter().find(|(other, _)| *other == unit);
        if self.clamped.contains(&unit) { [true; 3] } else { guided.map_or([false; 3], |(_, held)| *held) }
    }

    /// Whether the body can move as a whole.
    pub fn is_loose(&self) -> bool {
        // change of each held displacement under a shift along x, a shift along y, and a rotation
        let held = (0..self.layout.units()).flat_map(|unit| {
            let [x, y] = self.layout.centres[unit].map(|x| x / self.layout.spacing);
            let rows = [[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]];
            self.holds(unit).into_iter().zip(rows).filter(|(held, _)| *held).map(|(_, row)| row.into())
        });
        let rows: Vec<RowVector3<f64>> = held.collect();
        rows.is_empty() || MatrixXx3::from_rows(&rows).rank(1e-9) < 3
    }

    /// Held units with their displacements before a sample.
    pub(super) fn held_displacements(&self) -> impl Iterator<Item = (usize, [f64; 2])> {
        let held = self.clamped.iter().copied().chain(self.guided.iter().map(|guided| guided.0));
        held.zip(self.imposed.iter().copied())
    }

    /// Whether a panel prescribes the motion of a unit.
    pub fn is_driven(&self, unit: usize) -> bool {
        self.panels.iter().any(|panel| panel.unit == unit && panel.unit_acceleration().is_some())
    }

    /// Acceleration of the base (mm/s²) at a kink of the histories (K, R+1).
    pub(super) fn base_at(&self, history: &[f64], kink: usize) -> [f64; 2] {
        let row = history.len() / self.panels.len().max(1);
        let mut base = [0.0; 2];
        for (panel, own) in self.panels.iter().zip(history.chunks_exact(row.max(1))) {
            let Some(shakes) = panel.base_acceleration() else { continue };
            (0..2).for_each(|d| base[d] += shakes[d] * own[kink]);
        }
        base
    }

    /// Whether signals depend on the rotation of units.
    pub(super) fn reads_turns(&self) -> bool {
        self.frame == AccelerationFrame::Body || self.mount.is_some()
    }
}
