//! The stages of a projection.
//!
//! 0. A feasible target is returned unchanged.
//! 1. *Sequence*: linearise at the target, solve, linearise at the solution, and so on: a few programs with near rows only.
//! 2. *Path*: from the previous design, steps short enough (proximal term) for linearisation, tested with the exact penalty
//!    `½ Σ w (α − target)² + ρ Σ max(0, ε − c)`; a last sequence refines the result.
//! 3. *Repair*: the same from the target, if the previous design is infeasible.
//!
//! A result is returned only if the exact check (`exact.rs`) accepts it, otherwise the previous design.

use super::program::{MARGIN, ProgramInput, Step};
use super::rows::{Key, Row, RowKind};
use super::{FeasibleSet, ViolationKind};
use crate::body::End;

/// Outcome of a projection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// The target is feasible and is returned unchanged.
    Untouched,
    /// A feasible design near the target is returned.
    Projected,
    /// No feasible design was found; the previous design, which is feasible, is returned.
    Kept,
    /// The target or the weights contain NaN or infinity; the previous design, which is feasible, is returned.
    NotFinite,
    /// No feasible design was found; the previous design is returned and is infeasible, too.
    Infeasible,
}

impl Status {
    /// Name in records and commands.
    pub fn name(self) -> &'static str {
        match self {
            Status::Untouched => "untouched",
            Status::Projected => "projected",
            Status::Kept => "kept",
            Status::NotFinite => "not_finite",
            Status::Infeasible => "infeasible",
        }
    }

    /// Whether the returned design is feasible.
    pub fn is_feasible(self) -> bool {
        !matches!(self, Status::Infeasible)
    }
}

/// Stage at which a projection ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// No program was needed.
    None,
    /// The sequence from the target.
    Sequence,
    /// The path from the previous design.
    Path,
    /// The path from an infeasible start.
    Repair,
}

/// An active constraint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Active {
    /// Kind of constraint.
    pub kind: ViolationKind,
    /// The units; equal if only one is concerned.
    pub units: [usize; 2],
    /// Node of the first unit.
    pub node: usize,
    /// Distance to the limit (mm; angles times their shorter edge).
    pub slack: f64,
}

/// Result of a projection.
#[derive(Debug, Clone, PartialEq)]
pub struct Projection {
    /// The returned design.
    pub design: Vec<f64>,
    /// Outcome.
    pub status: Status,
    /// Stage of the returned design, or the last stage tried.
    pub stage: Stage,
    /// Euclidean distance from the target (mm); NaN if the target is not finite.
    pub distance: f64,
    /// Constraints within 1e-3 mm of their limits.
    pub active: Vec<Active>,
    /// Clarabel's interior-point iterations.
    pub iterations: u64,
    /// Number of convex programs solved.
    pub programs: u64,
}

/// Rows of a sequence: those closer to their limit than this (mm).
const WINDOW: f64 = 0.3;
/// Least weight, relative to the mean: v̂ is zero where nothing depends on a shift.
const LEAST_WEIGHT: f64 = 1e-3;
/// ρ: larger than observed multipliers (mm, at mean weight 1).
const PENALTY: f64 = 100.0;
/// A result with a coordinate farther from its target than this also tries a path (mm).
const FAR: f64 = 0.5;

/// Largest number of programs of a sequence.
const SEQUENCE_PROGRAMS: usize = 12;
/// Largest number of programs of a path.
const PATH_PROGRAMS: usize = 150;
/// Rows of a path: those closer to their limit than this (mm).
const REACH: f64 = 3.0;
/// Length of the first step of a path (mm, largest coordinate).
const STRIDE: f64 = 1.0;

/// Euclidean distance between two designs.
pub fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// Largest number of edges that are rotated, and least distance of their ends from the target together (mm).
const TURNS: usize = 6;
const FAR_EDGE: f64 = 3.0;
/// Bodies with more units, or with tied edges, skip the rotation of edges, which costs too much.
const LARGE: usize = 100;

/// Target and metric of a projection.
struct Aim<'a> {
    target: &'a [f64],
    weights: Vec<f64>,
}

