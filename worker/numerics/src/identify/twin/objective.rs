//! What is minimised, its gradient by the adjoint, and columns of its Jacobian by differences.

use super::unknowns::{Unknown, Unknowns};
use crate::dynamics::{
    Accuracy, Counters, Forces, Method, Outcome, Plan, Scene, Simulation, Solver, Wrt, planned, run,
};
use crate::identify::clock::{Clock, Offset};
use crate::identify::objective::onsets;
use crate::random::Draw;
use crate::trial::{Chip, Problem};
use crate::variation::Cast;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::borrow::Cow;

/// Of z, for differences: 10⁻⁴ standard deviations with the steps held.
const NUDGE: f64 = 1e-4;
/// Error of the signals by the steps that columns are taken with.
const COARSE: Accuracy = Accuracy(3e-2);

/// z with what it gives.
pub struct Point {
    pub z: DVector<f64>,
    pub cost: f64,
    cast: Cast,
    scene: Scene,
    simulation: Simulation,
    /// What the chips of the cast make of all signals, on the clock of the motion.
    felt: Vec<f64>,
    /// What is read of them (n, window, channels).
    read: Vec<f64>,
    /// Where clocks may be off: by how much each record's is (s), and the derivatives of `read` by it.
    offsets: Vec<f64>,
    slopes: Vec<f64>,
}

/// Columns of da/dz, an unknown each, of some records.
pub struct Columns {
    pub records: Vec<usize>,
    /// For how many records each stands.
    stands: Vec<f64>,
    /// (records, window, channels).
    of: Vec<Vec<f64>>,
    /// The same by the clocks' offsets, each record's by its own; empty where clocks are exact.
    slopes: Vec<f64>,
}

/// Body, records, window and weights.
pub struct Objective<'a> {
    problem: &'a Problem,
    design: &'a [f64],
    recordings: &'a [f64],
    /// Scene and forces of whole records, on the clock of the motion where clocks may be off.
    moving: (Scene, Forces),
    deviation: f64,
    clock: Option<Clock>,
    chip: Option<&'a Chip>,
    pool: &'a crate::Pool,
    pub unknowns: Unknowns,
    plan: Plan,
    /// For columns, of which a metric is made.
    coarse: Plan,
    /// What steps leave of the signals.
    least: f64,
    /// First instant of each record's force.
    onsets: Vec<usize>,
    /// Records that count: those that the body as designed can be simulated under.
    counts: Vec<bool>,
    window: usize,
    /// Readings of a record as far as the window.
    readings: usize,
    /// The records as far as that.
    scene: Scene,
    forces: Forces,
    recorded: Vec<f64>,
    /// Whether each recorded reading counts.
    seen: Vec<bool>,
    /// Standard deviation of each channel's noise, and of its bias.
    pub noise: Vec<f64>,
    bias: Vec<f64>,
    pub counters: Counters,
}

impl<'a> Objective<'a> {
    pub fn new(
        problem: &'a Problem,
        chip: Option<&'a Chip>,
        design: &'a [f64],
        (forces, recordings, deviation): (&'a Forces, &'a [f64], f64),
        unknowns: Unknowns,
        solver: &Solver,
        pool: &'a crate::Pool,
    ) -> Self {
        let width = problem.shape().inputs;
        let (least, delay) = problem.clock_and_delay();
        let body = (&problem.scene, design);
        let clock = Clock::new(deviation, delay, least, body, forces, &solver.in_equal_steps(), pool);
        let moving = match clock {
            Some(clock) => clock.in_motion(&problem.scene, forces),
            None => (problem.scene.clone(), forces.clone()),
        };
        let (scene, moved) = match clock {
            Some(_) => (Cow::Borrowed(&moving.0), Cow::Borrowed(&moving.1)),
            None => problem.in_motion(&problem.scene, forces),
        };
        let plan = planned(&scene, design, &moved, &solver.in_equal_steps()).double();
        let coarse = planned(&scene, design, &moved, &Solver::new(Method::Nystrom6, COARSE)).double();
        let mut objective = Self {
            problem,
            design,
            recordings,
            deviation,
            clock,
            chip,
            pool,
            unknowns,
            least: solver.accuracy.0.clamp(1e-6, 1e-2),
            plan,
            coarse,
            onsets: onsets(&problem.scene, forces),
            counts: vec![true; forces.samples],
            window: 0,
            readings: 0,
            scene: problem.scene.clone(),
            forces: forces.clone(),
            moving,
            recorded: Vec::new(),
            seen: Vec::new(),
            noise: vec![1.0; width],
            bias: chip.map_or_else(|| vec![0.0; width], |chip| chip.bias.clone()),
            counters: Counters::default(),
        };
        objective.look_at(problem.scene.instants);
        objective
    }

