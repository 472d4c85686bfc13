//! Combines a scene with a design in the form that the kernels use.

use super::ligaments::ShapeCotangent;
use super::{
    AddedMass, EdgeContact, LigamentStiffness, Outcome, Panel, Parameters, PartFactors, Scene, Strike,
};
use crate::body::{End, Geometry, void_angles_vjp};
use crate::lanes::Scalar;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Mass of a driven unit divided by the mean mass of a unit. If ligament forces are at most a thousand times those that accelerate a
/// mean unit equally, the relative error of the driven motion is 1e-9. The driving forces stay far from the limits of f32.
const HEAVY: f64 = 1e12;

/// A ligament with the data of its ends.
#[derive(Debug, Clone, Copy)]
pub struct Bar<S = f64> {
    /// Index among the layout's ligaments.
    pub index: usize,
    /// Unit at end a.
    pub a: usize,
    /// Unit at end b.
    pub b: usize,
    /// Global number of the node at end a.
    pub node_a: usize,
    /// Global number of the node at end b.
    pub node_b: usize,
    /// Arm from the centroid of unit a to its node (mm).
    pub arm_a: [f64; 2],
    /// Arm from the centroid of unit b to its node (mm).
    pub arm_b: [f64; 2],
    /// `arm_a` in the kernel's scalar type.
    pub lever_a: [S; 2],
    /// `arm_b` in the kernel's scalar type.
    pub lever_b: [S; 2],
    /// Unit vector along d₀.
    pub e: [S; 2],
    /// Length |d₀| (mm).
    pub length: S,
    /// k_l, k_s, k_θ.
    pub stiffness: [S; 3],
    /// Factors on the scene's k_l, k_s, k_θ.
    pub factors: [S; 3],
    /// k_l l₀ (N).
    pub tension: S,
    /// k_s l₀² (N·mm).
    pub twist: S,
    /// Void angles at rest, on the branch [−π/2, 3π/2).
    pub voids: [S; 2],
}

impl Bar {
    /// Converts to a kernel's scalar type.
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
    /// Number of ligaments of the layout.
    pub ligaments: usize,
    /// Contact.
    pub contact: Option<EdgeContact>,
    /// 1/(m, m, J) of each unit; 0 for held coordinates, nearly 0 for driven units.
    pub inverse_mass: Vec<[f64; 3]>,
    /// C (N·s/mm, N·s/mm, N·mm·s).
    pub damping: [f64; 3],
    /// Units that are not clamped, in ascending order.
    pub free: Vec<usize>,
    /// Units with prescribed motion, in ascending order; a subset of `free`.
    pub driven: Vec<usize>,
    /// Force and moment on the unit per newton, for each panel that drives its unit.
    pub drives: Vec<Option<Strike>>,
    /// Geometry of the design.
    pub geometry: Geometry,
    /// Global number of the node on which each panel acts, if it acts on a node.
    pub struck: Vec<Option<usize>>,
    /// State of each unit at the start of a sample, empty if all are zero; or the reason why no such state exists.
    pub start: Result<Vec<[f64; 3]>, Outcome>,
}

/// Least mass of a unit relative to the mean. Lighter units would need steps of no use.
const VANISHED: f64 = 1e-3;

/// C = ζ(2√(m̂ k_s), 2√(m̂ k_s), 2√(Ĵ k_θ)) for the mean undisplaced unit, so damping does not depend on the design; or ζ times the
/// given C.
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

/// A void angle (rad) on its branch: below −90° it is one above 180°.
pub fn unwrapped_void(psi: f64) -> f64 {
    if psi < -FRAC_PI_2 { psi + TAU } else { psi }
}

/// (m, m, J) of a driven unit; independent of the design.
pub(super) fn driven_mass(scene: &Scene) -> [f64; 3] {
    let (area, round) = scene.layout.mean_unit();
    let mass = HEAVY * scene.density * area;
    [mass, mass, mass * area / 6.0 * round]
}

