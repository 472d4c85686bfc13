//! Work items: samples to integrate, in a queue, and samples for the reverse sweep.

use super::Outcome;
use super::simulation::SampleTape;
use std::sync::{Mutex, PoisonError};

/// A sample to integrate, and the memory for its results.
pub struct SampleJob<'a> {
    /// Signals (T, 3M).
    pub signals: &'a mut [f64],
    /// Outcome of the simulation.
    pub outcome: &'a mut Outcome,
    /// Tape for the reverse sweep.
    pub tape: Option<&'a mut SampleTape>,
    /// Index of the sample's forces.
    pub index: usize,
}

/// Samples that are not yet taken, in order.
pub type SampleQueue<'s, 'a> = Mutex<&'s mut [SampleJob<'a>]>;

/// Removes up to `most` samples from a queue.
pub fn take<'s, 'a>(queue: &SampleQueue<'s, 'a>, most: usize) -> &'s mut [SampleJob<'a>] {
    let mut queue = queue.lock().unwrap_or_else(PoisonError::into_inner);
    let all = std::mem::take(&mut *queue);
    let (taken, left) = all.split_at_mut(most.min(all.len()));
    *queue = left;
    taken
}

/// A sample for the reverse sweep.
#[derive(Clone, Copy)]
pub struct Backward<'a> {
    /// Number of the sample.
    pub at: usize,
    /// Its tape.
    pub tape: &'a SampleTape,
    /// Force history.
    pub history: &'a [f64],
    /// Cotangents of the signals (T, 3M).
    pub cotangent: &'a [f64],
}
