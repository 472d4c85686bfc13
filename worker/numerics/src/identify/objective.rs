//! The objective F and its gradient by the adjoint.

use super::clock::{Clock, Offset};
use super::unknowns::{Unknown, Unknowns};
use crate::dynamics::{
    Accuracy, Forces, IntegrationPlan, Integrator, IntegratorSettings, Outcome, Parameters, Scene,
    Simulation, SimulationCounts, Wrt, planned, run,
};
use crate::trial::{Chip, Problem, tuned as tune_in_motion};
use crate::variation::Cast;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::borrow::Cow;

/// Difference in z (standard deviations) for derivatives, with time steps held.
const NUDGE: f64 = 1e-4;
/// Fraction of the signals' energy in the first window.
const GLANCE: f64 = 0.02;
/// Integration error for columns of the Jacobian.
const COARSE: Accuracy = Accuracy(3e-2);

mod columns;
mod readings;

pub use columns::Columns;
use readings::Readings;

/// z, its simulation and its cost.
pub struct FitPoint {
    pub z: DVector<f64>,
    pub cost: f64,
    pub cast: Cast,
    scene: Scene,
    plan: IntegrationPlan,
    simulation: Simulation,
    /// All signals as the cast's chips return them, on the clock of the simulation.
    felt: Vec<f64>,
    /// Readings (n, window, channels).
    pub read: Vec<f64>,
    /// With uncertain clocks: offset per record (s), and derivative of `read` in it.
    offsets: Vec<f64>,
    slopes: Vec<f64>,
}

/// F(z): half the sum of squares of whitened residuals, of clock offsets relative to their deviation, and of unknowns.
pub struct Misfit<'a> {
    problem: &'a Problem,
    design: &'a [f64],
    pool: &'a crate::Pool,
    /// Set if the records' clocks are uncertain.
    pub clock: Option<Clock>,
    pub unknowns: Unknowns,
    /// Number of unknowns, from the first, that are fitted.
    pub moves: usize,
    pub readings: Readings<'a>,
    simulator: Simulator,
    pub counters: SimulationCounts,
}

/// What is simulated, and how.
struct Simulator {
    /// Scene and forces of whole records, on the simulation's clock if clocks are uncertain.
    whole: (Scene, Forces),
    /// Difference between smooth and piecewise linear forces, on the same clock.
    whole_sharper: Forces,
    /// The same up to the end of the window.
    scene: Scene,
    forces: Forces,
    sharper: Forces,
    /// Solver and plans from `choose_clock`: accurate, and coarse for Jacobian columns.
    solver: IntegratorSettings,
    plan: IntegrationPlan,
    coarse: IntegrationPlan,
    /// Relative integration error of the signals.
    least: f64,
}

impl<'a> Misfit<'a> {
    pub fn new(
        problem: &'a Problem,
        chip: Option<&'a Chip>,
        design: &'a [f64],
        (forces, recordings, deviation): super::Records<'a>,
        unknowns: Unknowns,
        solver: &IntegratorSettings,
        pool: &'a crate::Pool,
    ) -> Self {
        let width = problem.shape().inputs;
        let sharper = sharper(forces);
        let mut objective = Self {
            problem,
            design,
            pool,
            clock: None,
            moves: unknowns.all().len(),
            unknowns,
            readings: Readings::new(recordings, deviation, &problem.scene, forces, chip, width),
            simulator: Simulator {
                whole: (problem.scene.clone(), forces.clone()),
                whole_sharper: sharper.clone(),
                scene: problem.scene.clone(),
                forces: forces.clone(),
                sharper,
                solver: *solver,
                plan: IntegrationPlan::equal(Integrator::Nystrom6, 1),
                coarse: IntegrationPlan::equal(Integrator::Nystrom6, 1),
                least: solver.accuracy.0.clamp(1e-6, 1e-2),
            },
            counters: SimulationCounts::default(),
        };
        objective.choose_clock(&problem.scene, design, forces, solver);
        objective.look_at(problem.scene.instants);
        objective
    }

    /// Chooses the solver, the clock of the simulation and the plans for a body under the records' forces.
    fn choose_clock(&mut self, body: &Scene, design: &[f64], forces: &Forces, solver: &IntegratorSettings) {
        let (problem, solver) = (self.problem, solver.in_equal_steps());
        let (least, delay) = problem.clock_and_delay();
        self.clock =
            Clock::new(self.readings.deviation, delay, least, (body, design), forces, &solver, self.pool);
        if let Some(clock) = self.clock {
            self.simulator.whole = clock.in_motion(&problem.scene, forces);
            self.simulator.whole_sharper = clock.in_motion(&problem.scene, &sharper(forces)).1;
        }
        self.simulator.solver = solver;
        let body = Scene { instants: self.simulator.whole.0.instants, ..body.clone() };
        let forces = self.simulator.whole.1.clone();
        [self.simulator.plan, self.simulator.coarse] = self.plans(&body, design, &forces);
    }

