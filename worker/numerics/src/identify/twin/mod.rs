//! A twin: of all casts that a body may be, the one that best explains records of it.
//!
//! ```text
//! min over z:  F = ½ ‖R^{-½} (y − a(z))‖² + ½ ‖z‖²      z standard normal, of what a [`Variation`] scatters; R noise and bias
//! ```
//! The maximum a posteriori estimate. L-BFGS (Nocedal, Math. Comput. 35, 1980) from the adjoint's gradients, in the metric of
//! Gauss and Newton's curvature of a few records, damped as by Marquardt. A wave's phase makes F hilly, so the fit begins
//! with the first part of each record and lengthens it.

mod objective;
mod unknowns;

use crate::definite::{inverse, solved_dense};
use crate::dynamics::{Accuracy, Counters, Forces, Solver};
use crate::identify::Offset;
use crate::identify::discrepancy::explained;
use crate::identify::interval::grouped;
use crate::student::student;
use crate::trial::{Chip, Mould, Problem, tuned};
use crate::variation::{Cast, Variation};
use nalgebra::{DMatrix, DVector};
use objective::{Columns, Objective, Point};
pub use unknowns::Unknown;
use unknowns::Unknowns;

/// How a fit ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// What is left of a step is a part of a standard error.
    Converged,
    /// No step lowers what is minimised any more, though its gradient asks for one.
    NoProgress,
    /// All steps are spent.
    StepsSpent,
    /// Where it was to begin, the body cannot be simulated.
    StartFailed,
}

impl Ending {
    /// The name by which people know it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::NoProgress => "no progress",
            Self::StepsSpent => "steps spent",
            Self::StartFailed => "the start cannot be simulated",
        }
    }
}

/// Asked in the course of long work whether it is to go on.
pub type GoOn<'a> = dyn FnMut() -> bool + 'a;

/// What a twin says of one unknown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Which.
    pub unknown: Unknown,
    /// Its standard deviation before any record: of a logarithm, in rad, in mm.
    pub scatter: f64,
    /// z: where it was found, in those.
    pub found: f64,
    /// Its standard deviation after the records, in those; 1: they tell nothing.
    pub left: f64,
    /// Half its 95 % interval, in those, which knows of what the model lacks; of a fit that was asked for it.
    pub half: Option<f64>,
}

/// A twin.
#[derive(Debug, Clone, PartialEq)]
pub struct Twin {
    /// The cast that explains the records best; as designed where none was found.
    pub cast: Cast,
    /// Root mean square over the channels of what is left of the signals by the noise of the chips; 1 where that is not known, and what is
    /// left stands for it.
    pub misfit: f64,
    /// What stands for the noise of each channel that is read (mm/s², rad/s): what is left, but no less than the chips'.
    pub noise: Vec<f64>,
}

/// How a twin was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// It.
    pub twin: Twin,
    /// Of each unknown.
    pub estimates: Vec<Estimate>,
    /// By how much later each record's readings were taken than it says, where clocks may be off and intervals were asked for; none of
    /// a record that the body cannot be simulated under.
    pub offsets: Vec<Option<Offset>>,
    /// How the fit ended.
    pub ending: Ending,
    /// Share of what is left that the motion explains on records that were not asked, where several were fitted and intervals asked for:
    /// what the model lacks.
    pub unmodelled: Option<f64>,
    /// Steps taken.
    pub steps: usize,
    /// Work done.
    pub counters: Counters,
}

/// Parts of the records that are looked at, one after the other.
const WINDOWS: [f64; 5] = [1.0 / 32.0, 0.0625, 0.125, 0.25, 1.0];
/// Records of which a metric is made: as many as lanes take at once.
const LANES: usize = 8;
/// Steps in one metric, at most.
const STEPS: usize = 20;
/// Metrics of the whole records, at most.
const ROUNDS: usize = 4;
/// Newton decrement, in standard errors, below which a step is nothing, and the part of F that it promises at least in the first windows.
const CLOSE: f64 = 0.3;
const WORTH: f64 = 0.01;
/// Change of the noise below which it stays.
const STAYS: f64 = 0.02;
/// Error of the signals by steps under measured records, in which it does not average out.
const FINE: Accuracy = Accuracy(1e-4);
/// Longest step of any unknown.
const STRIDE: f64 = 2.0;
/// Shortest part of a step.
const SHORTEST: f64 = 1e-4;

impl Fit {
    /// Of a trial's body from signals (N, T, channels) as its chips give them under `forces`. What
    /// scatters is the trial's variation, or [`Variation::USUAL`]. Samples that failed must be left out. `None` if it is told meanwhile not to
    /// go on.
    ///
    /// # Panics
    /// If lengths do not fit together.
    pub(crate) fn of(mould: &Mould, records: (&Forces, &[f64]), go_on: &mut GoOn) -> Option<Self> {
        let &Mould { trial, design, solver } = mould;
        let variation = trial.problem.variation.unwrap_or(Variation::USUAL);
        let chip = trial.chip.as_ref();
        let records = (records.0, records.1, 0.0);
        fit(&trial.problem, chip, design, solver, records, &variation, false, trial.pool, go_on)
    }

