//! Equilibrium of a compressed body, and its derivative in the design.
//!
//! ```text
//! ∂U/∂s(s*, α) = 0 for the free coordinates,   ds*/dα = −K⁻¹ ∂²U/∂s∂α,   K = ∂²U/∂s² at s*
//! ```
//! Held units move in small increments. After each, Newton's method with a line search on the energy moves the other units
//! (Nocedal & Wright, Numerical Optimization, 2006, ch. 3). While K stays positive definite, this is the stable equilibrium of
//! slow compression. Where K loses that, the body buckles, and its direction is undetermined.

use super::ligaments::{Turn, energy, gradient, product, turns};
use super::model::{Model, ModelCotangent};
use super::stiffness::{columns, hessian, sparse, unknowns};
use super::{Outcome, Scene};
use crate::lanes::{Base, Vector};
use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::Llt;
use faer::{Mat, Side};

/// Largest and smallest increment of held units, in ligament lengths.
const PART: f64 = 0.25;
const SMALLEST: f64 = PART / 64.0;
/// Newton steps per increment, and halvings per step.
const STEPS: usize = 30;
const HALVED: i32 = 12;
/// After a step as short as this (ligament lengths, rad), the next step is below rounding.
const SHORT: f64 = 1e-8;

type Places = Vec<[f64; 3]>;

impl Model {
    /// Model of `scene` with `design` at the start of its samples.
    pub fn new(scene: &Scene, design: &[f64]) -> Self {
        let cast = Self::uncompressed(scene, design);
        match scene.imposed.is_empty() || cast.start.is_err() {
            true => cast,
            false => Self { start: equilibrium(scene, &cast), ..cast },
        }
    }
}

/// State (u, v, θ) of every unit at the start of a sample.
///
/// # Errors
/// `Buckled` or `NoEquilibrium` if compression fails.
///
/// # Panics
/// If the design's length does not match the scene's layout.
pub fn start(scene: &Scene, design: &[f64]) -> Result<Vec<[f64; 3]>, Outcome> {
    let units = scene.layout.units();
    let start = Model::new(scene, design).start?;
    Ok(if start.is_empty() { vec![[0.0; 3]; units] } else { start })
}

/// Whether contact acts in the body before compression, which then is no equilibrium.
///
/// # Panics
/// If the design's length does not match the scene's layout.
pub fn touches(scene: &Scene, design: &[f64]) -> bool {
    Model::new(scene, design).touches()
}

/// Equilibrium of a compressed body.
///
/// # Errors
/// `Buckled` or `NoEquilibrium`.
pub fn equilibrium(scene: &Scene, model: &Model) -> Result<Places, Outcome> {
    let held = scene.clamped.len() + scene.guided.len();
    assert_eq!(scene.imposed.len(), held, "number of displacements of held units");
    let lengths = model.bars.iter().map(|bar| bar.length);
    let length = if model.bars.is_empty() { 1.0 } else { lengths.sum::<f64>() / model.bars.len() as f64 };
    let total = scene.imposed.iter().map(|[x, y]| x.hypot(*y)).fold(0.0, f64::max) / length;
    let (mut x, mut travelled, mut increment) = (vec![[0.0; 3]; model.units()], 0.0, PART);
    while travelled < total {
        let to = total.min(travelled + increment);
        let mut next = x.clone();
        for (unit, by) in scene.held_displacements() {
            let held = scene.holds(unit);
            (0..2).filter(|d| held[*d]).for_each(|d| next[unit][d] = by[d] * (to / total));
        }
        match newton_equilibrium(scene, model, next, SHORT * length) {
            Ok(found) => (x, travelled) = (found, to),
            Err(outcome) if 0.5 * increment < SMALLEST => return Err(outcome),
            Err(_) => increment *= 0.5,
        }
    }
    Ok(x)
}

/// Newton's method from `x` with held units fixed.
fn newton_equilibrium(scene: &Scene, model: &Model, mut x: Places, short: f64) -> Result<Places, Outcome> {
    let mut current = EnergySlope::current(scene, model, &x).ok_or(Outcome::NoEquilibrium)?;
    for _ in 0..STEPS {
        let factor = stiffness(scene, model, &x).ok_or(Outcome::Buckled)?;
        let step = solve(&factor, model, &current.gradient);
        let longest = step.as_flattened().iter().fold(0.0, |most: f64, s| most.max(s.abs()));
        let stepped = |by: f64| -> Places {
            let own = |(x, s): (&[f64; 3], &[f64; 3])| std::array::from_fn(|d| by.mul_add(-s[d], x[d]));
            x.iter().zip(&step).map(own).collect()
        };
        if longest <= short {
            let found = stepped(1.0);
            return stiffness(scene, model, &found).map(|_| found).ok_or(Outcome::Buckled);
        }
        let slope: f64 =
            current.gradient.as_flattened().iter().zip(step.as_flattened()).map(|(g, s)| g * s).sum();
        let steps = (0..HALVED).map(|half| 0.5_f64.powi(half));
        let try_step = |by: f64| {
            let next = EnergySlope::current(scene, model, &stepped(by))?;
            // where energies differ only by rounding, the forces decide
            let falls =
                next.energy <= current.energy - 1e-4 * by * slope || next.largest() < 0.5 * current.largest();
            falls.then_some((by, next))
        };
        let (by, next) = steps.into_iter().find_map(try_step).ok_or(Outcome::NoEquilibrium)?;
        (x, current) = (stepped(by), next);
    }
    Err(Outcome::NoEquilibrium)
}

