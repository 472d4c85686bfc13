//! Minimises F by L-BFGS (Nocedal, Math. Comput. 35, 1980) with adjoint gradients. The metric is the Gauss–Newton curvature, damped after
//! Marquardt (SIAM J. Appl. Math. 11, 1963). Updates of noise and fit alternate.

use super::objective::{Columns, FitPoint, Misfit};
use super::{Ending, Estimate, Fit, FitIteration, GoOn, Iteration, Unknown};
use crate::definite::{inverse, solved_dense};
use crate::dynamics::Parameters;
use nalgebra::{DMatrix, DVector};

/// Records per metric: the number of SIMD lanes, twice as many for measured records.
const LANES: usize = 8;
/// Relative change of the noise below which it has converged.
const STAYS: f64 = 0.02;
/// Shortest fraction of a step in the line search.
const SHORTEST: f64 = 1e-4;

/// Limits and tolerances.
#[derive(Debug, Clone, Copy)]
pub struct How {
    /// Largest number of rounds of noise and fit. An unconverged round is followed by a new metric.
    pub rounds: usize,
    /// Largest number of steps per round.
    pub steps: usize,
    /// Least predicted decrease of a step, relative to F.
    pub worth: f64,
    /// Newton decrement (standard errors) below which the fit has converged.
    pub close: f64,
}

/// A fit in progress.
pub struct Descent<'a> {
    pub objective: Misfit<'a>,
    go_on: &'a mut GoOn<'a>,
    known: &'a [FitIteration],
    watch: &'a mut dyn FnMut(&FitIteration),
    pub iterations: Vec<Iteration>,
    pub steps: usize,
    /// Ending of the last round.
    pub ending: Ending,
}

impl<'a> Descent<'a> {
    pub fn new(
        objective: Misfit<'a>,
        go_on: &'a mut GoOn<'a>,
        known: &'a [FitIteration],
        watch: &'a mut dyn FnMut(&FitIteration),
    ) -> Self {
        let (iterations, ending) = (Vec::new(), Ending::NoProgress);
        Self { objective, go_on, known, watch, iterations, steps: 0, ending }
    }

    /// Alternates noise and fit in the present window until both converge. Returns the final point and Jacobian columns near it (no columns
    /// if all rounds are in `known`). `None` if `go_on` returns `false`.
    pub fn settle(&mut self, mut point: FitPoint, how: How) -> Option<(FitPoint, Option<Columns>)> {
        self.objective.weigh(&point);
        let begun = self.iterations.len();
        // Then no caller needs columns.
        let all_known = self.known.len() > begun + how.rounds;
        let most = if self.objective.is_measured() { 2 * LANES } else { LANES };
        let mut columns = None;
        for round in 0..how.rounds {
            if !all_known && (round == 0 || self.ending != Ending::Converged) {
                columns = Some(self.objective.columns(&point, most));
            }
            let turn = match (self.known.get(self.iterations.len()), &columns) {
                (Some(turn), _) => {
                    point = self.objective.at(DVector::from_vec(turn.z.clone())).expect("it was simulated");
                    turn.clone()
                }
                (None, columns) => {
                    let columns = columns.as_ref().expect("not all is known");
                    let curvature = self.objective.curvature(&point, columns);
                    let (ending, steps, found) = self.descend(point, &curvature, how)?;
                    point = found;
                    self.told(&point, ending, steps)
                }
            };
            self.iterations.push(turn.iteration);
            (self.ending, self.steps) = (turn.ending, self.steps + turn.steps);
            if self.objective.weigh(&point) < STAYS && self.ending == Ending::Converged {
                break;
            }
        }
        Some((point, columns))
    }

    fn told(&mut self, point: &FitPoint, ending: Ending, steps: usize) -> FitIteration {
        let mut parameters = self.objective.parameters();
        parameters.iter_mut().zip(point.cast.material.array()).for_each(|(own, by)| *own *= by);
        let iteration = Iteration {
            window: self.objective.seconds(),
            misfit: self.objective.misfit(point)[1],
            parameters: Parameters::from_array(parameters),
        };
        let turn = FitIteration { iteration, z: point.z.as_slice().to_vec(), ending, steps };
        (self.watch)(&turn);
        turn
    }