impl Aim<'_> {
    fn wish(&self, x: &[f64]) -> Vec<f64> {
        self.target.iter().zip(x).map(|(t, x)| t - x).collect()
    }

    /// ½ Σ w (x − target)².
    fn cost(&self, x: &[f64]) -> f64 {
        let terms = self.target.iter().zip(x).zip(&self.weights);
        0.5 * terms.map(|((t, x), w)| w * (t - x) * (t - x)).sum::<f64>()
    }
}

impl FeasibleSet {
    /// Finds the feasible design nearest to `target` in the metric `weights` (per coordinate, such as Adam's √v̂; `None`:
    /// Euclidean), or returns `previous`, as the status states. Reuses memory of earlier calls, but no results.
    ///
    /// # Panics
    /// If a length differs from the layout's.
    pub fn project(&mut self, previous: &[f64], target: &[f64], weights: Option<&[f64]>) -> Projection {
        let n = self.layout.design_len();
        assert_eq!([previous.len(), target.len()], [n, n], "lengths of the designs");
        self.program.reset();
        let mut target = target.to_vec();
        for (i, (t, p)) in target.iter_mut().zip(previous).enumerate() {
            if self.program.fixed[i / 2] {
                *t = *p;
            }
        }
        if !target.iter().all(|t| t.is_finite()) {
            return self.kept(previous, &target, Status::NotFinite, Stage::None);
        }
        if self.violations(&target).is_empty() {
            return self.build_projection(target.clone(), &target, Status::Untouched, Stage::None);
        }
        let Some(weights) = metric(n, weights) else {
            return self.kept(previous, &target, Status::NotFinite, Stage::None);
        };
        let aim = Aim { target: &target, weights };
        let mut stage = Stage::Sequence;
        let mut best = self.sequence(&aim, target.clone());
        let near = |x: &Vec<f64>| x.iter().zip(&target).all(|(x, t)| (x - t).abs() <= FAR);
        if !best.as_ref().is_some_and(near) {
            let (name, start) = match self.violations(previous).is_empty() {
                true => (Stage::Path, previous.to_vec()),
                false => (Stage::Repair, target.clone()),
            };
            if let Some(x) = self.path(&aim, start)
                && best.as_ref().is_none_or(|b| aim.cost(&x) < aim.cost(b))
            {
                (best, stage) = (Some(x), name);
            }
        }
        if stage != Stage::Sequence {
            best = best.map(|x| self.turn_edges(&aim, x));
        }
        match best {
            Some(x) => self.build_projection(x, &target, Status::Projected, stage),
            None => self.kept(previous, &target, Status::Kept, Stage::Repair),
        }
    }

    /// Sequential quadratic programs from `x`; the result if it converges to a feasible design.
    fn sequence(&mut self, aim: &Aim<'_>, mut x: Vec<f64>) -> Option<Vec<f64>> {
        let mut near = self.rows.near(&x, WINDOW, 2.0);
        let mut rows = self.rows.collect(&near, &x, WINDOW);
        let mut guess: Option<Vec<Key>> = None;
        for _ in 0..SEQUENCE_PROGRAMS {
            let wish = aim.wish(&x);
            let ask = ProgramInput { wish: &wish, weights: &aim.weights, proximal: 0.0, penalty: None };
            let solved = match &guess {
                Some(active) => self.program.solve_from(&rows, &ask, active),
                None => self.program.solve(&rows, &ask),
            };
            let Step { step, active } = solved?;
            guess = Some(active);
            for (x, d) in x.iter_mut().zip(&step) {
                *x += d;
            }
            self.rows.refresh(&mut near, &x, WINDOW);
            rows = self.rows.collect(&near, &x, WINDOW);
            let small = squares(&step) <= 1e-4 * squares(&aim.wish(&x));
            if small && rows.iter().all(|r| self.holds(r)) {
                return self.violations(&x).is_empty().then_some(x);
            }
        }
        None
    }

