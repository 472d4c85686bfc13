//! Small motions about rest: damped eigenmodes, and responses of units to forces on panels.
//!
//! ```text
//! (s² M + s C + K) x = 0        x(ω) = (K + iω C − ω² M)⁻¹ e_panel,   read as −ω² (u, v) and iω θ
//! ```
//! C is not proportional to M and K, so shapes are complex. s follows from the first-order form z = (Ω x, s x) with twice the
//! unknowns, Ω a high frequency: block Arnoldi on its inverse gives the least |s| (Saad, Numerical Methods for Large Eigenvalue
//! Problems, 2011, ch. 6), with a sparse Cholesky factor of K. Responses use a sparse LU factor per frequency. An unsupported
//! body has rigid modes with s = 0; its inverse is that of A − σ, σ far below Ω, with P = K + σ C + σ² M.

pub mod bound;

pub use faer::c64;
use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::{Llt, Lu, SymbolicLu};
use faer::{Mat, Side};
use metasense_numerics::dynamics::{AccelerationFrame, Rest, Scene, sparse};
use nalgebra::DVector;
use std::f64::consts::TAU;

/// A mode of small motions: the real part of `shape` · exp(s t).
#[derive(Debug, Clone, PartialEq)]
pub struct Mode {
    /// s (1/s) with imaginary part ≥ 0; real for an overdamped mode.
    pub s: c64,
    /// (u, v, θ) of every unit (mm, mm, rad), 0 for held units; scaled to xᵀMx = 1, which makes it as real as possible.
    pub shape: Vec<[c64; 3]>,
}

impl Mode {
    /// |s|/2π (Hz).
    pub fn frequency(&self) -> f64 {
        self.s.norm() / TAU
    }

    /// −Re s/|s|; 1 for an overdamped mode.
    pub fn damping_ratio(&self) -> f64 {
        if self.s == c64::ZERO { 1.0 } else { -self.s.re / self.s.norm() }
    }

    /// −1/Re s (s); `None` without damping.
    pub fn decay_time(&self) -> Option<f64> {
        (self.s.re < 0.0).then(|| -self.s.re.recip())
    }
}

/// Why a body has no modes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoModes {
    /// Some motion has no stiffness in a supported body, or no damping in an unsupported one.
    Loose,
    /// Masses, stiffness or damping are not finite, or of too different magnitudes.
    NotFinite,
}

/// Residual energy norm of a converged mode, relative to the mode's: √(rᴴ K⁻¹ r / xᴴ K x). Slow modes, whose elastic forces
/// cancel, and their neighbours have more rounding error, accepted up to `ROUNDED`.
const TOLERANCE: f64 = 1e-10;
const ROUNDED: f64 = 1e-8;
/// Number of starts of the subspace: square lattices have double modes, which one start finds once.
const STARTS: usize = 3;
/// Relative distance of eigenvalues that count as distinct.
const APART: f64 = 1e-8;
/// σ/Ω for an unsupported body, and |s|/σ below which s is rounding error of 0.
const SHIFT: f64 = 1e-3;
const STILL: f64 = 1e-6;