    /// Leaves out records that the body as designed cannot be simulated under; how many are left.
    pub fn leave_out(&mut self) -> usize {
        let cast = self.unknowns.cast(&vec![0.0; self.unknowns.all().len()]);
        let found = self.simulate(&self.plan, &cast, &self.forces, false);
        self.counters += found.counters;
        self.counts = found.outcomes.iter().map(|outcome| *outcome == Outcome::Ok).collect();
        self.see();
        self.counts.iter().filter(|counts| **counts).count()
    }

    /// Channels of a reading.
    fn width(&self) -> usize {
        self.noise.len()
    }

    /// Looks at so many instants of each record, from its onset; where clocks may be off, by as many more as signals may be late.
    pub fn look_at(&mut self, window: usize) {
        let all = self.problem.scene.instants;
        self.window = window;
        let (finer, margin) = self.clock.map_or((1, 0), |clock| (clock.finer, clock.margin()));
        let n = self.onsets.iter().map(|o| (o + window + 2 * margin).min(all)).max().unwrap_or(all);
        self.readings = n;
        (self.scene, self.forces) = self.moving.1.beginning(&self.moving.0, finer * n);
        let width = self.width();
        self.recorded =
            self.recordings.chunks(all * width).flat_map(|record| &record[..n * width]).copied().collect();
        self.see();
    }

    fn simulate(&self, plan: &Plan, cast: &Cast, forces: &Forces, keep_tape: bool) -> Simulation {
        let own = cast.scene(&self.scene);
        let (scene, forces) = match self.clock {
            Some(_) => (Cow::Borrowed(&own), Cow::Borrowed(forces)),
            None => self.problem.in_motion(&own, forces),
        };
        run(&scene, &cast.design(self.design), &forces, plan, keep_tape, self.pool)
    }

    /// Simulates; none where a record that counts does not reach its end.
    pub fn at(&mut self, z: DVector<f64>) -> Option<Point> {
        let cast = self.unknowns.cast(z.as_slice());
        let mut simulation = self.simulate(&self.plan, &cast, &self.forces, true);
        self.counters += simulation.counters;
        let well = |(outcome, counts): (&Outcome, &bool)| !counts || *outcome == Outcome::Ok;
        if !simulation.outcomes.iter().zip(&self.counts).all(well) {
            return None;
        }
        let mut felt = std::mem::take(&mut simulation.signals);
        cast.chips.read(&mut felt);
        let (read, scene) = (Vec::new(), cast.scene(&self.scene));
        let (offsets, slopes) = (Vec::new(), Vec::new());
        let point = Point { z, cost: 0.0, cast, scene, simulation, felt, read, offsets, slopes };
        Some(self.again(point))
    }

    fn cost(&self, point: &Point) -> f64 {
        let misfit: f64 = self.residual(&point.read).iter().map(|r| r * r).sum();
        let clocks: f64 = point.offsets.iter().map(|offset| (offset / self.deviation).powi(2)).sum();
        0.5 * (misfit + clocks + point.z.norm_squared())
    }

    /// The same under the weights that are now, with the best offsets of the clocks.
    pub fn again(&self, mut point: Point) -> Point {
        let (samples, width) = (self.forces.samples, self.width());
        let Some(clock) = self.clock else {
            if point.read.is_empty() {
                point.read = self.problem.read(point.felt.clone(), samples);
            }
            return Point { cost: self.cost(&point), ..point };
        };
        let felt = self.problem.felt(point.felt.clone(), samples, clock.finer);
        let record = self.readings * width;
        let of = |(i, felt): (usize, &[f64])| {
            let whiten = |own: &mut [f64]| self.whiten_record(i, own);
            let offset = clock.settle(felt, &self.recorded[i * record..][..record], width, &whiten);
            (offset, clock.read(felt, width, offset, 0), clock.slope(felt, width, offset))
        };
        let each = felt.par_chunks_exact(record * clock.finer).enumerate();
        let all: Vec<_> = self.pool.install(|| each.map(of).collect());
        point.offsets = all.iter().map(|(offset, ..)| *offset).collect();
        point.read = all.iter().flat_map(|(_, read, _)| read).copied().collect();
        point.slopes = all.into_iter().flat_map(|(.., slope)| slope).collect();
        Point { cost: self.cost(&point), ..point }
    }