    /// Looks for a nearer design on the other side of the shortest edges. If a far target inverts an edge, clockwise and
    /// anticlockwise paths end in different designs. Rotates the edges farthest from their target by ±90° and continues from
    /// there.
    fn turn_edges(&mut self, aim: &Aim<'_>, mut best: Vec<f64>) -> Vec<f64> {
        if self.layout.units() > LARGE || self.program.leader.is_some() {
            return best;
        }
        let off =
            |x: &[f64], g: usize| (x[2 * g] - aim.target[2 * g]).hypot(x[2 * g + 1] - aim.target[2 * g + 1]);
        let mut edges: Vec<(f64, [usize; 2], [f64; 2])> = Vec::new();
        let vertices = self.layout.vertices(&best);
        for active in self.active(&best).iter().filter(|a| a.kind == ViolationKind::Edge) {
            let (unit, p) = (active.units[0], active.node);
            let next = self.layout.next(End { unit, node: p }).node;
            let [Some(here), Some(there)] = [p, next].map(|node| self.layout.groups.of_nodes[unit][node])
            else {
                continue;
            };
            let groups = [here, there];
            if groups.iter().any(|&g| self.program.fixed[g]) {
                continue;
            }
            let (s, t) = (vertices[unit][p], vertices[unit][next]);
            edges.push((groups.map(|g| off(&best, g)).iter().sum(), groups, [t[0] - s[0], t[1] - s[1]]));
        }
        edges.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        for (distance, [s, t], [x, y]) in edges.into_iter().take(TURNS) {
            if distance < FAR_EDGE {
                break;
            }
            for sense in [1.0, -1.0] {
                // Half the displacement that rotates the edge by 90°, at either end.
                let half = [0.5 * (x + sense * y), 0.5 * (y - sense * x)];
                let mut start = best.clone();
                for c in 0..2 {
                    start[2 * s + c] += half[c];
                    start[2 * t + c] -= half[c];
                }
                if let Some(x) = self.path(aim, start)
                    && aim.cost(&x) < (1.0 - 1e-6) * aim.cost(&best)
                {
                    best = x;
                    break;
                }
            }
        }
        best
    }

    /// Whether a row holds, or depends on fixed groups only.
    fn holds(&self, row: &Row) -> bool {
        row.value >= 0.0 || row.terms().iter().all(|t| self.program.fixed[t.0 as usize])
    }

    /// Proximal steps on the exact penalty from `x`, then a sequence from their end.
    fn path(&mut self, aim: &Aim<'_>, mut x: Vec<f64>) -> Option<Vec<f64>> {
        let mut near = self.rows.near(&x, REACH, 4.0);
        let mut rows = self.rows.collect(&near, &x, REACH);
        let mut merit = aim.cost(&x) + PENALTY * shortfall(&rows, |r| r.value);
        let longest = aim.wish(&x).iter().fold(0.0_f64, |m, d| m.max(d.abs()));
        let mut proximal = (longest / STRIDE - 1.0).max(0.0);
        let mut feasible: Option<Vec<f64>> = None;
        for _ in 0..PATH_PROGRAMS {
            let wish = aim.wish(&x);
            let ask = ProgramInput { wish: &wish, weights: &aim.weights, proximal, penalty: Some(PENALTY) };
            let Some(Step { step, .. }) = self.program.solve(&rows, &ask) else {
                proximal = 4.0 * proximal.max(0.25);
                continue;
            };
            let trial: Vec<f64> = x.iter().zip(&step).map(|(x, d)| x + d).collect();
            let model = aim.cost(&trial) + PENALTY * shortfall(&rows, |r| r.value_after(&step));
            let mut near_trial = near.clone();
            self.rows.refresh(&mut near_trial, &trial, REACH);
            let rows_trial = self.rows.collect(&near_trial, &trial, REACH);
            let merit_trial = aim.cost(&trial) + PENALTY * shortfall(&rows_trial, |r| r.value);
            let (predicted, actual) = (merit - model, merit - merit_trial);
            if predicted <= 1e-7 * merit || proximal > 1e6 {
                break;
            }
            if actual < 0.1 * predicted {
                proximal = 3.0 * proximal.max(0.2);
                continue;
            }
            if actual > 0.7 * predicted {
                proximal = if proximal < 0.05 { 0.0 } else { proximal / 3.0 };
            }
            (x, rows, near, merit) = (trial, rows_trial, near_trial, merit_trial);
            if rows.iter().all(|r| self.holds(r)) {
                feasible = Some(x.clone());
            }
            if actual <= 1e-6 * merit {
                break;
            }
        }
        // Three candidates: a sequence to the target, one to the nearest feasible design, the best design of the path.
        let polished = self.sequence(aim, x.clone());
        let snapped = self.sequence(&Aim { target: &x, weights: aim.weights.clone() }, x.clone());
        let feasible = feasible.filter(|f| self.violations(f).is_empty());
        [polished, snapped, feasible].into_iter().flatten().min_by(|a, b| aim.cost(a).total_cmp(&aim.cost(b)))
    }

