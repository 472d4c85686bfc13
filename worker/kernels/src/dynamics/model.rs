//! A scene with a design, in the form that the kernels read.

use super::{Contact, Inertia, Outcome, Panel, Parameters, Parts, Scene, Stiffness, Strike};
use crate::body::{End, Geometry, void_angles_vjp};
use crate::lanes::Scalar;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Mass of a driven unit by that of the mean one. Ligaments pull at most a thousand times as hard as it takes to accelerate a mean unit
/// so: the driven one's motion is off by 1e-9. What moves it is far from the limits of f32.
const HEAVY: f64 = 1e12;

/// A ligament with what the kernel needs of its ends.
#[derive(Debug, Clone, Copy)]
pub struct Bar<S = f64> {
    /// Its place among the layout's ligaments.
    pub index: usize,
    /// Units at the ends.
    pub a: usize,
    /// Likewise.
    pub b: usize,
    /// Nodes at the ends, by their numbers among all.
    pub node_a: usize,
    /// Likewise.
    pub node_b: usize,
    /// Arms from the centroids to the ends (mm).
    pub arm_a: [f64; 2],
    /// Likewise.
    pub arm_b: [f64; 2],
    /// The same, in a kernel's scalar.
    pub lever_a: [S; 2],
    /// Likewise.
    pub lever_b: [S; 2],
    /// Unit vector along the reference.
    pub e: [S; 2],
    /// l₀ (mm).
    pub length: S,
    /// k_l, k_s, k_θ.
    pub stiffness: [S; 3],
    /// By how much they are those of the scene.
    pub factors: [S; 3],
    /// k_l l₀ (N).
    pub tension: S,
    /// k_s l₀² (N·mm).
    pub twist: S,
    /// Void angles at rest, on the branch [−π/2, 3π/2).
    pub voids: [S; 2],
}

impl Bar {
    /// Rounded to a kernel's scalar.
    pub fn rounded<S: Scalar>(&self) -> Bar<S> {
        let Self { index, a, b, node_a, node_b, arm_a, arm_b, e, length, tension, twist, voids, .. } = *self;
        Bar {
            index,
            a,
            b,
            node_a,
            node_b,
            arm_a,
            arm_b,
            lever_a: arm_a.map(S::from_f64),
            lever_b: arm_b.map(S::from_f64),
            e: e.map(S::from_f64),
            length: S::from_f64(length),
            stiffness: self.stiffness.map(S::from_f64),
            factors: self.factors.map(S::from_f64),
            tension: S::from_f64(tension),
            twist: S::from_f64(twist),
            voids: voids.map(S::from_f64),
        }
    }
}

/// A scene with a design.
#[derive(Debug, Clone)]
pub struct Model {
    /// Ligaments.
    pub bars: Vec<Bar>,
    /// How many the layout has.
    pub ligaments: usize,
    /// Contact.
    pub contact: Option<Contact>,
    /// 1/(m, m, J) of each unit; zero where held, next to it where driven.
    pub inverse_mass: Vec<[f64; 3]>,
    /// C (N·s/mm, N·s/mm, N·mm·s).
    pub damping: [f64; 3],
    /// Units that move, in order.
    pub free: Vec<usize>,
    /// Units whose motion is given, in order; they are among the free ones.
    pub driven: Vec<usize>,
    /// Of each panel that drives its unit what 1 N does to it.
    pub drives: Vec<Option<Strike>>,
    /// The design's geometry.
    pub geometry: Geometry,
    /// Of each panel the number, among all, of the node that it acts on.
    pub struck: Vec<Option<usize>>,
    /// Where each unit is when a sample begins; empty where none has been moved. Or why there is no such place.
    pub start: Result<Vec<[f64; 3]>, Outcome>,
}

/// C = ζ(2√(m̂ k_s), 2√(m̂ k_s), 2√(Ĵ k_θ)) of the mean undisplaced unit, so that damping does not depend on the design; or ζ times
/// what the scene gives.
pub fn damping(scene: &Scene) -> [f64; 3] {
    if let Some(given) = scene.damping {
        return given.map(|c| scene.damping_ratio * c);
    }
    let (area, round) = scene.layout.mean_unit();
    let (mass, moment) = (scene.density * area, scene.density * area.powi(2) / 6.0 * round);
    let shift = 2.0 * scene.damping_ratio * (mass * scene.stiffness.shear).sqrt();
    let turn = 2.0 * scene.damping_ratio * (moment * scene.stiffness.bend).sqrt();
    [shift, shift, turn]
}

/// (m, m, J) of a driven unit, of no design.
pub(super) fn heavy(scene: &Scene) -> [f64; 3] {
    let (area, round) = scene.layout.mean_unit();
    let mass = HEAVY * scene.density * area;
    [mass, mass, mass * area / 6.0 * round]
}

