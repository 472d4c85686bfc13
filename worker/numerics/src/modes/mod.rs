//! Small motions about rest: eigenmodes with all of their damping, and how a force on a panel moves a unit.
//!
//! ```text
//! (s² M + s C + K) x = 0        x(ω) = (K + iω C − ω² M)⁻¹ e_panel,   read as −ω² (u, v) and iω θ
//! ```
//! C is not proportional to M and K, so that shapes are complex and s comes of the first-order form, z = (Ω x, s x), of twice
//! the unknowns, Ω a high frequency: eigenvalues of least |s| by Krylov–Schur on its inverse, K by a sparse Cholesky factor.
//! Responses take a sparse LU factor a frequency. All three are faer's.

pub mod bound;

use crate::dynamics::{Rest, Scene};
pub use faer::c64;
use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::solvers::Solve;
use faer::matrix_free::LinOp;
use faer::matrix_free::eigen::{PartialEigenParams, partial_eigen, partial_eigen_scratch};
use faer::sparse::linalg::solvers::{Llt, Lu, SymbolicLu};
use faer::sparse::{SparseColMat, Triplet};
use faer::{Col, Mat, MatMut, MatRef, Par, Side};
use std::f64::consts::TAU;

/// A mode of small motions: the real part of `shape` · exp(s t).
#[derive(Debug, Clone, PartialEq)]
pub struct Mode {
    /// s (1/s), of no negative imaginary part; real where the mode does not ring.
    pub s: c64,
    /// (u, v, θ) of every unit (mm, mm, rad), held ones at zero; xᵀMx = 1, which makes it as real as it can be.
    pub shape: Vec<[c64; 3]>,
}

impl Mode {
    /// |s|/2π (Hz).
    pub fn frequency(&self) -> f64 {
        self.s.norm() / TAU
    }

    /// −Re s/|s|: 1 where it does not ring.
    pub fn damping_ratio(&self) -> f64 {
        -self.s.re / self.s.norm()
    }
}

/// The body is not held: some motion meets no stiffness, and has no mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Loose;

/// Residual at which an eigenpair counts as found, relative to |1/s| of the slowest.
const TOLERANCE: f64 = 1e-13;
/// Krylov vectors by the eigenvalues asked for, and at most by twice that.
const SPARE: usize = 2;

/// The `count` modes of least |s|, in order of it; fewer where the body has fewer.
///
/// # Errors
/// If the stiffness is not positive definite.
pub fn modes(rest: &Rest, units: usize, count: usize) -> Result<Vec<Mode>, Loose> {
    let n = rest.mass.len();
    let stiffness = sparse(n, &rest.stiffness).sp_cholesky(Side::Lower).map_err(|_| Loose)?;
    let own = rest.stiffness.iter().filter(|(i, j, _)| i == j).map(|&(i, _, k)| (k / rest.mass[i]).sqrt());
    let inverse = Inverse { rest, stiffness, scale: own.fold(0.0, f64::max) };
    // pairs, and one more than are asked for, which may be cut in two
    let asked = (2 * count + 2).min(2 * n);
    let params =
        PartialEigenParams { min_dim: SPARE * asked, max_dim: 2 * SPARE * asked, ..Default::default() };
    let mut vectors = Mat::<c64>::zeros(2 * n, asked);
    let mut values = vec![c64::ZERO; asked];
    // any start that no symmetry of the lattice leaves without a part in some mode
    let start = Col::from_fn(2 * n, |i| (1.0 + 7.3 * i as f64).sin());
    let start = &start * (1.0 / start.norm_l2());
    let mut memory = MemBuffer::new(partial_eigen_scratch(&inverse, asked, Par::Seq, params));
    let (stack, start) = (MemStack::new(&mut memory), start.as_ref());
    let found =
        partial_eigen(vectors.as_mut(), &mut values, &inverse, start, TOLERANCE, Par::Seq, stack, params);
    let mut modes: Vec<Mode> = (0..found.n_converged_eigen.min(asked))
        .map(|j| (values[j].inv(), vectors.col(j)))
        .filter(|(s, _)| s.im >= 0.0)
        .map(|(s, z)| {
            let square: c64 = (0..n).map(|i| z[i] * z[i] * rest.mass[i]).sum();
            let scale = square.sqrt().inv();
            let mut shape = vec![[c64::ZERO; 3]; units];
            (0..n).for_each(|i| shape[rest.free[i / 3]][i % 3] = scale * z[i]);
            Mode { s, shape }
        })
        .collect();
    modes.sort_by(|a, b| a.s.norm().total_cmp(&b.s.norm()));
    modes.truncate(count);
    Ok(modes)
}