/// Energy of a state, and its gradient in the free coordinates (zero in others).
struct EnergySlope {
    energy: f64,
    gradient: Places,
}

impl EnergySlope {
    /// `None` if contact forbids the state.
    fn current(scene: &Scene, model: &Model, x: &[[f64; 3]]) -> Option<Self> {
        let zero = Base::splat(0.0);
        let places: Vec<[Base; 3]> = x.iter().map(|x| x.map(Base::splat)).collect();
        let (mut turn, mut g) = (vec![Turn::NONE; x.len()], vec![[zero; 3]; x.len()]);
        let mut margin = Base::splat(1.0);
        turns::<Base>(&places, &mut turn);
        let bars = &model.bars;
        let energy = if scene.linearised {
            gradient::<Base, true, true, false>(model, bars, &places, &turn, &mut g, &mut margin, &mut []);
            energy::<Base, true, true>(model, bars, &places, &turn)
        } else {
            gradient::<Base, false, true, false>(model, bars, &places, &turn, &mut g, &mut margin, &mut []);
            energy::<Base, false, true>(model, bars, &places, &turn)
        };
        let mut gradient = vec![[0.0; 3]; x.len()];
        for (u, d) in free_coordinates(model).into_iter().map(|i| (i / 3, i % 3)) {
            gradient[u][d] = g[u][d].lane(0);
        }
        let finite = gradient.as_flattened().iter().all(|g| g.is_finite());
        (finite && margin.lane(0) >= 0.0).then(|| Self { energy: energy.lane(0), gradient })
    }

    fn largest(&self) -> f64 {
        self.gradient.as_flattened().iter().fold(0.0, |most, g| most.max(g.abs()))
    }
}

/// Indices of the coordinates that are neither held nor driven: driven units stay in place until a sample starts.
fn free_coordinates(model: &Model) -> Vec<usize> {
    let mut loose = unknowns(model);
    loose.retain(|i| !model.driven.contains(&(i / 3)));
    loose
}

/// Cholesky factor of K at the state `x`; `None` if K is not positive definite.
fn stiffness(scene: &Scene, model: &Model, x: &[[f64; 3]]) -> Option<Llt<usize, f64>> {
    let loose = free_coordinates(model);
    let entries = columns(&loose, model.units(), |w| hessian(model, scene, x, w));
    sparse(loose.len(), &entries).sp_cholesky(Side::Lower).ok()
}

/// K⁻¹ y; zero in held coordinates.
fn solve(factor: &Llt<usize, f64>, model: &Model, y: &[[f64; 3]]) -> Places {
    let loose = free_coordinates(model);
    let of = |i: usize| (loose[i] / 3, loose[i] % 3);
    let right = Mat::from_fn(loose.len(), 1, |i, _| y[of(i).0][of(i).1]);
    let solved = factor.solve(&right);
    let mut whole = vec![[0.0; 3]; y.len()];
    for i in 0..solved.nrows() {
        whole[of(i).0][of(i).1] = solved[(i, 0)];
    }
    whole
}

/// Change of the equilibrium, −K⁻¹ `rate`, for `rate` = ∂²U/∂s∂p along a direction p.
pub fn follow(scene: &Scene, model: &Model, rate: &[[f64; 3]]) -> Places {
    let factor =
        stiffness(scene, model, model.start()).expect("K is positive definite at the start of a sample");
    let mut moved = solve(&factor, model, rate);
    moved.as_flattened_mut().iter_mut().for_each(|x| *x = -*x);
    moved
}

/// Passes the cotangent of the starting state to the model's other cotangents, if the body is compressed.
pub fn add_start_vjp(scene: &Scene, model: &Model, cotangent: &mut ModelCotangent) {
    if model.start().is_empty() {
        return;
    }
    // −λᵀ ∂²U/∂s∂α with λ = K⁻¹ times that cotangent
    let w = follow(scene, model, &cotangent.start);
    let w: Vec<[Base; 3]> = w.iter().map(|w| w.map(|w| Base::gather(&[w]))).collect();
    let zero = Base::splat(0.0);
    let x: Vec<[Base; 3]> = model.start().iter().map(|x| x.map(Base::splat)).collect();
    let mut turn = vec![Turn::NONE; x.len()];
    turns::<Base>(&x, &mut turn);
    let mut own = ModelCotangent::new(model, zero);
    let kernel = match scene.linearised {
        false => product::<Base, false, true, false, true>,
        true => product::<Base, true, true, false, true>,
    };
    let mut unread = vec![[zero; 3]; x.len()];
    kernel(model, &model.bars, &x, &w, &turn, &mut [], &mut unread, own.shape());
    let add = |to: &mut [f64], from: &[Base]| to.iter_mut().zip(from).for_each(|(t, f)| *t += f.lane(0));
    add(cotangent.arms.as_flattened_mut(), own.arms.as_flattened());
    add(cotangent.voids.as_flattened_mut(), own.voids.as_flattened());
    add(cotangent.stiffness.as_flattened_mut(), own.stiffness.as_flattened());
    cotangent.contact += own.contact.lane(0);
}