    /// What is read of signals of all sensors by records whose clocks are off by this much.
    fn read(&self, felt: Vec<f64>, samples: usize, offsets: &[f64]) -> Vec<f64> {
        let Some(clock) = self.clock else { return self.problem.read(felt, samples) };
        let (felt, width) = (self.problem.felt(felt, samples, clock.finer), self.width());
        let each = felt.chunks_exact(self.readings * width * clock.finer).zip(offsets);
        each.flat_map(|(own, offset)| clock.read(own, width, *offset, 0)).collect()
    }

    /// Transpose of the same.
    fn read_vjp(&self, cotangent: Vec<f64>, samples: usize, offsets: &[f64]) -> Vec<f64> {
        let Some(clock) = self.clock else { return self.problem.read_vjp(cotangent, samples) };
        let width = self.width();
        let each = cotangent.chunks_exact(self.readings * width).zip(offsets);
        let felt = each.flat_map(|(own, offset)| clock.read_vjp(own, width, *offset)).collect();
        self.problem.felt_vjp(felt, samples, clock.finer)
    }

    /// What is read (n, window, channels), R^{-½}(y − a), and the same as if the clocks' offsets were not known, of the records listed.
    pub fn parts(&self, point: &Point, records: &[usize]) -> [Vec<f64>; 3] {
        let record = self.readings * self.width();
        let of = |all: &[f64]| records.iter().flat_map(|i| &all[i * record..][..record]).copied().collect();
        let left = self.residual(&point.read);
        let (mut before, mut slopes) = (left.clone(), point.slopes.clone());
        self.whiten(&mut slopes);
        if let Some(clock) = self.clock {
            clock.whiten_residual(&slopes, &point.offsets, record, &mut before);
        }
        [of(&point.read), of(&left), of(&before)]
    }

    /// The clocks' offsets with their intervals, from [`Self::jacobian`] of all records and the covariance of z times t².
    pub fn offsets(
        &self,
        point: &Point,
        columns: &Columns,
        jacobian: &DMatrix<f64>,
        covariance: &DMatrix<f64>,
        unmodelled: f64,
    ) -> Vec<Option<Offset>> {
        let Some(clock) = self.clock else { return Vec::new() };
        let (record, left, mut slopes) =
            (self.readings * self.width(), self.residual(&point.read), point.slopes.clone());
        self.whiten(&mut slopes);
        let of = |i: usize| {
            let at = columns.records.iter().position(|of| *of == i)?;
            let (own, rows) = (i * record..(i + 1) * record, jacobian.rows(at * record, record).into_owned());
            let both = [&slopes[own.clone()], &left[own]];
            Some(clock.offset(point.offsets[i], both, &rows, covariance, unmodelled))
        };
        (0..self.counts.len()).map(of).collect()
    }

    /// R^{-½}(y − a), zero of what is not seen.
    pub fn residual(&self, read: &[f64]) -> Vec<f64> {
        let mut left: Vec<f64> = self.recorded.iter().zip(read).map(|(y, a)| y - a).collect();
        self.whiten(&mut left);
        left
    }

    /// Nothing counts that is outside the window, of a record that does not count, or at the end of its range.
    fn see(&mut self) {
        let (width, record) = (self.width(), self.readings * self.width());
        let margin = self.clock.map_or(0, |clock| clock.margin());
        let mut seen = vec![1.0; self.recorded.len()];
        for (i, own) in seen.chunks_exact_mut(record).enumerate() {
            let end = (self.onsets[i] + self.window + margin).min(self.readings.saturating_sub(margin));
            let end = if self.counts[i] { end } else { 0 };
            own.iter_mut().skip(end * width).for_each(|seen| *seen = 0.0);
        }
        if let Some(chip) = self.chip {
            chip.disturb_vjp(&mut seen, &self.recorded);
        }
        self.seen = seen.into_iter().map(|seen| seen != 0.0).collect();
    }

    /// R^{-½} x = (x − s x̄)/σ for R = σ² + b² 1 1ᵀ of the n readings of a record's channel that are seen, (1 − s)² = σ²/(σ² + n b²);
    /// symmetric. The others become zero.
    fn whiten(&self, of: &mut [f64]) {
        let record = self.readings * self.width();
        of.chunks_exact_mut(record).enumerate().for_each(|(i, own)| self.whiten_record(i, own));
    }

