//! What is simulated, but for design and forces: body, material, contact, where it is struck and where it is read.

use crate::body::{Geometry, Layout};
use nalgebra::{MatrixXx3, RowVector3};

/// Stiffnesses of a ligament.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stiffness {
    /// k_l (N/mm).
    pub stretch: f64,
    /// k_s (N/mm).
    pub shear: f64,
    /// k_θ (N·mm/rad).
    pub bend: f64,
}

/// Contact between the edges that face each other across a ligament.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// k_c (N·mm/rad²).
    pub stiffness: f64,
    /// ψ_min (rad): no state has a smaller void angle.
    pub min_angle: f64,
    /// ψ_c (rad): no contact from here on.
    pub cutoff_angle: f64,
}

/// The material's parameters, what is done to them, or a gradient in them.
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
    /// Plane density.
    pub density: f64,
    /// k_c.
    pub contact: f64,
}

impl Parameters {
    /// Those of a scene; `contact` is zero in one without.
    pub fn of(scene: &Scene) -> Self {
        let Stiffness { stretch, shear, bend } = scene.stiffness;
        let contact = scene.contact.map_or(0.0, |c| c.stiffness);
        Self { stretch, shear, bend, damping_ratio: scene.damping_ratio, density: scene.density, contact }
    }

    /// The scene with these.
    pub fn set(self, scene: &Scene) -> Scene {
        let Self { stretch, shear, bend, damping_ratio, density, contact: stiffness } = self;
        let contact = scene.contact.map(|c| Contact { stiffness, ..c });
        Scene {
            stiffness: Stiffness { stretch, shear, bend },
            damping_ratio,
            density,
            contact,
            ..scene.clone()
        }
    }

    /// In the order of the fields.
    pub fn array(self) -> [f64; 6] {
        let Self { stretch, shear, bend, damping_ratio, density, contact } = self;
        [stretch, shear, bend, damping_ratio, density, contact]
    }

    /// Likewise.
    pub fn from_array([stretch, shear, bend, damping_ratio, density, contact]: [f64; 6]) -> Self {
        Self { stretch, shear, bend, damping_ratio, density, contact }
    }
}

/// How the parts of one body differ from its material, or a gradient in that.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Parts {
    /// By what k_l, k_s, k_θ of each ligament are multiplied; empty where all are alike. C does not depend on it.
    pub ligaments: Vec<[f64; 3]>,
    /// By what the density of each unit is multiplied; likewise.
    pub units: Vec<f64>,
}

/// Maxwell's branch of every ligament: beside each of its stiffnesses a spring and a dashpot in series.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Relaxation {
    /// g: the spring's stiffness by that of the ligament.
    pub share: f64,
    /// τ (s) in which its force falls to 1/e.
    pub time: f64,
}

/// Mass on the centroid of a unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inertia {
    /// m (Mg).
    pub mass: f64,
    /// J about the centroid (Mg·mm²).
    pub moment: f64,
}

impl Inertia {
    /// Of the chip on a unit of a scene: (m, m, J), zero where it carries none.
    pub(super) fn on(scene: &Scene, unit: usize) -> [f64; 3] {
        match scene.chip {
            Some(Self { mass, moment }) if scene.sensors.contains(&unit) => [mass, mass, moment],
            _ => [0.0; 3],
        }
    }
}

/// How a chip sits on its unit.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mount {
    /// r from the centroid, in the unit's frame (mm): the chip reads the acceleration there.
    pub offset: [f64; 2],
    /// By how much its axes are turned against the frame's (rad).
    pub tilt: f64,
}

/// The frame in which accelerations are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Frame {
    /// Fixed axes.
    World,
    /// Turning with the unit: the acceleration rotated by −θ.
    Body,
}

/// Where and how a force acts on a unit; it keeps its direction, and its lever at rest, however the unit turns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Panel {
    /// The unit.
    pub unit: usize,
    /// Unit vector along which a positive force pushes; zero of a couple.
    pub direction: [f64; 2],
    /// The unit's node that it acts on, which the design moves; none: the centroid.
    pub node: Option<usize>,
    /// Moment of 1 N about that point (mm): of a force beside it, or of a couple.
    pub moment: f64,
    /// What is accelerated along the direction in place of a force on the unit; none: nothing.
    pub moves: Option<Moves>,
}

/// What a panel moves as its history says, whatever the ligaments pull: its acceleration is f over this mass (Mg).
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Moves {
    /// What all held units are fixed to; the panel's unit is one of them. The scene's places are then those in its frame, and sensors
    /// read what they feel, the base's motion with it.
    Base(f64),
    /// The panel's unit alone, which does not turn. No panel pushes it, and it is none of the held ones.
    Unit(f64),
}

impl Panel {
    /// On the centroid of a unit.
    pub fn central(unit: usize, direction: [f64; 2]) -> Self {
        Self { unit, direction, node: None, moment: 0.0, moves: None }
    }

    /// The acceleration of the base under 1 N (mm/s²).
    pub fn shakes(&self) -> Option<[f64; 2]> {
        match self.moves {
            Some(Moves::Base(mass)) => Some(self.direction.map(|d| d / mass)),
            _ => None,
        }
    }

