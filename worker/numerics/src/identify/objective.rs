//! What is minimised, its gradient by the adjoint and its tangents.
//!
//! Tangents are one-sided differences with the steps held, five simulations in lanes for five parameters; the plain dual
//! numbers of `jvp` check them. Exact to 1e-4, they leave the gradient to the adjoint.

use super::{BOX, Parameter, TRUST};
use crate::dynamics::{
    Counters, Forces, Outcome, Parameters, Plan, Scene, Simulation, Solver, Wrt, choose, run, tune,
};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Of the logarithm, for tangents.
const NUDGE: f64 = 1e-6;
/// Part of the largest force from which a record counts as begun.
const BEGUN: f64 = 0.01;
/// Part of the signals' energy that the first window holds.
const GLANCE: f64 = 0.02;

/// A set of parameters with what it gives.
#[derive(Debug, Clone)]
pub struct Point {
    pub parameters: [f64; 6],
    plan: Plan,
    simulation: Simulation,
}

impl Point {
    /// (N, n, 3M), n the instants of the window.
    pub fn signals(&self) -> &[f64] {
        &self.simulation.signals
    }

    pub fn cost(&self, objective: &Objective<'_>) -> f64 {
        let fit: f64 = objective.residual(self.signals()).iter().map(|r| r * r).sum();
        0.5 * (fit + objective.distrust(&self.parameters).norm_squared())
    }
}

/// Scene, records, window and weights.
pub struct Objective<'a> {
    base: &'a Scene,
    design: &'a [f64],
    whole: (&'a Forces, &'a [f64]),
    solver: Solver,
    free: &'a [Parameter],
    pool: &'a crate::Pool,
    /// First instant of each record's force.
    onsets: Vec<usize>,
    /// Instants that are looked at, from each onset.
    window: usize,
    /// The records as far as that.
    scene: Scene,
    forces: Forces,
    signals: Vec<f64>,
    /// Of accelerations and rotation rates.
    noise: [f64; 2],
    pub counters: Counters,
}

impl<'a> Objective<'a> {
    pub fn new(
        scene: &'a Scene,
        design: &'a [f64],
        forces: &'a Forces,
        signals: &'a [f64],
        solver: Solver,
        free: &'a [Parameter],
        pool: &'a crate::Pool,
    ) -> Self {
        let mut objective = Self {
            base: scene,
            design,
            whole: (forces, signals),
            solver,
            free,
            pool,
            onsets: onsets(scene, forces),
            window: 0,
            scene: scene.clone(),
            forces: forces.clone(),
            signals: signals.to_vec(),
            noise: [1.0; 2],
            counters: Counters::default(),
        };
        objective.look_at(scene.instants);
        objective
    }

    /// Finds steps that keep what is `asked` at these parameters, on whole records; what it came to.
    pub fn tune(&mut self, parameters: &[f64; 6], asked: &Solver) -> String {
        let scene = Parameters::from_array(*parameters).set(self.base);
        let tuned = tune(&scene, self.design, self.whole.0, asked, self.pool);
        self.counters += tuned.counters;
        self.solver = tuned.solver;
        tuned.plan.reason
    }

    /// Instants of a whole record.
    pub fn instants(&self) -> usize {
        self.base.instants
    }

    /// Length of the window (s).
    pub fn seconds(&self) -> f64 {
        self.window as f64 * self.base.duration / self.base.instants as f64
    }

    /// Channels of an instant.
    pub fn width(&self) -> usize {
        3 * self.base.sensors.len()
    }

    /// Records.
    pub fn records(&self) -> usize {
        self.forces.samples
    }

    /// Instants of the window from the beginning of the records.
    pub fn length(&self) -> usize {
        self.scene.instants
    }

    /// The first window: as long as it takes the signals to hold a small part of their energy.
    pub fn first_window(&self) -> usize {
        let (width, instants) = (self.width(), self.instants());
        let mut energy = vec![[0.0; 2]; instants + 1];
        for (i, &onset) in self.onsets.iter().enumerate() {
            for n in onset..instants {
                let at = &self.whole.1[(i * instants + n) * width..][..width];
                at.iter().enumerate().for_each(|(c, y)| energy[n - onset + 1][kind(c)] += y * y);
            }
        }
        let total = energy.iter().fold([0.0; 2], |s, e| [s[0] + e[0], s[1] + e[1]]);
        let mut sum = [0.0; 2];
        for (n, e) in energy.iter().enumerate() {
            sum = [sum[0] + e[0], sum[1] + e[1]];
            // A kind that shows nothing is not waited for.
            if (0..2).all(|c| total[c] == 0.0 || sum[c] > GLANCE * total[c]) {
                return n.max(4);
            }
        }
        instants
    }