    /// The same of one record.
    fn whiten_record(&self, i: usize, own: &mut [f64]) {
        let (width, seen) = (self.width(), &self.seen[i * own.len()..][..own.len()]);
        for c in 0..width {
            let (noise, bias) = (self.noise[c], self.bias[c]);
            let seen = || seen[c..].iter().step_by(width);
            let n = seen().filter(|seen| **seen).count().max(1) as f64;
            let counts = own[c..].iter().step_by(width).zip(seen()).filter(|(_, seen)| **seen);
            let mean = counts.map(|(x, _)| x).sum::<f64>() / n;
            let part = 1.0 - noise / noise.hypot(n.sqrt() * bias);
            let each = own[c..].iter_mut().step_by(width).zip(seen());
            each.for_each(|(x, seen)| *x = if *seen { (*x - part * mean) / noise } else { 0.0 });
        }
    }

    /// dF/dz.
    pub fn gradient(&mut self, point: &Point) -> DVector<f64> {
        let mut cotangent = self.residual(&point.read);
        self.whiten(&mut cotangent);
        cotangent.iter_mut().for_each(|bar| *bar = -*bar);
        let length = self.unknowns.all().iter().position(|of| *of == Unknown::LigamentLength);
        let of_length = length.map(|k| {
            let nudged = self.nudged(&self.plan, point, |z| z[k] += NUDGE, (&self.forces, &point.offsets));
            self.counters += nudged.1;
            let moved = nudged.0.iter().zip(&point.read).zip(&cotangent);
            moved.map(|((there, here), bar)| (there - here) / NUDGE * bar).sum::<f64>()
        });
        let mut cotangent = self.read_vjp(cotangent, self.forces.samples, &point.offsets);
        let chips = point.cast.chips.own_vjp(&point.felt, &cotangent);
        point.cast.chips.read_vjp(&mut cotangent);
        let gradient = point.simulation.vjp(&cotangent, Wrt::Parameters, self.pool);
        self.counters += gradient.counters;
        let mut slope = DVector::from(self.unknowns.pull(&point.scene, &point.cast, &gradient, &chips));
        if let (Some(k), Some(of_length)) = (length, of_length) {
            slope[k] = of_length;
        }
        slope + &point.z
    }

    /// What is read with z nudged.
    fn nudged(
        &self,
        plan: &Plan,
        point: &Point,
        nudge: impl Fn(&mut DVector<f64>),
        (forces, offsets): (&Forces, &[f64]),
    ) -> (Vec<f64>, Counters) {
        let mut z = point.z.clone();
        nudge(&mut z);
        let cast = self.unknowns.cast(z.as_slice());
        let simulation = self.simulate(plan, &cast, forces, false);
        let mut felt = simulation.signals;
        cast.chips.read(&mut felt);
        (self.read(felt, forces.samples, offsets), simulation.counters)
    }

    /// How far a nudge of all unknowns together moves each record, Σ R^{-½} da of it squared.
    fn moved(&mut self, point: &Point) -> Vec<f64> {
        let mut draw = Draw::numbered(0, 0);
        let along = DVector::from_fn(point.z.len(), |_, _| NUDGE * draw.normal());
        let all = (&self.forces, &point.offsets[..]);
        let [here, there] = [0.0, 1.0].map(|by| self.nudged(&self.coarse, point, |z| *z += by * &along, all));
        self.counters += here.1;
        self.counters += there.1;
        let mut moved: Vec<f64> = there.0.iter().zip(&here.0).map(|(there, here)| there - here).collect();
        self.whiten(&mut moved);
        let record = self.readings * self.width();
        moved.chunks_exact(record).map(|own| own.iter().map(|x| x * x).sum()).collect()
    }