    /// The acceleration of the unit under 1 N (mm/s²), where it is the panel that moves it.
    pub fn drives(&self) -> Option<[f64; 2]> {
        match self.moves {
            Some(Moves::Unit(mass)) => Some(self.direction.map(|d| d / mass)),
            _ => None,
        }
    }

    /// Where it acts on a unit of this centroid and these corners: the foot of its line, of a couple the centroid.
    pub fn foot(&self, centroid: [f64; 2], corners: &[[f64; 2]]) -> [f64; 2] {
        let ([x, y], [p, q]) = (self.node.map_or(centroid, |node| corners[node]), self.direction);
        [x + self.moment * q, y - self.moment * p]
    }
}

/// Everything of a simulation but design and forces.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Units and ligaments.
    pub layout: Layout,
    /// Plane density (Mg/mm²).
    pub density: f64,
    /// Ligaments.
    pub stiffness: Stiffness,
    /// How single ligaments and units differ.
    pub parts: Parts,
    /// How ligaments relax, in worlds that training never sees: such a scene has no gradient.
    pub relaxation: Option<Relaxation>,
    /// ζ; by what C is multiplied where `damping` gives that.
    pub damping_ratio: f64,
    /// C of every unit (N·s/mm, N·s/mm, N·mm·s) for ζ = 1, if not that of the mean unit.
    pub damping: Option<[f64; 3]>,
    /// α (mm) of the design whose masses and moments of inertia all designs have, if not their own.
    pub inertia: Option<Vec<f64>>,
    /// Contact; a scene without does not pay for it.
    pub contact: Option<Contact>,
    /// Linear strain measures.
    pub linearised: bool,
    /// Held units.
    pub clamped: Vec<usize>,
    /// Units that are held in part, as on a roller or in a guide, and whether each of u, v, θ is.
    pub guided: Vec<(usize, [bool; 3])>,
    /// By how much the clamped units, and after them the guided ones where they are held, have been moved before a sample (mm), which
    /// begins where the others then are at rest; empty: by nothing, and the body is as cast.
    pub pressed: Vec<[f64; 2]>,
    /// K input panels.
    pub panels: Vec<Panel>,
    /// Units of the M sensors.
    pub sensors: Vec<usize>,
    /// What each sensor's chip adds to its unit; a scene without does not pay for it.
    pub chip: Option<Inertia>,
    /// How they sit; on the centroid and straight in a scene without, which does not pay for it.
    pub mount: Option<Mount>,
    /// How sensors read.
    pub frame: Frame,
    /// Length of a sample (s).
    pub duration: f64,
    /// T.
    pub instants: usize,
}

impl Scene {
    /// What a design is in it.
    ///
    /// # Panics
    /// If the design's length is not the layout's, or a part's factor is missing.
    pub fn geometry(&self, design: &[f64]) -> Geometry {
        let Parts { ligaments, units } = &self.parts;
        let counts = [ligaments.len(), units.len()];
        for (given, parts) in counts.into_iter().zip([self.layout.ligaments.len(), self.layout.units()]) {
            assert!(given == 0 || given == parts, "{given} factors of {parts} parts");
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

    /// Whether each of u, v, θ of a unit is held.
    pub fn holds(&self, unit: usize) -> [bool; 3] {
        let guided = self.guided.iter().find(|(other, _)| *other == unit);
        if self.clamped.contains(&unit) { [true; 3] } else { guided.map_or([false; 3], |(_, held)| *held) }
    }

    /// Whether the body as a whole can move or turn against nothing that is held.
    pub fn is_loose(&self) -> bool {
        // of each held displacement what a shift along x, along y and a turn by a pitch do to it
        let held = (0..self.layout.units()).flat_map(|unit| {
            let [x, y] = self.layout.centres[unit].map(|x| x / self.layout.spacing);
            let rows = [[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]];
            self.holds(unit).into_iter().zip(rows).filter(|(held, _)| *held).map(|(_, row)| row.into())
        });
        let rows: Vec<RowVector3<f64>> = held.collect();
        rows.is_empty() || MatrixXx3::from_rows(&rows).rank(1e-9) < 3
    }

    /// Every unit that is held somehow with its way before a sample.
    pub(super) fn ways(&self) -> impl Iterator<Item = (usize, [f64; 2])> {
        let held = self.clamped.iter().copied().chain(self.guided.iter().map(|guided| guided.0));
        held.zip(self.pressed.iter().copied())
    }

    /// Whether a unit's motion is given.
    pub fn is_driven(&self, unit: usize) -> bool {
        self.panels.iter().any(|panel| panel.unit == unit && panel.drives().is_some())
    }

    /// The acceleration of the base under these histories, (K, R+1), at a kink (mm/s²).
    pub(super) fn base_at(&self, history: &[f64], kink: usize) -> [f64; 2] {
        let row = history.len() / self.panels.len().max(1);
        let mut base = [0.0; 2];
        for (panel, own) in self.panels.iter().zip(history.chunks_exact(row.max(1))) {
            let Some(shakes) = panel.shakes() else { continue };
            (0..2).for_each(|d| base[d] += shakes[d] * own[kink]);
        }
        base
    }

    /// Whether readings depend on how units have turned.
    pub(super) fn reads_turns(&self) -> bool {
        self.frame == Frame::Body || self.mount.is_some()
    }
}