/// Of a motion under a force of 1 N on a panel at one frequency: a_x, a_y (mm/s²/N) and ω (rad/s/N) of a unit.
pub type Response = [c64; 3];

/// Responses at these frequencies (Hz), of each unit to each panel: (frequencies, panels, units).
///
/// # Panics
/// If a unit is none of the scene's.
pub fn responses(
    scene: &Scene,
    rest: &Rest,
    units: &[usize],
    frequencies: &[f64],
) -> Vec<Vec<Vec<Response>>> {
    let n = rest.mass.len();
    let place = |unit: usize| rest.free.iter().position(|u| *u == unit);
    assert!(units.iter().all(|u| *u < scene.layout.units()), "units {units:?}");
    let mut forces = Mat::<c64>::zeros(n, scene.panels.len());
    for (k, panel) in scene.panels.iter().enumerate() {
        if let Some(i) = place(panel.unit) {
            (0..2).for_each(|d| forces[(3 * i + d, k)] = panel.direction[d].into());
        }
    }
    let dynamic = |hertz: f64| {
        let omega = TAU * hertz;
        let own = (0..n).map(|i| (i, i, c64::new(-omega * omega * rest.mass[i], omega * rest.damping[i])));
        let elastic = rest.stiffness.iter().map(|&(i, j, k)| (i, j, k.into()));
        sparse(n, &elastic.chain(own).collect::<Vec<_>>())
    };
    let pattern = SymbolicLu::try_new(dynamic(1.0).symbolic()).expect("memory for the factor's pattern");
    let at = |&hertz: &f64| {
        let lu = Lu::try_new_with_symbolic(pattern.clone(), dynamic(hertz).as_ref())
            .expect("damping leaves no zero");
        let moved = lu.solve(&forces);
        let speed = c64::new(0.0, TAU * hertz);
        let read = |k: usize, unit: usize| match place(unit) {
            Some(i) => [0, 1, 2].map(|d| if d < 2 { speed * speed } else { speed } * moved[(3 * i + d, k)]),
            None => [c64::ZERO; 3],
        };
        (0..scene.panels.len()).map(|k| units.iter().map(|&unit| read(k, unit)).collect()).collect()
    };
    frequencies.iter().map(at).collect()
}

fn sparse<T: faer::traits::ComplexField>(n: usize, entries: &[(usize, usize, T)]) -> SparseColMat<usize, T> {
    let entries: Vec<_> = entries.iter().map(|(i, j, value)| Triplet::new(*i, *j, value.clone())).collect();
    SparseColMat::try_new_from_triplets(n, n, &entries).expect("entries of an n × n matrix")
}

/// z ↦ A⁻¹ z of ż = A z, z = (Ω x, ẋ): x ↦ −K⁻¹ (C x + M ẋ), ẋ ↦ x.
struct Inverse<'a> {
    rest: &'a Rest,
    stiffness: Llt<usize, f64>,
    /// Ω (rad/s): parts of z are of like size in quick modes, too.
    scale: f64,
}

impl std::fmt::Debug for Inverse<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "the inverse of the first-order form of {} units", self.rest.free.len())
    }
}

impl LinOp<f64> for Inverse<'_> {
    fn apply_scratch(&self, _: usize, _: Par) -> StackReq {
        StackReq::EMPTY
    }

    fn nrows(&self) -> usize {
        2 * self.rest.mass.len()
    }

    fn ncols(&self) -> usize {
        self.nrows()
    }

    fn apply(&self, mut out: MatMut<'_, f64>, z: MatRef<'_, f64>, _: Par, _: &mut MemStack) {
        let (Rest { mass, damping, .. }, n) = (self.rest, self.rest.mass.len());
        let net = |i: usize, c: usize| -(damping[i] * z[(i, c)] + self.scale * mass[i] * z[(n + i, c)]);
        let moved = self.stiffness.solve(Mat::from_fn(n, z.ncols(), net));
        for c in 0..z.ncols() {
            for i in 0..n {
                (out[(i, c)], out[(n + i, c)]) = (moved[(i, c)], z[(i, c)] / self.scale);
            }
        }
    }

    fn conj_apply(&self, out: MatMut<'_, f64>, z: MatRef<'_, f64>, par: Par, stack: &mut MemStack) {
        self.apply(out, z, par, stack);
    }
}

#[cfg(test)]
mod tests;