    /// Tunes solver and clock for the cast of z. Returns the solver's reason. Call `look_at` afterwards.
    pub fn tune(&mut self, z: &DVector<f64>, forces: &Forces, asked: &IntegratorSettings) -> String {
        let cast = self.unknowns.cast(z.as_slice());
        let (scene, design) = (cast.scene(&self.problem.scene), cast.design(self.design));
        let tuned = tune_in_motion(self.problem, &scene, &design, forces, asked, self.pool);
        self.counters += tuned.counters;
        self.choose_clock(&scene, &design, forces, &tuned.solver);
        tuned.reason
    }

    /// Plans for a scene and forces: accurate, and coarse for Jacobian columns.
    fn plans(&self, scene: &Scene, design: &[f64], forces: &Forces) -> [IntegrationPlan; 2] {
        let (scene, forces) = self.in_motion(scene, forces);
        [self.simulator.solver, IntegratorSettings::new(Integrator::Nystrom4, COARSE)]
            .map(|solver| planned(&scene, design, &forces, &solver).double())
    }

    /// Moves scene and forces to the clock of chips that filter, unless they are on the finer clock for uncertain clocks.
    fn in_motion<'b>(&self, scene: &'b Scene, forces: &'b Forces) -> (Cow<'b, Scene>, Cow<'b, Forces>) {
        match self.clock {
            Some(_) => (Cow::Borrowed(scene), Cow::Borrowed(forces)),
            None => self.problem.in_motion(scene, forces),
        }
    }

    /// Excludes records under which the body cannot be simulated at z = 0. Returns the number that remain.
    pub fn leave_out(&mut self) -> usize {
        let cast = self.unknowns.cast(&vec![0.0; self.unknowns.all().len()]);
        let found = self.simulate(&self.simulator.plan, &cast, &self.simulator.forces, false);
        self.counters += found.counters;
        self.readings.counts = found.outcomes.iter().map(|outcome| *outcome == Outcome::Ok).collect();
        self.readings.see();
        self.readings.counted()
    }

    /// Sets the window: `window` instants of each record from its onset, plus the margin for late clocks.
    pub fn look_at(&mut self, window: usize) {
        let (finer, margin) = self.clock.map_or((1, 0), |clock| (clock.finer, clock.margin()));
        self.readings.look_at(window, margin, self.instants());
        let (to, instants) = (&mut self.simulator, finer * self.readings.instants);
        (to.scene, to.forces) = to.whole.1.beginning(&to.whole.0, instants);
        to.sharper = to.whole_sharper.beginning(&to.whole.0, instants).1;
    }

    fn simulate(&self, plan: &IntegrationPlan, cast: &Cast, forces: &Forces, keep_tape: bool) -> Simulation {
        let own = cast.scene(&self.simulator.scene);
        let (scene, forces) = self.in_motion(&own, forces);
        run(&scene, &cast.design(self.design), &forces, plan, keep_tape, self.pool)
    }

    /// Forces of all records, or of those listed, with the sharpness in z.
    fn forces(&self, z: &DVector<f64>, records: Option<&[usize]>) -> Cow<'_, Forces> {
        let of = |all: &'_ Forces| records.map(|records| all.select(records));
        let by = self.unknowns.sharpness(z.as_slice());
        let forces = of(&self.simulator.forces).map_or(Cow::Borrowed(&self.simulator.forces), Cow::Owned);
        if by == 0.0 {
            return forces;
        }
        let (mut forces, sharp) = (forces.into_owned(), of(&self.simulator.sharper));
        let sharp = sharp.as_ref().unwrap_or(&self.simulator.sharper);
        forces.values.iter_mut().zip(&sharp.values).for_each(|(f, sharp)| *f += by * sharp);
        Cow::Owned(forces)
    }

    /// Simulates at z, clamped to the limits of free parameters. `None` if a record that counts fails.
    pub fn at(&mut self, mut z: DVector<f64>) -> Option<FitPoint> {
        for k in 0..self.unknowns.free() {
            let limit = self.unknowns.limit(k);
            z[k] = z[k].clamp(-limit, limit);
        }
        let cast = self.unknowns.cast(z.as_slice());
        let (scene, forces) = (cast.scene(&self.simulator.scene), self.forces(&z, None));
        let plan = match self.unknowns.free() {
            0 => self.simulator.plan.clone(),
            _ => self.plans(&scene, &cast.design(self.design), &forces)[0].clone(),
        };
        let mut simulation = self.simulate(&plan, &cast, &forces, true);
        self.counters += simulation.counters;
        let well = |(outcome, counts): (&Outcome, &bool)| !counts || *outcome == Outcome::Ok;
        if !simulation.outcomes.iter().zip(&self.readings.counts).all(well) {
            return None;
        }
        let mut felt = std::mem::take(&mut simulation.signals);
        cast.chips.read(&mut felt);
        let (read, offsets, slopes) = (Vec::new(), Vec::new(), Vec::new());
        let point = FitPoint { z, cost: 0.0, cast, scene, plan, simulation, felt, read, offsets, slopes };
        Some(self.again(point))
    }

    fn cost(&self, point: &FitPoint) -> f64 {
        let misfit: f64 = self.readings.residual(&point.read).iter().map(|r| r * r).sum();
        let clocks: f64 = point.offsets.iter().map(|offset| (offset / self.readings.deviation).powi(2)).sum();
        0.5 * (misfit + clocks + point.z.norm_squared())
    }

    /// Updates readings, clock offsets and cost for the present weights.
    pub fn again(&self, mut point: FitPoint) -> FitPoint {
        let (samples, width) = (self.simulator.forces.samples, self.readings.width());
        let Some(clock) = self.clock else {
            if point.read.is_empty() {
                point.read = self.problem.read(point.felt.clone(), samples);
            }
            return FitPoint { cost: self.cost(&point), ..point };
        };
        let felt = self.problem.low_pass_channels(point.felt.clone(), samples, clock.finer);
        let record = self.readings.size();
        let of = |(i, felt): (usize, &[f64])| {
            let whiten = |own: &mut [f64]| self.readings.whiten_record(i, own);
            let offset = clock.settle(felt, &self.readings.recorded[i * record..][..record], width, &whiten);
            (offset, clock.read(felt, width, offset, 0), clock.slope(felt, width, offset))
        };
        let each = felt.par_chunks_exact(record * clock.finer).enumerate();
        let all: Vec<_> = self.pool.install(|| each.map(of).collect());
        point.offsets = all.iter().map(|(offset, ..)| *offset).collect();
        point.read = all.iter().flat_map(|(_, read, _)| read).copied().collect();
        point.slopes = all.into_iter().flat_map(|(.., slope)| slope).collect();
        FitPoint { cost: self.cost(&point), ..point }
    }

    /// Readings from the signals of all sensors, at these clock offsets.
    fn read(&self, felt: Vec<f64>, samples: usize, offsets: &[f64]) -> Vec<f64> {
        let Some(clock) = self.clock else { return self.problem.read(felt, samples) };
        let (felt, width) =
            (self.problem.low_pass_channels(felt, samples, clock.finer), self.readings.width());
        let each = felt.chunks_exact(self.readings.size() * clock.finer).zip(offsets);
        each.flat_map(|(own, offset)| clock.read(own, width, *offset, 0)).collect()
    }

    /// Transpose of `read`.
    fn read_vjp(&self, cotangent: Vec<f64>, samples: usize, offsets: &[f64]) -> Vec<f64> {
        let Some(clock) = self.clock else { return self.problem.read_vjp(cotangent, samples) };
        let width = self.readings.width();
        let each = cotangent.chunks_exact(self.readings.size()).zip(offsets);
        let felt = each.flat_map(|(own, offset)| clock.read_vjp(own, width, *offset)).collect();
        self.problem.low_pass_channels_vjp(felt, samples, clock.finer)
    }

    /// For the records listed: readings (n, window, channels), R^{-½}(y − a), and the same with R including the clock offsets' prior.
    pub fn parts(&self, point: &FitPoint, records: &[usize]) -> [Vec<f64>; 3] {
        let record = self.readings.size();
        let of = |all: &[f64]| records.iter().flat_map(|i| &all[i * record..][..record]).copied().collect();
        let left = self.readings.residual(&point.read);
        let (mut before, mut slopes) = (left.clone(), point.slopes.clone());
        self.readings.whiten(&mut slopes);
        if let Some(clock) = self.clock {
            clock.whiten_residual(&slopes, &point.offsets, record, &mut before);
        }
        [of(&point.read), of(&left), of(&before)]
    }

    /// Clock offsets with intervals, from [`Self::jacobian`] of all records and t² times the covariance of z.
    pub fn offsets(
        &self,
        point: &FitPoint,
        columns: &Columns,
        jacobian: &DMatrix<f64>,
        covariance: &DMatrix<f64>,
        unmodelled: f64,
    ) -> Vec<Option<Offset>> {
        let Some(clock) = self.clock else { return Vec::new() };
        let (record, left, mut slopes) =
            (self.readings.size(), self.readings.residual(&point.read), point.slopes.clone());
        self.readings.whiten(&mut slopes);
        let of = |i: usize| {
            let at = columns.records.iter().position(|of| *of == i)?;
            let (own, rows) = (i * record..(i + 1) * record, jacobian.rows(at * record, record).into_owned());
            let both = [&slopes[own.clone()], &left[own]];
            Some(clock.offset(point.offsets[i], both, &rows, covariance, unmodelled))
        };
        (0..self.readings.counts.len()).map(of).collect()
    }

    /// dF/dz of the fitted unknowns.
    pub fn gradient(&mut self, point: &FitPoint) -> DVector<f64> {
        let mut cotangent = self.readings.residual(&point.read);
        self.readings.whiten(&mut cotangent);
        cotangent.iter_mut().for_each(|bar| *bar = -*bar);
        let mut by_difference = Vec::new();
        for k in 0..self.moves {
            if matches!(self.unknowns.all()[k], Unknown::LigamentLength | Unknown::Sharpness) {
                let nudged = self.nudged(&point.plan, point, |z| z[k] += NUDGE, None);
                self.counters += nudged.1;
                let moved = nudged.0.iter().zip(&point.read).zip(&cotangent);
                let slope = moved.map(|((there, here), bar)| (there - here) / NUDGE * bar).sum::<f64>();
                by_difference.push((k, slope));
            }
        }
        let mut cotangent = self.read_vjp(cotangent, self.simulator.forces.samples, &point.offsets);
        let chips = point.cast.chips.own_vjp(&point.felt, &cotangent);
        point.cast.chips.read_vjp(&mut cotangent);
        let gradient = point.simulation.vjp(&cotangent, Wrt::Parameters, self.pool);
        self.counters += gradient.counters;
        let mut slope = DVector::from(self.unknowns.pull(&point.scene, &point.cast, &gradient, &chips));
        by_difference.into_iter().for_each(|(k, of)| slope[k] = of);
        (slope + &point.z).rows(0, self.moves).into_owned()
    }

    /// Noise per channel of the chips; `None` unless all channels have noise.
    pub fn known_noise(&self) -> Option<Vec<f64>> {
        self.readings.chip.map(Chip::deviations).filter(|all| all.iter().all(|noise| *noise > 0.0))
    }

    /// Noise per channel: RMS of the residual, and its lower bound from the chips' noise and the integration error.
    pub fn noises(&self, point: &FitPoint) -> [Vec<f64>; 2] {
        let width = self.readings.width();
        let mut left = self.readings.residual(&point.read);
        left.iter_mut().enumerate().for_each(|(i, r)| *r *= self.readings.noise[i % width]);
        let seen =
            |c: usize| self.readings.seen[c..].iter().step_by(width).filter(|seen| **seen).count() as f64;
        let rms = |of: &[f64], c: usize, n: f64| {
            (of[c..].iter().step_by(width).map(|x| x * x).sum::<f64>() / n.max(1.0)).sqrt()
        };
        let instants = (self.readings.recorded.len() / width) as f64;
        let chip = self.readings.chip.map_or_else(|| vec![0.0; width], Chip::deviations);
        let least = |c: usize| chip[c].max(self.simulator.least * rms(&self.readings.recorded, c, instants));
        [(0..width).map(|c| rms(&left, c, seen(c))).collect(), (0..width).map(least).collect()]
    }

    /// Sets the noise per channel to the residual's RMS, at least the lower bound. Returns the largest relative change.
    pub fn weigh(&mut self, point: &FitPoint) -> f64 {
        let [left, least] = self.noises(point);
        let noise = left.iter().zip(&least).map(|(left, least)| left.max(*least));
        let noise: Vec<f64> = noise.map(|noise| if noise > 0.0 { noise } else { 1.0 }).collect();
        let changed = noise.iter().zip(&self.readings.noise).map(|(now, before)| (now / before - 1.0).abs());
        let changed = changed.fold(0.0, f64::max);
        self.readings.noise = noise;
        changed
    }

    /// Whether records are measured.
    pub fn is_measured(&self) -> bool {
        self.unknowns.all().contains(&Unknown::Sharpness)
    }

    /// Material parameters of the spec.
    pub fn parameters(&self) -> [f64; 6] {
        Parameters::of(&self.problem.scene).array()
    }

    /// Free parameters at a limit, with descent directed beyond it.
    pub fn held(&self, point: &FitPoint, gradient: &DVector<f64>) -> Vec<usize> {
        let is = |k: &usize| {
            point.z[*k].abs() >= self.unknowns.limit(*k) * (1.0 - 1e-12) && point.z[*k] * gradient[*k] < 0.0
        };
        (0..self.unknowns.free()).filter(is).collect()
    }

    /// Length of a step relative to the longest allowed, over all unknowns.
    pub fn strides(&self, step: &DVector<f64>) -> f64 {
        step.iter().enumerate().fold(0.0, |most, (k, by)| most.max(self.unknowns.strides(k, *by)))
    }

    /// Appends zeros for the unknowns that are held.
    pub fn padded(&self, step: &DVector<f64>) -> DVector<f64> {
        step.clone().resize_vertically(self.unknowns.all().len(), 0.0)
    }

    /// Length of the window (s).
    pub fn seconds(&self) -> f64 {
        self.readings.window as f64 * self.problem.scene.duration / self.instants() as f64
    }

    /// Readings per whole record.
    pub fn instants(&self) -> usize {
        self.problem.scene.instants
    }

    /// 0 for an acceleration, 1 for a rotation rate.
    fn kind(&self, channel: usize) -> usize {
        usize::from(self.problem.channels[channel % self.problem.channels.len()] == 2)
    }

    /// First window: the shortest that contains a fraction `GLANCE` of the energy.
    pub fn first_window(&self) -> usize {
        let (width, instants) = (self.readings.width(), self.instants());
        let mut energy = vec![[0.0; 2]; instants + 1];
        for (i, &onset) in self.readings.onsets.iter().enumerate() {
            for n in onset..instants {
                let at = &self.readings.all[(i * instants + n) * width..][..width];
                at.iter().enumerate().for_each(|(c, y)| energy[n - onset + 1][self.kind(c)] += y * y);
            }
        }
        let total = energy.iter().fold([0.0; 2], |s, e| [s[0] + e[0], s[1] + e[1]]);
        let mut sum = [0.0; 2];
        for (n, e) in energy.iter().enumerate() {
            sum = [sum[0] + e[0], sum[1] + e[1]];
            // A kind without signal does not lengthen the window.
            if (0..2).all(|c| total[c] == 0.0 || sum[c] > GLANCE * total[c]) {
                return n.max(4);
            }
        }
        instants
    }

    /// RMS residual of accelerations and rotation rates over counted readings: in mm/s² and rad/s, and in % of the signals' RMS.
    pub fn misfit(&self, point: &FitPoint) -> [[f64; 2]; 2] {
        let (mut off, mut size, mut count) = ([0.0; 2], [0.0; 2], [0.0f64; 2]);
        let each = self.readings.recorded.iter().zip(&point.read).zip(&self.readings.seen).enumerate();
        for (i, ((y, a), _)) in each.filter(|(_, (_, seen))| **seen) {
            let kind = self.kind(i % self.readings.width());
            off[kind] += (y - a).powi(2);
            size[kind] += y * y;
            count[kind] += 1.0;
        }
        let part = |c: usize| if size[c] > 0.0 { 100.0 * (off[c] / size[c]).sqrt() } else { 0.0 };
        [[0, 1].map(|c| (off[c] / count[c].max(1.0)).sqrt()), [0, 1].map(part)]
    }
}

/// −δ²f/12 + δ⁴f/90 per instant: smooth minus piecewise linear forces of the same samples. The spectrum of linear forces is that of smooth
/// ones times sinc²(πfh).
fn sharper(forces: &Forces) -> Forces {
    let difference = |f: &[f64]| {
        let inner = f.windows(3).map(|f| f[0] - 2.0 * f[1] + f[2]);
        std::iter::once(0.0).chain(inner).chain([0.0]).collect::<Vec<f64>>()
    };
    let of = |history: &[f64]| {
        let second = difference(history);
        let both = difference(&second).into_iter().zip(second);
        both.map(|(fourth, second)| fourth / 90.0 - second / 12.0).collect::<Vec<f64>>()
    };
    let values = forces.values.chunks(forces.instants + 1).flat_map(of).collect();
    Forces { values, ..forces.clone() }
}