    /// da/dz of some records, at most, one after the other: half of them those that move most, of which a few may outweigh all the others,
    /// half of them in the place of the rest.
    pub fn columns(&mut self, point: &Point, most: usize) -> Columns {
        let mut records: Vec<usize> = (0..self.counts.len()).filter(|i| self.counts[*i]).collect();
        let mut stands = vec![1.0; records.len()];
        if most < records.len() {
            let moved = self.moved(point);
            records.sort_by(|a, b| moved[*b].total_cmp(&moved[*a]).then(a.cmp(b)));
            let mut rest = records.split_off(most / 2);
            rest.sort_unstable();
            let some = most - records.len();
            records.extend((0..some).map(|i| rest[i * rest.len() / some]));
            stands = vec![1.0; most - some];
            stands.resize(most, rest.len() as f64 / some as f64);
        }
        let forces = self.forces.select(&records);
        let offsets: Vec<f64> = records.iter().filter_map(|i| point.offsets.get(*i)).copied().collect();
        let unknowns = self.unknowns.all().len();
        let of = |k: usize| match k {
            0 => self.nudged(&self.coarse, point, |_| (), (&forces, &offsets)),
            k => self.nudged(&self.coarse, point, |z| z[k - 1] += NUDGE, (&forces, &offsets)),
        };
        let mut read: Vec<(Vec<f64>, Counters)> =
            self.pool.install(|| (0..=unknowns).into_par_iter().map(of).collect());
        read.iter().for_each(|(_, counters)| self.counters += *counters);
        let here = read.remove(0).0;
        let column = |there: Vec<f64>| there.iter().zip(&here).map(|(a, b)| (a - b) / NUDGE).collect();
        let of = read.into_iter().map(|(there, _)| column(there)).collect();
        Columns { records, stands, of, slopes: point.slopes.clone() }
    }

    /// R^{-½} da/dz, record by record; less what the clocks' offsets can take up.
    pub fn jacobian(&self, Columns { records, of, slopes, .. }: &Columns) -> DMatrix<f64> {
        let record = self.readings * self.width();
        let mut slopes = slopes.clone();
        self.whiten(&mut slopes);
        let mut jacobian = DMatrix::zeros(records.len() * record, of.len());
        let mut whole = vec![0.0; self.recorded.len()];
        for (k, column) in of.iter().enumerate() {
            for (i, own) in records.iter().zip(column.chunks(record)) {
                whole[i * record..][..record].copy_from_slice(own);
            }
            self.whiten(&mut whole);
            if let Some(clock) = self.clock {
                clock.whiten_each(&slopes, record, &mut whole);
            }
            let own = records.iter().flat_map(|i| &whole[i * record..][..record]);
            jacobian.column_mut(k).iter_mut().zip(own).for_each(|(to, x)| *to = *x);
        }
        jacobian
    }

    /// JᵀJ + 1, some records in the place of all.
    pub fn curvature(&self, columns: &Columns) -> DMatrix<f64> {
        let mut jacobian = self.jacobian(columns);
        let record = self.readings * self.width();
        for (i, stands) in columns.stands.iter().enumerate() {
            jacobian.rows_mut(i * record, record).scale_mut(stands.sqrt());
        }
        let mut curvature = jacobian.tr_mul(&jacobian);
        (0..curvature.nrows()).for_each(|k| curvature[(k, k)] += 1.0);
        curvature
    }

    /// That of the chips, where each channel that is read has some.
    pub fn known_noise(&self) -> Option<Vec<f64>> {
        self.chip.map(Chip::deviations).filter(|all| all.iter().all(|noise| *noise > 0.0))
    }

    /// Standard deviation of each channel's noise by what is left, and by what the chips have, where they have any, and steps leave.
    pub fn noises(&self, point: &Point) -> [Vec<f64>; 2] {
        let width = self.width();
        let mut left = self.residual(&point.read);
        left.iter_mut().enumerate().for_each(|(i, r)| *r *= self.noise[i % width]);
        let seen = |c: usize| self.seen[c..].iter().step_by(width).filter(|seen| **seen).count() as f64;
        let rms = |of: &[f64], c: usize, n: f64| {
            (of[c..].iter().step_by(width).map(|x| x * x).sum::<f64>() / n.max(1.0)).sqrt()
        };
        let instants = (self.recorded.len() / width) as f64;
        let chip = self.chip.map_or_else(|| vec![0.0; width], Chip::deviations);
        let least = |c: usize| chip[c].max(self.least * rms(&self.recorded, c, instants));
        [(0..width).map(|c| rms(&left, c, seen(c))).collect(), (0..width).map(least).collect()]
    }

    /// Takes what is left for the noise of each channel, but no less than what chips have and steps leave; by how much that changes
    /// it, relative.
    pub fn weigh(&mut self, point: &Point) -> f64 {
        let [left, least] = self.noises(point);
        let noise = left.iter().zip(&least).map(|(left, least)| left.max(*least));
        let noise: Vec<f64> = noise.map(|noise| if noise > 0.0 { noise } else { 1.0 }).collect();
        let changed = noise.iter().zip(&self.noise).map(|(now, before)| (now / before - 1.0).abs());
        let changed = changed.fold(0.0, f64::max);
        self.noise = noise;
        changed
    }
}