/// The `count` modes of least |s|, sorted, or all if there are fewer.
///
/// # Errors
/// If the stiffness is not positive definite, or numbers are not finite.
pub fn modes(rest: &Rest, units: usize, count: usize) -> Result<Vec<Mode>, NoModes> {
    let n = rest.mass.len();
    let stiff = rest.stiffness.iter().map(|(_, _, k)| k);
    if !rest.mass.iter().chain(&rest.damping).chain(stiff).all(|x| x.is_finite()) {
        return Err(NoModes::NotFinite);
    }
    if rest.loose && rest.damping.contains(&0.0) {
        return Err(NoModes::Loose);
    }
    let own = rest.stiffness.iter().filter(|(i, j, _)| i == j).map(|&(i, _, k)| (k / rest.mass[i]).sqrt());
    let scale = own.fold(0.0, f64::max);
    let shift = if rest.loose { SHIFT * scale } else { 0.0 };
    let own = |i: usize| (i, i, shift * (rest.damping[i] + shift * rest.mass[i]));
    let added = (0..n).map(own).filter(|_| rest.loose);
    let stiffness: Vec<_> = rest.stiffness.iter().copied().chain(added).collect();
    let stiffness = sparse(n, &stiffness).sp_cholesky(Side::Lower).map_err(|_| NoModes::Loose)?;
    let inverse = ShiftedInverse { rest, stiffness, scale, shift };
    let mut space = Subspace { basis: Vec::new(), image: Vec::new(), drawn: 0 };
    let mut size = (4 * count + 16).min(2 * n);
    loop {
        space.grow(&inverse, size);
        let pairs = space.pairs(&inverse, count).ok_or(NoModes::NotFinite)?;
        let residual_and_rounding: Vec<[f64; 2]> = pairs.iter().map(|(s, x)| inverse.left(*s, x)).collect();
        let allowed_residual = residual_and_rounding
            .iter()
            .fold(TOLERANCE, |most, [_, rounding]| most.max(*rounding))
            .min(ROUNDED);
        let found =
            residual_and_rounding.iter().all(|[left, rounding]| *left < rounding.max(allowed_residual));
        if size == 2 * n || (found && pairs.len() == count) {
            let finite = |(s, x): &(c64, Vec<c64>)| s.is_finite() && x.iter().all(|x| x.is_finite());
            if !pairs.iter().all(finite) {
                return Err(NoModes::NotFinite);
            }
            let whole = |x: Vec<c64>| {
                let mut shape = vec![[c64::ZERO; 3]; units];
                x.into_iter()
                    .enumerate()
                    .for_each(|(i, x)| shape[rest.unknowns[i] / 3][rest.unknowns[i] % 3] = x);
                shape
            };
            let mode = |(s, x): (c64, Vec<c64>)| Mode { s: damped(rest, s, &x), shape: whole(x) };
            return Ok(pairs.into_iter().map(mode).collect());
        }
        size = (size + size / 2).min(2 * n);
    }
}

/// All modes up to a frequency (Hz).
///
/// # Errors
/// As [`modes`].
pub fn modes_to(rest: &Rest, units: usize, hertz: f64) -> Result<Vec<Mode>, NoModes> {
    let mut count = 32;
    loop {
        let found = modes(rest, units, count)?;
        let all = found.len() < count || found.last().is_none_or(|last| last.frequency() > hertz);
        if all {
            return Ok(found.into_iter().filter(|mode| mode.frequency() <= hertz).collect());
        }
        count *= 2;
    }
}

/// s of a mode with the damping that its shape implies: for complex s, Re s = −xᴴCx/2xᴴMx, exactly 0 without damping.
fn damped(rest: &Rest, s: c64, x: &[c64]) -> c64 {
    if s.im == 0.0 {
        return c64::new(s.re, 0.0);
    }
    let square = |by: &[f64]| by.iter().zip(x).map(|(by, x)| by * x.norm_sqr()).sum::<f64>();
    let (size, slow) = (s.norm(), 0.5 * square(&rest.damping) / square(&rest.mass));
    let ratio = (slow / size).min(1.0);
    c64::new(-size * ratio, size * (1.0 - ratio * ratio).sqrt())
}

/// An orthonormal basis V of the Krylov subspace of A⁻¹, and A⁻¹ v of its first vectors in this basis.
struct Subspace {
    basis: Vec<DVector<f64>>,
    /// Vᵀ A⁻¹ v, per vector v to which A⁻¹ was applied.
    image: Vec<DVector<f64>>,
    /// Number of starts so far.
    drawn: usize,
}

impl Subspace {
    /// Applies A⁻¹ to `size` vectors in total.
    fn grow(&mut self, inverse: &ShiftedInverse<'_>, size: usize) {
        let most = 2 * inverse.rest.mass.len();
        while self.basis.len() < STARTS.min(most) {
            self.start(most);
        }
        while self.image.len() < size {
            let moved = inverse.apply(&self.basis[self.image.len()]);
            let image = self.add(moved);
            self.image.push(image);
            // The subspace is invariant; another start completes it.
            while self.basis.len() == self.image.len() && self.basis.len() < most {
                self.start(most);
            }
        }
    }

