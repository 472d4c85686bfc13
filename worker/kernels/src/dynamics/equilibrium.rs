//! Where a body comes to rest whose held units have been moved, and how that place follows the design.
//!
//! ```text
//! ∂U/∂s(s*, α) = 0 of the units that move,   ds*/dα = −K⁻¹ ∂²U/∂s∂α,   K = ∂²U/∂s² there
//! ```
//! Held units go their way in small parts, and Newton's method, each step as long as the energy falls, brings the others after
//! (Nocedal & Wright, Numerical Optimization, 2006, ch. 3). As K keeps positive definite, the place is the stable one that
//! a slow press leads to; where it ceases to be, the body buckles, and may go one way or another.

use super::ligaments::{ShapeCotangent, Turn, energy, gradient, product, turns};
use super::model::{Model, ModelCotangent};
use super::stiffness::{columns, hessian, sparse, unknowns};
use super::{Outcome, Scene};
use crate::lanes::{Sse2, Vector};
use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::Llt;
use faer::{Mat, Side};

/// Way of held units in a part, in lengths of a ligament, and into how many smaller ones it may be cut.
const PART: f64 = 0.25;
const SMALLEST: f64 = PART / 64.0;
/// Newton steps of a part, and how often one is halved.
const STEPS: usize = 30;
const HALVED: i32 = 12;
/// The step after one as short as this, in lengths of a ligament or rad, is below rounding.
const SHORT: f64 = 1e-8;

type Places = Vec<[f64; 3]>;

impl Model {
    /// The model of `scene` with `design`, where its samples begin.
    pub fn new(scene: &Scene, design: &[f64]) -> Self {
        let cast = Self::cast(scene, design);
        match scene.pressed.is_empty() {
            true => cast,
            false => Self { start: find(scene, &cast), ..cast },
        }
    }
}

/// Where every unit of a body is, (u, v, θ), when a sample begins.
///
/// # Errors
/// Says whether the body buckles on the way there, or comes to rest nowhere.
///
/// # Panics
/// If the design's length is not that of the scene's layout.
pub fn start(scene: &Scene, design: &[f64]) -> Result<Vec<[f64; 3]>, Outcome> {
    let units = scene.layout.units();
    let start = Model::new(scene, design).start?;
    Ok(if start.is_empty() { vec![[0.0; 3]; units] } else { start })
}

/// Whether parts touch in the body as cast, which then is no place of rest.
///
/// # Panics
/// If the design's length is not that of the scene's layout.
pub fn touches(scene: &Scene, design: &[f64]) -> bool {
    Model::new(scene, design).touches()
}

/// The same of a body whose held units are moved.
///
/// # Errors
/// Likewise.
pub fn find(scene: &Scene, model: &Model) -> Result<Places, Outcome> {
    assert_eq!(scene.pressed.len(), scene.clamped.len() + scene.guided.len(), "ways of held units");
    let lengths = model.bars.iter().map(|bar| bar.length);
    let length = if model.bars.is_empty() { 1.0 } else { lengths.sum::<f64>() / model.bars.len() as f64 };
    let way = scene.pressed.iter().map(|[x, y]| x.hypot(*y)).fold(0.0, f64::max) / length;
    let (mut x, mut gone, mut part) = (vec![[0.0; 3]; model.units()], 0.0, PART);
    while gone < way {
        let to = way.min(gone + part);
        let mut next = x.clone();
        for (unit, by) in scene.ways() {
            let held = scene.holds(unit);
            (0..2).filter(|d| held[*d]).for_each(|d| next[unit][d] = by[d] * (to / way));
        }
        match settle(scene, model, next, SHORT * length) {
            Ok(found) => (x, gone) = (found, to),
            Err(outcome) if 0.5 * part < SMALLEST => return Err(outcome),
            Err(_) => part *= 0.5,
        }
    }
    Ok(x)
}

/// Newton's method from `x` on, its held units where they are.
fn settle(scene: &Scene, model: &Model, mut x: Places, short: f64) -> Result<Places, Outcome> {
    let mut at = Slope::at(scene, model, &x).ok_or(Outcome::NoEquilibrium)?;
    for _ in 0..STEPS {
        let factor = stiffness(scene, model, &x).ok_or(Outcome::Buckled)?;
        let step = solve(&factor, model, &at.gradient);
        let longest = step.as_flattened().iter().fold(0.0, |most: f64, s| most.max(s.abs()));
        let moved = |by: f64| -> Places {
            let own = |(x, s): (&[f64; 3], &[f64; 3])| std::array::from_fn(|d| by.mul_add(-s[d], x[d]));
            x.iter().zip(&step).map(own).collect()
        };
        if longest <= short {
            let found = moved(1.0);
            return stiffness(scene, model, &found).map(|_| found).ok_or(Outcome::Buckled);
        }
        let slope: f64 = at.gradient.as_flattened().iter().zip(step.as_flattened()).map(|(g, s)| g * s).sum();
        let steps = (0..HALVED).map(|half| 0.5_f64.powi(half));
        let better = |by: f64| {
            let next = Slope::at(scene, model, &moved(by))?;
            // where energies are equal but for rounding, forces tell
            let falls = next.energy <= at.energy - 1e-4 * by * slope || next.largest() < 0.5 * at.largest();
            falls.then_some((by, next))
        };
        let (by, next) = steps.into_iter().find_map(better).ok_or(Outcome::NoEquilibrium)?;
        (x, at) = (moved(by), next);
    }
    Err(Outcome::NoEquilibrium)
}

