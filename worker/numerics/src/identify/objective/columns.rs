//! Jacobian columns by differences; curvature.

use super::{FitPoint, Misfit, NUDGE};
use crate::dynamics::{IntegrationPlan, SimulationCounts};
use crate::random::Draw;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Columns of da/dz for some records, one column per unknown.
pub struct Columns {
    pub records: Vec<usize>,
    /// Weight per record: the number of records that it represents.
    stands: Vec<f64>,
    /// Column per unknown (records, window, channels).
    of: Vec<Vec<f64>>,
}

impl Misfit<'_> {
    /// Readings of all records, or of those listed, at a nudged z.
    pub(super) fn nudged(
        &self,
        plan: &IntegrationPlan,
        point: &FitPoint,
        nudge: impl Fn(&mut DVector<f64>),
        records: Option<&[usize]>,
    ) -> (Vec<f64>, SimulationCounts) {
        let mut z = point.z.clone();
        nudge(&mut z);
        let (cast, forces) = (self.unknowns.cast(z.as_slice()), self.forces(&z, records));
        let simulation = self.simulate(plan, &cast, &forces, false);
        let mut felt = simulation.signals;
        cast.chips.read(&mut felt);
        let offset = |i: &usize| point.offsets.get(*i).copied();
        let some: Option<Vec<f64>> = records.map(|records| records.iter().filter_map(offset).collect());
        let offsets = some.as_deref().unwrap_or(&point.offsets);
        (self.read(felt, forces.samples, offsets), simulation.counters)
    }

    /// Sum of squares of R^{-½} da per record, under one random nudge of all fitted unknowns.
    fn moved(&mut self, point: &FitPoint, coarse: &IntegrationPlan) -> Vec<f64> {
        let mut draw = Draw::numbered(0, 0);
        let of = |k, _| if k < self.moves { NUDGE * draw.normal() } else { 0.0 };
        let along = DVector::from_fn(point.z.len(), of);
        let [here, there] = [0.0, 1.0].map(|by| self.nudged(coarse, point, |z| *z += by * &along, None));
        self.counters += here.1;
        self.counters += there.1;
        let mut moved: Vec<f64> = there.0.iter().zip(&here.0).map(|(there, here)| there - here).collect();
        self.readings.whiten(&mut moved);
        let record = self.readings.size();
        moved.chunks_exact(record).map(|own| own.iter().map(|x| x * x).sum()).collect()
    }

    /// da/dz for at most `most` records: half of them are the most sensitive, since a few can outweigh the others; half represent the rest.
    pub fn columns(&mut self, point: &FitPoint, most: usize) -> Columns {
        let coarse = match self.unknowns.free() {
            0 => self.simulator.coarse.clone(),
            _ => self.plans(&point.scene, &point.cast.design(self.design), &self.simulator.forces)[1].clone(),
        };
        let mut records: Vec<usize> =
            (0..self.readings.counts.len()).filter(|i| self.readings.counts[*i]).collect();
        let mut stands = vec![1.0; records.len()];
        if most < records.len() {
            let moved = self.moved(point, &coarse);
            records.sort_by(|a, b| moved[*b].total_cmp(&moved[*a]).then(a.cmp(b)));
            let mut rest = records.split_off(most / 2);
            rest.sort_unstable();
            let some = most - records.len();
            records.extend((0..some).map(|i| rest[i * rest.len() / some]));
            stands = vec![1.0; most - some];
            stands.resize(most, rest.len() as f64 / some as f64);
        }
        let of = |k: usize| match k {
            0 => self.nudged(&coarse, point, |_| (), Some(&records)),
            k => self.nudged(&coarse, point, |z| z[k - 1] += NUDGE, Some(&records)),
        };
        let mut read: Vec<(Vec<f64>, SimulationCounts)> =
            self.pool.install(|| (0..=self.moves).into_par_iter().map(of).collect());
        read.iter().for_each(|(_, counters)| self.counters += *counters);
        let here = read.remove(0).0;
        let column = |there: Vec<f64>| there.iter().zip(&here).map(|(a, b)| (a - b) / NUDGE).collect();
        let of = read.into_iter().map(|(there, _)| column(there)).collect();
        Columns { records, stands, of }
    }

    /// R^{-½} da/dz, record by record, with R including the prior of the clock offsets.
    pub fn jacobian(&self, point: &FitPoint, Columns { records, of, .. }: &Columns) -> DMatrix<f64> {
        let record = self.readings.size();
        let mut slopes = point.slopes.clone();
        self.readings.whiten(&mut slopes);
        let mut jacobian = DMatrix::zeros(records.len() * record, of.len());
        let mut whole = vec![0.0; self.readings.recorded.len()];
        for (k, column) in of.iter().enumerate() {
            for (i, own) in records.iter().zip(column.chunks(record)) {
                whole[i * record..][..record].copy_from_slice(own);
            }
            self.readings.whiten(&mut whole);
            if let Some(clock) = self.clock {
                clock.whiten_each(&slopes, record, &mut whole);
            }
            let own = records.iter().flat_map(|i| &whole[i * record..][..record]);
            jacobian.column_mut(k).iter_mut().zip(own).for_each(|(to, x)| *to = *x);
        }
        jacobian
    }

    /// JᵀJ + 1, with each record weighted by the number that it represents.
    pub fn curvature(&self, point: &FitPoint, columns: &Columns) -> DMatrix<f64> {
        let mut jacobian = self.jacobian(point, columns);
        let record = self.readings.size();
        for (i, stands) in columns.stands.iter().enumerate() {
            jacobian.rows_mut(i * record, record).scale_mut(stands.sqrt());
        }
        let mut curvature = jacobian.tr_mul(&jacobian);
        (0..curvature.nrows()).for_each(|k| curvature[(k, k)] += 1.0);
        curvature
    }
}