    /// Adds a start that has a component along every mode despite the lattice's symmetry.
    fn start(&mut self, length: usize) {
        self.drawn += 1;
        let pace = 7.3 + (self.drawn as f64).sqrt();
        let vector = DVector::from_fn(length, |i, _| (1.0 + pace * i as f64).sin());
        self.add(vector);
    }

    /// Adds the new component of a vector, if any, to the basis; returns the vector in this basis.
    fn add(&mut self, mut vector: DVector<f64>) -> DVector<f64> {
        let size = vector.norm();
        let mut image = DVector::zeros(self.basis.len());
        // Twice is enough (Giraud et al., Numer. Math. 101 (2005) 87–100).
        for _ in 0..2 {
            for (part, of) in image.iter_mut().zip(&self.basis) {
                let along = of.dot(&vector);
                *part += along;
                vector.axpy(-along, of, 1.0);
            }
        }
        let length = vector.norm();
        if length <= 1e-14 * size {
            return image;
        }
        self.basis.push(vector / length);
        image.push(length)
    }

    /// Entry of H = Vᵀ A⁻¹ V, a band matrix below the diagonal.
    fn part(&self, i: usize, j: usize) -> f64 {
        self.image[j].get(i).copied().unwrap_or(0.0)
    }

    /// y ↦ (H − shift)⁻¹ y, by elimination with partial pivoting.
    fn solve_shifted(&self, y: &mut [c64], shift: c64) {
        let m = y.len();
        let below = (0..m).map(|j| self.image[j].len() - j).max().unwrap_or(0);
        let entry = |i: usize, j: usize| c64::from(self.part(i, j)) - if i == j { shift } else { c64::ZERO };
        let mut rows: Vec<Vec<c64>> = (0..m).map(|i| (0..m).map(|j| entry(i, j)).collect()).collect();
        for k in 0..m {
            let end = (k + below).min(m);
            let pivot =
                (k..end).max_by(|&i, &j| rows[i][k].norm().total_cmp(&rows[j][k].norm())).unwrap_or(k);
            rows.swap(k, pivot);
            y.swap(k, pivot);
            let (top, rest) = rows.split_at_mut(k + 1);
            for (i, row) in (k + 1..end).zip(rest) {
                let by = row[k] / top[k][k];
                row[k..].iter_mut().zip(&top[k][k..]).for_each(|(to, from)| *to -= by * from);
                let taken = by * y[k];
                y[i] -= taken;
            }
        }
        for k in (0..m).rev() {
            let known: c64 = rows[k][k + 1..].iter().zip(&y[k + 1..]).map(|(a, y)| a * y).sum();
            y[k] = (y[k] - known) / rows[k][k];
        }
    }

    /// (s, x) of the `count` slowest modes in the subspace, scaled to xᵀMx = 1; `None` if numbers are not finite.
    ///
    /// Inverse iteration starts from real x, so that double modes are as real as single ones.
    fn pairs(&self, inverse: &ShiftedInverse<'_>, count: usize) -> Option<Vec<(c64, Vec<c64>)>> {
        let (m, n) = (self.image.len(), inverse.rest.mass.len());
        let values = Mat::from_fn(m, m, |i, j| self.part(i, j)).eigenvalues().ok()?;
        let snap_to_zero = |s: c64| if s.norm() < STILL * inverse.shift { c64::ZERO } else { s };
        let values = values.into_iter().map(|value| snap_to_zero(inverse.shift + value.inv()));
        let mut slow: Vec<c64> = values.filter(|s| s.im >= 0.0).collect();
        slow.sort_by(|a, b| a.norm().total_cmp(&b.norm()));
        slow.truncate(count);
        let mut pairs: Vec<(c64, Vec<c64>)> = Vec::new();
        for s in slow {
            // Avoids a division by zero; the iteration tolerates this error.
            let shift = (s - inverse.shift).inv() * (1.0 + 1e-3 * APART);
            let pace = 3.1 + (pairs.len() as f64).sqrt();
            let x = |i: usize| (1.0 + pace * (i % n) as f64).sin();
            let by = |i: usize| if i < n { c64::from(inverse.scale) } else { s };
            let start: Vec<c64> = (0..2 * n).map(|i| by(i) * x(i)).collect();
            let within = |v: &DVector<f64>| v.iter().zip(&start).map(|(v, z)| z * *v).sum::<c64>();
            let mut y: Vec<c64> = self.basis[..m].iter().map(within).collect();
            for _ in 0..3 {
                self.solve_shifted(&mut y, shift);
                let size = y.iter().map(|y| y.norm_sqr()).sum::<f64>().sqrt();
                y.iter_mut().for_each(|y| *y /= size);
            }
            let mut x = vec![c64::ZERO; n];
            for (y, v) in y.into_iter().zip(&self.basis) {
                x.iter_mut().zip(v.iter()).for_each(|(x, v)| *x += y * *v);
            }
            for (_, other) in
                pairs.iter().filter(|(known, _)| (known - s).norm() < APART * (s - inverse.shift).norm())
            {
                let along = inverse.across(s, other, &x) / inverse.across(s, other, other);
                x.iter_mut().zip(other).for_each(|(x, other)| *x -= along * other);
            }
            let square: c64 = x.iter().zip(&inverse.rest.mass).map(|(x, m)| x * x * *m).sum();
            let scale = square.sqrt().inv();
            x.iter_mut().for_each(|x| *x *= scale);
            pairs.push((s, x));
        }
        Some(pairs)
    }
}