impl Model {
    /// Model of `scene` with `design` before compression.
    pub fn uncompressed(scene: &Scene, design: &[f64]) -> Self {
        let layout = &scene.layout;
        let geometry = scene.geometry(design);
        let voids = geometry.void_angles(layout);
        let bar = |(index, (l, voids)): (usize, (&crate::body::Ligament, &[f64; 2]))| {
            let length = l.reference[0].hypot(l.reference[1]);
            let LigamentStiffness { stretch, shear, bend } = scene.stiffness;
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
                voids: voids.map(unwrapped_void),
            }
        };
        let bars = layout.ligaments.iter().zip(&voids).enumerate().map(bar).collect();
        let number = |panel: &Panel| panel.node.map(|node| layout.number(End { unit: panel.unit, node }));
        let mean = geometry.mass.iter().sum::<f64>() / layout.units() as f64;
        // a design that is not finite has its own outcome
        let has_mass =
            !geometry.mass.iter().any(|m| *m <= VANISHED * mean) && !geometry.moment.iter().any(|j| *j < 0.0);
        let own = geometry.mass.iter().zip(&geometry.moment).map(|(m, j)| [*m, *m, *j]);
        let inverse = |(unit, own): (usize, [f64; 3])| {
            let (chip, held) = (AddedMass::mass_on_unit(scene, unit), scene.holds(unit));
            std::array::from_fn(|d| if held[d] { 0.0 } else { 1.0 / (own[d] + chip[d]) })
        };
        let mut inverse_mass: Vec<[f64; 3]> = own.enumerate().map(inverse).collect();
        let driven: Vec<usize> = (0..layout.units()).filter(|u| scene.is_driven(*u)).collect();
        let heavy = driven_mass(scene);
        for &u in &driven {
            inverse_mass[u] = heavy.map(f64::recip);
        }
        let drives =
            |panel: &Panel| panel.unit_acceleration().map(|[x, y]| [heavy[0] * x, heavy[1] * y, 0.0]);
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
            start: if has_mass { Ok(Vec::new()) } else { Err(Outcome::NoMass) },
        }
    }

    /// State of each unit at the start of a sample; empty if all are zero or no start exists (then all samples fail).
    pub fn start(&self) -> &[[f64; 3]] {
        self.start.as_deref().unwrap_or(&[])
    }

    /// Mass of a unit including its chip (Mg); 0 if the unit cannot translate.
    pub fn mass(&self, unit: usize) -> f64 {
        let [x, y, _] = self.inverse_mass[unit];
        if x == 0.0 && y == 0.0 { 0.0 } else { x.max(y).recip() }
    }

    /// Converts a force on a panel to force and moment about the centroid of its unit. Panels that drive their unit ignore `strike`.
    pub fn about_centroid(&self, panel: usize, [x, y, moment]: Strike) -> Strike {
        if let Some(drives) = self.drives[panel] {
            return drives;
        }
        let [p, q] = self.struck[panel].map_or([0.0; 2], |node| self.geometry.arms[node]);
        [x, y, moment + (p * y - q * x)]
    }

    /// Removes ligaments between held units, except those in forbidden contact, which must make samples fail.
    pub fn without_fixed_bars(mut self) -> Self {
        let moves = |u: usize| self.inverse_mass[u] != [0.0; 3];
        let least = self.contact.map_or(f64::NEG_INFINITY, |c| c.min_angle);
        self.bars.retain(|b| moves(b.a) || moves(b.b) || b.voids.iter().any(|psi| *psi < least));
        self
    }

    /// Whether contact acts at rest in a body without compression, which then has no equilibrium.
    pub fn touches(&self) -> bool {
        if !self.start().is_empty() {
            return false;
        }
        let cutoff = self.contact.map_or(f64::NEG_INFINITY, |c| c.cutoff_angle);
        self.bars.iter().any(|b| b.voids.iter().any(|psi| *psi < cutoff))
    }

    /// Index range from the first to the last free unit.
    pub fn moving_range(&self) -> std::ops::Range<usize> {
        self.free.first().map_or(0..0, |first| *first..self.free[self.free.len() - 1] + 1)
    }

    /// Number of units.
    pub fn units(&self) -> usize {
        self.inverse_mass.len()
    }
}

/// Cotangents of the quantities that a model derives from its design.
#[derive(Debug, Clone)]
pub struct ModelCotangent<T = f64> {
    /// Cotangent of the arms.
    pub arms: Vec<[T; 2]>,
    /// Cotangent of (m, m, J) of each unit.
    pub mass: Vec<[T; 3]>,
    /// Cotangent of the void angles at rest.
    pub voids: Vec<[T; 2]>,
    /// Cotangent of k_l, k_s, k_θ of each ligament at constant C; only for parameters.
    pub stiffness: Vec<[T; 3]>,
    /// Cotangent of k_c; only for parameters.
    pub contact: T,
    /// Cotangent of C; only for parameters.
    pub damping: [T; 3],
    /// Cotangent of the state at the start of a sample.
    pub start: Vec<[T; 3]>,
}

impl<T: Copy> ModelCotangent<T> {
    /// All `zero`.
    #[inline(always)]
    pub fn new(model: &Model, zero: T) -> Self {
        let n = model.units();
        Self {
            arms: vec![[zero; 2]; model.geometry.arms.len()],
            mass: vec![[zero; 3]; n],
            voids: vec![[zero; 2]; model.ligaments],
            stiffness: vec![[zero; 3]; model.ligaments],
            contact: zero,
            damping: [zero; 3],
            start: vec![[zero; 3]; n],
        }
    }

    /// Cotangents to which second derivatives of the energy add.
    #[inline(always)]
    pub fn shape(&mut self) -> ShapeCotangent<'_, T> {
        let Self { arms, voids, stiffness, contact, .. } = self;
        ShapeCotangent { arms, voids, stiffness, contact }
    }
}

impl ModelCotangent {
    /// Adds `other`.
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

    /// Gradient in the parameters, if computed: C ∝ ζ √ρ (√k_s, √k_s, √k_θ), or C ∝ ζ if C is given; masses ∝ ρ.
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

    /// Gradient in the factors of ligaments and units, if computed.
    pub fn parts(&self, model: &Model, scene: &Scene) -> PartFactors {
        let LigamentStiffness { stretch, shear, bend } = scene.stiffness;
        let by = |own: &[f64; 3]| [stretch * own[0], shear * own[1], bend * own[2]];
        let Geometry { mass, moment, .. } = &model.geometry;
        let unit = |u: usize| {
            let [x, y, turn] = self.mass[u];
            ((x + y) * mass[u] + turn * moment[u]) / scene.parts.units.get(u).unwrap_or(&1.0)
        };
        PartFactors {
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
