//! One convex program of the projection, in Clarabel's form.
//!
//! ```text
//! minimise   Σ ½ w (d − d*)² + ½ τ d² + ρ Σ s
//! subject to value + gradient·d + s ≥ ε     s ≥ 0, only in rows that are violated now (if elastic)
//! ```
//! Coordinates without rows have a closed solution. Active rows of the last program are first tried as equations (one
//! factorisation instead of a dozen), and accepted if multipliers and other rows agree.

use super::rows::{Key, Row};
use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus, ZeroConeT};

/// Parameters of a program besides its rows.
pub(super) struct ProgramInput<'a> {
    /// d*: from the point of linearisation to the target, per coordinate.
    pub wish: &'a [f64],
    /// w, per coordinate.
    pub weights: &'a [f64],
    /// τ.
    pub proximal: f64,
    /// ρ; `None`: every row is hard.
    pub penalty: Option<f64>,
}

/// The solution of a program.
pub(super) struct Step {
    /// d, per coordinate.
    pub step: Vec<f64>,
    /// Rows that hold with equality and a positive multiplier, sorted.
    pub active: Vec<Key>,
}

/// Clarabel, with the structure of the last program.
pub(super) struct Program {
    /// Per group: whether it keeps its previous shift.
    pub fixed: Vec<bool>,
    /// Per group, the first group that moves with it, with equal weights and targets; `None`: all move independently.
    pub leader: Option<Vec<usize>>,
    warm: Option<Warm>,
    /// Number of interior-point iterations so far.
    pub iterations: u64,
    /// Number of programs solved so far.
    pub programs: u64,
}

struct Warm {
    equations: bool,
    keys: Vec<(Key, bool)>,
    columns: Vec<usize>,
    indices: Vec<usize>,
    solver: DefaultSolver<f64>,
}

/// Margin ε of all constraints (mm), so that rounding does not fail the exact check.
pub(super) const MARGIN: f64 = 1e-6;
/// Largest number of corrections of a guess of the active rows.
const ROUNDS: usize = 4;
/// Tolerance of multipliers and rows in a guess (mm, at mean weight 1).
const AGREE: f64 = 1e-8;

impl Program {
    /// All groups move independently.
    pub fn new(fixed: Vec<bool>) -> Self {
        Self { fixed, leader: None, warm: None, iterations: 0, programs: 0 }
    }

    /// Forgets the last program, and counts from zero.
    pub fn reset(&mut self) {
        (self.warm, self.iterations, self.programs) = (None, 0, 0);
    }

    /// Solves the program; `None` if it is infeasible or Clarabel fails.
    pub fn solve(&mut self, rows: &[Row], ask: &ProgramInput<'_>) -> Option<Step> {
        let rows = self.movable(rows);
        let solved = self.clarabel(&rows, ask, false)?;
        let active = solved.multipliers.iter().zip(&solved.slacks).zip(&rows);
        let active = active.filter(|((z, s), _)| z > s).map(|(_, r)| r.key).collect();
        Some(Step { step: solved.step, active })
    }

    /// As `solve` with hard rows, starting from a guess of the active ones.
    pub fn solve_from(&mut self, rows: &[Row], ask: &ProgramInput<'_>, guess: &[Key]) -> Option<Step> {
        let all = self.movable(rows);
        let mut active: Vec<Key> = guess.to_vec();
        for _ in 0..ROUNDS {
            let chosen: Vec<&Row> =
                all.iter().copied().filter(|r| active.binary_search(&r.key).is_ok()).collect();
            let Some(solved) = self.clarabel(&chosen, ask, true) else { break };
            let kept = chosen.iter().zip(&solved.multipliers).filter(|(_, z)| **z >= -AGREE);
            let mut next: Vec<Key> = kept.map(|(r, _)| r.key).collect();
            let mut agrees = next.len() == chosen.len();
            for row in &all {
                if row.value_after(&solved.step) < MARGIN - AGREE && active.binary_search(&row.key).is_err() {
                    next.push(row.key);
                    agrees = false;
                }
            }
            next.sort_unstable();
            if agrees {
                return Some(Step { step: solved.step, active: next });
            }
            active = next;
        }
        self.solve(rows, ask)
    }