    fn build_projection(&self, design: Vec<f64>, target: &[f64], status: Status, stage: Stage) -> Projection {
        Projection {
            active: self.active(&design),
            distance: distance(&design, target),
            design,
            status,
            stage,
            iterations: self.program.iterations,
            programs: self.program.programs,
        }
    }

    fn kept(&self, previous: &[f64], target: &[f64], status: Status, stage: Stage) -> Projection {
        let status = if self.violations(previous).is_empty() { status } else { Status::Infeasible };
        self.build_projection(previous.to_vec(), target, status, stage)
    }

    /// Constraints of `design` within 1e-3 mm of their limits (angles times their shorter edge).
    pub fn active(&self, design: &[f64]) -> Vec<Active> {
        if !(self.limits.enforced && design.iter().all(|x| x.is_finite())) {
            return Vec::new();
        }
        let rows = self.rows.collect(&self.rows.near(design, 1e-3, 0.0), design, 1e-3);
        rows.iter().map(|row| self.rows.describe(row)).collect()
    }
}

impl super::rows::Rows {
    fn describe(&self, row: &Row) -> Active {
        let [first, second, _] = row.key.at.map(|n| n as usize);
        let unit = self.unit(first);
        let (kind, units) = match row.key.kind {
            RowKind::Edge => (ViolationKind::Edge, [unit, unit]),
            RowKind::AngleLow => (ViolationKind::BlockAngleLow, [unit, unit]),
            RowKind::AngleHigh => (ViolationKind::BlockAngleHigh, [unit, unit]),
            RowKind::Ligament => (ViolationKind::LigamentAngle, [unit, unit]),
            RowKind::Void => (ViolationKind::VoidAngle, [unit, self.across(first, second)]),
            RowKind::Corners | RowKind::Side | RowKind::Through if row.bar => {
                (ViolationKind::LigamentClearance, [unit, self.unit(second)])
            }
            RowKind::Corners | RowKind::Side | RowKind::Through => {
                (ViolationKind::Clearance, [unit, self.unit(second)])
            }
        };
        Active { kind, units, node: first - self.first(unit), slack: row.value }
    }
}

/// The weights, scaled to mean 1 and raised to the least weight; `None` if one is not finite.
pub(super) fn metric(n: usize, weights: Option<&[f64]>) -> Option<Vec<f64>> {
    let Some(weights) = weights else { return Some(vec![1.0; n]) };
    assert_eq!(weights.len(), n, "length of the weights");
    let mean = weights.iter().sum::<f64>() / n as f64;
    if !(mean.is_finite() && weights.iter().all(|w| *w >= 0.0)) {
        return None;
    }
    if mean == 0.0 {
        return Some(vec![1.0; n]);
    }
    Some(weights.iter().map(|w| (w / mean).max(LEAST_WEIGHT)).collect())
}

fn squares(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x).sum()
}

/// Σ max(0, ε − c) for these values c of the rows.
fn shortfall(rows: &[Row], value: impl Fn(&Row) -> f64) -> f64 {
    rows.iter().map(|row| (MARGIN - value(row)).max(0.0)).sum()
}