    /// L-BFGS in the metric `curvature`. Returns ending, number of steps and final point.
    fn descend(
        &mut self,
        point: FitPoint,
        curvature: &DMatrix<f64>,
        how: How,
    ) -> Option<(Ending, usize, FitPoint)> {
        let objective = &mut self.objective;
        let mut point = objective.again(point);
        let (mut memory, mut damping): (Vec<[DVector<f64>; 2]>, f64) = (Vec::new(), 0.0);
        let mut gradient = objective.gradient(&point);
        for steps in 0..how.steps {
            if !(self.go_on)() {
                return None;
            }
            if gradient.iter().any(|slope| !slope.is_finite()) {
                return Some((Ending::NoProgress, steps, point));
            }
            // Hold free parameters at a limit if descent leads beyond it.
            let held = objective.held(&point, &gradient);
            let mut metric = curvature.clone();
            for &k in &held {
                memory.clear();
                gradient[k] = 0.0;
                metric.row_mut(k).fill(0.0);
                metric.column_mut(k).fill(0.0);
                metric[(k, k)] = 1.0;
            }
            // Shorten a long step: first drop the memory, then damp.
            let step = loop {
                let mut damped = metric.clone();
                (0..damped.nrows()).for_each(|k| damped[(k, k)] += damping);
                let Some(step) = along(&memory, &gradient, |q| solved_dense(damped, 1.0 + damping, q)) else {
                    return Some((Ending::NoProgress, steps, point));
                };
                let step = -step;
                if objective.strides(&step) <= 1.0 {
                    break step;
                }
                damping = if memory.is_empty() { (4.0 * damping).max(1.0) } else { damping };
                memory.clear();
            };
            let slope = gradient.dot(&step);
            if -slope < (how.close * how.close).max(how.worth * point.cost) {
                return Some((Ending::Converged, steps, point));
            }
            let mut by = 1.0;
            let found = loop {
                let there = objective.at(&point.z + by * objective.padded(&step));
                if let Some(there) = there.filter(|there| there.cost <= point.cost + 1e-4 * by * slope) {
                    break there;
                }
                by *= 0.3;
                if by < SHORTEST {
                    return Some((Ending::NoProgress, steps, point));
                }
            };
            let next = objective.gradient(&found);
            let (s, y) = ((&found.z - &point.z).rows(0, step.len()).into_owned(), &next - &gradient);
            if s.dot(&y) > 1e-10 * s.norm() * y.norm() {
                memory.push([s, y]);
            }
            (point, gradient) = (found, next);
            damping = if damping > 1.0 { damping / 4.0 } else { 0.0 };
        }
        Some((Ending::StepsSpent, how.steps, point))
    }
}

impl Fit {
    /// Stores the cast, its misfit and noise, and the estimates.
    pub(super) fn tell(&mut self, objective: &Misfit<'_>, point: &FitPoint, columns: &Columns) {
        let (unknowns, [left, _]) = (&objective.unknowns, objective.noises(point));
        self.twin.misfit = objective.known_noise().map_or(1.0, |known| {
            let squares: f64 = left.iter().zip(&known).map(|(left, known)| (left / known).powi(2)).sum();
            (squares / left.len() as f64).sqrt()
        });
        self.twin.noise.clone_from(&objective.readings.noise);
        self.twin.cast = unknowns.cast(point.z.as_slice());
        let covariance = covariance(objective.curvature(point, columns));
        let of = |(k, &unknown): (usize, &Unknown)| Estimate {
            unknown,
            scatter: unknowns.deviation(unknown),
            found: point.z[k],
            left: covariance[(k, k)].sqrt(),
            half: None,
            at_the_bound: false,
        };
        self.estimates = unknowns.all().iter().enumerate().map(of).collect();
    }
}

/// Inverse of a curvature, whose eigenvalues are at least 1. Returns the prior's covariance (identity) if entries are not finite.
pub fn covariance(curvature: DMatrix<f64>) -> DMatrix<f64> {
    let unknowns = curvature.nrows();
    inverse(curvature, 1.0).unwrap_or_else(|| DMatrix::identity(unknowns, unknowns))
}

/// H⁻¹ g by the two-loop recursion of L-BFGS, starting from the metric. `None` if entries are not finite.
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