    /// The same of a problem's body, from measured records, with intervals. Noise that the spec has relative is so to the records, whose
    /// clocks are off by a standard deviation (s).
    ///
    /// # Panics
    /// Likewise.
    pub fn of_records(
        problem: &Problem,
        design: &[f64],
        records: (&Forces, &[f64], f64),
        pool: &crate::Pool,
    ) -> Self {
        let width = problem.shape().inputs;
        let rms = |c: usize| {
            let of = records.1[c..].iter().step_by(width);
            (of.map(|y| y * y).sum::<f64>() * width as f64 / records.1.len() as f64).sqrt()
        };
        let chip = problem.chip(&(0..width).map(rms).collect::<Vec<_>>());
        let asked = problem.solver.at_most(FINE);
        let solver = tuned(problem, design, records.0, &asked, pool).solver;
        let variation = problem.variation.unwrap_or(Variation::USUAL);
        let found =
            fit(problem, chip.as_ref(), design, &solver, records, &variation, true, pool, &mut || true);
        found.expect("told to go on")
    }
}

fn fit(
    problem: &Problem,
    chip: Option<&Chip>,
    design: &[f64],
    solver: &Solver,
    records: (&Forces, &[f64], f64),
    variation: &Variation,
    intervals: bool,
    pool: &crate::Pool,
    go_on: &mut GoOn,
) -> Option<Fit> {
    let unknowns = Unknowns::new(&problem.scene, variation, pool);
    let mut objective = Objective::new(problem, chip, design, records, unknowns, solver, pool);
    let start = DVector::zeros(objective.unknowns.all().len());
    let cast = objective.unknowns.cast(start.as_slice());
    let mut fit = Fit {
        twin: Twin { cast, misfit: f64::INFINITY, noise: Vec::new() },
        estimates: Vec::new(),
        offsets: Vec::new(),
        ending: Ending::StartFailed,
        unmodelled: None,
        steps: 0,
        counters: Counters::default(),
    };
    if objective.leave_out() > 0 {
        fit.ending = Ending::NoProgress;
        let mut z = start;
        for part in WINDOWS {
            objective.look_at((part * problem.scene.instants as f64).ceil() as usize);
            let Some(point) = objective.at(z.clone()) else { break };
            let (point, columns) = match part < 1.0 {
                true => fit.settle(&mut objective, point, 1, WORTH, go_on)?,
                false => fit.settle(&mut objective, point, ROUNDS, 0.0, go_on)?,
            };
            z.copy_from(&point.z);
            if part == 1.0 {
                fit.tell(&objective, &point, &columns);
                if intervals {
                    let columns = objective.columns(&point, usize::MAX);
                    fit.bound(&objective, &point, &columns);
                }
            }
        }
    }
    fit.counters = objective.counters;
    Some(fit)
}

impl Fit {
    /// Noise and fit in turns, in the window that is looked at, until both stay; where that led, and columns near there.
    fn settle(
        &mut self,
        objective: &mut Objective,
        mut point: Point,
        rounds: usize,
        worth: f64,
        go_on: &mut GoOn,
    ) -> Option<(Point, Columns)> {
        objective.weigh(&point);
        let mut columns = objective.columns(&point, LANES);
        for round in 0..rounds {
            if round > 0 && self.ending != Ending::Converged {
                columns = objective.columns(&point, LANES);
            }
            let curvature = objective.curvature(&columns);
            let (ending, steps, found) =
                descend(objective, objective.again(point), &curvature, worth, go_on)?;
            (self.ending, self.steps, point) = (ending, self.steps + steps, found);
            if objective.weigh(&point) < STAYS && ending == Ending::Converged {
                break;
            }
        }
        Some((point, columns))
    }

    /// What was found, and how well it is known.
    fn tell(&mut self, objective: &Objective, point: &Point, columns: &Columns) {
        let (unknowns, [left, _]) = (&objective.unknowns, objective.noises(point));
        self.twin.misfit = objective.known_noise().map_or(1.0, |known| {
            let squares: f64 = left.iter().zip(&known).map(|(left, known)| (left / known).powi(2)).sum();
            (squares / left.len() as f64).sqrt()
        });
        self.twin.noise.clone_from(&objective.noise);
        self.twin.cast = unknowns.cast(point.z.as_slice());
        let covariance = covariance(objective.curvature(columns));
        let of = |(k, &unknown): (usize, &Unknown)| {
            let scatter = unknowns.deviation(unknown);
            Estimate { unknown, scatter, found: point.z[k], left: covariance[(k, k)].sqrt(), half: None }
        };
        self.estimates = unknowns.all().iter().enumerate().map(of).collect();
    }
}

