//! What is minimised, its gradient by the adjoint and its tangents.
//!
//! Tangents are one-sided differences with the steps held, five simulations in lanes for five parameters; the plain dual
//! numbers of `jvp` check them. Exact to 1e-4, they leave the gradient to the adjoint.

use super::clock::Clock;
use super::{BOX, Offset, Parameter, TRUST};
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
    /// Where clocks may be off: by how much each record's is (s), and signals and their derivatives by it, 0 of one at its bound.
    pub offsets: Vec<f64>,
    read: Vec<f64>,
    slopes: Vec<f64>,
}

impl Point {
    /// (N, n, 3M), n the instants of the window.
    pub fn signals(&self) -> &[f64] {
        if self.offsets.is_empty() { &self.simulation.signals } else { &self.read }
    }

    pub fn cost(&self, objective: &Objective<'_>) -> f64 {
        let fit: f64 = objective.residual(self.signals()).iter().map(|r| r * r).sum();
        let clocks: f64 = self.offsets.iter().map(|offset| (offset / objective.deviation).powi(2)).sum();
        0.5 * (fit + clocks + objective.distrust(&self.parameters).norm_squared())
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
    /// Standard deviation of the clocks' offsets (s), and the clock of the motion where that is not 0.
    deviation: f64,
    pub clock: Option<Clock>,
    /// Scene and forces on the clock of the motion.
    moving: (Scene, Forces),
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
        (free, deviation): (&'a [Parameter], f64),
        pool: &'a crate::Pool,
    ) -> Self {
        let mut objective = Self {
            base: scene,
            design,
            whole: (forces, signals),
            solver,
            free,
            pool,
            deviation,
            clock: None,
            moving: (scene.clone(), forces.clone()),
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
        let forces = self.whole.0;
        self.clock = Clock::new(self.deviation, 0.0, 1, (&scene, self.design), forces, asked, self.pool);
        if let Some(clock) = self.clock {
            self.moving = clock.in_motion(self.base, forces);
            self.look_at(self.window);
        }
        let scene = Parameters::from_array(*parameters).set(&self.moving.0);
        let tuned = tune(&scene, self.design, &self.moving.1, asked, self.pool);
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
        self.scene.instants / self.clock.map_or(1, |clock| clock.finer)
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
    ///
    /// Where clocks may be off, by as many more as signals may be late.
    pub fn look_at(&mut self, window: usize) {
        let signals = self.whole.1;
        let (all, width) = (self.instants(), self.width());
        self.window = window;
        let (finer, margin) = self.clock.map_or((1, 0), |clock| (clock.finer, clock.margin()));
        let n = self.onsets.iter().map(|o| (o + window + 2 * margin).min(all)).max().unwrap_or(all);
        (self.scene, self.forces) = self.moving.1.beginning(&self.moving.0, finer * n);
        self.signals = signals.chunks(all * width).flat_map(|record| &record[..n * width]).copied().collect();
    }

    /// Whether an entry of the signals lies in its record's window.
    fn seen(&self, entry: usize) -> bool {
        let (length, margin) = (self.length(), self.clock.map_or(0, |clock| clock.margin()));
        let a_record = length * self.width();
        let n = (entry % a_record) / self.width();
        n < self.onsets[entry / a_record] + self.window + margin && n + margin < length
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
        let (offsets, read, slopes) = (Vec::new(), Vec::new(), Vec::new());
        let point = Point { parameters: *parameters, plan, simulation, offsets, read, slopes };
        all.then(|| self.again(point))
    }

    /// The same with the best offsets of the clocks under the weights that are now.
    pub fn again(&self, mut point: Point) -> Point {
        let Some(clock) = self.clock else { return point };
        let (width, motion) = (self.width(), &point.simulation.signals);
        let (record, moved) = (self.length() * width, self.scene.instants * width);
        let of = |(i, motion): (usize, &[f64])| {
            let whiten = |own: &mut [f64]| self.whiten(i * record, own);
            let offset = clock.settle(motion, &self.signals[i * record..][..record], width, &whiten);
            let slope = clock.slope(motion, width, offset);
            (offset, clock.read(motion, width, offset, 0), slope)
        };
        let all: Vec<_> = self.pool.install(|| motion.par_chunks_exact(moved).enumerate().map(of).collect());
        point.offsets = all.iter().map(|(offset, ..)| *offset).collect();
        point.read = all.iter().flat_map(|(_, read, _)| read).copied().collect();
        point.slopes = all.into_iter().flat_map(|(.., slope)| slope).collect();
        point
    }

    /// Entries from number `first` on in units of the noise, zero outside the window.
    fn whiten(&self, first: usize, of: &mut [f64]) {
        for (i, x) in of.iter_mut().enumerate() {
            let at = first + i;
            *x = if self.seen(at) { *x / self.noise[kind(at % self.width())] } else { 0.0 };
        }
    }

    /// Derivatives of the signals by the clocks' offsets, whitened; empty where no clock may be off.
    pub fn slopes(&self, point: &Point) -> Vec<f64> {
        let mut slopes = point.slopes.clone();
        self.whiten(0, &mut slopes);
        slopes
    }

    /// The residual that goes with [`Self::jacobian`]: as if the offsets were not known.
    pub fn residual_before(&self, point: &Point) -> Vec<f64> {
        let mut left = self.residual(point.signals());
        if let Some(clock) = self.clock {
            let record = self.length() * self.width();
            clock.whiten_residual(&self.slopes(point), &point.offsets, record, &mut left);
        }
        left
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
        let mut left = self.left(signals);
        left.iter_mut().enumerate().for_each(|(i, r)| *r /= self.noise[kind(i % self.width())]);
        left
    }

    /// y − a within the window, zero outside.
    pub fn left(&self, signals: &[f64]) -> Vec<f64> {
        let of = |(i, (y, a)): (usize, (&f64, &f64))| if self.seen(i) { y - a } else { 0.0 };
        self.signals.iter().zip(signals).enumerate().map(of).collect()
    }

    /// (q − q₀)/ln 10.
    fn distrust(&self, parameters: &[f64; 6]) -> DVector<f64> {
        let start = Parameters::of(self.base).array();
        let of = |k: &Parameter| (parameters[*k as usize] / start[*k as usize]).ln() / TRUST;
        DVector::from_iterator(self.free.len(), self.free.iter().map(of))
    }

    /// The clocks' offsets with their intervals, from [`Self::jacobian`] and the parameters' covariance times t².
    pub fn offsets(
        &self,
        point: &Point,
        jacobian: &DMatrix<f64>,
        covariance: &DMatrix<f64>,
        unmodelled: f64,
    ) -> Vec<Offset> {
        let Some(clock) = self.clock else { return Vec::new() };
        let (slopes, left) = (self.slopes(point), self.residual(point.signals()));
        let record = self.length() * self.width();
        let of = |(i, value): (usize, &f64)| {
            let own = i * record..(i + 1) * record;
            let rows = jacobian.rows(own.start, record).into_owned();
            clock.offset(*value, [&slopes[own.clone()], &left[own]], &rows, covariance, unmodelled)
        };
        point.offsets.iter().enumerate().map(of).collect()
    }

    /// Gradient of F in the free logarithms, by the adjoint.
    pub fn gradient(&mut self, point: &Point) -> DVector<f64> {
        let residual = self.residual(point.signals());
        let (width, record) = (self.width(), self.length() * self.width());
        let mut cotangent: Vec<f64> =
            residual.iter().enumerate().map(|(i, r)| -r / self.noise[kind(i % width)]).collect();
        if let Some(clock) = self.clock {
            let each = cotangent.chunks_exact(record).zip(&point.offsets);
            cotangent = each.flat_map(|(bar, offset)| clock.read_vjp(bar, width, *offset)).collect();
        }
        let found = point.simulation.vjp(&cotangent, Wrt::Parameters, self.pool);
        self.counters += found.counters;
        let slopes = found.parameters.unwrap_or_default().array();
        let of = |k: &Parameter| slopes[*k as usize] * point.parameters[*k as usize];
        let fit = DVector::from_iterator(self.free.len(), self.free.iter().map(of));
        fit + self.distrust(&point.parameters) / TRUST
    }

    /// da/dq/s in the window, a column a free parameter; less what the clocks' offsets can take up.
    pub fn jacobian(&mut self, point: &Point) -> DMatrix<f64> {
        let of = |k: usize| {
            let scene = self.with(&self.nudged(&point.parameters, k));
            run(&scene, self.design, &self.forces, &point.plan, false, self.pool)
        };
        let free = self.free.len();
        let nudged: Vec<Simulation> = self.pool.install(|| (0..free).into_par_iter().map(of).collect());
        let mut jacobian = DMatrix::zeros(self.signals.len(), free);
        let (slopes, width) = (self.slopes(point), self.width());
        for (k, mut nudged) in nudged.into_iter().enumerate() {
            self.counters += nudged.counters;
            if let Some(clock) = self.clock {
                let each = nudged.signals.chunks_exact(self.scene.instants * width).zip(&point.offsets);
                nudged.signals = each.flat_map(|(own, offset)| clock.read(own, width, *offset, 0)).collect();
            }
            for (i, (there, here)) in nudged.signals.iter().zip(point.signals()).enumerate() {
                if self.seen(i) {
                    jacobian[(i, k)] = (there - here) / (NUDGE * self.noise[kind(i % width)]);
                }
            }
            if let Some(clock) = self.clock {
                let record = self.length() * width;
                clock.whiten_each(&slopes, record, jacobian.column_mut(k).as_mut_slice());
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