/// Response of a unit to a force of 1 N on a panel at one frequency: a_x, a_y (mm/s²/N) and ω (rad/s/N), in the scene's frame.
pub type FrequencyResponse = [c64; 3];

/// Responses (frequencies, panels, units) of each unit to each panel at these frequencies (Hz).
///
/// # Panics
/// If a unit does not exist.
pub fn responses(
    scene: &Scene,
    rest: &Rest,
    units: &[usize],
    frequencies: &[f64],
) -> Vec<Vec<Vec<FrequencyResponse>>> {
    let n = rest.mass.len();
    assert!(units.iter().all(|u| *u < scene.layout.units()), "units {units:?}");
    let mut forces = Mat::<c64>::zeros(n, scene.panels.len());
    for (k, pushes) in rest.pushes.iter().enumerate() {
        pushes.iter().for_each(|&(unknown, does)| forces[(unknown, k)] = does.into());
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
        let read = |k: usize, unit: usize| {
            let moves = [0, 1, 2].map(|d| rest.unknowns.binary_search(&(3 * unit + d)).ok());
            if moves == [None; 3] {
                return [c64::ZERO; 3];
            }
            let moved = moves.map(|i| i.map_or(c64::ZERO, |i| moved[(i, k)]));
            read(scene, rest, unit, moved, rest.shakes[k], hertz)
        };
        (0..scene.panels.len()).map(|k| units.iter().map(|&unit| read(k, unit)).collect()).collect()
    };
    frequencies.iter().map(at).collect()
}

/// Contribution of a mode and its conjugate to [`responses`]: φ φᵀ/(φᵀ(2s M + C) φ · (iω − s)). The sum over all modes is the
/// response, except for the common acceleration of a shaken base.
pub fn part_of(
    mode: &Mode,
    scene: &Scene,
    rest: &Rest,
    units: &[usize],
    frequencies: &[f64],
) -> Vec<Vec<Vec<FrequencyResponse>>> {
    let Mode { s, shape } = mode;
    let shape_at = |unknown: usize| shape[unknown / 3][unknown % 3];
    let damped = rest.unknowns.iter().zip(&rest.damping).map(|(&i, c)| shape_at(i) * shape_at(i) * *c);
    let own = 2.0 * *s + damped.sum::<c64>();
    let pushed = |pushes: &Vec<(usize, f64)>| -> c64 {
        pushes.iter().map(|&(unknown, does)| shape_at(rest.unknowns[unknown]) * does).sum()
    };
    let pushed: Vec<c64> = rest.pushes.iter().map(|pushes| pushed(pushes) / own).collect();
    let at = |&hertz: &f64| {
        let speed = c64::new(0.0, TAU * hertz);
        let of = |pushed: c64, unit: usize| {
            let moved = shape[unit].map(|x| {
                let part = x * pushed;
                let conjugate = if s.im > 0.0 { part.conj() / (speed - s.conj()) } else { c64::ZERO };
                part / (speed - *s) + conjugate
            });
            read(scene, rest, unit, moved, [0.0; 2], hertz)
        };
        pushed.iter().map(|&pushed| units.iter().map(|&unit| of(pushed, unit)).collect()).collect()
    };
    frequencies.iter().map(at).collect()
}