    /// Looks at so many instants of each record, from its onset.
    pub fn look_at(&mut self, window: usize) {
        let (forces, signals) = self.whole;
        let (all, width) = (self.instants(), self.width());
        self.window = window;
        let n = self.onsets.iter().map(|o| (o + window).min(all)).max().unwrap_or(all);
        (self.scene, self.forces) = forces.beginning(self.base, n);
        self.signals = signals.chunks(all * width).flat_map(|record| &record[..n * width]).copied().collect();
    }

    /// Whether an entry of the signals lies in its record's window.
    fn seen(&self, entry: usize) -> bool {
        let a_record = self.length() * self.width();
        (entry % a_record) / self.width() < self.onsets[entry / a_record] + self.window
    }

    /// The scene with these parameters.
    fn with(&self, parameters: &[f64; 6]) -> Scene {
        Parameters::from_array(*parameters).set(&self.scene)
    }

    /// Simulates; none where a sample does not reach its end.
    pub fn at(&mut self, parameters: &[f64; 6]) -> Option<Point> {
        let scene = self.with(parameters);
        let plan = choose(&scene, self.design, &self.solver).double();
        let simulation = run(&scene, self.design, &self.forces, &plan, true, self.pool);
        self.counters += simulation.counters;
        let all = simulation.outcomes.iter().all(|o| *o == Outcome::Ok);
        all.then_some(Point { parameters: *parameters, plan, simulation })
    }

    /// p·e^step in the free parameters, no farther from the scene's than `BOX`.
    pub fn moved(&self, parameters: &[f64; 6], step: &DVector<f64>) -> [f64; 6] {
        let (mut moved, start) = (*parameters, Parameters::of(self.base).array());
        for (&k, s) in self.free.iter().zip(step.iter()) {
            let k = k as usize;
            moved[k] = (moved[k] * s.exp()).clamp(start[k] / BOX, start[k] * BOX);
        }
        moved
    }

    /// The parameters with the `k`-th free one times e^`NUDGE`, also out of the box: at its edge records tell no less.
    fn nudged(&self, parameters: &[f64; 6], k: usize) -> [f64; 6] {
        let mut nudged = *parameters;
        nudged[self.free[k] as usize] *= NUDGE.exp();
        nudged
    }

    /// Parameters with stretch, shear, bend and density scaled; none where that would move one that is held.
    pub fn scaled(&self, parameters: &[f64; 6], scales: [f64; 4]) -> Option<[f64; 6]> {
        let mut scaled = *parameters;
        let places = [Parameter::Stretch, Parameter::Shear, Parameter::Bend, Parameter::Density];
        for (k, scale) in places.into_iter().zip(scales).filter(|(_, scale)| *scale != 1.0) {
            if !self.free.contains(&k) {
                return None;
            }
            scaled[k as usize] *= scale;
        }
        Some(scaled)
    }

    /// (y − a)/s within the window, zero outside.
    pub fn residual(&self, signals: &[f64]) -> Vec<f64> {
        let of = |(i, (y, a)): (usize, (&f64, &f64))| match self.seen(i) {
            true => (y - a) / self.noise[kind(i % self.width())],
            false => 0.0,
        };
        self.signals.iter().zip(signals).enumerate().map(of).collect()
    }

    /// (q − q₀)/ln 10.
    fn distrust(&self, parameters: &[f64; 6]) -> DVector<f64> {
        let start = Parameters::of(self.base).array();
        let of = |k: &Parameter| (parameters[*k as usize] / start[*k as usize]).ln() / TRUST;
        DVector::from_iterator(self.free.len(), self.free.iter().map(of))
    }