impl Fit {
    /// Intervals: the covariance H⁻¹ ((1 + u (G − 1)) Σ s sᵀ + 1) H⁻¹ of the estimate, s = Jᵀr of each of G groups, so that what is left
    /// may be correlated within a group, and its share u that is not noise, or follows from the motion alike in all of them, does not average out.
    fn bound(&mut self, objective: &Objective, point: &Point, columns: &Columns) {
        let (records, jacobian) = (columns.records.len(), objective.jacobian(columns));
        let [read, left, residual] = objective.parts(point, &columns.records);
        let width = self.twin.noise.len();
        self.unmodelled = explained(&read, &left, records, width);
        let (group, count) = grouped([records, residual.len() / (records * width), width]);
        let mut scores = DMatrix::zeros(count, jacobian.ncols());
        for (k, column) in jacobian.column_iter().enumerate() {
            for ((&group, r), j) in group.iter().zip(&residual).zip(column.iter()) {
                scores[(group, k)] += r * j;
            }
        }
        let inverse =
            covariance(jacobian.tr_mul(&jacobian) + DMatrix::identity(scores.ncols(), scores.ncols()));
        let beyond = 1.0 - self.twin.misfit.max(1.0).powi(-2);
        let alike = 1.0 + self.unmodelled.unwrap_or(0.0).max(beyond) * (count - 1) as f64;
        let (moved, t) = (scores * &inverse, student(count - 1));
        let covariance = t * t * (alike * moved.tr_mul(&moved) + &inverse * &inverse);
        let shared = (alike - 1.0) / (count - 1).max(1) as f64;
        self.offsets = objective.offsets(point, columns, &jacobian, &covariance, shared);
        for (k, estimate) in self.estimates.iter_mut().enumerate() {
            estimate.left = inverse[(k, k)].sqrt();
            estimate.half = Some(covariance[(k, k)].sqrt());
        }
    }
}

/// L-BFGS in the metric of a curvature, as long as steps are worth this part of F: how it ended, after how many and where.
fn descend(
    objective: &mut Objective,
    mut point: Point,
    curvature: &DMatrix<f64>,
    worth: f64,
    go_on: &mut GoOn,
) -> Option<(Ending, usize, Point)> {
    let (mut memory, mut damping): (Vec<[DVector<f64>; 2]>, f64) = (Vec::new(), 0.0);
    let mut gradient = objective.gradient(&point);
    for steps in 0..STEPS {
        if !go_on() {
            return None;
        }
        if gradient.iter().any(|slope| !slope.is_finite()) {
            return Some((Ending::NoProgress, steps, point));
        }
        // too long a step: first as Gauss and Newton have it, then damped
        let step = loop {
            let mut damped = curvature.clone();
            (0..damped.nrows()).for_each(|k| damped[(k, k)] += damping);
            let Some(step) = along(&memory, &gradient, |q| solved_dense(damped, 1.0 + damping, q)) else {
                return Some((Ending::NoProgress, steps, point));
            };
            let step = -step;
            if step.amax() <= STRIDE {
                break step;
            }
            damping = if memory.is_empty() { (4.0 * damping).max(1.0) } else { damping };
            memory.clear();
        };
        let slope = gradient.dot(&step);
        if -slope < (CLOSE * CLOSE).max(worth * point.cost) {
            return Some((Ending::Converged, steps, point));
        }
        let mut by = 1.0;
        let found = loop {
            let there = objective.at(&point.z + by * &step);
            if let Some(there) = there.filter(|there| there.cost <= point.cost + 1e-4 * by * slope) {
                break there;
            }
            by *= 0.3;
            if by < SHORTEST {
                return Some((Ending::NoProgress, steps, point));
            }
        };
        let next = objective.gradient(&found);
        let (s, y) = (&found.z - &point.z, &next - &gradient);
        if s.dot(&y) > 1e-10 * s.norm() * y.norm() {
            memory.push([s, y]);
        }
        (point, gradient) = (found, next);
        damping = if damping > 1.0 { damping / 4.0 } else { 0.0 };
    }
    Some((Ending::StepsSpent, STEPS, point))
}

/// The inverse of a curvature, which is 1 and more along every direction; of numbers that are none no more is known than before.
fn covariance(curvature: DMatrix<f64>) -> DMatrix<f64> {
    let unknowns = curvature.nrows();
    inverse(curvature, 1.0).unwrap_or_else(|| DMatrix::identity(unknowns, unknowns))
}

/// H⁻¹ g by the two loops of L-BFGS, H at first that of the metric; `None` of numbers that are none.
fn along(
    memory: &[[DVector<f64>; 2]],
    gradient: &DVector<f64>,
    metric: impl FnOnce(&DVector<f64>) -> Option<DVector<f64>>,
) -> Option<DVector<f64>> {
    let mut q = gradient.clone();
    let mut taken = Vec::with_capacity(memory.len());
    for [s, y] in memory.iter().rev() {
        let part = s.dot(&q) / s.dot(y);
        q.axpy(-part, y, 1.0);
        taken.push(part);
    }
    let mut step = metric(&q)?;
    for ([s, y], part) in memory.iter().zip(taken.into_iter().rev()) {
        let back = y.dot(&step) / s.dot(y);
        step.axpy(part - back, s, 1.0);
    }
    Some(step)
}

#[cfg(test)]
mod tests;