    /// Rows that depend on a group that is not fixed.
    fn movable<'a>(&self, rows: &'a [Row]) -> Vec<&'a Row> {
        rows.iter().filter(|r| r.terms().iter().any(|t| !self.fixed[t.0 as usize])).collect()
    }

    fn clarabel(&mut self, rows: &[&Row], ask: &ProgramInput<'_>, equations: bool) -> Option<Solved> {
        let free_step = |i: usize| {
            let (d, w) = (ask.wish[i], ask.weights[i]);
            if self.fixed[i / 2] { 0.0 } else { d * w / (w + ask.proximal) }
        };
        let mut step: Vec<f64> = (0..ask.wish.len()).map(free_step).collect();
        if rows.is_empty() {
            return Some(Solved { step, multipliers: Vec::new(), slacks: Vec::new() });
        }
        let tied: Vec<Row> = match &self.leader {
            Some(leader) => rows.iter().map(|row| row.tied(leader, &self.fixed)).collect(),
            None => rows.iter().map(|row| **row).collect(),
        };
        let rows = &tied;
        let mut members = vec![1.0; self.fixed.len()];
        for (group, &leader) in self.leader.iter().flatten().enumerate().filter(|(g, l)| g != *l) {
            members[leader] += members[group];
        }
        // Local indices of the groups in rows, in order of group.
        let mut local = vec![usize::MAX; self.fixed.len()];
        for &(g, _) in rows.iter().flat_map(|r| r.terms()) {
            if !self.fixed[g as usize] {
                local[g as usize] = 0;
            }
        }
        let groups: Vec<usize> = (0..local.len()).filter(|&g| local[g] == 0).collect();
        for (i, &g) in groups.iter().enumerate() {
            local[g] = i;
        }
        let slack: Vec<bool> = rows.iter().map(|r| ask.penalty.is_some() && r.value < MARGIN).collect();
        let elastic: Vec<usize> = (0..rows.len()).filter(|&i| slack[i]).collect();
        let (free, n) = (2 * groups.len(), 2 * groups.len() + elastic.len());
        let m = rows.len() + elastic.len();

        // Fill the matrix by columns: count, cumulate, fill in order of row.
        let mut count = vec![0_usize; n + 1];
        let each = |row: &Row, f: &mut dyn FnMut(usize, f64)| {
            for &(g, gradient) in row.terms() {
                let at = local[g as usize];
                if at != usize::MAX {
                    f(2 * at, gradient[0]);
                    f(2 * at + 1, gradient[1]);
                }
            }
        };
        for row in rows {
            each(row, &mut |column, _| count[column + 1] += 1);
        }
        count[free + 1..].fill(2);
        for column in 0..n {
            count[column + 1] += count[column];
        }
        let columns = count.clone();
        let (mut indices, mut values) = (vec![0; columns[n]], vec![0.0; columns[n]]);
        let mut put = |column: usize, row: usize, value: f64| {
            indices[count[column]] = row;
            values[count[column]] = value;
            count[column] += 1;
        };
        for (i, row) in rows.iter().enumerate() {
            each(row, &mut |column, value| put(column, i, -value));
        }
        for (k, &i) in elastic.iter().enumerate() {
            put(free + k, i, -1.0);
            put(free + k, rows.len() + k, -1.0);
        }
        let mut right: Vec<f64> = rows.iter().map(|r| r.value - MARGIN).collect();
        right.resize(m, 0.0);
        let coordinate = |i: usize| 2 * groups[i / 2] + i % 2;
        let weight = |i: usize| members[groups[i / 2]] * ask.weights[coordinate(i)];
        let proximal = |i: usize| members[groups[i / 2]] * ask.proximal;
        let mut diagonal: Vec<f64> = (0..free).map(|i| weight(i) + proximal(i)).collect();
        let mut linear: Vec<f64> = (0..free).map(|i| -weight(i) * ask.wish[coordinate(i)]).collect();
        // A small curvature keeps the slacks' block regular.
        diagonal.resize(n, 1e-6);
        linear.resize(n, ask.penalty.unwrap_or(0.0));

        let keys: Vec<(Key, bool)> = rows.iter().zip(&slack).map(|(r, s)| (r.key, *s)).collect();
        let same = |w: &Warm| {
            w.equations == equations && w.keys == keys && w.columns == columns && w.indices == indices
        };
        let mut warm = self.warm.take().filter(same);
        if let Some(kept) = &mut warm
            && kept.solver.update_data(&diagonal, &linear, &values, &right).is_err()
        {
            warm = None;
        }
        let mut warm = match warm {
            Some(kept) => kept,
            None => {
                let quadratic = CscMatrix::new(n, n, (0..=n).collect(), (0..n).collect(), diagonal);
                let matrix = CscMatrix::new(m, n, columns.clone(), indices.clone(), values);
                let cone = if equations { ZeroConeT(m) } else { NonnegativeConeT(m) };
                let solver =
                    DefaultSolver::new(&quadratic, &linear, &matrix, &right, &[cone], settings()).ok()?;
                Warm { equations, keys, columns, indices, solver }
            }
        };
        warm.solver.solve();
        self.programs += 1;
        self.iterations += u64::from(warm.solver.solution.iterations);
        let solution = &warm.solver.solution;
        let solved = match solution.status {
            SolverStatus::Solved | SolverStatus::AlmostSolved if solution.x.iter().all(|x| x.is_finite()) => {
                for i in 0..free {
                    step[coordinate(i)] = solution.x[i];
                }
                for (group, &leader) in self.leader.iter().flatten().enumerate() {
                    step.copy_within(2 * leader..2 * leader + 2, 2 * group);
                }
                let (multipliers, slacks) =
                    (solution.z[..rows.len()].to_vec(), solution.s[..rows.len()].to_vec());
                Some(Solved { step, multipliers, slacks })
            }
            // Infeasible, out of iterations, stalled or failed: the caller tries other methods.
            _ => None,
        };
        self.warm = Some(warm);
        solved
    }
}

struct Solved {
    step: Vec<f64>,
    multipliers: Vec<f64>,
    slacks: Vec<f64>,
}

pub(super) fn settings() -> DefaultSettings<f64> {
    DefaultSettings {
        verbose: false,
        max_iter: 100,
        // Both would prevent updates of the data, or make results depend on the machine.
        presolve_enable: false,
        max_threads: 1,
        direct_solve_method: "qdldl".to_string(),
        // Rows already have unit scale, and every solution is linearised again.
        equilibrate_enable: false,
        iterative_refinement_reltol: 1e-9,
        iterative_refinement_abstol: 1e-9,
        ..DefaultSettings::default()
    }
}