impl Model {
    /// The model of `scene` with `design` as cast, whatever its held units are moved by.
    pub fn cast(scene: &Scene, design: &[f64]) -> Self {
        let layout = &scene.layout;
        let geometry = scene.geometry(design);
        let voids = geometry.void_angles(layout);
        let branch = |psi: f64| if psi < -FRAC_PI_2 { psi + TAU } else { psi };
        let bar = |(index, (l, voids)): (usize, (&crate::body::Ligament, &[f64; 2]))| {
            let length = l.reference[0].hypot(l.reference[1]);
            let Stiffness { stretch, shear, bend } = scene.stiffness;
            let factors = scene.parts.ligaments.get(index).copied().unwrap_or([1.0; 3]);
            let stiffness = [stretch * factors[0], shear * factors[1], bend * factors[2]];
            let [arm_a, arm_b] = [l.a, l.b].map(|end| geometry.arms[layout.number(end)]);
            Bar {
                index,
                a: l.a.unit,
                b: l.b.unit,
                node_a: layout.number(l.a),
                node_b: layout.number(l.b),
                arm_a,
                arm_b,
                lever_a: arm_a,
                lever_b: arm_b,
                e: [l.reference[0] / length, l.reference[1] / length],
                length,
                stiffness,
                factors,
                tension: stiffness[0] * length,
                twist: stiffness[1] * length * length,
                voids: voids.map(branch),
            }
        };
        let bars = layout.ligaments.iter().zip(&voids).enumerate().map(bar).collect();
        let number = |panel: &Panel| panel.node.map(|node| layout.number(End { unit: panel.unit, node }));
        let own = geometry.mass.iter().zip(&geometry.moment).map(|(m, j)| [*m, *m, *j]);
        let inverse = |(unit, own): (usize, [f64; 3])| {
            let chip = Inertia::on(scene, unit);
            std::array::from_fn(|d| 1.0 / (own[d] + chip[d]))
        };
        let mut inverse_mass: Vec<[f64; 3]> = own.enumerate().map(inverse).collect();
        for (u, inverse) in inverse_mass.iter_mut().enumerate() {
            let held = scene.holds(u);
            (0..3).filter(|d| held[*d]).for_each(|d| inverse[d] = 0.0);
        }
        let driven: Vec<usize> = (0..layout.units()).filter(|u| scene.is_driven(*u)).collect();
        let heavy = heavy(scene);
        for &u in &driven {
            inverse_mass[u] = heavy.map(f64::recip);
        }
        let drives = |panel: &Panel| panel.drives().map(|[x, y]| [heavy[0] * x, heavy[1] * y, 0.0]);
        Self {
            bars,
            ligaments: layout.ligaments.len(),
            contact: scene.contact,
            inverse_mass,
            damping: damping(scene),
            driven,
            drives: scene.panels.iter().map(drives).collect(),
            free: (0..layout.units()).filter(|u| !scene.clamped.contains(u)).collect(),
            geometry,
            struck: scene.panels.iter().map(number).collect(),
            start: Ok(Vec::new()),
        }
    }

    /// Where each unit is when a sample begins; empty: as cast. So is a body that has no such place, whose samples all fail.
    pub fn start(&self) -> &[[f64; 3]] {
        self.start.as_deref().unwrap_or(&[])
    }

    /// Mass of a unit that moves, its chip's with it (Mg); 0 of one that does but turn.
    pub fn mass(&self, unit: usize) -> f64 {
        let [x, y, _] = self.inverse_mass[unit];
        if x == 0.0 && y == 0.0 { 0.0 } else { x.max(y).recip() }
    }

    /// What a strike on a panel does about the centroid of its unit; one that drives it strikes nowhere else.
    pub fn about_centroid(&self, panel: usize, [x, y, moment]: Strike) -> Strike {
        if let Some(drives) = self.drives[panel] {
            return drives;
        }
        let [p, q] = self.struck[panel].map_or([0.0; 2], |node| self.geometry.arms[node]);
        [x, y, moment + (p * y - q * x)]
    }

    /// Without the ligaments between held units, which never change; but for those whose contact is forbidden from the start.
    pub fn moving(mut self) -> Self {
        let moves = |u: usize| self.inverse_mass[u] != [0.0; 3];
        let least = self.contact.map_or(f64::NEG_INFINITY, |c| c.min_angle);
        self.bars.retain(|b| moves(b.a) || moves(b.b) || b.voids.iter().any(|psi| *psi < least));
        self
    }

    /// Whether contact may act at rest, against which nothing holds the body as it is cast.
    pub fn touches(&self) -> bool {
        if !self.start().is_empty() {
            return false;
        }
        let cutoff = self.contact.map_or(f64::NEG_INFINITY, |c| c.cutoff_angle);
        self.bars.iter().any(|b| b.voids.iter().any(|psi| *psi < cutoff))
    }

    /// From the first to the last unit that moves.
    pub fn moving_range(&self) -> std::ops::Range<usize> {
        self.free.first().map_or(0..0, |first| *first..self.free[self.free.len() - 1] + 1)
    }

    /// Number of units.
    pub fn units(&self) -> usize {
        self.inverse_mass.len()
    }
}

