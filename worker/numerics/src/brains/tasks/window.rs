//! The part of a record that a readout sees: all of it, or a time from the first contact on.
//!
//! Contact: the first reading above a tenth of its channel's scale (RMS of the initial body's training signals) and above five
//! standard deviations of its error.

use super::{Labels, SensingTask};
use crate::trial::PreparedTrial;

/// Least reading of a contact, relative to the channel's scale, and in standard deviations of the reading's error.
const CONTACT: [f64; 2] = [0.1, 5.0];

/// Greatest number of blocks of instants, of whose sums a device needs one weight per channel. In the authors' scene, 25 blocks of
/// 40 ms have the errors of a weight per instant; with 17, errors of impulses double.
const BLOCKS: usize = 25;

/// A window of each record of `instants` instants.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Window {
    /// Number of its instants.
    pub(super) len: usize,
    /// Reading per channel, relative to its scale, above which it starts; −1: with the record.
    pub(super) thresholds: Vec<f64>,
    instants: usize,
}

impl Window {
    /// That of the readouts of a trial.
    pub(super) fn of(trial: &PreparedTrial) -> Self {
        let (instants, scales) = (trial.problem.scene.instants, &trial.scales.channels);
        let Some(len) = trial.problem.tasks.window else {
            return Self { len: instants, thresholds: vec![-1.0; scales.len()], instants };
        };
        let deviations = trial.chip.as_ref().map_or(vec![0.0; scales.len()], |chip| {
            chip.deviations().iter().zip(&chip.bias).map(|(own, bias)| own.hypot(*bias)).collect()
        });
        let least = |(scale, error): (&f64, f64)| CONTACT[0].max(CONTACT[1] * error / scale);
        let thresholds = scales.iter().zip(deviations).map(least).collect();
        Self { len, thresholds, instants }
    }

    /// The instant of contact in each record of signals (N, T, channels), divided by their scales.
    pub(super) fn contacts(&self, signals: &[f64]) -> impl Iterator<Item = Option<usize>> {
        let channels = self.thresholds.len();
        let is_contact = |reading: &[f64]| reading.iter().zip(&self.thresholds).any(|(x, t)| x.abs() > *t);
        let records = signals.chunks_exact(self.instants * channels);
        records.map(move |record| record.chunks_exact(channels).position(is_contact))
    }

    /// Its first instant in each record, as for [`Window::contacts`]; 0 without contact.
    pub(super) fn starts(&self, signals: &[f64]) -> Vec<usize> {
        self.contacts(signals).map(Option::unwrap_or_default).collect()
    }

    /// Signals (N, len, channels) from these instants on; 0 after the end of a record.
    pub(super) fn signals(&self, signals: &[f64], starts: &[usize]) -> Vec<f64> {
        let channels = self.thresholds.len();
        let mut found = vec![0.0; starts.len() * self.len * channels];
        let records = signals.chunks_exact(self.instants * channels).zip(starts);
        for (own, (record, start)) in found.chunks_exact_mut(self.len * channels).zip(records) {
            own.iter_mut().zip(&record[start * channels..]).for_each(|(own, signal)| *own = *signal);
        }
        found
    }

    /// Number of instants per block; the last block may have fewer.
    pub(super) fn block(&self) -> usize {
        self.len.div_ceil(BLOCKS)
    }

    /// Sums (N, blocks, channels) of signals in windows (N, len, channels) over blocks of instants.
    pub(super) fn sums(&self, signals: &[f64]) -> Vec<f64> {
        let channels = self.thresholds.len();
        let sum = move |own: &[f64], c: usize| own.iter().skip(c).step_by(channels).sum::<f64>();
        let records = signals.chunks_exact(self.len * channels);
        let blocks = records.flat_map(|own| own.chunks(self.block() * channels));
        blocks.flat_map(|own| (0..channels).map(move |c| sum(own, c))).collect()
    }

    /// Transpose of [`Window::signals`] for one record: adds a cotangent (len, channels) to that of the record.
    pub(super) fn add_vjp(&self, cotangent: &[f64], start: usize, record: &mut [f64]) {
        let first = start * self.thresholds.len();
        record[first..].iter_mut().zip(cotangent).for_each(|(sum, own)| *sum += own);
    }
}

/// Moves times (ms) by those of windows that start at these instants: from the record's start to the window's (−1), or back (1).
/// Other labels stay.
pub(super) fn shifted(
    task: SensingTask,
    mut labels: Labels,
    starts: &[usize],
    interval: f64,
    sign: f64,
) -> Labels {
    if task == SensingTask::Onset {
        let times = starts.iter().map(|start| sign * 1e3 * interval * *start as f64);
        labels.iter_mut().zip(times).for_each(|(label, time)| label[0] += time);
    }
    labels
}

#[cfg(test)]
mod tests;