    /// Gradient of F in the free logarithms, by the adjoint.
    pub fn gradient(&mut self, point: &Point) -> DVector<f64> {
        let residual = self.residual(point.signals());
        let width = self.width();
        let cotangent: Vec<f64> =
            residual.iter().enumerate().map(|(i, r)| -r / self.noise[kind(i % width)]).collect();
        let found = point.simulation.vjp(&cotangent, Wrt::Parameters, self.pool);
        self.counters += found.counters;
        let slopes = found.parameters.unwrap_or_default().array();
        let of = |k: &Parameter| slopes[*k as usize] * point.parameters[*k as usize];
        let fit = DVector::from_iterator(self.free.len(), self.free.iter().map(of));
        fit + self.distrust(&point.parameters) / TRUST
    }

    /// da/dq/s in the window, a column a free parameter.
    pub fn jacobian(&mut self, point: &Point) -> DMatrix<f64> {
        let of = |k: usize| {
            let scene = self.with(&self.nudged(&point.parameters, k));
            run(&scene, self.design, &self.forces, &point.plan, false, self.pool)
        };
        let free = self.free.len();
        let nudged: Vec<Simulation> = self.pool.install(|| (0..free).into_par_iter().map(of).collect());
        let mut jacobian = DMatrix::zeros(self.signals.len(), free);
        for (k, nudged) in nudged.iter().enumerate() {
            self.counters += nudged.counters;
            for (i, (there, here)) in nudged.signals.iter().zip(point.signals()).enumerate() {
                if self.seen(i) {
                    jacobian[(i, k)] = (there - here) / (NUDGE * self.noise[kind(i % self.width())]);
                }
            }
        }
        jacobian
    }

    /// JᵀJ and the trust in the start.
    pub fn curvature(&self, jacobian: &DMatrix<f64>) -> DMatrix<f64> {
        let mut h = jacobian.tr_mul(jacobian);
        (0..h.nrows()).for_each(|k| h[(k, k)] += TRUST.powi(-2));
        h
    }

    /// Root mean squares of residual and signals within the window.
    fn sizes(&self, signals: &[f64]) -> [[f64; 2]; 2] {
        let mut sums = [[0.0; 2]; 2];
        let mut count = [0.0f64; 2];
        for (i, (y, a)) in self.signals.iter().zip(signals).enumerate().filter(|(i, _)| self.seen(*i)) {
            let c = kind(i % self.width());
            sums[0][c] += (y - a) * (y - a);
            sums[1][c] += y * y;
            count[c] += 1.0;
        }
        sums.map(|of| [0, 1].map(|c| (of[c] / count[c].max(1.0)).sqrt()))
    }

    /// RMS of the residual (mm/s², rad/s).
    pub fn residual_rms(&self, signals: &[f64]) -> [f64; 2] {
        self.sizes(signals)[0]
    }

    /// In % of the signals'.
    pub fn misfit(&self, signals: &[f64]) -> [f64; 2] {
        let [off, size] = self.sizes(signals);
        [0, 1].map(|c| if size[c] > 0.0 { 100.0 * off[c] / size[c] } else { 0.0 })
    }

    /// Takes the residual's size for the noise of each kind, but no less than what the steps leave; by how much that
    /// changes it, relative.
    pub fn weigh(&mut self, point: &Point) -> f64 {
        let [off, size] = self.sizes(point.signals());
        let least = self.solver.accuracy.0.clamp(1e-6, 1e-2);
        let noise = [0, 1].map(|c| {
            let noise = off[c].max(least * size[c]);
            if noise > 0.0 { noise } else { 1.0 }
        });
        let changed = [0, 1].map(|c| (noise[c] / self.noise[c] - 1.0).abs());
        self.noise = noise;
        changed[0].max(changed[1])
    }
}

/// The instant at which each record's force begins.
pub fn onsets(scene: &Scene, forces: &Forces) -> Vec<usize> {
    let onset = |i: usize| {
        let history = forces.sample(i);
        let largest = history.iter().fold(0.0f64, |m, f| m.max(f.abs()));
        let begun = |n: &usize| {
            let f = (0..forces.panels).map(|k| history[k * (forces.instants + 1) + n].abs());
            f.fold(0.0, f64::max) > BEGUN * largest
        };
        (0..=forces.instants).find(begun).unwrap_or(0) / forces.kinks(scene)
    };
    (0..forces.samples).map(onset).collect()
}

/// 0 of accelerations, 1 of rotation rates.
fn kind(channel: usize) -> usize {
    usize::from(channel % 3 == 2)
}

#[cfg(test)]
mod tests;