/// Cotangents of what a model takes from its design.
#[derive(Debug, Clone)]
pub struct ModelCotangent {
    /// Of the arms.
    pub arms: Vec<[f64; 2]>,
    /// Of (m, m, J).
    pub mass: Vec<[f64; 3]>,
    /// Of the void angles at rest.
    pub voids: Vec<[f64; 2]>,
    /// Of k_l, k_s, k_θ of each ligament, where asked for, C held.
    pub stiffness: Vec<[f64; 3]>,
    /// Of k_c, likewise.
    pub contact: f64,
    /// Of C, where asked for.
    pub damping: [f64; 3],
    /// Of where units are when a sample begins.
    pub start: Vec<[f64; 3]>,
}

impl ModelCotangent {
    /// Zero.
    pub fn new(model: &Model) -> Self {
        let n = model.units();
        Self {
            arms: vec![[0.0; 2]; model.geometry.arms.len()],
            mass: vec![[0.0; 3]; n],
            voids: vec![[0.0; 2]; model.ligaments],
            stiffness: vec![[0.0; 3]; model.ligaments],
            contact: 0.0,
            damping: [0.0; 3],
            start: vec![[0.0; 3]; n],
        }
    }

    /// Adds another.
    pub fn add(&mut self, other: &Self) {
        let add = |to: &mut [f64], from: &[f64]| to.iter_mut().zip(from).for_each(|(t, f)| *t += f);
        add(self.arms.as_flattened_mut(), other.arms.as_flattened());
        add(self.mass.as_flattened_mut(), other.mass.as_flattened());
        add(self.voids.as_flattened_mut(), other.voids.as_flattened());
        add(self.stiffness.as_flattened_mut(), other.stiffness.as_flattened());
        self.contact += other.contact;
        add(&mut self.damping, &other.damping);
        add(self.start.as_flattened_mut(), other.start.as_flattened());
    }

    /// Gradient in the parameters, where it was asked for: C ∝ ζ √ρ (√k_s, √k_s, √k_θ), or ζ alone where it is given; masses ∝ ρ.
    pub fn parameters(&self, model: &Model, scene: &Scene) -> Parameters {
        let follows = if scene.damping.is_some() { 0.0 } else { 1.0 };
        let c: [f64; 3] = std::array::from_fn(|d| follows * self.damping[d] * model.damping[d]);
        let per_ratio = damping(&Scene { damping_ratio: 1.0, ..scene.clone() });
        let own = |bar: &Bar| std::array::from_fn(|k| bar.factors[k] * self.stiffness[bar.index][k]);
        let add = |sum: [f64; 3], own: [f64; 3]| std::array::from_fn(|k| sum[k] + own[k]);
        let [stretch, shear, bend] = model.bars.iter().map(own).fold([0.0; 3], add);
        let mass = self.mass.iter().zip(&model.geometry.mass).map(|(bar, m)| (bar[0] + bar[1]) * m);
        let moment = self.mass.iter().zip(&model.geometry.moment).map(|(bar, j)| bar[2] * j);
        Parameters {
            stretch,
            shear: shear + 0.5 * (c[0] + c[1]) / scene.stiffness.shear,
            bend: bend + 0.5 * c[2] / scene.stiffness.bend,
            damping_ratio: (0..3).map(|d| self.damping[d] * per_ratio[d]).sum(),
            density: (mass.chain(moment).sum::<f64>() + 0.5 * c.iter().sum::<f64>()) / scene.density,
            contact: self.contact,
        }
    }

    /// Gradient in the factors of parts, likewise.
    pub fn parts(&self, model: &Model, scene: &Scene) -> Parts {
        let Stiffness { stretch, shear, bend } = scene.stiffness;
        let by = |own: &[f64; 3]| [stretch * own[0], shear * own[1], bend * own[2]];
        let Geometry { mass, moment, .. } = &model.geometry;
        let unit = |u: usize| {
            let [x, y, turn] = self.mass[u];
            ((x + y) * mass[u] + turn * moment[u]) / scene.parts.units.get(u).unwrap_or(&1.0)
        };
        Parts {
            ligaments: self.stiffness.iter().map(by).collect(),
            units: (0..model.units()).map(unit).collect(),
        }
    }

    /// Gradient in the design.
    pub fn design(mut self, model: &Model, scene: &Scene) -> Vec<f64> {
        let Scene { layout, density, parts, .. } = scene;
        if model.contact.is_some() {
            void_angles_vjp(&model.geometry, layout, &self.voids, &mut self.arms);
        }
        self.mass.iter_mut().zip(&parts.units).for_each(|(m, by)| m.iter_mut().for_each(|m| *m *= by));
        if scene.inertia.is_some() {
            self.mass.fill([0.0; 3]);
        }
        let mass: Vec<f64> = self.mass.iter().map(|m| m[0] + m[1]).collect();
        let moment: Vec<f64> = self.mass.iter().map(|m| m[2]).collect();
        model.geometry.vjp(layout, *density, &self.arms, &mass, &moment)
    }
}