/// Reading at a unit that moves by (u, v, θ) on a base with this acceleration.
fn read(
    scene: &Scene,
    rest: &Rest,
    unit: usize,
    [u, v, turn]: [c64; 3],
    shaken: [f64; 2],
    hertz: f64,
) -> FrequencyResponse {
    let turned = match scene.frame {
        AccelerationFrame::World => 0.0,
        AccelerationFrame::Body => rest.turned.get(unit).copied().unwrap_or(0.0),
    };
    let speed = c64::new(0.0, TAU * hertz);
    let [x, y] = [(u, 0), (v, 1)].map(|(moved, d)| speed * speed * moved + shaken[d]);
    let (s, c) = turned.sin_cos();
    [x * c + y * s, y * c - x * s, speed * turn]
}

/// z ↦ (A − σ)⁻¹ z of ż = A z, z = (Ω x, ẋ): x ↦ −P⁻¹ ((C + σ M) x + M ẋ), ẋ ↦ x + σ times that.
struct ShiftedInverse<'a> {
    rest: &'a Rest,
    /// Cholesky factor of P.
    stiffness: Llt<usize, f64>,
    /// Ω (rad/s); it balances the parts of z in fast modes.
    scale: f64,
    /// σ (1/s); 0 for a supported body.
    shift: f64,
}

impl ShiftedInverse<'_> {
    fn apply(&self, z: &DVector<f64>) -> DVector<f64> {
        let (Rest { mass, damping, .. }, n) = (self.rest, self.rest.mass.len());
        let slowed = |i: usize| damping[i] + self.shift * mass[i];
        let net = |i: usize, _| -(slowed(i) * z[i] + self.scale * mass[i] * z[n + i]);
        let moved = self.stiffness.solve(Mat::from_fn(n, 1, net));
        let speed = |i: usize| (z[i] + self.shift * moved[(i, 0)]) / self.scale;
        DVector::from_fn(2 * n, |i, _| if i < n { moved[(i, 0)] } else { speed(i - n) })
    }

    /// √(rᴴ P⁻¹ r / xᴴ P x), r = (s² M + s C + K) x, and its rounding error ε |x|ᵀ|K||x| / xᴴ P x.
    fn left(&self, s: c64, x: &[c64]) -> [f64; 2] {
        let (Rest { mass, damping, stiffness, .. }, n) = (self.rest, x.len());
        let (mut elastic, mut sizes) = (vec![c64::ZERO; n], 0.0);
        for &(i, j, k) in stiffness {
            elastic[i] += k * x[j];
            sizes += k.abs() * x[i].norm() * x[j].norm();
        }
        let force = |i: usize| elastic[i] + (s * s * mass[i] + s * damping[i]) * x[i];
        let parts = Mat::from_fn(n, 2, |i, part| if part == 0 { force(i).re } else { force(i).im });
        let moved = self.stiffness.solve(&parts);
        let work = |part: usize| (0..n).map(|i| parts[(i, part)] * moved[(i, part)]).sum::<f64>();
        let added = |i: usize| self.shift * (damping[i] + self.shift * mass[i]) * x[i].norm_sqr();
        let whole: f64 = x.iter().zip(&elastic).map(|(x, f)| (x.conj() * f).re).sum();
        let whole = whole + (0..n).map(added).sum::<f64>();
        [((work(0) + work(1)).max(0.0) / whole).sqrt(), f64::EPSILON * sizes / whole]
    }

    /// 2s xᵀMy + xᵀCy; 0 for two distinct modes of equal s.
    fn across(&self, s: c64, x: &[c64], y: &[c64]) -> c64 {
        let Rest { mass, damping, .. } = self.rest;
        x.iter()
            .zip(y)
            .zip(mass.iter().zip(damping))
            .map(|((x, y), (m, c))| x * y * (2.0 * s * *m + *c))
            .sum()
    }
}

#[cfg(test)]
mod tests;