/// The energy of all units at some places, and its gradient in those that nothing holds, zero in others.
struct Slope {
    energy: f64,
    gradient: Places,
}

impl Slope {
    /// Nothing where contact forbids them.
    fn at(scene: &Scene, model: &Model, x: &[[f64; 3]]) -> Option<Self> {
        let zero = Sse2::splat(0.0);
        let places: Vec<[Sse2; 3]> = x.iter().map(|x| x.map(Sse2::splat)).collect();
        let (mut turn, mut g) = (vec![Turn::NONE; x.len()], vec![[zero; 3]; x.len()]);
        let mut margin = Sse2::splat(1.0);
        turns::<Sse2>(&places, &mut turn);
        let bars = &model.bars;
        let energy = if scene.linearised {
            gradient::<Sse2, true, true, false>(model, bars, &places, &turn, &mut g, &mut margin, &mut []);
            energy::<Sse2, true, true>(model, bars, &places, &turn)
        } else {
            gradient::<Sse2, false, true, false>(model, bars, &places, &turn, &mut g, &mut margin, &mut []);
            energy::<Sse2, false, true>(model, bars, &places, &turn)
        };
        let mut gradient = vec![[0.0; 3]; x.len()];
        for (u, d) in loose(model).into_iter().map(|i| (i / 3, i % 3)) {
            gradient[u][d] = g[u][d].lane(0);
        }
        let finite = gradient.as_flattened().iter().all(|g| g.is_finite());
        (finite && margin.lane(0) >= 0.0).then(|| Self { energy: energy.lane(0), gradient })
    }

    fn largest(&self) -> f64 {
        self.gradient.as_flattened().iter().fold(0.0, |most, g| most.max(g.abs()))
    }
}

/// The displacements that nothing holds, among all: a driven unit stays where it is until a sample drives it.
fn loose(model: &Model) -> Vec<usize> {
    let mut loose = unknowns(model);
    loose.retain(|i| !model.driven.contains(&(i / 3)));
    loose
}

/// The factor of K at some places; nothing where it is not positive definite.
fn stiffness(scene: &Scene, model: &Model, x: &[[f64; 3]]) -> Option<Llt<usize, f64>> {
    let loose = loose(model);
    let entries = columns(&loose, model.units(), |w| hessian(model, scene, x, w));
    sparse(loose.len(), &entries).sp_cholesky(Side::Lower).ok()
}

/// K⁻¹ y; zero where units are held.
fn solve(factor: &Llt<usize, f64>, model: &Model, y: &[[f64; 3]]) -> Places {
    let loose = loose(model);
    let of = |i: usize| (loose[i] / 3, loose[i] % 3);
    let right = Mat::from_fn(loose.len(), 1, |i, _| y[of(i).0][of(i).1]);
    let solved = factor.solve(&right);
    let mut whole = vec![[0.0; 3]; y.len()];
    for i in 0..solved.nrows() {
        whole[of(i).0][of(i).1] = solved[(i, 0)];
    }
    whole
}

/// What a change of the places' derivative `rate`, ∂²U/∂s∂p along a direction p, makes of them.
pub fn follow(scene: &Scene, model: &Model, rate: &[[f64; 3]]) -> Places {
    let factor = stiffness(scene, model, model.start()).expect("stable where a sample began");
    let mut moved = solve(&factor, model, rate);
    moved.as_flattened_mut().iter_mut().for_each(|x| *x = -*x);
    moved
}

/// Adds what the cotangent of the places at the beginning passes on to the model's others; nothing in a body as cast.
pub fn pull_back(scene: &Scene, model: &Model, cotangent: &mut ModelCotangent) {
    if model.start().is_empty() {
        return;
    }
    // less λᵀ ∂²U/∂s∂α, λ = K⁻¹ of it
    let w: Vec<[Sse2; 3]> = follow(scene, model, &cotangent.start).iter().map(|w| w.map(one_lane)).collect();
    let zero = Sse2::splat(0.0);
    let x: Vec<[Sse2; 3]> = model.start().iter().map(|x| x.map(Sse2::splat)).collect();
    let mut turn = vec![Turn::NONE; x.len()];
    turns::<Sse2>(&x, &mut turn);
    let (mut arms, mut voids) = (vec![[zero; 2]; cotangent.arms.len()], vec![[zero; 2]; model.ligaments]);
    let (mut stiffness, mut contact) = (vec![[zero; 3]; model.ligaments], zero);
    let shape = ShapeCotangent {
        arms: &mut arms,
        voids: &mut voids,
        stiffness: &mut stiffness,
        contact: &mut contact,
    };
    let kernel = match scene.linearised {
        false => product::<Sse2, false, true, false, true>,
        true => product::<Sse2, true, true, false, true>,
    };
    let mut unread = vec![[zero; 3]; x.len()];
    kernel(model, &model.bars, &x, &w, &turn, &mut [], &mut unread, shape);
    let add = |to: &mut [f64], from: &[Sse2]| to.iter_mut().zip(from).for_each(|(t, f)| *t += f.lane(0));
    add(cotangent.arms.as_flattened_mut(), arms.as_flattened());
    add(cotangent.voids.as_flattened_mut(), voids.as_flattened());
    add(cotangent.stiffness.as_flattened_mut(), stiffness.as_flattened());
    cotangent.contact += contact.lane(0);
}

fn one_lane(x: f64) -> Sse2 {
    let mut lanes = Sse2::ZERO;
    lanes.set_lane(0, x);
    lanes
}
